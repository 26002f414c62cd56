"""The fleet and what was left out: figures and sections of the page.

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
from airswing.report.html import style
from airswing.report.html.document import Column, Figures, Section, folded, listing, table
from airswing.report.html.text import Units, plural, shown_per_kt
from airswing.report.run.reading_warnings import model_reasons, reading_warnings, tally
from airswing.report.run.selection import BeforeAfter, Rule, kept_reports, screening_audit
from airswing.units import NORMAL_95

# Report files left out that are named; the product names all.
_FILES_NAMED = 20


def fleet_figure(fits: xr.Dataset, names: Sequence[str]) -> Figure:
    """Draw amplitude and offset of each aircraft's deviation against every reference."""
    fits = fits.sel(aircraft=names)
    figure = style.new_figure(1.3 + max(0.24 * len(names), 1.2))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, quantity in ((left, "amplitude"), (right, "offset")):
        _draw_quantity(axes, fits, quantity)
        style.rows_axis(axes, names, f"{quantity} of the heading error (degree)")
        axes.set_title(quantity.capitalize())
    style.zero_line(right)
    right.tick_params(labelleft=False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=max(len(labels), 1))
    refused = int((~published(fits["status"])).any(axis=0).sum())
    hollow = f" Hollow grey: not usable ({refused} aircraft)." if refused else ""
    reports = int(fits["report_count"].max("reference").sum())
    return figure.say(
        f"Compass deviation of {plural(len(names), 'aircraft')} against each reference, with 95 % "
        f"intervals (n = {plural(reports, 'report')}).{hollow}"
    )


def _draw_quantity(axes: Axes, fits: xr.Dataset, quantity: str) -> None:
    references = [str(name) for name in fits["reference"].to_numpy()]
    # The intervals of one aircraft are spread over 0.54 of its row.
    shift = np.linspace(-0.27, 0.27, len(references)) if len(references) > 1 else [0.0]
    good = published(fits["status"])
    value = fits[quantity].to_numpy().astype(float)
    half = np.nan_to_num(NORMAL_95 * fits[f"{quantity}_standard_error"].to_numpy().astype(float))
    for index, reference in enumerate(references):
        colour, marker = style.series_style(index)
        y = np.arange(value.shape[1]) + shift[index]
        looks = ((True, colour, colour, reference), (False, "white", style.SOFT, None))
        for usable, face, edge, label in looks:
            chosen = (good[index] == usable) & np.isfinite(value[index])
            x, reach = value[index][chosen], half[index][chosen]
            look = {"marker": marker, "markersize": 4.5, "markerfacecolor": face, "label": label}
            style.intervals(axes, x, (x - reach, x + reach), y[chosen], color=edge, **look)
    # Limits from the usable fits, so that one wild fit does not compress the others.
    known = value[good & np.isfinite(value)]
    if not known.size:
        message = "none was fitted"
        axes.text(0.5, 0.5, message, transform=axes.transAxes, ha="center", color=style.SOFT)
        axes.set_xticks([])
        return
    low, high = float(known.min()), float(known.max())
    margin = max(0.12 * (high - low), 0.5)
    axes.set_xlim(0.0 if quantity == "amplitude" else min(low - margin, 0.0), max(high + margin, 0))


def before_after_figure(
    found: BeforeAfter,
    known: Sequence[str],
    aircraft: Sequence[str],
    reference: str,
    units: Units,
) -> Figure:
    """Draw the disagreement of each corrected aircraft before and after, the largest gain first.

    `found` has the numbers of the aircraft `known`, of which `aircraft` are drawn.
    """
    rows = [known.index(name) for name in aircraft if found.number[known.index(name)] > 0]
    if not rows:
        return style.empty_figure("No aircraft was corrected")
    rows.sort(key=lambda row: -found.reduction[row])
    figure = style.new_figure(1.3 + max(0.22 * len(rows), 1.2))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.5, 1))
    y, factor = np.arange(len(rows)), shown_per_kt(units)
    before, after, reduction, half = (
        factor * part[rows]
        for part in (found.before, found.after, found.reduction, np.nan_to_num(found.half_width))
    )
    left.hlines(y, after, before, color=style.FAINT, linewidth=2.5)
    left.plot(before, y, "o", color=style.ORANGE, markersize=6, label="as reported")
    left.plot(after, y, "D", color=style.BLUE, markersize=5.5, label="corrected")
    left.set_xlim(left=0)
    style.zero_line(right)
    style.intervals(right, reduction, (reduction - half, reduction + half), y, color=style.INK)
    names = [known[row] for row in rows]
    style.rows_axis(left, names, f"mean vector disagreement with {reference} ({units})")
    style.rows_axis(right, names, f"reduction ({units}), 95 % interval")
    right.tick_params(labelleft=False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    better = int((reduction > half).sum())
    return figure.say(
        f"Mean length of the difference between reported and {reference} wind before and after "
        f"the correction, by aircraft: {better} of {len(rows)} improve by more than their "
        f"interval (n = {plural(int(found.number[rows].sum()), 'report')}, the same before and "
        "after; the fits were made from them)."
    )


def audit_figure(headings: xr.Dataset, rules: Sequence[Rule]) -> Figure:
    """Draw how many reports each rule left out, on reading and on screening."""
    reading = tally(headings, "reading_audit")
    total, kept = headings.sizes["report"], kept_reports(headings)
    dropped, repaired = reading.get("dropped", {}), reading.get("repaired", {})
    reasons = [
        (before + name, number, colour)
        for before, counts, colour in (
            ("", dropped, style.SOFT),
            ("repaired: ", repaired, style.FAINT),
        )
        for name, number in sorted(counts.items(), key=lambda item: -item[1])
        if number
    ]
    lines = max(len(rules), len(reasons))
    figure = style.new_figure(1.5 + 0.32 * max(lines, 1))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1) if reasons else (1, 0.001))
    if rules:
        names, together, alone = zip(*rules, strict=True)
        _bars(left, names, together, style.SKY, total, lines)
        look = {"color": style.BLUE, "height": 0.7, "label": "by no other rule"}
        left.barh(range(len(names)), alone, **look)
        left.legend(loc="lower right", title="reports marked")
    else:
        style.blank(left, "No rule left out a report.")
    left.set_title("Screening before the fit")
    if reasons:
        names, numbers, colours = zip(*reasons, strict=True)
        _bars(right, names, numbers, list(colours), 0, lines)
        right.set_title("Dropped or repaired on reading")
    else:
        right.axis("off")
    return figure.say(
        f"What was left out (n = {plural(total, 'report')}): {kept:,} "
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
    style.rows_axis(axes, [name.replace("_", " ") for name in names], "reports")
    axes.set_ylim(lines - 0.4, -0.6)
    for row, number in enumerate(numbers):
        share = f" ({100 * number / total:.1f} %)" if total else ""
        axes.text(number, row, f"  {number:,}{share}", va="center", fontsize=8.5)
    # Space for the numbers to the right of the bars.
    axes.set_xlim(0, max([*numbers, 1]) * (1.5 if total else 1.35))
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def audit_section(headings: xr.Dataset, show: Figures) -> Section:
    """Return the section on reports, files and messages that were left out."""
    total, rules = headings.sizes["report"], screening_audit(headings)
    columns = [
        Column("rule", [rule.name.replace("_", " ") for rule in rules], "words"),
        Column("reports marked", [f"{rule.together:,}" for rule in rules]),
        Column("by this rule alone", [f"{rule.alone:,}" for rule in rules]),
        Column("share of all", [f"{100 * rule.together / total:.1f} %" for rule in rules]),
    ]
    counts = table(columns, caption=f"Screening by rule (n = {total:,} reports).")
    parts = [show("screening", audit_figure(headings, rules)), folded("Counts", [counts])]
    reading = tally(headings, "reading_audit")
    others = [entry["reason"] for entry in reading.get("files_skipped", [])][1:_FILES_NAMED]
    lines = [*reading_warnings(reading), *(f"also left out: {reason}" for reason in others)]
    for name, entry in tally(headings, "reference_audit").items():
        reasons = model_reasons([*entry.get("skipped", []), *entry.get("unread", [])])
        lines += [f"{name}: {line}" for line in [*reasons, *entry.get("notes", [])]]
    if lines:
        parts.append(folded("Files and messages", [listing(lines)], unfolded=True))
    return Section("audit", "What was left out", "", parts)
