"""How much the data speak for a candidate: closed-form Gaussian evidence, tempered by clusters.

Assumptions: an estimate of an aircraft's coefficients is normal about the truth with covariance
``f I^-1 + P``. ``I`` is the conditional information; ``f`` the cluster factor, estimated from the
scatter of day and week scores about each aircraft's own fit and pooled over aircraft; ``P`` the
background: model error that persists over the archive and the little of every effect that every
aircraft has, stated in m/s rms where the candidate acts. Under the null the coefficients are zero;
else normal with a width that is averaged over a grid: of single aircraft in m/s where the candidate
acts, from the smallest size that matters in practice, so that it is no second background; of the
fleet, and for raw evidence, the prior scale of the catalogue times a factor.

Evidence is in nats. *Raw* evidence (ranking) knows neither factor nor background; *tempered*
evidence (gates) takes the estimated ones. Who is struck, and by how much of a background,
:mod:`airswing.gap.evidence.of_candidate` puts together.

Source: docs/gap.md section 6; two-way clustering after Cameron, Gelbach & Miller (2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.small_matrices import inverse_and_logdet, solved_and_logdet
from airswing.gap.sums.accumulate import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Factors on the prior scales over which evidence is averaged.
SCALE_GRID = np.array([0.08, 0.2, 0.5, 1.2, 3.0])
#: Sizes of an effect of single aircraft, m/s rms in each direction, averaged over likewise.
SIZE_GRID = np.array([0.2, 0.4, 0.8, 1.6, 3.2])
#: Share by which coefficients differ that are the same: a type's units err alike, told unalike.
ABOUT = 0.2
#: Prior odds against whatever is told on its evidence alone, not held against days left out.
PRIOR_ODDS = 50.0
#: Probability of such a claim whose evidence leaves no doubt. Of names told so in four blind checks
#: (gross errors, coding, exchanges; seeds 274811, 415092, 862129, 553318) 21 of 22 were right, of
#: the unknowns that no effect of the catalogue comes near 18 of 19.
SUREST = 0.97


def plain_probability(nats: float) -> float:
    """Probability of what has this evidence alone."""
    # beyond fifty nats nothing changes, and the exponential would overflow
    return float(SUREST / (1 + PRIOR_ODDS * np.exp(-np.clip(nats, -50.0, 50.0))))


def luck(nats: float) -> float:
    """Probability at most that the strongest evidence of all is chance."""
    # from nil on: what speaks against it is no more than certain to be luck
    return float(min(1.0, PRIOR_ODDS * np.exp(-np.clip(nats, 0, 60))))


@dataclass(frozen=True)
class Score:
    """Evidence for a candidate given what is included."""

    candidate: Candidate
    # tempered, raw: log Bayes factor against nothing, nats
    tempered: float
    raw: float
    factor: float  # cluster factor used
    posterior: Floats  # (A,): probability per aircraft that it is struck (1 for all in fleet scope)
    aircraft_evidence: Floats  # (A,): tempered log Bayes factor per aircraft
    estimate: Floats  # (A, k): estimates, shrunk by the prior
    size: Floats  # (A,): rms of the effect where it acts, m/s
    acting: Floats  # (A,): reports on which it acts
    # day indices (first, one past the last) between which it acts; None: always
    period: tuple[int, int] | None = None
    # of a dictionary group: tempered evidence beyond what steady sensor errors explain
    novelty: float = np.inf
    background: float = 0.0  # size of the background where it acts, m/s rms in each direction
    # (A,) or 0; what the columns of the included effects cannot carry of these, m/s where it acts
    remainder: Floats | float = 0.0
    # that the name is right, once it was held against days left out
    probability: float | None = None


def allowance_covariance(
    second: Floats, acting: Floats | float, size: Floats | float, scales: Floats
) -> Floats:
    """Covariance of coefficients whose effect is ``size`` m/s rms in each direction where it acts.

    Parameters
    ----------
    second : (..., k, k) float
        Unwhitened X'X.
    acting : (...) float
        Reports on which the candidate acts.
    size : (...) float
        m s-1.
    scales : (..., k) float
        Prior scales, to regularise.

    Returns
    -------
    (..., k, k) float
    """
    k, both = scales.shape[-1], _outer(scales)
    count = np.maximum(np.asarray(acting, float), 1.0)[..., None, None]
    scaled = second / count * both
    # in a direction in which it hardly acts, 1 m/s would take any coefficient
    floor = 0.02 * np.trace(scaled, axis1=-2, axis2=-1) / k + 1e-12
    inverse, _ = inverse_and_logdet(scaled + floor[..., None, None] * np.eye(k))
    return np.asarray(np.square(size)[..., None, None] * inverse * both)


def log_prior_of_sizes(values: Floats) -> Floats:
    """Log probability (V,) of evenly spread values, m/s: normal, of the widths of `SIZE_GRID`."""
    each = np.exp(-0.5 * np.square(values / SIZE_GRID[:, None])) / SIZE_GRID[:, None]
    density = each.mean(axis=0) * np.abs(values)  # they are spread by their logarithm
    return np.asarray(np.log(density / density.sum()))


def _outer(scales: Floats) -> Floats:
    """Products of scales (..., k) with each other, (..., k, k)."""
    return np.asarray(scales[..., :, None] * scales[..., None, :])


@dataclass(frozen=True)
class OwnFit:
    """Least-squares fit of coefficients, in units of their prior scales."""

    spread: Floats  # (..., k, k): inverse information
    hat: Floats  # (..., k): estimates
    scales: Floats  # (..., k): prior standard deviations


def own_fit(information: Floats, score: Floats, scales: Floats) -> OwnFit:
    """Fit coefficients to their sums.

    Parameters
    ----------
    information : (..., k, k) float
        Conditional X'X.
    score : (..., k) float
        Conditional X'r; may have further axes in front.
    scales : (..., k) float
        Prior standard deviations of the coefficients.

    Returns
    -------
    OwnFit
        Directions without information drop out through a floor on the information.
    """
    k = scales.shape[-1]
    own = information * _outer(scales)
    # sums are of single precision in part: less than this share of the mean direction is rounding
    floor = 1e-4 * np.maximum(np.trace(own, axis1=-2, axis2=-1), 0.0) / k + 1e-9
    whole = own + floor[..., None, None] * np.eye(k)
    score = score * scales
    try:  # a factor costs a third of the eigenvalues, and nearly always there is one
        np.linalg.cholesky(whole)
    except np.linalg.LinAlgError:
        # where everything is explained by what is given, rounding may leave less than nothing
        nothing = np.linalg.eigvalsh(own)[..., 0] + floor <= 0.0
        whole = np.where(nothing[..., None, None], floor[..., None, None] * np.eye(k), whole)
        score = np.where(nothing[..., None], 0.0, score)
    spread, _ = inverse_and_logdet(whole)
    return OwnFit(spread, np.einsum("...ij,...j->...i", spread, score), scales)


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
    N(theta_hat; 0, V + S) to N(theta_hat; 0, V).
    """
    fit = own_fit(information, score, prior)
    variance = factor * fit.spread + allowance / _outer(prior)
    value, estimate, _ = _over_scales(fit.hat, variance, np.eye(prior.size), np.ones(1))
    return value[0], prior * estimate[0]


@dataclass(frozen=True)
class GridEvidence:
    """Tempered evidence of free coefficients at every width of the prior (S of them)."""

    tempered: Floats  # (S, ...)
    estimate: Floats  # (S, ..., k): posterior means
    # (...): log density of the estimates where nothing but errors and the allowance are at work, up
    # to a constant that the allowance does not change
    nothing: Floats


def grid_evidence(
    fit: OwnFit, *, factor: Floats | float, allowance: Floats, unit: Floats | None = None
) -> GridEvidence:
    """Tempered evidence and estimates at every width of the prior.

    Parameters
    ----------
    factor, allowance
        As in :func:`gaussian_evidence`; the factor may be (...), the allowance have further axes in
        front.
    unit : (..., k, k) float, optional
        Covariance of coefficients whose effect is 1 m/s: :data:`SIZE_GRID` times it are the widths
        instead of :data:`SCALE_GRID` times the prior scales.
    """
    both, eye = _outer(fit.scales), np.eye(fit.scales.shape[-1])
    tempered, estimate, nothing = _over_scales(
        fit.hat,
        np.asarray(factor)[..., None, None] * fit.spread + allowance / both,
        eye if unit is None else unit / both,
        SCALE_GRID if unit is None else SIZE_GRID,
    )
    return GridEvidence(tempered, fit.scales * estimate, nothing)


def raw_evidence(fit: OwnFit) -> Floats:
    """Evidence with neither cluster factor nor allowance at every width of the prior, (S, ...)."""
    return _over_scales(fit.hat, fit.spread, np.eye(fit.scales.shape[-1]), SCALE_GRID)[0]


def evidence_over_backgrounds(
    fit: OwnFit, *, factor: Floats | float, unit: Floats, levels: Floats
) -> tuple[Floats, Floats, Floats]:
    """Tempered evidence of single aircraft at every size of the background (T of them).

    Parameters
    ----------
    fit : OwnFit
        Of scores in C versions, (C, ..., k).
    factor : (...) float
        Cluster factor.
    unit : (..., k, k) float
        Covariance of coefficients whose effect is 1 m/s.
    levels : (T,) float
        Sizes of the background, m/s.

    Returns
    -------
    tempered : (S, C, T, ...) float
        At every width of :data:`SIZE_GRID`.
    estimate : (S, C, T, ..., k) float
        Posterior means.
    nothing : (C, T, ...) float
        As in :class:`GridEvidence`.

    Notes
    -----
    What :func:`grid_evidence` gives of the allowances ``levels^2 unit``. Every covariance is a
    multiple of I^-1 and one of ``unit``: in the basis in which both are diagonal all of them are.
    """
    half = np.linalg.cholesky(unit / _outer(fit.scales))
    back = np.linalg.inv(half)
    values, vectors = np.linalg.eigh(back @ fit.spread @ back.swapaxes(-1, -2))
    turned = ((vectors.swapaxes(-1, -2) @ back) @ fit.hat[..., None])[..., 0][:, None]
    further = [1] * values.ndim
    own = np.asarray(factor)[..., None] * values + np.square(levels).reshape(-1, *further)
    slab = np.square(SIZE_GRID).reshape(-1, 1, 1, *further)
    wide = own + slab
    square = turned**2
    whole = (square / own).sum(axis=-1)
    # one logarithm of a product of at most eight numbers of like size, not eight logarithms
    logdet = np.log(own.prod(axis=-1))
    tempered = whole - (square / wide).sum(axis=-1) + logdet - np.log(wide.prod(axis=-1))
    estimate = np.einsum("...ij,...j->...i", half @ vectors, slab / wide * turned)
    logdet = logdet + 2 * np.log(np.diagonal(half, axis1=-2, axis2=-1)).sum(axis=-1)
    return 0.5 * tempered, fit.scales * estimate, -0.5 * (whole + logdet)


def evidence_of_same(
    fit: OwnFit, *, factor: Floats | float, unit: Floats, levels: Floats, values: Floats
) -> Floats:
    """Tempered evidence that one coefficient is about a given value, by size of the background.

    Parameters
    ----------
    fit : OwnFit
        Of one coefficient, (C, ..., 1).
    factor, unit, levels
        As in :func:`evidence_over_backgrounds`.
    values : (V, ...) float
        Of the coefficient; each aircraft's own is within :data:`ABOUT` of it.

    Returns
    -------
    (V, C, T, ...) float
        Log ratio of N(t; v, E + (ABOUT v)^2) to N(t; 0, E), E of errors and background.
    """
    hat = (fit.hat * fit.scales)[..., 0][:, None]
    error = np.asarray(factor) * (fit.spread * _outer(fit.scales))[..., 0, 0]
    error = error + np.square(levels).reshape(-1, *[1] * error.ndim) * unit[..., 0, 0]
    at = values[:, None, None]
    wide = error + (ABOUT * at) ** 2
    return 0.5 * np.asarray(hat**2 / error - (hat - at) ** 2 / wide + np.log(error / wide))


def _over_scales(
    hat: Floats, variance: Floats, unit: Floats, grid: Floats
) -> tuple[Floats, Floats, Floats]:
    """Evidence (S, ...), posterior means (S, ..., k) for priors N(0, g^2 unit), log density."""
    _, whole, logdet = solved_and_logdet(variance, hat)
    slab = (grid**2).reshape(-1, *([1] * variance.ndim)) * unit
    solved, inner, wide_logdet = solved_and_logdet(variance + slab, hat)
    evidence = 0.5 * (whole - inner - wide_logdet + logdet)
    estimate = np.einsum("...ij,...j->...i", slab, solved)
    return evidence, estimate, -0.5 * (whole + logdet)


def sizes(stats: Statistics, columns: Integers) -> tuple[Floats, Floats]:
    """Unwhitened second moments of columns, and the reports on which they act.

    Parameters
    ----------
    columns : (..., k) int
        All in the layout's core, or none.

    Returns
    -------
    second : (..., A, k, k) float
    acting : (..., A) float
    """
    rows, along = columns[..., :, None], columns[..., None, :]
    if columns.max() < stats.layout.core:
        second = np.moveaxis(stats.raw_gram[:, rows, along], 0, -3)
        acting = np.maximum(stats.acting[:, columns].max(axis=-1), 0.0)
        return second, np.moveaxis(acting, 0, -1)
    wide = np.moveaxis(stats.whole_gram[:, rows, along], 0, -3)
    trace = np.trace(wide, axis1=-2, axis2=-1)[..., None, None]
    second = np.divide(wide, trace, out=np.zeros_like(wide), where=trace > 0)
    total = stats.day_count.sum(axis=1)
    return second * total[:, None, None], np.broadcast_to(total, second.shape[:-2])


def rms(second: Floats, acting: Floats, coefficients: Floats) -> Floats:
    """Root mean square (m/s) of effects with these coefficients (..., A, k), where they act."""
    energy = np.einsum("...k,...kl,...l->...", coefficients, second, coefficients)
    return np.asarray(np.sqrt(np.maximum(energy, 0) / np.maximum(acting, 1.0)))
