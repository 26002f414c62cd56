"""Figures of the fleet: fits of all aircraft, disagreement before and after, what was left out.

Intervals are 95 %: 1.96 standard errors clustered by flight. Fits that are not usable are drawn
hollow and grey.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from airswing.flags import published
from airswing.report.html.style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    SKY,
    SOFT,
    Units,
    blank,
    empty_figure,
    new_figure,
    plural,
    series_style,
    shown_per_kt,
    styled,
    thousands,
)
from airswing.report.run.reading_warnings import tally
from airswing.report.run.selection import BeforeAfter, kept_reports, screening_audit
from airswing.units import NORMAL_95


def rows_axis(axes: Axes, names: Sequence[str]) -> None:
    """Give a panel one named row an item, from top to bottom."""
    axes.set_yticks(range(len(names)), names, fontsize=8.5 if len(names) <= 30 else 7.5)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


@styled
def fleet_figure(fits: xr.Dataset, names: Sequence[str]) -> Figure:
    """Draw amplitude and offset of each aircraft's deviation against every reference."""
    figure = new_figure(1.3 + max(0.24 * len(names), 1.2))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, quantity in ((left, "amplitude"), (right, "offset")):
        _draw_quantity(axes, fits.sel(aircraft=names), quantity)
        rows_axis(axes, names)
        axes.set_title(quantity.capitalize())
        axes.set_xlabel(f"{quantity} of the heading error (degree)")
    right.axvline(0.0, color=INK, linewidth=0.8)
    right.tick_params(labelleft=False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=max(len(labels), 1))
    refused = int((~published(fits["status"].sel(aircraft=names))).any(axis=0).sum())
    hollow = f" Hollow grey: not usable ({refused} aircraft)." if refused else ""
    reports = int(fits["report_count"].sel(aircraft=names).max("reference").sum())
    return figure.say(
        f"Compass deviation of {plural(len(names), 'aircraft', 'aircraft')} against each "
        f"reference, with 95 % intervals (n = {plural(reports, 'report')}).{hollow}"
    )


def _draw_quantity(axes: Axes, fits: xr.Dataset, quantity: str) -> None:
    references = [str(name) for name in fits["reference"].to_numpy()]
    # The intervals of one aircraft are spread over 0.54 of its row.
    shift = np.linspace(-0.27, 0.27, len(references)) if len(references) > 1 else [0.0]
    good = published(fits["status"])
    value = fits[quantity].to_numpy().astype(float)
    half = np.nan_to_num(NORMAL_95 * fits[f"{quantity}_standard_error"].to_numpy().astype(float))
    for index, reference in enumerate(references):
        colour, marker = series_style(index)
        y = np.arange(value.shape[1]) + shift[index]
        looks = ((good[index], colour, colour, reference), (~good[index], "white", SOFT, None))
        for mask, face, edge, label in looks:
            chosen = mask & np.isfinite(value[index])
            axes.errorbar(
                value[index][chosen],
                y[chosen],
                xerr=half[index][chosen],
                fmt=marker,
                color=edge,
                markerfacecolor=face,
                markersize=4.5,
                linewidth=1.1,
                label=label,
            )
    # Limits from the usable fits, so that one wild fit does not compress the others.
    known = value[good & np.isfinite(value)]
    if not known.size:
        axes.text(0.5, 0.5, "none was fitted", transform=axes.transAxes, ha="center", color=SOFT)
        axes.set_xticks([])
        return
    low, high = float(known.min()), float(known.max())
    margin = max(0.12 * (high - low), 0.5)
    axes.set_xlim(0.0 if quantity == "amplitude" else min(low - margin, 0.0), max(high + margin, 0))


@styled
def before_after_figure(
    found: BeforeAfter,
    known: Sequence[str],
    aircraft: Sequence[str],
    reference: str,
    *,
    units: Units = "kt",
) -> Figure:
    """Draw the disagreement of each corrected aircraft before and after, the largest gain first.

    `found` has the numbers of the aircraft `known`, of which `aircraft` are drawn.
    """
    place = {name: row for row, name in enumerate(known)}
    rows = [place[name] for name in aircraft if found.number[place[name]] > 0]
    if not rows:
        return empty_figure("No aircraft was corrected")
    rows.sort(key=lambda row: -found.reduction[row])
    figure = new_figure(1.3 + max(0.22 * len(rows), 1.2))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.5, 1))
    y, factor = np.arange(len(rows)), shown_per_kt(units)
    before, after, reduction, half = (
        factor * part[rows]
        for part in (found.before, found.after, found.reduction, np.nan_to_num(found.half_width))
    )
    left.hlines(y, after, before, color=FAINT, linewidth=2.5)
    left.plot(before, y, "o", color=ORANGE, markersize=6, label="as reported")
    left.plot(after, y, "D", color=BLUE, markersize=5.5, label="corrected")
    left.set_xlabel(f"mean vector disagreement with {reference} ({units})")
    left.set_xlim(left=0)
    right.axvline(0.0, color=INK, linewidth=0.8)
    right.errorbar(reduction, y, xerr=half, fmt="o", color=INK, markersize=4, linewidth=1.1)
    right.set_xlabel(f"reduction ({units}), 95 % interval")
    right.tick_params(labelleft=False)
    for axes in (left, right):
        rows_axis(axes, [known[row] for row in rows])
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    better = int((reduction > half).sum())
    return figure.say(
        f"Mean length of the difference between reported and {reference} wind before and after "
        f"the correction, by aircraft: {better} of {len(rows)} improve by more than their "
        f"interval (n = {plural(int(found.number[rows].sum()), 'report')}, the same before and "
        "after; the fits were made from them)."
    )


@styled
def audit_figure(headings: xr.Dataset) -> Figure:
    """Draw how many reports each rule left out, on reading and on screening."""
    rules, reading = screening_audit(headings), tally(headings, "reading_audit")
    total, kept = headings.sizes["report"], kept_reports(headings)
    dropped, repaired = reading.get("dropped", {}), reading.get("repaired", {})
    reasons = [
        (before + name, number, colour)
        for before, counts, colour in (("", dropped, SOFT), ("repaired: ", repaired, FAINT))
        for name, number in sorted(counts.items(), key=lambda item: -item[1])
        if number
    ]
    figure = new_figure(1.5 + 0.32 * max(len(rules), len(reasons), 1))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1) if reasons else (1, 0.001))
    lines = max(len(rules), len(reasons))
    if rules:
        names = [rule.name for rule in rules]
        _bars(left, names, [rule.together for rule in rules], SKY, total, lines)
        alone = [rule.alone for rule in rules]
        left.barh(range(len(names)), alone, color=BLUE, height=0.7, label="by no other rule")
        left.legend(loc="lower right", title="reports marked")
    else:
        blank(left, "No rule left out a report.")
    left.set_title("Screening before the fit")
    if reasons:
        labels, numbers, colours = zip(*reasons, strict=True)
        _bars(right, labels, numbers, list(colours), 0, lines)
        right.set_title("Dropped or repaired on reading")
    else:
        right.axis("off")
    return figure.say(
        f"What was left out (n = {plural(total, 'report')}): {thousands(kept)} "
        f"({100 * kept / max(total, 1):.1f} %) entered the fits. Several rules can mark the same "
        "report; the dark part of a bar was marked by that rule alone."
    )


def _bars(
    axes: Axes,
    names: Sequence[str],
    numbers: Sequence[int],
    colour: str | list[str],
    total: int,
    lines: int,
) -> None:
    axes.barh(range(len(names)), numbers, color=colour, height=0.7, label="by this rule")
    rows_axis(axes, [name.replace("_", " ") for name in names])
    axes.set_ylim(lines - 0.4, -0.6)
    for row, number in enumerate(numbers):
        share = f" ({100 * number / total:.1f} %)" if total else ""
        axes.text(number, row, f"  {thousands(number)}{share}", va="center", fontsize=8.5)
    # Space for the numbers to the right of the bars.
    axes.set_xlim(0, max([*numbers, 1]) * (1.5 if total else 1.35))
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.set_xlabel("reports")
