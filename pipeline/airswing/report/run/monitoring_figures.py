"""What happened to the fleet, on a line of time.

Assumes a look at the fleet, as ``events.json`` keeps it. Dates are days, UTC; bands are 95 %
intervals of a date.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from airswing.report.html.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    SOFT,
    VERMILION,
    empty_figure,
    new_figure,
    plural,
    styled,
)

if TYPE_CHECKING:  # the watch itself is not needed to show it
    from airswing.evaluation.monitoring import Event, Monitoring

# Aircraft that stand below each other on a screen and can still be read.
MOST_ROWS = 24
SHORTEST = 30  # Days the line of time shows at least
FLEET = "all at once"
KINDS = {
    "compass_changed": ("compass changed", VERMILION, "D"),
    "disagreement_rose": ("wind disagreement rose", ORANGE, "^"),
    "aircraft_silent": ("silent", SOFT, "s"),
    "aircraft_new": ("new aircraft", GREEN, "o"),
    "reference_changed": ("reference changed", BLUE, "*"),
}


@styled
def timeline_figure(watched: Monitoring) -> Figure:
    """Draw events by date, a row an aircraft, the latest first.

    Parameters
    ----------
    watched : Monitoring
    """
    events = sorted(watched.events, key=lambda one: (one.noticed, one.date), reverse=True)
    names = list(dict.fromkeys(one.aircraft or FLEET for one in events))
    shown = names[:MOST_ROWS]
    if not shown:
        return empty_figure(f"No event up to {watched.until}")
    figure = new_figure(1.25 + 0.3 * max(len(shown), 2))
    axes = figure.add_subplot()
    drawn = [one for one in events if (one.aircraft or FLEET) in shown]
    silent = {one.aircraft for one in watched.states if one.silent}
    for one in drawn:
        _event(axes, shown.index(one.aircraft or FLEET), one, watched.until, silent)
    _frame(axes, shown, drawn, watched.until)
    for kind, (words, colour, marker) in KINDS.items():
        if any(one.kind == kind for one in drawn):
            axes.plot([], [], marker, color=colour, label=words, markersize=_size(marker))
    figure.legend(loc="outside upper left", ncols=len(KINDS), handletextpad=0.3, columnspacing=1.3)
    rest = f"; {len(names) - len(shown)} more are in the file" if len(names) > len(shown) else ""
    return figure.say(
        f"What happened up to {watched.until}, the latest first: {plural(len(drawn), 'event')} "
        f"in {plural(len(shown), 'row')}{rest}; bands are 95 % intervals of the date, a grey bar "
        "is a silence, the vertical line the last day."
    )


def _event(axes: Axes, row: int, one: Event, until: str, silent: set[str]) -> None:
    _, colour, marker = KINDS[one.kind]
    day, last = _place(one.date), _place(until)
    low, high = (_place(end) for end in one.evidence.get("date_ci", [one.date] * 2))
    if high > low:
        axes.plot([low, high], [row, row], color=colour, alpha=0.3, linewidth=7, zorder=2)
    if one.kind == "aircraft_silent":
        end = last if one.aircraft in silent else day + one.evidence["days"]
        axes.plot([day, end], [row, row], color=FAINT, linewidth=7, zorder=1)
    axes.plot(day, row, marker, color=colour, markersize=_size(marker), zorder=3)


def _frame(axes: Axes, names: Sequence[str], drawn: Sequence[Event], until: str) -> None:
    last = _place(until)
    first = min(_place(min([one.date, *one.evidence.get("date_ci", [])])) for one in drawn)
    axes.axvline(last, color=INK, linewidth=0.8)
    span = max(last - first, SHORTEST)
    axes.set_xlim(last - 1.06 * span, last + 0.02 * span)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_yticks(range(len(names)), names)
    axes.xaxis_date()
    locator = AutoDateLocator(minticks=4, maxticks=9)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def _size(marker: str) -> float:
    return 10.0 if marker == "*" else 6.5


def _place(day: str) -> float:
    """Place of a day on an axis of dates: days since 1970."""
    return float(np.datetime64(day, "D").astype(np.int64))
