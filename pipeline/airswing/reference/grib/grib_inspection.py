"""What a GRIB file holds, for people: counts, winds by time and level, grids, packings.

Validity: winds and what was skipped come from the scanner that collocation
uses; the overview of all other messages is by eccodes' short names.
"""

from __future__ import annotations

import os
from collections import Counter

import numpy as np

from airswing.errors import InputError
from airswing.reference.geometry.model_time import HYBRID
from airswing.reference.grib.fields import PRESSURE, FileContents, U
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.grib.messages import scan_file

_PACKINGS = {
    1: {0: "simple", 4: "second order", 8: "spherical harmonics"},
    2: {
        0: "simple",
        2: "complex",
        3: "complex with spatial differencing",
        4: "IEEE floats",
        40: "JPEG 2000",
        41: "PNG",
        42: "CCSDS",
        40000: "JPEG 2000",
        40010: "PNG",
    },
}


def inspect_grib(path: str | os.PathLike[str]) -> dict[str, object]:
    """What a GRIB file holds.

    Returns
    -------
    dict
        Ready for JSON: ``file``, ``messages``, ``fields``, ``winds`` (one entry a valid
        time, lead and member, with its levels), ``grids``, ``packings``, ``skipped``.

    Raises
    ------
    InputError
        Where the file cannot be read or holds no GRIB message.
    """
    name = os.fspath(path)
    try:
        contents = scan_file(name)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=name) from error
    if not contents.messages:
        reasons = "; ".join(sorted(why for _, why in contents.skipped))
        raise InputError("no GRIB message in it", file=name, found=reasons)
    packings = Counter(_packing(row.edition, row.packing) for row in contents.fields)
    return {
        "file": name,
        "messages": contents.messages,
        "fields": contents.parts,
        "winds": _winds(contents),
        "grids": [_grid(*section) for section in contents.grids],
        "packings": dict(packings),
        "skipped": [
            {"what": what, "reason": why, "count": count}
            for (what, why), count in sorted(contents.skipped.items())
        ],
    }


def _packing(edition: int, number: int) -> str:
    return f"GRIB{edition} " + _PACKINGS[edition].get(number, f"template {number}")


def _winds(contents: FileContents) -> list[dict[str, object]]:
    groups: dict[tuple[int, int, int, int], dict[float, set[int]]] = {}
    for row in contents.fields:
        key = (row.valid, row.lead, row.member, row.level_kind)
        groups.setdefault(key, {}).setdefault(row.level, set()).add(row.kind)
    found = []
    for (valid, lead, member, level_kind), levels in sorted(groups.items()):
        scale, unit = (1.0, "hybrid level") if level_kind == HYBRID else (0.01, "hPa")
        both = [level for level, kinds in levels.items() if {0, 1} <= kinds]
        alone = {
            level * scale: "u" if U in kinds else "v"
            for level, kinds in levels.items()
            if len(kinds - {PRESSURE}) == 1
        }
        found.append(
            {
                "valid_time": f"{np.datetime64(valid, 'ns').astype('datetime64[s]')}Z",
                "lead_time_h": lead / 3600.0,
                "member": member,
                "level_unit": unit,
                "levels": sorted(round(level * scale, 4) for level in both),
                "levels_with_one_component": {str(k): v for k, v in sorted(alone.items())},
            }
        )
    return found


def _grid(edition: int, section: bytes) -> dict[str, object]:
    grid = read_grid(edition, section)
    south, north, west, east = grid.outline()
    return {
        "kind": grid.kind,
        "points": [grid.ni, grid.nj],
        "step": [grid.di, grid.dj],
        "step_unit": "degree" if grid.kind.endswith("ll") else "m",
        "latitude_range": [south, north],
        "longitude_range": [west, east],
        "winds_along_grid": grid.wind_along_grid,
    }
