"""Model winds as xarray Datasets: NetCDF, Zarr, cfgrib, WRF, or given in Python."""
