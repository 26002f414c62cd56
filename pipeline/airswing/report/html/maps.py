"""Maps: positions of the reports over coasts, borders and states.

Equirectangular: a degree of longitude is drawn cos(latitude of the middle) as wide as one of
latitude, which serves up to the size of a continent. Sources of the outline: ``data/SOURCE.md``.
"""

from __future__ import annotations

from functools import lru_cache, partial
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from airswing.physics.great_circle import unwrapped
from airswing.physics.triangle import wrap_degrees
from airswing.report import html
from airswing.report.html import Look, plural

Floats = NDArray[np.float64]

_LAYERS: dict[str, dict[str, object]] = {
    "state": {"color": "#c3cad2", "linewidth": 0.5},
    "border": {"color": "#98a2ae", "linewidth": 0.7},
    "lake": {"color": html.SOFT, "linewidth": 0.6},
    "coast": {"color": html.SOFT, "linewidth": 0.7},
}
_TALLEST, _FLATTEST = 0.66, 0.42  # Limits of the drawn height of a map over its width
MOST_DRAWN = 500_000  # Reports a map draws at most


class View(NamedTuple):
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
    lon, lat = (deg[np.isfinite(deg)] for deg in (np.asarray(longitude), np.asarray(latitude)))
    if lon.size == 0 or lat.size == 0:
        return View(-180.0, 180.0, -90.0, 90.0)
    (x, width), (y, height) = (
        ((values.min() + values.max()) / 2, max(float(np.ptp(values)) * (1 + 2 * margin), 2.0))
        for values in (unwrapped(lon), lat)
    )
    narrowing = _narrowing(float(y))
    width = min(max(width, height / narrowing / _TALLEST), 360.0)
    height = max(height, width * narrowing * _FLATTEST)
    south, north = max(y - height / 2, -90.0), min(y + height / 2, 90.0)
    return View(float(x - width / 2), float(x + width / 2), float(south), float(north))


@lru_cache(maxsize=1)
def lines() -> dict[str, list[Floats]]:
    """Return the lines of each layer as (n, 2) arrays, degrees; they may pass -180 or 180."""
    source, layers = files("airswing.report.html").joinpath("data/outline.npz"), {}
    with source.open("rb") as stream, np.load(stream) as stored:
        for name in _LAYERS:
            ends = np.cumsum(stored[f"{name}_lengths"])[:-1]
            layers[name] = [
                np.column_stack([np.unwrap(longitude, period=360.0), latitude])
                for longitude, latitude in np.split(
                    stored[f"{name}_points"].T / 100.0, ends, axis=1
                )
            ]
    return layers


def draw_map(axes: Axes, view: View) -> None:
    """Draw the outline in a panel and set its limits, aspect and degree labels."""
    for name, look in _LAYERS.items():
        turns = [line + np.array([turn, 0]) for turn in (-360, 0, 360) for line in lines()[name]]
        axes.add_collection(LineCollection(turns, zorder=1.5, **look), autolim=False)
    axes.set(aspect=view.aspect, xlim=view[:2], ylim=view[2:])
    axes.grid(True, linewidth=0.4)
    for axis, most, ends in ((axes.xaxis, 6, "EW"), (axes.yaxis, 5, "NS")):
        axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 3, 5, 10]))
        axis.set_major_formatter(FuncFormatter(partial(_degree_label, ends)))
    axes.tick_params(labelsize=8)
    axes.spines[:].set_visible(True)


def _degree_label(ends: str, value: float, _position: object = None) -> str:
    shown = float(wrap_degrees(value)) if ends == "EW" else value
    hemisphere = "" if round(abs(shown), 6) in (0, 180) else ends[int(shown <= 0)]
    return f"{abs(shown):g}°{hemisphere}"


def places_section(headings: xr.Dataset, show: html.Figures) -> html.Section:
    """Return the section on the positions of the reports: a map of dots, or of their density."""
    every = max(1, -(-headings.sizes["report"] // MOST_DRAWN))
    lon, lat = (np.asarray(headings[name], float) for name in ("longitude", "latitude"))
    finite = np.isfinite(lon + lat)
    number = int(finite.sum())
    lon, lat = lon[finite][::every], lat[finite][::every]
    view, style = view_of(lon, lat), "one dot each"
    x, dense = view.unwrapped(lon), lon.size > html.MANY
    width = html.FULL_WIDTH - (1.65 if dense else 0.55)
    figure, axes = html.panels(min(width * view.height_over_width, 7.0) + 0.55)
    if dense:
        style = "as a density of hexagons, darker where reports are many"
        look = Look(mincnt=1, cmap=html.DENSITY, norm=LogNorm(), linewidths=0.1, extent=view)
        look["gridsize"] = 64, max(int(64 * view.height_over_width / np.sqrt(3)), 4)
        drawn = axes.hexbin(x, lat, **look)
        label = f"one in {every} reports" if every > 1 else "reports"
        bar = figure.colorbar(drawn, ax=axes, label=f"{label} in a cell", shrink=0.8, pad=0.01)
        html.count_ticks(bar, float(np.max(np.asarray(drawn.get_array()))))
    else:
        # Fainter with more points, so that the densest places remain visible.
        alpha = float(np.clip(1500.0 / max(x.size, 1), 0.15, 0.8))
        axes.scatter(x, lat, s=4.0, color=html.BLUE, alpha=alpha, linewidths=0)
    draw_map(axes, view)
    figure.say(
        f"Positions of the reports (n = {plural(number, 'report')} of "
        f"{plural(headings.sizes['aircraft'], 'aircraft')}), {style}."
        + (f" One report in {every} is drawn." if every > 1 else "")
    )
    return html.Section("places", "Positions of the reports", "", [show("map", figure, dpi=120)])
