"""The page of a run: result first, then the evidence; one self-contained HTML file.

Reports are in the same order in ``headings`` and ``corrected``; both may be lazy, and each figure
reads the variables it needs, aircraft by aircraft. In a large fleet panels are drawn for the
aircraft with the largest deviation; the table, which can be searched and sorted, has all. Every
figure is also written as PNG into ``figures/`` next to the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup

from airswing.evaluation.results import Evaluation
from airswing.flags import published
from airswing.products.ragged import time_span
from airswing.products.whole_files import write_text
from airswing.report.html import maps
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    document,
    folded,
    heading,
    link,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import Figures
from airswing.report.html.style import Units, garbage_collection_rare, plural, shown_per_kt
from airswing.report.run import fleet
from airswing.report.run import heading_error as compass
from airswing.report.run.changes import monitoring_section, stability_section
from airswing.report.run.evaluation import (
    field_test_section,
    ranking_section,
    report_errors_section,
    sensitivity_section,
)
from airswing.report.run.innovations import innovations_section, sounding_figure
from airswing.report.run.reading_warnings import model_reasons, reading_warnings, tally
from airswing.report.run.selection import (
    FORMULA,
    PHASE_WORDS,
    BeforeAfter,
    Total,
    adds_error,
    amplitudes,
    by_amplitude,
    coefficient_texts,
    disagreement,
    drawn_columns,
    fit_words,
    headline,
    headline_reference,
    interval_text,
    kept_reports,
    needs_no_correction,
    number_text,
    offsets_only,
    one_fit,
    screening_audit,
    status_words,
    tails,
)
from airswing.units import NORMAL_95
from airswing.version import __version__

# Aircraft in small panels, in one figure of small panels, in large panels, and in an overview.
SMALL_PANELS, SMALL_TOGETHER, LARGE_PANELS, OVERVIEW = 96, 12, 12, 40
# Report files left out that are named; the product names all.
_FILES_NAMED = 20
# What describes the shape of a deviation, with the decimals that are shown.
_SHAPE = {"offset": 2, "amplitude": 2, "phase": 0}

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


@garbage_collection_rare()
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
    reference = asked if asked in known else headline_reference(fits, headings)
    show = Figures(folder / "figures", units)
    show.clear()
    if apart is None and corrected is not None:
        apart = disagreement(headings, corrected, fits, reference)
    total = None if apart is None else apart.total
    order = by_amplitude(fits, reference)
    sounding = None
    if corrected is not None:
        sounding = sounding_figure(headings, corrected, fits, reference, units=units)
    drawn, period = drawn_columns(headings), _period(headings)
    sections = [
        _corrections_section(fits, reference, order, _links(folder, summary)),
        monitoring_section(found.monitoring, show),
        _curves_section(drawn, fits, reference, order, show),
        _fleet_section(drawn, fits, apart, reference, order, show),
        innovations_section(found.innovations, sounding, reference, order, show),
        ranking_section(found.ranking, found.virtual, show),
        stability_section(found.stability, show, period),
        field_test_section(found.field_test, show),
        sensitivity_section(found.sensitivity, show),
        report_errors_section(found.observation_errors, show),
        _places_section(headings, show),
        _audit_section(headings, show),
        _run_section(summary, headings),
    ]
    warnings = summary.get("warnings")
    text = document(
        title="airswing: compass deviation of the fleet",
        kicker=f"Compass deviation from wind reports  ·  {' to '.join(period or ['no reports'])}",
        headline=headline(fits, total, reference, per_kt=shown_per_kt(units), units=units),
        facts=_facts(headings, fits, total, reference, units),
        warnings=[str(line) for line in warnings] if isinstance(warnings, Iterable) else [],
        sections=sections,
        footer=[
            f"airswing {__version__}. ± and ranges in brackets are 95 % intervals, with flights as "
            "the independent units, unless stated otherwise. Map outline: Natural Earth and US "
            "Census Bureau, public domain."
        ],
    )
    return write_text(folder / "index.html", text)


def _links(folder: Path, summary: Mapping[str, object]) -> list[Markup]:
    found = [
        link(f"../{name}", label)
        for name, label in PRODUCTS.items()
        if (folder.parent / name).exists()
    ]
    more = summary.get("links")
    pairs = more if isinstance(more, Iterable) else ()
    return [*found, *(link(str(address), str(label)) for label, address in pairs)]


def _period(headings: xr.Dataset) -> tuple[str, str] | None:
    """Return the first and the last day of the reports."""
    if not headings.sizes["report"]:
        return None
    first, last = (str(np.datetime_as_string(day, "D")) for day in time_span(headings))
    return first, last


def _facts(
    headings: xr.Dataset, fits: xr.Dataset, total: Total | None, reference: str, units: Units
) -> list[tuple[str, str]]:
    sizes, constants = amplitudes(fits, reference), offsets_only(fits, reference)
    facts = [(f"{sizes.size + constants.size} of {fits.sizes['aircraft']}", "aircraft fitted")]
    if sizes.size:
        facts.append((f"{np.median(sizes):.1f}°", "median amplitude of the deviation"))
    if constants.size:
        words = f"median offset of {constants.size} with a constant only"
        facts.append((f"{np.median(constants):+.1f}°", words))
    if total is not None and total.number:
        factor = shown_per_kt(units)
        levels = f"{factor * total.before:.1f} → {factor * total.after:.1f} {units}"
        gain = interval_text(factor * total.reduction, factor * total.half_width)
        facts.append((levels, f"disagreement with {reference}; reduction {gain} {units}"))
    kept, reports = kept_reports(headings), headings.sizes["report"]
    return [*facts, (f"{kept:,}", f"reports used of {reports:,}")]


def _corrections_section(
    fits: xr.Dataset, reference: str, order: list[str], links: list[Markup]
) -> Section:
    nodes = [f"{node:.0f}°" for node in fits["table_heading"].to_numpy()]
    columns = [
        Column("aircraft", "words"),
        *[Column(node) for node in nodes],
        Column("resi\u00addual"),
        Column("offset"),
        Column("amplitude"),
        Column("phase"),
        Column("reports"),
        Column("status", "words"),
    ]
    rows = _correction_rows(fits, reference, order)
    meaning = (
        "the heading error itself, in degrees to subtract from the indicated heading"
        if adds_error(fits)
        else "in degrees to add to the indicated heading"
    )
    caption = (
        f"Eight-point corrections by indicated magnetic heading ({meaning}), fitted against "
        f"{reference}. Residual: rms error from eight points and rounding, degrees. Offset, "
        "amplitude and phase in degrees with 95 % intervals. Largest amplitude first; click a "
        "column title to sort. Grey italics: not usable "
        f"(n = {plural(len(rows), 'aircraft', 'aircraft')})."
    )
    formula = [paragraph(f"{FORMULA[0].upper()}{FORMULA[1:]}."), *map(paragraph, PHASE_WORDS)]
    parts = [
        table(columns, rows, caption=caption, sortable=True),
        folded("The deviation's formula, and offset, amplitude and phase", formula),
    ]
    if links:
        parts.append(listing(links))
    return Section("corrections", "Corrections", _loadable(fits, reference), parts)


def _loadable(fits: xr.Dataset, reference: str) -> str:
    status = fits["status"].sel(reference=reference).to_numpy()
    if published(status).any():
        return "The table to load into each unit."
    codes, counts = np.unique(status, return_counts=True)
    reasons = [
        f"{status_words(code)} ({plural(int(number), 'aircraft', 'aircraft')})"
        for code, number in zip(codes, counts, strict=True)
    ]
    return f"No table may be loaded: {', '.join(reasons)}."


def _correction_rows(fits: xr.Dataset, reference: str, order: list[str]) -> list[Row]:
    fit = fits.sel(reference=reference, aircraft=order)
    zero, usable = needs_no_correction(fit), published(fit["status"])
    reports, status = fit["report_count"].to_numpy(), fit["status"].to_numpy()
    names = [f"{name}{ending}" for name in _SHAPE for ending in ("", "_standard_error")]
    fit = fit[["table_correction", "table_residual_rms", *names]]
    fit = fit.where(xr.DataArray(usable, dims="aircraft"))  # a refused fit has no numbers
    shape = []
    for name, digits in _SHAPE.items():
        value, error = fit[name].to_numpy(), fit[f"{name}_standard_error"].to_numpy()
        pairs = zip(value.tolist(), (NORMAL_95 * error).tolist(), strict=True)
        shape.append([interval_text(one, half, digits=digits) for one, half in pairs])
    correction = fit["table_correction"].transpose("aircraft", "node").to_numpy()
    residual = fit["table_residual_rms"].to_numpy()
    return [
        Row(
            [
                name,
                *(f"{round(x, 1) + 0.0:+.1f}" if np.isfinite(x) else "-" for x in correction[k]),
                number_text(residual[k]),
                *(texts[k] for texts in shape),
                f"{int(reports[k]):,}",
                "no correction needed" if zero[k] else status_words(status[k]),
            ],
            doubt=not usable[k],
        )
        for k, name in enumerate(order)
    ]


def _curves_section(
    headings: xr.Dataset, fits: xr.Dataset, reference: str, order: list[str], show: Figures
) -> Section:
    parts: list[Markup] = []
    for start in range(0, len(order[:SMALL_PANELS]), SMALL_TOGETHER):
        names = order[start : min(start + SMALL_TOGETHER, SMALL_PANELS)]
        figure = compass.heading_errors_figure(headings, fits, names, reference, units=show.units)
        shown = show(f"heading_errors_{start // SMALL_TOGETHER + 1}", figure, dpi=120)
        title = f"{names[0]} to {names[-1]}, by amplitude ({len(names)} aircraft)"
        parts.append(shown if start == 0 else folded(title, [shown]))
    parts.append(heading("Each aircraft"))
    if len(order) > LARGE_PANELS:
        parts.append(
            paragraph(
                f"The {LARGE_PANELS} aircraft with the largest amplitude; the swing cards show all."
            )
        )
    for index, name in enumerate(order[:LARGE_PANELS]):
        fit = one_fit(fits, name, reference)
        if not np.isfinite(fit["deviation"].to_numpy()).any():
            continue  # the small panel has its reports
        figure = compass.heading_error_figure(headings, fits, name, reference, units=show.units)
        shown = show(f"heading_error_{index + 1:02d}_{name}", figure, dpi=120)
        inner = [shown]
        if published(fit["status"]):
            values = [f"{letter} = {value}" for letter, value in coefficient_texts(fit).items()]
            inner.append(paragraph(f"Coefficients with 95 % intervals: {', '.join(values)}."))
        parts.append(folded(f"{name}: {fit_words(fit)}", inner, unfolded=index == 0))
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
        figure = fleet.before_after_figure(
            apart, tails(headings), names, reference, units=show.units
        )
        parts.append(show("disagreement", figure))
    if len(names) < len(order):
        parts.insert(0, paragraph(f"The {len(names)} aircraft with the largest amplitude."))
    roses = show("headings_flown", compass.coverage_figure(headings, names))
    parts.append(folded("Headings flown", [roses]))
    return Section("fleet", "The fleet", "", parts)


def _places_section(headings: xr.Dataset, show: Figures) -> Section:
    places = maps.places_of(headings)
    by_phase = show("map_by_phase", maps.phase_maps_figure(places), dpi=120)
    by_level = show("map_by_level", maps.level_maps_figure(places), dpi=120)
    parts = [
        show("map", maps.reports_figure(headings, places), dpi=120),
        folded("By phase of flight and by level", [by_phase, by_level]),
    ]
    return Section("places", "Positions of the reports", "", parts)


def _audit_section(headings: xr.Dataset, show: Figures) -> Section:
    total = max(headings.sizes["report"], 1)
    rows = [
        Row(
            [
                rule.name.replace("_", " "),
                f"{rule.together:,}",
                f"{rule.alone:,}",
                f"{100 * rule.together / total:.1f} %",
            ]
        )
        for rule in screening_audit(headings)
    ]
    columns = [Column("rule", "words"), Column("reports marked")]
    columns += [Column("by this rule alone"), Column("share of all")]
    counts = table(columns, rows, caption=f"Screening by rule (n = {total:,} reports).")
    parts = [show("screening", fleet.audit_figure(headings)), folded("Counts", [counts])]
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
    entries |= {
        label: str(headings.attrs[name])
        for name, label in attributes.items()
        if headings.attrs.get(name)
    }
    columns = [Column("item", "words"), Column("value", "long")]
    rows = [Row([name, value]) for name, value in entries.items()]
    return Section("run", "This run", "", [table(columns, rows)] if rows else [])
