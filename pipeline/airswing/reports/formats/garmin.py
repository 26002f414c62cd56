"""Logs of Garmin flight decks and instruments: one aircraft a file, a row a second.

G1000 and relatives (log versions 1.00 to 1.03)
    Airframe (``#airframe_info,...``), units and names stand before the rows. Date and time are
    local; ``UTCOfst`` is local time minus UTC. ``HDG`` and ``TRK`` are magnetic (the deck shows
    both so). The altitude is ``AltB``, from version 1.03 on ``AltInd``: the altitude indicated at
    the setting ``BaroA`` (inches of mercury). Pressure altitude is it plus the standard
    atmosphere's altitude of that setting.
G3X, G3X Touch, G5
    Names in words with units, then a second line of short names. Time is UTC or local with an
    offset, the track is true where its unit says so, heading is magnetic and the altitude is the
    pressure altitude.

Magnetic directions are turned to true north by the IGRF declination, not by the log's variation.
The aircraft is the tail number of the first line, else its system's identity, else the name of the
file. The wind is derived from heading, true airspeed, track and ground speed, because the deck's
wind (``WndSpd``, ``WndDr``) is smoothed over many seconds. Rows before the receiver has a position
hold no report and are counted.

Source: layout of the logs as the decks write them (Garmin, G1000 pilot's guide, flight data
logging; G3X Touch pilot's guide, data log).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.reports.audit import Audit
from airswing.reports.cleaning import declination
from airswing.reports.columns import Mapped
from airswing.reports.formats import (
    ReportFormat,
    compression_of,
    constant_tail,
    lines_of,
    register,
)
from airswing.reports.values import parse_times, roll_flags
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

INCH_OF_MERCURY = 3386.389  # Pa at 0 degC (NIST SP 811)
ROWS_PER_PIECE = 100_000
_IDENTITIES = ("tail_number", "aircraft_ident", "registration", "system_id")
# What a column is, by its name without unit: short names of G1000, names in words of G3X and G5.
_NAMES = {
    "date": r"Lcl Date|UTC Date|Local Date",
    "clock": r"Lcl Time|UTC Time|Local Time",
    "ahead": r"UTCOfst|UTC Offset",
    "latitude": r"Latitude",
    "longitude": r"Longitude",
    "pressure_altitude": r"Pressure Altitude",
    "indicated_altitude": r"AltB|AltInd|Baro Altitude|Baro-Corrected Altitude",
    "setting": r"BaroA|Baro Setting|Altimeter Setting",
    "air_temperature": r"OAT|Outside Air Temp(erature)?",
    "heading": r"HDG|Magnetic Heading",
    "track": r"TRK|GPS Ground Track",
    "ground_speed": r"GndSpd|GPS Ground Speed",
    "reported_airspeed": r"TAS|True Airspeed",
    "indicated_airspeed": r"IAS|Indicated Airspeed",
    "roll": r"Roll",
}
_NEEDED = ("date", "clock", "latitude", "longitude", "heading", "track")
_HEADER = re.compile(rb"(Lcl|UTC|Local) Date")
_UNIT = re.compile(r"\s*\(([^)]*)\)\s*$")


def _read_log(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    lines = lines_of(path, 6)
    number = next((n for n, line in enumerate(lines) if _HEADER.search(line.encode())), None)
    if number is None:
        raise InputError(
            "is no log of a Garmin flight deck: none of its first lines names Lcl Date or UTC Date",
            file=path,
            found=lines[0][:200],
            remedy="Leave out format, or map the columns of another recorder's log",
        )
    names = [name.strip() for name in next(csv.reader([lines[number].lstrip("# ")]))]
    columns = {
        key: next((name for name in names if re.fullmatch(pattern, _UNIT.sub("", name))), None)
        for key, pattern in _NAMES.items()
    }
    absent = [key for key in _NEEDED if columns[key] is None]
    if columns["pressure_altitude"] is None and columns["indicated_altitude"] is None:
        absent.append("altitude")
    if absent:
        raise InputError(
            "is a flight deck's log without a column it needs",
            file=path,
            field=", ".join(absent),
            found=", ".join(names[:40]),
            remedy="Headings, tracks, altitudes and positions must be among what the deck logs",
        )
    facts = dict(re.findall(r'(\w+)="?([^",]*)"?', lines[0])) if lines[0].startswith("#") else {}
    identity = next((facts[n].strip() for n in _IDENTITIES if facts.get(n, "").strip()), "")
    tail = constant_tail(mapping) or identity or path.name.split(".")[0]
    # A line of short names may follow the names in words.
    second = number + 1 < len(lines) and _HEADER.search(lines[number + 1].encode()) is not None
    tables = pd.read_csv(
        path,
        header=None,
        skiprows=number + 1 + second,
        names=names,
        index_col=False,
        dtype=str,
        skipinitialspace=True,
        chunksize=ROWS_PER_PIECE,
        on_bad_lines="skip",
        keep_default_na=False,
        encoding_errors="replace",
        compression=compression_of(path),
    )
    rows = 0
    for table in tables:
        rows += len(table)
        yield _raw(table, tail, columns)
    if not rows:
        raise InputError("has a header but no reports", file=path)


def _raw(table: pd.DataFrame, tail: str, columns: dict[str, str | None]) -> pd.DataFrame:
    def text(key: str) -> pd.Series[str]:
        name = columns[key]
        if name is None:
            return pd.Series("", index=table.index)
        return table[name].fillna("").str.strip()

    def number(key: str, factor: float = 1.0, offset: float = 0.0) -> NDArray[np.float64]:
        values = pd.to_numeric(text(key), errors="coerce")
        return values.to_numpy(dtype=np.float64) * factor + offset

    date, clock = text("date"), text("clock")
    utc = (columns["clock"] or "").startswith("UTC")
    given = (date != "") & (clock != "")
    time, blank = parse_times(
        (date + "T" + clock + ("" if utc else text("ahead"))).where(given, "")
    )
    latitude, longitude = number("latitude"), number("longitude")
    # Indicated to pressure altitude: the standard altitude of the setting, zero at 29.92.
    setting = altitude_from_pressure(number("setting", INCH_OF_MERCURY))
    altitude = number("indicated_altitude", FOOT) + np.nan_to_num(setting)
    reported = number("pressure_altitude", FOOT)
    altitude = np.where(np.isnan(reported), altitude, reported)
    seconds = time.astype("datetime64[ns]").astype(np.int64) / 1e9
    east = declination(latitude, longitude, altitude, seconds)
    track_is_true = "true" in (columns["track"] or "").lower()
    return pd.DataFrame(
        {
            "tail": tail,
            "time": time,
            "time_blank": blank,
            "latitude": latitude,
            "longitude": longitude,
            "pressure_altitude": altitude,
            "air_temperature": number("air_temperature", 1.0, ZERO_CELSIUS),
            "reported_heading": (number("heading") + east) % 360.0,
            "track": (number("track") + (0.0 if track_is_true else east)) % 360.0,
            "ground_speed": number("ground_speed", KNOT),
            "reported_airspeed": number("reported_airspeed", KNOT),
            "indicated_airspeed": number("indicated_airspeed", KNOT),
            "roll_flag": roll_flags(number("roll")),
        }
    )


def _recognises(start: bytes) -> bool:
    start = start[:4096]
    g1000 = b"Lcl Date" in start and b"Lcl Time" in start and b"UTCOfst" in start
    g3x = _HEADER.search(start) is not None and (
        b"GPS Ground Track" in start or b"Magnetic Heading" in start
    )
    return g1000 or g3x


register(ReportFormat("g1000", _recognises, _read_log))
