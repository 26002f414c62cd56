"""The checks of a gap diagnosis on its page: assumptions, calibration, aliases, own claims.

Assumes a report in the shapes of :mod:`airswing.gap.result.schema`.
"""

from __future__ import annotations

import math

from markupsafe import Markup

from airswing.gap.result.schema import ClaimsEntry, FitEntry, GapReport
from airswing.report.gap.words import joined, plain_name
from airswing.report.html.document import Column, Row, Section, folded, paragraph, table

_BY_DESIGN: tuple[tuple[str, str, str], ...] = (
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
_CALIBRATION: tuple[tuple[str, str, str], ...] = (
    ("spread", "spread over that predicted", "1"),
    ("crps_m_s", "CRPS (m/s)", ""),
    ("lag_one", "correlation of neighbours on a flight", "0"),
    ("auc", "classifier's area under the curve", "0.5"),
)


def assumption_table(gap: GapReport) -> list[Markup]:
    """Return the table of assumptions with the result of each check."""
    rows = [
        Row([one.assumption, one.check, one.result, "yes" if one.ok else "no"], doubt=not one.ok)
        for one in gap.assumptions
    ]
    rows += [Row([*line, "-"]) for line in _BY_DESIGN]
    columns = [Column(name, "long") for name in ("assumption", "checked by", "result")]
    held = sum(one.ok for one in gap.assumptions)
    return [
        table(
            [*columns, Column("holds")],
            rows,
            caption=f"Each assumption with its check on these reports: {held} of "
            f"{len(gap.assumptions)} hold. One that does not (grey italics) widens the doubt about "
            "intervals; it does not by itself overturn a verdict, which must stand on held-out "
            "flights.",
        )
    ]


def calibration_table(gap: GapReport) -> list[Markup]:
    """Return how the simulation's stated error fits held-out reports, without and with effects."""
    if gap.calibration is None:
        return []
    before, after = gap.calibration.before, gap.calibration.after
    right = {"crps_m_s": _told(after.crps_expected_m_s)}
    rows = [
        Row([label, _told(getattr(before, key)), _told(getattr(after, key)), ideal or right[key]])
        for key, label, ideal in _CALIBRATION
    ]
    columns = [
        Column("held-out reports", "words"),
        Column("without the effects"),
        Column("with the effects"),
        Column("if right"),
    ]
    return [table(columns, rows, caption="Calibration of the simulation on held-out flights.")]


def _told(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def alias_lines(gap: GapReport) -> list[str]:
    """Return a line for each pair of effects that look alike on this archive."""
    return [
        f"{plain_name(pair.effect)} and {plain_name(pair.other)}: {100 * pair.alias_share:.0f} % "
        f"of the first's energy in common; {pair.separated_by} would tell"
        for pair in gap.aliases
    ]


def claims_section(gap: GapReport) -> Section:
    """Return the section on what of the product's own claims survives.

    Returns
    -------
    Section
        Without parts where the diagnosis tells nothing of it.
    """
    lead = (
        "The deviations airswing fits (and the field test, where there is one), computed again "
        "with every effect found beside the deviation taken off the winds first."
    )
    parts = [] if gap.claims is None else _claims(gap.claims)
    return Section("claims", "What of airswing's own claims survives", lead, parts)


def _claims(claims: ClaimsEntry) -> list[Markup]:
    names = [plain_name(name) for name in claims.taken_off]
    if not names:
        text = "Nothing was found beside the deviation, so the claims stand as they are."
        return [paragraph(text)]
    text = (
        f"Taken off: {joined(names)}. {claims.stay} of {claims.of} trusted fits keep both "
        "offset and amplitude within their 95 % interval."
    )
    parts = [paragraph(text)]
    test = claims.field_test
    if test is not None:
        low, high = test.reduction_ci_kt
        parts.append(
            paragraph(
                f"Field test: adjusted reduction {test.reduction_kt:.2f} kt "
                f"[{low:.2f}, {high:.2f}] becomes {test.reduction_kt_after:.2f} kt, "
                f"{'within' if test.stays else 'outside'} its interval."
            )
        )
    rows = [_fit_row(entry) for entry in claims.aircraft]
    columns = [
        Column("aircraft", "words"),
        Column("offset (°)"),
        Column("then"),
        Column("amplitude (°)"),
        Column("then"),
        Column("stays"),
    ]
    caption = f"Fits before and after (n = {len(rows)}); ± is one standard error."
    moved = any(entry.stays is False for entry in claims.aircraft)
    return [
        *parts,
        folded("Each aircraft", [table(columns, rows, caption=caption)], unfolded=moved),
    ]


def _fit_row(entry: FitEntry) -> Row:
    cells = [entry.aircraft]
    for value, error, then in (
        (entry.offset_deg, entry.offset_deg_standard_error, entry.offset_deg_after),
        (entry.amplitude_deg, entry.amplitude_deg_standard_error, entry.amplitude_deg_after),
    ):
        known = math.isfinite(value) and math.isfinite(error)
        spread = f" ± {_told(error)}" if known else ""
        cells += [f"{_told(value)}{spread}", _told(then)]
    word = {True: "yes", False: "no", None: "not judged"}[entry.stays]
    return Row([*cells, word], doubt=entry.stays is not True)
