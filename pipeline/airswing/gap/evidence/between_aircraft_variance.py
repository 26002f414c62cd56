"""How large the background of a fleet is, told by all effects that single aircraft could have.

Assumptions: for each effect every aircraft has a little of its own, of a size that all aircraft
share (rms where the effect acts, in each direction): model error that persists over the archive and
small effects nobody names. The sizes of the effects have a half-normal distribution whose scale is
the archive's, one for effects of the heading and one for the others: a quiet fleet is quiet in most
of them. The scale is averaged over, weighted by how well it explains the aircraft's estimates of
every effect, each aircraft free to be struck; one effect in two may go its own way.

Validity: three aircraft and more; what the data leave open the scales of :data:`SCALES` share
alike. Effects are taken as independent of each other, so their evidence counts half.

Source: random effects with half-normal scales, Gelman (2006), Bayesian Analysis 1, 515-534.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Averaged over where the fits estimate one variance: what is asked here is whether an aircraft
# stands out from the others, and a single best size would be drawn up by the one that does.
#: Sizes of the background that are averaged over, m/s.
GRID = np.array([0.0, 0.01, 0.02, 0.04, 0.06, 0.08, 0.11, 0.15, 0.2, 0.3])
#: Scales of its half-normal distribution over effects, m/s.
SCALES = np.array([0.02, 0.04, 0.08, 0.12])
#: Share of the evidence about the scale that counts.
COUNTED = 0.5
#: Share of the effects that go by the archive's scale.
ALIKE = 0.5
#: Probability that an aircraft is struck that is not asked about.
ELSEWHERE = 0.2


def half_normal(scale: float) -> Floats:
    """Log probability of the sizes of :data:`GRID`, (T,)."""
    edges = np.r_[0.0, (GRID[1:] + GRID[:-1]) / 2, GRID[-1]]
    density = -0.5 * (GRID / scale) ** 2 + np.log(np.diff(edges))
    return np.asarray(density - np.logaddexp.reduce(density))


def whole_prior(weights: Floats | None = None) -> Floats:
    """Log probability of the sizes of :data:`GRID` over scales, (T,).

    Parameters
    ----------
    weights : (H,) float, optional
        Log probability of each of :data:`SCALES`; all alike by default.
    """
    log = np.full(SCALES.size, -np.log(SCALES.size)) if weights is None else weights
    each = np.stack([half_normal(float(scale)) for scale in SCALES])
    return np.asarray(np.logaddexp.reduce(each + log[:, None], axis=0))


def told(likelihoods: Sequence[Floats]) -> Floats:
    """Log probability of the sizes given how likely every effect's estimates are at each.

    Parameters
    ----------
    likelihoods : sequence of (T,) float
        Of one effect each: log density of all aircraft's estimates at every size of :data:`GRID`.

    Returns
    -------
    (T,) float
    """
    weights = np.zeros(SCALES.size)
    for own in likelihoods:
        each = [np.logaddexp.reduce(half_normal(float(scale)) + own) for scale in SCALES]
        weights += COUNTED * np.array(each)
    alike = np.log(ALIKE) + whole_prior(weights - np.logaddexp.reduce(weights))
    return np.asarray(np.logaddexp(alike, np.log1p(-ALIKE) + whole_prior()))


def either(evidence: Floats) -> Floats:
    """Log density of aircraft that may be struck, over that of ones that are not; shape (T, A).

    Parameters
    ----------
    evidence : (T, S, A) float
        Log Bayes factors of being struck, by size of the background and width of the prior.
    """
    struck = np.logaddexp.reduce(evidence, axis=1) - np.log(evidence.shape[1])
    return np.asarray(np.logaddexp(np.log1p(-ELSEWHERE), np.log(ELSEWHERE) + struck))
