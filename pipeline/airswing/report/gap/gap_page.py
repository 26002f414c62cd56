"""The page of a gap diagnosis, and a diagnosis that a notebook displays.

Takes the content of ``gap.json`` (docs/formats.md) and the maps of ``gap.nc``. Whatever a file of
another version lacks is omitted. ± and ranges in brackets are 95 % intervals throughout.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from functools import partial, wraps
from pathlib import Path
from typing import ParamSpec

import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.gap.diagnose import Diagnosis
from airswing.gap.diagnose import diagnose as _diagnose
from airswing.gap.result.schema import GapReport
from airswing.products.whole_files import write_text
from airswing.report.gap import figures as draw
from airswing.report.gap import words
from airswing.report.gap.words import (
    Entry,
    closure_text,
    joined,
    number,
    p_text,
    parameters_text,
    plain_name,
    who_text,
)
from airswing.report.html.document import (
    Column,
    Figures,
    Section,
    described,
    document,
    folded,
    heading,
    listing,
    paragraph,
    table,
)
from airswing.report.html.style import drawing
from airswing.report.html.text import (
    Units,
    amount,
    interval_text,
    number_text,
    range_text,
    shown_per_kt,
    shown_per_m_s,
)
from airswing.units import NORMAL_95
from airswing.version import __version__

P = ParamSpec("P")
_Drawn = Callable[..., list[Markup]]


@drawing()
def write_gap_page(
    directory: Path, *, gap: GapReport | Entry, maps: xr.Dataset, units: Units = "kt"
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
    content = words.content_of(gap)
    show, figures = Figures(directory / "figures", units), gap_figures(content, maps, units=units)

    def drawn(*names: str) -> list[Markup]:
        return [show(name, figures[name](), dpi=120) for name in names if name in figures]

    text = document(
        title="airswing: the sim-to-real gap",
        kicker="Gap between real and simulated reports",
        headline=words.headline(content, units=units),
        facts=_facts(content, units),
        sections=[
            _what_section(content, drawn, units),
            _closure_section(content, drawn, units),
            _where_section(content, drawn),
            _ambiguous_section(content),
            _claims_section(content, units),
            _statistics_section(content, drawn, units),
        ],
        footer=f"airswing {__version__}. Disagreement is the mean length of the difference between "
        "reported and simulated wind, on held-out flights. ± and ranges in brackets are 95 % "
        "intervals. Map outline: Natural Earth and US Census Bureau, public domain.",
    )
    return write_text(directory / "index.html", text)


def gap_figures(
    gap: GapReport | Entry, maps: xr.Dataset, *, units: Units = "kt"
) -> dict[str, Callable[[], Figure]]:
    """Return functions that draw the figures of a diagnosis that have data, by name."""
    content = words.content_of(gap)
    found: dict[str, Callable[[], Figure]] = {}
    compass = {"compass_offset", "hard_iron", "soft_iron"}
    if "heading_map" in maps and compass & {effect["name"] for effect in content["effects"]}:
        found["compass_effects"] = partial(draw.compass_effects_figure, maps, content)
    for place, entry in enumerate(content["unknown"]["where"], 1):
        found[f"unknown_{place}"] = partial(draw.unknown_curve_figure, entry, units)
    if content["effects"] or content["unknown"]["where"]:
        found["waterfall"] = partial(draw.waterfall_figure, content, units)
    found["slices"] = partial(draw.slices_figure, content.get("where") or ())
    if "heading_map" in maps:
        found["aircraft_heading"] = partial(draw.aircraft_heading_figure, maps, content)
    if "level_map_cross" in maps:
        found["phase_level"] = partial(draw.phase_level_figure, maps, content, units)
    if "region_map_u" in maps:
        found["map"] = partial(draw.gap_map_figure, maps, content, units)
    if "time_line" in maps:
        found["aircraft_time"] = partial(draw.aircraft_time_figure, maps, content)
    if "pit_count" in maps:
        found["pit"] = partial(draw.pit_figure, maps)
    if content.get("evidence"):
        found["evidence"] = partial(draw.evidence_figure, content)
        tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
        found["probability"] = partial(draw.probability_figure, content, tails)
    if (content.get("noise") or {}).get("distance_km"):
        found["autocorrelation"] = partial(draw.autocorrelation_figure, content)
    return found


def _facts(gap: Entry, units: Units) -> list[tuple[str, str]]:
    closure, factor = gap["closure"], shown_per_kt(units)
    before, after = number(closure["before"]), number(closure["after"])
    facts = [(f"{factor * before:.2f} {units}", "disagreement of reports and simulation")]
    if gap["effects"] or gap["unknown"]["where"]:
        interval, reduction = (
            range_text(closure.get(name), factor=factor) for name in ("ci", "reduction_ci")
        )
        facts = [
            (words.levels_text(before, after, units=units), f"with the effects found{interval}"),
            (closure_text(closure, units=units).split(" (")[0], f"reduction{reduction}"),
        ]
    floor = number(gap["gap"].get("noise_floor_kt"))
    if math.isfinite(floor):
        facts.append((f"{factor * floor:.2f} {units}", "noise floor"))
    p_value = p_text(gap["gap"].get("significance")).removeprefix("= ")
    return [*facts, (p_value, "p value of the gap")]


def _effect_columns(gap: Entry, units: Units) -> list[Column]:
    effects, fleet = gap["effects"], words.fleet_of(gap)
    rivals = [joined([plain_name(name) for name in one["ambiguous_with"]]) for one in effects]
    shares = [f"{100 * number(one.get('share_of_gap')):.0f} %" for one in effects]
    closes = [closure_text(one.get("closure"), units=units) for one in effects]
    sizes = [parameters_text(one, units=units) or "-" for one in effects]
    return [
        Column("effect", [plain_name(one["name"]) for one in effects], "long"),
        Column("aircraft", [who_text(one, fleet) for one in effects], "long"),
        Column("parameters", sizes, "long"),
        Column("period", [words.period_text(one) or "always" for one in effects], "words"),
        Column("proba\u00adbility", [f"{number(one['probability']):.2f}" for one in effects]),
        Column("closes", closes),
        Column("share of the gap", shares),
        Column("ambiguous with", [text or "-" for text in rivals], "long"),
    ]


def _what_section(gap: Entry, drawn: _Drawn, units: Units) -> Section:
    effects, places = gap["effects"], gap["unknown"]["where"]
    parts: list[Markup] = []
    if start := words.start_words(gap.get("known"), gap.get("simulation")).strip():
        parts.append(paragraph(start))
    if effects:
        caption = (
            f"Effects found (n = {len(effects)}), the largest share of the gap first. Parameters "
            "with 95 % intervals (±), or the range over aircraft."
        )
        parts.append(table(_effect_columns(gap, units), caption=caption))
    elif not places:
        parts.append(paragraph("No effect of the catalogue is needed to explain these reports."))
    parts += drawn("compass_effects")
    for k, place in enumerate(places, 1):
        parts.append(paragraph(words.place_sentence(place, gap, units=units), note=True))
        if place.get("settled_by"):
            parts.append(paragraph(f"A measurement that would decide: {place['settled_by']}."))
        parts += drawn(f"unknown_{k}")
    parts += [paragraph(line) for line in words.caution_lines(gap, units=units)]
    each = [
        (tail, plain_name(effect["name"]), parameters_text(entry, units=units))
        for effect in effects
        for tail, entry in (effect.get("per_tail") or {}).items()
    ]
    if each:
        kinds = {"aircraft": "words", "effect": "long", "parameters": "long"}
        cells = zip(kinds.items(), zip(*each, strict=True), strict=True)
        inner = table([Column(title, column, kind) for (title, kind), column in cells])
        parts.append(folded("Parameters of each aircraft", [inner]))
    known = dict.fromkeys(effect["name"] for effect in effects)
    physics = [described(*nature) for name in known if (nature := words.nature_of(name))]
    if physics:
        parts.append(folded("Physics of the effects found", [listing(physics)]))
    return Section("what", "What is missing from the simulation", "", parts)


def _closure_section(gap: Entry, drawn: _Drawn, units: Units) -> Section:
    closure, factor = gap["closure"], shown_per_kt(units)
    interval = range_text(closure.get("ci"), factor=factor) or " (no interval from one day)"
    before, after = (
        amount(closure[when], factor=factor, unit=units) for when in ("before", "after")
    )
    text = (
        f"On {'held-out' if closure.get('held_out') else 'the same'} flights the disagreement is "
        f"{before} without and {after}{interval} with all effects stated."
    )
    return Section("closure", "How far the gap closes", "", [*drawn("waterfall"), paragraph(text)])


def _where_section(gap: Entry, drawn: _Drawn) -> Section:
    parts = drawn("slices", "aircraft_heading")
    if inner := drawn("phase_level", "map", "aircraft_time"):
        parts.append(folded("By phase and level, on a map, by week", inner))
    rows = sorted(gap.get("slices") or (), key=lambda entry: -entry["share_of_gap"])
    if rows:
        q_values = [p_text(entry.get("q_value")).removeprefix("= ") for entry in rows]
        columns = [
            Column("slice", map(words.slice_words, rows), "long"),
            Column("share of the gap", [f"{100 * one['share_of_gap']:.1f} %" for one in rows]),
            Column("q value", q_values),
        ]
        parts.append(folded(f"All {len(rows)} slices", [table(columns)]))
    lead = "Slices of the archive by their share of the gap, before any effect is assumed."
    return Section("where", "Where the gap is", lead, parts)


def _ambiguous_section(gap: Entry) -> Section:
    parts: list[Markup] = []
    lines = []
    for effect in gap["effects"]:
        if rivals := effect.get("ambiguity") or ():
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
    if reasons := gap.get("untestable"):
        columns = [Column("effect", map(plain_name, reasons), "long")]
        columns.append(Column("why", reasons.values(), "long"))
        parts += [heading("Effects that could not be tested"), table(columns)]
    if not parts:
        parts.append(paragraph("No effect found is ambiguous on these data."))
    return Section("ambiguous", "Ambiguous effects", "", parts)


def _claims_section(gap: Entry, units: Units) -> Section:
    title = "Consequences for the fitted deviations"
    claims = gap.get("claims")
    if not claims:
        return Section("claims", title)
    if not claims.get("taken_off"):
        text = "No effect was found, so the fitted deviations remain as they are."
        if gap["unknown"]["where"]:
            text = (
                "An unexplained error is not subtracted before the fit: the fitted deviations "
                "remain as they are and may contain part of it."
            )
        elif gap["effects"]:
            text = "Only compass effects were found, so the fitted deviations remain as they are."
        return Section("claims", title, "", [paragraph(text)])
    names = joined([plain_name(name) for name in claims["taken_off"]])
    lead = (
        f"After subtraction of {names}, {claims['stay']} of {claims['of']} fits keep offset and "
        "amplitude within their 95 % intervals."
    )
    parts: list[Markup] = []
    if test := claims.get("field_test"):
        factor = shown_per_kt(units)
        ends = test.get("reduction_ci_kt")
        before = amount(test["reduction_kt"], ends, factor=factor, unit=units)
        after = amount(test["reduction_kt_after"], factor=factor, unit=units)
        within = f"{'within' if test['stays'] else 'outside'} its interval"
        text = f"Field test: the adjusted reduction of {before} becomes {after}, {within}."
        parts.append(paragraph(text))
    rows = claims.get("aircraft") or ()
    columns = [Column("aircraft", [entry["aircraft"] for entry in rows], "words")]
    for name in ("offset", "amplitude"):
        key = f"{name}_deg"
        errors = [NORMAL_95 * number(entry[f"{key}_standard_error"]) for entry in rows]
        sizes = zip([number(entry[key]) for entry in rows], errors, strict=True)
        columns.append(Column(f"{name} (°)", [interval_text(*one) for one in sizes]))
        columns.append(Column("afterwards", [number_text(one[f"{key}_after"]) for one in rows]))
    answers = {True: "yes", False: "no", None: "not tested"}
    columns.append(Column("within the interval", [answers[entry["stays"]] for entry in rows]))
    caption = f"Fits before and after the subtraction (n = {len(rows)})."
    inner = table(columns, caption=caption, doubt=[entry["stays"] is not True for entry in rows])
    parts.append(folded("Each aircraft", [inner]))
    return Section("claims", title, lead, parts)


def _statistics_section(gap: Entry, drawn: _Drawn, units: Units) -> Section:
    parts: list[Markup] = []
    tested = gap.get("assumptions") or ()
    lead = ""
    if tested:
        held = [bool(one["ok"]) for one in tested]
        lead = f"{sum(held)} of {len(tested)} tested assumptions hold."
        columns = [
            Column("assumption", [one["assumption"] for one in tested], "long"),
            Column("test", [one["check"] for one in tested], "long"),
            Column("result", [one["result"] for one in tested], "long"),
            Column("holds", ["yes" if ok else "no" for ok in held]),
        ]
        caption = (
            "Assumptions with their tests on these reports. One that does not hold (grey italics) "
            "makes intervals less certain; the effects stated rest on held-out flights."
        )
        inner = table(columns, caption=caption, doubt=[not ok for ok in held])
        parts.append(folded("Assumptions", [inner]))
    calibration = _calibration(gap, units) + drawn("pit")
    noise = _noise(gap, units) + drawn("autocorrelation")
    for title, inner_parts in (
        ("Evidence for each effect", drawn("evidence", "probability")),
        ("Calibration on held-out flights", calibration),
        ("Noise model", noise),
    ):
        if inner_parts:
            parts.append(folded(title, inner_parts))
    return Section("statistics", "Statistics", lead, parts)


def _calibration(gap: Entry, units: Units) -> list[Markup]:
    parts: list[Markup] = []
    if pair := gap.get("calibration"):
        factor = shown_per_m_s(units)
        labels = {
            "spread": "spread over predicted spread",
            "crps_m_s": f"CRPS ({units})",
            "lag_one": "correlation of neighbours on a flight",
            "auc": "area under the ROC curve of a classifier",
        }
        scale = {"crps_m_s": factor}
        without, with_effects = (
            [number_text(pair[when].get(key), factor=scale.get(key, 1.0)) for key in labels]
            for when in ("before", "after")
        )
        crps = number_text(pair["after"].get("crps_expected_m_s"), factor=factor)
        columns = [
            Column("", labels.values(), "words"),
            Column("without the effects", without),
            Column("with the effects", with_effects),
            Column("if right", ["1", crps, "0", "0.5"]),
        ]
        parts.append(table(columns))
    if placebo := gap.get("decoy"):
        ends, factor = placebo.get("reduction_ci_kt"), shown_per_kt(units)
        closes = amount(placebo["reduction_kt"], ends, factor=factor, unit=units)
        text = (
            f"Placebo: effects with the same columns but random dates and aircraft close {closes} "
            f"({placebo['draws']} draws)."
        )
        parts.append(paragraph(text))
    return parts


def _noise(gap: Entry, units: Units) -> list[Markup]:
    noise, factor = gap.get("noise"), shown_per_m_s(units)
    if not noise:
        return []
    fitted = {
        f"correlated part ({units})": number_text(noise["correlated_sd_m_s"], factor=factor),
        f"white part ({units})": number_text(noise["white_sd_m_s"], factor=factor),
        "correlation length (km)": number_text(noise["length_km"], digits=0),
        "factor across the heading": number_text(noise.get("across_heading")),
        "factor along the heading": number_text(noise.get("along_heading")),
    }
    return [table([Column("noise model", fitted, "words"), Column("fitted", fitted.values())])]


class ShownDiagnosis(Diagnosis):
    """Result of :func:`airswing.diagnose`, with the figures of the gap's page."""

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of the gap's page by name, newly drawn."""
        with drawing():
            return {name: draw() for name, draw in gap_figures(self.report, self.dataset).items()}

    def _repr_html_(self) -> str:
        gap = words.content_of(self.report)
        found = [*gap["effects"], *gap["unknown"]["where"]]
        names = [plain_name(effect["name"]) for effect in gap["effects"]]
        for place in gap["unknown"]["where"]:
            variables = " and ".join(place["variables"]).replace("_", " ")
            names.append(f"unexplained, by {variables}")
        columns = [
            Column("effect", names),
            Column("aircraft", [who_text(one, words.fleet_of(gap)) for one in found]),
            Column("probability", [number_text(one["probability"]) for one in found]),
            Column("closes", [closure_text(one.get("closure")) for one in found]),
        ]
        text = paragraph(words.headline(gap))
        return str(text + table(columns) if found else text)


def _shown(find: Callable[P, Diagnosis]) -> Callable[P, ShownDiagnosis]:
    @wraps(find)
    def diagnose(*args: P.args, **kwargs: P.kwargs) -> ShownDiagnosis:
        found = find(*args, **kwargs)
        return ShownDiagnosis(*(getattr(found, one.name) for one in fields(found)))

    return diagnose


diagnose = _shown(_diagnose)
