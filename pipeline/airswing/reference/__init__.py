"""Model winds in: catalogue GRIB folders, sample their winds at report positions.

The modules in the order of the data: ``octets``, ``grids`` and
``gridsections`` (where a point lies on a model's grid), ``packing`` and
``values`` (the value at a grid point of one message), ``fields``,
``edition1``, ``edition2`` and ``messages`` (what a file holds, from its
octets), ``sampling`` (one model time at its reports), ``filecache`` and
``catalogue`` (which messages make a wind profile at which time),
``planning`` (which reports need which model times), ``store`` and
``collocate`` (all model times, joined in time), ``inspection``.
"""
