"""How much the data speak for a candidate: closed-form Gaussian evidence, tempered by clusters.

Assumptions: an estimate of an aircraft's coefficients is normal about the truth with covariance
``f I^-1 + P``. ``I`` is the conditional information; ``f`` the cluster factor, estimated from the
scatter of day and week scores about each aircraft's own fit and pooled over aircraft; ``P`` an
allowance for model error that persists over the archive, stated in m/s rms where the candidate
acts. Under the null the coefficients are zero; else normal with the prior scale of the catalogue
times a factor that is averaged over a grid.

Per-aircraft candidates are a spike-and-slab mixture: a share pi of aircraft is struck, pi averaged
over a grid. Fleet candidates have one set of coefficients. Evidence is in nats. *Raw* evidence
(ranking) takes one common factor for all candidates; *tempered* evidence (gates) the estimated one.

Source: GAP.md section 6; two-way clustering after Cameron, Gelbach & Miller (2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.candidates import Candidate
from airswing.gap.clusters import aircraft_factor, fleet_factor
from airswing.gap.measure import Conditional
from airswing.gap.small import inverse_and_logdet
from airswing.gap.statistics import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Factors on the prior scales over which evidence is averaged.
SCALE_GRID = np.array([0.08, 0.2, 0.5, 1.2, 3.0])
#: Shares of aircraft struck over which the mixture is averaged.
SHARE_GRID = np.array([0.03, 0.08, 0.2, 0.5, 0.8, 0.97])
#: Persistent model error allowed for, m/s rms where the candidate acts, in each direction; for the
#: fleet, of a column that the climatology takes up wholly.
AIRCRAFT_ALLOWANCE = 0.08  # and the little of every effect that every aircraft has
FLEET_ALLOWANCE = 0.09
#: Common cluster factor of raw evidence.
RAW_FACTOR = 1.5


@dataclass(frozen=True)
class Score:
    """Evidence for a candidate given what is included.

    Attributes
    ----------
    candidate : Candidate
    tempered, raw : float
        Log Bayes factor against nothing, nats.
    factor : float
        Cluster factor used.
    posterior : (A,)
        Probability per aircraft that it is struck (1 for all in fleet scope).
    aircraft_evidence : (A,)
        Tempered log Bayes factor per aircraft.
    estimate : (A, k)
        Estimates, shrunk by the prior.
    size : (A,)
        rms of the effect where it acts, m/s.
    acting : (A,)
        Reports on which it acts.
    period : (int, int) or None
        Day indices (first, one past the last) between which it acts; None: always.
    dates : (A, w) or None
        Log evidence of every window tried, per aircraft.
    novelty : float
        Of a dictionary group: tempered evidence beyond what steady sensor errors explain.
    """

    candidate: Candidate
    tempered: float
    raw: float
    factor: float
    posterior: Floats
    aircraft_evidence: Floats
    estimate: Floats
    size: Floats
    acting: Floats
    period: tuple[int, int] | None = None
    dates: Floats | None = None
    novelty: float = np.inf


def allowance_covariance(
    second: Floats, acting: Floats | float, size: float, scales: Floats
) -> Floats:
    """Covariance of coefficients whose effect is ``size`` m/s rms in each direction where it acts.

    Parameters
    ----------
    second : (..., k, k) float
        Unwhitened X'X.
    acting : (...) float
        Reports on which the candidate acts.
    size : float
        m s-1.
    scales : (k,) float
        Prior scales, to regularise.

    Returns
    -------
    (..., k, k) float
    """
    k = scales.size
    count = np.maximum(np.asarray(acting, float), 1.0)[..., None, None]
    scaled = second / count * np.outer(scales, scales)
    floor = 0.02 * np.trace(scaled, axis1=-2, axis2=-1) / k + 1e-12
    inverse, _ = inverse_and_logdet(scaled + floor[..., None, None] * np.eye(k))
    return np.asarray(size**2 * inverse * np.outer(scales, scales))


def gaussian_evidence(
    information: Floats, score: Floats, *, factor: float, allowance: Floats, prior: Floats
) -> tuple[Floats, Floats]:
    """Log Bayes factor of free coefficients against none, and the shrunk estimate.

    Parameters
    ----------
    information : (..., k, k) float
        Conditional X'X.
    score : (..., k) float
        Conditional X'r.
    factor : float
        Cluster factor.
    allowance : (..., k, k) float
        Covariance of persistent model error, in both hypotheses.
    prior : (k,) float
        Prior standard deviations of the coefficients.

    Returns
    -------
    log_bayes_factor : (...) float
    estimate : (..., k) float
        Posterior mean.

    Notes
    -----
    In units of the prior: theta_hat = I^-1 s, V = f I^-1 + P; the log ratio of
    N(theta_hat; 0, V + S) to N(theta_hat; 0, V). Directions without
    information drop out through a floor on I.
    """
    spread, hat = _own_fit(information, score, prior)
    variance = factor * spread + allowance / np.outer(prior, prior)
    value, estimate = _over_scales(hat, variance, np.ones(1))
    return value[0], prior * estimate[0]


def grid_evidence(
    information: Floats, score: Floats, *, factor: float, allowance: Floats, scales: Floats
) -> tuple[Floats, Floats, Floats]:
    """Tempered and raw evidence and estimates at every factor of :data:`SCALE_GRID`.

    Parameters
    ----------
    information, score, factor, allowance
        As in :func:`gaussian_evidence`.
    scales : (k,) float
        Prior standard deviations at factor 1.

    Returns
    -------
    tempered, raw : (S, ...) float
        With the estimated cluster factor and the allowance; with the common factor and none.
    estimate : (S, ..., k) float
        Posterior means, tempered.
    """
    spread, hat = _own_fit(information, score, scales)
    variance = factor * spread + allowance / np.outer(scales, scales)
    tempered, estimate = _over_scales(hat, variance, SCALE_GRID)
    raw, _ = _over_scales(hat, RAW_FACTOR * spread, SCALE_GRID)
    return tempered, raw, scales * estimate


def _own_fit(information: Floats, score: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """Inverse information and estimate, both in units of the prior."""
    k = prior.size
    own = information * np.outer(prior, prior)
    floor = 1e-4 * np.maximum(np.trace(own, axis1=-2, axis2=-1), 0.0) / k + 1e-9
    # where everything is explained by what is given, rounding may leave less than nothing
    nothing = np.linalg.eigvalsh(own)[..., 0] + floor <= 0.0
    own = np.where(nothing[..., None, None], 0.0, own) + floor[..., None, None] * np.eye(k)
    score = np.where(nothing[..., None], 0.0, score)
    spread, _ = inverse_and_logdet(own)
    return spread, np.einsum("...ij,...j->...i", spread, score * prior)


def _over_scales(hat: Floats, variance: Floats, grid: Floats) -> tuple[Floats, Floats]:
    """Evidence (S, ...) and posterior means (S, ..., k) for priors N(0, g^2) over a grid of g."""
    k = hat.shape[-1]
    square = (grid**2).reshape(-1, *([1] * (hat.ndim - 1)))
    inverse, logdet = inverse_and_logdet(variance)
    whole = np.einsum("...i,...ij,...j->...", hat, inverse, hat)
    wide = variance + square[..., None, None] * np.eye(k)
    inverse, wide_logdet = inverse_and_logdet(wide)
    solved = np.einsum("...ij,...j->...i", inverse, hat)
    inner = (solved * hat).sum(axis=-1)
    return 0.5 * (whole - inner - wide_logdet + logdet), square[..., None] * solved


def evaluate(
    stats: Statistics,
    given: Conditional,
    candidate: Candidate,
    *,
    allowed: NDArray[np.bool_] | None = None,
) -> Score:
    """Evidence of one candidate given the included columns.

    Parameters
    ----------
    stats : Statistics
    given : Conditional
    candidate : Candidate
    allowed : (A,) bool, optional
        Aircraft it may still strike; all by default.

    Returns
    -------
    Score
    """
    if candidate.scope == "fleet":
        return _evaluate_fleet(stats, given, candidate)
    return _evaluate_aircraft(stats, given, candidate, allowed)


def _sizes(stats: Statistics, candidate: Candidate) -> tuple[Floats, Floats]:
    """Unwhitened second moments (A, k, k) and acting counts (A,) of a candidate."""
    columns, total = candidate.columns, stats.day_count.sum(axis=1)
    if columns.max() < stats.layout.core:
        second = stats.raw_gram[:, columns[:, None], columns]
        return second, np.maximum(stats.acting[:, columns].max(axis=1), 0.0)
    wide = stats.whole_gram[:, columns[:, None], columns]
    trace = np.trace(wide, axis1=1, axis2=2)[:, None, None]
    second = np.divide(wide, trace, out=np.zeros_like(wide), where=trace > 0)
    return second * total[:, None, None], total


def rms(second: Floats, acting: Floats, coefficients: Floats) -> Floats:
    """Root mean square (m/s) of effects with these coefficients (A, k), where they act."""
    energy = np.einsum("ak,akl,al->a", coefficients, second, coefficients)
    return np.asarray(np.sqrt(np.maximum(energy, 0) / np.maximum(acting, 1.0)))


def fleet_allowance(given: Conditional, columns: Integers) -> float:
    """Persistent model error allowed for in a fleet-wide effect, m/s rms where it acts.

    What the climatology does not hold of the persistent error has its structure: it is met by a
    column in the measure in which the climatology itself takes the column up. An effect that
    changes sign with the heading or with the passing of weather averages it out.

    Parameters
    ----------
    given : Conditional
    columns : (k,) int

    Returns
    -------
    float
        :data:`FLEET_ALLOWANCE` times the root of the share of the columns' X'X taken.
    """
    return FLEET_ALLOWANCE * float(np.sqrt(given.lasting_share[columns].mean()))


def _evaluate_fleet(stats: Statistics, given: Conditional, candidate: Candidate) -> Score:
    columns, aircraft = candidate.columns, len(stats.tails)
    pick = np.ix_(columns, columns)
    information, score = given.fleet_gram[pick], given.fleet_score[:, columns].sum(axis=0)
    factor = fleet_factor(stats, given, columns)
    second, acting = _sizes(stats, candidate)
    allowance = allowance_covariance(
        second.sum(axis=0), float(acting.sum()), fleet_allowance(given, columns), candidate.scales
    )
    tempered, raw, estimates = grid_evidence(
        information, score, factor=factor, allowance=allowance, scales=candidate.scales
    )
    estimate = np.tile(estimates[int(np.argmax(tempered))], (aircraft, 1))
    total = log_mean(tempered)
    return Score(
        candidate, total, log_mean(raw), factor, np.ones(aircraft),
        np.full(aircraft, total), estimate, rms(second, acting, estimate), acting,
    )  # fmt: skip


def _evaluate_aircraft(
    stats: Statistics, given: Conditional, candidate: Candidate, allowed: NDArray[np.bool_] | None
) -> Score:
    columns, aircraft = candidate.columns, len(stats.tails)
    factor = aircraft_factor(stats, given, columns)
    second, acting = _sizes(stats, candidate)
    live = acting >= 20
    if allowed is not None:
        live &= allowed
    tempered, raw = np.zeros((2, SCALE_GRID.size, aircraft))
    estimates = np.zeros((SCALE_GRID.size, aircraft, columns.size))
    information = given.gram[:, columns[:, None], columns][live]
    score = given.score[:, :, columns].sum(axis=1)[live]
    allowance = allowance_covariance(
        second[live], acting[live], AIRCRAFT_ALLOWANCE, candidate.scales
    )
    if live.any():
        tempered[:, live], raw[:, live], estimates[:, live] = grid_evidence(
            information, score, factor=factor, allowance=allowance, scales=candidate.scales
        )
    total, posterior, best = mixture(tempered)
    whole, _, _ = mixture(raw)
    estimate = estimates[best]
    return Score(
        candidate, total, whole, factor, posterior, tempered[best], estimate,
        rms(second, acting, estimate), acting,
    )  # fmt: skip


def mixture(evidence: Floats) -> tuple[float, Floats, int]:
    """Spike-and-slab mixture over aircraft, averaged over prior scale and share struck.

    Parameters
    ----------
    evidence : (S, A) float
        Log Bayes factor per prior scale and aircraft.

    Returns
    -------
    total : float
        Log evidence against nobody struck.
    posterior : (A,) float
        Probability that each aircraft is struck, given that the candidate is at work.
    best : int
        Prior scale of the highest evidence.
    """
    share = SHARE_GRID[:, None, None]
    each = np.logaddexp(np.log1p(-share), np.log(share) + evidence[None])
    joint = each.sum(axis=2)
    weight = np.exp(joint - joint.max())
    weight /= weight.sum()
    struck = np.exp(np.log(share) + evidence[None] - each)
    posterior = np.einsum("ps,psa->a", weight, struck)
    return log_mean(joint.ravel()), posterior, int(np.argmax(joint.max(axis=0)))


def log_mean(values: Floats) -> float:
    """Logarithm of the mean of exponentials."""
    top = float(values.max())
    return top + float(np.log(np.mean(np.exp(values - top))))
