"""Model winds as xarray Datasets: NetCDF, Zarr, cfgrib, WRF, or given in Python.

``opening`` (files to Datasets), ``naming``, ``axes``, ``times``, ``levels`` and ``wrf`` (meaning of
a Dataset, by its CF attributes), ``fields`` (all of it as rows), ``reading`` (values at points).
"""
