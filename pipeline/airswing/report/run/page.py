"""The page of a run: result first, then the evidence; one self-contained HTML file.

Reports are in the same order in ``headings`` and ``corrected``; both may be lazy. In a large fleet
panels are drawn for the aircraft with the largest deviation; the table has all. Every figure is
also written as PNG into ``figures/`` next to the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup

from airswing.evaluation.results import Evaluation
from airswing.flags import published
from airswing.products.ragged import time_span
from airswing.products.whole_files import write_text
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
from airswing.report.html.style import drawing
from airswing.report.html.text import Units, interval_text, number_text, plural, shown_per_kt
from airswing.report.run import evaluation as judged
from airswing.report.run import fleet, selection
from airswing.report.run import heading_error as compass
from airswing.report.run.changes import monitoring_section, stability_section
from airswing.report.run.innovations import innovations_section, sounding_figure
from airswing.report.run.selection import BeforeAfter, Total, by_amplitude, one_fit, status_words
from airswing.units import NORMAL_95
from airswing.version import __version__

# Aircraft in small panels, in one figure of small panels, in large panels, and in an overview.
SMALL_PANELS, SMALL_TOGETHER, LARGE_PANELS, OVERVIEW = 96, 12, 12, 40

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


@drawing()
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
        fleet.audit_section(headings, show),
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
    sizes = selection.amplitudes(fits, reference)
    constants = selection.offsets_only(fits, reference)
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


def _fleet_section(
    headings: xr.Dataset,
    fits: xr.Dataset,
    apart: BeforeAfter | None,
    reference: str,
    order: list[str],
    show: Figures,
) -> Section:
    names = order[:OVERVIEW]
    parts = [show("fleet", fleet.fleet_figure(fits, names))]
    if apart is not None:
        known = selection.tails(headings)
        figure = fleet.before_after_figure(apart, known, names, reference, show.units)
        parts.append(show("disagreement", figure))
    if len(names) < len(order):
        parts.insert(0, paragraph(f"The {len(names)} aircraft with the largest amplitude."))
    roses = show("headings_flown", compass.coverage_figure(headings, names))
    parts.append(folded("Headings flown", [roses]))
    return Section("fleet", "The fleet", "", parts)


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
