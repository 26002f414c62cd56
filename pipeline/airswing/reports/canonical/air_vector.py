"""The wind of reports that tell heading, airspeed and ground vector instead of it.

Assumptions
-----------
Mode-S (registers 5,0 and 6,0), flight recorders and some data links report the magnetic heading and
an airspeed beside the ground vector of their GPS. The wind is then ground velocity minus air
velocity, and the heading error of such a report is that of the heading it reports. A magnetic
heading is brought to true north by the IGRF declination at the report's place and date: aircraft
whose own variation table is older carry the difference into their deviation, as they do on board.

Airspeed is the true airspeed where it is there, else from the Mach number, else from the indicated
airspeed, at the reported temperature; where no temperature is reported either, at the standard
atmosphere's, which is off by up to some 4 % and is said of every such wind (``wind_source``): the
aircraft's airspeed scale takes the mean of it up.

Units
-----
m s-1, degrees, Pa, K.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.flags import WIND_SOURCE
from airswing.physics.airspeed import airspeed_from_calibrated, airspeed_from_mach
from airswing.physics.atmosphere import standard_temperature
from airswing.physics.geomagnetism import FieldLattice
from airswing.physics.triangle import vector_from_bearing, wind_from_triangle

Array = NDArray[np.float64]
Codes = NDArray[np.int8]
Told = dict[str, Array]  # Columns of some reports by name, NaN where absent; all of one length


def true_heading(told: Told, seconds: Array) -> Array:
    """Heading from true north (degrees, 0 to 360): as reported, else magnetic plus the declination.

    Parameters
    ----------
    told : dict of (n,) arrays
        ``reported_heading, magnetic_heading, latitude, longitude`` (degrees) and
        ``pressure_altitude`` (m).
    seconds : (n,) array
        Since 1970.
    """
    heading, magnetic = told["reported_heading"].copy(), told["magnetic_heading"]
    wanted = np.flatnonzero(np.isnan(heading) & np.isfinite(magnetic))
    if wanted.size:
        place = (
            told["latitude"][wanted],
            told["longitude"][wanted],
            np.nan_to_num(told["pressure_altitude"][wanted]),
            seconds[wanted],
        )
        declination = FieldLattice.covering(*place).at(*place).declination
        heading[wanted] = (magnetic[wanted] + np.degrees(declination)) % 360.0
    return heading


def true_airspeed(told: Told) -> tuple[Array, NDArray[np.bool_]]:
    """Airspeed as reported, else from Mach, else from the indicated airspeed.

    Parameters
    ----------
    told : dict of (n,) arrays
        ``reported_airspeed, mach, indicated_airspeed`` (m s-1), ``air_temperature`` (K),
        ``pressure`` (Pa) and ``pressure_altitude`` (m).

    Returns
    -------
    airspeed : (n,) array
        m s-1.
    standard : (n,) array of bool
        Where it rests on the standard atmosphere's temperature.
    """
    measured = told["air_temperature"]
    kelvin = np.where(np.isnan(measured), standard_temperature(told["pressure_altitude"]), measured)
    from_mach = airspeed_from_mach(told["mach"], kelvin)
    indicated = airspeed_from_calibrated(told["indicated_airspeed"], told["pressure"], kelvin)
    worked_out = np.where(np.isnan(from_mach), indicated, from_mach)
    reported = told["reported_airspeed"]
    airspeed = np.where(np.isnan(reported), worked_out, reported)
    return airspeed, np.isnan(reported) & np.isnan(measured) & np.isfinite(airspeed)


def wind_of(told: Told, heading: Array, airspeed: Array) -> tuple[Array, Array]:
    """Wind (eastward, northward, m s-1) as ground velocity minus air velocity; NaN where unknown.

    ``told`` has ``ground_speed`` (m s-1) and ``track``, with ``heading`` in degrees from true
    north.
    """
    ground = vector_from_bearing(told["ground_speed"], np.radians(told["track"]))
    return wind_from_triangle(*ground, airspeed, np.radians(heading))


def source_codes(derived: NDArray[np.bool_], standard: NDArray[np.bool_]) -> Codes:
    """`airswing.flags.WIND_SOURCE` of each wind: whether derived here, and at which temperature."""
    exact, rough = WIND_SOURCE["derived"], WIND_SOURCE["derived_at_standard_temperature"]
    return np.where(derived, np.where(standard, rough, exact), WIND_SOURCE["reported"]).astype(
        np.int8
    )
