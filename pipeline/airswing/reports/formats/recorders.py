"""Logs of flight recorders as CSV: Garmin flight decks, and tables of Flightradar24.

G1000 and relatives (log versions 1.00 to 1.03) write local date and time, and an altitude indicated
at the setting ``BaroA``; G3X and G5 write names in words with units, then a line of short names.
Magnetic directions are turned to true north by the IGRF declination. The wind is derived, because
the deck's wind is smoothed over many seconds. ``heading`` and ``Direction`` of Flightradar24 are
the track over ground, and its aircraft is the flight. Sources: Garmin, G1000 and G3X Touch pilot's
guides; Flightradar24, "KML and CSV export tools".
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.reports.audit import Audit
from airswing.reports.cleaning import declination
from airswing.reports.columns import Mapped, numbers, parse_times, roll_flags, seconds_since_1970
from airswing.reports.formats import ReportFormat, constant_tail, is_text, opened
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

_INCH_OF_MERCURY = 3386.389  # Pa at 0 degC (NIST SP 811)
_ROWS_PER_PIECE = 100_000
_IDENTITIES = ("tail_number", "aircraft_ident", "registration", "system_id")
# Quantities by column name without unit: short names of G1000, names in words of G3X and G5.
_TEXTS = {
    "date": r"Lcl Date|UTC Date|Local Date",
    "clock": r"Lcl Time|UTC Time|Local Time",
    "ahead": r"UTCOfst|UTC Offset",
}
# Columns of numbers, with factor and offset to SI.
_NUMBERS = {
    "latitude": (r"Latitude", 1.0, 0.0),
    "longitude": (r"Longitude", 1.0, 0.0),
    "pressure_altitude": (r"Pressure Altitude", FOOT, 0.0),
    "indicated_altitude": (r"AltB|AltInd|Baro Altitude|Baro-Corrected Altitude", FOOT, 0.0),
    "setting": (r"BaroA|Baro Setting|Altimeter Setting", _INCH_OF_MERCURY, 0.0),
    "air_temperature": (r"OAT|Outside Air Temp(erature)?", 1.0, ZERO_CELSIUS),
    "heading": (r"HDG|Magnetic Heading", 1.0, 0.0),
    "track": (r"TRK|GPS Ground Track", 1.0, 0.0),
    "ground_speed": (r"GndSpd|GPS Ground Speed", KNOT, 0.0),
    "reported_airspeed": (r"TAS|True Airspeed", KNOT, 0.0),
    "indicated_airspeed": (r"IAS|Indicated Airspeed", KNOT, 0.0),
    "roll": (r"Roll", 1.0, 0.0),
}
_NEEDED = ("date", "clock", "latitude", "longitude", "heading", "track")
_HEADER = re.compile(r"(Lcl|UTC|Local) Date")
_GRANULAR = ("snapshot_id", "altitude", "heading", "latitude", "longitude", "speed")
_PLAYBACK = ("Timestamp", "UTC", "Callsign", "Position", "Altitude", "Speed", "Direction")


def _read_log(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with io.TextIOWrapper(opened(path), encoding="utf-8-sig", errors="replace") as file:
        lines = [file.readline(20_000).rstrip("\r\n") for _ in range(6)]
    number = next((n for n, line in enumerate(lines) if _HEADER.search(line)), None)
    if number is None:
        raise InputError(
            "is not a Garmin flight deck log: none of its first lines names Lcl Date or UTC Date",
            found=lines[0][:200],
            remedy="Leave out format, or map the columns of another recorder's log",
        )
    names = [name.strip() for name in next(csv.reader([lines[number].lstrip("# ")]))]
    columns = {}
    for key, pattern in (_TEXTS | {key: row[0] for key, row in _NUMBERS.items()}).items():
        known = (name for name in names if re.fullmatch(rf"({pattern})(\s*\([^)]*\)\s*)?", name))
        columns[key] = next(known, None)
    absent = [key for key in _NEEDED if columns[key] is None]
    if columns["pressure_altitude"] is None and columns["indicated_altitude"] is None:
        absent.append("altitude")
    if absent:
        raise InputError(
            "is a flight deck's log without a column it needs",
            field=", ".join(absent),
            found=", ".join(names[:40]),
            remedy="Headings, tracks, altitudes and positions must be among what the deck logs",
        )
    facts = dict(re.findall(r'(\w+)="?([^",]*)"?', lines[0])) if lines[0].startswith("#") else {}
    identity = next((facts[n].strip() for n in _IDENTITIES if facts.get(n, "").strip()), "")
    tail = constant_tail(mapping) or identity or path.name.split(".")[0]
    # A line of short names may follow the names in words.
    second = number + 1 < len(lines) and _HEADER.search(lines[number + 1]) is not None
    rows = 0
    with opened(path) as binary:
        for table in pd.read_csv(
            binary,
            header=None,
            skiprows=number + 1 + second,
            names=names,
            index_col=False,
            dtype=str,
            skipinitialspace=True,
            chunksize=_ROWS_PER_PIECE,
            on_bad_lines="skip",
            keep_default_na=False,
            encoding_errors="replace",
        ):
            rows += len(table)
            yield _of_deck(table, tail, columns)
    if not rows:
        raise InputError("has a header but no reports")


def _of_deck(table: pd.DataFrame, tail: str, columns: dict[str, str | None]) -> pd.DataFrame:
    text = {
        key: pd.Series("", table.index) if name is None else table[name].fillna("").str.strip()
        for key, name in columns.items()
    }
    number = {key: numbers(text[key], *scale) for key, (_, *scale) in _NUMBERS.items()}
    ahead = "" if (columns["clock"] or "").startswith("UTC") else text["ahead"]
    given = (text["date"] != "") & (text["clock"] != "")
    time, blank = parse_times((text["date"] + "T" + text["clock"] + ahead).where(given, ""))
    # Indicated to pressure altitude: the standard altitude of the setting, zero at 29.92.
    above = np.nan_to_num(altitude_from_pressure(number["setting"]))
    reported = number["pressure_altitude"]
    altitude = np.where(np.isnan(reported), number["indicated_altitude"] + above, reported)
    track = number["track"]
    if "true" not in (columns["track"] or "").lower():
        track += declination(
            number["latitude"], number["longitude"], altitude, seconds_since_1970(time)
        )
    kept = ("latitude", "longitude", "air_temperature", "ground_speed", "reported_airspeed")
    return pd.DataFrame(
        {
            "tail": tail,
            "time": time,
            "time_blank": blank,
            "pressure_altitude": altitude,
            "magnetic_heading": number["heading"] % 360.0,
            "track": track % 360.0,
            "roll_flag": roll_flags(number["roll"]),
            **{name: number[name] for name in (*kept, "indicated_airspeed")},
        }
    )


def _read_track(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with opened(path) as file:
        table = pd.read_csv(file, dtype=str, keep_default_na=False)
    table.columns = table.columns.str.strip()
    if set(_PLAYBACK) <= set(table):
        place = table["Position"].str.split(",", n=1, expand=True).reindex(columns=[0, 1])
        table = table.assign(latitude=place[0], longitude=place[1]).rename(
            columns={"Timestamp": "time", "Direction": "heading", "Callsign": "flight"}
            | {name: name.lower() for name in ("Altitude", "Speed")}
        )
    elif set(_GRANULAR) <= set(table):
        table = table.rename(columns={"snapshot_id": "time", "flight_id": "flight"})
        table["flight"] = table.get("flight", path.name.split(".")[0].removesuffix("_positions"))
    else:
        raise InputError(
            "is not a table of Flightradar24",
            found=", ".join(table.columns[:20]),
            remedy=f"Its columns are {', '.join(_GRANULAR)} or {', '.join(_PLAYBACK)}",
        )
    time, blank = parse_times(table["time"])
    altitude = numbers(table["altitude"], FOOT)
    flying = ~(altitude <= 0.0)
    audit.drop("on_ground_or_stale", np.count_nonzero(~flying), unread=True)
    audit.remark(
        "tables of Flightradar24 hold the track over ground and the ground speed, but no heading, "
        "airspeed or wind: only model winds can be added to them"
    )
    raw = pd.DataFrame(
        {
            "tail": constant_tail(mapping) or table["flight"],
            "flight": table["flight"],
            "time": time,
            "time_blank": blank,
            "latitude": numbers(table["latitude"]),
            "longitude": numbers(table["longitude"]),
            "pressure_altitude": altitude,
            "ground_speed": numbers(table["speed"], KNOT),
            "track": numbers(table["heading"]),
        }
    )
    yield raw.loc[flying]


def _is_log(start: bytes) -> bool:
    text = start[:4096].decode("latin-1")
    g1000 = all(name in text for name in ("Lcl Date", "Lcl Time", "UTCOfst"))
    g3x = "GPS Ground Track" in text or "Magnetic Heading" in text
    return g1000 or (g3x and _HEADER.search(text) is not None)


def _is_track(start: bytes) -> bool:
    header = start.split(b"\n")[0].decode(errors="replace")
    names = {name.strip(' "\r') for name in header.split(",")}
    return is_text(start) and (set(_GRANULAR) <= names or set(_PLAYBACK) <= names)


FORMATS = (
    ReportFormat("g1000", _is_log, _read_log, title="a log of a Garmin flight deck"),
    ReportFormat("flightradar24", _is_track, _read_track, title="a table of Flightradar24"),
)
