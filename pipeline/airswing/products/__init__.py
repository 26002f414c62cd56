"""NetCDF products, ragged arrays of reports, and files written whole or not at all."""
