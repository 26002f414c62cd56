"""Logs of Garmin G1000 flight decks: one aircraft a file, a row a second.

Assumptions
-----------
Three lines stand before the rows: what airframe it is (``#airframe_info,...``), units, names. Date
and time are local, ``UTCOfst`` is what they are ahead of UTC. ``HDG`` and ``TRK`` are magnetic (the
deck shows both so); both are turned to true north by the IGRF declination. ``AltB`` is the altitude
shown at the setting ``BaroA`` (inches of mercury): pressure altitude is it plus the standard
atmosphere's altitude of that setting. The aircraft is the tail number of the first line, else its
system's identity, else the file's name.

The wind is derived here from heading, true airspeed, track and ground speed: the deck's own
(``WndSpd``, ``WndDr``) is smoothed over many seconds. Rows before the receivers have a position
hold no report and are counted.

Source: layout of the logs as the deck writes them (Garmin, G1000 pilot's guide, flight data
logging).
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
from airswing.physics.geomagnetism import FieldLattice
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.codes import roll_flags
from airswing.reports.canonical.report_formats import Mapped, ReportFormat, register
from airswing.reports.canonical.times import parse_times
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

INCH_OF_MERCURY = 3386.389  # Pa at 0 degC (NIST SP 811)
# Rows in memory at a time: a record of a second each has some sixty columns of text.
ROWS_PER_PIECE = 100_000
_NEEDED = ("Lcl Date", "Lcl Time", "UTCOfst", "Latitude", "Longitude", "AltB", "HDG", "TRK")
_OWNERS = ("tail_number", "aircraft_ident", "registration", "system_id")


def _g1000_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one log (of the user's columns only a constant ``tail`` counts)."""
    lines = _first_lines(path)
    number = next(n for n, line in enumerate(lines) if "Lcl Date" in line and "Lcl Time" in line)
    names = [name.strip() for name in next(csv.reader([lines[number].lstrip("# ")]))]
    absent = [name for name in _NEEDED if name not in names]
    if absent:
        raise InputError(
            "is a flight deck's log without a column it needs",
            file=path,
            field=", ".join(absent),
            found=", ".join(names[:40]),
            remedy="Headings, tracks and positions must be among what the deck logs",
        )
    tail = str(mapping["tail"][1].value) if _has_constant(mapping) else _owner(lines, path)
    tables = pd.read_csv(
        path,
        header=None,
        skiprows=number + 1,
        names=names,
        index_col=False,
        dtype=str,
        skipinitialspace=True,
        chunksize=ROWS_PER_PIECE,
        on_bad_lines="skip",
        keep_default_na=False,
        encoding_errors="replace",
    )
    rows = 0
    for table in tables:
        rows += len(table)
        yield _piece(table, tail)
    if not rows:
        raise InputError("has a header but no reports", file=path)


def _has_constant(mapping: Mapped) -> bool:
    return "tail" in mapping and mapping["tail"][1].value is not None


def _first_lines(path: Path) -> list[str]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return [file.readline(20_000) for _ in range(6)]


def _owner(lines: list[str], path: Path) -> str:
    told = dict(re.findall(r'(\w+)="?([^",]*)"?', lines[0])) if lines[0].startswith("#") else {}
    found = next((told[name].strip() for name in _OWNERS if told.get(name, "").strip()), "")
    return found or path.name.split(".")[0]


def _piece(table: pd.DataFrame, tail: str) -> pd.DataFrame:
    def number(name: str, factor: float = 1.0, offset: float = 0.0) -> NDArray[np.float64]:
        if name not in table:
            return np.full(len(table), np.nan)
        values = pd.to_numeric(table[name].str.strip(), errors="coerce")
        return values.to_numpy(dtype=np.float64) * factor + offset

    parts = (table[name].str.strip() for name in ("Lcl Date", "Lcl Time", "UTCOfst"))
    date, clock, ahead = parts
    whole = (date != "") & (clock != "")
    text = (date + "T" + clock + ahead).where(whole, "")
    time, blank = parse_times(text)
    latitude, longitude = number("Latitude"), number("Longitude")
    altitude = number("AltB", FOOT)
    setting = number("BaroA", INCH_OF_MERCURY)
    # QNH to pressure altitude: the standard altitude of the setting, zero at 29.92.
    altitude = altitude + np.nan_to_num(altitude_from_pressure(setting))
    seconds = time.astype("datetime64[ns]").astype(np.int64) / 1e9
    place = (latitude, longitude, np.nan_to_num(altitude), seconds)
    declination = np.degrees(FieldLattice.covering(*place).at(*place).declination)
    return pd.DataFrame(
        {
            "tail": tail,
            "time": time,
            "time_blank": blank,
            "latitude": latitude,
            "longitude": longitude,
            "pressure_altitude": altitude,
            "air_temperature": number("OAT", 1.0, ZERO_CELSIUS),
            "reported_heading": (number("HDG") + declination) % 360.0,
            "track": (number("TRK") + declination) % 360.0,
            "ground_speed": number("GndSpd", KNOT),
            "reported_airspeed": number("TAS", KNOT),
            "indicated_airspeed": number("IAS", KNOT),
            "roll_flag": roll_flags(number("Roll")),
        }
    )


def _tells(start: bytes) -> bool:
    head = start[:4096]
    return b"Lcl Date" in head and b"Lcl Time" in head and b"UTCOfst" in head


register(ReportFormat("g1000", _tells, _g1000_pieces))
