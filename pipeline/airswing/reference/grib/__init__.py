"""GRIB: headers, grids, and values at points."""
