"""Where the gap lies: pictures of the residual by aircraft and heading, level, place and time.

Assumes the maps :func:`airswing.gap.evidence.localisation.residual_maps` puts into ``gap.nc``:
residuals are reported minus simulated, averaged in cells; NaN, and white, where fewer than two
flights are. Colours diverge around zero, orange against purple, and one scale holds within a
figure. Each figure says of how many reports the diagnosis is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.gap.result.schema import GapReport
from airswing.report.html.maps import draw_map, view_of
from airswing.report.html.style import (
    DIVERGING,
    INK,
    VERMILION,
    CaptionedFigure,
    empty_figure,
    new_figure,
    plural,
    styled,
)

Floats = NDArray[np.float64]

# Of the scale's half width: on cells darker than this, ink cannot be read.
_DARK = 0.62


def _cells(maps: xr.Dataset, name: str, *dims: str) -> Floats:
    return np.asarray(maps[name].transpose(*dims).to_numpy(), float)


def _counted(gap: GapReport) -> str:
    """Return the caption's brackets: reports, and what a white cell means."""
    return f"n = {plural(gap.counts.reports, 'report')}; white: too few flights"


def _even_limit(values: Floats, *, least: float = 0.5) -> float:
    """Return the half width of a diverging colour scale that holds 98 % of the cells."""
    finite = np.abs(values[np.isfinite(values)])
    # Not of the largest: one wild cell would leave all others pale.
    return max(float(np.percentile(finite, 98)), least) if finite.size else least


def _edges(centres: Floats) -> Floats:
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    first, last = 2 * centres[0] - middle[0], 2 * centres[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


@styled
def aircraft_heading_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    """Heat map of the mean heading error by aircraft and magnetic heading.

    Cells beyond two standard errors carry their value in figures, where there is room; aircraft
    that a verdict names are bold.

    Parameters
    ----------
    maps : Dataset
        ``gap.nc``: ``heading_map`` and its standard error (aircraft, octant), degrees.
    """
    centres = np.asarray(maps["octant"].to_numpy(), float)
    shown = _cells(maps, "heading_map", "aircraft", "octant")
    error = _cells(maps, "heading_map_standard_error", "aircraft", "octant")
    figure, axes, named = _aircraft_grid(maps, centres, shown, gap)
    if len(shown) <= 60:
        strong = np.argwhere(np.abs(shown) > 2 * error)
        texts = [(centres[column], row, shown[row, column]) for row, column in strong]
        _cell_texts(axes, texts, _even_limit(shown), decimals=1, size=7.5)
    first = min(float(_edges(centres)[0]), 0.0)
    axes.set_xticks(range(0, 361, 45))
    axes.set_xlabel("indicated magnetic heading (degree)")
    axes.set_xlim(first, 360.0 + first)
    bold = " Bold: aircraft that a verdict names." if named else ""
    return figure.say(
        f"Mean heading error (degree) by aircraft and magnetic heading ({_counted(gap)}). A "
        "compass fault shows as a row with a wave or one colour, a model fault as stripes across "
        f"the fleet.{bold}"
    )


@styled
def aircraft_time_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    """Heat map of the mean heading error by aircraft and week.

    Parameters
    ----------
    maps : Dataset
        ``gap.nc``: ``time_line`` (aircraft, week), degrees, and ``day``.
    """
    weeks = week_starts(maps)
    shown = _cells(maps, "time_line", "aircraft", "week")
    figure, axes, _ = _aircraft_grid(maps, np.arange(weeks.size, dtype=float), shown, gap)
    ticks = np.arange(0, weeks.size, max(1, -(-weeks.size // 10)))
    axes.set_xticks(ticks, [np.datetime_as_string(weeks[i], "D") for i in ticks])
    axes.set_xlabel("week from (date)")
    return figure.say(
        f"Mean heading error (degree) by aircraft and week ({_counted(gap)}). A fault that "
        "begins at a date shows as a row that changes colour there."
    )


def week_starts(maps: xr.Dataset) -> NDArray[np.datetime64]:
    """Return the first day of each week."""
    return np.asarray(
        maps["day"].to_numpy().min() + maps["week"].to_numpy().astype("timedelta64[W]")
    )


def _aircraft_grid(
    maps: xr.Dataset, centres: Floats, shown: Floats, gap: GapReport
) -> tuple[CaptionedFigure, Axes, set[str]]:
    """Draw a row an aircraft; return the names set in bold too."""
    tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
    named = {tail for effect in gap.effects for tail in effect.tails}
    figure = new_figure(1.25 + max(0.19 * len(tails), 1.4))
    axes = figure.add_subplot()
    # Even on both sides, so that the middle colour is no error.
    limit = _even_limit(shown)
    drawn = axes.pcolormesh(
        _edges(centres),
        np.arange(len(tails) + 1) - 0.5,
        shown,
        cmap=DIVERGING,
        vmin=-limit,
        vmax=limit,
        rasterized=True,
    )
    axes.set_yticks(range(len(tails)), tails, fontsize=8 if len(tails) <= 40 else 6.5)
    for label in axes.get_yticklabels():
        if label.get_text() in named:
            label.set_fontweight("bold")
            label.set_color(VERMILION)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    figure.colorbar(drawn, ax=axes, label="mean heading error (degree)", pad=0.01, extend="both")
    return figure, axes, named


def _cell_texts(
    axes: Axes,
    texts: Sequence[tuple[float, float, float]],
    limit: float,
    *,
    decimals: int,
    size: float,
) -> None:
    """Write (x, y, value) into the cells of a map, white on what is dark."""
    for x, y, value in texts:
        colour = "white" if abs(value) > _DARK * limit else INK
        # what rounds to nothing has no sign
        said = f"{round(value, decimals) + 0.0:+.{decimals}f}"
        axes.text(x, y, said, ha="center", va="center", fontsize=size, color=colour)


def _layers(middle: Floats) -> list[str]:
    """Return the bounds of layers of these middles (increasing), hPa; the first begins at 0."""
    edges = [0.0]
    for one in middle:
        edges.append(2.0 * float(one) - edges[-1])
    lower = [f"{top:.0f}-{bottom:.0f}" for top, bottom in pairwise(edges[1:])]
    return [f"above {edges[1]:.0f}", *lower]


@styled
def phase_level_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    """Heat maps of the mean residual by phase of flight and level, along and across the heading.

    Phases without a value are left out; levels stand from the ground up.

    Parameters
    ----------
    maps : Dataset
        ``gap.nc``: ``level_map_along`` and ``level_map_cross`` (phase, level), m/s.
    """
    across = _cells(maps, "level_map_cross", "phase", "level")
    along = _cells(maps, "level_map_along", "phase", "level")
    level = np.asarray(maps["level"].to_numpy(), float)
    filled, up = np.flatnonzero(np.isfinite(across).any(axis=1)), np.argsort(-level)
    layers = _layers(level)
    pick = np.ix_(filled, up)
    shown = {"along the heading": along[pick].T, "across the heading": across[pick].T}
    limit = _even_limit(np.concatenate([v.ravel() for v in shown.values()]), least=0.2)
    figure = new_figure(1.4 + 0.36 * level.size)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, value) in zip(panels, shown.items(), strict=True):
        drawn = axes.imshow(
            value, cmap=DIVERGING, vmin=-limit, vmax=limit, origin="lower", aspect="auto"
        )
        axes.set_title(name)
        axes.set_xticks(range(filled.size), [str(maps["phase"].to_numpy()[i]) for i in filled])
        axes.set_yticks(range(level.size), [layers[one] for one in up])
        axes.grid(visible=False)
        texts = [(x, y, cell) for (y, x), cell in np.ndenumerate(value) if np.isfinite(cell)]
        _cell_texts(axes, texts, limit, decimals=2, size=8)
    panels[0].set_ylabel("layer (hPa)")
    figure.colorbar(drawn, ax=list(panels), label="mean residual (m/s)", pad=0.01)
    return figure.say(
        f"Mean residual by phase of flight and layer ({_counted(gap)}; in each cell the "
        "mean in m/s)."
    )


@styled
def gap_map_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    """Map of the mean residual in cells: speed by colour, direction by arrows.

    Parameters
    ----------
    maps : Dataset
        ``gap.nc``: ``region_map_u`` and ``region_map_v`` (latitude, longitude), m/s.
    """
    lon, lat = (np.asarray(maps[name].to_numpy(), float) for name in ("longitude", "latitude"))
    u, v = (_cells(maps, f"region_map_{way}", "latitude", "longitude") for way in "uv")
    filled = np.isfinite(u) & np.isfinite(v)
    if not filled.any():
        return empty_figure("No cell holds enough reports for a map")
    rows, columns = np.nonzero(filled)
    view = view_of(lon[columns], lat[rows], margin=0.1)
    figure = new_figure(min(8.2 * view.height_over_width, 6.5) + 0.7)
    axes = figure.add_subplot()
    speed = np.hypot(u, v)
    length = _even_limit(speed)
    x = view.unwrapped(lon)
    order = np.argsort(x)
    drawn = axes.pcolormesh(
        _edges(x[order]),
        _edges(lat),
        speed[:, order],
        cmap="YlOrBr",
        vmin=0,
        vmax=length,
        alpha=0.85,
        rasterized=True,
    )
    arrows = axes.quiver(
        x[columns],
        lat[rows],
        u[filled],
        v[filled],
        color=INK,
        width=0.0022,
        scale=length * 22,
        pivot="mid",
        zorder=3,
    )
    draw_map(axes, view)
    said, look = f"{length:.1f} m/s", {"size": 8.5}
    axes.quiverkey(arrows, 0.9, 1.025, round(length, 1), said, labelpos="E", fontproperties=look)
    figure.colorbar(
        drawn, ax=axes, label="length of the mean residual (m/s)", shrink=0.85, pad=0.01
    )
    return figure.say(
        f"Mean residual wind (reported minus simulated) by place: colour its length, arrows where "
        f"it blows to ({_counted(gap)})."
    )
