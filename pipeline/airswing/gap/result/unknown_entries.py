"""What unknowns close, put into gap.json beside what has a name.

Assumptions: unknowns with a table were taken off before the names were searched for a last time, so
the names' closure is measured without them; unknowns of the dictionary come after the names. All
steps are on weeks left out.

Units: kt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from airswing.gap.as_sent.mended import Mended
from airswing.gap.closure.not_seen import hidden_interval
from airswing.gap.evidence.gaussian import luck
from airswing.gap.held_out.reduction import Closure
from airswing.gap.result.schema import (
    ClosesEntry,
    GapReport,
    PlaceEntry,
    StepEntry,
    UnknownClosureEntry,
    UnknownEntry,
)
from airswing.gap.result.single_entries import mended_effect, mended_place
from airswing.gap.result.table_entries import entry, interval
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem
from airswing.gap.taken_off.remainders import OWN_REMAINDER
from airswing.gap.taken_off.unknown_taken import Taken
from airswing.units import KNOT

#: Components of the nonparametric basis.
BASIS = ("cross", "along", "wind")


def with_unknowns(
    report: GapReport,
    taken: Sequence[Taken],
    *,
    problem: Problem,
    found: Found,
    whole: Closure,
    mended: Sequence[Mended] = (),
) -> GapReport:
    """Add unknowns, their closure and their steps of the waterfall.

    Parameters
    ----------
    report : GapReport
        From `airswing.gap.result.assembled.assemble`.
    taken : sequence of Taken
        Unknowns taken off before.
    problem : Problem
        Of the archive without them.
    whole : Closure
        With the dictionary's unknown terms; in the order of the terms.
    mended : sequence of Mended
        Winds set right before all others.
    """
    tails = problem.archive.tails
    with_name = [one for one in mended if one.name is not None]
    nameless = [one for one in mended if one.name is None]
    off: list[Taken | Mended] = [*nameless, *taken]
    tables = [mended_place(one, tails, interval([one])) for one in nameless]
    tables += [entry(one, tails) for one in taken]
    raised = _with_closures(report.unknown.where, found, whole)
    others = [place for place in raised if _stands(place, tables)]
    report = _without(report, [place for place in raised if place not in others])
    after_names = report.closure.after
    curves = max(after_names - report.gap.noise_floor_kt, 0.0) if others else 0.0
    saved = sum((one.saved for one in off), np.zeros(problem.archive.size))
    moved = float(saved.mean()) / KNOT
    low, high = interval(off) if off else (0.0, 0.0)
    if others:
        # of these curves no interval is drawn: half of what they close either way, and 0.01 kt
        # where they close nothing
        spread = 0.5 * curves + 0.01
        low, high = low - spread, high + spread
    closes = None
    if tables or others:
        named = report.closure.before - after_names
        left = report.gap.mean_vector_disagreement_kt + moved - named
        closes = UnknownClosureEntry(
            before=left,
            after=left - moved - curves,
            reduction=moved + curves,
            reduction_ci=[low + curves, high + curves],
        )
    places = [*tables, *others]
    report = replace(report, unknown=UnknownEntry(bool(places), places, closes))
    report = _moved(report, off, moved) if off else report
    for one in reversed(with_name):
        report = _with_named(report, one, tails)
    return with_hidden(report)


def _with_named(report: GapReport, found: Mended, tails: Sequence[str]) -> GapReport:
    """Add what was set right first under its name: the first of the effects taken off."""
    moved, (low, high) = float(found.saved.mean()) / KNOT, interval([found])
    gap, closure = report.gap, report.closure
    before, reduction = closure.before + moved, closure.reduction + moved
    bounds = None
    if closure.reduction_ci is not None:
        bounds = [closure.reduction_ci[0] + low, closure.reduction_ci[1] + high]
    excess = before - gap.noise_floor_kt
    others = [
        replace(effect, share_of_gap=effect.share_of_gap * closure.reduction / reduction)
        for effect in report.effects
    ]
    own = replace(mended_effect(found, tails), share_of_gap=min(moved / reduction, 1.0))
    first, *rest = report.waterfall
    step = StepEntry(own.name, first.kt, [low, high])
    return replace(
        report,
        effects=sorted([own, *others], key=lambda effect: -effect.held_out_energy),
        gap=replace(
            gap,
            mean_vector_disagreement_kt=gap.mean_vector_disagreement_kt + moved,
            significance=min(gap.significance, luck(found.evidence)),
        ),
        closure=replace(
            closure,
            before=before,
            reduction=reduction,
            reduction_ci=bounds,
            ci=None if bounds is None else [before - bounds[1], before - bounds[0]],
            fraction_of_excess=float(np.clip(reduction / excess, 0, 1)) if excess > 1e-6 else None,
        ),
        waterfall=[replace(first, kt=first.kt + moved), step, *rest],
    )


def with_hidden(report: GapReport) -> GapReport:
    """Say what nobody thought of could close unseen; where nothing is told, the interval holds it.

    Of one day nothing but names of single aircraft can be told, so nothing is said.
    """
    closure, counts = report.closure, report.counts
    if counts.days < 2:
        return report
    # unknowns are looked for on the reports held in memory
    low, high = hidden_interval(closure.before, counts.reports_in_view)
    told = replace(closure, could_hide_kt=high)
    ends, after = closure.reduction_ci, closure.ci
    silent = not report.effects and not report.unknown.present
    if silent and ends is not None and after is not None:
        told = replace(
            told,
            ci=[after[0] - high, after[1] - low],
            reduction_ci=[ends[0] + low, ends[1] + high],
        )
    return replace(report, closure=told)


def _with_closures(places: Sequence[PlaceEntry], found: Found, whole: Closure) -> list[PlaceEntry]:
    """Give each unknown of the dictionary the step its term makes."""
    before, steps = whole.before, []
    for term, (_, after, low, high) in zip(found.terms, whole.sequence, strict=False):
        if not term.candidate.known:
            steps.append((term.candidate.name, before - after, low, high))
        before = after
    out = []
    for place in places:
        # else of scatter, told where it was found; of directions not in steps it is not known
        if place.closure is None and place.component != "reported_direction":
            own = [step for step in steps if step[0] == place.group]
            _, reduction, low, high = own[0] if own else ("", 0.0, 0.0, 0.0)
            place = replace(place, closure=ClosesEntry(reduction, [low, high]))
            if own:
                steps.remove(own[0])
        out.append(place)
    return out


def _stands(place: PlaceEntry, tables: Sequence[PlaceEntry]) -> bool:
    """Whether a place is told beside tables.

    What a term of the basis explains of whitened changes along flights need not close anything of
    the winds; and what a table's cells leave on its aircraft is no unknown of its own.
    """
    if place.closure is None or place.mean is not None:
        return True
    own = set(place.tails)
    left = any(
        (not table.tails or len(own & set(table.tails)) > 0.5 * len(own))
        and place.size_m_s < OWN_REMAINDER * table.size_m_s
        for table in tables
    )
    return place.closure.reduction > 0.0 and not (left and place.component in BASIS)


def _without(report: GapReport, places: Sequence[PlaceEntry]) -> GapReport:
    """The report without places that close nothing: their steps leave the noise floor as well."""
    widened = sum(place.closure.reduction for place in places if place.closure is not None)
    if not places:
        return report
    floor = report.gap.noise_floor_kt + widened
    return replace(
        report,
        gap=replace(report.gap, noise_floor_kt=floor),
        waterfall=[*report.waterfall[:-1], replace(report.waterfall[-1], kt=floor)],
    )


def _moved(report: GapReport, taken: Sequence[Taken | Mended], moved: float) -> GapReport:
    """Start the closure and the waterfall from the archive as it is."""
    gap, closure = report.gap, report.closure
    before, fraction = closure.before + moved, closure.fraction_of_excess
    everything = before - gap.noise_floor_kt
    if everything > 1e-6:
        fraction = float(np.clip(closure.reduction / everything, 0, 1))
    strongest = max(one.evidence for one in taken)
    now, steps = before, []
    for one in taken:
        now -= float(one.saved.mean()) / KNOT
        steps.append(StepEntry(f"unknown: {one.title}", now, None))
    first, *rest = report.waterfall
    return replace(
        report,
        gap=replace(
            gap,
            mean_vector_disagreement_kt=gap.mean_vector_disagreement_kt + moved,
            significance=min(gap.significance, luck(strongest)),
        ),
        closure=replace(
            closure,
            before=before,
            after=closure.after + moved,
            ci=None if closure.ci is None else [end + moved for end in closure.ci],
            fraction_of_excess=fraction,
        ),
        waterfall=[replace(first, kt=before), *steps, *rest],
    )
