"""The page of a gap diagnosis: verdict, where, which, how far, what stays open, the checks.

Assumes ``gap.json`` of docs/formats.md.  Everything beyond it is optional and shown where
given: further keys of the dictionary and the arrays of ``gap.nc`` (names in
:mod:`airswing.report.gap.parts`).  What is missing is left out, never guessed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr
from markupsafe import Markup

import airswing
from airswing.report.gap import parts as gap_parts
from airswing.report.gap.checks_section import (
    alias_lines,
    assumption_table,
    calibration_table,
    claims_section,
)
from airswing.report.gap.slices import slices_figure
from airswing.report.gap.which_figures import unknown_curve_figure
from airswing.report.gap.words import (
    effect_sentence,
    joined,
    parameters_text,
    period_text,
    plain_name,
    rival_advice,
    rival_names,
    slice_words,
    small_text,
    verdict,
    who_text,
)
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    document,
    folded,
    heading,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded, write_whole

ASSUMPTIONS: tuple[tuple[str, str], ...] = (
    (
        "Errors along a flight fall off with distance as the fitted noise model says",
        "autocorrelation against distance, below",
    ),
    (
        "Model error shared by the fleet on a day is counted once",
        "scores are rescaled by clusters of aircraft by day and of days across the fleet",
    ),
    (
        "The reference's own climatology is not an aircraft's fault",
        "it is fitted beside every effect",
    ),
    (
        "The catalogue holds the effect",
        "a dictionary without physics competes with it; where that wins, the verdict is unknown",
    ),
    ("An effect found is not luck", "its energy must hold on flights it was not fitted to"),
)


def write_gap_page(
    directory: Path | str,
    *,
    gap: Mapping[str, Any],
    maps: xr.Dataset | None = None,
    details: Mapping[str, Any] | None = None,
    summary: Mapping[str, Any] | None = None,
) -> Path:
    """Write the page of a gap diagnosis, ``index.html``, into its folder.

    Parameters
    ----------
    directory : Path
        Folder of the page, ``gap`` in the run's output folder.
    gap : mapping
        Content of ``gap.json``; ``second_moment`` (list), ``would_tell`` and ``notes`` (lists
        of str) are shown where given.
    maps : Dataset, optional
        Content of ``gap.nc``, names as in :mod:`airswing.report.gap.parts`.
    details : mapping, optional
        What the diagnosis tells beside ``gap.json``: ``waterfall``, ``evidence``, ``noise``,
        ``untestable``, ``slices``, ``counts`` (see :mod:`airswing.gap.result.assembled`).
    summary : mapping, optional
        ``warnings``: list of str shown below the headline.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    gap = {**(details or {}), **gap}
    sections = [
        _where_section(gap, maps),
        _which_section(gap, maps),
        _far_section(gap, maps),
        _open_section(gap),
        claims_section(gap),
        _method_section(gap, maps),
    ]
    text = document(
        title="airswing: the sim-to-real gap",
        kicker="Where real reports part from simulated ones",
        headline=verdict(gap),
        facts=_facts(gap),
        warnings=[str(line) for line in (summary or {}).get("warnings", [])],
        sections=[section for section in sections if section.parts],
        footer=[
            f"airswing {airswing.__version__}. Disagreement is the mean length of the "
            "difference between reported and simulated wind. ± is one standard error; "
            "intervals in brackets and bars are 95 %. Map outline: Natural Earth and US "
            "Census Bureau, public domain."
        ],
    )
    return write_whole(Path(directory) / "index.html", text)


def _number(value: Any, digits: int = 2) -> str:
    return f"{float(value):.{digits}f}" if isinstance(value, int | float) else "-"


def _facts(gap: Mapping[str, Any]) -> list[tuple[str, str]]:
    numbers, closure = gap.get("gap") or {}, gap.get("closure") or {}
    facts = []
    if numbers.get("mean_vector_disagreement_kt") is not None:
        facts.append(
            (
                f"{_number(numbers['mean_vector_disagreement_kt'], 1)} kt",
                "disagreement of reports and simulation",
            )
        )
    if closure.get("after") is not None and gap.get("effects"):
        bounds = closure.get("ci")
        interval = f" [{_number(bounds[0], 1)}, {_number(bounds[1], 1)}]" if bounds else ""
        facts.append((f"{_number(closure['after'], 1)} kt{interval}", "with the effects found"))
    if numbers.get("noise_floor_kt") is not None:
        facts.append((f"{_number(numbers['noise_floor_kt'], 1)} kt", "noise floor"))
    if closure.get("fraction_of_excess") is not None and gap.get("effects"):
        facts.append(
            (
                f"{100 * float(closure['fraction_of_excess']):.0f} %",
                "of what can be explained is explained",
            )
        )
    if numbers.get("significance") is not None:
        facts.append(
            (
                small_text(float(numbers["significance"])).removeprefix("= "),
                "probability of this gap by luck",
            )
        )
    return facts


def _where_section(gap: Mapping[str, Any], maps: xr.Dataset | None) -> Section:
    where = list(gap.get("where") or [])
    everywhere = list(gap.get("slices") or where)
    named = sorted({str(t) for effect in gap.get("effects") or [] for t in effect.get("tails", [])})
    parts = [embedded(figure) for figure in gap_parts.where_figures(maps, gap, named)]
    parts.insert(0, embedded(slices_figure(where)))
    if everywhere:
        rows = [
            Row(
                [
                    slice_words(entry, most=12),
                    f"{100 * float(entry['share_of_gap']):.1f} %",
                    f"{float(entry.get('q_value', float('nan'))):.2g}",
                ]
            )
            for entry in sorted(everywhere, key=lambda entry: -float(entry["share_of_gap"]))
        ]
        columns = [Column("slice", "long"), Column("share of the gap"), Column("q value")]
        parts.append(folded(f"All {len(rows)} slices", [table(columns, rows)]))
    lead = "Which aircraft, headings, levels, places and times hold the gap, before any physics."
    return Section("where", "Where", lead, parts)


def _which_section(gap: Mapping[str, Any], maps: xr.Dataset | None) -> Section:
    effects = list(gap.get("effects") or [])
    parts: list[Markup] = []
    if effects:
        rows = [
            Row(
                [
                    f"{plain_name(str(effect['name']))} ({effect['name']})",
                    who_text(effect),
                    parameters_text(effect) or "-",
                    period_text(effect) or "always",
                    _number(effect.get("probability")),
                    _share(effect),
                    joined([plain_name(name) for name in rival_names(effect)]) or "-",
                ]
            )
            for effect in effects
        ]
        columns = [
            Column("effect", "long"),
            Column("who", "long"),
            Column("parameters", "long"),
            Column("when", "words"),
            Column("proba\u00adbility"),
            Column("share of the gap"),
            Column("not told apart from", "long"),
        ]
        parts.append(
            table(
                columns,
                rows,
                caption=f"The effects found (n = {len(rows)}), by what they explain of "
                "held-out flights; ± is one standard error.",
            )
        )
        parts += _per_aircraft(effects)
    else:
        parts.append(paragraph("No effect of the catalogue is needed to explain these reports."))
    parts += _unknown(gap)
    parts += [embedded(figure) for figure in gap_parts.which_figures(maps, gap)]
    parts += _second_moment(gap)
    return Section("which", "Which effect", "", parts)


def _per_aircraft(effects: Sequence[Mapping[str, Any]]) -> list[Markup]:
    """Return the parameters of each aircraft, where an effect has several."""
    rows = [
        Row([tail, plain_name(str(effect["name"])), parameters_text(entry)])
        for effect in effects
        for tail, entry in (effect.get("per_tail") or {}).items()
    ]
    if not rows:
        return []
    columns = [Column("aircraft", "words"), Column("effect", "long"), Column("parameters", "long")]
    return [folded("Each aircraft's parameters", [table(columns, rows)])]


def _share(effect: Mapping[str, Any]) -> str:
    share = effect.get("share_of_gap")
    return f"{100 * float(share):.0f} %" if share is not None else "-"


def _unknown(gap: Mapping[str, Any]) -> list[Markup]:
    unknown = gap.get("unknown") or {}
    if not unknown.get("present"):
        return []
    places = [
        slice_words(p) if isinstance(p, Mapping) else str(p) for p in unknown.get("where") or []
    ]
    text = "Something outside the catalogue is at work"
    text += f", found in {joined(places)}." if places else "; its place could not be told."
    places_drawn = [
        embedded(unknown_curve_figure(place))
        for place in unknown.get("where") or []
        if isinstance(place, Mapping) and (place.get("curve") or {}).get("labels")
    ]
    extra = [
        f"{key.replace('_', ' ')}: {value}"
        for key, value in unknown.items()
        if key not in {"present", "where"} and isinstance(value, str | int | float)
    ]
    return [paragraph(text, note=True), *places_drawn, *([listing(extra)] if extra else [])]


def _second_moment(gap: Mapping[str, Any]) -> list[Markup]:
    tests = [entry for entry in gap.get("second_moment") or [] if isinstance(entry, Mapping)]
    if not tests:
        return []
    keys = [key for key in tests[0] if isinstance(tests[0][key], str | int | float)]
    columns = [Column(key.replace("_", " "), "" if i else "words") for i, key in enumerate(keys)]
    rows = [Row([_cell(entry.get(key)) for key in keys]) for entry in tests]
    return [
        heading("Coding and gross errors"),
        table(
            columns,
            rows,
            caption=(
                "Effects that show in spread and rounding, not in means, have tests of their own."
            ),
        ),
    ]


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _far_section(gap: Mapping[str, Any], maps: xr.Dataset | None) -> Section:
    closure = gap.get("closure") or {}
    parts = [embedded(figure) for figure in gap_parts.closure_figures(gap)]
    bounds = closure.get("ci")
    if closure.get("before") is not None and closure.get("after") is not None:
        text = (
            f"On {'held-out' if closure.get('held_out', True) else 'the same'} flights the "
            f"disagreement goes from {_number(closure['before'])} to "
            f"{_number(closure['after'])} kt"
        )
        interval = "no interval can be had from one day"
        if bounds:
            interval = f"95 % interval {_number(bounds[0])} to {_number(bounds[1])}"
        text += f" ({interval})."
        parts.append(paragraph(text))
    rest = {
        key: value
        for key, value in closure.items()
        if key not in {"before", "after", "ci", "held_out", "steps"}
        and isinstance(value, str | int | float)
    }
    if rest:
        rows = [Row([key.replace("_", " "), _cell(value)]) for key, value in rest.items()]
        parts.append(folded("The numbers", [table([Column("", "words"), Column("")], rows)]))
    lead = "What adding the effects to the simulation buys, on flights they were not fitted to."
    return Section("far", "How far it closes", lead, parts)


def _open_section(gap: Mapping[str, Any]) -> Section:
    parts: list[Markup] = []
    for effect in gap.get("effects") or []:
        others = [plain_name(name) for name in rival_names(effect)]
        if others:
            told = rival_advice(effect)
            text = f"{effect_sentence(effect)}. The data fit as well: {joined(others)}."
            text += f" What would tell: {joined(told)}." if told else ""
            parts.append(paragraph(text))
    alike = alias_lines(gap)
    if alike:
        parts += [heading("What looks alike on these flights"), listing(alike)]
    would = gap.get("would_tell") or []
    if would:
        parts += [heading("What data would tell"), listing([str(line) for line in would])]
    untested = gap.get("untestable") or {}
    pairs = (
        list(untested.items())
        if isinstance(untested, Mapping)
        else [(entry["name"], entry.get("reason", "")) for entry in untested]
    )
    if pairs:
        rows = [Row([plain_name(str(name)), str(reason)]) for name, reason in pairs]
        parts += [
            heading("What could not be tested"),
            table([Column("effect", "long"), Column("why", "long")], rows),
        ]
    if not parts:
        parts.append(paragraph("Every effect named stands apart from its rivals on these data."))
    return Section("open", "What could not be told apart", "", parts)


def _method_section(gap: Mapping[str, Any], maps: xr.Dataset | None) -> Section:
    parts = assumption_table(gap, ASSUMPTIONS) + calibration_table(gap)
    parts += [embedded(figure) for figure in gap_parts.method_figures(maps, gap)]
    parts += _noise_table(gap.get("noise") or {})
    if gap.get("notes"):
        parts.append(listing([str(note) for note in gap["notes"]]))
    return Section("method", "What this rests on", "", parts)


def _noise_table(noise: Mapping[str, Any]) -> list[Markup]:
    names = {
        "correlated_sd_m_s": "correlated part (m/s)",
        "white_sd_m_s": "white part (m/s)",
        "length_km": "correlation length (km)",
    }
    rows = [Row([label, _number(noise[key])]) for key, label in names.items() if key in noise]
    if not rows:
        return []
    return [table([Column("noise model", "words"), Column("fitted")], rows)]
