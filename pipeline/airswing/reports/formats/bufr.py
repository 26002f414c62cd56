"""AMDAR, ACARS and AIREP BUFR (WMO FM 94, templates 3 11 001 to 3 11 010), through ecCodes.

``flightLevel``, ``indicatedAircraftAltitude`` and ``height`` are pressure altitudes in m. The
aircraft is the tail number if given, else the registration, else the flight number, in which
European AMDAR has its aircraft identifier. Levels of a profile (3-11-008, 3-11-009): elements
before the first level apply to all levels; a level begins where the vertical coordinate occurs
again. A message with an unavailable table version is decoded with a current one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.flags import ICING, PHASE, PLATFORM, ROLL
from airswing.guarded import WorkerEndedError, guarded
from airswing.reports.audit import Audit
from airswing.reports.columns import LARGEST_ROLL, Mapped
from airswing.reports.formats import ReportFormat, content_of, is_text

_TIME = ("year", "month", "day", "hour", "minute", "second")
_TAILS = (
    "aircraftTailNumber",
    "aircraftRegistrationNumberOrOtherIdentification",
    "aircraftFlightNumber",
)
_ALTITUDES = ("flightLevel", "indicatedAircraftAltitude", "height")
_VERTICAL = (*_ALTITUDES, "pressure")
_MEASURED = (*_VERTICAL, "windDirection", "windSpeed", "airTemperature")
_NUMBERS = {
    "latitude": "latitude",
    "longitude": "longitude",
    "pressure": "pressure",
    "windDirection": "wind_direction",
    "windSpeed": "wind_speed",
    "airTemperature": "air_temperature",
    "aircraftTrueAirspeed": "reported_airspeed",
    "aircraftTrueHeading": "reported_heading",
}
# Code table 0 08 004: 2 unsteady, 3 and 4 level, 5 ascending, 6 descending, 7 missing; 0 08 009: 0
# and 1 level but unsteady, 2 unsteady, then as above by interval.
_PHASES = {
    "phaseOfAircraftFlight": {
        **dict.fromkeys((3, 4), PHASE["cruise"]),
        **{5: PHASE["ascent"], 6: PHASE["descent"]},
    },
    "detailedPhaseOfFlight": {
        **dict.fromkeys((0, 1, 3, 4), PHASE["cruise"]),
        **dict.fromkeys((5, 7, 9, 11, 13), PHASE["ascent"]),
        **dict.fromkeys((6, 8, 10, 12, 14), PHASE["descent"]),
    },
}
# Codes that mean a roll angle of 5 degrees or more.
_UNSTEADY = {"phaseOfAircraftFlight": (2,), "detailedPhaseOfFlight": (0, 1, 2)}
_ROLLS = ("aircraftRollAngleQuality", "aircraftRollAngle")
# The largest code that means icing: tables 0 20 042 (1: icing) and 0 20 041 (kinds, 15 missing).
_ICINGS = {"airframeIcingPresent": 1.0, "airframeIcing": 14.0}
KEYS = (*_TIME, *_TAILS, *_ALTITUDES, *_NUMBERS, *_PHASES, *_ROLLS, *_ICINGS)
"""Keys of ecCodes that are read."""

_OLDEST_TABLES = 6  # older versions of the master table do not come with ecCodes
_CURRENT_TABLES = 33  # version of 2019, which holds every older descriptor
_MESSAGES_TOGETHER = 200

Value = float | int | str | None
Record = dict[str, Value]


def _read_bufr(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    messages = list(_messages(content_of(path), audit))
    rows = 0
    for first in range(0, len(messages), _MESSAGES_TOGETHER):
        records = _decoded(messages[first : first + _MESSAGES_TOGETHER], audit)
        rows += len(records)
        if records:
            yield _raw(pd.DataFrame.from_records(records, columns=list(KEYS)), audit)
    if not rows:
        raise InputError("holds no aircraft report that can be decoded")


def _messages(content: bytes, audit: Audit) -> Iterator[bytes]:
    """Whole messages of a file; incomplete messages are counted as dropped."""
    at = content.find(b"BUFR")
    while at >= 0:
        # From edition 2 on bytes 5 to 7 hold the length of the message.
        length = int.from_bytes(content[at + 4 : at + 7], "big")
        message = content[at : at + length]
        edition = content[at + 7 : at + 8]
        if edition >= b"\x02" and len(message) == length >= 12 and message.endswith(b"7777"):
            yield message
        else:
            audit.drop("undecodable_message", 1, unread=True)
            length = 4
        at = content.find(b"BUFR", at + length)


def _decoded(messages: list[bytes], audit: Audit) -> list[Record]:
    try:
        records, failed = guarded(decode_messages, messages)
    except (WorkerEndedError, ValueError):
        if len(messages) > 1:
            # One by one, not by bisection: each failure requires a new process.
            return [record for message in messages for record in _decoded([message], audit)]
        records, failed = [], 1
    audit.drop("undecodable_message", failed, unread=True)
    return records


def decode_messages(messages: list[bytes]) -> tuple[list[Record], int]:
    """Values by `KEYS` of each report or level, and the number of messages that cannot be decoded.

    ecCodes may end the process at a damaged message: called by :func:`airswing.guarded.guarded`.
    """
    import eccodes

    records: list[Record] = []
    failed = 0
    for content in messages:
        for current in (False, True):
            message = eccodes.codes_new_from_message(content)
            try:
                version = eccodes.codes_get(message, "masterTablesVersionNumber")
                if current or version < _OLDEST_TABLES:
                    eccodes.codes_set(message, "masterTablesVersionNumber", _CURRENT_TABLES)
                    eccodes.codes_set(message, "localTablesVersionNumber", 0)
                eccodes.codes_set(message, "skipExtraKeyAttributes", 1)
                eccodes.codes_set(message, "unpack", 1)
                decoded = [record for subset in _subsets(message) for record in _levels(subset)]
            except Exception:  # ecCodes raises many kinds
                continue
            finally:
                eccodes.codes_release(message)
            records += decoded
            break
        else:
            failed += 1
    return records, failed


def _subsets(message: int) -> Iterator[list[tuple[str, Value]]]:
    import eccodes

    number = int(eccodes.codes_get(message, "numberOfSubsets"))
    compressed = bool(eccodes.codes_get(message, "compressedData"))
    iterator = eccodes.codes_bufr_keys_iterator_new(message)
    entries: list[tuple[str, list[Value]]] = []
    try:
        while eccodes.codes_bufr_keys_iterator_next(iterator):
            name = eccodes.codes_bufr_keys_iterator_get_name(iterator)
            key = name.rsplit("#", 1)[-1]
            if not compressed and key == "subsetNumber" and entries:
                yield [(key, values[0]) for key, values in entries]
                entries = []
            if key in KEYS:
                get = eccodes.codes_get_array if compressed else eccodes.codes_get
                values = get(message, name)
                entries.append((key, [_value(v) for v in (values if compressed else [values])]))
    finally:
        eccodes.codes_bufr_keys_iterator_delete(iterator)
    for subset in range(number if compressed else 1):
        yield [(key, values[subset if len(values) > 1 else 0]) for key, values in entries]


def _value(value: object) -> Value:
    if isinstance(value, str | bytes):
        text = value if isinstance(value, str) else value.decode("ascii", "replace")
        return text if text.isprintable() else None
    number = float(value)  # type: ignore[arg-type]
    return None if number in (-1e100, 2147483647.0) else number


def _levels(subset: Iterable[tuple[str, Value]]) -> list[Record]:
    """One record for each level: elements before the levels, and those of the level."""
    common: Record = {}
    levels: list[Record] = [{}]
    vertical = ""
    for key, value in subset:
        if key == vertical:
            levels.append({})
        elif not vertical and key in _VERTICAL:
            vertical = key
        if value is not None:
            (levels[-1] if vertical else common).setdefault(key, value)
    records: list[Record] = []
    for level in levels:
        if records and level.keys().isdisjoint(_MEASURED):
            records[-1] = common | level | records[-1]
        else:
            records.append(common | level)
    return records


def _raw(table: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    column = table.drop(columns=[*_TAILS]).apply(pd.to_numeric, errors="coerce").astype(float)
    for name in (*_PHASES, "aircraftRollAngleQuality", *_ICINGS):
        counts = column[name].value_counts(dropna=False)
        audit.codes(name, {"missing" if c != c else f"{c:g}": int(n) for c, n in counts.items()})
    parts = column[[*_TIME]].fillna({"second": 0.0})
    text = table[list(_TAILS)].astype("string").apply(lambda c: c.str.strip()).replace("", None)
    unsteady = pd.Series(False, table.index)
    phase = pd.Series(np.nan, table.index)
    for name, codes in _PHASES.items():  # the detailed table comes last and overrides
        phase = column[name].map(codes).fillna(phase)
        unsteady |= column[name].isin(_UNSTEADY[name])
    angle, quality = column["aircraftRollAngle"].abs(), column["aircraftRollAngleQuality"]
    good, bad, missing = (ROLL[name] for name in ("good", "bad", "missing"))
    roll = np.select(
        [quality == 0, quality == 1, angle >= LARGEST_ROLL, angle < LARGEST_ROLL, unsteady],
        [good, bad, bad, good, bad],
        missing,
    )
    icing = np.full(len(table), ICING["missing"], dtype=np.int8)
    for name, largest in reversed(_ICINGS.items()):
        icing[column[name] == 0.0] = ICING["off"]
        icing[column[name].between(1.0, largest)] = ICING["on"]
    return pd.DataFrame(
        {
            "tail": text.bfill(axis=1).iloc[:, 0].fillna(""),
            "time": pd.to_datetime(parts, errors="coerce").astype("datetime64[ns]"),
            "time_blank": parts.isna().any(axis=1),
            "pressure_altitude": column[[*_ALTITUDES]].bfill(axis=1).iloc[:, 0],
            **{ours: column[name] for name, ours in _NUMBERS.items()},
            "phase": phase.fillna(PHASE["unknown"]).astype(np.int8),
            "roll_flag": roll.astype(np.int8),
            "icing": icing,
            "platform": np.int8(PLATFORM["AMDAR"]),
        }
    )


FORMATS = (
    ReportFormat(
        "bufr",
        lambda start: b"BUFR" in start[:4096] and not is_text(start),
        _read_bufr,
        title="BUFR",
    ),
)
