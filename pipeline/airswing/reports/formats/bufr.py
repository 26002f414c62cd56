"""AMDAR, ACARS and AIREP BUFR (WMO FM 94) to raw pieces, through pdbufr.

Assumptions
-----------
``flightLevel``, ``indicatedAircraftAltitude`` and ``height`` (007010, 010070, 007002) are
pressure altitudes in m, as AMDAR reports them; where only ``pressure`` is given it is used. The
aircraft is the tail number (001110) if given, else the registration (001008), else the flight
number (001006), which is where European AMDAR puts its aircraft identifier. Times are as coarse as
coded: older templates have whole minutes.

A message of edition 2 or later whose table version is not at hand is decoded with a current one;
one that still cannot be decoded, or that ends the process it is read in, is counted as
dropped (``undecodable_message``), and the rest of the file is read.

References
----------
WMO Manual on Codes, Volume I.2: code tables 0 08 004, 0 08 009, 0 02 064.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import ICING, PHASE, PLATFORM, ROLL
from airswing.guarded import WorkerEndedError, guarded
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.report_formats import Mapped, ReportFormat, is_text, register

_TIME = ("year", "month", "day", "hour", "minute", "second")
_TAILS = (
    "aircraftTailNumber",
    "aircraftRegistrationNumberOrOtherIdentification",
    "aircraftFlightNumber",
)
_ALTITUDES = ("flightLevel", "indicatedAircraftAltitude", "height")
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
_PHASES = ("phaseOfAircraftFlight", "detailedPhaseOfFlight")
_ROLLS = ("aircraftRollAngleQuality", "aircraftRollAngle")
_ICINGS = ("airframeIcingPresent", "airframeIcing")
_MEASURED = (*_ALTITUDES, "pressure", "windDirection", "windSpeed", "airTemperature")
COLUMNS = (*_TIME, *_TAILS, *_ALTITUDES, *_NUMBERS, *_PHASES, *_ROLLS, *_ICINGS)
"""eccodes keys asked for."""

# Phase of aircraft flight: 2 unsteady, 3 and 4 level, 5 ascending, 6 descending, 7 missing.
PHASE_008004 = {3: PHASE["cruise"], 4: PHASE["cruise"], 5: PHASE["ascent"], 6: PHASE["descent"]}
# Detailed phase of flight: 0 and 1 level but unsteady, 2 unsteady, then as above by interval.
PHASE_008009 = {
    **dict.fromkeys((0, 1, 3, 4), PHASE["cruise"]),
    **dict.fromkeys((5, 7, 9, 11, 13), PHASE["ascent"]),
    **dict.fromkeys((6, 8, 10, 12, 14), PHASE["descent"]),
}
# Codes that mean a roll angle of 5 degrees or more.
UNSTEADY = {"phaseOfAircraftFlight": (2,), "detailedPhaseOfFlight": (0, 1, 2)}
_LARGEST_ROLL = 5.0  # degrees: AMDAR's limit of a good roll angle
_OLDEST_TABLES = 6  # master table versions below are not shipped with eccodes
_CURRENT_TABLES = 33  # master table version, of 2019, that holds every older descriptor
_MESSAGES_TOGETHER, _ROWS_PER_PIECE = 100, 20_000
_START, _END = b"BUFR", b"7777"


def _bufr_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one BUFR file."""
    if find_spec("pdbufr") is None:
        raise InputError(
            "reading BUFR needs pdbufr",
            file=path,
            remedy="Install it with: pip install 'airswing[bufr]'",
        )
    rows = 0
    for table in _tables(path, audit):
        rows += len(table)
        yield _piece(_merged(table), audit)
    if not rows:
        raise InputError("holds no aircraft report that can be decoded", file=path)


def _tables(path: Path, audit: Audit) -> Iterator[pd.DataFrame]:
    """Reports of some thousand messages at a time."""
    rows: list[dict[str, object]] = []
    messages = _framed(path, audit)
    while taken := list(itertools.islice(messages, _MESSAGES_TOGETHER)):
        found, failed = _decoded(taken)
        rows += found
        for _ in range(failed):
            _drop(audit)
        if len(rows) >= _ROWS_PER_PIECE:
            yield pd.DataFrame.from_records(rows)
            rows = []
    if rows:
        yield pd.DataFrame.from_records(rows)


def _decoded(messages: list[bytes]) -> tuple[list[dict[str, object]], int]:
    """Reports of messages, and the number of messages that cannot be decoded."""
    try:
        return guarded(decode_messages, messages)
    except (WorkerEndedError, ValueError):
        if len(messages) == 1:
            return [], 1
    parts = [_decoded([message]) for message in messages]
    return [row for rows, _ in parts for row in rows], sum(failed for _, failed in parts)


def decode_messages(messages: list[bytes]) -> tuple[list[dict[str, object]], int]:
    """Decode BUFR messages by pdbufr, with their own tables or with current ones.

    ecCodes may end the process at a damaged message: called by :func:`airswing.guarded.guarded`.

    Returns
    -------
    rows : list of dict
        Values by `COLUMNS`, one entry a report.
    failed : int
        Messages that no tables decode.
    """
    import pdbufr

    failed: list[int] = []
    try:
        found = pdbufr.read_bufr(
            _unpackable(messages, failed), columns=COLUMNS, required_columns=False
        )
    except Exception as error:  # of ecCodes and pdbufr, not all of which can be pickled
        raise ValueError(str(error)) from None
    return found.to_dict("records"), len(failed)


def _unpackable(messages: list[bytes], failed: list[int]) -> Iterator[object]:
    """Messages as pdbufr takes them; numbers of those that cannot be unpacked go to `failed`."""
    import eccodes
    from pdbufr.high_level_bufr.bufr import BufrMessage

    for number, octets in enumerate(messages):
        for current in (False, True):
            message = object.__new__(BufrMessage)  # its constructor reads from a file
            message.codes_file = None
            message.codes_id = eccodes.codes_new_from_message(octets)
            try:
                if current or message["masterTablesVersionNumber"] < _OLDEST_TABLES:
                    message["masterTablesVersionNumber"] = _CURRENT_TABLES
                    message["localTablesVersionNumber"] = 0
                message["skipExtraKeyAttributes"] = 1
                message["unpack"] = 1
            except Exception:  # ecCodes raises many kinds
                eccodes.codes_release(message.codes_id)
                continue
            yield message
            break
        else:
            failed.append(number)


def _drop(audit: Audit) -> None:
    audit.read += 1
    audit.drop("undecodable_message", 1)


def _framed(path: Path, audit: Audit) -> Iterator[bytes]:
    """Whole messages of a file, over anything between; what has no end is counted as dropped."""
    with path.open("rb") as file:
        size, at = file.seek(0, os.SEEK_END), 0
        while (at := _mark(file.fileno(), at, size)) < size:
            head = os.pread(file.fileno(), 8, at)
            length = int.from_bytes(head[4:7], "big")
            octets = os.pread(file.fileno(), length, at) if len(head) == 8 else b""
            # Edition 2 on has the length of the whole message in octets 5 to 7.
            if head[7:] >= b"\x02" and length >= 12 and octets[length - 4 :] == _END:
                yield octets
                at += length
            else:
                _drop(audit)
                at += len(_START)


def _mark(descriptor: int, at: int, size: int) -> int:
    """Where the next message begins; the file's size where there is none."""
    while at < size:
        block = os.pread(descriptor, 1 << 16, at)
        found = block.find(_START)
        if found >= 0:
            return at + found
        # Blocks overlap by three octets: a mark may lie across their border.
        at += max(len(block) - len(_START) + 1, 1) if len(block) == 1 << 16 else size - at
    return size


def _merged(table: pd.DataFrame) -> pd.DataFrame:
    """Put a report together again that pdbufr split at a descriptor which appears twice.

    The second part repeats time and place and has no level, wind nor temperature of its own.
    """
    table = table.reindex(columns=list(COLUMNS))
    place = [*_TIME, "latitude", "longitude", "aircraftFlightNumber"]
    hollow = table[list(_MEASURED)].isna().all(axis=1)
    if not hollow.any():
        return table
    here = table[place].astype(object)
    before = here.shift()
    repeats = ((here == before) | (here.isna() & before.isna())).all(axis=1)
    second = np.flatnonzero((repeats & hollow).to_numpy(dtype=bool))
    if not second.size:
        return table
    whole = table.iloc[second - 1].set_axis(second).combine_first(table.iloc[second])
    table = table.astype(object)
    table.iloc[second - 1] = whole[list(COLUMNS)].to_numpy(dtype=object)
    return table.drop(index=table.index[second]).reset_index(drop=True)


def _piece(table: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    for name in (*_PHASES, *_ROLLS[:1], *_ICINGS):
        counts = table[name].value_counts(dropna=False)
        audit.codes(
            name, {"missing" if c != c or c is None else f"{c:g}": n for c, n in counts.items()}
        )
    time, blank = _times(table)
    altitude = _column(table, _ALTITUDES[0])
    for name in _ALTITUDES[1:]:
        altitude = np.where(np.isnan(altitude), _column(table, name), altitude)
    return pd.DataFrame(
        {
            "tail": _tails(table),
            "time": time,
            "time_blank": blank,
            "pressure_altitude": altitude,
            **{ours: _column(table, name) for name, ours in _NUMBERS.items()},
            "phase": _phases(table),
            "roll_flag": _rolls(table),
            "icing": _icing(table),
            "platform": np.int8(PLATFORM["AMDAR"]),
        }
    )


def _column(table: pd.DataFrame, name: str) -> NDArray[np.float64]:
    return pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)


def _times(table: pd.DataFrame) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    parts = pd.DataFrame({name: _column(table, name) for name in _TIME})
    parts["second"] = parts["second"].fillna(0.0)
    blank = parts.isna().any(axis=1).to_numpy(dtype=bool)
    time = pd.to_datetime(parts, errors="coerce").to_numpy(dtype="datetime64[ns]")
    return time, blank


def _tails(table: pd.DataFrame) -> pd.Series[str]:
    tail = pd.Series("", index=table.index, dtype=object)
    # The best last, so that it overwrites.
    for name in reversed(_TAILS):
        own = table[name].astype(object).fillna("").astype(str).str.strip()
        tail = own.where(own != "", tail)
    return tail


def _phases(table: pd.DataFrame) -> NDArray[np.int8]:
    phase = np.zeros(len(table), dtype=np.int8)
    for name, codes in zip(_PHASES, (PHASE_008004, PHASE_008009), strict=True):
        own = table[name].map(codes).fillna(0).to_numpy(dtype=np.int8)
        # The detailed table comes last and goes before where it knows.
        phase = np.where(own != 0, own, phase)
    return phase


def _rolls(table: pd.DataFrame) -> NDArray[np.int8]:
    roll = np.full(len(table), ROLL["missing"], dtype=np.int8)
    for name, codes in UNSTEADY.items():
        roll[table[name].isin(codes).to_numpy(dtype=bool)] = ROLL["bad"]
    angle = np.abs(_column(table, "aircraftRollAngle"))
    roll[angle < _LARGEST_ROLL] = ROLL["good"]
    roll[angle >= _LARGEST_ROLL] = ROLL["bad"]
    quality = _column(table, "aircraftRollAngleQuality")
    roll[quality == 0.0] = ROLL["good"]
    roll[quality == 1.0] = ROLL["bad"]
    return roll


def _icing(table: pd.DataFrame) -> NDArray[np.int8]:
    icing = np.full(len(table), ICING["missing"], dtype=np.int8)
    for name in reversed(_ICINGS):
        code = _column(table, name)
        icing[code == 0.0] = ICING["off"]
        # Code tables 0 20 042 (1: icing) and 0 20 041 (1 to 14 kinds of it, 15 missing).
        largest = 1.0 if name == "airframeIcingPresent" else 14.0
        icing[(code >= 1.0) & (code <= largest)] = ICING["on"]
    return icing


register(ReportFormat("bufr", lambda start: b"BUFR" in start and not is_text(start), _bufr_pieces))
