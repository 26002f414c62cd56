"""How much the data speak for a candidate: closed-form Gaussian evidence, tempered by clusters.

Assumptions: an estimate of an aircraft's coefficients is normal about the truth with covariance
``f I^-1 + P``. ``I`` is the conditional information; ``f`` the cluster factor, estimated from the
scatter of day and week scores about each aircraft's own fit and pooled over aircraft; ``P`` the
background: model error that persists over the archive and the little of every effect that every
aircraft has, stated in m/s rms where the candidate acts. Under the null the coefficients are zero;
else normal with a width that is averaged over a grid: of single aircraft in m/s where the candidate
acts, from the smallest size that matters in practice, so that it is no second background; of the
fleet, and for raw evidence, the prior scale of the catalogue times a factor.

Per-aircraft candidates are a spike-and-slab mixture: a share pi of aircraft is struck, pi averaged
over a grid. How large the background is the fleet itself tells, candidate by candidate: its size is
averaged over (:mod:`airswing.gap.background`), in the mixture as in the null, so that a scatter all
aircraft share is background as far as that is plausible and an effect from there on. Fleet
candidates have one set of coefficients and a fixed allowance. Evidence is in nats. *Raw* evidence
(ranking) knows neither factor nor background; *tempered* evidence (gates) takes the estimated ones.

Source: GAP.md section 6; two-way clustering after Cameron, Gelbach & Miller (2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airswing.gap.background import GRID, either, whole_prior
from airswing.gap.candidates import Candidate
from airswing.gap.clusters import aircraft_factor, fleet_factor
from airswing.gap.measure import Conditional
from airswing.gap.mixture import log_mean, mixture
from airswing.gap.sharing import shifts
from airswing.gap.small import inverse_and_logdet
from airswing.gap.statistics import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Factors on the prior scales over which evidence is averaged.
SCALE_GRID = np.array([0.08, 0.2, 0.5, 1.2, 3.0])
#: Sizes of an effect of single aircraft, m/s rms in each direction, averaged over likewise.
SIZE_GRID = np.array([0.2, 0.4, 0.8, 1.6, 3.2])
#: Reports on which a candidate must act to be looked at in an aircraft.
LEAST_ACTING = 20
#: Persistent model error allowed for in the fleet, m/s rms, of a column that the climatology takes
#: up wholly. Of winds along the grid, of which it takes three quarters, 88 simulated archives
#: without scattered by 0.10 m/s more than the noise made them.
FLEET_ALLOWANCE = 0.12


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
    novelty : float
        Of a dictionary group: tempered evidence beyond what steady sensor errors explain.
    background : float
        Size of the background where it acts, m/s rms in each direction.
    remainder : (A,) or 0
        What the columns of the included effects cannot carry of these, m/s where it acts.
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
    novelty: float = np.inf
    background: float = 0.0
    remainder: Floats | float = 0.0


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
    value, estimate, _ = _over_scales(hat, variance, np.eye(prior.size), np.ones(1))
    return value[0], prior * estimate[0]


@dataclass(frozen=True)
class GridEvidence:
    """Evidence of free coefficients at every width of the prior (S of them).

    Attributes
    ----------
    tempered, raw : (S, ...) float
        With the estimated cluster factor and the allowance; with neither.
    estimate : (S, ..., k) float
        Posterior means, tempered.
    nothing : (...) float
        Log density of the estimates where nothing but errors and the allowance are at work, up to a
        constant that the allowance does not change.
    """

    tempered: Floats
    raw: Floats
    estimate: Floats
    nothing: Floats


def grid_evidence(
    information: Floats,
    score: Floats,
    *,
    factor: float,
    allowance: Floats,
    scales: Floats,
    unit: Floats | None = None,
) -> GridEvidence:
    """Tempered and raw evidence and estimates at every width of the prior.

    Parameters
    ----------
    information, score, factor, allowance
        As in :func:`gaussian_evidence`; the allowance may have further axes in front.
    scales : (k,) float
        Prior standard deviations at factor 1 of :data:`SCALE_GRID`.
    unit : (..., k, k) float, optional
        Covariance of coefficients whose effect is 1 m/s: tempered evidence and estimates take
        :data:`SIZE_GRID` times it instead.

    Returns
    -------
    GridEvidence
    """
    spread, hat = _own_fit(information, score, scales)
    both, eye = np.outer(scales, scales), np.eye(scales.size)
    raw, _, _ = _over_scales(hat, spread, eye, SCALE_GRID)
    tempered, estimate, nothing = _over_scales(
        hat,
        factor * spread + allowance / both,
        eye if unit is None else unit / both,
        SCALE_GRID if unit is None else SIZE_GRID,
    )
    return GridEvidence(tempered, raw, scales * estimate, nothing)


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


def _over_scales(
    hat: Floats, variance: Floats, unit: Floats, grid: Floats
) -> tuple[Floats, Floats, Floats]:
    """Evidence (S, ...), posterior means (S, ..., k) for priors N(0, g^2 unit), log density."""
    square = (grid**2).reshape(-1, *([1] * variance.ndim))
    inverse, logdet = inverse_and_logdet(variance)
    whole = np.einsum("...i,...ij,...j->...", hat, inverse, hat)
    slab = square * unit
    inverse, wide_logdet = inverse_and_logdet(variance + slab)
    solved = np.einsum("...ij,...j->...i", inverse, hat)
    inner = (solved * hat).sum(axis=-1)
    evidence = 0.5 * (whole - inner - wide_logdet + logdet)
    estimate = np.einsum("...ij,...j->...i", slab, solved)
    return evidence, estimate, -0.5 * (whole + logdet)


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
    found = grid_evidence(
        information, score, factor=factor, allowance=allowance, scales=candidate.scales
    )
    estimate = np.tile(found.estimate[int(np.argmax(found.tempered))], (aircraft, 1))
    total = log_mean(found.tempered)
    return Score(
        candidate, total, log_mean(found.raw), factor, np.ones(aircraft),
        np.full(aircraft, total), estimate, rms(second, acting, estimate), acting,
    )  # fmt: skip


def _evaluate_aircraft(
    stats: Statistics, given: Conditional, candidate: Candidate, allowed: NDArray[np.bool_] | None
) -> Score:
    found = _aircraft_evidence(stats, given, candidate)
    second, acting = _sizes(stats, candidate)
    asked = acting >= LEAST_ACTING if allowed is None else (acting >= LEAST_ACTING) & allowed
    # the background is told by all aircraft; those not asked about may be struck or not
    found.nothing[:, ~asked] += either(found.tempered[..., ~asked])
    found.tempered[..., ~asked], found.raw[..., ~asked] = 0.0, 0.0
    mixed = mixture(
        found.tempered, found.nothing, found.prior(given, candidate), found.levels
    )  # fmt: skip
    estimate = found.estimates[mixed.best]
    return Score(
        candidate, mixed.total, mixture(found.raw).total, found.factor, mixed.posterior,
        found.tempered[mixed.best], estimate, rms(second, acting, estimate), acting,
        background=mixed.background,
    )  # fmt: skip


@dataclass(frozen=True)
class _Aircraft:
    """Evidence about single aircraft at every state (T of them): background times shift.

    Attributes
    ----------
    tempered : (T, S, A) float
    nothing : (T, A) float
    raw : (1, S, A) float
    estimates : (T, S, A, k) float
    factor : float
    shift_weight : (C,) float
        Log weight of each shift of the fleet; one of 0 where aircraft share nothing.
    """

    tempered: Floats
    nothing: Floats
    raw: Floats
    estimates: Floats
    factor: float
    shift_weight: Floats

    @property
    def levels(self) -> Floats:
        """Size of the background in every state, (T,)."""
        return np.tile(GRID, self.shift_weight.size)

    def prior(self, given: Conditional, candidate: Candidate) -> Floats:
        """Log weight of every state, (T,)."""
        told = whole_prior() if given.background is None else None
        if told is None:
            told = given.background[int(candidate.heading)]  # type: ignore[index]
        return np.asarray((self.shift_weight[:, None] + told).ravel())


def _aircraft_evidence(stats: Statistics, given: Conditional, candidate: Candidate) -> _Aircraft:
    """Evidence of each aircraft by background and, where aircraft share much, by shift."""
    columns, aircraft = candidate.columns, len(stats.tails)
    pick = np.ix_(columns, columns)
    factor = aircraft_factor(stats, given, columns)
    second, acting = _sizes(stats, candidate)
    live = acting >= LEAST_ACTING
    information = given.gram[:, columns[:, None], columns]
    score = given.score[:, :, columns].sum(axis=1)
    shared = None
    if columns.size == 1:
        own = np.where(live, information[:, 0, 0], 0.0)
        shared = shifts(own, score[:, 0], float(given.fleet_gram[pick][0, 0]), factor)
    values = np.zeros(1) if shared is None else shared.values
    weight = np.zeros(1) if shared is None else shared.log_weight
    states, widths = values.size * GRID.size, SIZE_GRID.size
    out = _Aircraft(
        np.zeros((states, widths, aircraft)), np.zeros((states, aircraft)),
        np.zeros((1, SCALE_GRID.size, aircraft)),
        np.zeros((states, widths, aircraft, columns.size)), factor, weight,
    )  # fmt: skip
    if not live.any():
        return out
    unit = allowance_covariance(second[live], acting[live], 1.0, candidate.scales)
    allowance = (GRID**2)[:, None, None, None] * unit
    tempering = partial(
        grid_evidence, factor=factor, scales=candidate.scales, unit=unit, allowance=allowance
    )
    out.raw[0][:, live] = tempering(information[live], score[live]).raw
    own = information if shared is None else shared.own[:, None, None]
    for c, value in enumerate(values):
        state = slice(c * GRID.size, (c + 1) * GRID.size)
        found = tempering(own[live], score[live] + value * own[live][..., 0])
        out.tempered[state][:, :, live] = found.tempered.swapaxes(0, 1)
        out.estimates[state][:, :, live] = found.estimate.swapaxes(0, 1)
        out.nothing[state][:, live] = found.nothing
    return out


def background_likelihood(stats: Statistics, given: Conditional, candidate: Candidate) -> Floats:
    """Log density of all aircraft's estimates at every size of the background, (T,).

    Parameters
    ----------
    stats : Statistics
    given : Conditional
    candidate : Candidate
        Of single aircraft.

    Returns
    -------
    (T,) float
    """
    found = _aircraft_evidence(stats, given, candidate)
    each = (found.nothing + either(found.tempered)).sum(axis=1).reshape(-1, GRID.size)
    return np.asarray(np.logaddexp.reduce(each + found.shift_weight[:, None], axis=0))
