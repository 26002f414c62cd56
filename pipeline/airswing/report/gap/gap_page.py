"""The page of a gap diagnosis: missing effects, closure, location and statistics of the gap.

Takes the content of ``gap.json`` (docs/formats.md) and the maps of ``gap.nc``. Whatever a file of
another version lacks is omitted. ± and ranges in brackets are 95 % intervals throughout.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.products.whole_files import write_text
from airswing.report.gap import figures as draw
from airswing.report.gap.words import (
    Entry,
    Report,
    caution_lines,
    closure_text,
    content_of,
    headline,
    joined,
    levels_text,
    nature_of,
    number,
    p_text,
    parameters_text,
    period_text,
    place_sentence,
    plain_name,
    slice_words,
    start_words,
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
from airswing.report.html.embed import Figures
from airswing.report.html.style import Units, garbage_collection_rare, shown_per_kt, shown_per_m_s
from airswing.report.run.selection import interval_text, number_text, range_text
from airswing.units import NORMAL_95
from airswing.version import __version__

_CALIBRATION = (
    ("spread", "spread over predicted spread", "1"),
    ("crps", "CRPS", ""),
    ("lag_one", "correlation of neighbours on a flight", "0"),
    ("auc", "area under the ROC curve of a classifier", "0.5"),
)


@garbage_collection_rare()
def write_gap_page(
    directory: Path, *, gap: Report | Entry, maps: xr.Dataset, units: Units = "kt"
) -> Path:
    """Write the page of a gap diagnosis, ``index.html``, and its figures, ``figures/*.png``.

    Parameters
    ----------
    directory : Path
        Folder of the page, ``gap`` in the output folder.
    gap : GapReport or mapping
        A diagnosis, or the content of ``gap.json``.
    maps : Dataset
        Content of ``gap.nc``.
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
    content = content_of(gap)
    show = Figures(directory / "figures", units)
    show.clear()
    text = document(
        title="airswing: the sim-to-real gap",
        kicker="Gap between real and simulated reports",
        headline=headline(content, units=units),
        facts=_facts(content, units),
        sections=[
            _what_section(content, maps, show),
            _closure_section(content, show),
            _where_section(content, maps, show),
            _ambiguous_section(content),
            _claims_section(content, units),
            _statistics_section(content, maps, show),
        ],
        footer=[
            f"airswing {__version__}. Disagreement is the mean length of the difference between "
            "reported and simulated wind, on held-out flights. ± and ranges in brackets are 95 % "
            "intervals. Map outline: Natural Earth and US Census Bureau, public domain."
        ],
    )
    return write_text(directory / "index.html", text)


def gap_figures(
    gap: Report | Entry, maps: xr.Dataset, *, units: Units = "kt"
) -> dict[str, Callable[[], Figure]]:
    """Return functions that draw the figures of a diagnosis that have data, by name."""
    content = content_of(gap)
    found: dict[str, Callable[[], Figure]] = {}
    compass = {"compass_offset", "hard_iron", "soft_iron"}
    if "heading_map" in maps and compass & {effect["name"] for effect in content["effects"]}:
        found["compass_effects"] = lambda: draw.compass_effects_figure(maps, content)
    for place, entry in enumerate(content["unknown"]["where"], 1):
        found[f"unknown_{place}"] = partial(draw.unknown_curve_figure, entry, units=units)
    if content["effects"] or content["unknown"]["where"]:
        found["waterfall"] = lambda: draw.waterfall_figure(content, units=units)
    found["slices"] = lambda: draw.slices_figure(content.get("where") or ())
    in_maps: dict[str, tuple[str, Callable[[], Figure]]] = {
        "aircraft_heading": ("heading_map", lambda: draw.aircraft_heading_figure(maps, content)),
        "phase_level": (
            "level_map_cross",
            lambda: draw.phase_level_figure(maps, content, units=units),
        ),
        "map": ("region_map_u", lambda: draw.gap_map_figure(maps, content, units=units)),
        "aircraft_time": ("time_line", lambda: draw.aircraft_time_figure(maps, content)),
        "pit": ("pit_count", lambda: draw.pit_figure(maps)),
    }
    found |= {name: figure for name, (needed, figure) in in_maps.items() if needed in maps}
    if content.get("evidence"):
        found["evidence"] = lambda: draw.evidence_figure(content)
        tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
        found["probability"] = lambda: draw.probability_figure(content, tails)
    if (content.get("noise") or {}).get("distance_km"):
        found["autocorrelation"] = lambda: draw.autocorrelation_figure(content)
    return found


def _shown(names: Sequence[str], gap: Entry, maps: xr.Dataset, show: Figures) -> list[Markup]:
    known = gap_figures(gap, maps, units=show.units)
    return [show(name, known[name](), dpi=120) for name in names if name in known]


def _facts(gap: Entry, units: Units) -> list[tuple[str, str]]:
    closure, factor = gap["closure"], shown_per_kt(units)
    before, after = number(closure["before"]), number(closure["after"])
    found = bool(gap["effects"] or gap["unknown"]["where"])
    facts = [(f"{factor * before:.2f} {units}", "disagreement of reports and simulation")]
    if found:
        interval = range_text(closure.get("ci"), factor=factor)
        facts = [
            (levels_text(before, after, units=units), f"with the effects found{interval}"),
            (
                closure_text(closure, units=units).split(" (")[0],
                f"reduction{range_text(closure.get('reduction_ci'), factor=factor)}",
            ),
        ]
    floor = number(gap["gap"].get("noise_floor_kt"))
    if math.isfinite(floor):
        facts.append((f"{factor * floor:.2f} {units}", "noise floor"))
    p_value = p_text(gap["gap"].get("significance")).removeprefix("= ")
    return [*facts, (p_value, "p value of the gap")]


def _what_section(gap: Entry, maps: xr.Dataset, show: Figures) -> Section:
    units, effects = show.units, gap["effects"]
    places, fleet = gap["unknown"]["where"], int((gap.get("counts") or {}).get("aircraft") or 0)
    parts: list[Markup] = []
    if start := start_words(gap.get("known"), gap.get("simulation")).strip():
        parts.append(paragraph(start))
    if effects:
        rows = [
            Row(
                [
                    plain_name(effect["name"]),
                    who_text(effect, fleet),
                    parameters_text(effect, units=units) or "-",
                    period_text(effect) or "always",
                    f"{number(effect['probability']):.2f}",
                    closure_text(effect.get("closure"), units=units),
                    f"{100 * number(effect.get('share_of_gap')):.0f} %",
                    joined([plain_name(name) for name in effect["ambiguous_with"]]) or "-",
                ]
            )
            for effect in effects
        ]
        columns = [Column(name, "long") for name in ("effect", "aircraft", "parameters")]
        columns += [Column("period", "words"), Column("proba\u00adbility"), Column("closes")]
        columns += [Column("share of the gap"), Column("ambiguous with", "long")]
        caption = (
            f"Effects found (n = {len(rows)}), the largest share of the gap first. Parameters with "
            "95 % intervals (±), or the range over aircraft."
        )
        parts.append(table(columns, rows, caption=caption))
    elif not places:
        parts.append(paragraph("No effect of the catalogue is needed to explain these reports."))
    parts += _shown(["compass_effects"], gap, maps, show)
    for k, place in enumerate(places, 1):
        parts.append(paragraph(place_sentence(place, gap, units=units), note=True))
        if place.get("settled_by"):
            parts.append(paragraph(f"A measurement that would decide: {place['settled_by']}."))
        parts += _shown([f"unknown_{k}"], gap, maps, show)
    parts += [paragraph(line) for line in caution_lines(gap, units=units)]
    each = [
        Row([tail, plain_name(effect["name"]), parameters_text(entry, units=units)])
        for effect in effects
        for tail, entry in (effect.get("per_tail") or {}).items()
    ]
    if each:
        columns = [Column("aircraft", "words"), Column("effect", "long")]
        inner = table([*columns, Column("parameters", "long")], each)
        parts.append(folded("Parameters of each aircraft", [inner]))
    natures = [nature_of(name) for name in dict.fromkeys(effect["name"] for effect in effects)]
    described_ones = [
        described(f"{one.title}.", one.physics, [one.source, one.confused])
        for one in natures
        if one
    ]
    if described_ones:
        parts.append(folded("Physics of the effects found", [listing(described_ones)]))
    return Section("what", "What is missing from the simulation", "", parts)


def _closure_section(gap: Entry, show: Figures) -> Section:
    closure, units, factor = gap["closure"], show.units, shown_per_kt(show.units)
    before, after = factor * number(closure["before"]), factor * number(closure["after"])
    interval = range_text(closure.get("ci"), factor=factor) or " (no interval from one day)"
    text = (
        f"On {'held-out' if closure.get('held_out') else 'the same'} flights the disagreement is "
        f"{before:.2f} {units} without and {after:.2f} {units}{interval} with all effects stated."
    )
    parts: list[Markup] = []
    if gap["effects"] or gap["unknown"]["where"]:
        parts.append(show("waterfall", draw.waterfall_figure(gap, units=units), dpi=120))
    parts.append(paragraph(text))
    return Section("closure", "How far the gap closes", "", parts)


def _where_section(gap: Entry, maps: xr.Dataset, show: Figures) -> Section:
    parts = _shown(["slices", "aircraft_heading"], gap, maps, show)
    inner = _shown(["phase_level", "map", "aircraft_time"], gap, maps, show)
    rows = [
        Row(
            [
                slice_words(entry),
                f"{100 * entry['share_of_gap']:.1f} %",
                p_text(entry.get("q_value")).removeprefix("= "),
            ]
        )
        for entry in sorted(gap.get("slices") or (), key=lambda entry: -entry["share_of_gap"])
    ]
    if inner:
        parts.append(folded("By phase and level, on a map, by week", inner))
    if rows:
        columns = [Column("slice", "long"), Column("share of the gap"), Column("q value")]
        parts.append(folded(f"All {len(rows)} slices", [table(columns, rows)]))
    lead = "Slices of the archive by their share of the gap, before any effect is assumed."
    return Section("where", "Where the gap is", lead, parts)


def _ambiguous_section(gap: Entry) -> Section:
    parts: list[Markup] = []
    lines = []
    for effect in gap["effects"]:
        rivals = effect.get("ambiguity") or ()
        if rivals:
            names = joined([plain_name(rival["name"]) for rival in rivals])
            needed = joined(list(dict.fromkeys(rival["separated_by"] for rival in rivals)))
            lines.append(
                f"{plain_name(effect['name'])} on {joined(effect['tails']) or 'all aircraft'} "
                f"could also be {names}. Data that would decide: {needed}."
            )
    if lines:
        parts.append(listing(line[0].upper() + line[1:] for line in lines))
    similar = [
        f"{plain_name(pair['effect'])} and {plain_name(pair['other'])}: shared variance "
        f"{100 * pair['alias_share']:.0f} %; decided by {pair['separated_by']}"
        for pair in gap.get("aliases") or ()
    ]
    if similar:
        parts.append(folded("Effects with shared variance on these flights", [listing(similar)]))
    if gap.get("untestable"):
        rows = [Row([plain_name(name), reason]) for name, reason in gap["untestable"].items()]
        columns = [Column("effect", "long"), Column("why", "long")]
        parts += [heading("Effects that could not be tested"), table(columns, rows)]
    if not parts:
        parts.append(paragraph("No effect found is ambiguous on these data."))
    return Section("ambiguous", "Ambiguous effects", "", parts)


def _claims_section(gap: Entry, units: Units) -> Section:
    title = "Consequences for the fitted deviations"
    claims = gap.get("claims")
    if not claims:
        return Section("claims", title)
    if not claims.get("taken_off"):
        if gap["unknown"]["where"]:
            text = (
                "An unexplained error is not subtracted before the fit: the fitted deviations "
                "remain as they are and may contain part of it."
            )
        elif gap["effects"]:
            text = "Only compass effects were found, so the fitted deviations remain as they are."
        else:
            text = "No effect was found, so the fitted deviations remain as they are."
        return Section("claims", title, "", [paragraph(text)])
    names = joined([plain_name(name) for name in claims["taken_off"]])
    lead = (
        f"After subtraction of {names}, {claims['stay']} of {claims['of']} fits keep offset and "
        "amplitude within their 95 % intervals."
    )
    parts: list[Markup] = []
    if test := claims.get("field_test"):
        factor = shown_per_kt(units)
        before, after = (
            factor * number(test[key]) for key in ("reduction_kt", "reduction_kt_after")
        )
        interval = range_text(test.get("reduction_ci_kt"), factor=factor)
        parts.append(
            paragraph(
                f"Field test: the adjusted reduction of {before:.2f} {units}{interval} becomes "
                f"{after:.2f} {units}, {'within' if test['stays'] else 'outside'} its interval."
            )
        )
    rows = []
    for entry in claims.get("aircraft") or ():
        cells = [entry["aircraft"]]
        for key in ("offset_deg", "amplitude_deg"):
            half = NORMAL_95 * number(entry[f"{key}_standard_error"])
            cells += [interval_text(number(entry[key]), half), number_text(entry[f"{key}_after"])]
        word = {True: "yes", False: "no", None: "not tested"}[entry["stays"]]
        rows.append(Row([*cells, word], doubt=entry["stays"] is not True))
    columns = [Column("aircraft", "words"), Column("offset (°)"), Column("afterwards")]
    columns += [Column("amplitude (°)"), Column("afterwards"), Column("within the interval")]
    caption = f"Fits before and after the subtraction (n = {len(rows)})."
    parts.append(folded("Each aircraft", [table(columns, rows, caption=caption)]))
    return Section("claims", title, lead, parts)


def _statistics_section(gap: Entry, maps: xr.Dataset, show: Figures) -> Section:
    parts: list[Markup] = []
    assumptions = gap.get("assumptions") or ()
    held = sum(bool(one["ok"]) for one in assumptions)
    lead = f"{held} of {len(assumptions)} tested assumptions hold." if assumptions else ""
    if assumptions:
        rows = [
            Row(
                [one["assumption"], one["check"], one["result"], "yes" if one["ok"] else "no"],
                doubt=not one["ok"],
            )
            for one in assumptions
        ]
        columns = [Column(name, "long") for name in ("assumption", "test", "result")]
        caption = (
            "Assumptions with their tests on these reports. One that does not hold (grey italics) "
            "makes intervals less certain; the effects stated rest on held-out flights."
        )
        inner = table([*columns, Column("holds")], rows, caption=caption)
        parts.append(folded("Assumptions", [inner]))
    evidence = _shown(["evidence", "probability"], gap, maps, show)
    if evidence:
        parts.append(folded("Evidence for each effect", evidence))
    calibration = _calibration(gap, show.units) + _shown(["pit"], gap, maps, show)
    if calibration:
        parts.append(folded("Calibration on held-out flights", calibration))
    noise = _noise(gap, show.units) + _shown(["autocorrelation"], gap, maps, show)
    if noise:
        parts.append(folded("Noise model", noise))
    return Section("statistics", "Statistics", lead, parts)


def _calibration(gap: Entry, units: Units) -> list[Markup]:
    pair, factor = gap.get("calibration"), shown_per_m_s(units)
    parts: list[Markup] = []
    if pair:
        rows = []
        for key, label, ideal in _CALIBRATION:
            name, scale = (f"{key}_m_s", factor) if key == "crps" else (key, 1.0)
            values: list[Any] = [
                scale * number(pair[when].get(name)) for when in ("before", "after")
            ]
            if key == "crps":
                label = f"{label} ({units})"
                ideal = number_text(scale * number(pair["after"].get("crps_expected_m_s")))
            rows.append(Row([label, *(number_text(value) for value in values), ideal]))
        columns = [Column("", "words"), Column("without the effects")]
        columns += [Column("with the effects"), Column("if right")]
        parts.append(table(columns, rows))
    if placebo := gap.get("decoy"):
        scale = shown_per_kt(units)
        reduction = scale * number(placebo["reduction_kt"])
        interval = range_text(placebo.get("reduction_ci_kt"), factor=scale)
        parts.append(
            paragraph(
                f"Placebo: effects with the same columns but random dates and aircraft close "
                f"{reduction:.2f} {units}{interval} ({placebo['draws']} draws)."
            )
        )
    return parts


def _noise(gap: Entry, units: Units) -> list[Markup]:
    noise, factor = gap.get("noise"), shown_per_m_s(units)
    if not noise:
        return []
    rows = [
        Row(
            [f"correlated part ({units})", number_text(factor * number(noise["correlated_sd_m_s"]))]
        ),
        Row([f"white part ({units})", number_text(factor * number(noise["white_sd_m_s"]))]),
        Row(["correlation length (km)", number_text(noise["length_km"], digits=0)]),
        Row(["factor across the heading", number_text(noise.get("across_heading"))]),
        Row(["factor along the heading", number_text(noise.get("along_heading"))]),
    ]
    return [table([Column("noise model", "words"), Column("fitted")], rows)]
