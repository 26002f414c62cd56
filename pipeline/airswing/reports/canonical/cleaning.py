"""Cleaning shared by every report format: one raw piece in, canonical columns out.

Assumes a piece has its quantities in SI (angles in degrees), NaN for absent numbers, NaT for
absent times and flags already decoded (:mod:`airswing.reports.canonical.codes`).

Rules
-----
A report is dropped only without tail, time or position. Everything else impossible becomes
NaN and is counted: the position of a report without wind still serves the ground vector.
Longitudes 180..360 become -180..0, headings and wind directions of -180..0 become 180..360 (some
recorders write them so: to drop them would be to drop every westerly), wind direction 360 becomes
0, calm (speed 0) has no wind whatever its direction, and a speed without a direction is no wind.
The wind of a position exactly at 0 N 0 E fails its check. Pressure follows from pressure altitude
by the two-layer standard atmosphere, or the reverse.

Validity
--------
Wind up to 150 m/s, temperature 150-340 K, pressure altitude -700 to 20,000 m.
"""

from __future__ import annotations

import string

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.flags import (
    ICING,
    PHASE,
    PLATFORM,
    ROLL,
    TEMPERATURE_QC,
    WIND_QC,
    WIND_SOURCE,
)
from airswing.physics.atmosphere import altitude_from_pressure, pressure_from_altitude
from airswing.physics.triangle import direction_in_degrees, wind_from_direction
from airswing.reports.canonical.air_vector import (
    source_codes,
    true_airspeed,
    true_heading,
    wind_of,
)
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.times import EARLIEST, LATEST, Column

FLAGS = {
    "roll_flag": ROLL["missing"],
    "temperature_qc": TEMPERATURE_QC["missing"],
    "wind_qc": WIND_QC["missing"],
    "phase": PHASE["unknown"],
    "icing": ICING["missing"],
    "wind_source": WIND_SOURCE["reported"],
    "platform": PLATFORM["unknown"],
}
"""Flag columns of a piece and the value that stands for missing."""

LIMITS = {
    "wind_speed": (0.0, 150.0),
    "wind_direction": (0.0, 360.0),
    "air_temperature": (150.0, 340.0),
    # of the standard atmosphere at the two limits of altitude
    "pressure": (5000.0, 110000.0),
    "pressure_altitude": (-700.0, 20000.0),
    "reported_airspeed": (0.0, 400.0),
    "reported_heading": (0.0, 360.0),
    "magnetic_heading": (0.0, 360.0),
    "ground_speed": (0.0, 500.0),
    "track": (0.0, 360.0),
    "indicated_airspeed": (0.0, 400.0),
    "mach": (0.0, 1.2),
    "eastward_wind": (-150.0, 150.0),
    "northward_wind": (-150.0, 150.0),
}
"""Lowest and highest possible value per column, in SI (degrees for angles)."""

# Those of them that may be written from -180 to 180.
ANGLES = ("wind_direction", "reported_heading", "magnetic_heading", "track")

_FLOATS = ("air_temperature", "reported_airspeed", "reported_heading")
# What only a wind derived here needs; it is not kept.
_DERIVED_FROM = ("magnetic_heading", "ground_speed", "track", "indicated_airspeed", "mach")
# Names come padded with NULs (fixed-width fields) and no-break spaces (spreadsheets).
_AROUND = string.whitespace + "\xa0\x00"
_ORIGIN = 1e-6  # degrees: a position nearer to 0 N 0 E than this is an unset one


def clean(piece: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    """Bring one raw piece to canonical columns.

    Parameters
    ----------
    piece : DataFrame
        ``tail`` (str), ``time`` (datetime64[ns]), ``latitude``, ``longitude`` and any of the
        columns of :data:`LIMITS` and :data:`FLAGS`, ``flight`` (str) and ``time_blank`` (bool).
    audit : Audit
        Every drop and repair is added to it; its ``read`` grows by the rows of the piece.

    Returns
    -------
    DataFrame
        ``tail, flight`` (categories), ``time, latitude, longitude, pressure,
        pressure_altitude, wind_speed, wind_direction, eastward_wind, northward_wind,
        air_temperature, reported_airspeed, reported_heading`` and the flags; float64 for
        position, float32 for all other numbers.
    """
    audit.read += len(piece)
    tail = _stripped(piece["tail"])
    time = piece["time"].to_numpy(dtype="datetime64[ns]")
    latitude = piece["latitude"].to_numpy(dtype=np.float64)
    longitude = piece["longitude"].to_numpy(dtype=np.float64)
    blank = piece["time_blank"].to_numpy() if "time_blank" in piece else np.isnat(time)
    keep = np.ones(len(piece), dtype=bool)
    for reason, bad in (
        ("missing_tail", (tail == "").to_numpy(dtype=bool)),
        ("missing_time", np.isnat(time) & blank),
        ("unparsable_time", np.isnat(time) & ~blank),
        ("time_out_of_range", (time < EARLIEST) | (time >= LATEST)),
        ("missing_position", ~np.isfinite(latitude) | ~np.isfinite(longitude)),
        ("latitude_out_of_range", np.abs(latitude) > 90.0),
        ("longitude_out_of_range", (longitude < -180.0) | (longitude > 360.0)),
    ):
        audit.drop(reason, int(np.count_nonzero(keep & bad)))
        keep &= ~bad
    piece = piece.loc[keep]
    longitude = longitude[keep]
    audit.repair("longitude_wrapped", int(np.count_nonzero(longitude >= 180.0)))
    frame = pd.DataFrame(
        {
            "tail": tail[keep].astype("category").array,
            "flight": _flight(piece).astype("category").array,
            "time": time[keep],
            "latitude": latitude[keep],
            "longitude": np.where(longitude >= 180.0, longitude - 360.0, longitude),
        }
    )
    for columns in (_levels(piece, audit), _wind(piece, audit)):
        for name, values in columns.items():
            frame[name] = values.astype(np.float32)
    for name in _FLOATS:
        frame[name] = _number(piece, name, audit).astype(np.float32)
    for name, missing in FLAGS.items():
        frame[name] = (
            piece[name].to_numpy(dtype=np.int8)
            if name in piece
            else np.full(len(piece), missing, dtype=np.int8)
        )
    _derive_wind(frame, piece, audit)
    _distrust_origin(frame, audit)
    return frame


def _derive_wind(frame: pd.DataFrame, piece: pd.DataFrame, audit: Audit) -> None:
    """Airspeed, true heading and, where none is reported, the wind that they tell."""
    if not set(_DERIVED_FROM).intersection(piece.columns):
        return
    told = {name: _number(piece, name, audit) for name in _DERIVED_FROM}
    known = (*_FLOATS, "latitude", "longitude", "pressure", "pressure_altitude")
    told |= {name: frame[name].to_numpy(dtype=np.float64) for name in known}
    seconds = frame["time"].to_numpy().astype("datetime64[ns]").astype(np.int64) / 1e9
    heading = true_heading(told, seconds)
    airspeed, standard = true_airspeed(told)
    eastward, northward = wind_of(told, heading, airspeed)
    fastest = LIMITS["wind_speed"][1]
    # False for NaN: a wind that cannot be worked out is not possible.
    possible = np.hypot(eastward, northward) <= fastest
    audit.repair(
        "derived_wind_out_of_range", int(np.count_nonzero(np.isfinite(eastward) & ~possible))
    )
    derived = frame["eastward_wind"].isna().to_numpy() & possible
    audit.repair("wind_derived", int(np.count_nonzero(derived)))
    speed, direction = wind_from_direction(eastward, northward)
    winds = {
        "eastward_wind": eastward,
        "northward_wind": northward,
        "wind_speed": speed,
        "wind_direction": np.degrees(direction),
    }
    for name, values in winds.items():
        frame[name] = np.where(derived, values, frame[name]).astype(np.float32)
    frame["reported_heading"] = heading.astype(np.float32)
    frame["reported_airspeed"] = airspeed.astype(np.float32)
    frame["wind_source"] = source_codes(derived, standard)


def _distrust_origin(frame: pd.DataFrame, audit: Audit) -> None:
    """Fail the wind of reports at 0 N 0 E exactly: a position rather unset than true."""
    unset = (frame["latitude"].abs() < _ORIGIN) & (frame["longitude"].abs() < _ORIGIN)
    audit.repair("wind_failed_at_origin", int(unset.sum()))
    frame.loc[unset, "wind_qc"] = np.int8(WIND_QC["fail"])


def _stripped(values: Column) -> Column:
    return values.fillna("").astype(str).str.strip(_AROUND)


def _flight(piece: pd.DataFrame) -> Column:
    if "flight" in piece:
        return _stripped(piece["flight"])
    return pd.Series("", index=piece.index, dtype=str)


def _number(piece: pd.DataFrame, name: str, audit: Audit) -> NDArray[np.float64]:
    if name not in piece:
        return np.full(len(piece), np.nan)
    values = piece[name].to_numpy(dtype=np.float64, copy=True)
    low, high = LIMITS[name]
    if name in ANGLES:
        west = (values >= -180.0) & (values < 0.0)
        audit.repair(f"{name}_wrapped", int(np.count_nonzero(west)))
        values[west] += 360.0
    with np.errstate(invalid="ignore"):
        bad = (values < low) | (values > high) | np.isinf(values)
    audit.repair(f"{name}_out_of_range", int(np.count_nonzero(bad)))
    values[bad] = np.nan
    return values


def _levels(piece: pd.DataFrame, audit: Audit) -> dict[str, NDArray[np.float64]]:
    altitude = _number(piece, "pressure_altitude", audit)
    pressure = _number(piece, "pressure", audit)
    pressure = np.where(np.isnan(pressure), pressure_from_altitude(altitude), pressure)
    altitude = np.where(np.isnan(altitude), altitude_from_pressure(pressure), altitude)
    return {"pressure": pressure, "pressure_altitude": altitude}


def _wind(piece: pd.DataFrame, audit: Audit) -> dict[str, NDArray[np.float64]]:
    """Both notations of the wind; direction is NaN where there is none (calm)."""
    if not {"wind_speed", "wind_direction"} <= set(piece):
        eastward = _number(piece, "eastward_wind", audit)
        northward = _number(piece, "northward_wind", audit)
        absent = np.isnan(eastward) | np.isnan(northward)
        eastward[absent] = northward[absent] = np.nan
        speed = np.hypot(eastward, northward)
        direction = direction_in_degrees(eastward, northward)
        direction[speed == 0.0] = np.nan
        return _as_wind(speed, direction, eastward, northward)
    speed = _number(piece, "wind_speed", audit)
    direction = _number(piece, "wind_direction", audit)
    audit.repair("wind_direction_360", int(np.count_nonzero(direction == 360.0)))
    # 360 means north, 0 calm in some codings: the speed says which it is.
    direction[direction == 360.0] = 0.0
    calm = speed == 0.0
    audit.repair("calm_without_direction", int(np.count_nonzero(calm & np.isnan(direction))))
    direction[calm] = np.nan
    half = ~calm & (np.isnan(direction) != np.isnan(speed))
    audit.repair("wind_incomplete", int(np.count_nonzero(half)))
    speed[half] = direction[half] = np.nan
    angle = np.radians(direction)
    eastward = np.where(calm, 0.0, -speed * np.sin(angle))
    northward = np.where(calm, 0.0, -speed * np.cos(angle))
    return _as_wind(speed, direction, eastward, northward)


def _as_wind(
    speed: NDArray[np.float64],
    direction: NDArray[np.float64],
    eastward: NDArray[np.float64],
    northward: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    return {
        "wind_speed": speed,
        "wind_direction": direction,
        "eastward_wind": eastward,
        "northward_wind": northward,
    }
