"""Ground vector of each report: from chords between fixes, or from reported heading and airspeed.

Assumptions
-----------
Where an aircraft reports true heading, true airspeed and wind, V_G = V_A + V_W is the velocity of
its own GPS at the report, without the rounding of positions and times. This holds only if the
column named heading *is* the true heading of the wind computation: in some archives it is a track
or a magnetic heading. It is therefore compared with the chords first, aircraft by aircraft.

The test
--------
Over reports with both, the reported heading must differ from the heading that the chords imply by
less than 1.5 degrees in the median absolute value and by less than 0.6 degrees in the signed median
(a magnetic heading differs by the declination, which would become part of coefficient A), each plus
the effect of rounding, and by no more than it differs from the track (a track column agrees with
the track to its rounding); airspeeds must differ by less than 3 m/s in the median. With fewer than
20 reports the chords are used. Where an aircraft passes, single reports that differ from their
chord by more than 15 m/s plus five standard errors keep the chord.

Units
-----
Radians, m s-1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import (
    along_cross,
    angle_of_vector,
    bearing,
    speed_of_vector,
    vector_from_bearing,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEWEST = 20
"""Reports below which an aircraft's columns are not tested."""
# Radians, in the median absolute value, in addition to the effect of rounding.
MAX_HEADING_DIFFERENCE = float(np.radians(1.5))
# Radians: half a degree is what cutting instead of rounding to whole degrees causes.
MAX_HEADING_BIAS = float(np.radians(0.6))
# m/s, each in addition to the effect of the errors of both.
MAX_AIRSPEED_DIFFERENCE = 3.0
MAX_VECTOR_DIFFERENCE = 15.0
MEDIAN_OF_NORMAL = 0.6745  # Median absolute value of a normal variable of unit variance


class Evidence(NamedTuple):
    """Ground vector of each report, arrays of shape (report,), m s-1."""

    eastward: Array
    northward: Array
    # along_error, cross_error: its standard errors along and across itself
    along_error: Array
    cross_error: Array
    from_reported: NDArray[np.bool_]  # whether it is from reported heading and airspeed
    # (aircraft,): names of `airswing.flags.REPORTED_HEADING_USE`
    reason: NDArray[np.str_]


def _group_median(values: Array, group: Index, groups: int) -> Array:
    """Median of each group, NaN left out; NaN where a group has no value."""
    found = pd.Series(values).groupby(group).median().reindex(range(groups))
    return np.asarray(found, dtype=np.float64)


def choose_ground_vector(
    chord: tuple[Array, Array, Array, Array],
    wind: tuple[Array, Array],
    reported: tuple[Array, Array],
    steps: tuple[Array, Array, Array],
    aircraft: Index,
    number: int,
    *,
    derived: NDArray[np.bool_] | None = None,
) -> Evidence:
    """Choose the vector from reported heading and airspeed where it agrees with the chords.

    Parameters
    ----------
    chord : four ndarrays, shape (report,)
        Eastward and northward ground velocity from fixes, and its along- and cross-track standard
        errors, m s-1.
    wind : two ndarrays, shape (report,)
        Eastward and northward reported wind, m s-1.
    reported : two ndarrays, shape (report,)
        Reported true airspeed (m s-1) and true heading (radians); NaN where absent.
    steps : three ndarrays, shape (report,)
        Resolution of the reported airspeed (m s-1), heading (radians) and wind (m s-1).
    aircraft : ndarray of int, shape (report,)
        Aircraft of each report.
    derived : ndarray of bool, shape (report,), optional
        Reports whose wind was derived from heading, airspeed and the aircraft's own ground vector:
        that vector is used for them in any case.

    Returns
    -------
    Evidence
    """
    airspeed, heading = reported
    air = vector_from_bearing(airspeed, heading)
    vector = air[0] + wind[0], air[1] + wind[1]
    reason = _judge(chord, wind, air, vector, aircraft, number)
    errors = _reported_errors(airspeed, heading, vector, steps)
    apart = np.hypot(vector[0] - chord[0], vector[1] - chord[1])
    explained = np.hypot(chord[2], chord[3]) + np.hypot(*errors)
    # a larger difference is a gross error of one of the two
    far = apart > MAX_VECTOR_DIFFERENCE + 5.0 * explained
    use = (reason == "used")[aircraft] & ~far
    if derived is not None:
        use |= derived
    use &= np.isfinite(vector[0] + vector[1])
    return Evidence(
        np.where(use, vector[0], chord[0]),
        np.where(use, vector[1], chord[1]),
        np.where(use, errors[0], chord[2]),
        np.where(use, errors[1], chord[3]),
        use,
        reason,
    )


def _judge(
    chord: tuple[Array, Array, Array, Array],
    wind: tuple[Array, Array],
    air: tuple[Array, Array],
    vector: tuple[Array, Array],
    aircraft: Index,
    number: int,
) -> NDArray[np.str_]:
    """Name of `REPORTED_HEADING_USE` of each aircraft."""
    present = np.bincount(aircraft, weights=np.isfinite(vector[0] + vector[1]), minlength=number)
    implied = chord[0] - wind[0], chord[1] - wind[1]
    turned = angle_of_vector(*implied, *air)
    off_air = np.abs(turned)
    off_track = np.abs(angle_of_vector(chord[0], chord[1], *air))
    speed = speed_of_vector(*implied)
    off_speed = np.abs(speed_of_vector(*air) - speed)
    both = np.isfinite(off_air)

    def middle(values: ArrayLike) -> Array:
        return _group_median(np.where(both, values, np.nan), aircraft, number)

    # two standard errors of rounding, as a median of absolute values
    noise = MEDIAN_OF_NORMAL * 2.0
    with np.errstate(divide="ignore", invalid="ignore"):
        angle_noise = middle(chord[3] / speed)
        angle_allowed = MAX_HEADING_DIFFERENCE + noise * angle_noise
        speed_allowed = MAX_AIRSPEED_DIFFERENCE + noise * middle(chord[2])
    heading_apart, track_apart = middle(off_air), middle(off_track)
    judged = np.bincount(aircraft, weights=both, minlength=number)
    # a median's standard error is 1.25 sigma / sqrt(n); a few of them for correlated noise
    bias_allowed = MAX_HEADING_BIAS + 5.0 * angle_noise / np.sqrt(np.maximum(judged, 1.0))
    # negated, so that NaN counts as biased; likewise below
    biased = ~(np.abs(middle(turned)) <= bias_allowed)
    return np.asarray(
        np.select(
            [
                present == 0,
                judged < FEWEST,
                (track_apart < heading_apart) & (track_apart < 0.5 * MAX_HEADING_DIFFERENCE),
                ~(heading_apart <= angle_allowed) | (track_apart < heading_apart) | biased,
                ~(middle(off_speed) <= speed_allowed),
            ],
            ["absent", "too_few", "heading_is_track", "heading_differs", "airspeed_differs"],
            "used",
        )
    )


def _reported_errors(
    airspeed: Array,
    heading: Array,
    vector: tuple[Array, Array],
    steps: tuple[Array, Array, Array],
) -> tuple[Array, Array]:
    """Rounding of airspeed, heading and wind, turned onto the ground vector: along and across."""
    # rounding to steps is uniform over a step, whose variance is a twelfth of its square
    along_air = steps[0] / np.sqrt(12.0)
    cross_air = steps[1] / np.sqrt(12.0) * airspeed
    wind_variance = steps[2] ** 2 / 12.0
    cosine, sine = along_cross(*vector_from_bearing(1.0, heading), bearing(vector[0], vector[1]))
    along = (along_air * cosine) ** 2 + (cross_air * sine) ** 2 + wind_variance
    cross = (along_air * sine) ** 2 + (cross_air * cosine) ** 2 + wind_variance
    return np.sqrt(along), np.sqrt(cross)
