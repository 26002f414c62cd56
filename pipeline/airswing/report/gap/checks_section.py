"""The checks of a gap diagnosis on its page: assumptions, calibration, aliases, own claims.

Assumes the keys ``assumptions``, ``calibration``, ``aliases`` and ``claims`` of ``gap.json`` in the
shapes of :mod:`airswing.gap.checks.assumptions` and :mod:`airswing.gap.checks.refit_claims`, every
one optional.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from airswing.report.gap.words import joined, plain_name
from airswing.report.html.document import Column, Row, Section, folded, paragraph, table

BY_DESIGN: tuple[tuple[str, str, str], ...] = (
    (
        "the reference's own climatology is not an aircraft's fault",
        "it is fitted beside every effect",
        "by design",
    ),
    (
        "the catalogue holds the effect",
        "a dictionary without physics competes with it; where that wins, the verdict is unknown",
        "by design",
    ),
)
CALIBRATION: tuple[tuple[str, str, str], ...] = (
    ("spread", "spread over that predicted", "1"),
    ("crps_m_s", "CRPS (m/s)", ""),
    ("lag_one", "correlation of neighbours on a flight", "0"),
    ("auc", "classifier's area under the curve", "0.5"),
)
Checked = Sequence[tuple[str, str]]


def assumption_table(gap: Mapping[str, Any], otherwise: Checked) -> list[Markup]:
    """Return the table of assumptions with the result of each check.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``.
    otherwise : sequence of (str, str)
        Assumptions and their checks, where the diagnosis tells no results.

    Returns
    -------
    list of Markup
    """
    told = [entry for entry in gap.get("assumptions") or [] if isinstance(entry, Mapping)]
    columns = [Column("assumption", "long"), Column("checked by", "long")]
    if not told:
        return [table(columns, [Row(list(pair)) for pair in otherwise])]
    rows = [
        Row(
            [entry["assumption"], entry["check"], entry["result"], "yes" if entry["ok"] else "no"],
            doubt=not entry["ok"],
        )
        for entry in told
    ]
    rows += [Row([*line, "-"]) for line in BY_DESIGN]
    held = sum(bool(entry["ok"]) for entry in told)
    return [
        table(
            [*columns, Column("result", "long"), Column("holds")],
            rows,
            caption=f"Each assumption with its check on these reports: {held} of {len(told)} "
            "hold. One that does not (grey italics) widens the doubt about intervals; it does "
            "not by itself overturn a verdict, which must stand on held-out flights.",
        )
    ]


def calibration_table(gap: Mapping[str, Any]) -> list[Markup]:
    """Return how the simulation's stated error fits held-out reports, without and with effects.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``.

    Returns
    -------
    list of Markup
    """
    calibration = gap.get("calibration") or {}
    before, after = calibration.get("before") or {}, calibration.get("after") or {}
    if not before or not after:
        return []
    right = {"crps_m_s": after.get("crps_expected_m_s")}
    rows = [
        Row([label, _told(before.get(key)), _told(after.get(key)), ideal or _told(right.get(key))])
        for key, label, ideal in CALIBRATION
    ]
    columns = [
        Column("held-out reports", "words"),
        Column("without the effects"),
        Column("with the effects"),
        Column("if right"),
    ]
    return [table(columns, rows, caption="Calibration of the simulation on held-out flights.")]


def _told(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, int | float) else "-"


def alias_lines(gap: Mapping[str, Any]) -> list[str]:
    """Return a line for each pair of effects that look alike on this archive.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``.

    Returns
    -------
    list of str
    """
    return [
        f"{plain_name(str(pair['effect']))} and {plain_name(str(pair['other']))}: "
        f"{100 * float(pair['alias_share']):.0f} % of the first's energy in common"
        + (f"; {pair['separated_by']} would tell" if pair.get("separated_by") else "")
        for pair in gap.get("aliases") or []
    ]


def claims_section(gap: Mapping[str, Any]) -> Section:
    """Return the section on what of the product's own claims survives.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``.

    Returns
    -------
    Section
        Without parts where the diagnosis tells nothing of it.
    """
    claims = gap.get("claims")
    parts: list[Markup] = []
    if isinstance(claims, Mapping):
        parts = _claims(claims)
    lead = (
        "The deviations airswing fits (and the field test, where there is one), computed again "
        "with every effect found beside the deviation taken off the winds first."
    )
    return Section("claims", "What of airswing's own claims survives", lead, parts)


def _claims(claims: Mapping[str, Any]) -> list[Markup]:
    names = [plain_name(str(name)) for name in claims.get("taken_off") or []]
    if not names:
        text = "Nothing was found beside the deviation, so the claims stand as they are."
        return [paragraph(text)]
    text = (
        f"Taken off: {joined(names)}. {claims['stay']} of {claims['of']} trusted fits keep both "
        "offset and amplitude within their 95 % interval."
    )
    parts = [paragraph(text)]
    test = claims.get("field_test")
    if isinstance(test, Mapping):
        low, high = test["reduction_ci_kt"]
        parts.append(
            paragraph(
                f"Field test: adjusted reduction {test['reduction_kt']:.2f} kt "
                f"[{low:.2f}, {high:.2f}] becomes {test['reduction_kt_after']:.2f} kt, "
                f"{'within' if test['stays'] else 'outside'} its interval."
            )
        )
    rows = [_fit_row(entry) for entry in claims.get("aircraft") or []]
    columns = [
        Column("aircraft", "words"),
        Column("offset (°)"),
        Column("then"),
        Column("amplitude (°)"),
        Column("then"),
        Column("stays"),
    ]
    caption = f"Fits before and after (n = {len(rows)}); ± is one standard error."
    moved = any(entry["stays"] is False for entry in claims.get("aircraft") or [])
    return [
        *parts,
        folded("Each aircraft", [table(columns, rows, caption=caption)], unfolded=moved),
    ]


def _fit_row(entry: Mapping[str, Any]) -> Row:
    cells = [str(entry["aircraft"])]
    for name in ("offset_deg", "amplitude_deg"):
        value, error, then = (
            entry.get(f"{name}{end}") for end in ("", "_standard_error", "_after")
        )
        spread = f" ± {_told(error)}" if value is not None and error is not None else ""
        cells += [f"{_told(value)}{spread}", _told(then)]
    word = {True: "yes", False: "no", None: "not judged"}[entry["stays"]]
    return Row([*cells, word], doubt=entry["stays"] is not True)
