"""Observations at stations, paired with forecasts by time.

Assumes tables with one line a station and time, latitude and longitude in degrees, and any of
temperature and wind with the unit in the column's name. A forecast's observation is the one nearest
to its valid time within a given gap. A calm has no direction: its components are zero whatever
direction the table gives. SI units.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from airswing.errors import InputError
from airswing.handover.forecasts.correcting import TIME
from airswing.handover.forecasts.forecast_pairs import (
    PLACES,
    STATION,
    VALID,
    column,
    numbers,
    on_axes,
    optional_column,
    read_table,
    times,
)
from airswing.handover.forecasts.station_grib import UNITS, forecasts_at_stations
from airswing.units import KNOT, ZERO_CELSIUS

# Column in lower case: variable, factor and offset to SI units.
_COLUMNS = {
    "air_temperature_k": ("air_temperature", 1.0, 0.0),
    "temperature_k": ("air_temperature", 1.0, 0.0),
    "air_temperature_degc": ("air_temperature", 1.0, ZERO_CELSIUS),
    "temperature_degc": ("air_temperature", 1.0, ZERO_CELSIUS),
    "wind_speed_kt": ("wind_speed", KNOT, 0.0),
    "wind_speed_m_s": ("wind_speed", 1.0, 0.0),
    "wind_direction_deg": ("wind_direction", 1.0, 0.0),
    "eastward_wind_m_s": ("eastward_wind", 1.0, 0.0),
    "northward_wind_m_s": ("northward_wind", 1.0, 0.0),
}
_RANGE = {
    "air_temperature": (150.0, 350.0),
    "wind_speed": (0.0, 150.0),
    "eastward_wind": (-150.0, 150.0),
    "northward_wind": (-150.0, 150.0),
}


def pairs_at_stations(
    forecasts: Sequence[Path],
    observations: Sequence[Path],
    *,
    columns: Mapping[str, str] | None = None,
    max_time_gap: float = 1800.0,
) -> xr.Dataset:
    """Pair forecasts from GRIB with observations at stations.

    Parameters
    ----------
    forecasts : sequence of Path
        GRIB files with temperature at 2 m or wind at 10 m.
    observations : sequence of Path
        Tables; their columns are named as in `_COLUMNS` after ``columns``.
    columns : mapping of str to str, optional
        Names in the tables to those of `_COLUMNS`.
    max_time_gap : float, default 1800
        Seconds between an observation and the valid time.

    Returns
    -------
    Dataset
        As :func:`airswing.handover.forecasts.correcting.correct_forecasts` takes it.

    Raises
    ------
    InputError
        If a table cannot be used, or no observation meets a forecast.
    """
    left_out: Counter[str] = Counter()
    parts = [_observations(Path(file), columns or {}, left_out) for file in observations]
    observed = pd.concat(parts, ignore_index=True)
    if observed.empty:
        raise InputError(
            "no observation can be used",
            file=observations[0],
            found="; ".join(f"{reason} ({n})" for reason, n in left_out.items() if n)
            or "no line with a value",
        )
    places = observed.groupby("station", sort=True)[list(PLACES)].first().reset_index()
    table, skipped = forecasts_at_stations(forecasts, places)
    left_out.update(skipped)
    outside = table.groupby("station")["forecast"].apply(lambda values: values.isna().all())
    off = [str(name) for name in outside.index[outside]]
    if off:
        left_out[f"stations without a forecast: {', '.join(off[:8])}"] += len(off)
    paired = _paired(table[table["forecast"].notna()], observed, max_time_gap)
    if not paired["observation"].notna().any():
        raise InputError(
            "no observation meets a forecast",
            file=observations[0],
            field="postprocess.stations.files",
            found=_spans(table, observed),
            remedy="Check the stations' places and times (UTC)",
        )
    paired = paired.merge(places, on="station", how="left")
    paired["units"] = paired["variable"].map(UNITS)
    found = on_axes(paired)
    found.attrs["lines_left_out"] = {reason: n for reason, n in left_out.items() if n}
    return found


def _spans(table: pd.DataFrame, observed: pd.DataFrame) -> str:
    valid = _valid(table)
    return (
        f"forecasts valid {valid.min()} to {valid.max()}, observations "
        f"{observed['time'].min()} to {observed['time'].max()}"
    )


def _valid(table: pd.DataFrame) -> pd.Series:
    return table[TIME] + pd.to_timedelta((table["lead"] * 3.6e12).round(), unit="ns")


def _observations(file: Path, columns: Mapping[str, str], left_out: Counter[str]) -> pd.DataFrame:
    """One table: station, time, place, variables in SI units."""
    raw, _ = read_table(file, columns)
    left_out["observation lines with another number of columns"] += int(raw.attrs["lines_skipped"])
    table = pd.DataFrame(
        {
            "station": column(raw, STATION, file=file).astype(str),
            "time": times(column(raw, VALID, file=file)),
        }
    )
    for name, known in PLACES.items():
        place = optional_column(raw, known) if name == "altitude" else column(raw, known, file=file)
        table[name] = np.nan if place is None else numbers(place)
    known_columns = [name for name in _COLUMNS if name in raw]
    if not known_columns:
        raise InputError(
            "no column with an observation",
            file=file,
            found="columns " + ", ".join(map(str, raw.columns)),
            remedy="Name them under columns, as one of " + ", ".join(_COLUMNS),
        )
    for name in known_columns:
        variable, factor, offset = _COLUMNS[name]
        table[variable] = numbers(raw[name]) * factor + offset
    _derive(table)
    for name, (least, most) in _RANGE.items():
        if name in table:
            absurd = table[name].notna() & ~table[name].between(least, most)
            left_out[f"{name} out of range"] += int(absurd.sum())
            table.loc[absurd, name] = np.nan
    good = table["time"].notna() & table["latitude"].between(-90, 90)
    good &= table["longitude"].between(-180, 360)
    left_out["observations without a time or place that can be read"] += int((~good).sum())
    return table[good]


def _derive(table: pd.DataFrame) -> None:
    """Components from speed and direction, and the speed from components."""
    if {"wind_speed", "wind_direction"} <= set(table):
        speed = table["wind_speed"].to_numpy()
        # The direction of a calm may be anything, or missing.
        angle = np.radians(np.where(speed == 0.0, 0.0, table["wind_direction"].to_numpy()))
        table["eastward_wind"] = -speed * np.sin(angle)
        table["northward_wind"] = -speed * np.cos(angle)
    elif {"eastward_wind", "northward_wind"} <= set(table):
        table["wind_speed"] = np.hypot(table["eastward_wind"], table["northward_wind"])


def _paired(table: pd.DataFrame, observed: pd.DataFrame, max_time_gap: float) -> pd.DataFrame:
    """Forecasts with the observation nearest to each valid time."""
    table = table.assign(time=_valid(table)).sort_values("time")
    parts = []
    for variable, forecasts in table.groupby("variable", sort=True):
        if variable not in observed:
            continue
        there = observed.loc[observed[variable].notna(), ["station", "time", variable]]
        parts.append(
            pd.merge_asof(
                forecasts,
                there.sort_values("time").rename(columns={variable: "observation"}),
                on="time",
                by="station",
                direction="nearest",
                tolerance=pd.Timedelta(seconds=max_time_gap),
            )
        )
    if not parts:
        return table.assign(observation=np.nan)
    return pd.concat(parts, ignore_index=True)
