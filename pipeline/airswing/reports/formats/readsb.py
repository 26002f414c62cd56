"""Traces of ADS-B receivers (readsb, tar1090): one aircraft and day a file, JSON.

Assumes that ``icao`` names the aircraft and ``timestamp`` is the epoch of the trace. Each point is
a list: seconds since then, latitude, longitude, barometric altitude in feet or ``"ground"``, ground
speed in knots, track in degrees true, flags, vertical rate, and in some points an object of what
else the aircraft sent: ``mag_heading``, ``true_heading``, ``ias``, ``tas``, ``mach``, ``oat``,
``roll``, ``flight``. The values of such an object hold for its point only. Points on the ground and
stale ones (flag bit 1) are left out and counted.

Source: readsb README-json.md ("trace jsons").
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.columns import Mapped
from airswing.reports.formats import ReportFormat, content_of, is_text, register
from airswing.reports.values import from_epoch, roll_flags
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

STALE = 1  # flag bit of a point whose position is older than its time
_NUMBERS = {
    "mag_heading": ("magnetic_heading", 1.0, 0.0),
    "true_heading": ("reported_heading", 1.0, 0.0),
    "ias": ("indicated_airspeed", KNOT, 0.0),
    "tas": ("reported_airspeed", KNOT, 0.0),
    "mach": ("mach", 1.0, 0.0),
    "oat": ("air_temperature", 1.0, ZERO_CELSIUS),
}


def _read_trace(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    try:
        content = json.loads(content_of(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"cannot be read as JSON: {error}", file=path) from error
    content = content if isinstance(content, dict) else {}
    points, begin = content.get("trace"), content.get("timestamp")
    if not isinstance(points, list) or not isinstance(begin, int | float):
        raise InputError(
            "is no trace of an aircraft",
            file=path,
            field="timestamp" if isinstance(points, list) else "trace",
            found=", ".join(map(str, content))[:200],
            remedy="Traces have icao, timestamp and trace",
        )
    # Older writers leave out the last entries; the track is the sixth and the last that is needed.
    whole = [point for point in points if isinstance(point, list) and len(point) >= 6]
    audit.drop("ragged_row", len(points) - len(whole), unread=True)
    flying = [point for point in whole if point[3] != "ground" and not _stale(point)]
    audit.drop("on_ground_or_stale", len(whole) - len(flying), unread=True)
    if not flying:
        raise InputError("holds no reports", file=path)
    yield _raw(flying, str(content.get("icao", "")).lstrip("~").upper(), float(begin))


def _stale(point: list[object]) -> bool:
    return len(point) > 6 and isinstance(point[6], int) and bool(point[6] & STALE)


def _raw(points: list[list[object]], tail: str, begin: float) -> pd.DataFrame:
    def column(place: int) -> NDArray[np.float64]:
        return np.array([as_float(point[place]) for point in points])

    others = [point[8] if len(point) > 8 and isinstance(point[8], dict) else {} for point in points]

    def other(key: str) -> NDArray[np.float64]:
        return np.array([as_float(values.get(key)) for values in others])

    raw: dict[str, object] = {
        "tail": tail,
        "time": from_epoch(begin + column(0)),
        "latitude": column(1),
        "longitude": column(2),
        "pressure_altitude": column(3) * FOOT,
        "ground_speed": column(4) * KNOT,
        "track": column(5),
        "flight": [str(values.get("flight") or "").strip() for values in others],
        "roll_flag": roll_flags(other("roll")),
    }
    for theirs, (ours, factor, offset) in _NUMBERS.items():
        raw[ours] = other(theirs) * factor + offset
    return pd.DataFrame(raw)


def as_float(value: object) -> float:
    """Return a number of a JSON document; NaN for any other value."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return float("nan")
    try:
        return float(value)
    except OverflowError:
        return float("nan")


def _recognises(start: bytes) -> bool:
    head = start[:1000].lstrip()
    return is_text(start) and head.startswith(b"{") and b'"icao"' in head


register(ReportFormat("readsb", _recognises, _read_trace))
