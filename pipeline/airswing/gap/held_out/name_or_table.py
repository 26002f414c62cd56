"""Whether a doubtful name explains what a table does that stands by itself.

Assumptions: a table that stands was confirmed on weeks left out by its own sums, so something is
there. An effect of the catalogue that the search had found, but not surely enough to be stated, is
what it is where, fitted without each fold, it takes as much off the reports left out as the table
does: it has one or two coefficients where the table has many. What it explains only in part stays
unknown.

Validity: every report counts alike, as where tables are compared with each other; blocks of three
days err independently of each other.

Units: m/s; energies in m2 s-2.

Source: docs/gap.md section 8.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.days_left_out import folds_of_days
from airswing.gap.held_out.reduction import held_out_errors
from airswing.gap.held_out.share_held import BLOCK, BOUND
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]

#: Share of what a table explains that a name may leave in any case, and where it is within the
#: error: another table must gain as much to be taken instead.
SHORT, MOST_SHORT = 0.03, 0.1
#: Aircraft in common over aircraft in either, from which name and table are of the same ones.
ALIKE = 0.75


def explains(
    problem: Problem, others: Sequence[Term], name: Term, table: tuple[Floats, Sequence[int]]
) -> bool:
    """Whether a name, beside others, explains as much of weeks left out as a table.

    Parameters
    ----------
    others : sequence of Term
        Names that stand.
    name : Term
        The doubtful one.
    table : ((n, 2) float, sequence of int)
        Error the table makes at every report, held out, m/s, and its aircraft.
    """
    error, tails = table
    both = set(name.tails) & set(tails)
    if len(both) < ALIKE * len({*name.tails, *tails}):
        return False
    fold = folds_of_days(problem.base.stats)

    def energy(taken: Floats) -> Floats:
        return _explained(problem, taken)

    zero = np.zeros_like(error)
    stand = sum(held_out_errors(problem, others, fold), zero)
    named = energy(sum(held_out_errors(problem, [*others, name], fold), zero))
    # the table alone may explain more than beside names that only stood in for it
    tables = max((energy(error), energy(stand + error)), key=lambda own: float(own.sum()))
    short, gain = tables - named, float((tables - energy(stand)).sum())
    doubt = float(short.std(ddof=1) * np.sqrt(short.size)) if short.size > 1 else 0.0
    allowed = min(max(doubt, SHORT * gain), MOST_SHORT * gain)
    return bool(gain > 0.0 and short.sum() <= allowed)


def _explained(problem: Problem, error: Floats) -> Floats:
    """Energy that an error takes off the residual, by block of days, mean over all reports."""
    residual = problem.archive.residual
    near = np.abs(residual).max(axis=1) < BOUND
    own = np.where(near, (2 * residual * error - error**2).sum(axis=1), 0.0)
    return np.asarray(np.bincount(problem.day // BLOCK, own) / max(own.size, 1))
