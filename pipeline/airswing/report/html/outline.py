"""Coast, borders and states behind a map, on a local equirectangular view.

Assumes longitudes in degrees east of any range and latitudes in degrees north.  The view is
plain: x is longitude unwrapped around the middle of the data, y latitude, and one degree of
longitude is drawn cos(latitude of the middle) as wide as one of latitude.  That is good for
context up to a continent; for the whole world it is a plate carree.  The lines are shipped
with the package (``data/SOURCE.md``): nothing is fetched.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import wrap_degrees
from airswing.report.html.style import SOFT

Floats = NDArray[np.float64]

LAYERS: dict[str, dict[str, object]] = {
    "state": {"color": "#c3cad2", "linewidth": 0.5},
    "border": {"color": "#98a2ae", "linewidth": 0.7},
    "lake": {"color": SOFT, "linewidth": 0.6},
    "coast": {"color": SOFT, "linewidth": 0.7},
}


TALLEST, FLATTEST = 0.66, 0.42  # Limits of a window's drawn height over its width


@dataclass(frozen=True)
class View:
    """A map's window: middle longitude and the limits around it, all in degrees.

    ``west`` and ``east`` are unwrapped: they may pass -180 or 180, and ``west < east`` always.
    """

    west: float
    east: float
    south: float
    north: float

    @property
    def middle(self) -> float:
        """Longitude of the middle of the window."""
        return (self.west + self.east) / 2

    @property
    def aspect(self) -> float:
        """Length of a degree of latitude over one of longitude, as drawn."""
        # Poleward of 78 degrees a map is not stretched any further.
        return 1 / max(float(np.cos(np.radians((self.south + self.north) / 2))), 0.2)

    @property
    def height_over_width(self) -> float:
        """Shape of the window as drawn."""
        return self.aspect * (self.north - self.south) / (self.east - self.west)

    def unwrapped(self, longitude: ArrayLike) -> Floats:
        """Bring longitudes within 180 degrees of the middle of the window."""
        return _unwrap_around(np.asarray(longitude, float), self.middle)


def _unwrap_around(longitude: Floats, middle: float) -> Floats:
    """Shift longitudes by whole turns to lie in [middle - 180, middle + 180)."""
    return wrap_degrees(longitude - middle) + middle


def middle_longitude(longitude: ArrayLike) -> float:
    """Middle of the shortest arc that holds all longitudes, across the antimeridian or not.

    Parameters
    ----------
    longitude : array (n,)
        Degrees east; NaN is ignored.

    Returns
    -------
    float
        Degrees in [-180, 180).
    """
    values = np.asarray(longitude, float)
    values = np.unique(np.round(values[np.isfinite(values)] % 360.0, 1))
    if values.size == 0:
        return 0.0
    gaps = np.diff(np.append(values, values[0] + 360.0))
    widest = int(np.argmax(gaps))
    first = values[(widest + 1) % values.size]
    length = 360.0 - gaps[widest]
    return float(wrap_degrees(first + length / 2))


def view_of(longitude: ArrayLike, latitude: ArrayLike, *, margin: float = 0.06) -> View:
    """Return the window that holds all points with a margin, two degrees wide and high at least.

    Parameters
    ----------
    longitude, latitude : array (n,)
        Degrees; NaN is ignored.
    margin : float, optional
        Part of the extent added on each side.
    """
    lat = np.asarray(latitude, float)
    lat = lat[np.isfinite(lat)]
    middle = middle_longitude(longitude)
    lon = _unwrap_around(np.asarray(longitude, float), middle)
    lon = lon[np.isfinite(lon)]
    if lon.size == 0 or lat.size == 0:
        return View(-180.0, 180.0, -90.0, 90.0)
    narrowing = max(float(np.cos(np.radians(y := (lat.min() + lat.max()) / 2))), 0.2)
    width = max(float(np.ptp(lon)) * (1 + 2 * margin), 2.0)
    height = max(float(np.ptp(lat)) * (1 + 2 * margin), 2.0)
    width = min(max(width, height / narrowing / TALLEST), 360.0)
    height = max(height, width * narrowing * FLATTEST)
    x = (lon.min() + lon.max()) / 2
    south, north = max(y - height / 2, -90.0), min(y + height / 2, 90.0)
    return View(float(x - width / 2), float(x + width / 2), float(south), float(north))


@lru_cache(maxsize=1)
def lines() -> dict[str, list[Floats]]:
    """Return the shipped lines of each layer (coast, border, state, lake), degrees (n, 2)."""
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
    """Return the lines of a layer that touch a window, unwrapped and split at its seam."""
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


def _degree_label(positive: str, negative: str, *, wraps: bool) -> FuncFormatter:
    def text(value: float, _position: object = None) -> str:
        shown = float(wrap_degrees(value)) if wraps else value
        if round(shown, 6) == 0:
            return "0°"
        if wraps and round(abs(shown), 6) == 180:
            return "180°"
        return f"{abs(shown):g}°{positive if shown > 0 else negative}"

    return FuncFormatter(text)


def draw_map(axes: Axes, view: View, *, ticks: int = 6) -> None:
    """Draw the outline in a panel, set its limits, shape and degree labels.

    Parameters
    ----------
    axes : matplotlib Axes
        The panel.
    ticks : int, optional
        About how many degree labels along x.
    """
    for name, look in LAYERS.items():
        drawn = LineCollection(lines_in(view, name), zorder=1.5, rasterized=True, **look)
        axes.add_collection(drawn, autolim=False)
    axes.set_xlim(view.west, view.east)
    axes.set_ylim(view.south, view.north)
    axes.set_aspect(view.aspect)
    axes.grid(True, linewidth=0.4)
    axes.xaxis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 3, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(max(ticks - 1, 3), steps=[1, 2, 3, 5, 10]))
    axes.xaxis.set_major_formatter(_degree_label("E", "W", wraps=True))
    axes.yaxis.set_major_formatter(_degree_label("N", "S", wraps=False))
    axes.tick_params(labelsize=8)
    for spine in axes.spines.values():
        spine.set_visible(True)
