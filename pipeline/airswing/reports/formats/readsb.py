"""Traces of ADS-B receivers (readsb, tar1090): one aircraft and day a file, JSON.

Assumptions
-----------
``icao`` names the aircraft, ``timestamp`` is the epoch of the trace, each point is a list: seconds
since then, latitude, longitude, barometric altitude in feet or ``"ground"``, ground speed in knots,
track in degrees from true north, flags, vertical rate, and now and then an object with what else
the aircraft sent: ``mag_heading``, ``true_heading``, ``ias``, ``tas``, ``mach``, ``oat``, ``roll``,
``flight``. What such an object holds counts for its own point alone. Points on the ground are left
out and counted; flag bits 1 (stale) likewise.

Source: readsb README-json.md ("trace jsons").
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.codes import roll_flags
from airswing.reports.canonical.report_formats import Mapped, ReportFormat, is_text, register
from airswing.reports.canonical.times import from_epoch
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

MOST_OCTETS = 1 << 28  # unpacked: few packed octets could fill any memory
# Bit of a point: its position is older than its time.
STALE = 1
_NUMBERS = {
    "mag_heading": ("magnetic_heading", 1.0, 0.0),
    "true_heading": ("reported_heading", 1.0, 0.0),
    "ias": ("indicated_airspeed", KNOT, 0.0),
    "tas": ("reported_airspeed", KNOT, 0.0),
    "mach": ("mach", 1.0, 0.0),
    "oat": ("air_temperature", 1.0, ZERO_CELSIUS),
}


def _readsb_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one trace."""
    content = _content(path)
    points = content.get("trace")
    begun = content.get("timestamp")
    if not isinstance(points, list) or not isinstance(begun, int | float):
        raise InputError(
            "is no trace of an aircraft",
            file=path,
            field="trace" if not isinstance(points, list) else "timestamp",
            found=", ".join(map(str, content))[:200],
            remedy="Traces have icao, timestamp and trace",
        )
    # Older writers leave the last entries out; track is the sixth and last that is needed.
    whole = [one for one in points if isinstance(one, list) and len(one) >= 6]
    audit.read += len(points) - len(whole)
    audit.drop("ragged_row", len(points) - len(whole))
    flying = [one for one in whole if one[3] != "ground" and not _stale(one)]
    audit.read += len(whole) - len(flying)
    audit.drop("on_ground_or_stale", len(whole) - len(flying))
    if not flying:
        raise InputError("holds no reports", file=path)
    yield _piece(flying, str(content.get("icao", "")).lstrip("~").upper(), float(begun))


def _content(path: Path) -> dict[str, object]:
    with path.open("rb") as file:
        octets = file.read(MOST_OCTETS + 1)
    if octets[:2] == b"\x1f\x8b":
        with gzip.open(path, "rb") as packed:
            octets = packed.read(MOST_OCTETS + 1)
    if len(octets) > MOST_OCTETS:
        raise InputError(f"unpacks to more than {MOST_OCTETS:,} octets", file=path)
    try:
        content = json.loads(octets)
    except (ValueError, RecursionError) as error:
        raise InputError(f"cannot be read as JSON: {error}", file=path) from error
    if not isinstance(content, dict):
        raise InputError("is no trace of an aircraft", file=path)
    return content


def _stale(point: list[object]) -> bool:
    return len(point) > 6 and isinstance(point[6], int) and bool(point[6] & STALE)


def _piece(points: list[list[object]], tail: str, begun: float) -> pd.DataFrame:
    def column(place: int) -> NDArray[np.float64]:
        return np.array([_float(point[place]) for point in points])

    # a point: seconds, latitude, longitude, feet, knots, track, flags, climb, what else is known
    extras = [_extra(point) for point in points]
    seconds = begun + column(0)
    roll = np.array([_float(extra.get("roll")) for extra in extras])
    piece: dict[str, object] = {
        "tail": tail,
        "time": from_epoch(seconds),
        "latitude": column(1),
        "longitude": column(2),
        "pressure_altitude": column(3) * FOOT,
        "ground_speed": column(4) * KNOT,
        "track": column(5),
        "flight": [str(extra.get("flight") or "").strip() for extra in extras],
        "roll_flag": roll_flags(roll),
    }
    for theirs, (ours, factor, offset) in _NUMBERS.items():
        values = np.array([_float(extra.get(theirs)) for extra in extras])
        piece[ours] = values * factor + offset
    return pd.DataFrame(piece)


def _extra(point: list[object]) -> dict[str, object]:
    return point[8] if len(point) > 8 and isinstance(point[8], dict) else {}


def _float(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return float("nan")
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def _tells(start: bytes) -> bool:
    head = start[:1000].lstrip()
    return is_text(start) and head.startswith(b"{") and b'"icao"' in head


register(ReportFormat("readsb", _tells, _readsb_pieces))
