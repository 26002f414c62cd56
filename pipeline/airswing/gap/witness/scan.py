"""How much the data speak for a table: of the fleet, or of single aircraft.

Assumptions: given everything the reference does, the values of a table's cells are normal about
nothing with the table's prior, of a size that is averaged over; under the null they have the same
form and a size of persistent error. Scores scatter by the cluster factor more than the noise model
says.

Validity: closed forms; cells without reports drop out by their prior.

Units: nats; m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.cluster_inflation import cluster_factor
from airswing.gap.witness.ground import Sums

Floats = NDArray[np.float64]

#: Sizes of a cell's value that are averaged over, m/s.
SIZES = np.array([0.15, 0.4, 1.0, 2.5])
#: Odds of an aircraft to be struck that are averaged over.
SHARES = np.array([0.04, 0.1, 0.25, 0.5, 0.8])


@dataclass(frozen=True)
class Weighed:
    """Evidence for a table, of every residual (R of them)."""

    # fleet, single: (R,): log Bayes factor of one table for all, and of tables of some aircraft's
    # own, nats
    fleet: Floats
    single: Floats
    by_aircraft: Floats  # (R, A)
    # fleet_factor, factor: cluster factors, of the real residual
    fleet_factor: float
    factor: float
    value: Floats  # (A, k): posterior mean of the real residual's tables


def evidence(
    gram: Floats, score: Floats, prior: Floats, *, error: float, factor: Floats
) -> tuple[Floats, Floats]:
    """Log Bayes factor of a table against none and its posterior mean.

    Parameters
    ----------
    gram : (k, k) float
    score : (R, k) float
    prior : (k, k) float
        Correlation.
    error : float
        Size of persistent error, m/s, under both hypotheses.
    factor : (R,) float
        Cluster factor of each.

    Returns
    -------
    log_bayes_factor : (R,) float
    mean : (R, k) float
    """
    # a smooth prior has next to nothing in its roughest direction: a root needs all of them
    root = np.linalg.cholesky(prior + 1e-9 * np.eye(prior.shape[0]))
    values, vectors = np.linalg.eigh(root.T @ gram @ root)
    values = np.maximum(values, 0.0)
    turned = (score @ root) @ vectors
    out = np.empty((SIZES.size, score.shape[0]))
    means = np.empty((SIZES.size, *score.shape))
    scaled, told = values / factor[:, None], turned**2 / factor[:, None] ** 2
    for s, size in enumerate(SIZES):
        narrow = scaled * (1 + scaled * error**2)
        wide = scaled * (1 + scaled * (error**2 + size**2))
        # directions that nothing tells add no evidence, and would divide nought by nought
        safe = scaled > 1e-9
        gain = told / np.where(safe, narrow, 1.0) - told / np.where(safe, wide, 1.0)
        gain -= np.log(np.where(safe, wide, 1.0) / np.where(safe, narrow, 1.0))
        out[s] = 0.5 * np.where(safe, gain, 0.0).sum(axis=1)
        shrunk = size**2 * (turned / factor[:, None]) / (1 + scaled * (size**2 + error**2))
        means[s] = shrunk @ vectors.T @ root.T
    best = np.argmax(out, axis=0)
    total = np.logaddexp.reduce(out, axis=0) - np.log(SIZES.size)
    return total, means[best, np.arange(score.shape[0])]


def weigh(
    sums: Sums, prior: Floats, *, fleet_error: float, error: float, spread: float = 1.0
) -> Weighed:
    """Weigh a table on the sums of an archive.

    Parameters
    ----------
    prior : (k, k) float
    fleet_error, error : float
        Persistent error of the fleet and of single aircraft, m/s.
    spread : float
        What multiplies the cluster factors (where a mean of simulated scores was taken off).
    """
    count = sums.score.shape[0]
    whole = sums.score.sum(axis=1)
    fleet_factor = np.array([_fleet_factor(sums, whole[r]) for r in range(count)]) * spread
    single = sums.score if sums.apart is None else sums.apart
    factor = np.array([own_factor(sums, single[r]) for r in range(count)]) * spread
    fleet, _ = evidence(
        sums.fleet_gram, whole.sum(axis=1), prior, error=fleet_error, factor=fleet_factor
    )
    aircraft = sums.gram.shape[0]
    by_aircraft = np.zeros((count, aircraft))
    value = np.zeros((aircraft, prior.shape[0]))
    for a in range(aircraft):
        by_aircraft[:, a], own = evidence(
            sums.gram[a], single[:, a].sum(axis=1), prior, error=error, factor=factor
        )
        value[a] = own[0]
    mixed = [
        np.logaddexp(np.log1p(-share), np.log(share) + by_aircraft).sum(axis=1) for share in SHARES
    ]
    some = np.logaddexp.reduce(mixed, axis=0) - np.log(SHARES.size)
    return Weighed(fleet, some, by_aircraft, float(fleet_factor[0]), float(factor[0]), value)


def _fleet_factor(sums: Sums, score: Floats) -> float:
    values = cluster_factor(sums.fleet_days, score, sums.fleet_gram)
    finite = values[np.isfinite(values)]
    # a fleet's days go together more than one aircraft's; where no day tells how much, twice
    return max(1.2, float(finite.max())) if finite.size else 2.0


def own_factor(sums: Sums, score: Floats) -> float:
    """Cluster factor of single aircraft's scores, (A, D, k), the median one."""
    flown = np.trace(sums.gram, axis1=1, axis2=2) > 1e-6
    if not flown.any():
        return 1.5
    values = sums.scatter_of(score)[flown]
    middle = [np.median(c[np.isfinite(c)]) for c in values.T if np.isfinite(c).any()]
    # reports are never worth more than they are; unknown, half as much again
    return max(1.0, float(np.max(middle))) if middle else 1.5
