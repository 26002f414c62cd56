"""Readable summary of model files: times, leads, levels, grids, and skipped content."""

from __future__ import annotations

import numpy as np

from airswing.reference.catalogue import build_catalogue
from airswing.reference.grids import AxesGrid, Grid


def inspect_winds(path: str) -> dict[str, object]:
    """Model winds of a file or store, ready for JSON."""
    catalogue = build_catalogue(path, name="inspected")
    times = np.datetime_as_string(catalogue.times, unit="s")
    levels = catalogue.levels(0)
    grids = (catalogue.grids[number] for number in np.unique(catalogue.profiles["grid"]).tolist())
    return {
        "engine": catalogue.engine,
        "variables": sorted({name for stored in catalogue.stored for name in stored.names}),
        "times": len(catalogue),
        "first_time": f"{times[0]}Z",
        "last_time": f"{times[-1]}Z",
        "leads_h": (np.unique(catalogue.leads) / 3600.0).tolist(),
        "members": np.unique(catalogue.profiles["member"]).tolist(),
        "levels": f"{levels.size} pressure levels, {levels[0] / 100:g} to {levels[-1] / 100:g} hPa"
        if catalogue.is_isobaric(0)
        else f"{levels.size} native levels with their pressure",
        "grids": [_described(grid) for grid in grids],
        "notes": catalogue.notes,
        "skipped": catalogue.skipped,
    }


def _described(grid: Grid) -> str:
    south, north, west, east = grid.outline()
    projection = f" ({grid.frame.proj})" if isinstance(grid, AxesGrid) and grid.frame.proj else ""
    way = "along the grid" if grid.wind_along_grid else "to true east and north"
    return (
        f"{grid.name}{projection}, {grid.ni} x {grid.nj} points, latitude {south:.4g} to "
        f"{north:.4g}, longitude {west:.4g} to {east:.4g}, winds {way}"
    )
