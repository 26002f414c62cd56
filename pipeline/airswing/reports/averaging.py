"""Reports every few seconds brought to one an interval: means over straight flight.

Assumptions
-----------
What a report of one second tells beyond its neighbours is coding noise; model errors and the
aircraft's own are the same in all of them, so a mean is one report with less noise and no false
claim of many. Where the heading swings within the interval by more than :data:`STRAIGHT` the middle
report stands for it as it is: a mean over a turn is nowhere on the path.

Validity: intervals of up to some minutes. Positions are averaged in degrees, on the short way round
at the antimeridian; at the poles means of longitude are meaningless, of latitude they are not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.physics.triangle import direction_in_degrees, wrap_degrees
from airswing.reports.canonical.audit import Audit
from airswing.reports.derive import Columns

STRAIGHT = 10.0  # Degrees of heading within which an interval counts as straight
_MEANS = (
    "latitude",
    "pressure",
    "pressure_altitude",
    "eastward_wind",
    "northward_wind",
    "air_temperature",
    "reported_airspeed",
)
_ANGLES = ("longitude", "reported_heading")


def averaged(columns: Columns, interval: float, audit: Audit) -> None:
    """Bring reports sorted by ``tail`` and ``time`` to one an interval (s; 0: none), in place.

    ``averaged`` of the audit counts the reports that went into means or stood beside the middle
    one.
    """
    count = columns["tail"].size
    if interval <= 0.0 or count < 2:
        return
    seconds = columns["time"].astype("datetime64[ms]").astype(np.int64) / 1e3
    cell = np.floor(seconds / interval).astype(np.int64)
    new = np.ones(count, dtype=bool)
    new[1:] = (np.diff(columns["tail"]) != 0) | (np.diff(cell) != 0)
    new[1:] |= np.diff(columns["flight"]) != 0
    starts = np.flatnonzero(new)
    sizes = np.diff(np.r_[starts, count])
    middle = starts + sizes // 2
    straight = (sizes > 1) & _straight(columns, starts, sizes)
    out = {name: values[middle] for name, values in columns.items()}
    for name in _MEANS:
        _fill(out, name, _mean(columns[name], starts), straight)
    for name in _ANGLES:
        _fill(out, name, _mean_angle(columns[name], starts), straight)
    # Less the first: sums of seconds since 1970 would lose the milliseconds.
    mean_time = np.add.reduceat(seconds - seconds[starts].repeat(sizes), starts) / sizes
    at = (seconds[starts] + mean_time) * 1e9
    out["time"] = np.where(straight, np.round(at).astype("datetime64[ns]"), out["time"])
    _wind_of_components(out, straight)
    audit.drop("averaged", count - starts.size)
    for name in columns:
        columns[name] = out[name].astype(columns[name].dtype)


def _fill(out: Columns, name: str, means: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
    out[name] = np.where(where, means, out[name])


def _mean(values: NDArray[np.floating], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean of each interval, NaN left out."""
    known = np.isfinite(values)
    total = np.add.reduceat(np.where(known, values, 0.0).astype(np.float64), starts)
    number = np.add.reduceat(known.astype(np.int64), starts)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(number > 0, total / number, np.nan))


def _mean_angle(degrees: NDArray[np.floating], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean about the first value of each interval, the short way round, in its own range."""
    sizes = np.diff(np.r_[starts, degrees.size])
    first = degrees[starts].repeat(sizes).astype(np.float64)
    apart = wrap_degrees(degrees - first)
    mean = degrees[starts] + _mean(apart, starts)
    wrapped = mean % 360.0
    west = np.any(degrees < 0.0)
    return np.asarray(np.where(west & (wrapped >= 180.0), wrapped - 360.0, wrapped))


def _straight(
    columns: Columns, starts: NDArray[np.int64], sizes: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether the reported heading stays within a band; reports without one count as straight."""
    heading = columns["reported_heading"].astype(np.float64)
    first = heading[starts].repeat(sizes)
    apart = wrap_degrees(heading - first)
    high = np.maximum.reduceat(np.where(np.isnan(apart), -np.inf, apart), starts)
    low = np.minimum.reduceat(np.where(np.isnan(apart), np.inf, apart), starts)
    return np.asarray(~(high - low > STRAIGHT))


def _wind_of_components(out: Columns, where: NDArray[np.bool_]) -> None:
    """Speed and direction of the averaged components."""
    east, north = out["eastward_wind"], out["northward_wind"]
    if "wind_speed" in out:
        out["wind_speed"] = np.where(where, np.hypot(east, north), out["wind_speed"])
    if "wind_direction" in out:
        direction = direction_in_degrees(east, north)
        out["wind_direction"] = np.where(where, direction, out["wind_direction"])
