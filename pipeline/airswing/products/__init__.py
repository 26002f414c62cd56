"""What airswing leaves behind: NetCDF files, ragged reports, files that are whole or not there."""
