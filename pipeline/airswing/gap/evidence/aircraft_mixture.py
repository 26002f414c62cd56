"""Which aircraft of a fleet are struck: a spike-and-slab mixture of their evidence.

Assumptions: a share of the aircraft is struck, each by coefficients of its own; the share, the
width of their prior and, where it is a question, the size of the background are averaged over.

Validity: aircraft are independent of each other once the background is given.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.between_aircraft_variance import GRID, whole_prior

Floats = NDArray[np.float64]

#: Shares of aircraft struck over which the mixture is averaged.
SHARE_GRID = np.array([0.03, 0.08, 0.2, 0.5, 0.8, 0.97])


@dataclass(frozen=True)
class Same:
    """Evidence that those struck have one and the same coefficient, by its value (V of them)."""

    evidence: Floats  # (T, V, A): log Bayes factors, as those of coefficients of their own
    log_prior: Floats  # (V,): of the values


@dataclass(frozen=True)
class Mixed:
    """Spike-and-slab mixture over aircraft."""

    total: float  # log evidence against nobody struck
    # (A,): probability that each aircraft is struck, given that the candidate is at work
    posterior: Floats
    best: tuple[int, int]  # background and prior scale of the highest evidence
    # root mean square size of the background, m/s, whether or not anybody is struck
    background: float


def mixture(
    evidence: Floats,
    nothing: Floats | None = None,
    prior: Floats | None = None,
    levels: Floats = GRID,
    same: Same | None = None,
) -> Mixed:
    """Spike-and-slab mixture over aircraft, averaged over background, prior scale and share struck.

    Parameters
    ----------
    evidence : (T, S, A) float
        Log Bayes factor per size of the background, prior scale and aircraft; 0 for aircraft that
        cannot be struck.
    nothing : (T, A) float, optional
        Log density of each aircraft's estimates if it is not struck. None: the background is no
        question (T is 1).
    prior : (T,) float, optional
        Log probability of the sizes of the background
        (:mod:`airswing.gap.evidence.between_aircraft_variance`).
    levels : (T,) float
        The sizes, m/s.
    same : Same, optional
        One coefficient for all that are struck is as likely beforehand as one for each.
    """
    each = by_share(evidence)
    if nothing is None:
        nobody = np.zeros(1)
    else:
        nobody = (whole_prior() if prior is None else prior) + nothing.sum(axis=1)
    joint = each.sum(axis=3) + nobody[None, :, None]
    posterior = _posterior(evidence, each, joint)
    top = np.unravel_index(int(np.argmax(joint.max(axis=0))), joint.shape[1:])
    total = log_mean(joint.ravel()) - log_mean(nobody)
    if same is not None:
        each = by_share(same.evidence)
        alike = each.sum(axis=3) + nobody[None, :, None] + same.log_prior
        # of the values a sum, the prior is in it
        other = log_mean(np.logaddexp.reduce(alike, axis=2).ravel()) - log_mean(nobody)
        share = 1.0 / (1.0 + np.exp(np.clip(total - other, -50.0, 50.0)))
        posterior += share * (_posterior(same.evidence, each, alike) - posterior)
        total = float(np.logaddexp(total, other) - np.log(2.0))
    return Mixed(
        total,
        posterior,
        (int(top[0]), int(top[1])),
        0.0 if nothing is None else _size(joint, nobody, levels),
    )


def _posterior(evidence: Floats, each: Floats, joint: Floats) -> Floats:
    """Probability (A,) that each aircraft is struck, (P, T, S) averaged over by ``joint``."""
    weight = np.exp(joint - joint.max())
    weight /= weight.sum()
    struck = np.exp(np.log(SHARE_GRID)[:, None, None, None] + evidence[None] - each)
    return np.asarray(np.einsum("pts,ptsa->a", weight, struck))


def by_share(evidence: Floats) -> Floats:
    """Log density of aircraft of which a share is struck, over that of nobody struck.

    Parameters
    ----------
    evidence : (..., A) float
        Log Bayes factor of each aircraft.

    Returns
    -------
    (P, ..., A) float
        For every share of :data:`SHARE_GRID`.
    """
    share = SHARE_GRID.reshape(-1, *([1] * evidence.ndim))
    # as np.logaddexp, which takes an exponential and a logarithm for every share, at a fifth
    top = np.maximum(evidence, 0.0)
    none, one = np.exp(-top), np.exp(evidence - top)
    return np.asarray(top + np.log((1 - share) * none + share * one))


def _size(joint: Floats, nobody: Floats, levels: Floats) -> float:
    """Root mean square background, somebody struck as likely as nobody beforehand."""
    by_level = np.logaddexp(
        np.logaddexp.reduce(joint, axis=(0, 2)) - np.log(joint[:, 0].size), nobody
    )
    weight = np.exp(by_level - by_level.max())
    return float(np.sqrt((weight * levels**2).sum() / weight.sum()))


def log_mean(values: Floats) -> float:
    """Logarithm of the mean of exponentials."""
    top = float(values.max())
    return top + float(np.log(np.mean(np.exp(values - top))))
