"""Damage that may change some values and no others: what is sound has to stay as it is.

* One octet of one GRIB message's data changes: the other messages' winds are the same bit for bit,
  and under PNG, whose chunks carry checksums, no wind is another.
* A gzip stream carries a checksum: what is read of a damaged one is as it was.
* One cell of one row of a table changes: the other rows are as they were.
"""

from __future__ import annotations

import functools
import random
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from benchmarks.fuzz.dataset_seeds import LEVELS
from benchmarks.fuzz.mutations import CELLS, sections

Winds = tuple[Any, Any]


def payload_changed(data: bytes, pick: random.Random) -> tuple[bytes, int]:
    """Change one octet of one message's data; the message's number."""
    messages = sections(data)
    number = pick.randrange(len(messages))
    start, length = messages[number][-1]
    head = 11 if data[messages[number][0][0] + 7] == 1 else 5
    at = start + head + pick.randrange(length - head)
    value = data[at] ^ (1 << pick.randrange(8))
    return data[:at] + bytes([value]) + data[at + 1 :], number


def others_differ(found: Winds, sound: Winds, pressure: Any, number: int, *, all_told: bool) -> str:
    """What is silently other after one octet of message `number` changed; empty if nothing is.

    Parameters
    ----------
    found, sound : pair of array
        u and v at the reports, of the damaged and the sound file.
    pressure : array
        Of the reports, Pa.
    number : int
        Of the message: u and v by turns, from the top level down.
    all_told : bool
        Whether a checksum tells of the change.
    """
    level = LEVELS[number // 2] * 100.0
    nearest = np.sort(np.abs(LEVELS * 100.0 - level))[1]
    apart = np.abs(np.asarray(pressure) - level) > nearest
    for ours, theirs in zip(map(np.asarray, found), map(np.asarray, sound), strict=True):
        same = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
        if not same[..., apart].all():
            return f"{int((~same[..., apart]).sum())} winds of sound messages"
        if all_told and not (same | np.isnan(ours)).all():
            return f"{int((~same).sum())} winds of a stream with a checksum"
    return ""


def cell_changed(data: bytes, pick: random.Random) -> tuple[bytes, int]:
    """Change one cell of one row of a table; the row's number, from 0."""
    rows = data.split(b"\n")
    number = pick.randrange(1, len(rows) - 1)
    cells = rows[number].split(b",")
    quiet = [cell for cell in CELLS if '"' not in cell and "," not in cell]
    cells[pick.randrange(1, len(cells))] = pick.choice(quiet).encode("utf-8", "replace")
    rows[number] = b",".join(cells)
    return b"\n".join(rows), number - 1


@functools.cache
def sound_reports(path: Path) -> pd.DataFrame:
    """What a sound table says, by tail."""
    from airswing.reports import read_reports

    return by_tail(read_reports(path))


def by_tail(ds: xr.Dataset) -> pd.DataFrame:
    """Winds, places and times of reports, a line a tail: every report is another aircraft's."""
    names = ("time", "latitude", "longitude", "pressure", "eastward_wind", "northward_wind")
    tails = np.repeat(ds["aircraft"].values.astype(str), ds["row_size"].values)
    return pd.DataFrame({name: ds[name].values for name in names}, index=tails)


def rows_differ(found: pd.DataFrame, sound: pd.DataFrame, changed: str | None) -> str:
    """What rows say that they did not; absent ones say nothing."""
    for name in found.columns:
        ours = found[name]
        theirs = sound[name].reindex(ours.index)
        other = ~((ours == theirs) | (ours.isna() & theirs.isna())) & (ours.index != changed)
        if other.any():
            return f"{name} of {int(other.sum())} sound rows"
    return ""
