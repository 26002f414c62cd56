"""The page's sections on the field test, the reference and the error profiles.

Assumes ``field_test.json``, ``sensitivity.json`` and ``error_profiles.nc`` of docs/formats.md; keys
they do not have are left out of the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import xarray as xr
from markupsafe import Markup

from airswing.evaluation.results import Content
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    folded,
    heading,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded
from airswing.report.run.evaluation_figures import (
    field_test_figure,
    profile_panels,
    scrutiny_figure,
)
from airswing.report.run.page_numbers import number_text
from airswing.report.run.sensitivity_figures import (
    aircraft_differences_figure,
    pair_differences_figure,
    pair_name,
    verdict_word,
)

SLICES: dict[Literal["by_lead_time", "by_phase", "by_level", "by_season"], str] = {
    "by_lead_time": "lead time",
    "by_phase": "phase of flight",
    "by_level": "level",
    "by_season": "season",
}


def field_test_section(field_test: Content | None) -> Section:
    """Return the field test: the sentence, the figures, the table, the scrutiny."""
    if not field_test or not field_test.get("groups"):
        return Section("field-test", "Field test")
    parts = [embedded(field_test_figure(field_test)), _groups_table(field_test)]
    if field_test.get("by_aircraft") or field_test.get("permutation"):
        parts.append(embedded(scrutiny_figure(field_test)))
    parts += _scrutiny_words(field_test)
    return Section("field-test", "Field test", _field_test_sentence(field_test), parts)


def _bounds(bounds: Sequence[float] | None) -> str:
    return f" ({number_text(bounds[0])} to {number_text(bounds[1])})" if bounds else ""


def _field_test_sentence(field_test: Content) -> str:
    linear = float(field_test["adjusted_reduction_kt"])
    text = (
        f"The corrected aircraft gained {linear:.2f} kt"
        f"{_bounds(field_test.get('adjusted_reduction_ci_kt'))} beyond the controls by the linear "
        "difference"
    )
    square = field_test.get("adjusted_reduction_quadrature_kt")
    if square is not None:
        text += (
            f", {float(square):.2f} kt"
            f"{_bounds(field_test.get('adjusted_reduction_quadrature_ci_kt'))} adding errors in "
            "quadrature"
        )
    reference = field_test.get("reference")
    return text + (f", against {reference}." if reference else ".")


def _groups_table(field_test: Content) -> Markup:
    rows = [
        Row(
            [
                name,
                entry["aircraft"],
                number_text(entry["before_kt"]),
                number_text(entry["during_kt"]),
                number_text(entry["reduction_kt"]) + _bounds(entry.get("reduction_ci_kt")),
                f"{int(entry.get('reports_before', 0)):,}",
                f"{int(entry.get('reports_during', 0)):,}",
            ]
        )
        for name, entry in field_test["groups"].items()
    ]
    columns = [
        Column("group", "words"),
        Column("aircraft"),
        Column("before (kt)"),
        Column("during (kt)"),
        Column("reduction (kt)"),
        Column("reports before"),
        Column("reports during"),
    ]
    return table(columns, rows, caption="Mean vector disagreement; in brackets 95 % intervals.")


def _scrutiny_words(field_test: Content) -> list[Markup]:
    lines = []
    chosen = field_test.get("regression_to_the_mean")
    if chosen and (luck := chosen["spurious_reduction_kt"]) is not None:
        lines.append(
            "Regression to the mean: choosing the same number of worst aircraft in an earlier "
            f"window alone would have given {float(luck):+.2f} kt."
        )
    nearest = field_test.get("matched_controls")
    if nearest and (matched := nearest["adjusted_reduction_kt"]) is not None:
        lines.append(
            f"Against the control nearest before the test, each corrected aircraft gained "
            f"{float(matched):+.2f} kt on average."
        )
    predicted = field_test.get("predicted_reduction_kt")
    if predicted is not None:
        lines.append(
            f"Predicted from the fits before the test: {float(predicted):.2f} kt"
            f"{_bounds(field_test.get('predicted_reduction_ci_kt'))}."
        )
    lines += [str(note) for note in field_test.get("notes", [])]
    return [listing(lines)] if lines else []


def sensitivity_section(sensitivity: Content | None) -> Section:
    """Return the dependence on the reference: verdicts, figures, slices, error estimates."""
    title = "Does the reference matter?"
    pairs = sensitivity.get("pairs") if sensitivity else None
    if not sensitivity or not pairs:
        return Section("sensitivity", title)
    parts = [embedded(pair_differences_figure(pairs)), _verdict_table(pairs, "Every pair.")]
    for pair in pairs:
        # A pool against its member is the members' own difference again, drawn smaller.
        if pair.get("aircraft") and _own_test(pair):
            shown = embedded(aircraft_differences_figure(pair))
            parts.append(folded(f"Each aircraft, {pair_name(pair)}", [shown]))
    for key, words in SLICES.items():
        if sensitivity.get(key):
            rows = _verdict_table(sensitivity[key], f"The same by {words}.")
            parts.append(folded(f"By {words}", [rows]))
    parts += _three_way(sensitivity.get("three_way") or [])
    apart = [pair for pair in pairs if pair.get("poolable") is False]
    lead = (
        "No two references differ both beyond error and by a size that matters: they may be pooled."
        if all(pair.get("poolable") for pair in pairs)
        else _apart_sentence(apart) or "Some pairs cannot be judged on these reports."
    )
    return Section("sensitivity", title, lead.replace(" +- ", " ± "), parts)


def _apart_sentence(apart: Sequence[Content]) -> str:
    named = [f"{pair_name(pair)} ({pair.get('why', '')})" for pair in apart[:2]]
    more = f", and {len(apart) - 2} more pairs" if len(apart) > 2 else ""
    return f"Not poolable: {'; '.join(named)}{more}." if named else ""


def _verdict_table(pairs: Sequence[Content], caption: str) -> Markup:
    sliced = any(pair.get("slice") for pair in pairs)
    columns = [Column("slice", "words")] if sliced else []
    columns += [
        Column("pair", "words"),
        Column("verdict", "words"),
        Column("why", "long"),
        Column("curves differ (degree rms)"),
        Column("p value"),
        Column("winds differ (m/s)"),
        Column("reports"),
    ]
    rows = []
    for pair in pairs:
        fleet = pair["fleet"]
        rows.append(
            Row(
                [
                    *([pair.get("slice", "")] if sliced else []),
                    pair_name(pair),
                    verdict_word(pair),
                    _why(pair),
                    number_text(fleet.get("curve_rms_deg", float("nan"))),
                    _p_value(fleet.get("p_value")) if _own_test(pair) else "none of its own",
                    number_text(pair.get("mean_vector_difference_m_s", float("nan"))),
                    f"{int(pair.get('reports', 0)):,}",
                ],
                doubt=pair.get("poolable") is None,
            )
        )
    return table(columns, rows, caption=caption)


def _own_test(pair: Content) -> bool:
    return bool(pair.get("own_test", True))


def _why(pair: Content) -> str:
    """Why a pair may be pooled or not; a pool and its member say nothing new of that."""
    if not _own_test(pair) and pair.get("poolable"):
        return "the pool is made of its members: their difference is part of the members' own"
    return str(pair.get("why", "")).replace(" +- ", " ± ")


def _p_value(value: float | None) -> str:
    return f"{float(value):.2g}" if value is not None and float(value) == float(value) else "-"


def _three_way(found: Sequence[Content]) -> list[Markup]:
    rows = [
        Row(
            [
                ", ".join(entry["references"]),
                corner["reference"],
                "negative variance"
                if (rms := corner.get("component_rms")) is None
                else number_text(rms),
                f"{int(entry['reports']):,}",
            ]
        )
        for entry in found
        for corner in entry.get("errors", [])
    ]
    if not rows:
        return []
    columns = [
        Column("three references", "words"),
        Column("reference", "words"),
        Column("own error of a component (m/s rms)"),
        Column("reports"),
    ]
    note = (
        "Three-cornered hat: assumes the three references' errors are independent; references "
        "that use the same reports come out too good."
    )
    return [heading("Each reference's own error"), table(columns, rows, caption=note)]


def profiles_section(profiles: xr.Dataset | None, reference: str) -> Section:
    """Return the error profiles by level and phase of flight."""
    if profiles is None:
        return Section("profiles", "Error by level and phase")
    known = [str(name) for name in profiles["reference"].to_numpy()]
    first = reference if reference in known else known[0]
    parts = [profile_panels(profiles, first)]
    parts += [
        folded(f"Against {name}", [profile_panels(profiles, name)])
        for name in known
        if name != first
    ]
    parts.append(paragraph("The differences hold the reference's own error too."))
    return Section("profiles", "Error by level and phase", "", parts)
