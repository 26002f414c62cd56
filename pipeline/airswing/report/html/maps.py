"""Maps: positions of the reports over coasts, borders and states.

A map is equirectangular: x is the longitude unwrapped around the middle of the data, and a degree
of longitude is drawn cos(latitude of the middle) as wide as one of latitude, which serves up to the
size of a continent. The outline is part of the package (``data/SOURCE.md``). Many reports (over
20,000) are drawn as a density of hexagons; of more than `MOST_DRAWN` every n-th is drawn, as the
caption says. Counts are of all reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from airswing.flags import PHASE
from airswing.physics.triangle import wrap_degrees
from airswing.report.html import document as html
from airswing.report.html import style
from airswing.report.html.text import plural

Floats = NDArray[np.float64]

LAYERS: dict[str, dict[str, object]] = {
    "state": {"color": "#c3cad2", "linewidth": 0.5},
    "border": {"color": "#98a2ae", "linewidth": 0.7},
    "lake": {"color": style.SOFT, "linewidth": 0.6},
    "coast": {"color": style.SOFT, "linewidth": 0.7},
}
TALLEST, FLATTEST = 0.66, 0.42  # Limits of the drawn height of a map over its width
_LEVELS_HPA = (0, 400, 600, 800, 1100)  # Boundaries of the layers
_PHASES = ("ascent", "cruise", "descent", "unknown")
MOST_DRAWN = 500_000  # Reports a map draws at most


@dataclass(frozen=True)
class View:
    """Limits of a map, degrees; west and east are unwrapped and may pass -180 or 180."""

    west: float
    east: float
    south: float
    north: float

    @property
    def aspect(self) -> float:
        """Length of a degree of latitude over one of longitude, as drawn."""
        # Poleward of 78 degrees a map is not stretched any further.
        return 1 / max(float(np.cos(np.radians((self.south + self.north) / 2))), 0.2)

    @property
    def height_over_width(self) -> float:
        """Drawn height over drawn width."""
        return self.aspect * (self.north - self.south) / (self.east - self.west)

    def unwrapped(self, longitude: ArrayLike) -> Floats:
        """Shift longitudes by whole turns to within 180 degrees of the middle."""
        return _unwrap_around(np.asarray(longitude, float), (self.west + self.east) / 2)


def _unwrap_around(longitude: Floats, middle: float) -> Floats:
    return wrap_degrees(longitude - middle) + middle


def _middle_longitude(longitude: Floats) -> float:
    """Return the middle of the shortest arc that contains all longitudes, in [-180, 180)."""
    values = np.unique(np.round(longitude % 360.0, 1))
    gaps = np.diff(np.append(values, values[0] + 360.0))
    widest = int(np.argmax(gaps))
    first = values[(widest + 1) % values.size]
    return float(wrap_degrees(first + (360.0 - gaps[widest]) / 2))


def view_of(longitude: ArrayLike, latitude: ArrayLike, *, margin: float = 0.06) -> View:
    """Return the map limits that contain all points, at least two degrees wide and high."""
    lon, lat = np.asarray(longitude, float), np.asarray(latitude, float)
    lon, lat = lon[np.isfinite(lon)], lat[np.isfinite(lat)]
    if lon.size == 0 or lat.size == 0:
        return View(-180.0, 180.0, -90.0, 90.0)
    lon = _unwrap_around(lon, _middle_longitude(lon))
    x, y = (lon.min() + lon.max()) / 2, (lat.min() + lat.max()) / 2
    narrowing = max(float(np.cos(np.radians(y))), 0.2)
    width, height = (max(float(np.ptp(one)) * (1 + 2 * margin), 2.0) for one in (lon, lat))
    width = min(max(width, height / narrowing / TALLEST), 360.0)
    height = max(height, width * narrowing * FLATTEST)
    south, north = max(y - height / 2, -90.0), min(y + height / 2, 90.0)
    return View(float(x - width / 2), float(x + width / 2), float(south), float(north))


@lru_cache(maxsize=1)
def lines() -> dict[str, list[Floats]]:
    """Return the lines of each layer (coast, border, state, lake) as (n, 2) arrays, degrees."""
    source = files("airswing.report.html").joinpath("data/outline.npz")
    with source.open("rb") as stream, np.load(stream) as stored:
        return {
            name: np.split(
                stored[f"{name}_points"] / 100.0, np.cumsum(stored[f"{name}_lengths"])[:-1]
            )
            for name in LAYERS
        }


@lru_cache(maxsize=32)
def lines_in(view: View, layer: str) -> list[Floats]:
    """Return the lines of a layer within a view, unwrapped and split at its seam."""
    parts = lines()[layer]
    points = np.concatenate(parts)
    shifted = np.column_stack([view.unwrapped(points[:, 0]), points[:, 1]])
    seams = np.flatnonzero(np.abs(np.diff(shifted[:, 0])) > 180.0) + 1
    starts = np.union1d(np.cumsum([0, *map(len, parts[:-1])]), seams)
    low, high = np.minimum.reduceat(shifted, starts), np.maximum.reduceat(shifted, starts)
    crosses = (high[:, 0] >= view.west) & (low[:, 0] <= view.east)
    crosses &= (high[:, 1] >= view.south) & (low[:, 1] <= view.north)
    crosses &= np.diff(starts, append=len(shifted)) > 1
    return [part for part, seen in zip(np.split(shifted, starts[1:]), crosses, strict=True) if seen]


def _degree_label(positive: str, negative: str) -> FuncFormatter:
    def text(value: float, _position: object = None) -> str:
        shown = float(wrap_degrees(value)) if positive == "E" else value
        hemisphere = positive if shown > 0 else negative
        return f"{abs(shown):g}°{'' if round(abs(shown), 6) in (0, 180) else hemisphere}"

    return FuncFormatter(text)


def draw_map(axes: Axes, view: View, *, ticks: int = 6) -> None:
    """Draw the outline in a panel and set its limits, aspect and degree labels."""
    for name, look in LAYERS.items():
        axes.add_collection(LineCollection(lines_in(view, name), zorder=1.5, **look), autolim=False)
    limits = {"xlim": (view.west, view.east), "ylim": (view.south, view.north)}
    axes.set(aspect=view.aspect, **limits)
    axes.grid(True, linewidth=0.4)
    for axis, most, ends in ((axes.xaxis, ticks, "EW"), (axes.yaxis, max(ticks - 1, 3), "NS")):
        axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 3, 5, 10]))
        axis.set_major_formatter(_degree_label(*ends))
    axes.tick_params(labelsize=8)
    axes.spines[:].set_visible(True)


class Places(NamedTuple):
    """Positions that are drawn with their phase and layer, and counts of all reports."""

    longitude: Floats
    latitude: Floats
    phase: NDArray[np.int8]  # place in `_PHASES`
    layer: NDArray[np.int8]  # -1 outside all layers
    every: int  # one report in so many is drawn
    number: int  # of reports with a position
    phase_counts: NDArray[np.int64]
    layer_counts: NDArray[np.int64]

    def thinning(self) -> str:
        """Return a sentence on the thinning, empty without any."""
        return f" One report in {self.every} is drawn." if self.every > 1 else ""


def places_of(headings: xr.Dataset) -> Places:
    """Return the positions of at most `MOST_DRAWN` reports, taken evenly from the archive."""
    every = max(1, -(-headings.sizes["report"] // MOST_DRAWN))
    drawn = slice(None, None, every)
    order = np.full(max(PHASE.values()) + 1, -1, np.int8)
    order[[PHASE[name] for name in _PHASES]] = range(len(_PHASES))
    phase, layers = order[headings["phase"].to_numpy()], len(_LEVELS_HPA) - 1
    above = np.searchsorted(_LEVELS_HPA, headings["pressure"].to_numpy() / 100.0, "right") - 1
    layer = np.where(above < layers, above, -1).astype(np.int8)
    longitude, latitude = (headings[name].to_numpy() for name in ("longitude", "latitude"))
    number = int((np.isfinite(longitude) & np.isfinite(latitude)).sum())
    return Places(
        longitude[drawn].astype(np.float64),
        latitude[drawn].astype(np.float64),
        phase[drawn],
        layer[drawn],
        every,
        number,
        np.bincount(phase[phase >= 0], minlength=len(_PHASES)),
        np.bincount(layer[layer >= 0], minlength=layers),
    )


def _height(view: View, columns: int, rows: int, *, colourbar: bool = False) -> float:
    width = (style.FULL_WIDTH - (1.1 if colourbar else 0.0)) / columns - 0.55
    return rows * (min(width * view.height_over_width, 7.0) + 0.55)


def _draw_places(
    axes: Axes,
    view: View,
    longitude: Floats,
    latitude: Floats,
    *,
    cells: int,
    dense: bool,
    size: float = 4.0,
) -> PolyCollection | None:
    """Draw reports in a map panel, as points or, if many, as a density."""
    x, mappable = view.unwrapped(longitude), None
    if dense:
        rows = max(int(cells * view.height_over_width / np.sqrt(3)), 4)
        mappable = axes.hexbin(
            x,
            latitude,
            gridsize=(cells, rows),
            mincnt=1,
            cmap=style.DENSITY,
            norm=LogNorm(),
            linewidths=0.1,
            extent=(view.west, view.east, view.south, view.north),
        )
    else:
        # Fainter with more points, so that the densest places remain visible.
        alpha = float(np.clip(1500.0 / max(x.size, 1), 0.15, 0.8))
        axes.scatter(x, latitude, s=size, color=style.BLUE, alpha=alpha, linewidths=0)
    draw_map(axes, view, ticks=6 if cells > 60 else 3)
    return mappable


def reports_figure(headings: xr.Dataset, places: Places) -> Figure:
    """Draw a map of every report."""
    view = view_of(places.longitude, places.latitude)
    shown = np.isfinite(places.longitude + places.latitude)
    dense = int(shown.sum()) > style.MANY
    figure, axes = style.panels(_height(view, 1, 1, colourbar=dense))
    points = places.longitude[shown], places.latitude[shown]
    drawn = _draw_places(axes, view, *points, cells=64, dense=dense)
    if drawn is not None:
        label = f"one in {places.every} reports" if places.every > 1 else "reports"
        bar = figure.colorbar(drawn, ax=axes, label=f"{label} in a cell", shrink=0.8, pad=0.01)
        style.count_ticks(bar, float(np.max(np.asarray(drawn.get_array()))))
    how = "as a density of hexagons, darker where reports are many" if drawn else "one dot each"
    return figure.say(
        f"Positions of the reports (n = {plural(places.number, 'report')} of "
        f"{plural(headings.sizes.get('aircraft', 0), 'aircraft')}), {how}.{places.thinning()}"
    )


def _panels(
    places: Places,
    group: NDArray[np.int8],
    counts: NDArray[np.int64],
    labels: Sequence[str],
    columns: int,
    what: str,
) -> Figure:
    view = view_of(places.longitude, places.latitude)
    rows = -(-len(labels) // columns)
    figure, grid = style.panels(_height(view, columns, rows), rows, columns, squeeze=False)
    masks = [group == number for number in range(len(labels))]
    dense = max(int(mask.sum()) for mask in masks) > style.MANY
    for axes, label, mask, number in zip(grid.flat, labels, masks, counts, strict=False):
        axes.set_title(f"{label}  (n = {number:,})")
        shown = places.longitude[mask], places.latitude[mask]
        _draw_places(axes, view, *shown, size=2.5, cells=40, dense=bool(dense and mask.any()))
        if not mask.any():
            axes.text(0.5, 0.5, "no reports", transform=axes.transAxes, ha="center")
    return figure.say(f"The reports by {what} (n = {counts.sum():,}).{places.thinning()}")


def phase_maps_figure(places: Places) -> Figure:
    """Draw a map of the reports of each phase of flight."""
    names = _PHASES if places.phase_counts[3] else _PHASES[:3]
    what = "phase of flight"
    return _panels(places, places.phase, places.phase_counts, names, len(names), what)


def level_maps_figure(places: Places) -> Figure:
    """Draw a map of the reports of each pressure layer."""
    names = [
        f"{top}-{bottom} hPa" if top else f"above {bottom} hPa"
        for top, bottom in pairwise(_LEVELS_HPA)
    ]
    return _panels(places, places.layer, places.layer_counts, names, 2, "layer")


def places_section(headings: xr.Dataset, show: html.Figures) -> html.Section:
    """Return the section on the positions of the reports."""
    places = places_of(headings)
    inner = [
        show("map_by_phase", phase_maps_figure(places), dpi=120),
        show("map_by_level", level_maps_figure(places), dpi=120),
    ]
    whole = show("map", reports_figure(headings, places), dpi=120)
    parts = [whole, html.folded("By phase of flight and by level", inner)]
    return html.Section("places", "Positions of the reports", "", parts)
