"""Model winds: catalogue the content of files, sample their winds at reports.

In the order of the data: ``files`` (kinds, copies and identities), ``state`` (which fields are
winds at a time), ``grids`` (position on a model's grid), ``grib/`` (headers and values of GRIB),
``gridded/`` (meaning and values of Datasets), ``catalogue`` (which fields make a profile at which
time), ``winds`` (interpolation), ``collocate`` (all model times, joined in time).
"""
