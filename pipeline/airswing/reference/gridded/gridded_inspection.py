"""What model winds that come as Datasets hold, for people."""

from __future__ import annotations

import numpy as np

from airswing.reference.geometry.model_time import HYBRID
from airswing.reference.geometry.placing import Placing
from airswing.reference.gridded.gridded_catalogue import (
    GriddedCatalogue,
    build_gridded_catalogue,
    engine_of,
)


def inspect_gridded(path: str) -> dict[str, object]:
    """What the model winds of a file are, for people, ready for JSON; opened by its content.

    Raises
    ------
    InputError
        Where it holds no usable winds.
    """
    used = engine_of(path)
    found = build_gridded_catalogue(path, name="inspected", engine=used)
    times = np.datetime_as_string(found.times, unit="s")
    return {
        "engine": used,
        "variables": sorted({name for one in found.stored for name in one.names}),
        "times": len(found),
        "first_time": f"{times[0]}Z",
        "last_time": f"{times[-1]}Z",
        "leads_h": sorted({float(s) / 3600.0 for s in found.leads}),
        "levels": _levels_in_words(found),
        "grids": [_grid_in_words(found.grids[int(n)]) for n in np.unique(found.grid_numbers)],
        "notes": found.notes,
        "skipped": found.skipped,
    }


def _levels_in_words(found: GriddedCatalogue) -> str:
    levels = found.levels(0)
    if found.level_kinds[0] == HYBRID:
        return f"{levels.size} native levels with their pressure"
    return f"{levels.size} pressure levels, {levels[0] / 100:g} to {levels[-1] / 100:g} hPa"


def _grid_in_words(grid: Placing) -> str:
    south, north, west, east = grid.outline()
    way = "along the grid" if grid.wind_along_grid else "to true east and north"
    return (
        f"{grid.ni} x {grid.nj} points, latitude {south:.4g} to {north:.4g}, "
        f"longitude {west:.4g} to {east:.4g}, winds {way}"
    )
