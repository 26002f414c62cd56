"""Mode-S messages as JSON: tables of ``traffic``, lines of rs1090 and jet1090.

Assumes one object a message with ``timestamp`` (seconds since 1970 or ISO 8601), ``icao24`` and the
decoded values: ``latitude, longitude, altitude`` (ft), ``groundspeed`` (kt), ``track``,
``callsign``; of register 5,0 ``track, groundspeed, TAS, roll`` and of register 6,0 ``heading``
(magnetic), ``IAS, Mach``, both as entries of their own or within ``bds50`` and ``bds60``. Objects
are lines, the entries of a list, or the columns of a table (pandas). The same tables saved as
Parquet or CSV are read by :mod:`airswing.reports.formats.tabular`.

Sources: rs1090 documentation (docs.rs/rs1090, decoding of BDS 5,0 and 6,0); traffic, "Mode-S data".
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.columns import LAYOUTS, Mapped, sources
from airswing.reports.formats import ReportFormat, content_of, is_text, register
from airswing.reports.formats.tabular import merged, to_raw, with_layout

_KEYS = (
    *("timestamp", "icao24", "callsign", "latitude", "longitude", "altitude", "groundspeed"),
    *("track", "heading", "IAS", "TAS", "Mach"),
)
_NEEDED = next(layout for layout in LAYOUTS if layout.messages).signature


def _read_messages(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    content = content_of(path).decode("utf-8", "replace")
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
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
            file=path,
            field=", ".join(sorted(_NEEDED - set(table.columns))),
            found=", ".join(map(str, table.columns))[:300],
        )
    names = [str(name) for name in table.columns]
    found = sources(names, with_layout(names, mapping), path)
    yield merged(to_raw(table, found, audit), audit)


def _parsed(line: str) -> object:
    """A line as JSON, None where it is none: a recording may end in the middle of a line."""
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _flat(message: Mapping[str, object]) -> dict[str, object]:
    """The values of a message, those of its registers too."""
    values: dict[str, object] = {}
    for part in (message, message.get("bds50"), message.get("bds60")):
        if isinstance(part, Mapping):
            values |= {key: part[key] for key in _KEYS if part.get(key) is not None}
    return values


_START = re.compile(rb"\s*(\[\s*)?\{")


def _recognises(start: bytes) -> bool:
    return is_text(start) and _START.match(start) is not None and b'"icao24"' in start


register(ReportFormat("mode_s", _recognises, _read_messages))
