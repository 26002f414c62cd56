"""From the exact state of the flights to the reports of the units.

The GPS ground velocity is exact; airspeed and heading have white noise; reports are coded in whole
steps. Temperature is the standard atmosphere's plus a gradient with latitude and travelling waves;
icing protection is on inside cold moist patches. Units: SI, degrees for places, hours since the
start; coded values in the canonical columns' units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.physics.atmosphere import pressure_from_altitude, standard_temperature
from airswing.synthetic.atmosphere import Array, WaveKind, random_waves, stream
from airswing.synthetic.fields import plane
from airswing.synthetic.flights import STEP, Flown
from airswing.synthetic.instrument import (
    EarthField,
    Fault,
    Mask,
    Setting,
    acts,
    apply_unit_faults,
    coded,
    compute_wind,
    sensed_heading,
)
from airswing.synthetic.outside_effects import effect_change, report_variables

Flights = NDArray[np.int64]
Wind = Callable[[Flights, Array, Array, Array, Array], Array]
"""(flight, latitude, longitude, pressure Pa, hours) to the true wind (2, n), m/s."""


@dataclass(frozen=True)
class Coding:
    """Steps of the coded values, and the noise of a unit."""

    direction_deg: float = 1.0
    speed_kt: float = 1.0
    position_arcmin: float = 0.1
    time_s: float = 1.0
    airspeed_noise: float = 0.7  # white, m/s
    heading_noise: float = 0.3  # white, degrees


@dataclass(frozen=True)
class Correction:
    """Eight-point tables that some units apply from an hour on."""

    # By index of the aircraft: degrees of error at 0, 45, ... 315, to be subtracted from the
    # indicated magnetic heading.
    tables: dict[int, Array]
    start: float  # hours since the start of the archive


@dataclass(frozen=True)
class Units:
    """The fleet's units."""

    tails: Sequence[str]
    faults: Sequence[Fault]  # those of the models are ignored
    coding: Coding
    correction: Correction | None = None


_EXACT = ("u", "v", "heading", "airspeed", "latitude", "longitude", "altitude")
TRUTH = {f"true_{name}": name for name in _EXACT} | {"ground_u": "east", "ground_v": "north"}
TRUTH |= {name: name for name in ("bank", "acceleration", "declination", "horizontal")}
"""Columns of the exact state."""


def observe(
    flown: Flown,
    flight: Flights,
    step: NDArray[np.int64],
    *,
    wind: Wind,
    seed: int,
    field: EarthField,
    units: Units,
) -> pd.DataFrame:
    """Reports of the units at steps (n,) of flights (n,), with the truth in further columns.

    Coded: ``latitude, longitude`` degrees, ``altitude`` m, ``hours``, ``direction`` degrees,
    ``speed`` kt, ``celsius``. Exact: `TRUTH`, ``dip`` (radians), ``heading, airspeed`` as
    indicated; ``computed_u/v``, the wind the unit computed before outside effects and coding.
    ``made`` numbers the reports identically with and without effects.
    """
    tail, tails, faults = flown.aircraft[flight], units.tails, units.faults
    state = _state(flown, flight, step.astype(float), wind, field)
    lag = np.zeros(step.size)  # delay of each wind after its position and time, steps
    for fault in faults:
        if fault.name == "time_lag":
            lag[acts(fault, tail, state["hours"], tails)] += fault.value("offset_s") / STEP
    late = lag != 0
    used = state
    if late.any():
        past = _state(flown, flight[late], np.maximum(step - lag, 0.0)[late], wind, field)
        used = {name: values.copy() for name, values in state.items()}
        for name, values in past.items():
            used[name][late] = values
    temperature, icing = _weather(state, seed)
    latitude, longitude = state["latitude"], state["longitude"]
    box = (latitude.min(), latitude.max(), longitude.min(), longitude.max())
    setting = Setting(
        tail=tail,
        temperature=temperature,
        icing=icing,
        phase=flown.phase[step, flight].astype(np.int64),
        box=tuple(map(float, box)),  # type: ignore[arg-type]
        magnetic=used["heading"] - used["declination"],
        **{f.name: used[f.name] for f in fields(Setting) if f.name in used},
    )
    apply_unit_faults(setting, faults, tails)
    heading, airspeed = _indicated(used, setting, seed, units)
    u, v = compute_wind(used["east"], used["north"], airspeed, heading)
    exact = {"aircraft": tail, "flight": flight, "phase": flown.phase[step, flight]}
    exact |= {"icing": icing.astype(np.int8), "heading": heading, "airspeed": airspeed}
    exact |= {name: state[column] for name, column in TRUTH.items()}
    exact |= {"dip": np.arctan2(state["down"], state["horizontal"]), "temperature": temperature}
    return _reported(pd.DataFrame(exact), state, u, v, units, seed)


def _state(
    flown: Flown, flight: Flights, step: Array, wind: Wind, field: EarthField
) -> dict[str, Array]:
    """Exact state at (fractional) steps: places, air vector, field, accelerations."""
    names = ("latitude", "longitude", "altitude", "east", "north", "bank")
    state = {name: flown.at(name, flight, step) for name in names}
    hours = flown.departure[flight] + step * STEP / 3600.0
    pressure = pressure_from_altitude(state["altitude"])
    blown = wind(flight, state["latitude"], state["longitude"], pressure, hours)
    air = state["east"] - blown[0], state["north"] - blown[1]
    heading = np.arctan2(*air)
    speeding = flown.acceleration(flight, step)
    declination, horizontal, down = field.at(state["latitude"], state["longitude"], hours)
    return state | {
        "hours": hours,
        "pressure": pressure,
        "u": blown[0],
        "v": blown[1],
        "heading": heading,
        "airspeed": np.hypot(*air),
        "acceleration": speeding[0] * np.sin(heading) + speeding[1] * np.cos(heading),
        "declination": declination,
        "horizontal": horizontal,
        "down": down,
    }


def _weather(state: dict[str, Array], seed: int) -> tuple[Array, Mask]:
    """True temperature (K) and whether icing protection is on."""
    moist = random_waves(
        stream(seed, "weather"),
        WaveKind(40, 1.0, (90.0, 250.0), 0.6, 12.0, (35.0, 0.0)),
        start=-12.0,
        end=float(state["hours"].max()) + 24.0,
    )
    x, y = plane(state["latitude"], state["longitude"])
    warm, wet = moist.at_points(x, y, np.log(state["pressure"] / 1e5), state["hours"])
    temperature = standard_temperature(state["altitude"]) - 0.006 * y + 2.5 * warm
    celsius = temperature - 273.15
    # Supercooled drops: colder cloud is ice, which does not stick.
    icing = (wet > 0.75) & (celsius < -1.0) & (celsius > -22.0)
    return np.asarray(temperature), icing


def _indicated(
    state: dict[str, Array], setting: Setting, seed: int, units: Units
) -> tuple[Array, Array]:
    """Indicated true heading (radians) and airspeed (m/s)."""
    unit, coding = setting.unit, units.coding
    noise = stream(seed, "instrument noise").normal(size=(2, setting.hours.size))
    sensed = sensed_heading(setting.magnetic, setting.horizontal, setting.down, unit)
    sensed = sensed + np.radians(coding.heading_noise) * noise[0]
    if units.correction is not None:
        nodes = np.arange(0.0, 360.0, 45.0)
        for tail, table in units.correction.tables.items():
            where = (setting.tail == tail) & (setting.hours >= units.correction.start)
            error = np.interp(np.degrees(sensed[where]), nodes, table, period=360.0)
            sensed[where] -= np.radians(error)
    heading = sensed + setting.declination + setting.declination_error
    airspeed = state["airspeed"] * unit.airspeed_factor + unit.airspeed_offset
    for fault in units.faults:
        if fault.name == "heading_coding":
            where = acts(fault, setting.tail, setting.hours, units.tails)
            step = np.radians(fault.value("step_deg"))
            north = np.zeros(heading.size)
            if not fault.parameters.get("true_north"):
                north = setting.declination + setting.declination_error
            rounded = np.round((heading - north) / step) * step + north
            heading[where] = rounded[where]
    return heading, airspeed + coding.airspeed_noise * noise[1]


def _reported(
    frame: pd.DataFrame, state: dict[str, Array], u: Array, v: Array, units: Units, seed: int
) -> pd.DataFrame:
    """Add the coded columns (the message) and the number a report was made with."""
    tails, faults, coding = units.tails, units.faults, units.coding
    tail, hours = frame["aircraft"].to_numpy(), state["hours"]
    number = hours.size
    frame["made"] = np.arange(number)
    frame["computed_u"], frame["computed_v"] = u, v
    outside = [fault for fault in faults if fault.name == "outside"]
    if outside:
        variables = report_variables(frame, u, v, hours)
        for place, fault in enumerate(outside):
            rng = stream(seed, f"outside {place}")
            where = acts(fault, tail, hours, tails)
            change = effect_change(fault.parameters, u, v, variables, where, rng)
            u, v = u + change[:, 0], v + change[:, 1]
    steps = {
        "direction": np.full(number, coding.direction_deg),
        "speed": np.full(number, coding.speed_kt),
        "position": np.full(number, coding.position_arcmin / 60.0),
        "time": np.full(number, coding.time_s),
    }
    altitude, named = state["altitude"].copy(), tail.copy()
    for fault in faults:
        where = acts(fault, tail, hours, tails)
        if fault.name == "altitude_offset":
            altitude[where] += fault.value("offset_ft") * 0.3048
        elif fault.name == "wind_coding":
            direction_step = fault.value("direction_step_deg", 10.0) or coding.direction_deg
            steps["direction"][where] = direction_step
            steps["speed"][where] = fault.value("step", 5.0)
        elif fault.name == "position_coding":
            steps["position"][where] = fault.value("step", 1.0) / 60.0
        elif fault.name == "time_lag" and fault.parameters.get("to_minute"):
            steps["time"][where] = 60.0
        elif fault.name == "outliers":
            # Seeded by its content, so that it does not depend on other effects.
            rng = stream(seed, f"outliers {fault.tails} {fault.value('fraction')}")
            hit = where & (rng.uniform(size=number) < fault.value("fraction"))
            kind = rng.integers(0, 3, number)
            wild = rng.normal(0, 25.0, (2, number))
            u, v = (
                np.where(hit, np.select([kind == 0, kind == 1], [-wind, noise], 2.0 * wind), wind)
                for wind, noise in zip((u, v), wild, strict=True)
            )
        elif fault.name == "tail_swap":
            pair = fault.tails or fault.parameters["pair"]
            first, second = (list(tails).index(str(name)) for name in pair)
            inside = (hours >= fault.period[0]) & (hours < fault.period[1])
            for old, new in ((first, second), (second, first)):
                named[inside & (tail == old)] = new
    direction, speed = coded(u, v, direction_step=steps["direction"], speed_step=steps["speed"])
    radians, metres = np.radians(direction), speed * 1852.0 / 3600.0
    seconds = np.floor(hours * 3600.0 / steps["time"] + 1e-6) * steps["time"]  # cut, not rounded
    frame["tail"] = np.array(tails)[named]
    frame["hours"] = seconds / 3600.0
    frame["latitude"] = np.round(state["latitude"] / steps["position"]) * steps["position"]
    frame["longitude"] = np.round(state["longitude"] / steps["position"]) * steps["position"]
    frame["altitude"] = np.round(altitude / 3.048) * 3.048  # tens of feet
    frame["direction"], frame["speed"] = direction, speed
    frame["u"], frame["v"] = -metres * np.sin(radians), -metres * np.cos(radians)
    rng = stream(seed, "temperature noise")
    frame["celsius"] = np.round(frame["temperature"] - 273.15 + rng.normal(0, 0.5, number))
    frame["temperature_qc"] = np.where(rng.uniform(size=number) < 0.004, "fail", "pass")
    # 5 degrees: AMDAR's limit of a good roll angle.
    frame["roll_flag"] = np.where(np.abs(frame["bank"]) > np.radians(5.0), "B", "G")
    return frame
