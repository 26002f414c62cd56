"""The page of a gap diagnosis, and a diagnosis that a notebook displays.

Takes the content of ``gap.json`` and the maps of ``gap.nc`` (docs/formats.md). ± and ranges in
brackets are 95 % intervals throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import ParamSpec

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.gap.diagnose import Diagnosis
from airswing.gap.diagnose import diagnose as _diagnose
from airswing.gap.result.schema import GapReport, SliceEntry
from airswing.report import html
from airswing.report.gap import words
from airswing.report.gap.figures import gap_figures
from airswing.report.gap.words import closure_text, p_text, plain_name
from airswing.report.html import amount, interval_text, joined, number_text
from airswing.units import KNOT, NORMAL_95

P = ParamSpec("P")
_Drawn = Callable[..., list[Markup]]


@html.drawing()
def write_gap_page(directory: Path, *, gap: GapReport, maps: xr.Dataset) -> Path:
    """Write the page of a gap diagnosis, ``index.html``, and its figures, ``figures/*.png``.

    ``maps`` is the content of ``gap.nc``. Returns the page; InputError if it cannot be written.
    """
    show = html.Figures(directory / "figures")
    figures = gap_figures(gap, maps)

    def drawn(*names: str) -> list[Markup]:
        return [show(name, figures[name](), dpi=120) for name in names if name in figures]

    closure = gap.closure
    before, after = closure.before, closure.after
    interval, reduction = (html.range_text(ends) for ends in (closure.ci, closure.reduction_ci))
    days = f"on {'held-out' if closure.held_out else 'the same'} days"
    facts = [(f"{before:.2f} kt", "disagreement of reports and simulation")]
    if gap.effects or gap.unknown.where:
        facts = [
            (words.levels_text(before, after), f"with the effects found{interval}, {days}"),
            (closure_text(closure).split(" (")[0], f"reduction{reduction}"),
        ]
    facts.append((f"{gap.gap.noise_floor_kt:.2f} kt", "noise floor"))
    p_value = p_text(gap.gap.significance).removeprefix("= ")
    return html.write_document(
        directory / "index.html",
        title="airswing: gap between real and simulated reports",
        kicker="Gap between real and simulated reports",
        headline=words.headline(gap),
        facts=[*facts, (p_value, "p value of the gap")],
        sections=[
            _effects_section(gap, drawn),
            html.Section("closure", "How far the gap closes", "", drawn("waterfall")),
            _where_section(gap, drawn),
            _ambiguous_section(gap),
            _claims_section(gap),
            _statistics_section(gap, drawn),
        ],
        footer="Disagreement is the mean length of the difference between reported and simulated "
        "wind, on held-out days. ± and ranges in brackets are 95 % intervals. Map outline: Natural "
        "Earth and US Census Bureau, public domain.",
    )


def _effects_section(gap: GapReport, drawn: _Drawn) -> html.Section:
    effects, places, fleet = gap.effects, gap.unknown.where, gap.counts.aircraft
    rows = [
        {
            "effect": plain_name(effect.name),
            "aircraft": words.who_text(effect, fleet),
            "parameters": words.parameters_text(effect) or "-",
            "period": words.period_text(effect) or "always",
            "proba\u00adbility": f"{effect.probability:.2f}",
            "closes": closure_text(effect.closure),
            "share of the gap": f"{100 * effect.share_of_gap:.0f} %",
        }
        for effect in effects
    ]
    caption = (
        f"Effects found (n = {len(effects)}), the largest share of the gap first. Parameters "
        "with 95 % intervals (±), or the range over aircraft."
    )
    long = ("effect", "aircraft", "parameters")
    no_effect = "No effect of the catalogue is needed to explain these reports."
    parts = [
        words.start_words(gap.known, gap.simulation).strip(),
        html.table(rows, words=["period"], long=long, caption=caption),
        "" if effects or places else no_effect,
    ]
    for k, place in enumerate(places, 1):
        parts.append(html.paragraph(words.place_sentence(place, fleet), note=True))
        if decides := place.settled_by:
            parts.append(f"A measurement that would decide: {decides}.")
        parts += drawn(f"unknown_{k}")
    tail_rows = []
    for effect in effects:
        for tail, entry in (effect.per_tail or {}).items():
            row = {"aircraft": tail, "effect": plain_name(effect.name)}
            tail_rows.append(row | {"parameters": words.parameters_text(entry)})
    single = html.table(tail_rows, words=["aircraft"], long=("effect", "parameters"))
    names = dict.fromkeys(effect.name for effect in effects)
    physics = [text for name in names if (text := words.nature_of(name))]
    parts += words.caution_lines(gap)
    parts.append(html.folded("Parameters of each aircraft", single))
    parts.append(html.folded("Physics of the effects found", html.listing(physics)))
    return html.Section("what", "Effects missing from the simulation", "", parts)


def _where_section(gap: GapReport, drawn: _Drawn) -> html.Section:
    caption = (
        "Cross-validated shares of the slices with a q value below 5 %. Slices overlap, so shares "
        "need not add to 100 %."
    )
    inner = drawn("phase_level", "map", "aircraft_time")
    parts = [
        _slices_table(gap.where, caption) or "No slice has a q value below 5 %.",
        *drawn("aircraft_heading"),
        html.folded("By phase and level, on a map, by week", *inner),
        html.folded(f"All {len(gap.slices)} slices", _slices_table(gap.slices)),
    ]
    lead = "Slices of the archive by their share of the gap, before any effect is assumed."
    return html.Section("where", "Where the gap is", lead, parts)


def _slices_table(slices: Sequence[SliceEntry], caption: str = "") -> Markup:
    rows = sorted(slices, key=lambda entry: -entry.share_of_gap)
    columns = {
        "slice": map(words.slice_words, rows),
        "share of the gap's variance": [
            html.bar(entry.share_of_gap, f"{100 * entry.share_of_gap:.1f} %") for entry in rows
        ],
        "q value": [p_text(entry.q_value).removeprefix("= ") for entry in rows],
    }
    return html.table(columns, words=list(columns)[:2], caption=caption)


def _ambiguous_section(gap: GapReport) -> html.Section:
    lines = []
    for effect in gap.effects:
        if rivals := effect.ambiguity:
            names = joined([plain_name(rival.name) for rival in rivals])
            needed = joined(list(dict.fromkeys(rival.separated_by for rival in rivals)))
            name, who = words.capital(plain_name(effect.name)), joined(effect.tails)
            lines.append(
                f"{name} on {who or 'all aircraft'} could also be {names}. Data that would "
                f"decide: {needed}."
            )
    similar = [
        f"{plain_name(pair.effect)} and {plain_name(pair.other)}: shared variance "
        f"{100 * pair.alias_share:.0f} %; decided by {pair.separated_by}"
        for pair in gap.aliases
    ]
    reasons = gap.untestable
    columns = {"effect": map(plain_name, reasons), "why": reasons.values()}
    parts: list[str] = [
        html.listing(lines),
        html.folded("Effects with shared variance on these flights", html.listing(similar)),
        html.heading("Effects that could not be tested") if reasons else "",
        html.table(columns, long=columns),
    ]
    if not any(parts):
        parts.append("No effect found is ambiguous on these data.")
    return html.Section("ambiguous", "Ambiguous effects", "", parts)


def _claims_section(gap: GapReport) -> html.Section:
    section = partial(html.Section, "claims", "Consequences for the fitted deviations")
    claims = gap.claims
    if not claims:
        return section()
    if not claims.taken_off:
        text = "No effect was found, so the fitted deviations remain unchanged."
        if gap.unknown.where:
            text = (
                "An unexplained error is not subtracted before the fit: the fitted deviations "
                "remain unchanged and may contain part of it."
            )
        elif gap.effects:
            text = "Only compass effects were found, so the fitted deviations remain unchanged."
        return section("", [text])
    names = joined([plain_name(name) for name in claims.taken_off])
    lead = (
        f"After subtraction of {names}, {claims.stay} of {claims.of} fits keep offset and "
        "amplitude within their 95 % intervals."
    )
    text = ""
    if test := claims.field_test:
        shown = partial(amount, unit="kt")
        before = shown(test.reduction_kt, test.reduction_ci_kt)
        within = f"{'within' if test.stays else 'outside'} its interval"
        text = f"Field test: the adjusted reduction of {before} becomes "
        text += f"{shown(test.reduction_kt_after)}, {within}."
    rows = claims.aircraft
    columns = {"aircraft": [entry.aircraft for entry in rows]}
    for name in ("offset", "amplitude"):
        value, error, after = (
            [getattr(entry, f"{name}_deg{ending}") for entry in rows]
            for ending in ("", "_standard_error", "_after")
        )
        columns[f"{name} (°)"] = list(map(interval_text, value, NORMAL_95 * np.array(error)))
        columns[f"{name} afterwards"] = after
    answers = {True: "yes", False: "no", None: "not tested"}
    columns["within the interval"] = [answers[entry.stays] for entry in rows]
    caption = f"Fits before and after the subtraction (n = {len(rows)})."
    doubt = [entry.stays is not True for entry in rows]
    inner = html.table(columns, words=["aircraft"], caption=caption, doubt=doubt)
    return section(lead, [text, html.folded("Each aircraft", inner)])


def _statistics_section(gap: GapReport, drawn: _Drawn) -> html.Section:
    passed = [entry.ok for entry in gap.assumptions]
    lead = f"{sum(passed)} of {len(passed)} tested assumptions hold." if passed else ""
    checked = [
        {
            "assumption": entry.assumption,
            "test": entry.check,
            "result": entry.result,
            "holds": "yes" if entry.ok else "no",
        }
        for entry in gap.assumptions
    ]
    caption = (
        "Assumptions with their tests on these reports. One that does not hold (grey italics) "
        "makes intervals less certain; the effects stated rest on held-out days."
    )
    long, doubt = ("assumption", "test", "result"), [not ok for ok in passed]
    assumptions = html.table(checked, long=long, caption=caption, doubt=doubt)
    rows, placebo = [], ""
    if pair := gap.calibration:
        crps = number_text(pair.after.crps_expected_m_s / KNOT)
        for key, label, scale, right in (
            ("spread", "spread over predicted spread", 1.0, "1"),
            ("crps_m_s", "CRPS (kt)", 1.0 / KNOT, crps),
            ("lag_one", "correlation of neighbours on a flight", 1.0, "0"),
            ("auc", "area under the ROC curve of a classifier", 1.0, "0.5"),
        ):
            before, after = (scale * getattr(state, key) for state in (pair.before, pair.after))
            row = {"": label, "without the effects": before, "with the effects": after}
            rows.append(row | {"if right": right})
    if drawn_at_random := gap.placebo:
        closes = amount(drawn_at_random.reduction_kt, drawn_at_random.reduction_ci_kt, unit="kt")
        placebo = (
            f"Placebo: one cycle of the heading of other flights closes {closes} "
            f"({drawn_at_random.draws} draws)."
        )
    noise = gap.noise
    fitted = {
        "correlated part (kt)": noise.correlated_sd_m_s / KNOT,
        "white part (kt)": noise.white_sd_m_s / KNOT,
        "correlation length (km)": number_text(noise.length_km, digits=0),
        "factor across the heading": noise.across_heading,
        "factor along the heading": noise.along_heading,
    }
    model = html.table({"noise model": fitted, "fitted": fitted.values()}, words=["noise model"])
    calibration = html.table(rows, words=[""]), placebo, *drawn("pit")
    parts = [
        html.folded("Assumptions", assumptions),
        html.folded("Evidence for each effect", _evidence_table(gap)),
        html.folded("Calibration on held-out days", *calibration),
        html.folded("Noise model", model),
    ]
    return html.Section("statistics", "Statistics", lead, parts)


def _evidence_table(gap: GapReport) -> Markup:
    best: dict[str, float] = {}
    for entry in gap.evidence:
        if entry.known and entry.evidence_nats is not None and np.isfinite(entry.evidence_nats):
            best[entry.name] = max(entry.evidence_nats, best.get(entry.name, -np.inf))
    marks = {effect.name: "found" for effect in gap.effects}
    rivals = {name: "ambiguous" for effect in gap.effects for name in effect.ambiguous_with}
    rows = [
        {
            "effect": plain_name(name),
            "log Bayes factor": round(best[name]),
            "": (rivals | marks).get(name, ""),
        }
        for name in sorted(best, key=best.__getitem__, reverse=True)
    ]
    caption = (
        "Log Bayes factor of each effect of the catalogue against no effect. Effects with similar "
        "columns share evidence, so a large factor alone is no finding."
    )
    return html.table(rows, words=["effect", ""], caption=caption)


class ShownDiagnosis(Diagnosis):
    """Result of :func:`airswing.diagnose`, with the figures of the gap's page."""

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of the gap's page by name, newly drawn."""
        with html.drawing():
            return {name: draw() for name, draw in gap_figures(self.report, self.dataset).items()}

    def __repr__(self) -> str:
        return words.verdict(self.report)

    def _repr_html_(self) -> str:
        return str(html.listing(words.verdict(self.report).split("\n")))


def _shown(find: Callable[P, Diagnosis]) -> Callable[P, ShownDiagnosis]:
    @wraps(find)
    def diagnose(*args: P.args, **kwargs: P.kwargs) -> ShownDiagnosis:
        return ShownDiagnosis(**vars(find(*args, **kwargs)))

    return diagnose


diagnose = _shown(_diagnose)
