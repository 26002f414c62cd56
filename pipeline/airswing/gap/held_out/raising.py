"""Whether a name explains anything of reports left out, every one alike.

Assumptions: a name is found by what changes along flights, where the reference errs least. A
heading error that changes when the aircraft turns (a hysteresis, a platform that settles) changes
along the heading as well there, as an airspeed's error would; but an airspeed errs between turns
too. So a right name lowers the disagreement of every report alike, on weeks it was not fitted on,
beside the other names. Where it raises that beyond its error (between blocks of days, and of what
the reference lastingly errs by along each aircraft's routes), what is at work is something else.

Validity: effects of single aircraft; archives of more than a day or two.

Units: m/s; energies in m2 s-2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.days_left_out import folds_of_days
from airswing.gap.held_out.name_or_table import BLOCK, BOUND
from airswing.gap.held_out.reduction import held_out_errors
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Standard errors by which the disagreement must rise.
CLEARLY = 2.0
#: What the reference lastingly errs by along an aircraft's routes, m/s.
LASTING = 0.1


def raising(problem: Problem, terms: Sequence[Term]) -> list[int]:
    """Find names of single aircraft that raise the disagreement of weeks left out.

    Returns
    -------
    list of int
        Numbers of the terms.
    """
    asked = [k for k, t in enumerate(terms) if t.candidate.known and t.candidate.scope != "fleet"]
    if not asked or problem.base.stats.clock.short:
        return []
    errors = held_out_errors(problem, terms, folds_of_days(problem.base.stats))
    rest = problem.archive.residual - np.sum(errors, axis=0)
    near = np.abs(problem.archive.residual).max(axis=1) < BOUND
    out = []
    for k in asked:
        own = np.where(near[:, None], errors[k], 0.0)
        lasting = np.bincount(problem.archive.aircraft, np.hypot(*own.T))
        explained, between = _explained((rest + own) * own, own**2, problem.day // BLOCK)
        doubt = np.hypot(between, 2 * LASTING * float(np.hypot.reduce(lasting)))
        if explained < -CLEARLY * doubt:
            out.append(k)
    return out


def _explained(held: Floats, whole: Floats, block: Integers) -> tuple[float, float]:
    """Energy an error takes off, and its standard error between blocks of days.

    Blocks scatter about the share of the error that all of them hold: one that acts for a week has
    two or three, beside many on which nothing is asked.

    Parameters
    ----------
    held, whole : (n, 2) float
        Product of residual and error, and the error's square.
    block : (n,) int
    """
    of_block, size = (np.bincount(block, part.sum(axis=1)) for part in (held, whole))
    total = float(size.sum())
    if total <= 0.0:
        return 0.0, 0.0
    share = float(of_block.sum()) / total
    number = total**2 / float((size**2).sum())
    few = np.sqrt(number / max(number - 1.0, 0.5))
    return (2 * share - 1) * total, 2 * few * float(np.hypot.reduce(of_block - share * size))
