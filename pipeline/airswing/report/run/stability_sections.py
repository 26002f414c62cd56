"""The page's sections on stability, on whom to correct, and on the virtual field test.

Assumes ``stability.json``, the ranking and ``virtual_field_test.json`` as
:mod:`airswing.evaluation` makes them; what is missing leaves its section out.
"""

from __future__ import annotations

from collections.abc import Sequence

from airswing.evaluation.results import Content
from airswing.report.html.document import Column, Row, Section, paragraph, table
from airswing.report.html.embed import embedded
from airswing.report.run.page_numbers import number_text
from airswing.report.run.stability_figures import (
    prediction_figure,
    ranking_figure,
    stability_figure,
)
from airswing.units import NORMAL_95


def stability_section(stability: Content | None) -> Section:
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


def ranking_section(ranking: Sequence[Content] | None, virtual: Content | None) -> Section:
    """Return whom to correct first, and how far such predictions held."""
    title = "Whom to correct"
    known = [
        (most, entry) for entry in ranking or [] if (most := entry["expected_gain_kt"]) is not None
    ]
    if not known or ranking is None:
        return Section("ranking", title)
    most, first = known[0]
    gain = _with_interval(most, first["expected_gain_ci_kt"])
    lead = (
        f"{first['aircraft']} would gain most: {gain} of its "
        f"{number_text(first['disagreement_kt'])} kt."
    )
    parts = [embedded(ranking_figure(ranking))]
    lines = _prediction_words(virtual) if virtual else []
    if virtual and lines:
        parts.append(embedded(prediction_figure(virtual)))
        parts += [paragraph(line) for line in lines]
    return Section("ranking", title, lead, parts)


def _prediction_words(virtual: Content) -> list[str]:
    lines = []
    later, held_out = virtual.get("later"), virtual.get("held_out")
    if later and "why" not in later:
        text = f"Learned up to {later['learned_until']} and applied after it"
        lines += _prediction_line(text, later)
    if held_out and "why" not in held_out:
        text = f"With whole flights held out of the fit ({held_out['folds']} parts)"
        lines += _prediction_line(text, held_out)
    return lines


def _prediction_line(text: str, part: Content) -> list[str]:
    realised, predicted = part["realised_gain_kt"], part["predicted_gain_kt"]
    if realised is None or predicted is None:
        return []
    found = _with_interval(realised, part["realised_gain_ci_kt"])
    expected = _with_interval(predicted, part["predicted_gain_ci_kt"])
    return [f"{text}, the winds gain {found}; expected were {expected}."]


def _with_interval(value: float, interval: Sequence[float]) -> str:
    """Knots, with the interval where there is one."""
    low, high = (float(end) for end in interval)
    if not low <= high:
        return f"{number_text(value)} kt"
    return f"{number_text(value)} kt ({number_text(low)} to {number_text(high)})"
