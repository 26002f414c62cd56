"""Proposal of a column mapping for an unknown report table, to be pasted into a configuration.

The quantity of a column follows from its name, its unit from the end of the name or from brackets
in it. If several remain possible, the values decide, and the text marks the entry to be confirmed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from airswing.reports.columns import (
    QUANTITIES,
    REQUIRED,
    TEXT,
    Column,
    Quantity,
    Source,
    gives_wind,
    numbers,
    parse_times,
    possible,
    recognised,
)
from airswing.reports.formats.tabular import column_of, first_rows

# Largest value, and the units of columns with a larger one and without.
_BY_SIZE = {
    # 1013 hPa is the largest there is, and the least at flight level still 15,000 Pa.
    "pressure": (2000.0, "Pa", "hPa"),
    # In metres that is above most airliners; in feet half of all flight is.
    "pressure_altitude": (15_500.0, "ft", "m"),
    # No air is as warm as 150 degC, none as cold as 150 K.
    "temperature": (150.0, "K", "degC"),
    # The speed of sound in m/s: no transport aircraft flies at 340 m/s, but many at 340 kt.
    **dict.fromkeys(("ground_speed", "true_airspeed", "indicated_airspeed"), (340.0, "kt", "m/s")),
}
_FASTEST_WIND = 60.0  # median of a column of winds, in any unit; aircraft are faster

Entry = str | dict[str, str]  # a canonical name, or one with its unit, parts or value


def propose_mapping(path: str | Path) -> dict[str, Any] | None:
    """Propose how an unknown CSV or Parquet table would be read; None for fewer than two columns.

    Returns ``columns`` in the form of ``reports.columns`` of the configuration, ``yaml`` (the same
    as text, with guesses marked), ``unused`` (columns without a known quantity) and ``missing``
    (required quantities that were not found).
    """
    table = first_rows(Path(path)).rename(columns=str)
    stems: dict[str, str] = {}
    for column in table.columns.tolist():
        stem, there = recognised(column)[0], table[column].dropna()
        text = stem in QUANTITIES and len(there) > 0 and np.isnan(numbers(there)).all()
        if stem is not None and not text:
            stems.setdefault(stem, column)
    if len(stems) < 2:
        return None
    remarks: dict[str, str] = {}
    mapping = _time(table, stems, remarks)
    _motion(table, stems, remarks)
    values = {
        name: pd.Series(numbers(table[column]))
        for name, column in stems.items()
        if name in QUANTITIES
    }
    for name, column in stems.items():
        if name in values:
            mapping[column] = _entry(QUANTITIES[name], column, values[name], remarks)
        elif name != "time":
            mapping[column] = name
    if "tail" not in stems:
        mapping["tail"] = {"value": re.sub(r"\W+", "_", Path(path).name.split(".")[0])}
        remarks["tail"] = "one aircraft a file is a guess: give its name, or the column that has it"
    parts = mapping.get("time")
    used = {*mapping, *(parts.values() if isinstance(parts, dict) else ())}
    # Canonical columns of text are read without a mapping.
    used |= {column for column in table.columns if column.strip().lower() in TEXT}
    missing = [name for name in REQUIRED if name not in stems and name != "tail"]
    if not stems.keys() & {"pressure_altitude", "pressure"}:
        missing.append("pressure_altitude_ft or pressure_hPa")
    if not gives_wind(QUANTITIES[name].variable for name in values):
        missing.append("a wind, or heading, airspeed, ground_speed and track")
    return {
        "columns": mapping,
        "yaml": _as_yaml(mapping, remarks),
        "unused": [column for column in table.columns if column not in used],
        "missing": missing,
    }


def _time(table: pd.DataFrame, stems: dict[str, str], remarks: dict[str, str]) -> dict[str, Entry]:
    candidates = [column for column in table.columns.tolist() if recognised(column)[0] == "time"]
    dates = [c for c in candidates if re.search(r"date|day", c, re.I) and not _has_clock(table[c])]
    clocks = [c for c in candidates if c not in dates]
    # A clock time without a date ("12:00:00") is not enough, nor are seconds since the start.
    valid_share = {c: float(np.mean(possible(parse_times(table[c])[0]))) for c in clocks}
    best = max(valid_share, key=lambda column: valid_share[column], default=None)
    if dates and clocks and (best is None or valid_share[best] == 0.0):
        clock = next((column for column in clocks if _has_clock(table[column])), clocks[0])
        stems["time"] = "time"
        joined = column_of(table, Source(dates[0], parts=(clock,)))
        if not possible(parse_times(joined)[0]).any():
            remarks["time"] = 'no ISO 8601 date: add a format, such as format: "%d.%m.%Y %H:%M:%S"'
        return {"time": {"date": dates[0], "time": clock}}
    column = best or next(iter(dates), None)
    if column is None:
        return {}
    stems["time"] = column
    if pd.api.types.is_numeric_dtype(table[column]):
        remarks[column] = "a number that is read as a time between 1973 and now"
    return {column: "time"}


def _has_clock(column: Column) -> bool:
    return bool(column.dropna().astype(str).str.contains(r"\d:\d\d").any())


def _motion(table: pd.DataFrame, stems: dict[str, str], remarks: dict[str, str]) -> None:
    airspeed = bool(stems.keys() & {"true_airspeed", "indicated_airspeed", "mach"})
    speed, direction = stems.get("wind_speed"), stems.get("wind_direction")
    ambiguous = "ground_speed" not in stems and speed is not None and speed.lower() == "speed"
    if ambiguous and float(pd.Series(numbers(table[speed])).abs().median()) > _FASTEST_WIND:
        stems["ground_speed"] = stems.pop("wind_speed")
        remarks[str(speed)] = "as fast as an aircraft: the ground speed, not the wind"
        if direction is not None and direction.lower() == "direction":
            stems["track"] = stems.pop("wind_direction")
    if "heading" not in stems:
        return
    if not airspeed and "track" not in stems and "ground_speed" in stems:
        stems["track"] = stems.pop("heading")
        remarks[stems["track"]] = "without an airspeed: the direction of movement over ground"
    elif {"ground_speed", "track"} <= stems.keys() and airspeed and "magnetic_heading" not in stems:
        stems["magnetic_heading"] = stems.pop("heading")
        remarks[stems["magnetic_heading"]] = "magnetic is a guess: heading_deg where it is true"


def _entry(quantity: Quantity, column: str, values: Column, remarks: dict[str, str]) -> Entry:
    largest, remark = float(values.abs().max()), ""
    written = recognised(column)[1]
    unit: str | None = None  # that of the canonical name
    if written:
        unit = None if written == "degree" else written
    elif quantity.stem == "pressure_altitude" and 0 < largest <= 600:
        # Flight levels are hundreds of feet: no aircraft is above 60,000 ft.
        unit, remark = "hft", "flight levels guessed from its values"
    elif quantity.stem in _BY_SIZE:
        limit, above, below = _BY_SIZE[quantity.stem]
        unit = above if largest > limit else below
        remark = f"{above} or {below} guessed from its values: please check"
    elif quantity.si_unit == "m/s":
        unit, remark = "kt", "kt or m/s cannot be decided from the name: please check"
    if remark:
        remarks.setdefault(column, remark)
    return quantity.canonical if unit is None else {"name": quantity.canonical, "unit": unit}


def _as_yaml(mapping: Mapping[str, object], remarks: Mapping[str, str]) -> str:
    import yaml

    lines = ["columns:"]
    for key, value in mapping.items():
        yaml_key, yaml_value = (
            yaml.safe_dump(entry, default_flow_style=True, width=1000).split("\n")[0]
            for entry in (key, value)
        )
        remark = f"   # {remarks[key]}" if key in remarks else ""
        lines.append(f"  {yaml_key}: {yaml_value}{remark}")
    return "\n".join(lines)
