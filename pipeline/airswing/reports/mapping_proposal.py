"""The mapping an unknown report table would be read with, to be pasted into a configuration.

Assumes a table with a header. What a column is, is told from its name (and the unit written at its
end or in brackets), and where that leaves units open, from its values; every guess of that kind is
marked in the text, for a person to confirm. A heading is proposed as magnetic where the table has
ground speed and airspeed beside it (Mode-S, recorders), since those report the compass.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.reports.columns import QUANTITIES, REQUIRED, compatible, split_name
from airswing.reports.formats.tabular import first_rows
from airswing.reports.values import Column

_NAMES = (
    (
        "tail",
        r"tail(no|num(ber)?|id)?|registration|reg|rego|ac(id|reg)?|aircraft(id|reg)?|airframe"
        r"|icao(24|addr(ess)?|hex)?|hex(ident|code)?|modes|msn|ident(ifier)?",
    ),
    (
        "time",
        r"time(stamp|utc|gps)?|utc|datetime(utc)?|(obs|valid|report|observation)(date)?time|ts"
        r"|epoch(time)?|unixtime|date|gmt",
    ),
    ("latitude", r"lat(itude)?(deg|dd|n|gps)?|gpslat(itude)?|y"),
    ("longitude", r"(lon(g|gitude)?|lng)(deg|dd|e|gps)?|gpslon(g|gitude)?|x"),
    (
        "pressure_altitude",
        r"(p|press(ure)?|baro(metric)?|std|indicated)?alt(itude)?(baro|std|msl)?"
        r"|baroaltitude|flightlevel|flevel|fl|(press)?height|palt|hp",
    ),
    ("pressure", r"p|pres(s|sure)?|staticpress(ure)?|ps"),
    ("wind_direction", r"w(i)?n?d?dir(ection)?(true|from)?|dd|winddirn|wd|direction"),
    ("wind_speed", r"w(i)?n?d?sp(ee)?d|ff|ws|windvel(ocity)?|wspd|speed"),
    ("eastward_wind", r"u|uwnd|uwind|windu|ucomp(onent)?|eastwardwind|wx"),
    ("northward_wind", r"v|vwnd|vwind|windv|vcomp(onent)?|northwardwind|wy"),
    ("temperature", r"t|temp(erature)?|sat|oat|airtemp(erature)?|tmp|statictemp|outsidetemp|ta"),
    ("true_airspeed", r"tas|trueair(speed)?"),
    ("indicated_airspeed", r"ias|cas|indicatedair(speed)?|calibratedair(speed)?"),
    ("mach", r"mach(no|number)?|m"),
    ("magnetic_heading", r"mag(netic)?h(ea)?di?n?g|h(ea)?di?n?gmag(netic)?|mh"),
    ("heading", r"(true)?h(ea)?di?n?g(true)?|th"),
    ("ground_speed", r"gs|ground(speed|spd)|gnd(spd|speed)|gspd|velocity|sog"),
    ("track", r"trk|track(angle|true)?|truetrack|course|cog"),
    ("roll_flag", r"rollflag"),
    ("phase", r"phase(offlight)?|flightphase"),
    ("flight", r"flight(id|no|num(ber)?)?|callsign|flt(no|id)?|trip"),
)
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_ENDING = re.compile(r"_(ft|m|km|kts?|kn|knots|mps|m_s|ms|kmh|hPa|Pa|mb|degC|C|K|deg|rad)$", re.I)
_SPEEDS = {
    *("wind_speed", "eastward_wind", "northward_wind", "true_airspeed", "indicated_airspeed"),
    "ground_speed",
}


Entry = str | dict[str, str]  # a canonical name, or one with its unit, parts or value


class ProposedMapping(TypedDict):
    """How an unknown table would be read."""

    columns: dict[str, Entry]
    yaml: str  # the same as text with its guesses marked
    unused: list[str]  # columns nothing was found for
    missing: list[str]  # what is needed and was not found


def propose_mapping(path: str | Path) -> ProposedMapping | None:
    """Propose how an unknown table would be read.

    Parameters
    ----------
    path : path
        CSV or Parquet.

    Returns
    -------
    dict or None
        None where nothing at all was recognised.

    Raises
    ------
    InputError
        The file is no table.
    """
    table = first_rows(Path(path))
    found: dict[str, str] = {}
    for column in map(str, table.columns):
        name = _stem(column)
        if name is not None and name not in found:
            found[name] = column
    if len(found) < 2:
        return None
    mapping: dict[str, Entry] = {}
    remarks: dict[str, str] = {}
    _time(table, found, mapping, remarks)
    if _reports_compass(set(found)):
        found["magnetic_heading"] = found.pop("heading")
        remarks[found["magnetic_heading"]] = "magnetic is a guess: heading_deg where it is true"
    for name, column in found.items():
        if name != "time":
            mapping[column] = _entry(name, column, table[column], remarks)
    if "tail" not in found:
        mapping["tail"] = {"value": re.sub(r"\W+", "_", Path(path).name.split(".")[0])}
        remarks["tail"] = "one aircraft a file is a guess: say it, or the column that tells it"
    used = {
        one for value in mapping.values() if isinstance(value, Mapping) for one in _texts(value)
    }
    unused = [c for c in map(str, table.columns) if c not in mapping and c not in used]
    return {
        "columns": mapping,
        "yaml": _as_yaml(mapping, remarks),
        "unused": unused,
        "missing": _missing(set(found)),
    }


def _reports_compass(found: set[str]) -> bool:
    """Whether a plain heading stands among what a transponder or a recorder reports."""
    airspeed = found & {"true_airspeed", "indicated_airspeed", "mach"}
    return (
        {"heading", "ground_speed", "track"} <= found
        and "magnetic_heading" not in found
        and bool(airspeed)
    )


def _texts(value: Mapping[str, object]) -> list[str]:
    return [str(one) for key, one in value.items() if key in ("date", "time", "offset")]


def _stem(column: str) -> str | None:
    """What a column is by its name."""
    known = split_name(column.strip())
    if known is not None:
        return next(stem for stem, one in QUANTITIES.items() if one is known[0])
    plain = _ENDING.sub("", _BRACKET.sub("", column.strip()))
    plain = re.sub(r"[^a-z0-9]", "", plain.lower())
    return next((name for name, names in _NAMES if re.fullmatch(names, plain)), None)


def _time(
    table: pd.DataFrame, found: dict[str, str], mapping: dict[str, Entry], remarks: dict[str, str]
) -> None:
    """The time's column, or the two that make it."""
    of_time = [c for c in map(str, table.columns) if _stem(c) == "time"]
    dates = [c for c in of_time if re.search(r"date|day", c, re.I) and not _has_clock(table[c])]
    clocks = [c for c in of_time if c not in dates]
    if dates and clocks and not _has_date(table[clocks[0]]):
        mapping["time"] = {"date": dates[0], "time": clocks[0]}
        found["time"] = "time"
    elif of_time:
        found["time"] = (clocks or of_time)[0]
        mapping[found["time"]] = "time"
        if pd.api.types.is_numeric_dtype(table[found["time"]]):
            remarks[found["time"]] = "seconds or milliseconds since 1970"


def _has_clock(column: Column) -> bool:
    return bool(column.dropna().astype(str).str.contains(r"\d:\d\d").any())


def _has_date(column: Column) -> bool:
    text = column.dropna().astype(str)
    numeric = pd.api.types.is_numeric_dtype(column)
    return bool(numeric or text.str.contains(r"\d{4}-?\d\d-?\d\d|\d+/\d+/\d+").any())


def _entry(name: str, column: str, values: Column, remarks: dict[str, str]) -> Entry:
    """Canonical name of a column, with the unit that its name or its values tell."""
    quantity = QUANTITIES.get(name)
    if quantity is None:
        return name
    known = split_name(column.strip())
    canonical = quantity.canonical
    if known is not None:
        return canonical if known[1] == "degree" else {"name": canonical, "unit": known[1]}
    written = _BRACKET.search(column) or _ENDING.search(column)
    if written and compatible(written.group(1), quantity.si_unit):
        return {"name": canonical, "unit": written.group(1)}
    unit, why = _guessed(name, pd.to_numeric(values, errors="coerce").to_numpy(dtype=float))
    if why:
        remarks[column] = why
    return canonical if unit is None else {"name": canonical, "unit": unit}


def _guessed(name: str, values: NDArray[np.float64]) -> tuple[str | None, str]:
    """Unit by the size of the values, and the remark that says so."""
    known = np.abs(values[np.isfinite(values)])
    largest = float(known.max()) if known.size else 0.0
    if name == "pressure":
        # 1013 hPa is the largest there is, and the least at flight level still 15,000 Pa.
        return ("Pa" if largest > 2000 else "hPa"), "unit guessed from its values"
    if name == "pressure_altitude":
        # Flight levels are hundreds of feet: no aircraft is above 60,000 ft.
        if largest <= 600 and largest > 0:
            return "hft", "flight levels guessed from its values"
        # In metres that is above most airliners; in feet half of all flight is.
        return ("ft" if largest > 15_500 else "m"), "unit guessed from its values"
    if name == "temperature":
        # no air is as warm as 150 degC, none as cold as 150 K
        return ("K" if largest > 150 else "degC"), "unit guessed from its values"
    if name in _SPEEDS:
        airborne = name in ("true_airspeed", "ground_speed", "indicated_airspeed")
        # 340 m/s is the speed of sound: no transport flies at it, at 340 kt many do.
        unit = "kt" if not airborne or largest > 340 else "m/s"
        return unit, "kt or m/s cannot be told from the name: please check"
    return None, ""


def _missing(found: set[str]) -> list[str]:
    """Names of what is needed beside what was found."""
    absent = [name for name in REQUIRED if name not in found and name != "tail"]
    if not found & {"pressure_altitude", "pressure"}:
        absent.append("pressure_altitude_ft or pressure_hPa")
    reported = {"wind_direction", "wind_speed"} <= found
    components = {"eastward_wind", "northward_wind"} <= found
    derived = (
        found & {"heading", "magnetic_heading"}
        and found & {"true_airspeed", "mach", "indicated_airspeed"}
        and {"ground_speed", "track"} <= found
    )
    if not (reported or components or derived):
        absent.append("a wind, or heading, airspeed, ground_speed and track")
    return absent


def _as_yaml(mapping: Mapping[str, object], remarks: Mapping[str, str]) -> str:
    lines = ["columns:"]
    for key, value in mapping.items():
        left, right = (_in_yaml(one) for one in (key, value))
        remark = f"   # {remarks[key]}" if key in remarks else ""
        lines.append(f"  {left}: {right}{remark}")
    return "\n".join(lines)


def _in_yaml(value: object) -> str:
    import yaml

    return yaml.safe_dump(value, default_flow_style=True, width=1000).split("\n")[0]
