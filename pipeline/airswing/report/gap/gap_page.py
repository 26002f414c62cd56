"""The page of a gap diagnosis: verdict, where, which, how far, what stays open, the checks.

Assumes a report in the shapes of :mod:`airswing.gap.result.schema` and the ``gap.nc`` beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import xarray as xr
from markupsafe import Markup

from airswing.gap.result.schema import EffectEntry, GapReport, NoiseEntry
from airswing.products.whole_files import write_text
from airswing.report.gap.checks_section import (
    alias_lines,
    assumption_table,
    calibration_table,
    claims_section,
)
from airswing.report.gap.closing_figures import (
    autocorrelation_figure,
    pit_figure,
    waterfall_figure,
)
from airswing.report.gap.slices import slices_figure
from airswing.report.gap.verdict import digits_that_tell, verdict
from airswing.report.gap.where_figures import (
    aircraft_heading_figure,
    aircraft_time_figure,
    gap_map_figure,
    phase_level_figure,
)
from airswing.report.gap.which_figures import (
    evidence_figure,
    posterior_figure,
    posteriors,
    unknown_curve_figure,
)
from airswing.report.gap.words import (
    effect_sentence,
    joined,
    nature_of,
    parameters_text,
    period_text,
    plain_name,
    slice_words,
    small_text,
    who_text,
)
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    described,
    document,
    folded,
    heading,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded
from airswing.version import __version__


def write_gap_page(directory: Path, *, gap: GapReport, maps: xr.Dataset) -> Path:
    """Write the page of a gap diagnosis, ``index.html``, into its folder.

    Parameters
    ----------
    directory : Path
        Folder of the page, ``gap`` in the run's output folder.
    gap : GapReport
        Content of ``gap.json``.
    maps : Dataset
        Content of ``gap.nc``.

    Raises
    ------
    InputError
        If the page cannot be written.
    """
    sections = [
        _where_section(gap, maps),
        _which_section(gap, maps),
        _far_section(gap),
        _open_section(gap),
        claims_section(gap),
        _method_section(gap, maps),
    ]
    text = document(
        title="airswing: the sim-to-real gap",
        kicker="Where real reports part from simulated ones",
        headline=verdict(gap),
        facts=_facts(gap),
        sections=[section for section in sections if section.parts],
        footer=[
            f"airswing {__version__}. Disagreement is the mean length of the "
            "difference between reported and simulated wind. ± is one standard error; "
            "intervals in brackets and bars are 95 %. Map outline: Natural Earth and US "
            "Census Bureau, public domain."
        ],
    )
    return write_text(directory / "index.html", text)


def _facts(gap: GapReport) -> list[tuple[str, str]]:
    numbers, closure = gap.gap, gap.closure
    digits = digits_that_tell(closure.before, closure.after) if gap.effects else 1
    level = f"{numbers.mean_vector_disagreement_kt:.{digits}f} kt"
    facts = [(level, "disagreement of reports and simulation")]
    if gap.effects:
        bounds = closure.ci
        interval = f" [{bounds[0]:.{digits}f}, {bounds[1]:.{digits}f}]" if bounds else ""
        facts.append((f"{closure.after:.{digits}f} kt{interval}", "with the effects found"))
    facts.append((f"{numbers.noise_floor_kt:.{digits}f} kt", "noise floor"))
    if closure.fraction_of_excess is not None and gap.effects:
        share = f"{100 * closure.fraction_of_excess:.0f} %"
        facts.append((share, "of what can be explained is explained"))
    luck = small_text(numbers.significance).removeprefix("= ")
    return [*facts, (luck, "probability of this gap by luck")]


def _where_section(gap: GapReport, maps: xr.Dataset) -> Section:
    parts = [embedded(slices_figure(gap.where))]
    drawn = (aircraft_heading_figure, phase_level_figure, gap_map_figure, aircraft_time_figure)
    parts += [embedded(draw(maps, gap)) for draw in drawn]
    everywhere = sorted(gap.slices, key=lambda entry: -entry.share_of_gap)
    if everywhere:
        rows = [
            Row(
                [
                    slice_words(entry, most=12),
                    f"{100 * entry.share_of_gap:.1f} %",
                    f"{entry.q_value:.2g}",
                ]
            )
            for entry in everywhere
        ]
        columns = [Column("slice", "long"), Column("share of the gap"), Column("q value")]
        parts.append(folded(f"All {len(rows)} slices", [table(columns, rows)]))
    lead = "Which aircraft, headings, levels, places and times hold the gap, before any physics."
    return Section("where", "Where", lead, parts)


def _which_section(gap: GapReport, maps: xr.Dataset) -> Section:
    effects = gap.effects
    parts: list[Markup] = []
    if effects:
        rows = [
            Row(
                [
                    f"{plain_name(effect.name)} ({effect.name})",
                    who_text(effect, gap.counts.aircraft),
                    parameters_text(effect) or "-",
                    period_text(effect) or "always",
                    f"{effect.probability:.2f}",
                    f"{100 * effect.share_of_gap:.0f} %",
                    joined([plain_name(name) for name in effect.ambiguous_with]) or "-",
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
        parts += _natures(effects)
        parts += _per_aircraft(effects)
    else:
        parts.append(paragraph("No effect of the catalogue is needed to explain these reports."))
    parts += _unknown(gap)
    parts.append(embedded(evidence_figure(gap)))
    single = posteriors(gap.evidence)
    if single:
        tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
        parts.append(embedded(posterior_figure(tails, single)))
    return Section("which", "Which effect", "", parts)


def _natures(effects: Sequence[EffectEntry]) -> list[Markup]:
    """Return what each effect found is, who says so, and what is like it: once, however often."""
    told = [nature_of(name) for name in dict.fromkeys(effect.name for effect in effects)]
    entries = [
        described(f"{one.title}.", one.physics, [one.source, one.alike])
        for one in told
        if one is not None
    ]
    return [heading("What they are"), listing(entries)] if entries else []


def _per_aircraft(effects: Sequence[EffectEntry]) -> list[Markup]:
    """Return the parameters of each aircraft, where an effect has several."""
    rows = [
        Row([tail, plain_name(effect.name), parameters_text(entry)])
        for effect in effects
        for tail, entry in (effect.per_tail or {}).items()
    ]
    if not rows:
        return []
    columns = [Column("aircraft", "words"), Column("effect", "long"), Column("parameters", "long")]
    return [folded("Each aircraft's parameters", [table(columns, rows)])]


def _unknown(gap: GapReport) -> list[Markup]:
    if not gap.unknown.present:
        return []
    places = joined([slice_words(place) for place in gap.unknown.where])
    text = f"Something outside the catalogue is at work, found in {places}."
    drawn = [embedded(unknown_curve_figure(place)) for place in gap.unknown.where]
    return [paragraph(text, note=True), *drawn]


def _far_section(gap: GapReport) -> Section:
    closure = gap.closure
    interval = "no interval can be had from one day"
    if closure.ci:
        interval = f"95 % interval {closure.ci[0]:.2f} to {closure.ci[1]:.2f}"
    rows = [Row(["reduction (kt)", f"{closure.reduction:.3g}"])]
    if closure.fraction_of_excess is not None:
        rows.append(Row(["fraction of excess", f"{closure.fraction_of_excess:.3g}"]))
    parts = [
        *([embedded(waterfall_figure(gap))] if gap.effects else []),
        paragraph(
            f"On {'held-out' if closure.held_out else 'the same'} flights the disagreement goes "
            f"from {closure.before:.2f} to {closure.after:.2f} kt ({interval})."
        ),
        folded("The numbers", [table([Column("", "words"), Column("")], rows)]),
    ]
    lead = "What adding the effects to the simulation buys, on flights they were not fitted to."
    return Section("far", "How far it closes", lead, parts)


def _open_section(gap: GapReport) -> Section:
    parts: list[Markup] = []
    for effect in gap.effects:
        if effect.ambiguity:
            others = [plain_name(rival.name) for rival in effect.ambiguity]
            told = list(dict.fromkeys(rival.separated_by for rival in effect.ambiguity))
            text = effect_sentence(effect, gap.counts.aircraft)
            text += f". The data fit as well: {joined(others)}. What would tell: {joined(told)}."
            parts.append(paragraph(text))
    alike = alias_lines(gap)
    if alike:
        parts += [heading("What looks alike on these flights"), listing(alike)]
    if gap.untestable:
        rows = [Row([plain_name(name), reason]) for name, reason in gap.untestable.items()]
        parts += [
            heading("What could not be tested"),
            table([Column("effect", "long"), Column("why", "long")], rows),
        ]
    if not parts:
        parts.append(paragraph("Every effect named stands apart from its rivals on these data."))
    return Section("open", "What could not be told apart", "", parts)


def _method_section(gap: GapReport, maps: xr.Dataset) -> Section:
    parts = assumption_table(gap) + calibration_table(gap)
    parts += [embedded(autocorrelation_figure(gap)), embedded(pit_figure(maps))]
    parts.append(_noise_table(gap.noise))
    return Section("method", "What this rests on", "", parts)


def _noise_table(noise: NoiseEntry) -> Markup:
    rows = [
        Row(["correlated part (m/s)", f"{noise.correlated_sd_m_s:.2f}"]),
        Row(["white part (m/s)", f"{noise.white_sd_m_s:.2f}"]),
        Row(["correlation length (km)", f"{noise.length_km:.0f}"]),
        Row(["across the heading, times", f"{noise.across_heading:.2f}"]),
        Row(["along the heading, times", f"{noise.along_heading:.2f}"]),
    ]
    return table([Column("noise model", "words"), Column("fitted")], rows)
