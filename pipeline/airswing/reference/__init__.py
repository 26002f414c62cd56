"""Model winds in: catalogue GRIB folders, sample their winds at report positions.

The order of the modules is the order of the data: ``grids`` (where a point
lies on a model's grid), ``packing`` (the value at a grid point of one
message), ``messages`` (what a file holds, from its octets), ``catalogue``
(which messages make a wind profile at which time), ``sampling`` (one model
time at its reports) and ``collocate`` (all model times, joined in time).
"""
