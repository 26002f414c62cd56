"""Readable summary of model files: times, levels, grids, packings, and skipped content."""

from __future__ import annotations

import os
from collections import Counter

import numpy as np

from airswing.errors import InputError
from airswing.reference.catalogue import build_catalogue
from airswing.reference.files import local_path
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import FileContents, off_levels, scan_file
from airswing.reference.gridded.datasets import engine_of
from airswing.reference.grids import AxesGrid
from airswing.reference.winds import HYBRID, ISOBARIC, PRESSURE

_UNITS = {ISOBARIC: "hPa", HYBRID: "hybrid level"}
_PACKINGS = {
    1: {0: "simple", 4: "second order", 8: "spherical harmonics"},
    2: {
        **{0: "simple", 2: "complex", 3: "complex with spatial differencing", 4: "IEEE floats"},
        **{40: "JPEG 2000", 41: "PNG", 42: "CCSDS", 40000: "JPEG 2000", 40010: "PNG"},
    },
}


def inspect_grib(path: str | os.PathLike[str]) -> dict[str, object]:
    """Content of a GRIB file, ready for JSON."""
    name = os.fspath(path)
    try:
        contents = scan_file(local_path(name))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=name) from error
    if not contents.messages:
        reasons = "; ".join(sorted(why for _, why in contents.skipped))
        raise InputError("no GRIB message in it", file=name, found=reasons)
    with_pressure = {row.level_kind for row in contents.fields if row.kind == PRESSURE}
    usable = [r for r in contents.fields if r.level_kind <= HYBRID or r.level_kind in with_pressure]
    for row in set(contents.fields) - set(usable):
        contents.skipped["wind", off_levels(row.kind, row.level_kind)] += 1
    contents.fields = usable
    packings = Counter(
        f"GRIB{row.edition} " + _PACKINGS[row.edition].get(row.packing, f"template {row.packing}")
        for row in contents.fields
    )
    return {
        "file": name,
        "messages": contents.messages,
        "fields": contents.parts,
        "winds": _winds(contents),
        "grids": [_grid(read_grid(*section)) for section in contents.grids],
        "packings": dict(packings),
        "skipped": [
            {"what": what, "reason": why, "count": count}
            for (what, why), count in sorted(contents.skipped.items())
        ],
    }


def _winds(contents: FileContents) -> list[dict[str, object]]:
    groups: dict[tuple[int, int, int, int], dict[float, str]] = {}
    for row in sorted(contents.fields, key=lambda row: (row.level, row.kind)):
        levels = groups.setdefault((row.valid, row.lead, row.member, row.level_kind), {})
        if row.kind != PRESSURE:
            level = row.level * (0.01 if row.level_kind == ISOBARIC else 1.0)
            levels[level] = levels.get(level, "") + "uv"[row.kind]
    return [
        {
            "valid_time": f"{np.datetime64(valid, 'ns').astype('datetime64[s]')}Z",
            "lead_time_h": lead / 3600.0,
            "member": member,
            "level_unit": _UNITS.get(kind, f"level of type {kind}"),
            "levels": [round(level, 4) for level, found in levels.items() if len(set(found)) == 2],
            "levels_with_one_component": {
                str(level): found[0] for level, found in levels.items() if len(set(found)) == 1
            },
        }
        for (valid, lead, member, kind), levels in sorted(groups.items())
    ]


def _grid(grid: AxesGrid) -> dict[str, object]:
    south, north, west, east = grid.outline()
    steps = (axis[1] - axis[0] if axis.size > 1 else 0.0 for axis in (grid.x, grid.y))
    return {
        "kind": grid.frame.kind,
        "projection": grid.frame.proj,
        "points": [grid.ni, grid.nj],
        "step": [float(np.round(step, 6)) for step in steps],
        "step_unit": ["degree" if grid.frame.meridional else "m"] * 2,
        "latitude_range": [south, north],
        "longitude_range": [west, east],
        "winds_along_grid": grid.wind_along_grid,
    }


def inspect_gridded(path: str) -> dict[str, object]:
    """Model winds of a NetCDF file, Zarr store or other Dataset, ready for JSON."""
    used = engine_of(path)
    found = build_catalogue(path, name="inspected", engine=used)
    times = np.datetime_as_string(found.times, unit="s")
    levels = found.levels(0)
    ends = f"{levels[0] / 100:g} to {levels[-1] / 100:g} hPa"
    return {
        "engine": used,
        "variables": sorted({name for one in found.stored for name in one.names}),
        "times": len(found),
        "first_time": f"{times[0]}Z",
        "last_time": f"{times[-1]}Z",
        "leads_h": sorted({float(s) / 3600.0 for s in found.leads}),
        "levels": f"{levels.size} pressure levels, {ends}"
        if found.is_isobaric(0)
        else f"{levels.size} native levels with their pressure",
        "grids": [
            f"{grid.ni} x {grid.nj} points, latitude {south:.4g} to {north:.4g}, longitude "
            f"{west:.4g} to {east:.4g}, winds "
            + ("along the grid" if grid.wind_along_grid else "to true east and north")
            for grid in (found.grids[n] for n in np.unique(found.profiles["grid"]).tolist())
            for south, north, west, east in [grid.outline()]
        ],
        "notes": found.notes,
        "skipped": found.skipped,
    }
