"""Where the reports are: maps of all reports, by phase of flight and by level.

Assumes latitude and longitude in degrees and pressure in Pa.  Few reports are drawn as
points, many (over 20,000) as a density of hexagons on a logarithmic scale.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.report.outline import View, draw_map, view_of
from airswing.report.style import (
    BLUE,
    DENSITY,
    FULL_WIDTH,
    MANY,
    CaptionedFigure,
    blank,
    new_figure,
    plural,
    styled,
    thousands,
)
from airswing.vocabulary import PHASE

LEVELS_HPA: tuple[tuple[float, float], ...] = ((0, 400), (400, 600), (600, 800), (800, 1100))

Mask = NDArray[np.bool_]


def _places(headings: xr.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    longitude = np.asarray(headings["longitude"].to_numpy(), float)
    latitude = np.asarray(headings["latitude"].to_numpy(), float)
    return longitude, latitude


def _height(view: View, columns: int, rows: int, *, colourbar: bool = False) -> float:
    width = (FULL_WIDTH - (1.1 if colourbar else 0.0)) / columns - 0.55
    return rows * (min(width * view.height_over_width, 7.0) + 0.55)


def draw_places(
    axes: Axes,
    view: View,
    longitude: Any,
    latitude: Any,
    *,
    size: float = 4.0,
    cells: int = 60,
    dense: bool | None = None,
) -> Any:
    """Draw reports in a map panel, as points or (many) as a density.

    Parameters
    ----------
    axes : matplotlib Axes
        A panel, not yet drawn on.
    view : View
        The window.
    longitude, latitude : array (n,)
        Degrees.
    size : float, optional
        Area of a point, points squared.
    cells : int, optional
        Hexagons along the panel.
    dense : bool, optional
        Density (True) or points (False); by default density from 20,000 reports.

    Returns
    -------
    the density's mappable, or None for points
    """
    x, y = view.unwrapped(longitude), np.asarray(latitude, float)
    mappable = None
    if x.size > MANY if dense is None else dense:
        rows = max(int(cells * view.height_over_width / np.sqrt(3)), 4)
        mappable = axes.hexbin(
            x,
            y,
            gridsize=(cells, rows),
            mincnt=1,
            cmap=DENSITY,
            norm=LogNorm(),
            linewidths=0.1,
            extent=(view.west, view.east, view.south, view.north),
            rasterized=True,
        )
    else:
        alpha = float(np.clip(1500.0 / max(x.size, 1), 0.15, 0.8))
        axes.scatter(x, y, s=size, color=BLUE, alpha=alpha, linewidths=0, rasterized=True)
    draw_map(axes, view, ticks=6 if cells > 60 else 3)
    return mappable


@styled
def reports_figure(headings: xr.Dataset, *, keep: Mask | None = None, title: str = "") -> Figure:
    """Map every report (the seed's Fig. 1).

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude`` (report) and ``aircraft``.
    keep : array of bool (report,), optional
        Reports to show; all by default.
    title : str, optional
        Heading of the panel.

    Returns
    -------
    CaptionedFigure
    """
    longitude, latitude = _places(headings)
    view = view_of(longitude, latitude)
    shown = np.isfinite(longitude) & np.isfinite(latitude)
    shown &= True if keep is None else keep
    figure = new_figure(_height(view, 1, 1, colourbar=int(shown.sum()) > MANY))
    axes = figure.add_subplot()
    drawn = draw_places(axes, view, longitude[shown], latitude[shown], cells=64)
    if drawn is not None:
        figure.colorbar(drawn, ax=axes, label="reports in a cell", shrink=0.8, pad=0.01)
    axes.set_title(title)
    how = "as a density of hexagons, darker where reports are many" if drawn else "one dot each"
    return figure.say(
        f"Where the reports are (n = {plural(int(shown.sum()), 'report')} of "
        f"{plural(headings.sizes.get('aircraft', 0), 'aircraft', 'aircraft')}), {how}."
    )


def _panels(headings: xr.Dataset, groups: list[tuple[str, Mask]], columns: int) -> CaptionedFigure:
    longitude, latitude = _places(headings)
    view = view_of(longitude, latitude)
    rows = -(-len(groups) // columns)
    figure = new_figure(_height(view, columns, rows))
    dense = max((int(mask.sum()) for _, mask in groups), default=0) > MANY
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (label, mask) in zip(grid, groups, strict=False):
        axes.set_title(f"{label}  (n = {thousands(mask.sum())})")
        if mask.any():
            draw_places(
                axes, view, longitude[mask], latitude[mask], size=2.5, cells=40, dense=dense
            )
        else:
            draw_map(axes, view, ticks=3)
            axes.text(0.5, 0.5, "no reports", transform=axes.transAxes, ha="center")
    for axes in grid[len(groups) :]:
        blank(axes, "")
    return figure


@styled
def phase_maps_figure(headings: xr.Dataset) -> Figure:
    """Map the reports of each phase of flight (ascent, cruise, descent, and unknown if any).

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude``, ``phase`` (report).

    Returns
    -------
    CaptionedFigure
    """
    phase = headings["phase"].to_numpy()
    order = ("ascent", "cruise", "descent", "unknown")
    groups = [(name, np.asarray(phase == PHASE[name])) for name in order]
    groups = [(name, mask) for name, mask in groups if name != "unknown" or mask.any()]
    figure = _panels(headings, groups, len(groups))
    shares = ", ".join(f"{name} {thousands(int(mask.sum()))}" for name, mask in groups)
    return figure.say(f"The reports by phase of flight: {shares} (n = {thousands(phase.size)}).")


@styled
def level_maps_figure(
    headings: xr.Dataset, *, levels: tuple[tuple[float, float], ...] = LEVELS_HPA
) -> Figure:
    """Map the reports of each layer of pressure.

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude``, ``pressure`` (Pa) (report).
    levels : tuple of (top, bottom), optional
        Layers, hPa.

    Returns
    -------
    CaptionedFigure
    """
    pressure = np.asarray(headings["pressure"].to_numpy(), float) / 100.0
    groups = [
        (
            f"{top:.0f}-{bottom:.0f} hPa" if top else f"above {bottom:.0f} hPa",
            (pressure >= top) & (pressure < bottom),
        )
        for top, bottom in levels
    ]
    figure = _panels(headings, groups, 2)
    shares = "; ".join(f"{name} {thousands(mask.sum())}" for name, mask in groups)
    return figure.say(f"The reports by layer: {shares} (n = {thousands(pressure.size)}).")
