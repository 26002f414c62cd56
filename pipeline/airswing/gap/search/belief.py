"""The probability that a claim is right, from its evidence and from days left out.

Assumptions: four things tell a right name from a wrong one, whichever effect it is: its evidence,
how it does on days it was not fitted on, how much stronger what has no name in the same archive is,
and how much stronger what else has one is (unexplained structure, and leaks of large effects, make
false changes and exchanges). A logistic function of them states the probability; changes in time
have a constant of their own. Its weights are learned from simulated archives
(``python -m benchmarks.gap_probabilities`` prints how it does on archives left out) and stand in
``claim_weights.json``.

Validity: archives like those; a claim that could not be tested on days left out has no probability
and is not stated.

Source: Platt (1999), Advances in Large Margin Classifiers, 61-74 (probabilities from scores).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term
from airswing.gap.search.confirmation import Confirmation

Floats = NDArray[np.float64]

#: Numbers that a probability is made of, in the order of :func:`features`.
FEATURES = ("log_nats", "deviations", "nameless", "named", "change")
WEIGHTS_FILE = Path(__file__).with_name("claim_weights.json")
#: Probability from which a name is stated.
STATED = 0.9
#: Odds that a table beside a doubtful name, confirmed by sums of its own, adds to those of the name
#: which explains as much: on archives without effect one in twenty has a table, or fewer.
TABLE_ODDS = 20.0
#: That a name is that one: log odds where nothing is left beside it, and by how much they fall with
#: the logarithm of one plus what is left.
NAMED_EVEN, NAMED_SLOPE = 3.4, 6.0
#: Probability of that below which it is likelier another effect, and the name is not told.
LIKELIER_ANOTHER = 0.5
#: Of one day: nats at which a name is as likely wrong as right; growth of its log odds with their
#: logarithm (0.9 at nine nats); deviations by which parts of the day must confirm it.
ONE_DAY_EVEN, ONE_DAY_SLOPE, ONE_DAY_DEVIATIONS = 5.0, 3.8, 2.0
#: That a table is of no effect of the catalogue: share of it that the nearest explains from which
#: it may as well be that, and how sharply the odds fall there. In the blind checks what came from
#: outside was explained to 0.3 at most, five effects of the catalogue told as unknowns to 0.54 to
#: 0.93; but errors that grow, or wear off, in flight and never change sign to 0.5 and 0.7 as well.
OUTSIDE_EVEN, OUTSIDE_SLOPE = 0.45, 20.0
#: Deviations beyond which a claim does not become surer.
MOST_DEVIATIONS = 6.0


def features(terms: Sequence[Term], confirmation: Confirmation) -> Floats:
    """What tells right claims from wrong ones.

    Parameters
    ----------
    confirmation : Confirmation
        Of the same terms.

    Returns
    -------
    (t, 5) float
        Logarithm of the evidence in nats; deviations by which days left out confirm it; logarithms
        of one plus the strongest other evidence over its own, of terms without a name and of those
        with one; 1 for a change in time.
    """
    # its logarithm is taken: what has less evidence has none
    evidence = np.array([max(term.score.tempered, 0.1) for term in terms])
    known = np.array([term.candidate.known for term in terms], bool)
    deviations = np.clip(confirmation.deviations, -MOST_DEVIATIONS, MOST_DEVIATIONS)
    out = np.zeros((len(terms), len(FEATURES)))
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

    Returns
    -------
    (t,) float
    """
    return np.asarray(np.where(confirmation.tested, chance(weighed), 0.0))


def chance(weighed: Floats) -> Floats:
    """Learned probability of what :func:`features` gives, (..., 5)."""
    constant, weights = learned_weights()
    logit = constant + weighed @ weights
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0))))


def as_named(left: Floats, shared: NDArray[np.bool_]) -> Floats:
    """Probability that what is there is what the name says, (t,).

    Of what all aircraft have no other aircraft tells how much is left without it, of the model's
    error say: what is left beside it makes it no less likely than not.

    Parameters
    ----------
    left : (t,) float
        What each name leaves on its aircraft
        (:func:`airswing.gap.search.left_beside.left_beside`).
    shared : (t,) bool
        Whether all aircraft have it.
    """
    likely = 1.0 / (1.0 + np.exp(NAMED_SLOPE * np.log1p(left) - NAMED_EVEN))
    return np.asarray(np.where(shared, np.maximum(likely, LIKELIER_ANOTHER), likely))


def of_one_day(weighed: Floats) -> Floats:
    """Probability of names of single aircraft in an archive of a day or two, (t,).

    Its few parts confirm by few deviations, however strong the evidence: that decides. Days were
    cut out of simulated archives. Without effect (72 days and 28 pairs of days, and some of the
    hard world) the strongest such name had 5.7 nats; on 72 days with an effect on one to three
    aircraft 33 names had nine nats and more, and 32 were right.

    Parameters
    ----------
    weighed : (t, 5) float
        From :func:`features`.
    """
    odds = ONE_DAY_SLOPE * (weighed[:, 0] - np.log(ONE_DAY_EVEN))
    confirmed = weighed[:, 1] >= ONE_DAY_DEVIATIONS
    return np.asarray(np.where(confirmed, 1.0 / (1.0 + np.exp(-odds)), 0.0))


def beside_table(probability: float) -> float:
    """Probability of a doubtful name that explains what a table does which stands by itself."""
    # certainty has no odds
    odds = TABLE_ODDS * probability / max(1.0 - probability, 1e-9)
    return odds / (1.0 + odds)


def outside_catalogue(share: float) -> float:
    """Probability that a table is of something outside the catalogue.

    Parameters
    ----------
    share : float
        Of the table's mean square that the nearest effect explains.
    """
    near = 1.0 / (1.0 + np.exp(-OUTSIDE_SLOPE * (share - OUTSIDE_EVEN)))
    return float(1.0 - 0.5 * near)


@lru_cache(maxsize=1)
def learned_weights() -> tuple[float, Floats]:
    """Constant and weights (5,) of the logistic function."""
    content = json.loads(WEIGHTS_FILE.read_text(encoding="utf-8"))
    return float(content["constant"]), np.array([content[name] for name in FEATURES], float)
