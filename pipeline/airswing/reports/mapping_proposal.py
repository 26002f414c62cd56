"""Proposal of a column mapping for an unknown report table, to be pasted into a configuration.

The quantity of a column follows from its name, its unit from the end of the name or from brackets
in it. Where that leaves a choice the values decide, and the text marks the entry to be confirmed:
the time column with the most possible times; the unit of a speed by the speed between successive
positions or other speeds; a heading in a table with ground speed, track and airspeed is magnetic, a
heading without track and airspeed is the track, a plain ``speed`` as of aircraft the ground speed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.reports.columns import (
    OTHER_NAMES,
    QUANTITIES,
    REQUIRED,
    Source,
    compatible,
    conversion,
    gives_wind,
    split_name,
)
from airswing.reports.flights import step_distance
from airswing.reports.formats.tabular import column_of, first_rows
from airswing.reports.values import Column, numbers, parse_times, possible
from airswing.units import KNOT

_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_ENDING = re.compile(r"_(ft|m|km|kts?|kn|knots|mps|m_s|ms|kmh|hPa|Pa|mb|degC|C|K|deg|rad)$", re.I)
_AIRBORNE = ("ground_speed", "true_airspeed", "indicated_airspeed")
_SPEEDS = (*_AIRBORNE, "wind_speed", "eastward_wind", "northward_wind")
_UNITS = {"kt": KNOT, "m/s": 1.0, "km/h": 1.0 / 3.6}
_FASTEST_WIND = 60.0  # median of a column of winds, in any unit; aircraft are faster

Entry = str | dict[str, str]  # a canonical name, or one with its unit, parts or value


def propose_mapping(path: str | Path) -> dict[str, Any] | None:
    """Propose how an unknown CSV or Parquet table would be read; None for fewer than two columns.

    Returns ``columns`` as ``reports.columns`` of the configuration takes them, ``yaml`` (the same
    as text, with its guesses marked), ``unused`` (columns for which no quantity was found) and
    ``missing`` (what is needed and was not found).
    """
    table = first_rows(Path(path))
    table.columns = [str(column) for column in table.columns]
    found: dict[str, str] = {}
    for column in table.columns:
        stem, values = _stem(column), table[column].dropna()
        if stem in QUANTITIES and len(values) and np.isnan(numbers(values)).all():
            continue  # text
        if stem is not None and stem not in found:
            found[stem] = column
    if len(found) < 2:
        return None
    mapping: dict[str, Entry] = {}
    remarks: dict[str, str] = {}
    times = _time(table, found, mapping, remarks)
    _motion(table, found, remarks)
    speed = _speed_of_positions(table, found, times)
    for name, column in found.items():
        if name != "time":
            mapping[column] = _entry(name, column, table, found, speed, remarks)
    if "tail" not in found:
        mapping["tail"] = {"value": re.sub(r"\W+", "_", Path(path).name.split(".")[0])}
        remarks["tail"] = "one aircraft a file is a guess: give its name, or the column that has it"
    used = {
        str(part)
        for value in mapping.values()
        if isinstance(value, Mapping)
        for key, part in value.items()
        if key in ("date", "time", "offset")
    }
    return {
        "columns": mapping,
        "yaml": _as_yaml(mapping, remarks),
        "unused": [c for c in table.columns if c not in mapping and c not in used],
        "missing": _missing(set(found)),
    }


def _motion(table: pd.DataFrame, found: dict[str, str], remarks: dict[str, str]) -> None:
    airspeed = bool(found.keys() & {"true_airspeed", "indicated_airspeed", "mach"})
    speed, direction = found.get("wind_speed"), found.get("wind_direction")
    plain = "ground_speed" not in found and speed is not None and speed.lower() == "speed"
    if plain and float(pd.Series(numbers(table[speed])).abs().median()) > _FASTEST_WIND:
        found["ground_speed"] = found.pop("wind_speed")
        remarks[str(speed)] = "as fast as an aircraft: the ground speed, not the wind"
        if direction is not None and direction.lower() == "direction":
            found["track"] = found.pop("wind_direction")
    if "heading" not in found:
        return
    if not airspeed and "track" not in found and "ground_speed" in found:
        found["track"] = found.pop("heading")
        remarks[found["track"]] = "without an airspeed: the direction of movement over ground"
    elif {"ground_speed", "track"} <= found.keys() and airspeed and "magnetic_heading" not in found:
        found["magnetic_heading"] = found.pop("heading")
        remarks[found["magnetic_heading"]] = "magnetic is a guess: heading_deg where it is true"


def _speed_of_positions(
    table: pd.DataFrame, found: Mapping[str, str], times: NDArray[np.datetime64] | None
) -> float:
    """Median speed between successive positions of an aircraft, m s-1; NaN where unknown."""
    if times is None or not {"latitude", "longitude"} <= found.keys():
        return float("nan")
    latitude, longitude = (numbers(table[found[name]]) for name in ("latitude", "longitude"))
    tail = pd.factorize(table[found["tail"]])[0] if "tail" in found else np.zeros(len(table))
    order = np.lexsort((times, tail))
    seconds = times[order].astype("datetime64[ms]").astype(np.int64) / 1e3
    gap = np.where(np.diff(tail[order]) == 0, np.diff(seconds), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = step_distance(latitude[order], longitude[order]) / gap
    flying = speed[(gap > 0.0) & (gap < 1800.0) & (speed > 30.0) & (speed < 400.0)]
    return float(np.median(flying)) if flying.size >= 3 else float("nan")


def _stem(column: str) -> str | None:
    """The quantity of a column by its name; None for an unknown one."""
    if known := split_name(column.strip()):
        return known[0].stem
    plain = _ENDING.sub("", _BRACKET.sub("", column.strip()))
    plain = re.sub(r"[^a-z0-9]", "", plain.lower())
    return next((name for name, names in OTHER_NAMES.items() if re.fullmatch(names, plain)), None)


def _time(
    table: pd.DataFrame, found: dict[str, str], mapping: dict[str, Entry], remarks: dict[str, str]
) -> NDArray[np.datetime64] | None:
    """Map the time's column, or the two that make it; the times of the rows, None without."""
    candidates = [column for column in table.columns if _stem(column) == "time"]
    dates = [c for c in candidates if re.search(r"date|day", c, re.I) and not _has_clock(table[c])]
    clocks = [c for c in candidates if c not in dates]
    # A clock alone ("12:00:00") is no time, nor are seconds since the begin of a flight.
    read = {column: parse_times(table[column])[0] for column in clocks}
    whole = {column: float(np.mean(possible(time))) for column, time in read.items()}
    best = max(whole, key=lambda column: whole[column], default=None)
    if dates and clocks and (best is None or whole[best] == 0.0):
        clock = next((column for column in clocks if _has_clock(table[column])), clocks[0])
        mapping["time"] = {"date": dates[0], "time": clock}
        found["time"] = "time"
        return parse_times(column_of(table, Source(dates[0], parts=(clock,))))[0]
    column = best or next(iter(dates), None)
    if column is None:
        return None
    found["time"] = column
    mapping[column] = "time"
    if pd.api.types.is_numeric_dtype(table[column]):
        remarks[column] = "a number that is read as a time between 1973 and now"
    return parse_times(table[column])[0]


def _has_clock(column: Column) -> bool:
    return bool(column.dropna().astype(str).str.contains(r"\d:\d\d").any())


def _entry(
    name: str,
    column: str,
    table: pd.DataFrame,
    found: Mapping[str, str],
    speed: float,
    remarks: dict[str, str],
) -> Entry:
    quantity = QUANTITIES.get(name)
    if quantity is None:
        return name
    known = split_name(column.strip())
    canonical = quantity.canonical
    if known is not None and known[0] is quantity:
        return canonical if known[1] == "degree" else {"name": canonical, "unit": known[1]}
    if unit := _written_unit(column, quantity.si_unit):
        return {"name": canonical, "unit": unit}
    largest = float(pd.Series(numbers(table[column])).abs().max())
    if name in _SPEEDS:
        unit, remark = _unit_of_speed(name, table, found, speed)
    else:
        unit, remark = _unit_by_size(name, largest)
    if remark:
        remarks.setdefault(column, remark)
    return canonical if unit is None else {"name": canonical, "unit": unit}


def _written_unit(column: str, si_unit: str) -> str | None:
    written = _BRACKET.search(column) or _ENDING.search(column)
    return written.group(1) if written and compatible(written.group(1), si_unit) else None


def _unit_by_size(name: str, largest: float) -> tuple[str | None, str]:
    if name == "pressure":
        # 1013 hPa is the largest there is, and the least at flight level still 15,000 Pa.
        return ("Pa" if largest > 2000 else "hPa"), "unit guessed from its values"
    if name == "pressure_altitude":
        # Flight levels are hundreds of feet: no aircraft is above 60,000 ft.
        if 0 < largest <= 600:
            return "hft", "flight levels guessed from its values"
        # In metres that is above most airliners; in feet half of all flight is.
        return ("ft" if largest > 15_500 else "m"), "unit guessed from its values"
    if name == "temperature":
        # No air is as warm as 150 degC, none as cold as 150 K.
        return ("K" if largest > 150 else "degC"), "unit guessed from its values"
    return None, ""


def _unit_of_speed(
    name: str, table: pd.DataFrame, found: Mapping[str, str], speed: float
) -> tuple[str, str]:
    please_check = "kt or m/s cannot be decided from the name: please check"
    if name not in _AIRBORNE:
        return "kt", please_check
    values = pd.Series(numbers(table[found[name]]))
    typical = float(values[values > 0].median())
    if not np.isfinite(speed):
        for other in _AIRBORNE:
            column = found.get(other)
            if column is None or other == "indicated_airspeed":
                continue
            others = pd.Series(numbers(table[column]))
            unit = _written_unit(column, "m/s") or (
                known[1] if (known := split_name(column)) else ""
            )
            # 340 m/s is the speed of sound: no transport flies at it, at 340 kt many do.
            unit = unit or ("kt" if float(others.max()) > 340 else "")
            if unit:
                factor, _ = conversion(unit, "m/s")
                speed = float(others[others > 0].median()) * factor
                break
    if not np.isfinite(speed) or not np.isfinite(typical):
        return ("kt" if float(values.max()) > 340 else "m/s"), please_check
    # Indicated is below true airspeed: by a quarter at 20,000 ft, by half at 40,000 ft.
    expected = speed * (0.75 if name == "indicated_airspeed" else 1.0)
    # km/h is rare: it must fit better by a third.
    cost = {
        unit: abs(float(np.log(typical * factor / expected))) + (0.3 if unit == "km/h" else 0.0)
        for unit, factor in _UNITS.items()
    }
    unit = min(cost, key=lambda unit: cost[unit])
    return unit, "unit found by comparison with the other speeds"


def _missing(found: set[str]) -> list[str]:
    absent = [name for name in REQUIRED if name not in found and name != "tail"]
    if not found & {"pressure_altitude", "pressure"}:
        absent.append("pressure_altitude_ft or pressure_hPa")
    if not gives_wind(QUANTITIES[name].variable for name in found & QUANTITIES.keys()):
        absent.append("a wind, or heading, airspeed, ground_speed and track")
    return absent


def _as_yaml(mapping: Mapping[str, object], remarks: Mapping[str, str]) -> str:
    import yaml

    lines = ["columns:"]
    for key, value in mapping.items():
        left, right = (
            yaml.safe_dump(one, default_flow_style=True, width=1000).split("\n")[0]
            for one in (key, value)
        )
        remark = f"   # {remarks[key]}" if key in remarks else ""
        lines.append(f"  {left}: {right}{remark}")
    return "\n".join(lines)
