"""The probability that a claim is right, from its evidence and from days left out.

Assumptions: four things tell a right name from a wrong one, whichever effect it is: its evidence,
how it does on days it was not fitted on, how much stronger what has no name in the same archive is,
and how much stronger what else has one is (unexplained structure, and leaks of large effects, make
false changes and exchanges). A logistic function of them states the probability; changes in time
have a constant of their own. Its weights are set, not fitted: on 25 simulated archives with effects
in the catalogue and outside it the search came to too few wrong names (4 of 17) to fit them.

Validity: archives like those; a claim that could not be tested on days left out has no probability
and is not stated.

Source: Platt (1999), Advances in Large Margin Classifiers, 61-74 (probabilities from scores).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term
from airswing.gap.search.confirmation import Confirmation

Floats = NDArray[np.float64]

#: Constant, and weights of :func:`features`.
CONSTANT = -3.0
WEIGHTS = (1.2, 1.0, -0.8, -0.2, -1.5)
#: Probability from which a name is stated.
STATED = 0.9
#: Deviations under which days left out do not confirm a claim, whatever its evidence; it is then no
#: likelier than not.
LEAST_DEVIATIONS = 2.0
#: Deviations beyond which a claim does not become surer.
MOST_DEVIATIONS = 6.0


def features(terms: Sequence[Term], confirmation: Confirmation) -> Floats:
    """What tells right claims from wrong ones.

    Parameters
    ----------
    terms : sequence of Term
    confirmation : Confirmation
        Of the same terms.

    Returns
    -------
    (t, 5) float
        Logarithm of the evidence in nats; deviations by which days left out confirm it; logarithms
        of one plus the strongest other evidence over its own, of terms without a name and of those
        with one; 1 for a change in time.
    """
    evidence = np.array([max(term.score.tempered, 0.1) for term in terms])
    known = np.array([term.candidate.known for term in terms], bool)
    deviations = np.clip(confirmation.deviations, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    out = np.zeros((len(terms), len(WEIGHTS)))
    for k, term in enumerate(terms):
        others = np.arange(len(terms)) != k
        nameless = float(evidence[others & ~known].max(initial=0.0))
        named = float(evidence[others & known].max(initial=0.0))
        changes = term.period is not None or term.candidate.kind == "drift"
        out[k] = (
            np.log(evidence[k]),
            deviations[k],
            np.log1p(nameless / evidence[k]),
            np.log1p(named / evidence[k]),
            float(changes),
        )
    return out


def probabilities(weighed: Floats, confirmation: Confirmation) -> Floats:
    """Probability that each term is at work as named, (t,); 0 where it could not be tested.

    Parameters
    ----------
    weighed : (t, 5) float
        From :func:`features`.
    confirmation : Confirmation

    Returns
    -------
    (t,) float
    """
    logit = CONSTANT + weighed @ np.array(WEIGHTS)
    out = 1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0)))
    out = np.where(confirmation.deviations < LEAST_DEVIATIONS, np.minimum(out, 0.5), out)
    return np.asarray(np.where(confirmation.tested, out, 0.0))
