"""What one report file holds, for a person who has just been given it.

Assumes a file :func:`airswing.reports.read.read_reports` can read; nothing is ordered or thinned,
so duplicates are counted as reports.
"""

from __future__ import annotations

from collections import Counter
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.cleaning import FLAGS
from airswing.reports.canonical.columns import ColumnMapping, parse_mapping
from airswing.reports.files import expand, file_frames

_NUMBERS = (
    "pressure",
    "eastward_wind",
    "air_temperature",
    "reported_airspeed",
    "reported_heading",
)


def reports_summary(path: str | Path, *, columns: ColumnMapping | None = None) -> dict[str, object]:
    """Say what a report file holds; columns as in `airswing.reports.read.read_reports`.

    Returns
    -------
    dict
        ``file, format, reports, aircraft, first, last`` (ISO 8601 UTC), ``bounding_box``
        (``{"south", "north", "west", "east"}`` in degrees), ``columns`` (reports that have a
        value, per quantity), ``flags`` (reports per code, per field) and ``audit`` (the rest of
        it). Plain types throughout.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    audit = Audit()
    tails: set[str] = set()
    times: list[pd.Timestamp] = []
    box: list[tuple[float, float, float, float]] = []
    present: Counter[str] = Counter()
    mapping = parse_mapping(columns)
    files = expand(str(path))
    for frame in chain.from_iterable(file_frames(one, "auto", mapping, audit) for one in files):
        if not len(frame):
            continue
        tails.update(str(tail) for tail in frame["tail"].unique())
        times += [frame["time"].min(), frame["time"].max()]
        latitude, longitude = frame["latitude"], frame["longitude"]
        box.append((latitude.min(), latitude.max(), longitude.min(), longitude.max()))
        present.update({name: int(frame[name].notna().sum()) for name in _NUMBERS})
        present.update({name: int((frame[name] != none).sum()) for name, none in FLAGS.items()})
        present.update({"flight": int((frame["flight"].astype(str) != "").sum())})
    corners = np.array(box, dtype=np.float64).reshape(-1, 4)
    counts = audit.as_dict()
    return {
        "file": str(path),
        "format": next(iter(counts["formats"]), None),
        "reports": audit.kept,
        "aircraft": len(tails),
        "first": _iso(min(times)) if times else None,
        "last": _iso(max(times)) if times else None,
        "bounding_box": _box(corners) if len(corners) else None,
        "columns": {name: number for name, number in present.items() if number},
        "flags": counts["flags"],
        "audit": {name: part for name, part in counts.items() if name != "flags"},
    }


def _iso(time: pd.Timestamp) -> str:
    return f"{time.isoformat()}Z"


def _box(corners: NDArray[np.float64]) -> dict[str, float]:
    return {
        "south": float(corners[:, 0].min()),
        "north": float(corners[:, 1].max()),
        "west": float(corners[:, 2].min()),
        "east": float(corners[:, 3].max()),
    }
