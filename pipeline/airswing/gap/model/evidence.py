"""Log evidence of candidates: spike and slab over aircraft, a common part, dates, exchanges.

The likelihood of scores U~_a = G_a (theta_a + theta_F) + N(0, kappa G_a) by aircraft, the priors of
the scopes, of changes in a period and of exchanged identifiers are those of docs/gap.md, section 4.

Source: Mitchell and Beauchamp (1988), J. Am. Stat. Assoc. 83, 1023-1032 (spike and slab); Zellner
(1986), On assessing prior distributions with g-prior distributions, Elsevier, 233-243.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from airswing.gap.arrays import Booleans, Integers
from airswing.gap.model.candidates import Group
from airswing.gap.model.sums import SIDES
from airswing.gap.model.terms import BLOCKS, WIDE, Model, Statistics, cluster_factor, number_prior

Floats = NDArray[Any]
#: Logarithm of a sum of exponentials, along the first axis or another.
log_sum = np.logaddexp.reduce

#: Scales of the slab, m/s rms where a candidate acts, from half a knot to `WIDE` in steps of three:
#: half a step off costs 0.1 nat a coefficient. A scale below an effect's size would favour the
#: effect divided among several terms.
SCALES = np.array([0.3, 0.9, 2.7, WIDE])
#: Least m, m/s: the error that no aircraft is free of. On simulated archives without an effect m is
#: 0.00 to 0.01 m/s; three times that allows for errors that no simulation contains.
SMALL = 0.03
#: Posterior probability from which an aircraft is stated as affected.
INCLUDED = 0.75
#: Shares of affected aircraft that the Beta prior is integrated over.
SHARES = np.linspace(0.02, 0.98, 25)
#: Ratio of the spread of aircraft with one fault to its size: units of one make differ little.
SPREAD = 0.25
#: Share of the unit matrix in the shape of a prior, so that it has an inverse.
SLIGHT = 1e-4


@dataclass(frozen=True)
class ScopeEvidence:
    """Evidence of a candidate in one scope."""

    evidence: float  # log Bayes factor against no effect, over scales and sets of aircraft
    scale: float  # most probable s, m/s
    tails: tuple[int, ...]  # aircraft affected with the probability `INCLUDED` and more
    inclusion: Floats  # (A,): posterior probability of each
    spread: float = 0.0  # `SPREAD` where the affected share a mean, otherwise 0
    # of a dated candidate: stretches of days from and before which each affected aircraft has the
    # change; prior precision for s = 1, (m, m)
    period: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    shape: Floats | None = None


def common_variance(stats: Statistics) -> tuple[Floats, Floats]:
    """T and T0 of the module, (m, m)."""
    m = stats.score.shape[1]
    given_back = stats.fleet_inverse - np.linalg.inv(stats.information.sum(axis=0) + stats.ridge)
    uneven = max(0.0, stats.fleet_factor - 1.0) * stats.fleet_inverse
    lasting = max(stats.lasting + float(np.mean(stats.remainder)), 1e-6)
    total = given_back + uneven + lasting * np.eye(m)
    values, vectors = np.linalg.eigh((total + total.T) / 2)
    # differences of inverses may come out below nothing by rounding
    return (vectors * np.clip(values, lasting, 1e6)) @ vectors.T, given_back


class _Common:
    """Integrates the common part, given aircraft whose individual parts are integrated.

    An aircraft with its individual part integrated is a Gaussian in the common part phi,
    exp(l + j'phi - phi'J phi / 2). Leading axes are several cases: scales, dates, sets of aircraft.
    """

    def __init__(self, variance: Floats) -> None:
        self.inverse = np.linalg.inv(variance)
        self.log_det = np.linalg.slogdet(variance)[1]

    def total(self, level: Floats, score: Floats, information: Floats) -> Floats:
        """Log evidence of sums over aircraft (...), (..., m), (..., m, m)."""
        precision = self.inverse + information
        solved = np.linalg.solve(precision, score[..., None])[..., 0]
        gain = 0.5 * (score * solved).sum(-1) - 0.5 * np.linalg.slogdet(precision)[1]
        return np.asarray(level + gain - 0.5 * self.log_det)

    def mean(self, score: Floats, information: Floats) -> Floats:
        return np.asarray(np.linalg.solve(self.inverse + information, score[..., None])[..., 0])


def _log_density(level: Floats, score: Floats, information: Floats, phi: Floats) -> Floats:
    """Log density of aircraft at a common part phi (..., m)."""
    quadratic = ((information @ phi[..., None])[..., 0] * phi).sum(-1)
    return np.asarray(level + (score * phi).sum(-1) - 0.5 * quadratic)


Gaussians = tuple[Floats, Floats, Floats]  # level (..., A), score (..., A, m), information


def _sum_of_cases(affected: Booleans, inside: Gaussians, outside: Gaussians) -> Gaussians:
    return (
        np.where(affected, inside[0], outside[0]).sum(axis=-1),
        np.where(affected[..., None], inside[1], outside[1]).sum(axis=-2),
        np.where(affected[..., None, None], inside[2], outside[2]).sum(axis=-3),
    )


def _cumulative_sums(order: Integers, gaussians: Gaussians) -> Gaussians:
    """Sums over the first 0, 1, ... A aircraft of an order (..., A)."""

    def summed(values: Floats, inner: int) -> Floats:
        values = np.broadcast_to(values, order.shape + values.shape[values.ndim - inner :])
        index, axis = order.reshape(order.shape + (1,) * inner), -1 - inner
        return np.insert(np.take_along_axis(values, index, axis).cumsum(axis), 0, 0.0, axis)

    return summed(gaussians[0], 0), summed(gaussians[1], 1), summed(gaussians[2], 2)


def _best_sets(
    common: _Common, null: Gaussians, slab: Gaussians, *, add: Floats, able: Booleans
) -> tuple[Floats, Floats]:
    """Log evidence of the best set of each size, and each aircraft's gain given the common part.

    Of every case of the leading axes of ``slab`` and ``able`` (..., A); sets of more than the
    aircraft that are able have none.
    """
    phi = common.mean(null[1].sum(axis=0), null[2].sum(axis=0))

    def gain_at(phi: Floats) -> Floats:
        at = phi[..., None, :]
        return np.where(able, _log_density(*slab, at) - _log_density(*null, at) + add, -np.inf)

    for _ in range(3):  # the order of the aircraft depends on phi, which depends on those affected
        _, score, information = _sum_of_cases(gain_at(phi) > 0, slab, null)
        phi = common.mean(score, information)
    gain = gain_at(phi)
    order = np.argsort(-gain, axis=-1)
    more = _cumulative_sums(order, (slab[0] - null[0] + add, slab[1] - null[1], slab[2] - null[2]))
    evidence = common.total(*(x.sum(axis=0) + y for x, y in zip(null, more, strict=True)))
    sizes = np.arange(gain.shape[-1] + 1)
    return np.where(sizes <= able.sum(axis=-1)[..., None], evidence, -np.inf), gain


def _sets_with_mean(
    variance: Floats, null: Gaussians, slab: Gaussians, scales: Floats, gain: Floats, able: Booleans
) -> tuple[Floats, Floats]:
    """As `_best_sets` for affected aircraft that share a mean, for each of the scales (s,).

    Aircraft without the effect are Gaussians in phi, those with it in phi + mu; both are
    integrated together.
    """
    m = variance.shape[0]
    joint_variance = np.stack([block_diag(variance, s**2 * np.eye(m)) for s in scales])

    def joint(rest: Gaussians, inside: Gaussians) -> Gaussians:
        """Level, score and information in (phi, mu) of sums over aircraft."""
        top = np.concatenate([rest[2] + inside[2], inside[2]], axis=-1)
        bottom = np.concatenate([inside[2], inside[2]], axis=-1)
        information = np.concatenate([top, bottom], axis=-2)
        score = np.concatenate([rest[1] + inside[1], inside[1]], axis=-1)
        return rest[0] + inside[0], score, information

    nothing: Gaussians = (np.zeros(()), np.zeros(m), np.zeros((m, m)))
    for _ in range(2):
        better = gain > 0
        affected = np.where(better.any(-1, keepdims=True), better, gain == gain.max(-1)[:, None])
        rest = _sum_of_cases(affected, nothing, null)
        inside = _sum_of_cases(affected, slab, nothing)
        phi, mu = np.split(_Common(joint_variance).mean(*joint(rest, inside)[1:])[:, None], 2, -1)
        gain = _log_density(*slab, phi + mu) - _log_density(*null, phi)
        gain = np.where(able, gain, -np.inf)
    order = np.argsort(-gain, axis=-1)
    steps, without = _cumulative_sums(order, slab), _cumulative_sums(order, null)
    rest = (null[0].sum(0) - without[0], null[1].sum(0) - without[1], null[2].sum(0) - without[2])
    evidence = _Common(joint_variance[:, None]).total(*joint(rest, steps))
    return np.where(np.arange(able.size + 1) <= able.sum(), evidence, -np.inf), gain


def static_evidence(
    stats: Statistics,
    kappa: float,
    scopes: str,
    *,
    scales: Floats = SCALES,
    usual: float = SMALL,
    having: Sequence[int] = (),
) -> dict[str, ScopeEvidence]:
    """Evidence of a candidate that acts on the whole archive, by scope (of ``a`` and ``f``).

    ``kappa`` is the noise factor of single aircraft, ``usual`` the error that all aircraft have;
    aircraft ``having`` the effect by a term in the model have no second one.
    """
    aircraft, m = stats.score.shape
    variance, given_back = common_variance(stats)
    score = stats.score + stats.information @ (given_back @ stats.score.sum(axis=0))
    values, vectors = np.linalg.eigh(stats.information)
    values = np.maximum(values, 1e-8 * max(float(values.max()), 1e-12))
    turned = np.einsum("aji,aj->ai", vectors, score)
    small = usual**2 + stats.usual + np.broadcast_to(stats.remainder, aircraft)[:, None]

    def integrated(variance: Floats) -> Gaussians:
        """Each aircraft with its individual part of these variances (..., A, 1) integrated."""
        spread = kappa * values + variance * values**2
        shrunk = values / (kappa + variance * values)
        information = (vectors * shrunk[..., None, :]) @ vectors.swapaxes(-1, -2)
        linear = np.einsum("aij,...aj->...ai", vectors, turned / (kappa + variance * values))
        level = -0.5 * np.log(spread).sum(axis=-1) - 0.5 * (turned**2 / spread).sum(axis=-1)
        return level, linear, information

    common, null = _Common(variance), integrated(small)
    sums = [x.sum(axis=0) for x in null]
    nothing = float(common.total(*sums))
    out = {}
    if "f" in scopes:
        wider = _Common(variance + scales[:, None, None] ** 2 * np.eye(m))
        by_scale = wider.total(*sums)
        evidence = float(log_sum(by_scale)) - np.log(scales.size) - nothing
        best = float(scales[by_scale.argmax()])
        out["f"] = ScopeEvidence(evidence, best, tuple(range(aircraft)), np.ones(aircraft))
    if "a" in scopes:
        able: Booleans = ~np.isin(np.arange(aircraft), having)
        able &= np.trace(stats.information, axis1=1, axis2=2) > 0
        squared = scales[:, None, None] ** 2
        slab = integrated(squared + small)
        independent, gain = _best_sets(common, null, slab, add=np.zeros(1), able=able)
        slab = integrated(SPREAD**2 * squared + small)
        shared_mean, gain_shared = _sets_with_mean(variance, null, slab, scales, gain, able)
        log_odds = np.concatenate([independent, shared_mean]) + number_prior(aircraft) - nothing
        weight = np.exp(log_sum(log_odds, axis=1) - log_sum(log_odds, axis=None))
        gains = np.concatenate([gain, gain_shared])
        inclusion = sum(w * share_of_aircraft(g)[1] for w, g in zip(weight, gains, strict=True))
        evidence = float(log_sum(log_odds, axis=None)) - np.log(len(log_odds))
        shares_mean, k = divmod(int(log_odds.max(axis=1).argmax()), scales.size)
        affected = tuple(int(a) for a in np.flatnonzero(np.asarray(inclusion) > INCLUDED))
        best, spread = float(scales[k]), SPREAD * shares_mean
        out["a"] = ScopeEvidence(evidence, best, affected, np.asarray(inclusion), spread)
    return out


def share_of_aircraft(gain: Floats) -> tuple[float, Floats]:
    """Integrate over the share of affected aircraft, given the gain (A,) of each.

    Log evidence, and the probability (A,) that each is affected. Aircraft are independent given
    their share; nested sets alone would favour none or all.
    """
    log_share, log_rest = np.log(SHARES)[:, None], np.log1p(-SHARES)[:, None]
    log_total = np.logaddexp(log_rest, log_share + gain)
    by_share = log_total.sum(axis=1)
    weight = np.exp(by_share - log_sum(by_share))
    inclusion = np.asarray(weight @ np.exp(log_share + gain - log_total))
    return float(log_sum(by_share) - np.log(SHARES.size)), inclusion


# ------------------------------------------------------------------------------------------- dates
@dataclass(frozen=True)
class _Periods:
    """Periods of a change, from a stretch of days until before another or the end, (P,) each.

    Half of the prior is that of changes that last until the end. The others have lengths of two,
    four, eight ... stretches and begin a quarter of their length apart; they are refined later.
    """

    start: Integers
    stop: Integers
    log_prior: Floats

    @classmethod
    def of_archive(cls, stretches: int) -> _Periods:
        until_end = np.arange(stretches)
        lengths = [SIDES << k for k in range(stretches.bit_length()) if SIDES << k < stretches]
        begins = [np.arange(0, stretches - n, max(1, n // 4)) for n in lengths]
        start = np.concatenate([until_end, *begins])
        of_those = (begin + n for begin, n in zip(begins, lengths, strict=True))
        stop = np.concatenate([np.full(stretches, stretches), *of_those])
        number = np.where(stop == stretches, stretches, start.size - stretches)
        return cls(start, stop, -np.log(2.0 * number))

    def sums(self, by_stretch: Floats) -> Floats:
        total = np.insert(np.cumsum(by_stretch, axis=1), 0, 0.0, axis=1)
        return np.asarray(total[:, self.stop] - total[:, self.start])

    def as_flown(self, number: int, flown: Booleans) -> tuple[int, int]:
        """Start and stop of a period by the stretches (k, T) in which some aircraft fly."""
        start, stop = int(self.start[number]), int(self.stop[number])
        days = start + np.flatnonzero(flown[:, start:stop].any(axis=0))
        return int(days[0]), stop if stop == flown.shape[1] else int(days[-1]) + 1


def dated_evidence(
    model: Model, group: Group, kappa: float, least: float
) -> tuple[ScopeEvidence, ScopeEvidence]:
    """Evidence of a change in a period, of each aircraft or one for all, for two noise factors.

    The second factor is that of the candidate itself given the change, worked out only where the
    evidence by the first, ``kappa``, is ``least`` or more.
    """
    sums = model.sums
    by_day, _ = sums.information(group)
    day_score = model.day_score[:, :, group.columns] @ group.transform
    periods = _Periods.of_archive(sums.T)
    information = periods.sums(by_day)
    # of the prior: scaled to the trace of the unit matrix, which replaces it where it is zero
    m = information.shape[-1]
    trace, eye = np.trace(information, axis1=-2, axis2=-1)[..., None, None], np.eye(m)
    shape = np.where(trace > 0, m * information / np.maximum(trace, 1e-12), eye) + SLIGHT * eye
    # of the whole archive and of each period
    cross = information.copy()
    for a in range(sums.A):
        by_stretch = _explained_by_stretch(model, group, a)
        explained = periods.sums(by_stretch[None])[0]
        cross[a] -= by_stretch.sum(axis=0).T @ explained
        information[a] -= np.swapaxes(explained, 1, 2) @ explained
    flown = np.insert(np.cumsum(sums.flown, axis=1), 0, 0, axis=1)
    before, until = flown[:, periods.start], flown[:, periods.stop]
    able: Booleans = (before >= SIDES) & (until - before >= SIDES)
    able &= (periods.stop == sums.T) | (flown[:, -1:] - until >= SIDES)
    if not able.any():
        nothing = ScopeEvidence(-np.inf, float(SCALES[0]), (), np.zeros(sums.A))
        return nothing, nothing
    statistics = model.statistics(group)
    scores = periods.sums(day_score)
    changes = _Changes(statistics, periods, sums.flown, able, scores, information, cross, shape)
    ranked = changes.evidence(kappa)
    if ranked.evidence < least:
        return ranked, ranked
    factors = _factor_with_changes(ranked.period, day_score, by_day, statistics)
    affected = factors[list(ranked.period)] if ranked.period else factors
    factor = max(kappa, float(np.nanmean(factors)), float(np.nanmean(affected)))
    return ranked, changes.evidence(factor)


def _explained_by_stretch(model: Model, group: Group, aircraft: int) -> Floats:
    """W of the terms' module for columns in force in each stretch of days, (T, w, m)."""
    sums, active = model.sums, model.by_aircraft[aircraft]
    span = sums.rows_of(aircraft)
    cuts = sums.cuts[aircraft * sums.D + np.r_[sums.first_day, sums.D]] - span.start
    values = sums.rows[span, group.columns] @ group.transform.astype(np.float32)
    stretches = itertools.pairwise(cuts)
    cross = np.stack([active.rows[i:j].T @ values[i:j] for i, j in stretches], dtype=np.float64)
    return np.asarray(active.root @ cross)


def _factor_with_changes(
    period: Mapping[int, tuple[int, int]], score: Floats, by_day: Floats, stats: Statistics
) -> Floats:
    """Noise factor of each aircraft, whose changes are no scatter of its days."""
    days, m = np.arange(score.shape[1]), score.shape[2]
    residual = np.empty_like(score)
    for a, (scores, information) in enumerate(zip(score, by_day, strict=True)):
        start, stop = period.get(a, (days.size, days.size))
        late = ((days >= start) & (days < stop))[:, None]
        joint_score = np.concatenate([scores, scores * late], axis=1).sum(axis=0)
        total, later = information.sum(axis=0), (information * late[..., None]).sum(axis=0)
        joint = np.block([[total, later], [later, later]]) + np.eye(2 * m) / WIDE**2
        fit = np.linalg.solve(joint, joint_score)
        residual[a] = scores - information @ fit[:m] - late * (information @ fit[m:])
    inverse = np.asarray(np.linalg.inv(stats.information + stats.ridge), np.float64)
    factors = [cluster_factor(residual, by_day, inverse, stats.ridge, n) for n in BLOCKS]
    return np.maximum(*factors)


@dataclass(frozen=True)
class _Changes:
    """Changes of a candidate in each of the periods, by aircraft."""

    stats: Statistics
    periods: _Periods
    flown: Booleans  # (A, T)
    able: Booleans  # (A, P): flies often enough in and outside the period
    score: Floats  # (A, P, m)
    information: Floats  # (A, P, m, m)
    # (A, P, m, m): shared by the whole archive and a period; it differs from that of the period
    # where terms in the model act on all
    cross: Floats
    shape: Floats  # (A, P, m, m): of the prior

    def evidence(self, kappa: float) -> ScopeEvidence:
        """Evidence of changes, of each aircraft or one for all, with a noise factor."""
        stats, periods, able, shape = self.stats, self.periods, self.able, self.shape
        aircraft, m = stats.score.shape
        rows, eye = np.arange(aircraft), np.eye(m)
        variance, given_back = common_variance(stats)
        returned = given_back @ stats.score.sum(axis=0)
        total_score = (stats.score + stats.information @ returned) / kappa
        crossed = np.swapaxes(self.cross, -1, -2) / kappa
        score = self.score / kappa + crossed @ returned
        total, information = stats.information / kappa, self.information / kappa
        common = _Common(variance)
        small = SMALL**2 + stats.usual + np.broadcast_to(stats.remainder, aircraft)

        def with_small(information: Floats, score: Floats) -> Gaussians:
            """The small undated part of each aircraft integrated; (A, ..., m, m), (A, ..., m)."""
            free = small.reshape(-1, *[1] * (score.ndim - 2))
            spread = eye + free[..., None, None] * information
            solved = np.linalg.solve(spread, score[..., None])[..., 0]
            level = 0.5 * free * (score * solved).sum(-1) - 0.5 * np.linalg.slogdet(spread)[1]
            return level, np.asarray(solved), np.asarray(np.linalg.solve(spread, information))

        null = with_small(total, total_score)
        sums = [x.sum(axis=0) for x in null]
        nothing = float(common.total(*sums))
        prior, anywhere = number_prior(aircraft), np.asarray(able.any(axis=1))
        # an aircraft changes on a day that it flies
        distinct = np.where(able & self.flown[:, periods.start], periods.log_prior, -np.inf)
        distinct[anywhere] -= log_sum(distinct[anywhere], axis=1, keepdims=True)
        separate, shared, by_scale = [], [], []
        for s in SCALES:
            slab = information + shape / s**2
            turned = np.linalg.solve(slab, crossed)
            rest = total[:, None] - np.swapaxes(crossed, -1, -2) @ turned
            linear = total_score[:, None] - np.einsum("adij,adi->adj", turned, score)
            change = 0.5 * (score * np.linalg.solve(slab, score[..., None])[..., 0]).sum(-1)
            change -= 0.5 * (np.linalg.slogdet(s**2 * slab)[1] - np.linalg.slogdet(shape)[1])
            level, linear, rest = with_small(rest, linear)
            level = level + change
            picked = (level.T, linear.swapaxes(0, 1), rest.swapaxes(0, 1))
            nested, gains = _best_sets(common, null, picked, add=np.zeros(1), able=able.T)
            by_period = log_sum(nested + prior, axis=1) + periods.log_prior
            by_period[~able.any(axis=0)] = -np.inf
            shared.append(float(log_sum(by_period)) - nothing)
            # separate periods: each aircraft's best, with the evidence that the others add
            phi = common.mean(sums[1], sums[2])
            for _ in range(3):
                density = _log_density(level, linear, rest, phi) - _log_density(*null, phi)[:, None]
                density = density + distinct
                best = density.argmax(axis=1)
                by_aircraft = log_sum(density, axis=1)
                picked = (level[rows, best], linear[rows, best], rest[rows, best])
                _, phi_score, phi_information = _sum_of_cases(by_aircraft > 0, picked, null)
                phi = common.mean(phi_score, phi_information)
            several = np.zeros(aircraft)
            at = rows[anywhere], best[anywhere]
            several[anywhere] = by_aircraft[anywhere] - (density[at] - distinct[at])
            nested, gain = _best_sets(common, null, picked, add=several, able=anywhere)
            separate.append(float(log_sum(nested + prior)) - nothing)
            by_scale.append((by_period, gains, best, gain))
        evidence = float(np.logaddexp(log_sum(separate), log_sum(shared))) - np.log(2 * SCALES.size)
        together = max(shared) >= max(separate)
        k = int(np.argmax(shared if together else separate))
        by_period, gains, best, gain = by_scale[k]
        if together:
            one = int(by_period.argmax())
            gain, best = gains[one], np.full(aircraft, one)
        inclusion = 1 / (1 + np.exp(-np.clip(gain, -30, 30)))
        tails = tuple(int(a) for a in np.flatnonzero(inclusion > INCLUDED))
        period = {
            a: periods.as_flown(int(best[a]), self.flown[list(tails) if together else [a]])
            for a in tails
        }
        mean = shape[list(tails), best[list(tails)]].mean(axis=0) if tails else eye
        return ScopeEvidence(
            evidence, float(SCALES[k]), tails, inclusion, period=period, shape=mean
        )


# --------------------------------------------------------------------------------------- exchanges
@dataclass(frozen=True)
class Exchange:
    """Two aircraft that exchanged identifiers on a day.

    ``evidence`` is against no exchange, ``as_changes`` that of separate changes of both aircraft
    at that day, each less the log number of pairs and days.
    """

    pair: tuple[int, int]
    day: int
    evidence: float
    as_changes: float


def exchange_evidence(model: Model, group: Group, kappa: float) -> Exchange | None:
    """Evidence that two aircraft exchanged identifiers.

    The deviations of either (columns of the group) are free whether or not they did, so that an
    exchange has no parameter but pair and date.
    """
    sums = model.sums
    if sums.A < 2 or sums.T <= 2 * SIDES:
        return None
    information = sums.information(group)[0] / kappa
    score = model.day_score[:, :, group.columns] @ group.transform / kappa
    early_information, early_score = (np.cumsum(x, axis=1) - x for x in (information, score))
    late_information = information.sum(axis=1)[:, None] - early_information
    late_score = score.sum(axis=1)[:, None] - early_score
    eye = np.eye(group.size)

    def evidence(information: Floats, score: Floats) -> Floats:
        out = []
        for s in SCALES:
            spread = s**2 * information + eye
            solved = np.linalg.solve(spread, score[..., None])[..., 0]
            out.append(0.5 * s**2 * (solved * score).sum(-1) - 0.5 * np.linalg.slogdet(spread)[1])
        return np.asarray(log_sum(out, axis=0) - np.log(SCALES.size))

    unchanged = evidence(information.sum(axis=1), score.sum(axis=1))
    crossed = evidence(
        early_information[:, None] + late_information[None], early_score[:, None] + late_score[None]
    )
    gain = crossed + crossed.transpose(1, 0, 2) - (unchanged[:, None] + unchanged[None])[..., None]
    change = evidence(early_information, early_score) + evidence(late_information, late_score)
    change -= unchanged[:, None]
    gain[:, :, :SIDES], gain[:, :, -SIDES:] = -np.inf, -np.inf
    gain[np.arange(sums.A), np.arange(sums.A)] = -np.inf
    i, j, d = (int(k) for k in np.unravel_index(gain.argmax(), gain.shape))
    looked_at = np.log(sums.A * (sums.A - 1) / 2 * sums.T)
    return Exchange(
        (min(i, j), max(i, j)),
        int(sums.first_day[d]),
        float(gain[i, j, d]) - looked_at,
        float(change[i, d] + change[j, d]) - looked_at,
    )
