"""From the exact state of the flights to what the units report.

Assumptions: the GPS ground velocity is exact; airspeed and heading carry white noise; a lagging
unit works from the state of some seconds ago; reports are coded in whole steps of position,
direction, speed, time and degrees Celsius. Temperature is the standard atmosphere's plus a
gradient with latitude and travelling waves; icing protection is on inside cold moist patches.
Units: SI, degrees for places, hours since the start; coded values in the canonical columns'
units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.physics.atmosphere import pressure_from_altitude, standard_temperature
from airswing.synthetic.aircraft.airborne_fleet import STEP, Flown
from airswing.synthetic.aircraft.faults import Fault, Setting, acts, apply_unit_faults
from airswing.synthetic.aircraft.instrument import coded, compute_wind, sensed_heading
from airswing.synthetic.aircraft.outside_effects import (
    outside_change,
    report_variables,
    scatter_change,
)
from airswing.synthetic.aircraft.parameter_values import listed
from airswing.synthetic.world.earthfield import EarthField
from airswing.synthetic.world.gridded_fields import plane
from airswing.synthetic.world.true_atmosphere import stream
from airswing.synthetic.world.waves import WaveKind, random_waves

__all__ = ["Coding", "Correction", "observe"]

Array = NDArray[np.float64]
# (flight, latitude, longitude, pressure Pa, hours) to the true wind (2, n) in m/s.
Wind = Callable[[NDArray[np.int64], Array, Array, Array, Array], Array]


@dataclass(frozen=True)
class Coding:
    """What a unit can express and how noisy it is."""

    # direction_deg, speed_kt, position_arcmin, time_s: steps
    direction_deg: float = 1.0
    speed_kt: float = 1.0
    position_arcmin: float = 0.1
    time_s: float = 1.0
    # airspeed_noise, heading_noise: white noise of airspeed (m/s) and heading (degrees)
    airspeed_noise: float = 0.7
    heading_noise: float = 0.3


@dataclass(frozen=True)
class Correction:
    """An eight-point table that some units apply from an hour on."""

    # dict of int to ndarray (8,): by aircraft index: degrees of error at 0, 45, ... 315, to be
    # subtracted from the indicated magnetic heading.
    tables: dict[int, Array]
    start: float  # hours since the archive's start


@dataclass(frozen=True)
class Units:
    """The fleet's units."""

    tails: Sequence[str]  # the fleet
    faults: Sequence[Fault]  # of units and reporting; the references' are passed over
    coding: Coding  # steps and noise
    correction: Correction | None = None  # eight-point tables in use


def _state(
    flown: Flown, flight: NDArray[np.int64], step: Array, wind: Wind, field: EarthField
) -> dict[str, Array]:
    """Return the exact state at (fractional) steps: places, air vector, field, accelerations."""
    state = {
        name: flown.at(name, flight, step)
        for name in ("latitude", "longitude", "altitude", "east", "north", "bank")
    }
    hours = flown.departure[flight] + step * STEP / 3600.0
    pressure = pressure_from_altitude(state["altitude"])
    blown = wind(flight, state["latitude"], state["longitude"], pressure, hours)
    air = state["east"] - blown[0], state["north"] - blown[1]
    heading = np.arctan2(*air)
    speeding = flown.acceleration(flight, step)
    declination, horizontal, down = field.at(state["latitude"], state["longitude"], hours)
    state.update(
        hours=hours,
        pressure=pressure,
        u=blown[0],
        v=blown[1],
        heading=heading,
        airspeed=np.hypot(*air),
        acceleration=speeding[0] * np.sin(heading) + speeding[1] * np.cos(heading),
        declination=declination,
        horizontal=horizontal,
        down=down,
    )
    return state


def _weather(state: dict[str, Array], seed: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return true temperature (K) and whether icing protection is on."""
    moist = random_waves(
        stream(seed, "weather"),
        WaveKind(
            count=40, rms=1.0, lengths=(90.0, 250.0), depth=0.6, memory=12.0, drift=(35.0, 0.0)
        ),
        start=-12.0,
        end=float(state["hours"].max()) + 24.0,
    )
    x, y = plane(state["latitude"], state["longitude"])
    zeta = np.log(state["pressure"] / 1e5)
    warm, wet = moist.at_points(x, y, zeta, state["hours"])
    temperature = standard_temperature(state["altitude"]) - 0.006 * y + 2.5 * warm
    celsius = temperature - 273.15
    # supercooled drops: colder cloud is ice and sticks to nothing
    icing = (wet > 0.75) & (celsius < -1.0) & (celsius > -22.0)
    return np.asarray(temperature), icing


def _lag_steps(
    faults: Sequence[Fault], tail: NDArray[np.int64], hours: Array, tails: Sequence[str]
) -> Array:
    """Return how many steps behind its position and time each report's wind is."""
    lag = np.zeros(hours.size)
    for fault in faults:
        if fault.name == "time_lag":
            lag[acts(fault, tail, hours, tails)] += fault.value("offset_s") / STEP
    return lag


def _indicate(
    state: dict[str, Array],
    setting: Setting,
    rng: np.random.Generator,
    coding: Coding,
    correction: Correction | None,
) -> tuple[Array, Array]:
    """Return indicated true heading (radians) and airspeed (m/s)."""
    unit = setting.unit
    noise = rng.normal(size=(2, setting.hours.size))
    sensed = sensed_heading(setting.magnetic, setting.horizontal, setting.down, unit)
    sensed = sensed + np.radians(coding.heading_noise) * noise[0]
    if correction is not None:
        nodes = np.arange(0.0, 360.0, 45.0)
        for tail, table in correction.tables.items():
            where = (setting.tail == tail) & (setting.hours >= correction.start)
            error = np.interp(np.degrees(sensed[where]), nodes, table, period=360.0)
            sensed[where] -= np.radians(error)
    heading = sensed + setting.declination + setting.declination_error
    airspeed = state["airspeed"] * unit.airspeed_factor + unit.airspeed_offset
    return heading, airspeed + coding.airspeed_noise * noise[1]


def _in_steps(
    heading: Array, setting: Setting, faults: Sequence[Fault], tails: Sequence[str]
) -> None:
    """Round indicated headings (radians) of units that take them in coarse steps."""
    for fault in faults:
        if fault.name == "heading_coding":
            own = acts(fault, setting.tail, setting.hours, tails)
            step = np.radians(fault.value("step_deg"))
            north = np.zeros(heading.size)
            if not fault.parameters.get("true_north"):
                north = setting.declination + setting.declination_error
            rounded = np.round((heading - north) / step) * step + north
            heading[own] = rounded[own]


def _gross(
    rng: np.random.Generator, u: Array, v: Array, hit: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return winds with gross errors where ``hit``: reversed, wild or doubled."""
    kind = rng.integers(0, 3, u.size)
    wild = rng.normal(0, 25.0, (2, u.size))
    for value, (reverse, strange) in enumerate(((u, wild[0]), (v, wild[1]))):
        changed = np.select([kind == 0, kind == 1], [-reverse, strange], 2.0 * reverse)
        if value == 0:
            first = np.where(hit, changed, u)
        else:
            v = np.where(hit, changed, v)
    return first, v


def observe(
    flown: Flown,
    flight: NDArray[np.int64],
    step: NDArray[np.int64],
    *,
    wind: Wind,
    seed: int,
    field: EarthField,
    units: Units,
) -> pd.DataFrame:
    """Return what the units report, with the truth in columns of their own.

    Parameters
    ----------
    flight, step : ndarray int (n,)
        Where on them the reports are made.
    wind : callable
        True wind, see `Wind`.

    Returns
    -------
    pandas.DataFrame
        One row a report. Coded: ``latitude, longitude`` degrees, ``altitude`` m, ``hours``,
        ``direction`` degrees, ``speed`` kt, ``celsius``. Exact: ``true_*``, ``ground_u/v``,
        ``heading, airspeed`` as indicated, ``bank``, ``acceleration``, ``declination``,
        ``horizontal``, ``dip`` (radians, SI); ``computed_u/v``, the wind the unit computed before
        whatever became of it. ``made`` numbers the reports, with and without effects alike.
    """
    tail, tails, faults = flown.aircraft[flight], units.tails, units.faults
    here = _state(flown, flight, step.astype(float), wind, field)
    lag = _lag_steps(faults, tail, here["hours"], tails)
    late = lag != 0
    used = here
    if late.any():
        past = _state(flown, flight[late], np.maximum(step - lag, 0.0)[late], wind, field)
        used = {name: values.copy() for name, values in here.items()}
        for name, values in past.items():
            used[name][late] = values
    temperature, icing = _weather(here, seed)
    setting = Setting(
        tail=tail,
        temperature=temperature,
        icing=icing,
        phase=flown.phase[step, flight].astype(np.int64),
        box=(
            float(here["latitude"].min()),
            float(here["latitude"].max()),
            float(here["longitude"].min()),
            float(here["longitude"].max()),
        ),
        magnetic=used["heading"] - used["declination"],
        **{name: used[name] for name in _SET_BY},
    )
    apply_unit_faults(setting, faults, tails)
    rng = stream(seed, "instrument noise")
    heading, airspeed = _indicate(used, setting, rng, units.coding, units.correction)
    _in_steps(heading, setting, faults, tails)
    u, v = compute_wind(used["east"], used["north"], airspeed, heading)
    exact = {"aircraft": tail, "flight": flight, "phase": flown.phase[step, flight]}
    exact |= {"icing": icing.astype(np.int8), "heading": heading, "airspeed": airspeed}
    exact |= {name: here[own] for name, own in TRUTH.items()}
    exact |= {"dip": np.arctan2(here["down"], here["horizontal"]), "temperature": temperature}
    return _report(pd.DataFrame(exact), here, u, v, faults, tails, units.coding, seed)


# What of the state a unit's faults depend on.
_SET_BY = (
    "hours",
    "latitude",
    "longitude",
    "altitude",
    "declination",
    "horizontal",
    "down",
    "acceleration",
    "bank",
)
# Columns of the exact state, and their names in it.
TRUTH = {
    "true_u": "u",
    "true_v": "v",
    "true_heading": "heading",
    "true_airspeed": "airspeed",
    "true_latitude": "latitude",
    "true_longitude": "longitude",
    "true_altitude": "altitude",
    "ground_u": "east",
    "ground_v": "north",
    "bank": "bank",
    "acceleration": "acceleration",
    "declination": "declination",
    "horizontal": "horizontal",
}


def _outside(
    frame: pd.DataFrame,
    u: Array,
    v: Array,
    hours: Array,
    faults: Sequence[Fault],
    tails: Sequence[str],
    seed: int,
) -> tuple[Array, Array]:
    """Return the computed wind with the effects that are in no catalogue."""
    frame["computed_u"], frame["computed_v"] = u, v
    outside = [fault for fault in faults if fault.name == "outside"]
    if not outside:
        return u, v
    variables = report_variables(frame, u, v, hours)
    whose = frame["aircraft"].to_numpy()
    for number, fault in enumerate(outside):
        chosen = acts(fault, whose, hours, tails)
        if "kind" in fault.parameters:
            rng = stream(seed, f"outside {number}")
            change = scatter_change(fault.parameters, u, v, variables, chosen, rng)
        else:
            change = outside_change(fault.parameters, u, v, variables, chosen)
        u, v = u + change[:, 0], v + change[:, 1]
    return u, v


def _report(
    frame: pd.DataFrame,
    here: dict[str, Array],
    u: Array,
    v: Array,
    faults: Sequence[Fault],
    tails: Sequence[str],
    coding: Coding,
    seed: int,
) -> pd.DataFrame:
    """Add the coded columns (what stands in the message) and the number a report was made with."""
    frame["made"] = np.arange(len(frame))
    tail, hours = frame["aircraft"].to_numpy(), here["hours"]
    count = hours.size
    u, v = _outside(frame, u, v, hours, faults, tails, seed)
    steps = {
        "direction": np.full(count, coding.direction_deg),
        "speed": np.full(count, coding.speed_kt),
        "position": np.full(count, coding.position_arcmin / 60.0),
        "time": np.full(count, coding.time_s),
    }
    altitude = here["altitude"].copy()
    named = tail.copy()
    for fault in faults:
        where = acts(fault, tail, hours, tails)
        if fault.name == "altitude_offset":
            altitude[where] += fault.value("offset_ft") * 0.3048
        elif fault.name == "wind_coding":
            steps["direction"][where] = (
                fault.value("direction_step_deg", 10.0) or coding.direction_deg
            )
            steps["speed"][where] = fault.value("step", 5.0)
        elif fault.name == "position_coding":
            steps["position"][where] = fault.value("step", 1.0) / 60.0
        elif fault.name == "time_lag" and fault.parameters.get("to_minute"):
            steps["time"][where] = 60.0
        elif fault.name == "outliers":
            # named by its content, so that other effects beside it leave it as it is
            rng = stream(seed, f"outliers {fault.tails} {fault.value('fraction')}")
            hit = where & (rng.uniform(size=count) < fault.value("fraction"))
            u, v = _gross(rng, u, v, hit)
        elif fault.name == "tail_swap":
            pair = fault.tails or listed(fault.parameters["pair"])
            first, second = (list(tails).index(str(name)) for name in pair)
            inside = (hours >= fault.period[0]) & (hours < fault.period[1])
            swap = {first: second, second: first}
            for old, new in swap.items():
                named[inside & (tail == old)] = new
    direction, speed = coded(u, v, direction_step=steps["direction"], speed_step=steps["speed"])
    radians = np.radians(direction)
    metres = speed * 1852.0 / 3600.0
    seconds = np.floor(hours * 3600.0 / steps["time"] + 1e-6) * steps["time"]  # cut, not rounded
    frame["tail"] = np.array(tails)[named]
    frame["hours"] = seconds / 3600.0
    frame["latitude"] = np.round(here["latitude"] / steps["position"]) * steps["position"]
    frame["longitude"] = np.round(here["longitude"] / steps["position"]) * steps["position"]
    frame["altitude"] = np.round(altitude / 3.048) * 3.048  # tens of feet
    frame["direction"], frame["speed"] = direction, speed
    frame["u"], frame["v"] = -metres * np.sin(radians), -metres * np.cos(radians)
    rng = stream(seed, "temperature noise")
    frame["celsius"] = np.round(frame["temperature"] - 273.15 + rng.normal(0, 0.5, count))
    frame["temperature_qc"] = np.where(rng.uniform(size=count) < 0.004, "fail", "pass")
    # AMDAR's limit of a good roll angle
    frame["roll_flag"] = np.where(np.abs(frame["bank"]) > np.radians(5.0), "B", "G")
    return frame
