"""The page's sections on stability, on whom to correct, and on the virtual field test.

Assumes ``stability.json``, the ranking and ``virtual_field_test.json`` as
:mod:`airswing.evaluation` makes them; what is missing leaves its section out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from airswing.report.html.document import Column, Row, Section, paragraph, table
from airswing.report.html.embed import embedded
from airswing.report.run.page_numbers import number_text
from airswing.report.run.stability_figures import (
    prediction_figure,
    ranking_figure,
    stability_figure,
)
from airswing.units import NORMAL_95


def stability_section(stability: Mapping[str, Any] | None) -> Section:
    """Return whether the compasses stayed as they were: the sentence, the figure, the dates."""
    title = "Stability"
    if not stability:
        return Section("stability", title)
    entries = stability["changes"]
    judged = [entry for entry in entries if entry["p_value"] is not None]
    changed = [entry for entry in judged if entry["changes"]]
    lead = f"None of {len(judged)} compasses shows a change within the period."
    if changed:
        lead = (
            f"{len(changed)} of {len(judged)} compasses changed within the period: their fits "
            "straddle the change and describe neither side of it."
        )
    elif not judged:
        lead = "The period is too short to tell whether a compass changed."
    parts = [embedded(stability_figure(stability))]
    if changed:
        rows = [
            Row(
                [
                    entry["aircraft"],
                    change["date"],
                    f"{change['date_ci'][0]} to {change['date_ci'][1]}",
                    *(
                        f"{change['change_deg'][name]:+.2f} ± "
                        f"{NORMAL_95 * change['standard_error_deg'][name]:.2f}"
                        for name in "ABC"
                    ),
                    number_text(change["p_value"], digits=3),
                ]
            )
            for entry in changed
            for change in entry["changes"]
        ]
        columns = [
            Column("aircraft", "words"),
            Column("new compass from", "words"),
            Column("95 % interval", "words"),
            *(Column(f"change of {name} (degree)") for name in "ABC"),
            Column("p"),
        ]
        parts.append(table(columns, rows, caption="Changes found, with 95 % intervals."))
    return Section("stability", title, lead, parts)


def ranking_section(
    ranking: Sequence[Mapping[str, Any]] | None, virtual: Mapping[str, object] | None
) -> Section:
    """Return whom to correct first, and how far such predictions held."""
    title = "Whom to correct"
    known = [entry for entry in ranking or [] if entry["expected_gain_kt"] is not None]
    if not known or ranking is None:
        return Section("ranking", title)
    first = known[0]
    gain = _with_interval(first["expected_gain_kt"], first["expected_gain_ci_kt"])
    lead = (
        f"{first['aircraft']} would gain most: {gain} of its "
        f"{number_text(first['disagreement_kt'])} kt."
    )
    parts = [embedded(ranking_figure(ranking))]
    lines = _prediction_words(virtual or {})
    if lines:
        parts.append(embedded(prediction_figure(virtual or {})))
        parts += [paragraph(line) for line in lines]
    return Section("ranking", title, lead, parts)


def _prediction_words(virtual: Mapping[str, Any]) -> list[str]:
    words = {
        "later": "Learned up to {learned_until} and applied after it",
        "held_out": "With whole flights held out of the fit ({folds} parts)",
    }
    lines = []
    for key, text in words.items():
        part = virtual.get(key) or {}
        if part.get("realised_gain_kt") is None:
            continue
        found = _with_interval(part["realised_gain_kt"], part["realised_gain_ci_kt"])
        expected = _with_interval(part["predicted_gain_kt"], part["predicted_gain_ci_kt"])
        lines.append(
            f"{text.format_map(dict(part))}, the winds gain {found}; expected were {expected}."
        )
    return lines


def _with_interval(value: float, interval: Sequence[float]) -> str:
    """Knots, with the interval where there is one."""
    low, high = (float(end) for end in interval)
    if not low <= high:
        return f"{number_text(value)} kt"
    return f"{number_text(value)} kt ({number_text(low)} to {number_text(high)})"
