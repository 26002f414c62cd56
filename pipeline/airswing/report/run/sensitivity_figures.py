"""How far the fits depend on the reference, as pictures.

Assumes ``sensitivity.json`` as :func:`airswing.evaluation.reference_comparison.sensitivity.compare`
returns it: differences of coefficients in degrees (first reference minus second) with standard
errors clustered by day.  Bars are 1.96 standard errors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.evaluation.results import Content
from airswing.report.html.style import (
    BLUE,
    INK,
    SOFT,
    VERMILION,
    empty_figure,
    new_figure,
    plural,
    styled,
)
from airswing.units import NORMAL_95

COEFFICIENTS = ("A", "B", "C", "D", "E")
# Rows of the figure, the largest differences first; every aircraft stands in the table.
MOST_AIRCRAFT = 40


def pair_name(pair: Content) -> str:
    """Return ``ruc - rtfdaa`` for a pair, the order in which differences are taken."""
    return " - ".join(str(name) for name in pair["references"])


def verdict_word(pair: Content) -> str:
    """Return whether a pair may be pooled, in a word or two."""
    if pair.get("poolable") is None:
        return "cannot tell"
    return "poolable" if pair["poolable"] else "not poolable"


def _verdict_colour(pair: Content) -> str:
    if pair.get("poolable") is None:
        return SOFT
    return BLUE if pair["poolable"] else VERMILION


@styled
def pair_differences_figure(pairs: Sequence[Content]) -> Figure:
    """Draw the fleet's common difference of each coefficient for every pair of references.

    Parameters
    ----------
    pairs : sequence of mappings
        ``pairs`` of ``sensitivity.json`` (or a slice of it): ``references``, ``fleet`` with
        ``difference`` and ``standard_error`` (degree), ``poolable``.
    """
    shown = [pair for pair in pairs if pair["fleet"].get("difference")]
    if not shown:
        return empty_figure("No pair has enough reports to compare")
    figure = new_figure(1.3 + 0.4 * len(shown))
    panels = figure.subplots(1, len(COEFFICIENTS), sharey=True, sharex=True)
    for axes, name in zip(panels, COEFFICIENTS, strict=True):
        for row, pair in enumerate(shown):
            value = float(pair["fleet"]["difference"][name])
            half = NORMAL_95 * float(pair["fleet"]["standard_error"][name])
            colour = _verdict_colour(pair)
            axes.errorbar(value, row, xerr=half, fmt="o", color=colour, markersize=5, linewidth=1.4)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.set_title(name)
        axes.set_xlabel("degree")
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
    names = [f"{_slice(pair)}{pair_name(pair)}\n{verdict_word(pair)}" for pair in shown]
    panels[0].set_yticks(range(len(shown)), names, fontsize=8.5)
    for label, pair in zip(panels[0].get_yticklabels(), shown, strict=True):
        label.set_color(_verdict_colour(pair))
    panels[0].set_ylim(len(shown) - 0.5, -0.5)
    reports = max(int(pair.get("reports", 0)) for pair in shown)
    aircraft = max(int(pair["fleet"].get("aircraft", 0)) for pair in shown)
    return figure.say(
        "Common difference of the fleet's deviation coefficients between references fitted on the "
        f"same reports, 95 % intervals (n = {plural(reports, 'report')}, "
        f"{plural(aircraft, 'aircraft', 'aircraft')}). Blue: poolable, orange: not."
    )


def _slice(pair: Content) -> str:
    return f"{pair['slice']}: " if pair.get("slice") else ""


@styled
def aircraft_differences_figure(pair: Content) -> Figure:
    """Draw the difference of offset and amplitude of each aircraft for one pair of references.

    Parameters
    ----------
    pair : mapping
        One of ``pairs`` of ``sensitivity.json``: ``aircraft`` with ``offset`` and
        ``amplitude``, each a ``difference`` and its ``ci`` (degree).
    """
    known = [entry for entry in pair.get("aircraft", []) if entry.get("amplitude")]
    rows = sorted(known, key=lambda entry: -abs(_number(entry["amplitude"]["difference"])))
    rows = rows[:MOST_AIRCRAFT]
    if not rows:
        return empty_figure("No aircraft has enough reports against both")
    figure = new_figure(1.2 + max(0.2 * len(rows), 0.8))
    panels = figure.subplots(1, 2, sharey=True)
    _differences(panels[0], "Amplitude", [entry["amplitude"] for entry in rows])
    _differences(panels[1], "Offset", [entry["offset"] for entry in rows])
    panels[0].set_yticks(range(len(rows)), [str(e["aircraft"]) for e in rows], fontsize=8)
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    more = f" of {len(known)}, those that differ most" if len(known) > len(rows) else ""
    return figure.say(
        f"{pair_name(pair)}: difference of each aircraft's amplitude and offset, 95 % intervals "
        f"that honour the shared reports (n = {plural(len(rows), 'aircraft', 'aircraft')}{more}). "
        "Orange: the interval leaves out zero."
    )


def _number(value: float | None) -> float:
    """A number that JSON may have made null."""
    return float("nan") if value is None else float(value)


def _differences(axes: Axes, title: str, rows: Sequence[Content]) -> None:
    value = np.array([_number(entry["difference"]) for entry in rows])
    low, high = np.array([[_number(end) for end in entry["ci"]] for entry in rows]).T
    colours = [
        SOFT if one <= 0 <= other else VERMILION for one, other in zip(low, high, strict=True)
    ]
    places = np.arange(len(rows))
    axes.hlines(places, low, high, colors=colours, linewidth=1.3)
    axes.scatter(value, places, s=16, c=colours, zorder=2)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_title(title)
    axes.set_xlabel("difference (degree)")
    axes.tick_params(axis="y", length=0)
    ends = np.concatenate([low, high])
    if np.isfinite(ends).any():
        reach = 1.1 * float(np.nanpercentile(np.abs(ends), 97)) or 1.0
        axes.set_xlim(-reach, reach)
