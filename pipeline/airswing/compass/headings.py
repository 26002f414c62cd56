"""Headings and heading errors of every report: ground vector, both air vectors, magnetic field.

Assumptions
-----------
Reports in the ragged order (aircraft, then time) with flights numbered over the archive; model
winds relative to true north at the same reports. The unit computed its wind as ground velocity
minus true airspeed along its indicated heading, so that the indicated heading is the argument of
V_A = V_G - V_W,reported: it is derived and needs no heading column.

The ground velocity comes from chords between fixes (`airswing.physics.track`); where the path
turns, from the legs around it (`airswing.physics.turns`); where an aircraft reports true heading
and airspeed that agree with its fixes, from these (`airswing.compass.ground_vector`). In all cases
V_G = V_A + W holds.

Standard errors
---------------
``ground_velocity_error`` is one standard error of each component of V_G: rounding of positions and
times, and variation of the velocity between fixes. ``heading_standard_error`` is that error carried
to the indicated heading, ``heading_error_standard_error`` to psi_err, to first order: V_G enters
both air vectors, so that an error of it nearly cancels. Errors of the model and of the coding of
the wind are not included; the fit estimates that scatter.

Laziness
--------
On dask-backed Datasets nothing is computed: blocks of whole aircraft are derived when they are
asked for, with the same result for any chunks (`airswing.compass.whole_aircraft`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.ground_vector import Evidence, choose_ground_vector
from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import InputError
from airswing.flags import GROUND_VECTOR_SOURCE, REPORTED_HEADING_USE
from airswing.physics import triangle
from airswing.physics.geomagnetism import FieldLattice
from airswing.physics.track import ACCELERATION_DENSITY, GroundTrack, Resolution, ground_track
from airswing.physics.turns import near_turns
from airswing.products.ragged import aircraft_of_report
from airswing.reports.resolution import DIRECTION_STEPS, SPEED_STEPS, lattice_step
from airswing.vocabulary import VARIABLES, describe

Array = NDArray[np.float64]

_NEEDED = (
    "time",
    "latitude",
    "longitude",
    "pressure_altitude",
    "eastward_wind",
    "northward_wind",
    "flight",
    "row_size",
)
DERIVED = (
    "ground_eastward_velocity",
    "ground_northward_velocity",
    "ground_speed",
    "track",
    "ground_velocity_error",
    "turn",
    "longitudinal_acceleration",
    "climb_rate",
    "bank",
    "heading",
    "heading_standard_error",
    "airspeed",
    "magnetic_heading",
    "declination",
    "horizontal_field",
    "dip",
    "heading_error",
    "heading_error_standard_error",
    "airspeed_error",
    "ground_vector_source",
    "reported_heading_use",
)
"""Variables that are added to the reports and the winds."""
LARGEST_ERROR = float(np.pi / np.sqrt(3.0))
"""Radians: standard error of an unknown angle, uniform over the circle."""
_WIND_NAMES = ("reference_eastward_wind", "reference_northward_wind")


def derive_headings(
    reports: xr.Dataset,
    winds: xr.Dataset,
    *,
    acceleration_density: float = ACCELERATION_DENSITY,
    widen: bool = True,
) -> xr.Dataset:
    """Headings, magnetic field and heading errors of reports against model winds.

    Parameters
    ----------
    reports : Dataset
        Canonical reports (dimensions ``report`` and ``aircraft``).
    winds : Dataset
        Collocated model winds (dimensions ``reference`` and ``report``).
    acceleration_density : float
        Variation of the ground velocity between fixes, m2 s-3; see `airswing.physics.track`.
    widen : bool
        Whether ground vectors may reach past the neighbouring fixes.

    Returns
    -------
    Dataset
        Reports and winds with the variables `DERIVED`: ``ground_speed, track,
        ground_eastward_velocity, ground_northward_velocity, ground_velocity_error, turn,
        longitudinal_acceleration, climb_rate, bank, heading, heading_standard_error,
        magnetic_heading, airspeed, declination, horizontal_field, dip, ground_vector_source``
        (report), ``heading_error, heading_error_standard_error, airspeed_error`` (reference,
        report) and ``reported_heading_use`` (aircraft); angles in degrees. Dask-backed where the
        reports or the winds are.

    Raises
    ------
    InputError
        If a variable is missing, or the two Datasets do not hold the same reports.

    References
    ----------
    Jacobs et al. 2010, steps a-c and equation 3.
    """
    _check(reports, winds)
    # Both hold the reports' coordinates, and comparing them would load dask arrays.
    merged = reports.merge(winds, compat="override", combine_attrs="override")
    merged.attrs = {**winds.attrs, **reports.attrs}
    return map_aircraft(_derive, merged, acceleration_density=acceleration_density, widen=widen)


class _Motion(NamedTuple):
    """Motion as the reports alone show it; arrays of shape (report,), m s-1 and radians."""

    ground: Evidence
    path: GroundTrack
    air_east: Array
    air_north: Array


def _derive(ds: xr.Dataset, *, acceleration_density: float, widen: bool) -> xr.Dataset:
    total = int(ds["row_size"].sum())
    if total != ds.sizes["report"]:
        raise InputError(
            "row_size does not add up to the reports",
            field="row_size",
            found=f"{total} for {ds.sizes['report']} reports",
        )
    motion = _motion(ds, acceleration_density, widen)
    derived: dict[str, tuple[tuple[str, ...], NDArray[Any]]] = {
        name: (("report",), values)
        for name, values in (_report_columns(motion) | _field_columns(ds, motion)).items()
    }
    derived["ground_vector_source"] = (("report",), _source(motion))
    codes = [REPORTED_HEADING_USE[str(why)] for why in motion.ground.reason]
    derived["reported_heading_use"] = (("aircraft",), np.array(codes))
    names = ("heading_error", "heading_error_standard_error", "airspeed_error")
    east, north = (ds[name].transpose("reference", "report").to_numpy() for name in _WIND_NAMES)
    for name, values in zip(names, _compare(east, north, motion), strict=True):
        derived[name] = (("reference", "report"), values)
    # of the type they have on disk, so that a stage run from the product gives the same bits
    typed = {
        name: (dims, values.astype(VARIABLES[name].dtype))
        for name, (dims, values) in derived.items()
    }
    return describe(ds.assign(typed))


def _check(reports: xr.Dataset, winds: xr.Dataset) -> None:
    for name in _NEEDED:
        if name not in reports:
            raise InputError("the reports lack a variable", field=name)
    for name in _WIND_NAMES:
        if name not in winds:
            raise InputError("the model winds lack a variable", field=name)
    if winds.sizes.get("report") != reports.sizes["report"]:
        raise InputError(
            "model winds and reports do not hold the same reports",
            field="report",
            found=f"{winds.sizes.get('report')} winds for {reports.sizes['report']} reports",
            remedy="Collocate these reports again",
        )


def _column(ds: xr.Dataset, name: str) -> Array:
    """Values of a variable over the reports; NaN where it is absent."""
    if name not in ds:
        return np.full(ds.sizes["report"], np.nan)
    return np.asarray(ds[name].to_numpy(), dtype=np.float64)


def _seconds(ds: xr.Dataset) -> Array:
    """Times in seconds since 1970; NaN where unknown."""
    time = ds["time"].to_numpy().astype("datetime64[ns]")
    return np.asarray(np.where(np.isnat(time), np.nan, time.astype(np.int64) / 1e9))


def _resolution(ds: xr.Dataset, name: str, aircraft: NDArray[np.int64]) -> Array:
    """Resolution of each report's aircraft; 0 where it is unknown."""
    if name not in ds:
        return np.zeros(aircraft.size)
    return np.nan_to_num(np.asarray(ds[name].to_numpy(), dtype=np.float64))[aircraft]


def _motion(ds: xr.Dataset, acceleration_density: float, widen: bool) -> _Motion:
    aircraft, seconds, flight = aircraft_of_report(ds), _seconds(ds), ds["flight"].to_numpy()
    path = ground_track(
        _column(ds, "latitude"),
        _column(ds, "longitude"),
        seconds,
        _column(ds, "pressure_altitude"),
        flight,
        Resolution(
            _resolution(ds, "position_resolution", aircraft),
            _resolution(ds, "time_resolution", aircraft),
        ),
        acceleration_density=acceleration_density,
        widen=widen,
    )
    wind = _column(ds, "eastward_wind"), _column(ds, "northward_wind")
    chord = path.eastward, path.northward, path.along_error, path.cross_error
    turning = near_turns(
        (path.leg_eastward, path.leg_northward, path.leg_error),
        wind,
        chord,
        seconds,
        flight,
        roll_flag=ds["roll_flag"].to_numpy() if "roll_flag" in ds else None,
    )
    air = triangle.vector_from_bearing(turning.airspeed, turning.heading)
    of_legs = (
        air[0] + wind[0][turning.report],
        air[1] + wind[1][turning.report],
        turning.airspeed_error,
        # an error of the heading is one of the ground vector across it
        turning.airspeed * turning.heading_error,
    )
    chord = chord[0].copy(), chord[1].copy(), chord[2].copy(), chord[3].copy()
    for values, better in zip(chord, of_legs, strict=True):
        values[turning.report] = better
    ground = _chosen(ds, chord, wind, aircraft)
    return _Motion(ground, path, *triangle.air_vector(ground.eastward, ground.northward, *wind))


def _chosen(
    ds: xr.Dataset,
    chord: tuple[Array, Array, Array, Array],
    wind: tuple[Array, Array],
    aircraft: NDArray[np.int64],
) -> Evidence:
    """Ground vector from fixes, or from reported heading and airspeed."""
    number = ds.sizes["aircraft"]
    airspeed, heading = _column(ds, "reported_airspeed"), _column(ds, "reported_heading")
    # some columns hold zero where a value is absent
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
            _resolution(ds, "wind_speed_resolution", aircraft),
        ),
        aircraft,
        number,
        derived=_column(ds, "wind_source") > 0,
    )


def _source(motion: _Motion) -> NDArray[np.int8]:
    """Codes of `GROUND_VECTOR_SOURCE`."""
    ground, path = motion.ground, motion.path
    one_sided = (path.before == 0) | (path.after == 0)
    widened = np.maximum(path.before, path.after) > 1
    code = {name: np.int8(value) for name, value in GROUND_VECTOR_SOURCE.items()}
    return np.select(
        [~np.isfinite(ground.eastward), ground.from_reported, one_sided, widened],
        [code["none"], code["reported"], code["one_sided_chord"], code["widened_chord"]],
        code["chord"],
    )


def _report_columns(motion: _Motion) -> dict[str, Array]:
    ground, path = motion.ground, motion.path
    return {
        "ground_eastward_velocity": ground.eastward,
        "ground_northward_velocity": ground.northward,
        "ground_speed": triangle.speed_of_vector(ground.eastward, ground.northward),
        "track": np.degrees(triangle.bearing(ground.eastward, ground.northward)),
        # of a component: half of the mean square of the vector
        "ground_velocity_error": np.sqrt(0.5 * (ground.along_error**2 + ground.cross_error**2)),
        "turn": np.degrees(path.turn),
        "longitudinal_acceleration": path.longitudinal_acceleration,
        "climb_rate": path.climb_rate,
        "bank": np.degrees(path.bank),
        "heading": np.degrees(triangle.bearing(motion.air_east, motion.air_north)),
        "heading_standard_error": _heading_error(motion),
        "airspeed": triangle.speed_of_vector(motion.air_east, motion.air_north),
    }


def _heading_error(motion: _Motion) -> Array:
    """Standard error of the indicated heading, degrees: that of the ground vector across it."""
    ground = motion.ground
    track = triangle.bearing(ground.eastward, ground.northward)
    along, cross = triangle.along_cross(motion.air_east, motion.air_north, track)
    speed = triangle.speed_of_vector(motion.air_east, motion.air_north)
    # components along and across the track, turned across the heading
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.hypot(cross * ground.along_error, along * ground.cross_error) / speed
        # first order is meaningless beyond the error of an unknown angle
        return np.asarray(np.degrees(np.minimum(across / speed, LARGEST_ERROR)))


def _field_columns(ds: xr.Dataset, motion: _Motion) -> dict[str, Array]:
    place = (
        _column(ds, "latitude"),
        _column(ds, "longitude"),
        np.nan_to_num(_column(ds, "pressure_altitude")),
        _seconds(ds),
    )
    field = FieldLattice.covering(*place).at(*place)
    heading = triangle.bearing(motion.air_east, motion.air_north)
    return {
        "magnetic_heading": np.degrees(triangle.wrap_positive(heading - field.declination)),
        "declination": np.degrees(field.declination),
        "horizontal_field": field.horizontal,
        "dip": np.degrees(field.dip),
    }


def _compare(wind_east: Array, wind_north: Array, motion: _Motion) -> tuple[Array, Array, Array]:
    """Heading error and its standard error (degrees), airspeed error (m s-1), (reference, report).

    The heading of a vector V turns by n.dV/|V|, n its right-hand normal. An error dV of the ground
    velocity enters both air vectors, so that the difference of the two n/|V| is left.
    """
    ground = motion.ground
    air = motion.air_east, motion.air_north
    implied = triangle.air_vector(
        ground.eastward,
        ground.northward,
        wind_east.astype(np.float64),
        wind_north.astype(np.float64),
    )
    error = triangle.heading_error(*air, *implied)
    used, other = air[0] ** 2 + air[1] ** 2, implied[0] ** 2 + implied[1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = air[1] / used - implied[1] / other, implied[0] / other - air[0] / used
    track = triangle.bearing(ground.eastward, ground.northward)
    along, cross = triangle.along_cross(*slope, track)
    standard_error = np.hypot(along * ground.along_error, cross * ground.cross_error)
    speed_error = triangle.airspeed_error(*air, *implied)
    return np.degrees(error), np.degrees(standard_error), speed_error
