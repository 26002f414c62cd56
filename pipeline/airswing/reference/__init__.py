"""Model winds in: catalogue what files hold, sample their winds at report positions.

In the order of the data: ``geometry/`` (where a point lies on a model's grid, what a model time
is), ``grib/`` (what a file of octets holds, and the value at a point of it), ``sampling`` (one
model time at its reports), ``planning`` (which reports need which model times), ``store``,
``places`` and ``collocate`` (all model times, joined in time).
"""
