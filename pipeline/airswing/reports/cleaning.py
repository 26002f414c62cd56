"""Cleaning shared by every report format: raw columns in SI to canonical columns.

A report is dropped only without aircraft, time or position; every other impossible value becomes
NaN and is counted. Wind direction 360 becomes 0, a calm has no direction, a speed without a
direction gives no wind. Where no wind is reported it is ground velocity minus air velocity, of the
true airspeed if reported, else from the Mach number, else from the indicated airspeed, at the
reported temperature, else at that of the standard atmosphere, which is in error by up to 4 %.
"""

from __future__ import annotations

import string
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.flags import ICING, PHASE, PLATFORM, QC, ROLL, WIND_SOURCE
from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    airspeed_from_mach,
    altitude_from_pressure,
    pressure_from_altitude,
    standard_temperature,
)
from airswing.physics.geomagnetism import geomagnetic_field
from airswing.physics.triangle import (
    direction_in_degrees,
    vector_from_bearing,
    wind_components,
    wind_from_triangle,
)
from airswing.reports.audit import Audit
from airswing.reports.columns import LIMITS, Column, Floats, Mask, possible, seconds_since_1970

FLAGS = {
    "roll_flag": ROLL["missing"],
    "temperature_qc": QC["missing"],
    "wind_qc": QC["missing"],
    "phase": PHASE["unknown"],
    "icing": ICING["missing"],
    "wind_source": WIND_SOURCE["reported"],
    "platform": PLATFORM["unknown"],
}
"""Flag columns and their value for missing."""

# Usual mistakes of a unit that make values impossible: factor and offset that correct them.
_MISTAKES = pd.read_csv(Path(__file__).with_name("mistakes.csv"))
_WIND = ("wind_speed", "wind_direction", "eastward_wind", "northward_wind")
_ANGLES = ("wind_direction", "reported_heading", "magnetic_heading", "track")
_AIR_DATA = ("air_temperature", "reported_airspeed", "reported_heading")
_FOR_DERIVED_WIND = ("magnetic_heading", "ground_speed", "track", "indicated_airspeed", "mach")
# Names are padded with NULs (fixed-width fields) and no-break spaces (spreadsheets).
_PADDING = string.whitespace + "\xa0\x00"
_MANY = 0.5  # share of impossible values above which the likely mistake is searched for
_ORIGIN = 1e-6  # degrees: positions nearer to 0 N 0 E than this were not set


def clean(raw: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    """Bring raw columns to the canonical columns of :func:`airswing.reports.read.read_file`.

    Raw are ``tail`` (str), ``time`` (datetime64[ns]), ``latitude``, ``longitude`` and any of the
    columns of :data:`LIMITS` and :data:`FLAGS`, ``flight`` (str) and ``time_blank`` (bool). Every
    drop and repair is counted, and the rows as read.
    """
    audit.read += len(raw)
    tail = _stripped(raw["tail"])
    time = raw["time"].to_numpy(dtype="datetime64[ns]")
    blank = raw["time_blank"].to_numpy() if "time_blank" in raw else np.isnat(time)
    place = {name: raw[name].to_numpy(dtype=np.float64) for name in ("latitude", "longitude")}
    reasons = {
        "missing_tail": (tail == "").to_numpy(dtype=bool),
        "missing_time": np.isnat(time) & blank,
        "unparsable_time": np.isnat(time) & ~blank,
        "time_out_of_range": ~possible(time),
        "missing_position": ~np.isfinite(place["latitude"]) | ~np.isfinite(place["longitude"]),
    }
    for name, values in place.items():
        low, high = LIMITS[name]
        reasons[f"{name}_out_of_range"] = beyond = (values < low) | (values > high)
        _name_mistake(name, values, beyond, audit)
    keep = np.ones(len(raw), dtype=bool)
    for reason, bad in reasons.items():
        audit.drop(reason, np.count_nonzero(keep & bad))
        keep &= ~bad
    raw = raw.loc[keep]
    longitude = place["longitude"][keep]
    audit.repair("longitude_wrapped", np.count_nonzero(longitude >= 180.0))
    flight = _stripped(raw["flight"]) if "flight" in raw else pd.Series("", raw.index, dtype=str)
    frame = pd.DataFrame(
        {
            "tail": tail[keep].astype("category").array,
            "flight": flight.astype("category").array,
            "time": time[keep],
            "latitude": place["latitude"][keep],
            "longitude": np.where(longitude >= 180.0, longitude - 360.0, longitude),
        }
    )
    altitude = _number(raw, "pressure_altitude", audit)
    pressure = _number(raw, "pressure", audit)
    pressure = np.where(np.isnan(pressure), pressure_from_altitude(altitude), pressure)
    altitude = np.where(np.isnan(altitude), altitude_from_pressure(pressure), altitude)
    measured = {"pressure": pressure, "pressure_altitude": altitude, **_wind(raw, audit)}
    measured |= {name: _number(raw, name, audit) for name in _AIR_DATA}
    frame = frame.assign(**{name: values.astype(np.float32) for name, values in measured.items()})
    for name, missing in FLAGS.items():
        frame[name] = raw[name].to_numpy(dtype=np.int8) if name in raw else np.int8(missing)
    if set(raw).intersection(_FOR_DERIVED_WIND):
        _derive_wind(frame, raw, audit)
    unset = (frame["latitude"].abs() < _ORIGIN) & (frame["longitude"].abs() < _ORIGIN)
    audit.repair("wind_failed_at_origin", int(unset.sum()))
    frame.loc[unset, "wind_qc"] = np.int8(QC["fail"])
    return frame


def _stripped(values: Column) -> Column:
    return values.fillna("").astype(str).str.strip(_PADDING)


def _number(raw: pd.DataFrame, name: str, audit: Audit) -> Floats:
    if name not in raw:
        return np.full(len(raw), np.nan)
    values = raw[name].to_numpy(dtype=np.float64, copy=True)
    low, high = LIMITS[name]
    if name in _ANGLES:
        west = (values >= -180.0) & (values < 0.0)
        audit.repair(f"{name}_wrapped", np.count_nonzero(west))
        values[west] += 360.0
    with np.errstate(invalid="ignore"):
        bad = (values < low) | (values > high) | np.isinf(values)
    audit.repair(f"{name}_out_of_range", np.count_nonzero(bad))
    _name_mistake(name, values, bad, audit)
    values[bad] = np.nan
    return values


def _name_mistake(name: str, values: Floats, bad: Mask, audit: Audit) -> None:
    """Name the mistake that explains many impossible values: undone, all become possible."""
    low, high = LIMITS[name]
    if np.count_nonzero(bad) < _MANY * np.count_nonzero(np.isfinite(values)):
        return
    wrong = values[bad & np.isfinite(values)]
    if wrong.size < 2 or np.ptp(wrong) == 0.0:
        return
    for variables, likely, factor, offset in _MISTAKES.itertuples(index=False):
        if name not in variables.split():
            continue
        corrected = factor * values + offset
        if np.mean((corrected < low) | (corrected > high)) < 0.02:
            audit.mistakes.setdefault(name, likely)
            return


def _wind(raw: pd.DataFrame, audit: Audit) -> dict[str, Floats]:
    """Speed, direction and components of the reported wind; a calm has no direction."""
    if {"wind_speed", "wind_direction"} <= set(raw):
        speed = _number(raw, "wind_speed", audit)
        direction = _number(raw, "wind_direction", audit)
        # 360 means north, and 0 calm in some codes: the speed decides.
        audit.repair("wind_direction_360", np.count_nonzero(direction == 360.0))
        direction[direction == 360.0] = 0.0
        calm = speed == 0.0
        audit.repair("calm_without_direction", np.count_nonzero(calm & np.isnan(direction)))
        direction[calm] = np.nan
        half = ~calm & (np.isnan(direction) != np.isnan(speed))
        audit.repair("wind_incomplete", np.count_nonzero(half))
        speed[half] = direction[half] = np.nan
        eastward, northward = wind_components(speed, np.radians(direction))
    else:
        eastward = _number(raw, "eastward_wind", audit)
        northward = _number(raw, "northward_wind", audit)
        eastward[np.isnan(northward)] = northward[np.isnan(eastward)] = np.nan
        speed, direction = _speed_and_direction(eastward, northward)
    return dict(zip(_WIND, (speed, direction, eastward, northward), strict=True))


def _speed_and_direction(eastward: Floats, northward: Floats) -> tuple[Floats, Floats]:
    speed = np.hypot(eastward, northward)
    return speed, np.where(speed == 0.0, np.nan, direction_in_degrees(eastward, northward))


def _derive_wind(frame: pd.DataFrame, raw: pd.DataFrame, audit: Audit) -> None:
    """Fill in airspeed, true heading and, where none is reported, the wind."""
    values = {name: _number(raw, name, audit) for name in _FOR_DERIVED_WIND}
    measured_names = (*_AIR_DATA, "latitude", "longitude", "pressure", "pressure_altitude")
    values |= {name: frame[name].to_numpy(dtype=np.float64) for name in measured_names}
    heading, magnetic = values["reported_heading"].copy(), values["magnetic_heading"]
    wanted = np.flatnonzero(np.isnan(heading) & np.isfinite(magnetic))
    if wanted.size:
        east = declination(
            values["latitude"][wanted],
            values["longitude"][wanted],
            values["pressure_altitude"][wanted],
            seconds_since_1970(frame["time"].to_numpy()[wanted]),
        )
        heading[wanted] = (magnetic[wanted] + east) % 360.0
    measured, reported = values["air_temperature"], values["reported_airspeed"]
    standard = standard_temperature(values["pressure_altitude"])
    kelvin = np.where(np.isnan(measured), standard, measured)
    from_mach = airspeed_from_mach(values["mach"], kelvin)
    indicated = airspeed_from_calibrated(values["indicated_airspeed"], values["pressure"], kelvin)
    computed = np.where(np.isnan(from_mach), indicated, from_mach)
    airspeed = np.where(np.isnan(reported), computed, reported)
    ground = vector_from_bearing(values["ground_speed"], np.radians(values["track"]))
    eastward, northward = wind_from_triangle(*ground, airspeed, np.radians(heading))
    speed, direction = _speed_and_direction(eastward, northward)
    # False for NaN too: a wind that cannot be derived is not usable.
    usable = speed <= LIMITS["wind_speed"][1]
    audit.repair("derived_wind_out_of_range", np.count_nonzero(np.isfinite(eastward) & ~usable))
    derived = frame["eastward_wind"].isna().to_numpy() & usable
    audit.repair("wind_derived", np.count_nonzero(derived))
    for name, wind in zip(_WIND, (speed, direction, eastward, northward), strict=True):
        frame[name] = np.where(derived, wind, frame[name]).astype(np.float32)
    frame["reported_heading"] = heading.astype(np.float32)
    frame["reported_airspeed"] = airspeed.astype(np.float32)
    at_standard_temperature = derived & np.isnan(reported) & np.isnan(measured)
    frame["wind_source"] = np.select(
        [at_standard_temperature, derived],
        [WIND_SOURCE["derived_at_standard_temperature"], WIND_SOURCE["derived"]],
        WIND_SOURCE["reported"],
    ).astype(np.int8)


def declination(latitude: Floats, longitude: Floats, altitude: Floats, seconds: Floats) -> Floats:
    """IGRF declination (degrees east) at places in degrees and m and seconds since 1970."""
    field = geomagnetic_field(latitude, longitude, np.nan_to_num(altitude), seconds)
    return np.asarray(np.degrees(field.declination))
