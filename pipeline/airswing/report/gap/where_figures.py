"""Where the gap lies: pictures of the residual by aircraft and heading, level, place and time.

Assumes plain arrays: residuals are reported minus simulated wind, m/s, averaged in cells, with
the number of reports in each; NaN where a cell is empty.  Cells with few reports are left
white.  Colours diverge around zero, orange against purple, and one scale holds within a figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from airswing.report.html.outline import draw_map, view_of
from airswing.report.html.style import (
    DIVERGING,
    INK,
    VERMILION,
    compass_axis,
    empty_figure,
    new_figure,
    plural,
    styled,
)

Floats = NDArray[np.float64]
FEW = 10
"""Reports below which a cell is left white."""


def _shown_cells(value: ArrayLike, number: ArrayLike | None, *, few: int = FEW) -> Floats:
    """Return the values with cells of fewer than `few` reports, where counted, set to NaN."""
    values = np.asarray(value, float)
    if number is None:
        return values
    return np.where(np.asarray(number, float) >= few, values, np.nan)


def _counted(number: ArrayLike | None, total: int) -> str:
    """Return the caption's brackets: reports, and what a white cell means."""
    if number is None:
        shown = f"n = {plural(total, 'report')}; " if total else ""
        return f"{shown}white: too few flights"
    total = int(np.nansum(np.asarray(number, float)))
    return f"n = {plural(total, 'report')}; white: fewer than {FEW} reports"


def _even_limit(values: Floats, *, least: float = 0.5) -> float:
    """Return the half width of a diverging colour scale that holds 98 % of the cells."""
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(finite, 98)), least) if finite.size else least


def _edges(centres: Floats) -> Floats:
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    first, last = 2 * centres[0] - middle[0], 2 * centres[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


@styled
def aircraft_heading_figure(
    tails: Sequence[str],
    heading: ArrayLike,
    value: ArrayLike,
    number: ArrayLike | None = None,
    *,
    standard_error: ArrayLike | None = None,
    quantity: str = "mean residual across the heading (m/s)",
    outstanding: Sequence[str] = (),
    total: int = 0,
) -> Figure:
    """Heat map of a mean by aircraft and magnetic heading.

    Parameters
    ----------
    tails : sequence of str (aircraft,)
        Identifiers, from top to bottom.
    heading : array (bin,)
        Middle of each bin of magnetic heading, degrees.
    value : array (aircraft, bin)
        Mean of each cell; NaN where there is none.
    number : array (aircraft, bin), optional
        Reports of each cell.
    standard_error : array (aircraft, bin), optional
        Cells beyond two of them carry their value in figures, where there is room.
    quantity : str, optional
        What is shown, with its unit.
    outstanding : sequence of str, optional
        Aircraft set in bold: those a verdict names.
    total : int, optional
        Reports behind the figure, where `number` is not given.
    """
    centres = np.asarray(heading, float)
    figure = new_figure(1.25 + max(0.19 * len(tails), 1.4))
    axes = figure.add_subplot()
    shown = _shown_cells(value, number)
    _aircraft_grid(axes, tails, centres, shown, quantity, outstanding)
    _strong_texts(axes, centres, shown, standard_error)
    first = min(float(_edges(centres)[0]), 0.0)
    compass_axis(axes, label="indicated magnetic heading (degree)")
    axes.set_xlim(first, 360.0 + first)
    named = " Bold: aircraft that a verdict names." if outstanding else ""
    return figure.say(
        f"{_capital(quantity)} by aircraft and magnetic heading ({_counted(number, total)}). A "
        "compass fault shows as a row with a wave or one colour, a model fault as stripes across "
        f"the fleet.{named}"
    )


@styled
def aircraft_time_figure(
    tails: Sequence[str],
    week: ArrayLike,
    value: ArrayLike,
    number: ArrayLike | None = None,
    *,
    quantity: str = "mean heading error (degree)",
    outstanding: Sequence[str] = (),
    total: int = 0,
) -> Figure:
    """Heat map of a mean by aircraft and week.

    Parameters
    ----------
    tails : sequence of str (aircraft,)
    week : array (week,)
        Start of each week as datetime64, or its number from the archive's start.
    value : array (aircraft, week)
        Mean of each cell; NaN where there is none.
    number : array (aircraft, week), optional
        Reports of each cell.
    quantity, outstanding, total
        As for :func:`aircraft_heading_figure`.
    """
    weeks = np.asarray(week)
    figure = new_figure(1.25 + max(0.19 * len(tails), 1.4))
    axes = figure.add_subplot()
    shown = _shown_cells(value, number)
    _aircraft_grid(axes, tails, np.arange(weeks.size, dtype=float), shown, quantity, outstanding)
    step = max(1, -(-weeks.size // 10))
    ticks = np.arange(0, weeks.size, step)
    dated = np.issubdtype(weeks.dtype, np.datetime64)
    labels = [
        np.datetime_as_string(weeks[i], "D") if dated else f"{int(weeks[i]) + 1}" for i in ticks
    ]
    axes.set_xticks(ticks, labels)
    axes.set_xlabel("week from (date)" if dated else "week of the archive (number)")
    return figure.say(
        f"{_capital(quantity)} by aircraft and week ({_counted(number, total)}). A fault that "
        "begins at a date shows as a row that changes colour there."
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _aircraft_grid(
    axes: Axes,
    tails: Sequence[str],
    centres: Floats,
    shown: Floats,
    quantity: str,
    outstanding: Sequence[str],
) -> None:
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
        if label.get_text() in outstanding:
            label.set_fontweight("bold")
            label.set_color(VERMILION)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    figure = axes.get_figure()
    if figure is not None:
        figure.colorbar(drawn, ax=axes, label=quantity, pad=0.01, extend="both")


def _strong_texts(axes: Axes, centres: Floats, shown: Floats, error: ArrayLike | None) -> None:
    """Write the value into the cells that are beyond two standard errors, where there is room."""
    if error is None or centres.size > 12 or shown.shape[0] > 60:
        return
    limit = _even_limit(shown)
    strong = np.abs(shown) > 2 * np.asarray(error, float)
    for row, column in np.argwhere(strong):
        value = shown[row, column]
        colour = "white" if abs(value) > 0.62 * limit else INK
        axes.text(
            centres[column],
            row,
            f"{value:+.1f}",
            ha="center",
            va="center",
            fontsize=7.5,
            color=colour,
        )


@styled
def phase_level_figure(
    phases: Sequence[str],
    layers: Sequence[str],
    components: Mapping[str, Any],
    number: ArrayLike | None = None,
    *,
    total: int = 0,
) -> Figure:
    """Heat maps of the mean residual by phase of flight and level, one for each component.

    Parameters
    ----------
    phases : sequence of str (phase,)
    layers : sequence of str (layer,)
        From the ground up.
    components : mapping of str to array (phase, layer)
        Mean residual, m/s, by component in words.
    number : array (phase, layer), optional
        Reports of each cell.
    total : int, optional
        Reports behind the figure, where `number` is not given.
    """
    shown = {name: _shown_cells(value, number) for name, value in components.items()}
    limit = _even_limit(np.concatenate([v.ravel() for v in shown.values()]), least=0.2)
    figure = new_figure(1.4 + 0.36 * len(layers))
    panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
    drawn = None
    for axes, (name, value) in zip(panels, shown.items(), strict=True):
        drawn = axes.imshow(
            value.T, cmap=DIVERGING, vmin=-limit, vmax=limit, origin="lower", aspect="auto"
        )
        axes.set_title(name)
        axes.set_xticks(range(len(phases)), phases)
        axes.set_yticks(range(len(layers)), layers)
        axes.grid(visible=False)
        _cell_texts(axes, value.T, limit)
    panels[0].set_ylabel("layer (hPa)")
    if drawn is not None:
        figure.colorbar(drawn, ax=list(panels), label="mean residual (m/s)", pad=0.01)
    return figure.say(
        f"Mean residual by phase of flight and layer ({_counted(number, total)}; in each cell the "
        "mean in m/s)."
    )


def _cell_texts(axes: Axes, value: Floats, limit: float) -> None:
    for (y, x), cell in np.ndenumerate(value):
        if np.isfinite(cell):
            strong = abs(cell) > 0.62 * limit
            axes.text(
                x,
                y,
                f"{cell:+.2f}",
                ha="center",
                va="center",
                fontsize=8,
                color="white" if strong else INK,
            )


@styled
def gap_map_figure(
    longitude: ArrayLike,
    latitude: ArrayLike,
    eastward: ArrayLike,
    northward: ArrayLike,
    number: ArrayLike | None = None,
    *,
    total: int = 0,
) -> Figure:
    """Map of the mean residual in cells: speed by colour, direction by arrows.

    Parameters
    ----------
    longitude, latitude : array (x,), (y,)
        Middles of the cells, degrees.
    eastward, northward : array (y, x)
        Mean residual, m/s.
    number : array (y, x), optional
        Reports of each cell.
    total : int, optional
        Reports behind the figure, where `number` is not given.
    """
    lon, lat = np.asarray(longitude, float), np.asarray(latitude, float)
    u, v = _shown_cells(eastward, number), _shown_cells(northward, number)
    filled = np.isfinite(u) & np.isfinite(v)
    if not filled.any():
        return empty_figure("No cell holds enough reports for a map")
    rows, columns = np.nonzero(filled)
    view = view_of(lon[columns], lat[rows], margin=0.1)
    figure = new_figure(min(8.2 * view.height_over_width, 6.5) + 0.7)
    axes = figure.add_subplot()
    speed = np.hypot(u, v)
    x = view.unwrapped(lon)
    order = np.argsort(x)
    drawn = axes.pcolormesh(
        _edges(x[order]),
        _edges(lat),
        speed[:, order],
        cmap="YlOrBr",
        vmin=0,
        vmax=_even_limit(speed),
        alpha=0.85,
        rasterized=True,
    )
    length = _even_limit(speed)
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
    axes.quiverkey(
        arrows,
        0.9,
        1.025,
        round(length, 1),
        f"{length:.1f} m/s",
        labelpos="E",
        fontproperties={"size": 8.5},
    )
    figure.colorbar(
        drawn, ax=axes, label="length of the mean residual (m/s)", shrink=0.85, pad=0.01
    )
    return figure.say(
        f"Mean residual wind (reported minus simulated) by place: colour its length, arrows where "
        f"it blows to ({_counted(number, total)})."
    )
