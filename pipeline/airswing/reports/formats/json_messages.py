"""JSON of receivers: traces of readsb and tar1090, and decoded Mode-S messages.

Traces hold one aircraft and day: ``icao``, ``timestamp`` (the epoch) and points, each a list of
seconds since then, latitude, longitude, barometric altitude (ft) or ``"ground"``, ground speed
(kt), track (degrees true), flags, vertical rate, and possibly an object for this point only
(readsb, README-json.md). Messages are one object each, as lines, entries of a list or columns of a
table, with decoded values directly or within ``bds50`` and ``bds60`` (magnetic heading).
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.columns import LAYOUTS, Mapped, from_epoch, roll_flags, sources
from airswing.reports.formats import ReportFormat, content_of, is_text
from airswing.reports.formats.tabular import merged, to_raw
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

_NUMBERS = {
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
_NEEDED = next(layout for layout in LAYOUTS if layout.messages).signature


def _read_trace(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    content = json.loads(content_of(path))
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
    whole = [point for point in points if isinstance(point, list) and len(point) >= 6]
    audit.drop("ragged_row", len(points) - len(whole), unread=True)
    # The first flag bit of a point says that its position is older than its time.
    flags = [point[6] if len(point) > 6 and isinstance(point[6], int) else 0 for point in whole]
    flying = [p for p, flag in zip(whole, flags, strict=True) if p[3] != "ground" and not flag & 1]
    audit.drop("on_ground_or_stale", len(whole) - len(flying), unread=True)
    if not flying:
        raise InputError("holds no reports")
    others = [p[8] if len(p) > 8 and isinstance(p[8], dict) else {} for p in flying]

    def floats(values: Iterable[object]) -> NDArray[np.float64]:
        return np.array([_as_float(value) for value in values])

    place = [floats(point[n] for point in flying) for n in range(6)]
    other = {key: floats(values.get(key) for values in others) for key in (*_NUMBERS, "roll")}
    yield pd.DataFrame(
        {
            "tail": str(content.get("icao", "")).lstrip("~").upper(),
            "time": from_epoch(float(begin) + place[0]),
            "latitude": place[1],
            "longitude": place[2],
            "pressure_altitude": place[3] * FOOT,
            "ground_speed": place[4] * KNOT,
            "track": place[5],
            "flight": [str(values.get("flight") or "").strip() for values in others],
            "roll_flag": roll_flags(other["roll"]),
            **{
                ours: other[theirs] * factor + offset
                for theirs, (ours, factor, offset) in _NUMBERS.items()
            },
        }
    )


def _as_float(value: object) -> float:
    """A number of a JSON document; NaN for any other value."""
    with contextlib.suppress(OverflowError):
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    return float("nan")


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
    if not set(table.columns) >= _NEEDED:
        raise InputError(
            "holds no decoded Mode-S messages with positions",
            field=", ".join(sorted(_NEEDED - set(table.columns))),
            found=", ".join(map(str, table.columns))[:300],
        )
    names = [str(name) for name in table.columns]
    found = sources(names, mapping)
    yield merged(to_raw(table, found, audit), audit)


def _parsed(text: str) -> object:
    """Text parsed as JSON, None if invalid: a recording may end in the middle of a line."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _flat(message: Mapping[str, object]) -> dict[str, object]:
    values: dict[str, object] = {}
    for part in (message, message.get("bds50"), message.get("bds60")):
        if isinstance(part, Mapping):
            values |= {key: part[key] for key in _KEYS if part.get(key) is not None}
    return values


def _is_trace(start: bytes) -> bool:
    beginning = start[:1000].lstrip()
    return is_text(start) and beginning.startswith(b"{") and b'"icao"' in beginning


def _is_messages(start: bytes) -> bool:
    bracket = re.match(rb"\s*(\[\s*)?\{", start)
    return is_text(start) and bracket is not None and b'"icao24"' in start


FORMATS = (
    ReportFormat("readsb", _is_trace, _read_trace, title="a JSON trace"),
    ReportFormat("mode_s", _is_messages, _read_messages, title="JSON"),
)
