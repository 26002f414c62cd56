"""Reports written to files in order of time, one file for each time window.

Assumes a format that encodes a batch of reports as bytes. Files are written in a temporary folder
next to their target and renamed when all are complete.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.export import Request, refuse_existing
from airswing.handover.fixed_columns import Lines, lines_of, put_number, put_text, text_table
from airswing.handover.platforms import (
    LONGEST_IDENTIFIER,
    PLATFORMS,
    identifiers,
    names_of,
    platforms,
)
from airswing.handover.selection import Rows, Selected
from airswing.products.whole_files import made_folder

# So few that their lines stay in the processor's cache.
REPORTS_AT_ONCE = 10_000


@dataclass(frozen=True)
class Records:
    """Some reports in the order they are written."""

    levels: Rows  # of all reports, each report's by descending pressure
    first: NDArray[np.int64]  # first level of each report
    size: NDArray[np.int64]  # levels of each report
    number: NDArray[np.int64]  # of the report in the export, from 1
    identifiers: Lines  # (aircraft, 40)
    platform: NDArray[np.int8]  # (aircraft,), index of `PLATFORMS`

    @property
    def heads(self) -> Rows:
        """First level of each report."""
        return self.levels[self.first]

    def names(self) -> Lines:
        """Names (report, 40), no two alike, since readers merge or drop reports of equal names.

        They begin with a word that no reader takes for a type of report (WRF looks for ``ACARS``
        and others there).
        """
        lines = lines_of(f"{'airswing':<40}", self.first.size)
        put_number(lines, 10, 10, self.number)
        put_text(lines, 21, text_table(list(PHASE), 20)[self.heads["phase"]])
        return lines

    def texts(self, by_platform: list[str], width: int) -> Lines:
        """Text of each report's platform (report, width), given one text a platform."""
        table = text_table(by_platform, width)
        return np.asarray(table[self.platform[self.heads["aircraft"]]])

    def joined(self, head: Lines, level: Lines, tail: Lines | None = None) -> bytes | memoryview:
        """Bytes of the reports: each its head, its levels, its tail, all (lines, columns)."""
        tail = np.empty((head.shape[0], 0), np.uint8) if tail is None else tail
        if (self.size == 1).all():
            return np.concatenate([head, level, tail], axis=1).reshape(-1).data
        # Reports of equal size form one array; a record is one item, so that they can be
        # joined in order without a loop over lines.
        pieces = np.empty(self.size.size, dtype=object)
        for size in np.unique(self.size).tolist():
            chosen = np.flatnonzero(self.size == size)
            inner = level[self.first[chosen][:, np.newaxis] + np.arange(size)]
            parts = [head[chosen], inner.reshape(chosen.size, -1), tail[chosen]]
            whole = np.ascontiguousarray(np.concatenate(parts, axis=1))
            pieces[chosen] = whole.view(f"V{whole.shape[1]}").ravel().tolist()
        return b"".join(pieces.tolist())


def write_records(
    request: Request,
    selected: Selected,
    file_name: str,
    encode: Callable[[Records], bytes | memoryview],
    *,
    header: Callable[[dict[str, int]], bytes] = lambda numbers: b"",
) -> dict[str, Any]:
    """Write selected reports.

    Parameters
    ----------
    file_name : str
        As the reader of the format expects it, for files in a folder.
    encode : callable
        From `Records` to bytes.
    header : callable, optional
        From the number of reports of each platform to the bytes before the first report.

    Returns
    -------
    dict
        ``files``, ``reports``, ``levels``, ``platforms``, ``left_out``, ``notes``, and
        ``identifiers`` where aircraft are written as numbers.

    Raises
    ------
    InputError
        If a file exists already or cannot be written.
    """
    rows, order = selected.rows, selected.order
    written = identifiers(request.corrected, request.settings)
    fleet = text_table(written, LONGEST_IDENTIFIER), platforms(request.corrected, request.settings)
    # First level of each report among the ordered rows, and the window of each report.
    first = np.flatnonzero(np.diff(rows["report"][order], prepend=-1))
    heads = order[first]
    begin = 0 if request.settings.start is None else int(request.settings.start.timestamp())
    window = np.zeros(first.size, dtype=np.int64)
    if request.window is not None:
        window = (rows["time"][heads] - begin) // int(request.window)
    windows, starts = np.unique(window, return_index=True)
    ends = [*starts[1:].tolist(), first.size]
    targets = [_target(request, file_name, begin, int(one)) for one in windows]
    refuse_existing(request, *targets)
    files: list[dict[str, Any]] = []
    bounds = np.append(first, order.size)
    totals = np.zeros(len(PLATFORMS), dtype=np.int64)
    try:
        with (
            made_folder(request.path.parent),
            tempfile.TemporaryDirectory(
                prefix=".airswing-export-", dir=request.path.parent
            ) as temporary,
        ):
            for start, end, target in zip(starts.tolist(), ends, targets, strict=True):
                aircraft = rows["aircraft"][heads[start:end]]
                numbers = np.bincount(fleet[1][aircraft], minlength=len(PLATFORMS))
                totals += numbers
                with (Path(temporary) / str(len(files))).open("wb") as stream:
                    stream.write(header(dict(zip(PLATFORMS, numbers.tolist(), strict=True))))
                    for low in range(start, end, REPORTS_AT_ONCE):
                        edges = bounds[low : min(low + REPORTS_AT_ONCE, end) + 1]
                        levels = rows[order[edges[0] : edges[-1]]]
                        number = np.arange(low + 1, low + edges.size)
                        stream.write(
                            encode(
                                Records(
                                    levels, edges[:-1] - edges[0], np.diff(edges), number, *fleet
                                )
                            )
                        )
                    stream.flush()
                    os.fsync(stream.fileno())  # before the rename
                times = rows["time"][heads[[start, end - 1]]]
                files.append(
                    {
                        "path": str(target),
                        "reports": end - start,
                        "levels": int(bounds[end] - bounds[start]),
                        "first_time": f"{np.datetime64(int(times[0]), 's')}Z",
                        "last_time": f"{np.datetime64(int(times[1]), 's')}Z",
                    }
                )
            for number_of_file, target in enumerate(targets):
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(Path(temporary) / str(number_of_file), target)
    except OSError as err:
        raise InputError(
            "cannot write the export; nothing was changed",
            file=request.path,
            found=err.strerror or err,
            remedy="Free space or choose another place with -o",
        ) from err
    account: dict[str, Any] = {
        "files": files,
        "reports": first.size,
        "levels": order.size,
        "platforms": dict(zip(PLATFORMS, totals.tolist(), strict=True)),
        "left_out": dict(selected.left_out),
        "notes": _sounding_notes(selected) if request.soundings else [],
    }
    if request.settings.identifiers == "number":
        account["identifiers"] = dict(zip(names_of(request.corrected), written, strict=True))
    return account


def _target(request: Request, file_name: str, begin: int, window: int) -> Path:
    if request.window is None:
        return request.path / file_name if request.folder else request.path
    moment = np.datetime64(begin + window * int(request.window), "s")
    digits = "".join(letter for letter in str(moment) if letter.isdigit())
    # Seconds are named only where they are not zero.
    return request.path / digits.removesuffix("00") / file_name


def _sounding_notes(selected: Selected) -> list[str]:
    joined, split, shallow = (selected.soundings[name] for name in ("joined", "split", "shallow"))
    notes = [
        f"{joined:,} joined soundings; joining moved a report by up to "
        f"{selected.farthest / 1000.0:.0f} km and {selected.longest / 60.0:.0f} min"
    ]
    if split:
        notes.append(f"soundings were split at {split:,} pressure steps over 200 hPa")
    if shallow:
        notes.append(f"{shallow:,} soundings of less than 150 hPa are written as single levels")
    return notes
