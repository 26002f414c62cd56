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
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.report.gap_words import slice_words
from airswing.report.outline import draw_map, view_of
from airswing.report.style import (
    BLUE,
    DIVERGING,
    FAINT,
    INK,
    SOFT,
    VERMILION,
    blank,
    compass_axis,
    new_figure,
    plural,
    series_style,
    styled,
    thousands,
)

Floats = NDArray[np.float64]
FEW = 10
"""Reports below which a cell is left white."""


def shown_cells(value: Any, number: Any, *, few: int = FEW) -> Floats:
    """Return the values with cells of fewer than `few` reports set to NaN."""
    values, count = np.asarray(value, float), np.asarray(number, float)
    return np.where(count >= few, values, np.nan)


def even_limit(values: Floats, *, least: float = 0.5) -> float:
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
    heading: Any,
    residual: Any,
    number: Any,
    *,
    component: str = "across the heading",
    outstanding: Sequence[str] = (),
) -> Figure:
    """Heat map of the mean residual by aircraft and magnetic heading.

    Parameters
    ----------
    tails : sequence of str (aircraft,)
        Identifiers, from top to bottom.
    heading : array (bin,)
        Middle of each bin of magnetic heading, degrees.
    residual, number : array (aircraft, bin)
        Mean residual (m/s) and reports of each cell.
    component : str, optional
        Which component is shown, in words.
    outstanding : sequence of str, optional
        Aircraft set in bold: those a verdict names.

    Returns
    -------
    CaptionedFigure
    """
    centres = np.asarray(heading, float)
    shown = shown_cells(residual, number)
    limit = even_limit(shown)
    figure = new_figure(1.25 + max(0.19 * len(tails), 1.4))
    axes = figure.add_subplot()
    drawn = axes.pcolormesh(
        _edges(centres),
        np.arange(len(tails) + 1) - 0.5,
        shown,
        cmap=DIVERGING,
        vmin=-limit,
        vmax=limit,
        rasterized=True,
    )
    compass_axis(axes, label="indicated magnetic heading (degree)")
    axes.set_yticks(range(len(tails)), tails, fontsize=8 if len(tails) <= 40 else 6.5)
    for label in axes.get_yticklabels():
        if label.get_text() in outstanding:
            label.set_fontweight("bold")
            label.set_color(VERMILION)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    figure.colorbar(
        drawn, ax=axes, label=f"mean residual {component} (m/s)", pad=0.01, extend="both"
    )
    total = int(np.nansum(np.asarray(number, float)))
    named = " Bold: aircraft that a verdict names." if outstanding else ""
    return figure.say(
        f"Mean residual {component} by aircraft and magnetic heading (n = "
        f"{plural(total, 'report')}; white: fewer than {FEW} reports). A compass fault shows as a "
        f"row with a wave or one colour, a model fault as stripes across the fleet.{named}"
    )


@styled
def phase_level_figure(
    phases: Sequence[str], layers: Sequence[str], components: Mapping[str, Any], number: Any
) -> Figure:
    """Heat maps of the mean residual by phase of flight and level, one for each component.

    Parameters
    ----------
    phases : sequence of str (phase,)
    layers : sequence of str (layer,)
        From the ground up.
    components : mapping of str to array (phase, layer)
        Mean residual, m/s, by component in words.
    number : array (phase, layer)
        Reports of each cell.

    Returns
    -------
    CaptionedFigure
    """
    shown = {name: shown_cells(value, number) for name, value in components.items()}
    limit = even_limit(np.concatenate([v.ravel() for v in shown.values()]), least=0.2)
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
        _cell_texts(axes, value.T, np.asarray(number).T, limit)
    panels[0].set_ylabel("layer (hPa)")
    if drawn is not None:
        figure.colorbar(drawn, ax=list(panels), label="mean residual (m/s)", pad=0.01)
    total = int(np.nansum(np.asarray(number, float)))
    return figure.say(
        f"Mean residual by phase of flight and layer (n = {plural(total, 'report')}; in each cell "
        f"the mean in m/s; white: fewer than {FEW} reports)."
    )


def _cell_texts(axes: Axes, value: Floats, number: Any, limit: float) -> None:
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
    longitude: Any, latitude: Any, eastward: Any, northward: Any, number: Any
) -> Figure:
    """Map of the mean residual in cells: speed by colour, direction by arrows.

    Parameters
    ----------
    longitude, latitude : array (x,), (y,)
        Middles of the cells, degrees.
    eastward, northward : array (y, x)
        Mean residual, m/s.
    number : array (y, x)
        Reports of each cell.

    Returns
    -------
    CaptionedFigure
    """
    lon, lat = np.asarray(longitude, float), np.asarray(latitude, float)
    u, v = shown_cells(eastward, number), shown_cells(northward, number)
    filled = np.isfinite(u) & np.isfinite(v)
    if not filled.any():
        figure = new_figure(1.2)
        blank(figure.add_subplot(), "No cell holds enough reports for a map.")
        return figure.say("No cell holds enough reports for a map (n = 0).")
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
        vmax=even_limit(speed),
        alpha=0.85,
        rasterized=True,
    )
    length = even_limit(speed)
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
    total = int(np.nansum(np.asarray(number, float)))
    return figure.say(
        f"Mean residual wind (reported minus simulated) by place: colour its length, arrows where "
        f"it blows to (n = {plural(total, 'report')}; blank: fewer than {FEW} reports)."
    )


@styled
def timeline_figure(
    time: Any,
    series: Mapping[str, tuple[Any, Any]],
    *,
    changes: Mapping[str, Any] | None = None,
    quantity: str = "mean disagreement (kt)",
    number: int = 0,
) -> Figure:
    """Time lines of a quantity with 95 % intervals, and the dates of changes found.

    Parameters
    ----------
    time : array of datetime64 (time,)
        Middle of each day or week.
    series : mapping of str to (value, half width), arrays (time,)
        Lines by name; at most seven are drawn in colours.
    changes : mapping of str to datetime64 or (datetime64, datetime64), optional
        Date, or interval of dates, of each change by name.
    quantity : str, optional
        The y axis in words, with its unit.
    number : int, optional
        Reports behind the lines.

    Returns
    -------
    CaptionedFigure
    """
    times = np.asarray(time, "datetime64[s]").astype("datetime64[ms]").astype(object)
    figure = new_figure(3.3)
    axes = figure.add_subplot()
    for index, (name, (value, half)) in enumerate(series.items()):
        colour, marker = series_style(index)
        line, width = np.asarray(value, float), np.nan_to_num(np.asarray(half, float))
        axes.fill_between(times, line - width, line + width, color=colour, alpha=0.18, linewidth=0)
        axes.plot(times, line, color=colour, marker=marker, markersize=3.5, label=name)
    for name, when in (changes or {}).items():
        span = np.atleast_1d(np.asarray(when, "datetime64[s]")).astype("datetime64[ms]")
        dates = span.astype(object)
        if dates.size == 2:
            axes.axvspan(dates[0], dates[1], color=VERMILION, alpha=0.2, linewidth=0)
        middle = dates[0] + (dates[-1] - dates[0]) / 2
        axes.axvline(middle, color=VERMILION, linewidth=1.2, linestyle=(0, (4, 2)))
        axes.annotate(
            name,
            (middle, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, -2),
            textcoords="offset points",
            va="top",
            fontsize=8.5,
            color=VERMILION,
        )
    locator = AutoDateLocator(minticks=4, maxticks=9)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_ylabel(quantity)
    if len(series) > 1:
        figure.legend(loc="outside upper left", ncols=min(len(series), 7))
    spans = any(np.size(when) == 2 for when in (changes or {}).values())
    dated = " Dashed: changes found" if changes else ""
    dated += (", shaded their 95 % interval." if spans else ".") if changes else ""
    counted = f" (n = {plural(number, 'report')})" if number else ""
    return figure.say(
        f"{quantity[0].upper()}{quantity[1:]} over time with 95 % intervals{counted}.{dated}"
    )


@styled
def slices_figure(where: Sequence[Mapping[str, Any]], *, most: int = 15) -> Figure:
    """Bars of the slices of the archive that hold the gap, by share of its energy.

    Parameters
    ----------
    where : sequence of mappings
        ``where`` of ``gap.json``: ``variable``, ``values``, ``share_of_gap``, ``q_value``, and
        ``share_ci`` where given.
    most : int, optional
        Slices drawn at most; the rest is in the table.

    Returns
    -------
    CaptionedFigure
    """
    rows = sorted(where, key=lambda entry: -float(entry["share_of_gap"]))[:most]
    if not rows:
        figure = new_figure(1.2)
        blank(figure.add_subplot(), "No slice holds more of the gap than noise would.")
        return figure.say("No slice holds more of the gap than noise would (n = 0 slices).")
    figure = new_figure(1.0 + 0.3 * len(rows))
    axes = figure.add_subplot()
    share = 100 * np.array([float(entry["share_of_gap"]) for entry in rows])
    sure = [float(entry.get("q_value", 0.0)) < 0.05 for entry in rows]
    y = np.arange(len(rows))
    axes.barh(y, share, color=[BLUE if good else FAINT for good in sure], height=0.7)
    for row, entry in enumerate(rows):
        if entry.get("share_ci"):
            axes.plot(
                100 * np.asarray(entry["share_ci"], float), [row, row], color=INK, linewidth=1
            )
        q = float(entry.get("q_value", np.nan))
        text = f"  {share[row]:.0f} %" + (f"   q = {q:.2g}" if np.isfinite(q) else "")
        end = max(share[row], 100 * max(entry.get("share_ci", [0])))
        axes.text(max(end, 0), row, text, va="center", fontsize=8.5)
    axes.set_yticks(y, [slice_words(entry) for entry in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.axvline(0.0, color=SOFT, linewidth=0.8)
    axes.set_xlim(right=max(float(share.max()) * 1.4, 5.0))
    axes.set_xlabel("share of the gap's energy (%)")
    more = f"; {len(where) - len(rows)} smaller ones are in the table" if len(where) > most else ""
    return figure.say(
        f"Slices that hold the gap, by their share of its cross-fitted energy (n = "
        f"{thousands(len(rows))} slices{more}). Blue: beyond noise at a false-discovery rate of "
        "5 %. Slices overlap, so shares need not add to 100 %."
    )
