"""Passes over an archive's reports: noise, sums, search, and again about what was found first.

Assumptions: those of the modules called. The search runs twice where effects are large: the second
time on residuals linearised about the effects found first, with the noise fitted after taking them
off. Reports of two aircraft that were exchanged are given back before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan, plan_dictionary
from airswing.gap.design.candidates import candidates
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.design.layout import make_layout
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.scattered_headings import of_columns
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.held_out.level_or_other import goes_by
from airswing.gap.held_out.linearised import FoundFirst
from airswing.gap.held_out.raising import raising
from airswing.gap.noise.model import fit_noise, flown
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.cross_validated import Doubtful, Standing, settle, with_name
from airswing.gap.search.stepwise import Rules, with_background
from airswing.gap.search.tail_swaps import Swap, beside, exchange, find_swap
from airswing.gap.sums.accumulate import SumColumns
from airswing.gap.sums.elimination import eliminate_days
from airswing.gap.sums.problem import Problem
from airswing.gap.sums.variance_components import shared_prior, shared_variances
from airswing.gap.sums.whole_archive import Archive, held_archive, sum_reports

Progress = Callable[[str, float], None]

#: Size at single reports, m/s, from which an effect is in danger of being clipped as gross errors.
PEAK = 2.5
#: Why a name is not told that explains nothing of every report alike.
RAISES = "taken off, it leaves reports of weeks left out further from the simulation"


@dataclass(frozen=True)
class Pass:
    """One pass over the reports and the search on its sums."""

    problem: Problem
    standing: Standing


@dataclass(frozen=True)
class Search:
    """What is looked for, and how; ``named``: names that tables confirmed, stated in any case."""

    effects: Mapping[str, Effect]
    rules: Rules
    dictionary: bool
    seed: int
    tell: Progress
    named: tuple[Doubtful, ...] = ()


def search_twice(
    archive: Archive, search: Search, *, swaps: bool
) -> tuple[Pass, bool, Swap | None]:
    """Pass over the reports in memory, then over all; again where two aircraft were exchanged.

    Returns
    -------
    final : Pass
    again : bool
        Whether it is linearised about what an earlier one found.
    swap : Swap or None
    """
    first = run_pass(archive.held(), search)
    swap = swap_in(first, search) if swaps and archive.whole else None
    if swap is not None:
        archive = _exchanged(archive, swap, first)
        first = run_pass(archive, search)
    about = _found_first(archive, first)
    terms = first.standing.found.terms
    if archive.whole and about is None:
        return first, False, swap
    del first  # its sums
    final = run_pass(archive, search, about=about, start=terms)
    if swaps and not archive.whole:
        swap = swap_in(final, search)
        if swap is not None:
            archive = _exchanged(archive, swap, final)
            del final
            first = run_pass(archive.held(), search)
            about, terms = _found_first(archive, first), first.standing.found.terms
            del first
            final = run_pass(archive, search, about=about, start=terms)
    return final, about is not None, swap


def of_view(archive: Archive, frame: Frame) -> Archive:
    """Archive of other winds on the reports held in memory; all that is looked at from then on."""
    held = held_archive(frame, workers=archive.workers)
    return replace(held, reports=archive.reports, flights=archive.flights)


def swap_in(made: Pass, search: Search) -> Swap | None:
    """Look for two aircraft that exchanged identifiers, beside what a pass found."""
    base = made.problem.base
    others, needed = beside(made.standing.found.terms)
    return find_swap(base, given_terms(base, others), search.effects, threshold=needed)


def _exchanged(archive: Archive, swap: Swap, made: Pass) -> Archive:
    stats = made.problem.base.stats
    start = float(stats.clock.begins(stats.days[swap.day]))
    return archive.exchanged(swap.pair, lambda frame: exchange(frame, swap, start))


def _found_first(archive: Archive, first: Pass) -> FoundFirst | None:
    """What a first pass found, where it is large enough to be linearised about."""
    found = first.standing.found
    about = FoundFirst.of(first.problem, found.terms, term_coefficients(found.given, found.terms))
    peak = about.errors(archive.view, archive.context).peak
    return about if peak > PEAK or any(_large(t) for t in found.terms) else None


def _large(term: Term) -> bool:
    """Whether a term is large enough to be linearised again and to disturb the noise fit."""
    # m/s: less turns a heading flown at 120 m/s by less than 0.7 degrees, where first order is
    # exact enough
    return bool(np.max(term.score.size[list(term.tails)]) > 1.5)


def run_pass(
    archive: Archive,
    search: Search,
    *,
    about: FoundFirst | None = None,
    start: Sequence[Term] = (),
) -> Pass:
    """Fit the noise, accumulate and search; the noise with what was found first taken off.

    Beside that noise all that is at work stands out, most of all what is not conditioned on yet: a
    second search begins with the terms of the first.
    """
    effects, tell = search.effects, search.tell
    frame, context = archive.view, archive.context
    tell("noise", 0.0)
    calm = frame.residual if about is None else about(frame, context)[0]
    noise = fit_noise(calm, flown(context, heading_doubt(frame, context)), seed=search.seed)
    plan = plan_dictionary(context, effects)
    if not search.dictionary:
        plan = DictionaryPlan(plan.knots, (), plan.centre, plan.means, plan.flags)
    columns = SumColumns(noise, make_layout(effects, plan, context), effects, plan)
    stats = sum_reports(
        archive, columns, about=about, progress=lambda done: tell("statistics", done)
    )
    tell("search", 0.0)
    variances = shared_variances(stats, shared_prior(columns.layout, effects))
    pool = candidates(columns.layout, effects, dictionary=search.dictionary)
    like = of_columns(frame, columns.layout, effects)
    base = with_background(replace(eliminate_days(stats, variances), scattered=like), pool)
    problem = Problem(
        frame, context, effects, plan, noise, base, archive.reports, archive.flights, search.seed
    )
    ranking = Ranking(base, pool)
    standing = _settled(problem, ranking, search.rules, start)
    for one in search.named:
        standing = with_name(ranking, standing, one)
    return Pass(problem, standing)


def _settled(problem: Problem, ranking: Ranking, rules: Rules, start: Sequence[Term]) -> Standing:
    """Search; again without a bias beyond a level, or a name, that is no such thing."""
    standing = settle(ranking, rules, start)
    found = standing.found
    other = goes_by(problem, found.terms, term_coefficients(found.given, found.terms))
    if other is not None:
        wrong = {other[0]: f"what it explains goes by {other[1]}, not by level"}
    else:
        wrong = dict.fromkeys(raising(problem, found.terms), RAISES)
    if not wrong:
        return standing
    keys = {found.terms[k].key for k in wrong}
    left = ranking.among([c for c in ranking.pool if (c.name, c.scope) not in keys])
    again = _settled(problem, left, rules, [term for term in start if term.key not in keys])
    doubtful = [Doubtful(found.terms[k], 0.0, standing.weighed[k], wrong[k]) for k in wrong]
    return replace(again, doubtful=(*again.doubtful, *doubtful))
