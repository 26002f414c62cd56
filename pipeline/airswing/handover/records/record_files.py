"""Reports to files: chosen, joined, put in order of time and written window by window.

Assumes a format that tells how a batch of reports becomes octets (`Layout`). The archive goes by in
blocks of aircraft and comes back in bins of time, so memory does not grow with it. Files are
written in a folder of their own beside the target and take their names when all are complete.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.records.eligible import NEEDED, eligible_rows, winds_of
from airswing.handover.records.fixed_columns import (
    Lines,
    lines_of,
    put_number,
    put_text,
    text_table,
)
from airswing.handover.records.platforms import (
    LONGEST_IDENTIFIER,
    PLATFORMS,
    identifiers,
    platforms,
)
from airswing.handover.records.registry import Account, FileAccount, Request
from airswing.handover.records.run_products import refuse_existing
from airswing.handover.records.soundings import joined_soundings
from airswing.handover.records.time_order import TimeOrder
from airswing.products.atomic import made_folder


@dataclass(frozen=True)
class Records:
    """Some reports in the order they are written."""

    levels: NDArray[np.void]  # rows of all reports, each report's by descending pressure
    first: NDArray[np.int64]  # first level of each report
    size: NDArray[np.int64]  # and how many it has
    number: NDArray[np.int64]  # counts the reports of the export from 1
    identifiers: Lines  # (aircraft, 40)
    platform: NDArray[np.int8]  # (aircraft,), numbers of `PLATFORMS`

    @cached_property
    def heads(self) -> NDArray[np.void]:
        """First level of each report."""
        return self.levels[self.first]


@dataclass(frozen=True)
class Layout:
    """How one format writes reports."""

    file_name: str  # as its reader expects it
    encode: Callable[[Records], bytes | memoryview]
    # What stands before the reports, by their number of each platform: as many octets whatever
    # the counts, since it is written first and again when they are known.
    header: Callable[[Mapping[str, int]], bytes] = lambda counts: b""
    # By reason, rows that the reader would not take.
    barred: Callable[[NDArray[np.void]], Mapping[str, NDArray[np.bool_]]] = lambda rows: {}
    # Sees all rows that are written, before the first of them is encoded.
    look: Callable[[NDArray[np.void]], None] = lambda rows: None


@dataclass
class _Written:
    """One file: where it is made, where it shall stand, what is in it."""

    made: Path
    target: Path
    reports: int = 0
    levels: int = 0
    platforms: Counter[str] = field(default_factory=Counter)
    span: tuple[int, int] = (0, 0)

    def told(self) -> FileAccount:
        first, last = (f"{np.datetime64(moment, 's')}Z" for moment in self.span)
        return {
            "path": str(self.target),
            "reports": self.reports,
            "levels": self.levels,
            "first_time": first,
            "last_time": last,
        }


def write_records(request: Request, layout: Layout) -> Account:
    """Write the reports of an archive.

    Raises
    ------
    InputError
        If there is nothing to write, a file is there already, or it cannot be written.
    """
    winds_of(request)
    folder = request.path.parent
    try:
        with (
            made_folder(folder),
            tempfile.TemporaryDirectory(prefix=".airswing-export-", dir=folder) as name,
        ):
            return _write(request, layout, Path(name))
    except OSError as err:
        raise InputError(
            "cannot write the export; nothing was changed",
            file=request.path,
            found=err.strerror or err,
            remedy="Free space or choose another place with -o",
        ) from err


def _write(request: Request, layout: Layout, folder: Path) -> Account:
    from airswing.products.ragged import blocks

    ds = request.corrected
    written = identifiers(ds, request.settings)
    fleet = text_table(written, LONGEST_IDENTIFIER), platforms(ds, request.settings)
    order = TimeOrder(folder / "bins", (one["time"].to_numpy() for one in blocks(ds, ["time"])))
    left_out: Counter[str] = Counter()
    windows: set[int] = set()
    for rows in _rows(request, layout, left_out):
        windows.update(np.unique(_window(request, rows["time"])).tolist())
        order.add(rows)
        layout.look(rows)
    if not windows:
        raise _nothing(left_out)
    targets = {window: _target(request, layout, window) for window in sorted(windows)}
    refuse_existing(request, *targets.values())
    files = [
        _Written(folder / f"file{number}", target) for number, target in enumerate(targets.values())
    ]
    place = {window: file for window, file in zip(targets, files, strict=True)}
    _fill(order, place, request, layout, fleet)
    for file in files:
        _publish(file)
    aircraft = ds["aircraft"].to_numpy().astype(str)
    table = dict(zip(aircraft.tolist(), written, strict=True))
    total: Counter[str] = Counter()
    for file in files:
        total.update(file.platforms)
    account: Account = {
        "files": [file.told() for file in files],
        "reports": sum(file.reports for file in files),
        "levels": sum(file.levels for file in files),
        "platforms": dict(total),
        "left_out": dict(left_out),
    }
    if request.settings.identifiers == "number":
        account["identifiers"] = table
    return account


def _rows(request: Request, layout: Layout, left_out: Counter[str]) -> Iterator[NDArray[np.void]]:
    """What is handed over, block by block."""
    from airswing.products.ragged import blocks

    aircraft = reports = 0
    for block in blocks(request.corrected, NEEDED):
        rows, chosen = eligible_rows(block, request, first_aircraft=aircraft, left_out=left_out)
        flight = block["flight"].to_numpy()[chosen]
        for reason, bad in layout.barred(rows).items():
            if bad.any():
                left_out[reason] += int(np.count_nonzero(bad))
                rows, flight = rows[~bad], flight[~bad]
        rows["report"] = np.arange(rows.size)
        if request.soundings:
            rows = joined_soundings(rows, flight)
        rows["report"] += reports
        aircraft += block.sizes["aircraft"]
        reports += rows.size
        if rows.size:
            yield rows


def _window(request: Request, time: NDArray[np.int64]) -> NDArray[np.int64]:
    if request.window is None:
        return np.zeros_like(time)
    return (time - _begin(request)) // int(request.window)


def _begin(request: Request) -> int:
    start = request.settings.start
    return 0 if start is None else int(start.timestamp())


def _target(request: Request, layout: Layout, window: int) -> Path:
    if not request.folder:
        return request.path
    if request.window is None:
        return request.path / layout.file_name
    begin = np.datetime64(_begin(request) + window * int(request.window), "s")
    digits = "".join(mark for mark in str(begin) if mark.isdigit())
    # Seconds are named where they are not zero.
    return request.path / digits.removesuffix("00") / layout.file_name


def _nothing(left_out: Mapping[str, int]) -> InputError:
    told = ", ".join(f"{reason} {count:,}" for reason, count in left_out.items())
    return InputError(
        "no report is left to hand over",
        found=told or "no reports",
        remedy="Look at the reasons: fit more aircraft, choose another period, or --winds reported",
    )


def _fill(
    order: TimeOrder,
    place: Mapping[int, _Written],
    request: Request,
    layout: Layout,
    fleet: tuple[Lines, NDArray[np.int8]],
) -> None:
    """Write all reports in order of time, one window after the other."""
    number = 1
    for rows in order:
        own = _window(request, rows["time"])
        for begin, stop in _stretches(own):
            file = place[int(own[begin])]
            records = _records(rows[begin:stop], number, fleet)
            number += records.first.size
            with file.made.open("ab") as stream:
                # Keeps its place: what it counts is known when the last report is written.
                if not file.reports:
                    stream.write(layout.header({}))
                stream.write(layout.encode(records))
            _count(file, records)
    for file in place.values():
        with file.made.open("r+b") as stream:
            stream.write(layout.header(file.platforms))


def _stretches(own: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    begins = np.flatnonzero(np.diff(own, prepend=own[0] - 1))
    return zip(begins.tolist(), [*begins[1:].tolist(), own.size], strict=True)


def _records(
    levels: NDArray[np.void], number: int, fleet: tuple[Lines, NDArray[np.int8]]
) -> Records:
    first = np.flatnonzero(np.diff(levels["report"], prepend=-1))
    size = np.diff(first, append=levels.size)
    return Records(levels, first, size, np.arange(number, number + first.size), *fleet)


def _count(file: _Written, records: Records) -> None:
    kinds = np.bincount(records.platform[records.heads["aircraft"]], minlength=len(PLATFORMS))
    file.platforms.update(dict(zip(PLATFORMS, kinds.tolist(), strict=True)))
    first, last = int(records.levels["time"][0]), int(records.levels["time"][-1])
    file.span = (file.span[0] if file.reports else first, last)
    file.reports += records.first.size
    file.levels += records.levels.size


def _publish(file: _Written) -> None:
    file.target.parent.mkdir(parents=True, exist_ok=True)
    with file.made.open("rb") as stream:
        # Before the rename: a name must not outlive what it stands for.
        os.fsync(stream.fileno())
    os.replace(file.made, file.target)


def names(records: Records) -> Lines:
    """A name for every report, (report, 40), unlike any other's: readers merge or drop equal names.

    It begins with a word that no reader takes for a kind of report (WRF looks for ``ACARS`` and
    others at the beginning of names).
    """
    lines = lines_of(f"{'airswing':<40}", records.first.size)
    put_number(lines, 10, 10, records.number)
    put_text(lines, 21, text_table(list(PHASE), 20)[records.heads["phase"]])
    return lines


def interleaved(records: Records, head: Lines, level: Lines, tail: Lines) -> bytes | memoryview:
    """Octets of reports: each its head, its levels, its tail, all (lines, columns)."""
    if (records.size == 1).all():
        return np.concatenate([head, level, tail], axis=1).reshape(-1).data
    # Reports of one size at a time: each such batch is one array.
    pieces = np.empty(records.size.size, dtype=object)
    for size in np.unique(records.size).tolist():
        own = np.flatnonzero(records.size == size)
        inner = level[records.first[own][:, np.newaxis] + np.arange(size)].reshape(own.size, -1)
        # one item a record: rows of octets can then be joined as they are, without a loop over
        # lines
        whole = np.ascontiguousarray(np.concatenate([head[own], inner, tail[own]], axis=1))
        pieces[own] = whole.view(f"V{whole.shape[1]}").ravel().tolist()
    return b"".join(pieces.tolist())
