"""Where the reports are: maps of all reports, by phase of flight and by level.

Assumes latitude and longitude in degrees and pressure in Pa.  Few reports are drawn as
points, many (over 20,000) as a density of hexagons on a logarithmic scale; of very many (over
`MOST_DRAWN`) every so manieth is drawn, as the figures then say.  Counts are of all reports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import ArrayLike, NDArray

from airswing.flags import PHASE
from airswing.products.ragged import blocks
from airswing.report.html.outline import View, draw_map, view_of
from airswing.report.html.style import (
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

# Top and bottom of each layer.
_LEVELS_HPA = ((0, 400), (400, 600), (600, 800), (800, 1100))

MOST_DRAWN = 500_000  # Reports a map draws at most


class _Places(NamedTuple):
    """Reports to be drawn, and what there is of them in all."""

    longitude: NDArray[np.float64]
    latitude: NDArray[np.float64]
    group: NDArray[np.int64]
    every: int
    counts: NDArray[np.int64]

    def words(self) -> str:
        """Say what is drawn, where that is not all."""
        return f" Of them, one in {self.every} is drawn." if self.every > 1 else ""


def _places(
    headings: xr.Dataset,
    names: Sequence[str],
    group_of: Callable[[xr.Dataset], NDArray[np.int64]],
    groups: int,
) -> _Places:
    """Reports to be drawn: every so manieth of the archive, so that few enough are left."""
    every = max(1, -(-headings.sizes["report"] // MOST_DRAWN))
    counts, parts, start = np.zeros(groups, dtype=np.int64), [], 0
    for block in blocks(headings, ["longitude", "latitude", *names]):
        group = group_of(block)
        counts += np.bincount(group[group >= 0], minlength=groups)
        drawn = slice(-start % every, None, every)
        # Copies: a view of every so manieth report would keep them all.
        parts.append(
            [
                np.array(block["longitude"].to_numpy()[drawn], float),
                np.array(block["latitude"].to_numpy()[drawn], float),
                group[drawn].copy(),
            ]
        )
        start += block.sizes["report"]
    longitude, latitude, number = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _Places(longitude, latitude, number, every, counts)


def _height(view: View, columns: int, rows: int, *, colourbar: bool = False) -> float:
    width = (FULL_WIDTH - (1.1 if colourbar else 0.0)) / columns - 0.55
    return rows * (min(width * view.height_over_width, 7.0) + 0.55)


def _draw_places(
    axes: Axes,
    view: View,
    longitude: ArrayLike,
    latitude: ArrayLike,
    *,
    cells: int,
    size: float = 4.0,
    dense: bool | None = None,
) -> PolyCollection | None:
    """Draw reports in a map panel, as points or (many) as a density."""
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
        # The more points, the fainter: it still shows where most lie over each other.
        alpha = float(np.clip(1500.0 / max(x.size, 1), 0.15, 0.8))
        axes.scatter(x, y, s=size, color=BLUE, alpha=alpha, linewidths=0, rasterized=True)
    draw_map(axes, view, ticks=6 if cells > 60 else 3)
    return mappable


@styled
def reports_figure(headings: xr.Dataset) -> Figure:
    """Map every report (the seed's Fig. 1).

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude`` (report) and ``aircraft``.
    """

    def known(block: xr.Dataset) -> NDArray[np.int64]:
        finite = np.isfinite(block["longitude"].to_numpy() + block["latitude"].to_numpy())
        return np.where(finite, 0, -1)

    places = _places(headings, [], known, 1)
    view = view_of(places.longitude, places.latitude)
    shown, number = places.group == 0, int(places.counts[0])
    figure = new_figure(_height(view, 1, 1, colourbar=int(shown.sum()) > MANY))
    axes = figure.add_subplot()
    drawn = _draw_places(axes, view, places.longitude[shown], places.latitude[shown], cells=64)
    if drawn is not None:
        label = f"one in {places.every} reports" if places.every > 1 else "reports"
        bar = figure.colorbar(drawn, ax=axes, label=f"{label} in a cell", shrink=0.8, pad=0.01)
        bar.formatter = bar.minorformatter = LogFormatter()
    how = "as a density of hexagons, darker where reports are many" if drawn else "one dot each"
    return figure.say(
        f"Where the reports are (n = {plural(number, 'report')} of "
        f"{plural(headings.sizes.get('aircraft', 0), 'aircraft', 'aircraft')}), {how}."
        f"{places.words()}"
    )


def _panels(places: _Places, labels: Sequence[str], columns: int) -> CaptionedFigure:
    view = view_of(places.longitude, places.latitude)
    rows = -(-len(labels) // columns)
    figure = new_figure(_height(view, columns, rows))
    masks = [places.group == number for number in range(len(labels))]
    dense = max((int(mask.sum()) for mask in masks), default=0) > MANY
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, label, mask, count in zip(grid, labels, masks, places.counts, strict=False):
        axes.set_title(f"{label}  (n = {thousands(count)})")
        if mask.any():
            shown = places.longitude[mask], places.latitude[mask]
            _draw_places(axes, view, *shown, size=2.5, cells=40, dense=dense)
        else:
            draw_map(axes, view, ticks=3)
            axes.text(0.5, 0.5, "no reports", transform=axes.transAxes, ha="center")
    for axes in grid[len(labels) :]:
        blank(axes, "")
    return figure


@styled
def phase_maps_figure(headings: xr.Dataset) -> Figure:
    """Map the reports of each phase of flight (ascent, cruise, descent, and unknown if any).

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude``, ``phase`` (report).
    """
    order = ("ascent", "cruise", "descent", "unknown")
    place = np.full(max(PHASE.values()) + 1, -1)
    place[[PHASE[name] for name in order]] = range(len(order))
    places = _places(headings, ["phase"], lambda block: place[block["phase"].to_numpy()], 4)
    names = [name for name in order if name != "unknown" or places.counts[3]]
    figure = _panels(places, names, len(names))
    told = zip(names, places.counts, strict=False)
    shares = ", ".join(f"{name} {thousands(int(count))}" for name, count in told)
    return figure.say(
        f"The reports by phase of flight: {shares} "
        f"(n = {thousands(headings.sizes['report'])}).{places.words()}"
    )


@styled
def level_maps_figure(headings: xr.Dataset) -> Figure:
    """Map the reports of each layer of pressure.

    Parameters
    ----------
    headings : Dataset
        With ``latitude``, ``longitude``, ``pressure`` (Pa) (report).
    """

    def layer(block: xr.Dataset) -> NDArray[np.int64]:
        pressure = np.asarray(block["pressure"].to_numpy(), float) / 100.0
        found = np.full(pressure.size, -1, dtype=np.int64)
        for number, (top, bottom) in enumerate(_LEVELS_HPA):
            found[(pressure >= top) & (pressure < bottom)] = number
        return found

    places = _places(headings, ["pressure"], layer, len(_LEVELS_HPA))
    names = [
        f"{top:.0f}-{bottom:.0f} hPa" if top else f"above {bottom:.0f} hPa"
        for top, bottom in _LEVELS_HPA
    ]
    figure = _panels(places, names, 2)
    told = zip(names, places.counts, strict=True)
    shares = "; ".join(f"{name} {thousands(count)}" for name, count in told)
    return figure.say(
        f"The reports by layer: {shares} (n = {thousands(headings.sizes['report'])})."
        f"{places.words()}"
    )
