"""One file a report format: CSV and Parquet tables, MADIS NetCDF, AMDAR BUFR."""
