"""What moves no mean and has no name: scatter of single reports, and winds sent otherwise.

Assumptions: either shows in the other. A floor of the speeds sent scatters the reports that meet
it, and jitter sends other speeds. Both are looked for; on the same aircraft the one stands that
closes more, and the other is looked for again without them.

Validity: that of :mod:`airswing.gap.scatter.excess_scatter` and
:mod:`airswing.gap.witness.sent_winds`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.closure.of_scatter import (
    Reduction,
    reduction_of_jitter,
    reduction_of_steps,
)
from airswing.gap.held_out.days_left_out import folds_of_days
from airswing.gap.passes import Search
from airswing.gap.scatter.excess_scatter import Scattering, scattering
from airswing.gap.scatter.moment_verdict import MomentVerdict
from airswing.gap.sums.problem import Problem
from airswing.gap.taken_off.remainders import small_beside
from airswing.gap.witness.bench import Bench, Setting
from airswing.gap.witness.sent_winds import SentWinds, sent_winds

Floats = NDArray[np.float64]

# What stands beside a moment that is told and closes nothing.
NOTHING = Reduction(0.0, 0.0)
#: Size of scatter beside that of names on the same aircraft up to which it is what they leave: a
#: band of ten degrees of temperature, sent in whole ones, leaves a tenth of its energy.
SCATTER_LEFT = 0.35


def in_no_mean(
    problem: Problem,
    rest: Floats,
    moments: Sequence[MomentVerdict],
    gross: NDArray[np.bool_],
    search: Search,
) -> tuple[Scattering | None, SentWinds | None, dict[str, Reduction]]:
    """Find what has no name and moves no mean.

    Parameters
    ----------
    rest : (n, 2) float
        Residual without what was found, m/s.
    moments : sequence of MomentVerdict
        Effects of scatter that have a name.
    gross : (n,) bool
        Single reports that stand off both neighbours.
    search : Search
        For its progress.

    Returns
    -------
    jittery : Scattering or None
    sent : SentWinds or None
    closes : dict
        What either closes, by ``scatter``, ``reported_speed`` and ``reported_direction``.
    """
    explained = {tail for moment in moments for tail in moment.tails}
    # single gross errors with a name are left out: their aircraft may scatter besides
    erring = [t for m in moments if m.name == "outliers" for t in m.tails]
    struck = gross & np.isin(np.array(problem.archive.tails)[problem.archive.aircraft], erring)
    jittery = _scatters(problem, rest, struck, explained - set(erring))
    search.tell("sent winds", 0.0)
    sent = _sent_otherwise(problem, rest, explained)
    closes = _closes(problem, rest, jittery, sent, struck)
    if jittery is not None and sent is not None:
        # either shows in the other: a floor of the speeds scatters, jitter sends other speeds
        if closes.get(sent.component, NOTHING).kt > closes["scatter"].kt:
            tails = {problem.archive.tails[a] for a in sent.aircraft}
            jittery = _scatters(problem, rest, struck, (explained - set(erring)) | tails)
        else:
            sent = _sent_otherwise(problem, rest, explained | set(jittery.tails))
        closes = _closes(problem, rest, jittery, sent, struck)
    search.tell("where", 0.0)
    return jittery, sent, closes


def _closes(
    problem: Problem,
    rest: Floats,
    jittery: Scattering | None,
    sent: SentWinds | None,
    struck: NDArray[np.bool_],
) -> dict[str, Reduction]:
    """How far the disagreement shrinks without either, where it is known."""
    closes = {}
    if jittery is not None:
        closes["scatter"] = reduction_of_jitter(rest, jittery, struck)
    if sent is not None and sent.speeds is not None:
        closes[sent.component] = Reduction(sent.closes, sent.closes_error)
    elif sent is not None and sent.lattice is not None:
        steps = reduction_of_steps(problem.archive, rest, sent.lattice, sent.aircraft)
        closes[sent.component] = steps
    return closes


def _scatters(
    problem: Problem, rest: Floats, gross: NDArray[np.bool_], explained: Collection[str]
) -> Scattering | None:
    """Find reports that scatter beyond simulated ones, where days left out can confirm it.

    Not what a large name leaves: at its edges variables are known to their rounding alone.
    """
    archive = problem.archive
    if problem.base.stats.clock.short or set(archive.tails) <= set(explained):
        return None
    found = scattering(
        archive,
        problem.context,
        rest,
        problem.noise,
        gross=gross,
        fold=folds_of_days(problem.base.stats)[problem.day],
        explained=explained,
        seed=problem.seed,
    )
    if found is None:
        return None
    own = np.isin(np.array(archive.tails)[archive.aircraft], found.tails)
    size = float(np.sqrt(2 * (found.sizes[own] ** 2).mean()))
    named = (archive.residual - rest)[own]
    return None if small_beside(named, size, share=SCATTER_LEFT) else found


def _sent_otherwise(problem: Problem, rest: Floats, explained: Collection[str]) -> SentWinds | None:
    """Find winds sent otherwise than simulated, but for aircraft whose scatter has a name."""
    setting = Setting.of(problem).alike
    fold = folds_of_days(problem.base.stats)
    known = [a for a, tail in enumerate(problem.archive.tails) if tail in explained]
    return sent_winds(Bench.of(setting, rest), fold, without=known)
