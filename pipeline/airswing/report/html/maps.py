"""Maps: positions of the reports over coasts, borders and states.

A map is equirectangular: x is the longitude unwrapped around the middle of the data, and a degree
of longitude is drawn cos(latitude of the middle) as wide as one of latitude, which serves up to the
size of a continent. The outline is part of the package (``data/SOURCE.md``). Many reports (over
20,000) are drawn as a density of hexagons; if there are more than `MOST_DRAWN`, every n-th is
drawn, as stated in the caption. Counts are of all reports.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.resources import files
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from airswing.flags import PHASE
from airswing.physics.triangle import wrap_degrees
from airswing.report import html
from airswing.report.html import Look, plural

Floats = NDArray[np.float64]
Groups = Mapping[str, NDArray[np.bool_]]

_LAYERS: dict[str, dict[str, object]] = {
    "state": {"color": "#c3cad2", "linewidth": 0.5},
    "border": {"color": "#98a2ae", "linewidth": 0.7},
    "lake": {"color": html.SOFT, "linewidth": 0.6},
    "coast": {"color": html.SOFT, "linewidth": 0.7},
}
_TALLEST, _FLATTEST = 0.66, 0.42  # Limits of the drawn height of a map over its width
_LEVELS_HPA = (0, 400, 600, 800, 1100)  # Boundaries of the layers
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
        return 1 / _narrowing((self.south + self.north) / 2)

    @property
    def height_over_width(self) -> float:
        """Drawn height over drawn width."""
        return self.aspect * (self.north - self.south) / (self.east - self.west)

    def unwrapped(self, longitude: ArrayLike) -> Floats:
        """Shift longitudes by whole turns to within 180 degrees of the middle."""
        middle = (self.west + self.east) / 2
        return wrap_degrees(np.asarray(longitude, float) - middle) + middle


def _narrowing(latitude: float) -> float:
    # Poleward of 78 degrees a map is not stretched any further.
    return max(float(np.cos(np.radians(latitude))), 0.2)


def view_of(longitude: ArrayLike, latitude: ArrayLike, *, margin: float = 0.06) -> View:
    """Return the map limits that contain all points, at least two degrees wide and high."""
    lon, lat = np.asarray(longitude, float), np.asarray(latitude, float)
    lon, lat = lon[np.isfinite(lon)], lat[np.isfinite(lat)]
    if lon.size == 0 or lat.size == 0:
        return View(-180.0, 180.0, -90.0, 90.0)
    # The middle of the shortest arc that contains all longitudes.
    values = np.unique(np.round(lon % 360.0, 1))
    gaps = np.diff(values, append=values[0] + 360.0)
    widest = int(np.argmax(gaps))
    first = values[(widest + 1) % values.size]
    middle = float(wrap_degrees(first + (360.0 - gaps[widest]) / 2))
    lon = wrap_degrees(lon - middle) + middle
    x, y = (lon.min() + lon.max()) / 2, (lat.min() + lat.max()) / 2
    narrowing = _narrowing(float(y))
    width, height = (max(float(np.ptp(one)) * (1 + 2 * margin), 2.0) for one in (lon, lat))
    width = min(max(width, height / narrowing / _TALLEST), 360.0)
    height = max(height, width * narrowing * _FLATTEST)
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
            for name in _LAYERS
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


def draw_map(axes: Axes, view: View, *, ticks: int = 6) -> None:
    """Draw the outline in a panel and set its limits, aspect and degree labels."""
    for name, look in _LAYERS.items():
        axes.add_collection(LineCollection(lines_in(view, name), zorder=1.5, **look), autolim=False)
    limits = {"xlim": (view.west, view.east), "ylim": (view.south, view.north)}
    axes.set(aspect=view.aspect, **limits)
    axes.grid(True, linewidth=0.4)
    for axis, most, ends in ((axes.xaxis, ticks, "EW"), (axes.yaxis, max(ticks - 1, 3), "NS")):
        axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 3, 5, 10]))
        axis.set_major_formatter(FuncFormatter(partial(_degree_label, ends)))
    axes.tick_params(labelsize=8)
    axes.spines[:].set_visible(True)


def _degree_label(ends: str, value: float, _position: object = None) -> str:
    shown = float(wrap_degrees(value)) if ends == "EW" else value
    hemisphere = "" if round(abs(shown), 6) in (0, 180) else ends[int(shown <= 0)]
    return f"{abs(shown):g}°{hemisphere}"


def _map_panels(
    longitude: Floats, latitude: Floats, groups: Groups, columns: int, label: str = ""
) -> tuple[html.CaptionedFigure, bool]:
    longitude, latitude = longitude.astype(float), latitude.astype(float)
    view, rows = view_of(longitude, latitude), -(-len(groups) // columns)
    dense = max(int(mask.sum()) for mask in groups.values()) > html.MANY
    alone = len(groups) == 1
    width = (html.FULL_WIDTH - (1.1 if dense and alone else 0.0)) / columns - 0.55
    height = rows * (min(width * view.height_over_width, 7.0) + 0.55)
    figure, grid = html.panels(height, rows, columns, squeeze=False)
    for axes, (title, mask) in zip(grid.flat, groups.items(), strict=False):
        x, y = view.unwrapped(longitude[mask]), latitude[mask]
        axes.set_title(title)
        if dense and x.size:
            cells = 64 if alone else 40
            look = Look(mincnt=1, cmap=html.DENSITY, norm=LogNorm(), linewidths=0.1)
            look["extent"] = (view.west, view.east, view.south, view.north)
            look["gridsize"] = cells, max(int(cells * view.height_over_width / np.sqrt(3)), 4)
            drawn = axes.hexbin(x, y, **look)
        else:
            # Fainter with more points, so that the densest places remain visible.
            alpha = float(np.clip(1500.0 / max(x.size, 1), 0.15, 0.8))
            look = Look(s=4.0 if alone else 2.5, color=html.BLUE, alpha=alpha, linewidths=0)
            axes.scatter(x, y, **look)
        draw_map(axes, view, ticks=6 if alone else 3)
        if not x.size:
            axes.text(0.5, 0.5, "no reports", transform=axes.transAxes, ha="center")
    if dense and alone:
        bar = figure.colorbar(drawn, ax=axes, label=f"{label} in a cell", shrink=0.8, pad=0.01)
        html.count_ticks(bar, float(np.max(np.asarray(drawn.get_array()))))
    return figure, dense


def places_section(headings: xr.Dataset, show: html.Figures) -> html.Section:
    """Return the section on the positions of the reports: maps of all, by phase and by level."""
    every = max(1, -(-headings.sizes["report"] // MOST_DRAWN))
    thinned = f" One report in {every} is drawn." if every > 1 else ""
    lon, lat = (headings[name].to_numpy() for name in ("longitude", "latitude"))
    phase, level = headings["phase"].to_numpy(), headings["pressure"].to_numpy() / 100.0
    known = np.isfinite(lon + lat)
    layers = {
        f"{top}-{bottom} hPa" if top else f"above {bottom} hPa": (top <= level) & (level < bottom)
        for top, bottom in pairwise(_LEVELS_HPA)
    }
    phases = {name: phase == PHASE[name] for name in ("ascent", "cruise", "descent", "unknown")}
    if not phases["unknown"].any():
        del phases["unknown"]

    few = slice(None, None, every)
    label = f"one in {every} reports" if every > 1 else "reports"
    figure, dense = _map_panels(lon[few], lat[few], {"": known[few]}, 1, label)
    how = "as a density of hexagons, darker where reports are many" if dense else "one dot each"
    figure.say(
        f"Positions of the reports (n = {plural(int(known.sum()), 'report')} of "
        f"{plural(headings.sizes.get('aircraft', 0), 'aircraft')}), {how}.{thinned}"
    )
    parts, inner = [show("map", figure, dpi=120)], []
    for kind, words, groups, columns in (
        ("phase", "phase of flight", phases, len(phases)),
        ("level", "layer", layers, 2),
    ):
        titled = {f"{name}  (n = {mask.sum():,})": mask[few] for name, mask in groups.items()}
        figure, _ = _map_panels(lon[few], lat[few], titled, columns)
        number = sum(int(mask.sum()) for mask in groups.values())
        figure.say(f"The reports by {words} (n = {number:,}).{thinned}")
        inner.append(show(f"map_by_{kind}", figure, dpi=120))
    parts.append(html.folded("By phase of flight and by level", *inner))
    return html.Section("places", "Positions of the reports", "", parts)
