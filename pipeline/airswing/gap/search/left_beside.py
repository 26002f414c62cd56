"""Whether an effect is the one named, told by what its own aircraft show beside it.

Assumptions: where something is at work that the catalogue lacks, the likest name takes most of it
and leaves a rest in its component (across the heading, or not) on its aircraft. The aircraft it is
not on tell what is left without it, of model error and irregular sensors: only what stands out of
theirs counts. Of a right name a small share of its evidence is left as well: large errors are
linearised, and bank and acceleration are inferred. What is left of a name is in units of both.

Validity: archives of more than a day or two; effects that last or change, of single aircraft or
all. A likeness that leaves next to nothing (an airspeed's scale for its offset, where airspeeds are
alike) is not told apart so: the ambiguity of a claim names it.

Source: docs/gap.md section 6; raw evidence as in :mod:`airswing.gap.evidence.gaussian`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.of_candidate import evaluate_each, raw_of_one
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.sums.elimination import Base

Floats = NDArray[np.float64]

#: Raw evidence, nats, that the strongest of some forty candidates has where nothing is.
USUAL = 2.0
#: Share of a right name's raw evidence that is left on its aircraft.
SHARE = 0.03
#: The same of what its columns do not carry, over what they do (`Effect.told_share`). Of errors by
#: an acceleration, which is inferred, right names left 3 and 4 % before they were linearised about.
OF_UNTOLD = 0.25


def left_beside(base: Base, pool: Sequence[Candidate], terms: Sequence[Term]) -> Floats:
    """What each name leaves on its own aircraft beside all terms, beyond what is usual, (t,).

    Parameters
    ----------
    pool : sequence of Candidate
        Lasting effects and groups are asked.
    terms : sequence of Term
        All are given; of terms without a name it is 0.

    Returns
    -------
    (t,) float
        Raw evidence over what a right name leaves.
    """
    out = np.zeros(len(terms))
    given = given_terms(base, terms)
    lasting = [candidate for candidate in pool if candidate.kind == "mean"]
    single = [candidate for candidate in lasting if candidate.scope == "aircraft"]
    aircraft = range(len(base.stats.tails)) if any(t.candidate.known for t in terms) else ()
    raw = np.array([raw_of_one(given, single, a) for a in aircraft])
    for k, term in enumerate(terms):
        what = term.candidate
        if not what.known:
            continue
        if what.scope == "fleet":
            wide = [c for c in lasting if c.scope == "fleet" and _rivals(c, what)]
            scores = evaluate_each(base.stats, given, wide, allowed=[None] * len(wide))
            left = max((score.raw / score.factor for score in scores), default=0.0) - USUAL
        else:
            most = raw[:, [_rivals(c, what) for c in single]].max(axis=1, initial=0.0)
            own = np.isin(aircraft, term.tails)
            usual = max(float(most[~own].max(initial=0.0)), USUAL)
            left = float(np.maximum(most[own] - usual, 0.0).sum())
        allowed = share_left(what) * max(term.score.raw, 0.0) + _left_of_others(terms, k)
        out[k] = max(left, 0.0) / (USUAL + allowed)
    return out


def _left_of_others(terms: Sequence[Term], k: int) -> float:
    """Raw evidence that the inferred columns of other names leave on a name's aircraft, nats."""
    own, what = set(terms[k].tails), terms[k].candidate
    return sum(
        _share_untold(other.candidate) * max(other.score.raw, 0.0)
        for j, other in enumerate(terms)
        if j != k
        and other.candidate.scope == what.scope == "aircraft"
        and other.candidate.heading == what.heading
        and own & set(other.tails)
    )


def share_left(what: Candidate) -> float:
    """Share of its raw evidence that a right name leaves on its aircraft."""
    return max(SHARE, _share_untold(what))


def _share_untold(what: Candidate) -> float:
    """The part of it that its columns do not carry, of inferred ones."""
    return OF_UNTOLD * (1.0 / what.told_share - 1.0)


def _rivals(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates have different names and err in the same component."""
    return one.name != other.name and one.heading == other.heading
