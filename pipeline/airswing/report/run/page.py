"""The page of a run: result first, then the evidence; one self-contained HTML file.

Reports are in the same order in ``headings`` and ``corrected``; both may be lazy. In a large fleet
panels are drawn for the aircraft with the largest deviation; the table has all. Every figure is
also written as PNG into ``figures/`` next to the page. Fits that are not usable are hollow grey.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from airswing.evaluation.results import Evaluation
from airswing.flags import published
from airswing.products.ragged import time_span
from airswing.products.whole_files import write_text
from airswing.report.html import style
from airswing.report.html.document import (
    Column,
    Figures,
    Section,
    document,
    folded,
    heading,
    link,
    listing,
    paragraph,
    table,
)
from airswing.report.html.maps import places_section
from airswing.report.html.text import Units, interval_text, number_text, plural, shown_per_kt
from airswing.report.run import evaluation as judged
from airswing.report.run import heading_error as compass
from airswing.report.run import selection
from airswing.report.run.changes import monitoring_section, stability_section
from airswing.report.run.innovations import innovations_section, sounding_figure
from airswing.report.run.reading_warnings import model_reasons, reading_warnings, tally
from airswing.report.run.selection import BeforeAfter, Total, by_amplitude, one_fit, status_words
from airswing.units import NORMAL_95
from airswing.version import __version__

# Aircraft in small panels, in one figure of small panels, in large panels, and in an overview.
SMALL_PANELS, SMALL_TOGETHER, LARGE_PANELS, OVERVIEW = 96, 12, 12, 40
# Report files left out that are named; the product names all.
_FILES_NAMED = 20

PRODUCTS = {
    "tables.csv": "8-point tables of the fleet (CSV)",
    "swing_cards.pdf": "swing cards, a page for each aircraft with a fit (PDF)",
    "fits.nc": "fits with covariances (NetCDF)",
    "corrected.nc": "corrected reports (NetCDF)",
    "headings.nc": "headings and heading errors of every report (NetCDF)",
    "corrected": "corrected reports, a file a month (NetCDF)",
    "headings": "headings and heading errors of every report, a file a month (NetCDF)",
    "ranking.csv": "which aircraft to correct first (CSV)",
    "stability.json": "fits by calendar window and changes of the compasses (JSON)",
    "virtual_field_test.json": "predicted and realised reduction on reports not fitted (JSON)",
    "field_test.json": "field test (JSON)",
    "sensitivity.json": "comparison of references (JSON)",
    "error_profiles.nc": "error profiles (NetCDF)",
    "innovation_statistics.nc": "innovation statistics (NetCDF)",
    "observation_errors.nc": "observation errors by phase of flight and layer (NetCDF)",
    "events.json": "state of every aircraft and events (JSON)",
    "report/monitoring.html": "monitoring of the fleet (page)",
    "gap/index.html": "the sim-to-real gap (page)",
    "postprocess/index.html": "post-processed forecasts (page)",
}


@style.drawing()
def write_page(
    directory: Path | str,
    *,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset | None = None,
    summary: Mapping[str, object] | None = None,
    evaluation: Evaluation | None = None,
    apart: BeforeAfter | None = None,
    units: Units = "kt",
) -> Path:
    """Write the page of a run, ``index.html``, and its figures, ``figures/*.png``.

    Parameters
    ----------
    directory : Path or str
        Folder of the page, ``report`` in the output folder of the run. Products found in the
        output folder are linked.
    headings, fits, corrected : Dataset
        Products of docs/formats.md, in memory or lazy.
    summary : mapping, optional
        ``reference``: the fit of the headline; ``links``: more (label, relative address);
        ``warnings``: list of str; other plain values are listed under "This run".
    evaluation : Evaluation, optional
        What is missing leaves its section out.
    apart : BeforeAfter, optional
        Disagreement with the reference of the headline; computed from ``corrected`` by default.
    units : {"kt", "m/s"}, optional
        Unit of all speeds on the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    folder, summary, found = Path(directory), summary or {}, evaluation or Evaluation()
    asked, known = str(summary.get("reference", "")), fits["reference"].to_numpy().astype(str)
    reference = asked if asked in known else selection.headline_reference(fits, headings)
    show = Figures(folder / "figures", units)
    if apart is None and corrected is not None:
        apart = selection.disagreement(headings, corrected, reference)
    total = None if apart is None else apart.total
    order = by_amplitude(fits, reference)
    sounding = None
    if corrected is not None:
        sounding = sounding_figure(headings, corrected, order, reference, units)
    drawn, period = selection.drawn_columns(headings), _period(headings)
    sections = [
        _corrections_section(fits, reference, order, _links(folder, summary)),
        monitoring_section(found.monitoring, show),
        _curves_section(drawn, fits, reference, order, show),
        _fleet_section(drawn, fits, apart, reference, order, show),
        innovations_section(found.innovations, sounding, reference, order, show),
        judged.ranking_section(found.ranking, found.virtual, show),
        stability_section(found.stability, show, period),
        judged.field_test_section(found.field_test, show),
        judged.sensitivity_section(found.sensitivity, show),
        judged.report_errors_section(found.observation_errors, show),
        places_section(headings, show),
        _audit_section(headings, show),
        _run_section(summary, headings),
    ]
    warnings = summary.get("warnings")
    per_kt = shown_per_kt(units)
    text = document(
        title="airswing: compass deviation of the fleet",
        kicker=f"Compass deviation from wind reports  ·  {' to '.join(period or ['no reports'])}",
        headline=selection.headline(fits, total, reference, per_kt=per_kt, units=units),
        facts=_facts(headings, fits, total, reference, units),
        warnings=[str(line) for line in warnings] if isinstance(warnings, Iterable) else [],
        sections=sections,
        footer=f"airswing {__version__}. ± and ranges in brackets are 95 % intervals, with flights "
        "as the independent units, unless stated otherwise. Map outline: Natural Earth and US "
        "Census Bureau, public domain.",
    )
    return write_text(folder / "index.html", text)


def _links(folder: Path, summary: Mapping[str, object]) -> list[Markup]:
    there = (name for name in PRODUCTS if (folder.parent / name).exists())
    more: Any = summary.get("links") or ()
    pairs = [*((PRODUCTS[name], f"../{name}") for name in there), *more]
    return [link(str(address), str(label)) for label, address in pairs]


def _period(headings: xr.Dataset) -> tuple[str, str] | None:
    """Return the first and the last day of the reports."""
    if not headings.sizes["report"]:
        return None
    first, last = (str(np.datetime_as_string(day, "D")) for day in time_span(headings))
    return first, last


def _facts(
    headings: xr.Dataset, fits: xr.Dataset, total: Total | None, reference: str, units: Units
) -> list[tuple[str, str]]:
    sizes, constants = selection.fitted_sizes(fits, reference)
    facts = [(f"{sizes.size + constants.size} of {fits.sizes['aircraft']}", "aircraft fitted")]
    if sizes.size:
        facts.append((f"{np.median(sizes):.1f}°", "median amplitude of the deviation"))
    if constants.size:
        words = f"median offset of {constants.size} with a constant only"
        facts.append((f"{np.median(constants):+.1f}°", words))
    if total is not None and total.number:
        before, after, reduction, half = (shown_per_kt(units) * value for value in total[:4])
        gain = interval_text(reduction, half)
        words = f"disagreement with {reference}; reduction {gain} {units}"
        facts.append((f"{before:.1f} → {after:.1f} {units}", words))
    kept, reports = selection.kept_reports(headings), headings.sizes["report"]
    return [*facts, (f"{kept:,}", f"reports used of {reports:,}")]


def _corrections_section(
    fits: xr.Dataset, reference: str, order: list[str], links: list[Markup]
) -> Section:
    columns, usable = _correction_columns(fits.sel(reference=reference, aircraft=order))
    meaning = (
        "the heading error itself, in degrees to subtract from the indicated heading"
        if selection.adds_error(fits)
        else "in degrees to add to the indicated heading"
    )
    caption = (
        f"Eight-point corrections by indicated magnetic heading ({meaning}), fitted against "
        f"{reference}. Residual: rms error from eight points and rounding, degrees. Offset, "
        "amplitude and phase in degrees with 95 % intervals. Largest amplitude first; click a "
        "column title to sort. Grey italics: not usable "
        f"(n = {plural(len(order), 'aircraft')})."
    )
    formula = map(paragraph, selection.FORMULA)
    parts = [
        table(columns, caption=caption, doubt=~usable, sortable=True),
        folded("The deviation's formula, and offset, amplitude and phase", formula),
    ]
    if links:
        parts.append(listing(links))
    lead = "The table to load into each unit."
    status = fits["status"].sel(reference=reference).to_numpy()
    if not published(status).any():
        reasons = [
            f"{status_words(code)} ({plural(int(number), 'aircraft')})"
            for code, number in zip(*np.unique(status, return_counts=True), strict=True)
        ]
        lead = f"No table may be loaded: {', '.join(reasons)}."
    return Section("corrections", "Corrections", lead, parts)


def _correction_columns(fit: xr.Dataset) -> tuple[list[Column], np.ndarray]:
    """Return the columns of the table, and which fits are usable."""
    zero, usable = selection.needs_no_correction(fit), published(fit["status"])
    status = [
        "no correction needed" if none else status_words(code)
        for none, code in zip(zero, fit["status"].to_numpy(), strict=True)
    ]
    reports = [f"{int(number):,}" for number in fit["report_count"].to_numpy()]
    shape = {"offset": 2, "amplitude": 2, "phase": 0}  # decimals
    names = [f"{name}{ending}" for name in shape for ending in ("", "_standard_error")]
    nodes = [f"{node:.0f}°" for node in fit["table_heading"].to_numpy()]
    fit = fit[["table_correction", "table_residual_rms", *names]]
    fit = fit.where(xr.DataArray(usable, dims="aircraft"))  # a refused fit has no numbers

    def correction(value: float) -> str:
        return f"{round(value, 1) + 0.0:+.1f}" if np.isfinite(value) else "-"

    def with_interval(name: str, digits: int) -> list[str]:
        pairs = zip(fit[name].values, fit[f"{name}_standard_error"].values, strict=True)
        return [interval_text(value, NORMAL_95 * error, digits=digits) for value, error in pairs]

    tables = fit["table_correction"].transpose("node", "aircraft").to_numpy()
    columns = [
        Column("aircraft", selection.tails(fit), "words"),
        *(Column(node, map(correction, x)) for node, x in zip(nodes, tables, strict=True)),
        Column("resi\u00addual", map(number_text, fit["table_residual_rms"].values)),
        *(Column(name, with_interval(name, digits)) for name, digits in shape.items()),
        Column("reports", reports),
        Column("status", status, "words"),
    ]
    return columns, usable


def _curves_section(
    headings: xr.Dataset, fits: xr.Dataset, reference: str, order: list[str], show: Figures
) -> Section:
    parts: list[Markup] = []
    for start in range(0, len(order[:SMALL_PANELS]), SMALL_TOGETHER):
        names = order[start : min(start + SMALL_TOGETHER, SMALL_PANELS)]
        figure = compass.heading_errors_figure(headings, fits, names, reference, show.units)
        shown = show(f"heading_errors_{start // SMALL_TOGETHER + 1}", figure, dpi=120)
        title = f"{names[0]} to {names[-1]}, by amplitude ({len(names)} aircraft)"
        parts.append(shown if start == 0 else folded(title, [shown]))
    parts.append(heading("Each aircraft"))
    if len(order) > LARGE_PANELS:
        few = f"The {LARGE_PANELS} aircraft with the largest amplitude; the swing cards show all."
        parts.append(paragraph(few))
    for index, name in enumerate(order[:LARGE_PANELS]):
        fit = one_fit(fits, name, reference)
        if not np.isfinite(fit["deviation"].to_numpy()).any():
            continue  # the small panel has its reports
        figure = compass.heading_error_figure(headings, fits, name, reference, units=show.units)
        inner = [show(f"heading_error_{index + 1:02d}_{name}", figure, dpi=120)]
        if published(fit["status"]):
            texts = selection.coefficient_texts(fit).items()
            values = ", ".join(f"{letter} = {value}" for letter, value in texts)
            inner.append(paragraph(f"Coefficients with 95 % intervals: {values}."))
        parts.append(folded(f"{name}: {selection.fit_words(fit)}", inner, unfolded=index == 0))
    lead = (
        "Heading error is the indicated heading minus the heading implied by the reference wind; "
        "for a compass without deviation it scatters about zero."
    )
    return Section("curves", "Heading error against heading", lead, parts)


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


def _fleet_section(
    headings: xr.Dataset,
    fits: xr.Dataset,
    apart: BeforeAfter | None,
    reference: str,
    order: list[str],
    show: Figures,
) -> Section:
    names = order[:OVERVIEW]
    parts = [show("fleet", fleet_figure(fits, names))]
    if apart is not None:
        known = selection.tails(headings)
        figure = before_after_figure(apart, known, names, reference, show.units)
        parts.append(show("disagreement", figure))
    if len(names) < len(order):
        parts.insert(0, paragraph(f"The {len(names)} aircraft with the largest amplitude."))
    roses = show("headings_flown", compass.coverage_figure(headings, names))
    parts.append(folded("Headings flown", [roses]))
    return Section("fleet", "The fleet", "", parts)


def audit_figure(headings: xr.Dataset, rules: Sequence[selection.Rule]) -> Figure:
    """Draw how many reports each rule left out, on reading and on screening."""
    reading = tally(headings, "reading_audit")
    total, kept = headings.sizes["report"], selection.kept_reports(headings)
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


def _audit_section(headings: xr.Dataset, show: Figures) -> Section:
    total, rules = headings.sizes["report"], selection.screening_audit(headings)
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


def _run_section(summary: Mapping[str, object], headings: xr.Dataset) -> Section:
    entries = {
        {"watched": "monitoring"}.get(name, str(name).replace("_", " ")): value
        for name, value in summary.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool)
    }
    attributes = {
        "airswing_version": "version",
        "source": "source",
        "history": "history",
        "uuid": "identifier of the headings",
    }
    for name, label in attributes.items():
        if headings.attrs.get(name):
            entries[label] = str(headings.attrs[name])
    columns = [Column("item", entries, "words"), Column("value", entries.values(), "long")]
    return Section("run", "This run", "", [table(columns)] if entries else [])
