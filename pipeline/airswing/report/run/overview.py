"""The fleet on one page: fits side by side, disagreement before and after, what was left out.

Assumes the products of docs/formats.md.  Intervals are 95 %: 1.96 clustered standard
errors.  Fits that are not to be trusted are drawn hollow and grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
    blank,
    empty_figure,
    new_figure,
    plural,
    series_style,
    styled,
    thousands,
)
from airswing.report.run.page_numbers import (
    BeforeAfter,
    disagreement,
    kept_reports,
    screening_audit,
)
from airswing.report.run.reading_warnings import tally
from airswing.report.run.selection import headline_reference, tails
from airswing.units import NORMAL_95

PAGE_OF_AIRCRAFT = 40  # Aircraft in one overview figure; larger fleets get several


def by_amplitude(fits: xr.Dataset, reference: str) -> list[str]:
    """Return aircraft with the largest amplitude first, untrusted fits last."""
    fit = fits.sel(reference=reference)
    trusted = published(fit["status"])
    amplitude = np.nan_to_num(fit["amplitude"].to_numpy().astype(float), nan=-1.0)
    order = np.lexsort((-amplitude, ~trusted))
    names = tails(fits)
    return [names[i] for i in order]


def _rows_axis(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), names, fontsize=8.5 if len(names) <= 30 else 7.5)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _draw_quantity(axes: Axes, fits: xr.Dataset, names: Sequence[str], quantity: str) -> None:
    known = tails(fits)
    place = {name: row for row, name in enumerate(known)}
    rows = [place[name] for name in names]
    references = [str(name) for name in fits["reference"].to_numpy()]
    # In a row one high: an aircraft's intervals stand under each other, apart from the next's.
    shift = np.linspace(-0.27, 0.27, len(references)) if len(references) > 1 else [0.0]
    for index, reference in enumerate(references):
        fit = fits.isel(reference=index, aircraft=rows)
        value = fit[quantity].to_numpy().astype(float)
        half = NORMAL_95 * fit[f"{quantity}_standard_error"].to_numpy().astype(float)
        good = published(fit["status"])
        colour, marker = series_style(index)
        y = np.arange(len(rows)) + shift[index]
        for mask, face, edge in ((good, colour, colour), (~good, "white", SOFT)):
            mask = mask & np.isfinite(value)
            axes.errorbar(
                value[mask],
                y[mask],
                xerr=np.nan_to_num(half[mask]),
                fmt=marker,
                color=edge,
                markerfacecolor=face,
                markersize=4.5,
                linewidth=1.1,
                label=reference if face == colour else None,
            )


def _sane_limits(axes: Axes, fits: xr.Dataset, quantity: str) -> None:
    """Keep one wild fit from squeezing the rest: limits from the trusted fits."""
    good = published(fits["status"])
    value = fits[quantity].to_numpy().astype(float)[good]
    value = value[np.isfinite(value)]
    if value.size == 0:
        axes.text(0.5, 0.5, "none was fitted", transform=axes.transAxes, ha="center", color=SOFT)
        axes.set_xticks([])
        return
    low, high = float(value.min()), float(value.max())
    room = max(0.12 * (high - low), 0.5)
    low = 0.0 if quantity == "amplitude" else min(low - room, 0.0)
    axes.set_xlim(low, max(high + room, 0.0))


@styled
def fleet_figure(fits: xr.Dataset, aircraft: Sequence[str] | None = None) -> Figure:
    """Amplitude and offset of each aircraft's deviation, the references side by side.

    Parameters
    ----------
    fits : Dataset
        FITS: ``amplitude``, ``offset`` and their standard errors, ``status``.
    aircraft : list of str, optional
        Identifiers from top to bottom; all, as they stand, by default.
    """
    names = list(aircraft or tails(fits))
    figure = new_figure(1.3 + max(0.24 * len(names), 1.2))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, quantity, title in ((left, "amplitude", "Amplitude"), (right, "offset", "Offset")):
        _draw_quantity(axes, fits, names, quantity)
        _rows_axis(axes, names)
        _sane_limits(axes, fits, quantity)
        axes.set_title(title)
        axes.set_xlabel(f"{quantity} of the heading error (degree)")
    right.axvline(0.0, color=INK, linewidth=0.8)
    right.tick_params(labelleft=False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    refused = int((~published(fits["status"].sel(aircraft=names))).any(axis=0).sum())
    hollow = f" Hollow grey: not to be trusted ({refused} aircraft)." if refused else ""
    return figure.say(
        f"Compass deviation of {plural(len(names), 'aircraft', 'aircraft')} (n = "
        f"{plural(int(fits['report_count'].sel(aircraft=names).max('reference').sum()), 'report')})"
        f", with 95 % intervals, against each reference.{hollow}"
    )


def disagreement_figure(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    fits: xr.Dataset,
    reference: str | None = None,
    aircraft: Sequence[str] | None = None,
) -> Figure:
    """Wind disagreement of each aircraft before and after the correction.

    Parameters
    ----------
    headings, corrected, fits : Dataset
        Products of docs/formats.md.
    reference : str, optional
        Reference or pool; by default the first pool, else the first reference.
    aircraft : list of str, optional
        Identifiers; all by default.  Aircraft that were not corrected are left out.
    """
    reference = reference or headline_reference(fits, headings)
    found = disagreement(headings, corrected, fits, reference)
    return before_after_figure(found, tails(headings), aircraft or tails(headings), reference)


@styled
def before_after_figure(
    found: BeforeAfter, known: Sequence[str], aircraft: Sequence[str], reference: str
) -> Figure:
    """As :func:`disagreement_figure`, of what is known of all aircraft, some of them drawn."""
    place = {name: row for row, name in enumerate(known)}
    rows = [place[name] for name in aircraft]
    rows = [row for row in rows if found.number[row] > 0]
    if not rows:
        return empty_figure("No aircraft was corrected")
    rows.sort(key=lambda row: -found.reduction[row])
    figure = new_figure(1.3 + max(0.22 * len(rows), 1.2))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.5, 1))
    y = np.arange(len(rows))
    before, after = found.before[rows], found.after[rows]
    left.hlines(y, after, before, color=FAINT, linewidth=2.5)
    left.plot(before, y, "o", color=ORANGE, markersize=6, label="as reported")
    left.plot(after, y, "D", color=BLUE, markersize=5.5, label="corrected")
    left.set_xlabel(f"mean vector disagreement with {reference} (kt)")
    left.set_xlim(left=0)
    right.axvline(0.0, color=INK, linewidth=0.8)
    right.errorbar(
        found.reduction[rows],
        y,
        xerr=np.nan_to_num(found.half_width[rows]),
        fmt="o",
        color=INK,
        markersize=4,
        linewidth=1.1,
    )
    right.set_xlabel("reduction (kt), 95 % interval")
    right.tick_params(labelleft=False)
    for axes in (left, right):
        _rows_axis(axes, [known[row] for row in rows])
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    better = int((found.reduction[rows] > np.nan_to_num(found.half_width[rows])).sum())
    return figure.say(
        f"Mean length of the difference between reported and {reference} wind before and after "
        f"the correction, by aircraft: {better} of {len(rows)} improve by more than their "
        f"interval (n = {plural(int(found.number[rows].sum()), 'report')}, the same before and "
        "after; the fits were learned from them)."
    )


def _bars(
    axes: Axes,
    names: Sequence[str],
    numbers: Sequence[int],
    colour: str | list[str],
    total: int,
    room: int,
) -> None:
    y = np.arange(len(names))
    axes.barh(y, numbers, color=colour, height=0.7, label="by this rule")
    axes.set_yticks(y, [name.replace("_", " ") for name in names])
    axes.set_ylim(max(len(names), room) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    for row, number in enumerate(numbers):
        share = f" ({100 * number / total:.1f} %)" if total else ""
        axes.text(number, row, f"  {thousands(number)}{share}", va="center", fontsize=8.5)
    # Room for the numbers that stand behind the bars.
    axes.set_xlim(0, max([*numbers, 1]) * (1.5 if total else 1.35))
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.set_xlabel("reports")


def reading_reasons(ds: xr.Dataset) -> tuple[dict[str, int], dict[str, int]]:
    """Count by reason the reports dropped and repaired on reading.

    Parameters
    ----------
    ds : Dataset
        With the attribute ``reading_audit`` (JSON or mapping) where reading left one.

    Returns
    -------
    dropped, repaired : dict of str to int
        Largest first; empty without the attribute.
    """
    audit = tally(ds, "reading_audit")
    return _ordered(audit.get("dropped", {})), _ordered(audit.get("repaired", {}))


def _ordered(counts: Mapping[str, int]) -> dict[str, int]:
    """Keep what was counted at least once, the largest first."""
    kept = {str(name): int(number) for name, number in counts.items() if int(number) > 0}
    return dict(sorted(kept.items(), key=lambda item: -item[1]))


@styled
def audit_figure(headings: xr.Dataset) -> Figure:
    """Show what was left out and by which rule, on reading and on screening.

    Parameters
    ----------
    headings : Dataset
        With ``screening`` (report); the attribute ``reading_audit`` (JSON) where present.
    """
    rules, (dropped, repaired) = screening_audit(headings), reading_reasons(headings)
    total = headings.sizes["report"]
    kept = kept_reports(headings)
    reasons = [(name, number, SOFT) for name, number in dropped.items()]
    reasons += [(f"repaired: {name}", number, FAINT) for name, number in repaired.items()]
    figure = new_figure(1.5 + 0.32 * max(len(rules), len(reasons), 1))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1) if reasons else (1, 0.001))
    if rules:
        names = [rule.name for rule in rules]
        whole = [rule.together for rule in rules]
        alone = [rule.alone for rule in rules]
        _bars(left, names, whole, SKY, total, len(reasons))
        left.barh(range(len(names)), alone, color=BLUE, height=0.7, label="by no other rule")
        left.legend(loc="lower right", title="reports marked")
    else:
        blank(left, "No rule left out a report.")
    left.set_title("Screening before the fit")
    if reasons:
        labels, numbers, colours = zip(*reasons, strict=True)
        _bars(right, labels, numbers, list(colours), 0, len(rules))
        right.set_title("Dropped or repaired on reading")
    else:
        right.axis("off")
    return figure.say(
        f"What was left out (n = {plural(total, 'report')}): {thousands(kept)} "
        f"({100 * kept / max(total, 1):.1f} %) entered the fits. A report can be marked by several "
        "rules; the dark part of a bar is what only that rule removed."
    )
