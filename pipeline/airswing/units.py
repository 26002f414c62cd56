"""Constants that more than one folder needs, each once, with unit and source.

The synthetic archives share none of them: they are the independent truth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # `airswing --help` does without numpy
    import numpy as np
    from numpy.typing import NDArray

# Metres a second in a knot: the international nautical mile an hour (BIPM, SI brochure).
KNOT = 1852.0 / 3600.0
FOOT = 0.3048  # Metres in a foot: the international foot of 1959, exact
ZERO_CELSIUS = 273.15  # Kelvin at zero degrees Celsius (BIPM, SI brochure)
HOUR, DAY = 3600.0, 86400.0  # Seconds
EARTH_RADIUS = 6371008.8  # Mean radius of the earth, m (IUGG 1980), where a sphere is sufficient
# Metres in a degree of latitude on the mean sphere: within 0.5 % of the ellipsoid's.
METRES_PER_DEGREE = 111195.0
# Radius of the sphere most models are computed on, m (GRIB2 code table 3.2, entry 6).
MODEL_EARTH_RADIUS = 6371229.0
# Standard errors on either side of a normal estimate that hold 95 % of it.
#
# Not 1.96: quantiles of Student's t are divided by it and tend to one.
NORMAL_95 = 1.959964

# Index of rows of an array: a slice, a mask or their numbers.
Picked: TypeAlias = "slice | NDArray[np.bool_] | NDArray[np.signedinteger]"
