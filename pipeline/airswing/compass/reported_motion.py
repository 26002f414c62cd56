"""What the reports alone say of an aircraft's motion: ground vector, path and air vector.

Assumes reports in the ragged order (aircraft, then time) with flights numbered over the archive.
Chords between fixes give the ground velocity; where the path turns they are those of the legs
around it (`airswing.physics.turns`); where an aircraft reports heading and airspeed that agree with
its fixes these are believed before the chords (`airswing.compass.ground_vector`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.ground_vector import Evidence, choose_ground_vector
from airswing.physics import triangle
from airswing.physics.track import GroundTrack, Resolution, ground_track
from airswing.physics.turns import beside_turns
from airswing.products.ragged import aircraft_of_report
from airswing.reports.resolution import DIRECTION_STEPS, SPEED_STEPS, lattice_step

Array = NDArray[np.float64]


Account = dict[str, int | dict[str, str]]
"""Which ground vectors were believed: counts, and reasons by aircraft, ready for JSON."""


class Motion(NamedTuple):
    """What the reports alone say; arrays of shape (report,), m s-1 and radians."""

    ground: Evidence
    path: GroundTrack
    air_east: Array
    air_north: Array


def column_of(ds: xr.Dataset, name: str) -> Array:
    """Values of a variable over the reports; NaN where there is none."""
    if name not in ds:
        return np.full(ds.sizes["report"], np.nan)
    return np.asarray(ds[name].to_numpy(), dtype=np.float64)


def seconds_of(reports: xr.Dataset) -> Array:
    """Times in seconds since 1970; NaN where unknown."""
    time = reports["time"].to_numpy().astype("datetime64[ns]")
    seconds = time.astype(np.int64) / 1e9
    return np.asarray(np.where(np.isnat(time), np.nan, seconds))


def _per_report(reports: xr.Dataset, name: str, aircraft: NDArray[np.int64]) -> Array:
    """Resolution of each report's aircraft; 0 where it is not known."""
    if name not in reports:
        return np.zeros(aircraft.size)
    return np.nan_to_num(np.asarray(reports[name].to_numpy(), dtype=np.float64))[aircraft]


def motion_of(reports: xr.Dataset, *, acceleration_density: float, widen: bool) -> Motion:
    """Motion of reports in memory; options as for `airswing.physics.track.ground_track`."""
    aircraft = aircraft_of_report(reports)
    path = ground_track(
        column_of(reports, "latitude"),
        column_of(reports, "longitude"),
        seconds_of(reports),
        column_of(reports, "pressure_altitude"),
        reports["flight"].to_numpy(),
        Resolution(
            _per_report(reports, "position_resolution", aircraft),
            _per_report(reports, "time_resolution", aircraft),
        ),
        acceleration_density=acceleration_density,
        widen=widen,
    )
    wind = column_of(reports, "eastward_wind"), column_of(reports, "northward_wind")
    ground = _believed(reports, _beside_turns(reports, path, wind), wind, aircraft)
    air_east, air_north = triangle.air_vector(ground.eastward, ground.northward, *wind)
    return Motion(ground, path, air_east, air_north)


def _beside_turns(
    reports: xr.Dataset, path: GroundTrack, wind: tuple[Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """Ground velocity and its errors along and across, of the legs around where the path turns."""
    chord = path.eastward, path.northward, path.along_error, path.cross_error
    found = beside_turns(
        (path.leg_eastward, path.leg_northward, path.leg_error),
        wind,
        chord,
        seconds_of(reports),
        reports["flight"].to_numpy(),
        roll_flag=reports["roll_flag"].to_numpy() if "roll_flag" in reports else None,
    )
    air = triangle.vector_from_bearing(found.airspeed, found.heading)
    new = (
        air[0] + wind[0][found.report],
        air[1] + wind[1][found.report],
        found.airspeed_error,
        # An error of the heading is one of the ground vector across it.
        found.airspeed * found.heading_error,
    )
    out = tuple(values.copy() for values in chord)
    for values, better in zip(out, new, strict=True):
        values[found.report] = better
    return out[0], out[1], out[2], out[3]


def _believed(
    reports: xr.Dataset,
    chord: tuple[Array, Array, Array, Array],
    wind: tuple[Array, Array],
    aircraft: NDArray[np.int64],
) -> Evidence:
    number = reports.sizes["aircraft"]
    airspeed, heading = (
        column_of(reports, "reported_airspeed"),
        column_of(reports, "reported_heading"),
    )
    # Zero is how some columns say that they have none.
    airspeed = np.where(airspeed > 0.0, airspeed, np.nan)
    speed_step, heading_step = (
        np.nan_to_num(lattice_step(values, aircraft, number, steps))[aircraft]
        for values, steps in ((airspeed, SPEED_STEPS), (heading, DIRECTION_STEPS))
    )
    return choose_ground_vector(
        chord,
        wind,
        (airspeed, np.radians(heading)),
        (
            speed_step,
            np.radians(heading_step),
            _per_report(reports, "wind_speed_resolution", aircraft),
        ),
        aircraft,
        number,
        derived=column_of(reports, "wind_source") > 0,
    )


def accounts_of(reports: xr.Dataset, motion: Motion) -> list[Account]:
    """Which ground vector was believed, and how the chords reached, aircraft by aircraft."""
    ground, path = motion.ground, motion.path
    known = np.isfinite(ground.eastward)
    chord = known & ~ground.own
    marked = {
        "reported_heading_and_airspeed": ground.own,
        "chords": chord,
        "none": ~known,
        "one_sided": chord & ((path.before == 0) | (path.after == 0)),
        "widened": chord & (np.maximum(path.before, path.after) > 1),
    }
    aircraft, number = aircraft_of_report(reports), reports.sizes["aircraft"]
    counts = {
        name: np.bincount(aircraft[values], minlength=number) for name, values in marked.items()
    }
    tails = [str(name) for name in reports["aircraft"].to_numpy()]
    return [
        {
            **{name: int(values[row]) for name, values in counts.items()},
            "aircraft_with_own_vector": int(why == "own"),
            "aircraft_whose_own_vector_was_not_believed": (
                {} if why in ("own", "absent") else {tail: str(why)}
            ),
        }
        for row, (tail, why) in enumerate(zip(tails, ground.reason, strict=True))
    ]


def sum_of_accounts(accounts: Sequence[Account]) -> Account:
    """Account of a fleet from those of its parts, in order."""
    total: Account = {}
    for account in accounts:
        for name, value in account.items():
            known = total.get(name)
            if isinstance(value, dict):
                total[name] = (known if isinstance(known, dict) else {}) | value
            else:
                total[name] = (known if isinstance(known, int) else 0) + value
    return total
