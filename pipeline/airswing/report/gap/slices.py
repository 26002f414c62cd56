"""The gap over time and the slices that hold it.

Assumes slices of :mod:`airswing.gap.result.schema` (shares in 0 to 1 of the gap's cross-fitted
energy, q values of false-discovery control) and plain arrays over time with half widths of 95 %
intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from airswing.gap.result.schema import SliceEntry
from airswing.report.gap.words import slice_words, small_text
from airswing.report.html.style import (
    BLUE,
    FAINT,
    SOFT,
    VERMILION,
    blank,
    new_figure,
    plural,
    series_style,
    styled,
    thousands,
)


@styled
def timeline_figure(
    time: ArrayLike,
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


LEAST = 0.005
"""Share of the gap below which a slice stands in the table alone."""


@styled
def slices_figure(where: Sequence[SliceEntry], *, most: int = 15) -> Figure:
    """Bars of the slices of the archive that hold the gap, by share of its energy.

    Parameters
    ----------
    where : sequence of SliceEntry
    most : int, optional
        Slices drawn at most; the rest is in the table.

    Returns
    -------
    CaptionedFigure
    """
    known = sorted(where, key=lambda entry: -entry.share_of_gap)[:most]
    rows = [entry for entry in known if entry.share_of_gap >= LEAST] or known[:3]
    if not rows:
        figure = new_figure(1.2)
        blank(figure.add_subplot(), "No slice holds more of the gap than noise would.")
        return figure.say("No slice holds more of the gap than noise would (n = 0 slices).")
    figure = new_figure(1.0 + 0.3 * len(rows))
    axes = figure.add_subplot()
    share = 100 * np.array([entry.share_of_gap for entry in rows])
    sure = [entry.q_value < 0.05 for entry in rows]
    y = np.arange(len(rows))
    axes.barh(y, share, color=[BLUE if good else FAINT for good in sure], height=0.7)
    for row, entry in enumerate(rows):
        q = f"   q {small_text(entry.q_value)}" if np.isfinite(entry.q_value) else ""
        text = f"  {share[row]:.0f} %{q}"
        axes.text(max(share[row], 0), row, text, va="center", fontsize=8.5)
    axes.set_yticks(y, [slice_words(entry, most=2) for entry in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.axvline(0.0, color=SOFT, linewidth=0.8)
    axes.set_xlim(right=max(float(share.max()) * 1.4, 5.0))
    axes.set_xlabel("share of the gap's energy (%)")
    more = (
        f"; {len(where) - len(rows)} smaller ones are in the table"
        if len(where) > len(rows)
        else ""
    )
    return figure.say(
        f"Slices that hold the gap, by their share of its cross-fitted energy (n = "
        f"{thousands(len(rows))} slices{more}). Blue: beyond noise at a false-discovery rate of "
        "5 %. Slices overlap, so shares need not add to 100 %."
    )
