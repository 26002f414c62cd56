"""Reports written as text to files in order of time, one file for each time window.

A format is two or three printf templates with named fields: the lines before the levels of a
report, the line of a level, and the lines after the levels. All fields have fixed columns as in the
Fortran formats of the readers. Files are written under temporary names and renamed when all are
complete.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.flags import PHASE
from airswing.handover.selection import (
    PLATFORMS,
    Request,
    Rows,
    Selected,
    identifiers,
    platforms,
    refuse_existing,
)
from airswing.physics.triangle import direction_in_degrees
from airswing.products.whole_files import atomic

Array = NDArray[np.float64]
Columns = Mapping[str, ArrayLike]

MISSING = -888888.0
"""Missing value of the formats of WRF, OBSPROC and WRFDA."""
REPORTS_AT_ONCE = 10_000  # more take more memory and no less time
_FIELD = re.compile(r"%\((\w+)\)(-?(\d+)(?:\.(\d+))?[dfs])")
_PHASES = {code: name for name, code in PHASE.items()}


@dataclass(frozen=True)
class Format:
    """Layout of a file of reports.

    Fields before and after the levels are ``latitude``, ``longitude``, ``date`` (fourteen digits),
    ``date_text`` (``yyyy-mm-dd_hh:mm:ss``), ``identifier``, ``name``, ``number`` of the report,
    ``levels`` (their number) and the ``texts``; those of a level are ``pressure``, ``temperature``
    and what ``columns`` makes of the rows and the platform (index of `PLATFORMS`) of each.
    """

    file_name: str  # in a folder
    before: str
    level: str
    columns: Callable[[Rows, NDArray[np.int8]], Columns]
    texts: Mapping[str, Sequence[str]]  # of each of `PLATFORMS`
    after: str = ""
    header: Callable[[dict[str, int]], str] = lambda numbers: ""  # from reports by platform


def lines(template: str, columns: Columns, size: int) -> list[str]:
    """Text of fixed columns from a printf template and the values of each named field (size,).

    Numbers are rounded without a negative zero (some readers stop at -0). ValueError if one is not
    finite, or a value does not fit into its field: no reader accepts Fortran's asterisks.
    """
    values: list[list[Any]] = []
    for name, form, _, decimals in _FIELD.findall(template):
        column = np.asarray(columns[name])
        if form.endswith("f"):
            column = np.round(column.astype(np.float64), int(decimals)) + 0.0
            if not np.isfinite(column).all():
                raise ValueError("a number is not finite")
        values.append(column.tolist())
    layout = _FIELD.sub(r"%\2", template)
    width = len(_FIELD.sub(lambda field: " " * int(field[3]), template))
    texts = [layout % row for row in zip(*values, strict=True)] if values else [layout] * size
    if any(len(text) != width for text in texts):
        raise ValueError("a value does not fit into its columns")
    return texts


def encoded(
    form: Format,
    levels: Rows,
    first: NDArray[np.int64],
    number: NDArray[np.int64],
    identifier: Sequence[str],
    platform: NDArray[np.int8],
) -> bytes:
    """Bytes of some reports, from the rows of all, and the first row and further values of each."""
    places, size = levels[first], np.diff(first, append=levels.size)
    texts = np.datetime_as_string(places["time"].astype("datetime64[s]")).tolist()
    # Readers merge or drop reports of equal names. The first word is none that a reader takes for
    # a type of report (WRF looks there).
    pairs = zip(number.tolist(), places["phase"].tolist(), strict=True)
    fields: dict[str, ArrayLike] = {
        "latitude": places["latitude"],
        "longitude": places["longitude"],
        "date": [re.sub(r"[-T:]", "", text) for text in texts],
        "date_text": [text.replace("T", "_") for text in texts],
        "identifier": identifier,
        "name": [f"airswing {serial:10d} {_PHASES[phase]:<20}" for serial, phase in pairs],
        "number": number,
        "levels": size,
    }
    fields |= {name: np.array(words)[platform] for name, words in form.texts.items()}
    before, after = (lines(template, fields, first.size) for template in (form.before, form.after))
    columns = {
        "pressure": levels["pressure"],
        "temperature": np.nan_to_num(levels["temperature"], nan=MISSING),
        **form.columns(levels, np.repeat(platform, size)),
    }
    rows = lines(form.level, columns, levels.size)
    ends = zip(first.tolist(), (first + size).tolist(), before, after, strict=True)
    return "".join("".join([top, *rows[i:j], end]) for i, j, top, end in ends).encode("ascii")


def speed_and_direction(u: ArrayLike, v: ArrayLike, *, least: float = 0.0) -> tuple[Array, Array]:
    """Speed (m/s) and direction in (0, 360] degrees, 360 for a calm, of components (n,) in m/s.

    A direction no larger than ``least`` degrees becomes 360, since readers take 0 as missing.
    """
    east, north = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    speed = np.hypot(east, north)
    direction = direction_in_degrees(east, north)
    return speed, np.where((speed == 0.0) | (direction <= least), 360.0, direction)


def write_records(request: Request, selected: Selected, form: Format) -> dict[str, Any]:
    """Write selected reports.

    Returns ``files``, ``reports``, ``levels``, ``platforms``, ``left_out``, ``notes``, and
    ``identifiers`` where aircraft are written as numbers.
    """
    rows, order = selected.rows, selected.order
    fleet, platform = identifiers(request), platforms(request)
    # First level of each report among the ordered rows, and the window of each report.
    first = np.flatnonzero(np.diff(rows["report"][order], prepend=-1))
    bounds = np.append(first, order.size)
    places = rows[["time", "aircraft"]][order[first]]
    targets, starts = [request.path / form.file_name if request.folder else request.path], [0]
    if request.window is not None:
        begin = 0 if request.settings.start is None else int(request.settings.start.timestamp())
        window = (places["time"] - begin) // int(request.window)
        windows, opens = np.unique(window, return_index=True)
        starts = opens.tolist()
        moments = (np.datetime64(begin + int(k) * int(request.window), "s") for k in windows)
        # Names contain seconds only if these are not zero.
        names = (re.sub(r"\D", "", str(moment)).removesuffix("00") for moment in moments)
        targets = [request.path / name / form.file_name for name in names]
    refuse_existing(request, *targets)
    files: list[dict[str, Any]] = []
    code = platform[places["aircraft"]]
    with contextlib.ExitStack() as together:
        for target, start, end in zip(targets, starts, [*starts[1:], first.size], strict=True):
            numbers = _by_platform(code[start:end])
            with together.enter_context(atomic(target, "export")).open("wb") as stream:
                stream.write(form.header(numbers).encode("ascii"))
                for low in range(start, end, REPORTS_AT_ONCE):
                    high = min(low + REPORTS_AT_ONCE, end)
                    stream.write(
                        encoded(
                            form,
                            rows[order[bounds[low] : bounds[high]]],
                            bounds[low:high] - bounds[low],
                            np.arange(low + 1, high + 1),
                            [fleet[place] for place in places["aircraft"][low:high]],
                            code[low:high],
                        )
                    )
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
    account: dict[str, Any] = {
        "files": files,
        "reports": first.size,
        "levels": order.size,
        "platforms": _by_platform(code),
        "left_out": dict(selected.left_out),
        "notes": _sounding_notes(selected) if request.soundings else [],
    }
    if request.settings.identifiers == "number":
        account["identifiers"] = dict(zip(request.aircraft, fleet, strict=True))
    return account


def _by_platform(code: NDArray[np.int8]) -> dict[str, int]:
    return dict(zip(PLATFORMS, np.bincount(code, minlength=len(PLATFORMS)).tolist(), strict=True))


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
