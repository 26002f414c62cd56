"""Reports written to files in order of time, one file for each time window.

A format is two or three printf templates: the lines before the levels of a report, the line of a
level, and the lines after the levels. All fields have fixed columns as in the Fortran formats of
the readers. Files are written in a temporary folder next to their target and renamed when all are
complete.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.export import Request, refuse_existing
from airswing.handover.selection import (
    PLATFORMS,
    Rows,
    Selected,
    identifiers,
    names_of,
    platforms,
)
from airswing.physics.triangle import direction_in_degrees
from airswing.products.whole_files import made_folder

Array = NDArray[np.float64]

MISSING = -888888.0
"""Missing value of the formats of WRF, OBSPROC and WRFDA."""
REPORTS_AT_ONCE = 10_000  # more take more memory and no less time
_FIELD = re.compile(r"%-?(\d+)(?:\.\d+)?[dfs]")
_PHASES = {code: name for name, code in PHASE.items()}


@dataclass(frozen=True)
class Records:
    """Some reports in the order they are written."""

    levels: Rows  # of all reports, each report's by descending pressure
    first: NDArray[np.int64]  # first level of each report
    size: NDArray[np.int64]  # levels of each report
    number: NDArray[np.int64]  # of the report in the export, from 1
    identifiers: Sequence[str]  # by aircraft
    platform: NDArray[np.int8]  # index of `PLATFORMS`, by aircraft

    @property
    def places(self) -> Rows:
        """First level of each report, with the report's place and time."""
        return self.levels[self.first]

    def aircraft(self) -> list[str]:
        """Identifier of each report's aircraft."""
        return [self.identifiers[number] for number in self.places["aircraft"]]

    def names(self) -> list[str]:
        """A unique name of 40 characters for each report; readers merge or drop equal names.

        It begins with a word that no reader takes for a type of report (WRF looks there).
        """
        pairs = zip(self.number.tolist(), self.places["phase"].tolist(), strict=True)
        return [f"airswing {number:10d} {_PHASES[code]:<20}" for number, code in pairs]

    def by_platform(self, texts: Sequence[str]) -> list[str]:
        """Text of each report's platform, given one for each of `PLATFORMS`."""
        return [texts[code] for code in self.platform[self.places["aircraft"]].tolist()]


def fixed(values: ArrayLike, decimals: int) -> list[float]:
    """Finite numbers, rounded, without a negative zero (some readers stop at -0)."""
    numbers = np.round(np.asarray(values, dtype=np.float64), decimals) + 0.0
    if not np.isfinite(numbers).all():
        raise ValueError("a number is not finite")
    return list(numbers.tolist())


def dates(seconds: NDArray[np.int64], *, separators: bool) -> list[str]:
    """``yyyy-mm-dd_hh:mm:ss``, or the fourteen digits alone, of seconds since 1970 (UTC)."""
    texts = np.datetime_as_string(seconds.astype("datetime64[s]")).tolist()
    if separators:
        return [text.replace("T", "_") for text in texts]
    return ["".join([t[:4], t[5:7], t[8:10], t[11:13], t[14:16], t[17:]]) for t in texts]


def lines(template: str, columns: Sequence[Sequence[object]]) -> list[str]:
    """Text of fixed columns from a printf template and the values of each field.

    ValueError if a value does not fit into its field: no reader accepts Fortran's asterisks.
    """
    found = [template % values for values in zip(*columns, strict=True)]
    width = len(_FIELD.sub(lambda field: " " * int(field[1]), template))
    if any(len(text) != width for text in found):
        raise ValueError("a value does not fit into its columns")
    return found


def joined(
    records: Records, before: list[str], levels: list[str], after: list[str] | None = None
) -> bytes:
    """Bytes of the reports: the text before the levels, that of each level, that after them."""
    ends = records.first + records.size
    parts = zip(records.first.tolist(), ends.tolist(), strict=True)
    whole = ["".join([text, *levels[i:j]]) for text, (i, j) in zip(before, parts, strict=True)]
    if after is not None:
        whole = [one + end for one, end in zip(whole, after, strict=True)]
    return "".join(whole).encode("ascii")


def speed_and_direction(u: ArrayLike, v: ArrayLike, *, least: float = 0.0) -> tuple[Array, Array]:
    """Speed (m/s) and direction in (0, 360] degrees, 360 for a calm, of components (n,) in m/s.

    A direction no larger than ``least`` degrees becomes 360, since readers take 0 as missing.
    """
    east, north = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    speed = np.hypot(east, north)
    direction = direction_in_degrees(east, north)
    return speed, np.where((speed == 0.0) | (direction <= least), 360.0, direction)


def write_records(
    request: Request,
    selected: Selected,
    file_name: str,
    encode: Callable[[Records], bytes],
    *,
    header: Callable[[dict[str, int]], bytes] = lambda numbers: b"",
) -> dict[str, Any]:
    """Write selected reports; the file name is that of files in a folder.

    ``encode`` turns `Records` into bytes, ``header`` the number of reports of each platform into
    the bytes before the first report. Returns ``files``, ``reports``, ``levels``, ``platforms``,
    ``left_out``, ``notes``, and ``identifiers`` where aircraft are written as numbers.
    """
    rows, order = selected.rows, selected.order
    fleet = identifiers(request.corrected, request.settings)
    platform = platforms(request.corrected, request.settings)
    # First level of each report among the ordered rows, and the window of each report.
    first = np.flatnonzero(np.diff(rows["report"][order], prepend=-1))
    bounds = np.append(first, order.size)
    places = rows[["time", "aircraft"]][order[first]]
    begin = 0 if request.settings.start is None else int(request.settings.start.timestamp())
    window = np.zeros(first.size, dtype=np.int64)
    if request.window is not None:
        window = (places["time"] - begin) // int(request.window)
    windows, starts = np.unique(window, return_index=True)
    ends = [*starts[1:].tolist(), first.size]
    targets = [_target(request, file_name, begin, int(one)) for one in windows]
    refuse_existing(request, *targets)
    files: list[dict[str, Any]] = []
    totals = np.zeros(len(PLATFORMS), dtype=np.int64)
    folder = request.path.parent
    try:
        with (
            made_folder(folder),
            tempfile.TemporaryDirectory(prefix=".airswing-export-", dir=folder) as temporary,
        ):
            for start, end, target in zip(starts.tolist(), ends, targets, strict=True):
                of_platform = platform[places["aircraft"][start:end]]
                numbers = np.bincount(of_platform, minlength=len(PLATFORMS))
                totals += numbers
                with (Path(temporary) / str(len(files))).open("wb") as stream:
                    stream.write(header(dict(zip(PLATFORMS, numbers.tolist(), strict=True))))
                    for low in range(start, end, REPORTS_AT_ONCE):
                        edges = bounds[low : min(low + REPORTS_AT_ONCE, end) + 1]
                        records = Records(
                            levels=rows[order[edges[0] : edges[-1]]],
                            first=edges[:-1] - edges[0],
                            size=np.diff(edges),
                            number=np.arange(low + 1, low + edges.size),
                            identifiers=fleet,
                            platform=platform,
                        )
                        stream.write(encode(records))
                    stream.flush()
                    os.fsync(stream.fileno())  # before the rename
                times = places["time"][[start, end - 1]].astype("datetime64[s]")
                files.append(
                    {
                        "path": str(target),
                        "reports": end - start,
                        "levels": int(bounds[end] - bounds[start]),
                        "first_time": f"{times[0]}Z",
                        "last_time": f"{times[1]}Z",
                    }
                )
            for number, target in enumerate(targets):
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(Path(temporary) / str(number), target)
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
        account["identifiers"] = dict(zip(names_of(request.corrected), fleet, strict=True))
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
