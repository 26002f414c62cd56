"""Model winds that come as an xarray Dataset: NetCDF, Zarr, cfgrib, wrfout, or given in Python.

In the order of the data: ``opening`` (files to Datasets), ``cf_axes``, ``cf_times``,
``vertical``, ``projection``, ``wind_names`` and ``wrfout`` (what a Dataset means, by its CF
attributes), ``axes_grid`` and ``curvilinear`` (where a point lies on its grid), ``dataset_fields``
(all of it as rows, one a level), ``gridded_catalogue`` (which rows make a wind profile at which
time), ``raw_chunks``, ``blosc_blocks``, ``chunk_reading`` and ``gridded_sampling`` (values at
points, each chunk read once).
"""
