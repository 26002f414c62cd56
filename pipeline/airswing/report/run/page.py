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
from matplotlib.figure import Figure

from airswing.compass.correction import main_reference
from airswing.evaluation import Evaluation
from airswing.flags import published
from airswing.products.ragged import time_span
from airswing.report import html
from airswing.report.html import FAINT, SOFT, Look, interval_text, plural
from airswing.report.html.maps import places_section
from airswing.report.run import evaluation as judged
from airswing.report.run import selection
from airswing.report.run.changes import monitoring_section, stability_section
from airswing.report.run.heading_error import heading_errors_figure
from airswing.report.run.innovations import innovations_section
from airswing.report.run.reading_warnings import model_reasons, reading_warnings, tally
from airswing.report.run.selection import BeforeAfter, Run, names_of, status_words
from airswing.units import NORMAL_95

# Aircraft in panels, in one figure of panels, and in an overview.
PANELS, TOGETHER, OVERVIEW = 96, 12, 40
# Most skipped report files that are named; the product names all.
_FILES_NAMED = 20

# Words on entries of the summary and attributes of the headings that are listed.
_ENTRIES = {
    "watched": "monitoring",
    "airswing_version": "version",
    "source": "source",
    "history": "history",
    "uuid": "identifier of the headings",
}
PRODUCTS = {
    "tables.csv": "8-point tables of the fleet (CSV)",
    "swing_cards.pdf": "swing cards, a page for each aircraft with a fit (PDF)",
    "fits.nc": "fits with covariances (NetCDF)",
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
    "gap/index.html": "gap between real and simulated reports (page)",
    "postprocess/index.html": "post-processed forecasts (page)",
}


@html.drawing()
def write_page(
    directory: Path | str,
    *,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset | None = None,
    summary: Mapping[str, Any] | None = None,
    evaluation: Evaluation | None = None,
    disagreement: BeforeAfter | None = None,
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
        ``reference``: the fit of the headline; ``warnings``: list of str; other plain values are
        listed under "This run".
    evaluation : Evaluation, optional
        Sections without content are omitted.
    disagreement : BeforeAfter, optional
        Disagreement with the reference of the headline; computed from ``corrected`` by default.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    folder, summary, results = Path(directory), summary or {}, evaluation or Evaluation()
    reference = summary.get("reference") or main_reference(fits)
    run = Run(selection.drawn_columns(headings), fits, reference)
    show = html.Figures(folder / "figures")
    if corrected is not None and disagreement is None:
        disagreement = selection.disagreement(headings, corrected, reference)
    total, period, errors = disagreement and disagreement.total, None, results.observation_errors
    if headings.sizes["report"]:
        first, last = np.datetime_as_string(time_span(headings), "D")
        period = str(first), str(last)
    values = {**summary, **{name: headings.attrs.get(name) for name in list(_ENTRIES)[1:]}}
    entries = {
        _ENTRIES.get(name, name.replace("_", " ")): str(value)
        for name, value in values.items()
        if isinstance(value, str | int | float)
    }
    columns = {"item": entries, "value": entries.values()}
    sections = [
        _corrections_section(run, folder),
        results.monitoring and monitoring_section(results.monitoring),
        _curves_section(run, show),
        _fleet_section(run, disagreement, show),
        innovations_section(results.innovations, reference, show),
        results.ranking and judged.ranking_section(results.ranking, results.virtual, show),
        results.stability and stability_section(results.stability, show, period),
        results.field_test and judged.field_test_section(results.field_test, show),
        results.sensitivity and judged.sensitivity_section(results.sensitivity, show),
        errors is not None and judged.report_errors_section(errors, show),
        places_section(headings, show),
        _audit_section(headings),
        html.Section("run", "This run", "", [html.table(columns, words=["item"], long=["value"])]),
    ]
    return html.write_document(
        folder / "index.html",
        title="airswing: compass deviation of the fleet",
        kicker=f"Compass deviation from wind reports  ·  {' to '.join(period or ['no reports'])}",
        headline=selection.headline(fits, total, reference),
        facts=_facts(run, total),
        warnings=summary.get("warnings", ()),
        sections=sections,
        footer="± and ranges in brackets are 95 % intervals, with flights "
        "as the independent units, unless stated otherwise. Map outline: Natural Earth and US "
        "Census Bureau, public domain.",
    )


def _facts(run: Run, total: BeforeAfter | None) -> list[tuple[str, str]]:
    sizes, constants = selection.fitted_sizes(run.fits, run.reference)
    facts = [(f"{sizes.size} of {run.fits.sizes['aircraft']}", "aircraft fitted")]
    if sizes.size:
        facts.append((f"{np.median(sizes):.1f}°", "median amplitude of the deviation"))
    if constants.size:
        words = f"median offset of {constants.size} aircraft with an offset only"
        facts.append((f"{np.median(constants):+.1f}°", words))
    if total is not None and total.number:
        before, after, reduction, half, *_ = total
        words = f"disagreement with {run.reference}; reduction {interval_text(reduction, half)} kt"
        facts.append((f"{before:.1f} → {after:.1f} kt", words))
    reports = f"reports used of {run.headings.sizes['report']:,}"
    return [*facts, (f"{selection.kept_reports(run.headings):,}", reports)]


def _corrections_section(run: Run, folder: Path) -> html.Section:
    meaning = "in degrees to add to the indicated heading"
    if selection.adds_error(run.fits):
        meaning = "the heading error itself, in degrees to subtract from the indicated heading"
    caption = (
        f"Eight-point corrections by indicated {selection.abscissa(run.fits)} heading ({meaning}), "
        f"fitted against {run.reference}. Residual: rms error from eight points and rounding, "
        "degrees. Offset, amplitude and phase in degrees with 95 % intervals. Largest amplitude "
        "first; click a column title to sort. Grey italics: not usable "
        f"(n = {len(run.order)} aircraft)."
    )
    fit = run.fits.sel(reference=run.reference, aircraft=run.order)
    status, usable = fit["status"].to_numpy(), published(fit["status"])
    # A refused fit has no numbers.
    valid = fit.where(xr.DataArray(usable, dims="aircraft"))
    nodes = [f"{node:.0f}°" for node in fit["table_heading"].to_numpy()]
    tables = valid["table_correction"].transpose("node", "aircraft").to_numpy()
    decimals = selection.table_digits(fit)
    columns: dict[str, Iterable[object]] = {
        "aircraft": run.order,
        **{
            node: [interval_text(value, np.nan, digits=decimals, sign=True) for value in row]
            for node, row in zip(nodes, tables, strict=True)
        },
        "resi\u00addual": valid["table_residual_rms"].to_numpy(),
    }
    for name, digits in (("offset", 2), ("amplitude", 2), ("phase", 0)):
        values, halves = valid[name].values, NORMAL_95 * valid[f"{name}_standard_error"].values
        pairs = zip(values, halves, strict=True)
        columns[name] = [interval_text(value, half, digits=digits) for value, half in pairs]
    columns["reports"] = fit["report_count"].to_numpy().astype(int)
    columns["status"] = [
        "no correction needed" if no_need else status_words(code)
        for no_need, code in zip(selection.needs_no_correction(fit), status, strict=True)
    ]
    present = [name for name in PRODUCTS if (folder.parent / name).exists()]
    words = ("aircraft", "status")
    title = "The deviation's formula, and offset, amplitude and phase"
    parts = [
        html.table(columns, words=words, caption=caption, doubt=~usable, sortable=True),
        html.folded(title, *selection.formula(run.fits)),
        html.listing(html.link(f"../{name}", PRODUCTS[name]) for name in present),
    ]
    lead = "The table to load into each unit."
    if not usable.any():
        reasons = [
            f"{name.replace('_', ' ')} ({plural(number, 'aircraft')})"
            for name, number in selection.status_counts(run.fits, run.reference).items()
            if number
        ]
        lead = f"No table may be loaded: {', '.join(reasons)}."
    return html.Section("corrections", "Corrections", lead, parts)


def _curves_section(run: Run, show: html.Figures) -> html.Section:
    parts: list[str] = []
    order = run.order[:PANELS]
    for start in range(0, len(order), TOGETHER):
        names = order[start : start + TOGETHER]
        figure = heading_errors_figure(run, names)
        shown = show(f"heading_errors_{start // TOGETHER + 1}", figure, dpi=120)
        title = f"{names[0]} to {names[-1]}, by amplitude ({len(names)} aircraft)"
        parts.append(shown if start == 0 else html.folded(title, shown))
    lead = (
        "Heading error is the indicated heading minus the heading implied by the reference wind; "
        "for a compass without deviation it scatters about zero. The swing cards have a page for "
        "each aircraft with a fit."
    )
    return html.Section("curves", "Heading error against heading", lead, parts)


def _fleet_section(run: Run, disagreement: BeforeAfter | None, show: html.Figures) -> html.Section:
    names = run.order[:OVERVIEW]
    few = f"The {len(names)} aircraft with the largest amplitude."
    parts = [show("fleet", _fleet_figure(run.fits, names))]
    if disagreement is not None:
        parts.append(show("disagreement", _before_after_figure(run, disagreement, names)))
    return html.Section("fleet", "The fleet", few if len(names) < len(run.order) else "", parts)


def _fleet_figure(fits: xr.Dataset, names: Sequence[str]) -> Figure:
    fits, references = fits.sel(aircraft=names), names_of(fits, "reference")
    figure, panels = html.panels(1.3 + max(0.24 * len(names), 1.2), 1, 2, sharey=True)
    # The intervals of one aircraft are spread over 0.54 of its row.
    shift = np.linspace(-0.27, 0.27, len(references)) if len(references) > 1 else [0.0]
    good, marked = published(fits["status"]), np.zeros((len(references), len(names)), bool)
    for axes, quantity in zip(panels, ("amplitude", "offset"), strict=True):
        value = fits[quantity].to_numpy().astype(float)
        half = NORMAL_95 * np.nan_to_num(fits[f"{quantity}_standard_error"].to_numpy())
        finite = np.isfinite(value)
        marked |= finite
        for index, reference in enumerate(references):
            solid, y = html.series(index, label=reference), np.arange(len(names)) + shift[index]
            hollow = {**solid, "color": SOFT, "markerfacecolor": "white", "label": None}
            for usable, look in ((True, solid), (False, hollow)):
                x = np.where(good[index] == usable, value[index], np.nan)
                ends = x - half[index], x + half[index]
                html.intervals(axes, x, ends, y, markersize=4.5, **look)
        html.rows_axis(axes, names, f"{quantity} of the heading error (degree)")
        axes.set_title(quantity.capitalize())
        # Limits from the usable fits, so that one wild fit does not compress the others.
        if (good & finite).any():
            low, high = (float(end(value[good & finite])) for end in (np.min, np.max))
            margin = max(0.12 * (high - low), 0.5)
            low = 0.0 if quantity == "amplitude" else min(low - margin, 0.0)
            axes.set_xlim(low, max(high + margin, 0))
        else:
            look = Look(transform=axes.transAxes, ha="center", color=SOFT)
            axes.text(0.5, 0.5, "none was fitted", **look)
            axes.set_xticks([])
    html.zero_line(panels[1])
    panels[1].tick_params(labelleft=False)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=len(references)
    )
    refused, absent = (marked & ~good).any(axis=0).sum(), (~marked).all(axis=0).sum()
    reports = int(fits["report_count"].max("reference").sum())
    return figure.say(
        f"Compass deviation of {plural(len(names), 'aircraft')} against each reference, with 95 % "
        f"intervals (n = {plural(reports, 'report')})."
        + (f" Hollow grey: not usable ({refused} aircraft)." if refused else "")
        + (f" Without a mark: no fit ({absent} aircraft)." if absent else "")
    )


def _before_after_figure(run: Run, disagreement: BeforeAfter, aircraft: Sequence[str]) -> Figure:
    fleet, reference = names_of(run.headings), run.reference
    rows = [fleet.index(name) for name in aircraft if disagreement.number[fleet.index(name)] > 0]
    if not rows:
        return html.empty_figure("No aircraft was corrected")
    rows.sort(key=lambda row: -disagreement.reduction[row])
    height = 1.3 + max(0.22 * len(rows), 1.2)
    figure, (left, right) = html.panels(height, 1, 2, sharey=True, width_ratios=(1.5, 1))
    before, after, reduction, half = (np.nan_to_num(column[rows]) for column in disagreement[:4])
    y, names = np.arange(len(rows)), [fleet[row] for row in rows]
    left.hlines(y, after, before, color=FAINT, linewidth=2.5)
    left.plot(before, y, "o", color=html.ORANGE, markersize=6, label="as reported")
    left.plot(after, y, "D", color=html.BLUE, markersize=5.5, label="corrected")
    left.set_xlim(left=0)
    html.rows_axis(left, names, f"mean vector disagreement with {reference} (kt)")
    label, ends = "reduction (kt), 95 % interval", (reduction - half, reduction + half)
    html.interval_rows(right, names, reduction, ends, label, color=html.INK)
    right.tick_params(labelleft=False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure.say(
        f"Mean length of the difference from the {reference} wind (n = "
        f"{plural(disagreement.number[rows].sum(), 'report')} of the fit): "
        f"{(reduction > half).sum()} of {len(rows)} aircraft improve by more than their interval."
    )


def _audit_section(headings: xr.Dataset) -> html.Section:
    reading = tally(headings, "reading_audit")
    total, used = headings.sizes["report"], selection.kept_reports(headings)
    rules = selection.screening_audit(headings)
    longest = max((marked for _, marked, _ in rules), default=1)
    screened = [
        {
            "screening rule": rule.replace("_", " "),
            "reports marked": html.bar(
                marked / longest, f"{marked:,} ({100 * marked / total:.1f} %)"
            ),
            "only by this rule": alone,
        }
        for rule, marked, alone in rules
    ]
    changed = [
        {"on reading": f"{action}: {name.replace('_', ' ')}", "reports": number}
        for action in ("dropped", "repaired")
        for name, number in sorted(reading.get(action, {}).items(), key=lambda item: -item[1])
        if number
    ]
    more = [entry["reason"] for entry in reading.get("files_skipped", [])][1:_FILES_NAMED]
    messages = [*reading_warnings(reading), *(f"also left out: {reason}" for reason in more)]
    for name, entry in tally(headings, "reference_audit").items():
        why = model_reasons([*entry.get("skipped", []), *entry.get("unread", [])])
        messages += [f"{name}: {line}" for line in [*why, *entry.get("notes", [])]]
    share = 100 * used / max(total, 1)
    lead = f"{used:,} of {plural(total, 'report')} ({share:.1f} %) entered the fits."
    parts = [
        html.table(screened, words=["screening rule", "reports marked"]),
        html.table(changed, words=["on reading"]),
        html.folded("Files and messages", html.listing(messages), unfolded=True),
    ]
    return html.Section("audit", "Omitted reports", lead, parts)
