"""Headings and heading errors of every report: ground vector, both air vectors, magnetic field.

Reports in the ragged order (aircraft, then time) with flights numbered over the archive; model
winds relative to true north at the same reports. The unit computed its wind as ground velocity
minus true airspeed along its indicated heading, so that the indicated heading is the argument of
V_A = V_G - V_W,reported: it is derived and needs no heading column.

The ground velocity comes from chords between fixes (`airswing.physics.track`); where the path
turns, from the legs around it (`airswing.physics.turns`); where an aircraft reports true heading
and airspeed, from these: V_G = V_A + V_W has no error of rounded positions and times. A column
named heading may hold the track or the magnetic heading (which differs by the declination, a part
of coefficient A); it is therefore compared with the chords, aircraft by aircraft
(:func:`_judge_reported_heading`).

Standard errors are those of rounded positions and times and of the velocity between fixes:
``ground_velocity_error`` of each component of V_G, ``heading_standard_error`` carried to the
indicated heading, ``heading_error_standard_error`` to psi_err, to first order: V_G enters both air
vectors, so that an error of it nearly cancels. Errors of the model and of the coding of the wind
are not included; the fit estimates that scatter.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import InputError
from airswing.flags import GROUND_VECTOR_SOURCE, REPORTED_HEADING_USE
from airswing.physics import triangle
from airswing.physics.geomagnetism import geomagnetic_field
from airswing.physics.track import ACCELERATION_DENSITY, ground_track
from airswing.physics.turns import near_turns
from airswing.products.ragged import aircraft_of_report
from airswing.reports.flights import DIRECTION_STEPS, SPEED_STEPS, lattice_step
from airswing.vocabulary import VARIABLES, describe

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_POSITION = ("latitude", "longitude", "pressure_altitude")
_WINDS = ("eastward_wind", "northward_wind")
_NEEDED = ("time", *_POSITION, *_WINDS, "flight", "row_size")
_WIND_NAMES = ("reference_eastward_wind", "reference_northward_wind")
LARGEST_ERROR = float(np.pi / np.sqrt(3.0))
"""Radians: standard error of an unknown angle, uniform over the circle."""
FEWEST = 20  # reports below which an aircraft's columns are not tested
# Radians, in the median absolute value, in addition to the effect of rounding.
MAX_HEADING_DIFFERENCE = float(np.radians(1.5))
# Radians: half a degree is the effect of cutting instead of rounding to whole degrees.
MAX_HEADING_BIAS = float(np.radians(0.6))
# m/s, each in addition to the effect of the errors of both.
MAX_AIRSPEED_DIFFERENCE, MAX_VECTOR_DIFFERENCE = 3.0, 15.0
MEDIAN_OF_NORMAL = 0.6745  # median absolute value of a normal variable of unit variance


class GroundVector(NamedTuple):
    """Ground velocity of each report and its standard errors, arrays of shape (report,), m s-1."""

    eastward: Array
    northward: Array
    along_error: Array  # along and across the velocity itself
    cross_error: Array


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
        Reports and winds with ``ground_speed, track, ground_eastward_velocity,
        ground_northward_velocity, ground_velocity_error, turn, longitudinal_acceleration,
        climb_rate, bank, heading, heading_standard_error, magnetic_heading, airspeed, declination,
        horizontal_field, dip, ground_vector_source`` (report), ``heading_error,
        heading_error_standard_error, airspeed_error`` (reference, report) and
        ``reported_heading_use`` (aircraft); angles in degrees. Dask-backed where the reports or
        the winds are.

    Raises
    ------
    InputError
        If a variable is missing, or the two Datasets do not hold the same reports.

    References
    ----------
    Jacobs et al. 2010, steps a-c and equation 3.

    Examples
    --------
    >>> ruc = airswing.build_catalogue("data_samples/ruc/*.grb", name="ruc")
    >>> headings = airswing.derive_headings(reports, airswing.collocate(reports, {"ruc": ruc}))
    >>> headings["heading_error"].attrs["units"]
    'degree'
    """
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
    # Both hold the reports' coordinates, and comparing them would load dask arrays.
    merged = reports.merge(winds, compat="override", combine_attrs="override")
    merged.attrs = {**winds.attrs, **reports.attrs}
    return map_aircraft(_derive, merged, acceleration_density=acceleration_density, widen=widen)


def _derive(ds: xr.Dataset, *, acceleration_density: float, widen: bool) -> xr.Dataset:
    """Add the derived variables to the reports of some aircraft, in memory."""
    total = int(ds["row_size"].sum())
    if total != ds.sizes["report"]:
        seen = f"{total} for {ds.sizes['report']} reports"
        raise InputError("row_size does not add up to the reports", field="row_size", found=seen)
    aircraft, flight = aircraft_of_report(ds), ds["flight"].to_numpy()
    latitude, longitude, altitude, u, v = (_column(ds, name) for name in (*_POSITION, *_WINDS))
    time = ds["time"].to_numpy().astype("datetime64[ns]")
    seconds = np.where(np.isnat(time), np.nan, time.astype(np.int64) / 1e9)
    path = ground_track(
        latitude,
        longitude,
        seconds,
        altitude,
        flight,
        position_step=_resolution(ds, "position_resolution", aircraft),
        time_step=_resolution(ds, "time_resolution", aircraft),
        acceleration_density=acceleration_density,
        widen=widen,
    )
    chord = GroundVector(
        path.eastward.copy(), path.northward.copy(), path.along_error, path.cross_error.copy()
    )
    # near turns from the legs around them
    legs = path.leg_eastward, path.leg_northward, path.leg_error
    roll_flag = ds["roll_flag"].to_numpy() if "roll_flag" in ds else None
    turning = near_turns(legs, (u, v), chord, seconds, flight, roll_flag=roll_flag)
    rows = turning.report
    east, north = triangle.vector_from_bearing(turning.airspeed, turning.heading)
    chord.eastward[rows], chord.northward[rows] = east + u[rows], north + v[rows]
    chord.along_error[rows] = turning.airspeed_error
    # an error of the heading is one of the ground vector across it
    chord.cross_error[rows] = turning.airspeed * turning.heading_error
    ground, from_reported, use = _choose_ground_vector(ds, chord, (u, v), aircraft)
    sources = {
        "none": ~np.isfinite(ground.eastward),
        "reported": from_reported,
        "one_sided_chord": (path.before == 0) | (path.after == 0),
        "widened_chord": np.maximum(path.before, path.after) > 1,
    }
    air = triangle.air_vector(ground.eastward, ground.northward, u, v)
    heading = triangle.bearing(*air)
    field = geomagnetic_field(latitude, longitude, np.nan_to_num(altitude), seconds)
    reference = (
        ds[name].transpose("reference", "report").to_numpy().astype(np.float64)
        for name in _WIND_NAMES
    )
    implied = triangle.air_vector(ground.eastward, ground.northward, *reference)
    heading_error, difference_error = _heading_errors(ground, air, implied)
    derived: dict[str, NDArray[Any]] = {
        "ground_eastward_velocity": ground.eastward,
        "ground_northward_velocity": ground.northward,
        "ground_speed": np.hypot(ground.eastward, ground.northward),
        "track": np.degrees(triangle.bearing(ground.eastward, ground.northward)),
        # of a component: half of the mean square of the vector
        "ground_velocity_error": np.sqrt(0.5 * (ground.along_error**2 + ground.cross_error**2)),
        "turn": np.degrees(path.turn),
        "longitudinal_acceleration": path.longitudinal_acceleration,
        "climb_rate": path.climb_rate,
        "bank": np.degrees(path.bank),
        "heading": np.degrees(heading),
        "heading_standard_error": np.degrees(heading_error),
        "airspeed": np.hypot(*air),
        "magnetic_heading": np.degrees(triangle.wrap_positive(heading - field.declination)),
        "declination": np.degrees(field.declination),
        "horizontal_field": field.horizontal,
        "dip": np.degrees(field.dip),
        "ground_vector_source": np.select(
            list(sources.values()),
            [GROUND_VECTOR_SOURCE[name] for name in sources],
            GROUND_VECTOR_SOURCE["chord"],
        ),
        "reported_heading_use": use,
        "heading_error": np.degrees(triangle.heading_error(*air, *implied)),
        "heading_error_standard_error": np.degrees(difference_error),
        "airspeed_error": triangle.airspeed_error(*air, *implied),
    }
    dims = "reference", "report"
    # in the type of the product, so that results from memory and from a file are identical
    return describe(
        ds.assign(
            {
                name: (
                    ("aircraft",) if name == "reported_heading_use" else dims[-values.ndim :],
                    values.astype(VARIABLES[name].dtype),
                )
                for name, values in derived.items()
            }
        )
    )


def _column(ds: xr.Dataset, name: str, dim: str = "report") -> Array:
    """Values of a variable over the reports, or over another dimension; NaN where it is absent."""
    if name not in ds:
        return np.full(ds.sizes[dim], np.nan)
    return np.asarray(ds[name].to_numpy(), dtype=np.float64)


def _resolution(ds: xr.Dataset, name: str, aircraft: Index) -> Array:
    return np.nan_to_num(_column(ds, name, "aircraft"))[aircraft]


def _choose_ground_vector(
    ds: xr.Dataset, chord: GroundVector, wind: tuple[Array, Array], aircraft: Index
) -> tuple[GroundVector, NDArray[np.bool_], NDArray[np.int8]]:
    """Use reported heading and airspeed where they agree with the chords.

    Returns the ground vector, whether it is the reported one (report,), and the use of each
    aircraft's reports, codes of `REPORTED_HEADING_USE`.
    """
    number = ds.sizes["aircraft"]
    airspeed, degrees = _column(ds, "reported_airspeed"), _column(ds, "reported_heading")
    # some columns hold zero where a value is absent
    airspeed, heading = np.where(airspeed > 0.0, airspeed, np.nan), np.radians(degrees)
    air = triangle.vector_from_bearing(airspeed, heading)
    vector = air[0] + wind[0], air[1] + wind[1]
    available = np.isfinite(vector[0] + vector[1])
    use = _judge_reported_heading(chord, wind, air, available, aircraft, number)
    # Rounding of airspeed, heading and wind, along and across the ground vector: uniform over a
    # step, whose variance is a twelfth of its square.
    speed_step, degree_step = (
        np.nan_to_num(lattice_step(values, aircraft, number, steps))[aircraft]
        for values, steps in ((airspeed, SPEED_STEPS), (degrees, DIRECTION_STEPS))
    )
    along_air = speed_step / np.sqrt(12.0)
    cross_air = np.radians(degree_step) / np.sqrt(12.0) * airspeed
    wind_variance = _resolution(ds, "wind_speed_resolution", aircraft) ** 2 / 12.0
    ahead = triangle.vector_from_bearing(1.0, heading)
    cosine, sine = triangle.along_cross(*ahead, triangle.bearing(*vector))
    along = np.sqrt((along_air * cosine) ** 2 + (cross_air * sine) ** 2 + wind_variance)
    cross = np.sqrt((along_air * sine) ** 2 + (cross_air * cosine) ** 2 + wind_variance)
    # a larger difference is a gross error of one of the two
    difference = np.hypot(vector[0] - chord.eastward, vector[1] - chord.northward)
    explained = np.hypot(chord.along_error, chord.cross_error) + np.hypot(along, cross)
    agrees = ~(difference > MAX_VECTOR_DIFFERENCE + 5.0 * explained)
    # a wind derived from heading, airspeed and ground vector is consistent with that vector only
    derived = _column(ds, "wind_source") > 0
    selected = available & (derived | ((use == REPORTED_HEADING_USE["used"])[aircraft] & agrees))
    pairs = zip((*vector, along, cross), chord, strict=True)
    ground = GroundVector(*(np.where(selected, value, from_fixes) for value, from_fixes in pairs))
    return ground, selected, use


def _judge_reported_heading(
    chord: GroundVector,
    wind: tuple[Array, Array],
    air: tuple[Array, Array],
    available: NDArray[np.bool_],
    aircraft: Index,
    number: int,
) -> NDArray[np.int8]:
    """Code of `REPORTED_HEADING_USE` of each aircraft."""
    present = np.bincount(aircraft, weights=available, minlength=number)
    implied = chord.eastward - wind[0], chord.northward - wind[1]
    turned = triangle.angle_of_vector(*implied, *air)
    off_track = np.abs(triangle.angle_of_vector(chord.eastward, chord.northward, *air))
    speed = np.hypot(*implied)
    comparable = np.isfinite(turned)

    def median(values: Array) -> Array:
        medians = pd.Series(np.where(comparable, values, np.nan)).groupby(aircraft).median()
        return np.asarray(medians.reindex(range(number)), dtype=np.float64)

    # two standard errors of rounding, as a median of absolute values
    noise = MEDIAN_OF_NORMAL * 2.0
    with np.errstate(divide="ignore", invalid="ignore"):
        angle_noise = median(chord.cross_error / speed)
    angle_allowed = MAX_HEADING_DIFFERENCE + noise * angle_noise
    speed_allowed = MAX_AIRSPEED_DIFFERENCE + noise * median(chord.along_error)
    heading_difference, track_difference = median(np.abs(turned)), median(off_track)
    judged = np.bincount(aircraft, weights=comparable, minlength=number)
    # a median's standard error is 1.25 sigma / sqrt(n); a few of them for correlated noise
    bias_allowed = MAX_HEADING_BIAS + 5.0 * angle_noise / np.sqrt(np.maximum(judged, 1.0))
    # negated, so that NaN counts as biased; the following tests too
    biased = ~(np.abs(median(turned)) <= bias_allowed)
    fast = ~(median(np.abs(np.hypot(*air) - speed)) <= speed_allowed)
    nearer_track = track_difference < heading_difference
    reasons = {
        "absent": present == 0,
        "too_few": judged < FEWEST,
        "heading_is_track": nearer_track & (track_difference < 0.5 * MAX_HEADING_DIFFERENCE),
        "heading_differs": ~(heading_difference <= angle_allowed) | nearer_track | biased,
        "airspeed_differs": fast,
    }
    codes = [REPORTED_HEADING_USE[name] for name in reasons]
    use = np.select(list(reasons.values()), codes, REPORTED_HEADING_USE["used"])
    return np.asarray(use, dtype=np.int8)


def _heading_errors(
    ground: GroundVector, air: tuple[Array, Array], implied: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Standard errors of the indicated heading and of the heading error, radians.

    The heading of a vector V turns by n.dV/|V|, n its right-hand normal. An error dV of the ground
    velocity enters both air vectors, so that only the difference of the two n/|V| matters.
    """
    track, errors = triangle.bearing(ground.eastward, ground.northward), []
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_air, slope_implied = (np.stack([v, -u]) / (u**2 + v**2) for u, v in (air, implied))
    for slope in (slope_air, slope_air[:, np.newaxis] - slope_implied):
        along, cross = triangle.along_cross(slope[0], slope[1], track)
        errors.append(np.hypot(along * ground.along_error, cross * ground.cross_error))
    # first order is meaningless beyond the error of an unknown angle
    return np.minimum(errors[0], LARGEST_ERROR), errors[1]
