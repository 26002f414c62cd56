"""Logs of flight recorders and receivers: Garmin flight decks, readsb, Mode-S.

G1000 and relatives (log versions 1.00 to 1.03) write local date and time, and an altitude indicated
at the setting ``BaroA``; G3X and G5 write names in words with units, then a line of short names.
Magnetic directions are turned to true north by the IGRF declination. The wind is derived, because
the deck's wind is smoothed over many seconds. Source: Garmin, G1000 and G3X Touch pilot's guides.

JSON traces of readsb and tar1090 hold one aircraft and day: ``icao``, ``timestamp`` (the epoch) and
points, each a list of seconds since then, latitude, longitude, barometric altitude (ft) or
``"ground"``, ground speed (kt), track (degrees true), flags, vertical rate, and possibly an object
for this point only (readsb, README-json.md). Decoded Mode-S messages are one object each, as lines,
entries of a list or columns of a table, with values directly or within ``bds50`` and ``bds60``
(magnetic heading).
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.reports.audit import Audit
from airswing.reports.cleaning import declination
from airswing.reports.columns import (
    LAYOUTS,
    Mapped,
    from_epoch,
    numbers,
    parse_times,
    roll_flags,
    seconds_since_1970,
    sources,
)
from airswing.reports.formats import ReportFormat, content_of, is_text, opened
from airswing.reports.formats.tabular import ROWS_PER_PIECE, csv_pieces, merge_messages, to_raw
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

_INCH_OF_MERCURY = 3386.389  # Pa at 0 degC (NIST SP 811)
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
        matches = (name for name in names if re.fullmatch(rf"({pattern})(\s*\([^)]*\)\s*)?", name))
        columns[key] = next(matches, None)
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
    tail = identity or path.name.split(".")[0]
    # A line of short names may follow the names in words.
    second = number + 1 < len(lines) and _HEADER.search(lines[number + 1]) is not None
    rows = 0
    for table in csv_pieces(
        path,
        (names, ",", number + 1 + second),
        audit,
        names=names,
        dtype=str,
        skipinitialspace=True,
        chunksize=ROWS_PER_PIECE,
        on_bad_lines="warn",
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
    has_time = (text["date"] != "") & (text["clock"] != "")
    time, blank = parse_times((text["date"] + "T" + text["clock"] + ahead).where(has_time, ""))
    # Indicated to pressure altitude: the standard altitude of the setting, zero at 29.92.
    above = np.nan_to_num(altitude_from_pressure(number["setting"]))
    reported = number["pressure_altitude"]
    altitude = np.where(np.isnan(reported), number["indicated_altitude"] + above, reported)
    track = number["track"]
    if "true" not in (columns["track"] or "").lower():
        track += declination(
            number["latitude"], number["longitude"], altitude, seconds_since_1970(time)
        )
    copied = ("latitude", "longitude", "air_temperature", "ground_speed", "reported_airspeed")
    return pd.DataFrame(
        {
            "tail": tail,
            "time": time,
            "time_blank": blank,
            "pressure_altitude": altitude,
            "magnetic_heading": number["heading"] % 360.0,
            "track": track % 360.0,
            "roll_flag": roll_flags(number["roll"]),
            **{name: number[name] for name in (*copied, "indicated_airspeed")},
        }
    )


def _is_log(start: bytes) -> bool:
    text = start[:4096].decode("latin-1")
    g1000 = all(name in text for name in ("Lcl Date", "Lcl Time", "UTCOfst"))
    g3x = "GPS Ground Track" in text or "Magnetic Heading" in text
    return g1000 or (g3x and _HEADER.search(text) is not None)


# --- JSON ----------------------------------------------------------------------------------------

_TRACE_NUMBERS = {
    "mag_heading": ("magnetic_heading", 1.0, 0.0),
    "true_heading": ("reported_heading", 1.0, 0.0),
    "ias": ("indicated_airspeed", KNOT, 0.0),
    "tas": ("reported_airspeed", KNOT, 0.0),
    "mach": ("mach", 1.0, 0.0),
    "oat": ("air_temperature", 1.0, ZERO_CELSIUS),
}
_KEYS = (
    *("timestamp", "icao24", "callsign", "latitude", "longitude", "altitude", "groundspeed"),
    *("track", "heading", "IAS", "TAS", "Mach"),
)
_MESSAGE_NEEDED = next(layout for layout in LAYOUTS if layout.messages).signature
# An integer beyond 64 bits would be refused by an array of numbers.
_loads = partial(json.loads, parse_int=lambda digits: (int if len(digits) < 20 else float)(digits))


def _read_trace(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    content = _loads(content_of(path))
    content = content if isinstance(content, dict) else {}
    points, begin = content.get("trace"), content.get("timestamp")
    if not isinstance(points, list) or not isinstance(begin, int | float):
        raise InputError(
            "is not a trace of an aircraft",
            field="timestamp" if isinstance(points, list) else "trace",
            found=", ".join(map(str, content))[:200],
            remedy="Traces have icao, timestamp and trace",
        )
    # Older writers leave out the last entries; the track is the sixth and the last that is needed.
    complete = [point for point in points if isinstance(point, list) and len(point) >= 6]
    audit.drop("ragged_row", len(points) - len(complete), unread=True)
    # The first flag bit of a point says that its position is older than its time.
    flags = [point[6] if len(point) > 6 and isinstance(point[6], int) else 0 for point in complete]
    flying = [p for p, f in zip(complete, flags, strict=True) if p[3] != "ground" and not f & 1]
    audit.drop("on_ground_or_stale", len(complete) - len(flying), unread=True)
    if not flying:
        raise InputError("holds no reports")
    details = [p[8] if len(p) > 8 and isinstance(p[8], dict) else {} for p in flying]
    place = pd.DataFrame([point[:6] for point in flying]).apply(numbers)
    detail_columns = pd.DataFrame(details, columns=[*_TRACE_NUMBERS, "roll"]).apply(numbers)
    yield pd.DataFrame(
        {
            "tail": str(content.get("icao", "")).lstrip("~").upper(),
            "time": from_epoch(float(begin) + place[0].to_numpy()),
            "latitude": place[1],
            "longitude": place[2],
            "pressure_altitude": place[3] * FOOT,
            "ground_speed": place[4] * KNOT,
            "track": place[5],
            "flight": [str(values.get("flight") or "").strip() for values in details],
            "roll_flag": roll_flags(detail_columns["roll"].to_numpy()),
            **{
                ours: detail_columns[theirs] * factor + offset
                for theirs, (ours, factor, offset) in _TRACE_NUMBERS.items()
            },
        }
    )


def _read_messages(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    content = content_of(path).decode("utf-8", "replace")
    document = _parsed(content)
    if document is None:
        document = [_parsed(line) for line in content.splitlines() if line.strip()]
    messages = document if isinstance(document, list) else [document]
    rows = [message for message in messages if isinstance(message, Mapping)]
    audit.drop("ragged_row", len(messages) - len(rows), unread=True)
    if len(rows) == 1 and isinstance(rows[0].get("icao24"), Mapping | list):
        table = pd.DataFrame({key: pd.Series(rows[0].get(key)) for key in _KEYS if key in rows[0]})
    else:
        table = pd.DataFrame.from_records([_flat(row) for row in rows])
    if not set(table.columns) >= _MESSAGE_NEEDED:
        raise InputError(
            "holds no decoded Mode-S messages with positions",
            field=", ".join(sorted(_MESSAGE_NEEDED - set(table.columns))),
            found=", ".join(map(str, table.columns))[:300],
        )
    matched = sources([str(name) for name in table.columns], mapping)
    yield merge_messages(to_raw(table, matched, audit), audit)


def _parsed(text: str) -> object:
    """Text parsed as JSON, None if invalid: a recording may end in the middle of a line."""
    try:
        return _loads(text)
    except (ValueError, RecursionError):
        return None


def _flat(message: Mapping[str, object]) -> dict[str, object]:
    values: dict[str, object] = {}
    for section in (message, message.get("bds50"), message.get("bds60")):
        if isinstance(section, Mapping):
            values |= {key: section[key] for key in _KEYS if section.get(key) is not None}
    return values


def _is_trace(start: bytes) -> bool:
    beginning = start[:1000].lstrip()
    return is_text(start) and beginning.startswith(b"{") and b'"icao"' in beginning


def _is_messages(start: bytes) -> bool:
    bracket = re.match(rb"\s*(\[\s*)?\{", start)
    return is_text(start) and bracket is not None and b'"icao24"' in start


FORMATS = (
    ReportFormat("g1000", _is_log, _read_log, title="a log of a Garmin flight deck"),
    ReportFormat("readsb", _is_trace, _read_trace, title="a JSON trace"),
    ReportFormat("mode_s", _is_messages, _read_messages, title="JSON"),
)
