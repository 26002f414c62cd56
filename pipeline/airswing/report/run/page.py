"""The page of a run: the result first, then what shows it.

Assumes the products of docs/formats.md with reports in the same order in HEADINGS and
CORRECTED.  Writes one self-contained HTML file; large fleets keep it usable: small multiples
and larger figures are made for the aircraft with the largest deviation, everyone is in the table,
which can be searched and sorted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup

from airswing.evaluation.results import Evaluation
from airswing.products.ragged import time_span
from airswing.products.whole_files import write_text
from airswing.report.html import maps
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    document,
    drawing,
    folded,
    heading,
    link,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded
from airswing.report.html.style import drawing_a_page, plural
from airswing.report.run import compass_figures as compass
from airswing.report.run import overview
from airswing.report.run.compass_panels import (
    large_panel,
    shown_of,
    small_caption,
    small_panels,
)
from airswing.report.run.evaluation_sections import (
    field_test_section,
    profiles_section,
    sensitivity_section,
)
from airswing.report.run.monitoring_section import monitoring_section
from airswing.report.run.page_numbers import (
    BeforeAfter,
    Total,
    correction_rows,
    disagreement,
    harmonic_amplitude,
    headline,
    kept_reports,
    offsets_alone,
    screening_audit,
)
from airswing.report.run.reading_warnings import model_reasons, reading_warnings, tally
from airswing.report.run.report_errors import report_errors_section
from airswing.report.run.selection import adds_error, headline_reference, tails
from airswing.report.run.stability_sections import ranking_section, stability_section
from airswing.version import __version__

# Aircraft that have a small panel, panels side by side, and aircraft that have a large one.
SMALL_PANELS, SMALL_TOGETHER, LARGE_PANELS = 96, 12, 40
# Report files left out that are named one by one; the product names all.
_FILES_NAMED = 20


@drawing_a_page()
def write_page(
    directory: Path | str,
    *,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset | None = None,
    summary: Mapping[str, object] | None = None,
    evaluation: Evaluation | None = None,
) -> Path:
    """Write the page of a run, ``index.html``, into its folder.

    Parameters
    ----------
    directory : Path
        Folder of the page, ``report`` in the run's output folder; products found beside it are
        linked.
    headings, fits, corrected : Dataset
        Products of docs/formats.md.
    summary : mapping, optional
        ``reference``: the fit the page leads with; ``links``: more (label, address relative to
        the page); ``warnings``: list of str; other plain values are listed under "This run".

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    summary, found = summary or {}, evaluation or Evaluation()
    reference = _lead_reference(fits, headings, summary)
    links = [*_product_links(Path(directory)), *_links(summary)]
    # Once for all that tells it: the sums go through the whole archive.
    apart = None if corrected is None else disagreement(headings, corrected, fits, reference)
    total = None if apart is None else apart.total
    sections = [
        monitoring_section(found.monitoring),
        _corrections_section(fits, reference, links),
        _curves_section(headings, fits, reference),
        _fleet_section(headings, fits, apart, reference),
        ranking_section(found.ranking, found.virtual),
        stability_section(found.stability),
        field_test_section(found.field_test),
        sensitivity_section(found.sensitivity),
        profiles_section(found.profiles, reference),
        report_errors_section(found.observation_errors),
        _places_section(headings),
        _audit_section(headings),
        _run_section(summary, headings),
    ]
    text = document(
        title="airswing: compass deviation of the fleet",
        kicker=f"Compass deviation from wind reports  ·  {_period(headings)}",
        headline=headline(fits, total, reference),
        facts=_facts(headings, fits, total, reference),
        warnings=_warnings(summary),
        sections=[section for section in sections if section.parts],
        footer=[
            f"airswing {__version__}. Map outline: Natural Earth and US Census "
            "Bureau, public domain. Intervals are 95 %, with flights as the independent "
            "units, unless said otherwise."
        ],
    )
    return write_text(Path(directory) / "index.html", text)


PRODUCTS = {
    "tables.csv": "8-point tables of the fleet (CSV)",
    "swing_cards": "swing cards, a page for each aircraft with a table",
    "fits.nc": "fits with covariances (NetCDF)",
    "corrected.nc": "corrected reports (NetCDF)",
    "headings.nc": "headings and heading errors of every report (NetCDF)",
    "corrected": "corrected reports, a file a month (NetCDF)",
    "headings": "headings and heading errors of every report, a file a month (NetCDF)",
    "ranking.csv": "whom to correct first (CSV)",
    "stability.json": "fits by calendar window and changes of the compass (JSON)",
    "virtual_field_test.json": "virtual field test (JSON)",
    "field_test.json": "field test (JSON)",
    "sensitivity.json": "sensitivity to the reference (JSON)",
    "error_profiles.nc": "error profiles (NetCDF)",
    "innovation_statistics.nc": "observation minus reference by aircraft, phase and level (NetCDF)",
    "observation_errors.nc": "the reports' own error by phase of flight and layer (NetCDF)",
    "events.json": "states of the aircraft and events (JSON)",
    "report/monitoring.html": "the watch over the fleet (page)",
    "gap/index.html": "the sim-to-real gap (page)",
    "postprocess/index.html": "forecasts corrected after the fact (page)",
}


def _product_links(directory: Path) -> list[tuple[str, str]]:
    """Return (label, address) of the products that stand beside the page's folder."""
    beside = directory.parent
    return [(label, f"../{name}") for name, label in PRODUCTS.items() if (beside / name).exists()]


def _links(summary: Mapping[str, object]) -> list[tuple[str, str]]:
    told = summary.get("links")
    pairs = told if isinstance(told, Iterable) else ()
    return [(str(label), str(address)) for label, address in pairs]


def _warnings(summary: Mapping[str, object]) -> list[str]:
    told = summary.get("warnings")
    return [str(line) for line in told] if isinstance(told, Iterable) else []


def _lead_reference(fits: xr.Dataset, headings: xr.Dataset, summary: Mapping[str, object]) -> str:
    asked = str(summary.get("reference", ""))
    known = [str(name) for name in fits["reference"].to_numpy()]
    return asked if asked in known else headline_reference(fits, headings)


def _period(headings: xr.Dataset) -> str:
    if not headings.sizes["report"]:
        return "no reports"
    first, last = time_span(headings)
    return f"{np.datetime_as_string(first, 'D')} to {np.datetime_as_string(last, 'D')}"


def _facts(
    headings: xr.Dataset, fits: xr.Dataset, total: Total | None, reference: str
) -> list[tuple[str, str]]:
    amplitude, alone = harmonic_amplitude(fits, reference), offsets_alone(fits, reference)
    kept = kept_reports(headings)
    fleet = fits.sizes["aircraft"]
    facts = [(f"{amplitude.size + alone.size} of {fleet}", "aircraft with a fit to be trusted")]
    if amplitude.size or not alone.size:
        facts.append(
            (f"{np.median(amplitude):.1f}°" if amplitude.size else "-", "median amplitude")
        )
    if alone.size:
        facts.append(
            (f"{np.median(alone):+.1f}°", f"median offset of {alone.size} without a curve")
        )
    if total is not None and total.number:
        facts.append(
            (
                f"{total.before:.1f} → {total.after:.1f} kt",
                f"wind disagreement with {reference}, before and after",
            )
        )
    facts.append((f"{kept:,}", f"reports used of {headings.sizes['report']:,}"))
    return facts


def _corrections_section(
    fits: xr.Dataset, reference: str, addresses: Sequence[tuple[str, str]]
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
    order = overview.by_amplitude(fits, reference)
    rows = [Row(cells, doubt=not good) for cells, good in correction_rows(fits, reference, order)]
    meaning = (
        "the heading error itself, degrees to subtract from the indicated heading"
        if adds_error(fits)
        else "degrees to add to the indicated heading"
    )
    caption = (
        f"Eight-point corrections by indicated magnetic heading ({meaning}), fitted against "
        f"{reference}; residual: rms degrees that eight points and rounding cost; offset, "
        "amplitude and phase in degrees with 95 % intervals. Largest amplitude first; a click on "
        "a head sorts by its column. Grey italics: not to be trusted "
        f"(n = {plural(len(rows), 'aircraft', 'aircraft')})."
    )
    parts = [table(columns, rows, caption=caption, sortable=True)]
    links = [link(address, label) for label, address in addresses]
    if links:
        parts.append(listing(links))
    return Section("corrections", "Corrections", "What to load into each unit.", parts)


def _curves_section(headings: xr.Dataset, fits: xr.Dataset, reference: str) -> Section:
    order = overview.by_amplitude(fits, reference)
    small, large = order[:SMALL_PANELS], order[:LARGE_PANELS]
    found = {name: shown_of(headings, fits, name, reference) for name in small}
    panels = small_panels(list(found.values()), reference)
    parts: list[Markup] = []
    for start in range(0, len(small), SMALL_TOGETHER):
        names = small[start : start + SMALL_TOGETHER]
        own = panels[start : start + SMALL_TOGETHER]
        caption = "" if start else small_caption(fits, len(small), reference)
        shown = drawing(own, caption)
        title = f"{names[0]} to {names[-1]}, by amplitude ({len(names)} aircraft)"
        parts.append(shown if start == 0 else folded(title, [shown]))
    parts.append(heading("Each aircraft, larger"))
    if len(large) < len(order):
        parts.append(
            paragraph(
                f"The {len(large)} aircraft with the largest amplitude; the other "
                f"{len(order) - len(large)} are in the table."
            )
        )
    for index, name in enumerate(large):
        words = compass.fit_words(found[name].fit)
        shown = large_panel(found[name], fits, reference)
        parts.append(folded(f"{name}: {words}", [shown], unfolded=index == 0))
    lead = (
        "Heading error is the indicated heading minus the heading that the reference wind "
        "implies; a compass without deviation would lie along zero."
    )
    return Section("curves", "Heading error against heading", lead, parts)


def _fleet_section(
    headings: xr.Dataset, fits: xr.Dataset, apart: BeforeAfter | None, reference: str
) -> Section:
    order = overview.by_amplitude(fits, reference)
    names = order[: overview.PAGE_OF_AIRCRAFT]
    parts = [embedded(overview.fleet_figure(fits, names))]
    if apart is not None:
        figure = overview.before_after_figure(apart, tails(headings), names, reference)
        parts.append(embedded(figure))
    if len(names) < len(order):
        parts.insert(0, paragraph(f"The {len(names)} aircraft with the largest amplitude."))
    parts.append(heading("Headings flown"))
    parts.append(embedded(compass.coverage_figure(headings, names), raster=True, dpi=140))
    return Section("fleet", "The fleet", "", parts)


def _places_section(headings: xr.Dataset) -> Section:
    parts = [
        embedded(maps.reports_figure(headings)),
        embedded(maps.phase_maps_figure(headings), raster=True, dpi=130),
        embedded(maps.level_maps_figure(headings), raster=True, dpi=130),
    ]
    return Section("places", "Where the reports are", "", parts)


def _audit_section(headings: xr.Dataset) -> Section:
    rules = screening_audit(headings)
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
        for rule in rules
    ]
    columns = [
        Column("rule", "words"),
        Column("reports marked"),
        Column("by this rule alone"),
        Column("share of all"),
    ]
    counts = table(columns, rows, caption=f"Screening by rule (n = {total:,} reports).")
    parts = [embedded(overview.audit_figure(headings)), folded("The counts", [counts])]
    if lines := _on_the_way_in(headings):
        parts.append(folded("Files and messages", [listing(lines)], unfolded=True))
    return Section("audit", "What was left out", "", parts)


def _on_the_way_in(headings: xr.Dataset) -> list[str]:
    """What did not come in of reports and models, a line each."""
    reading = tally(headings, "reading_audit")
    others = [entry["reason"] for entry in reading.get("files_skipped", [])][1:_FILES_NAMED]
    return [
        *reading_warnings(reading),
        *(f"also left out: {reason}" for reason in others),
        *(
            f"{name}: {line}"
            for name, entry in tally(headings, "reference_audit").items()
            for line in [
                *model_reasons([*entry.get("skipped", []), *entry.get("unread", [])]),
                *entry.get("notes", []),
            ]
        ),
    ]


def _run_section(summary: Mapping[str, object], headings: xr.Dataset) -> Section:
    named = {
        "airswing_version": "version",
        "source": "read from",
        "history": "history",
        "uuid": "identifier of headings.nc",
    }
    entries = {
        str(name).replace("_", " "): value
        for name, value in summary.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool)
    }
    entries |= {
        label: str(headings.attrs[name])
        for name, label in named.items()
        if headings.attrs.get(name)
    }
    rows = [Row([name, value]) for name, value in entries.items()]
    columns = [Column("what", "words"), Column("value", "long")]
    return Section("run", "This run", "", [table(columns, rows)] if rows else [])
