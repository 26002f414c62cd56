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

from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.days_left_out import folds_of_days
from airswing.gap.held_out.reduction import held_out_errors
from airswing.gap.held_out.share_held import share_held
from airswing.gap.sums.problem import Problem

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
    out = []
    for k in asked:
        told = share_held(rest + errors[k], errors[k], problem.day)
        by_aircraft = np.bincount(problem.archive.aircraft, np.hypot(*errors[k].T))
        lasting = LASTING * float(np.hypot.reduce(by_aircraft)) / max(told.energy, 1e-12)
        # taken off it saves (2 share - 1) of its energy
        if told.energy and 2 * told.share - 1 < -CLEARLY * 2 * np.hypot(told.error, lasting):
            out.append(k)
    return out
