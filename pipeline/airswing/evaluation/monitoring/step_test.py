"""Sequential test for a step of a quantity, for many aircraft at once.

Assumes that a day gives a quantity x (the coefficients of a compass; the logarithm of a wind vector
difference) by a normal matrix N and a right side r, with errors of covariance phi N^-1 + tau^2: phi
from the independent errors of the reports of the day, tau^2 from their common error. The weight of
a day is W = (phi N^-1 + tau^2)^-1, which also exists for singular N. The scale of the errors of
each aircraft is estimated by empirical Bayes; successive days are correlated (first-order
autoregression), which inflates the variance of a period.

Every night a step at any of the last 30 days is compared with no step. The level before has its
error and a slow drift, the step a prior over shapes: the offset alone, A to C, or A to E. The
statistic is the largest log likelihood ratio over dates (Page 1954, Biometrika 41, 100-115;
window-limited: Lai 1995, J. R. Stat. Soc. B 57, 613-658; mixtures over the step: Pollak & Siegmund
1975, Ann. Stat. 3, 1267-1282). Normal errors select the nights; the decision uses Student's t
errors of the days, and no single day can decide (:func:`corroborated_ratio`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.innovations import Floats, Ints

LONGEST = 30  # days that a step may lie back when it is detected
LAGS = (1, 2, 3, 4, 5, 7, 10, 14, 20, 30)
"""Lengths in days of the period after the step that are tried every night."""
SCALE_FREEDOM = 60.0  # degrees of freedom of the fleet's noise in the noise of one aircraft
FEWEST_DAYS = 14  # fewest days with reports before a step
FEWEST_AFTER = 3  # fewest days with reports after a step that is found from all days of an archive
FREEDOM = 6.0
"""Degrees of freedom of a day's Student's t: a day is the mean of a few heavy-tailed flights."""
SINGLE_DAY = 5.5
"""Log likelihood ratio that the day farthest from the level may add to that of the others."""
LIKELIHOOD_RATIO_95 = 7.35
"""-2 ln(1 - sqrt(0.95)): 95 % point of the likelihood ratio of a date (Eo & Morley 2015, Quant.
Econ. 6, 463-497)."""
_ROUNDS = 8
_SUMS = ("weight", "limited", "right", "days")
_SINGULAR = 1e-9  # relative accuracy of a weight: smaller eigenvalues are rounding errors


@dataclass(frozen=True)
class Law:
    """Prior knowledge of a quantity with p components."""

    shapes: Floats  # (shape, p): standard deviation of a step, by shape; all equally probable
    level: Floats  # (p,): standard deviation of the level before any report
    drift: Floats  # (p,): standard deviation of the level's drift, which does not count as a step
    farthest: float  # squared distance to which a day is limited when the level is updated
    threshold: float  # log likelihood ratio of an alarm
    # log likelihood ratio by normal errors from which Student's t is evaluated; None: normal
    # errors decide
    student_from: float | None = None


@dataclass(frozen=True)
class Noise:
    """Errors of a day."""

    within: float  # phi: error variance of the reports
    between: Floats  # (p,): tau^2: variance of the common error of a day's reports
    persistence: float = 0.0  # correlation of a day with the next

    def weights(self, normal: Floats, right: Floats) -> tuple[Floats, Floats]:
        """Weight W of days and W x, from their sums (..., p, p) and (..., p)."""
        inside = self.within * np.eye(self.between.size) + normal * self.between
        columns = np.concatenate([normal, right[..., np.newaxis]], axis=-1)
        solution = np.linalg.solve(inside, columns)
        weight = solution[..., :-1]
        return 0.5 * (weight + np.swapaxes(weight, -1, -2)), solution[..., -1]

    def inflation(self, days: float) -> float:
        """Variance of the mean of a period over that with independent days."""
        r = self.persistence
        # 1 + 2 sum over j < days of (1 - j / days) r^j
        return float((1.0 + r) / (1.0 - r) - 2.0 * r * (1.0 - r**days) / (days * (1.0 - r) ** 2))


@dataclass
class Step:
    """A step that was detected."""

    number: int  # of the aircraft
    day: int  # first day after the step
    earliest: int  # 95 % interval of that day
    latest: int
    statistic: float  # log likelihood ratio
    change: Floats  # (p,): estimate of the step
    error: Floats  # (p,): its standard error
    night: int = 0  # that detected it
    reporting: int = 0  # aircraft with reports on that day


class StepTest:
    """Levels of many aircraft, and their test for a step."""

    def __init__(self, law: Law, noise: Noise, number: int) -> None:
        self.law, self.noise, p = law, noise, law.level.size
        # sums of all days so far; the right side with and without the limit of far days
        parts = [("weight", "f8", (p, p)), ("limited", "f8", p), ("right", "f8", p), ("days", "f8")]
        self.sums = np.zeros(number, parts)
        # squared distances and their degrees of freedom, for the scale of each aircraft's noise
        self.excess, self.freedom = np.zeros((2, number))
        # day, and the sums before it
        self._ring: deque[tuple[int, NDArray[np.void]]] = deque(maxlen=LONGEST)

    def scale(self, craft: Ints) -> Floats:
        """Error variance of each aircraft over that of the fleet."""
        excess, freedom = self.excess[craft], self.freedom[craft]
        return np.asarray((SCALE_FREEDOM + excess) / (SCALE_FREEDOM + freedom))

    def level(self, craft: Ints) -> tuple[Floats, Floats]:
        """Level of aircraft and its covariance, drift included."""
        sums = self.sums[craft]
        return _level(self.law, self.noise, sums["weight"], sums["limited"], self.scale(craft))

    def innovation(self, craft: Ints, weight: Floats, right: Floats) -> tuple[Floats, Floats]:
        """Weight and score of a day's difference from the level, including the level's error."""
        sums, scale = self.sums[craft], self.scale(craft)
        before = sums["weight"], sums["limited"]
        return _relative(self.law, self.noise, before, (weight, right), scale, scale)

    def add(self, day: int, craft: Ints, weight: Floats, right: Floats) -> None:
        """Add a later day of aircraft ``craft``, distances limited to the law's farthest."""
        self._ring.append((day, self.sums.copy()))
        if not craft.size:
            return
        distance, freedom = _distance(
            *self.innovation(craft, weight, right), self.law.shapes.max(axis=0)
        )
        new = self.sums["days"][craft] < FEWEST_DAYS
        share = np.where(new, 1.0, np.sqrt(self.law.farthest / np.maximum(distance, 1e-30)))
        expected = np.einsum("nij,nj->ni", weight, self.level(craft)[0])
        limited = expected + np.minimum(share, 1.0)[:, np.newaxis] * (right - expected)
        usual = freedom + 3.0 * np.sqrt(2.0 * freedom)
        # the distance was measured with the scale before this day
        excess = np.where(new, freedom, np.minimum(distance, usual)) * self.scale(craft)
        for name, values in zip(_SUMS, (weight, limited, right, 1.0), strict=True):
            self.sums[name][craft] += values
        self.excess[craft] += excess
        self.freedom[craft] += freedom

    def steps(self, craft: Ints) -> list[Step]:
        """Steps of aircraft detected on the last day."""
        law, lags = self.law, self._lags()
        if law.student_from is None:
            return self.likely(craft, law.threshold)
        ratios = self._ratios(craft, lags)
        steps = []
        for j in np.flatnonzero(ratios.max(axis=0, initial=-np.inf) > law.student_from):
            tried = [lag for lag, ratio in zip(lags, ratios[:, j], strict=True) if ratio > 0.0]
            statistic = max(self._student_ratio(int(craft[j]), lag) for lag in tried)
            if statistic > law.threshold:
                steps.append(replace(self._dated(int(craft[j])), statistic=statistic))
        return steps

    def likely(self, craft: Ints, threshold: float) -> list[Step]:
        """Same as :meth:`steps`, with normal errors and another threshold."""
        best = self._ratios(craft, self._lags()).max(axis=0, initial=-np.inf)
        return [self._dated(int(k)) for k in craft[best > threshold]]

    def _lags(self) -> list[int]:
        return [lag for lag in LAGS if lag <= len(self._ring)]

    def _student_ratio(self, number: int, lag: int) -> float:
        """Log likelihood ratio of a step ``lag`` days ago, with Student's t errors."""
        rows = [self.sums[number], *(self._ring[-k][1][number] for k in range(1, lag + 1))]
        daily, score = (
            -np.diff([row[name] for row in rows], axis=0) for name in ("weight", "right")
        )
        flew = np.trace(daily, axis1=1, axis2=2) > 0
        scale, before = float(self.scale(np.array([number]))[0]), rows[-1]
        level, covariance = _level(self.law, self.noise, before["weight"], before["limited"], scale)
        inflated = scale * self.noise.inflation(lag)
        score = (score[flew] - daily[flew] @ level) / inflated
        return corroborated_ratio(daily[flew] / inflated, score, covariance, self.law.shapes)

    def restart(self, step: Step) -> None:
        """Restart the level of an aircraft after its step."""
        k = step.number
        before = next(sums for day, sums in self._ring if day == step.day)[k].copy()
        for sums in [*(sums for _, sums in self._ring), self.sums]:
            # days before the step contain no information on the new level
            after = sums["days"][k] > before["days"]
            for name in ("weight", "right", "days"):
                sums[name][k] = sums[name][k] - before[name] if after else 0.0
            sums["limited"][k] = sums["right"][k]

    def _ratios(self, craft: Ints, lags: Sequence[int]) -> Floats:
        """Log likelihood ratios of a step ``lags`` days ago, (lag, n), with normal errors."""
        before = np.array([self._ring[-lag][1][craft] for lag in lags], self.sums.dtype)
        before = before.reshape(len(lags), craft.size)
        ratio = _mixture(*self._after(craft, lags, before, "limited"), self.law.shapes)
        return np.where(before["days"] >= FEWEST_DAYS, ratio, -np.inf)

    def _after(
        self, craft: Ints, lags: Sequence[int], before: NDArray[np.void], side: str
    ) -> tuple[Floats, Floats]:
        scale = np.broadcast_to(self.scale(craft), before.shape)
        inflation = np.array([self.noise.inflation(lag) for lag in lags])
        weight, right = (self.sums[name][craft] - before[name] for name in ("weight", side))
        past, inflated = (before["weight"], before["limited"]), scale * inflation[:, np.newaxis]
        return _relative(self.law, self.noise, past, (weight, right), scale, inflated)

    def _dated(self, number: int) -> Step:
        lags, craft = range(1, len(self._ring) + 1), np.array([number])
        ratio = self._ratios(craft, lags)[:, 0]
        best = int(np.argmax(ratio))
        likely = np.flatnonzero(2.0 * (ratio[best] - ratio) <= LIKELIHOOD_RATIO_95)
        day = [self._ring[-lag][0] for lag in lags]
        # without the limit of far days
        before = self._ring[-(best + 1)][1][craft][np.newaxis]
        weight, score = self._after(craft, [best + 1], before, "right")
        change, error = _step_estimate(weight[0, 0], score[0, 0], self.law)
        return Step(
            number, day[best], day[likely[-1]], day[likely[0]], float(ratio[best]), change, error
        )


def step_of_series(
    law: Law, noise: Noise, scale: float, day: Ints, weight: Floats, right: Floats
) -> Step | None:
    """Most likely step of a series of days, from all days before and after it.

    Days far from the levels on both sides of the step weigh less, by Student's t. ``scale`` is the
    error variance of the aircraft over that of the fleet; ``weight`` (d, p, p) and ``right`` (d, p)
    are those of each day after removal of the fleet's common part. None with fewer days than
    :data:`FEWEST_DAYS` before and :data:`FEWEST_AFTER` after.
    """
    places = np.arange(FEWEST_DAYS, day.size - FEWEST_AFTER + 1)
    if not places.size:
        return None
    scales = np.asarray(scale)
    inflation = np.array([noise.inflation(day[-1] - day[k] + 1.0) for k in places])
    split = day.size // 2
    # the second time with the levels on both sides of the date found first
    for _ in range(2):
        share = np.ones(day.size)
        for side in (slice(0, split), slice(split, None)):
            days = weight[side], right[side]
            total = days[0].sum(axis=0), days[1].sum(axis=0)
            relative = _relative(law, noise, total, days, scales, scales)
            distance, freedom = _distance(*relative, law.shapes.max(axis=0))
            share[side] = np.minimum((FREEDOM + freedom) / (FREEDOM + distance), 1.0)
        sums = (weight * share[:, np.newaxis, np.newaxis]).cumsum(axis=0)
        rights = (right * share[:, np.newaxis]).cumsum(axis=0)
        before = sums[places - 1], rights[places - 1]
        after = sums[-1] - before[0], rights[-1] - before[1]
        relative = _relative(law, noise, before, after, scales, scales * inflation)
        ratio = _mixture(*relative, law.shapes)
        best = int(np.argmax(ratio))
        split = int(places[best])
    likely = places[2.0 * (ratio[best] - ratio) <= LIKELIHOOD_RATIO_95]
    # the decision is that of the nightly test: Student's t errors, and no single day can decide
    level, covariance = _level(law, noise, before[0][best], before[1][best], scale)
    inflated = scale * inflation[best]
    statistic = corroborated_ratio(
        weight[split:] / inflated,
        (right[split:] - weight[split:] @ level) / inflated,
        covariance,
        law.shapes,
    )
    change, error = _step_estimate(relative[0][best], relative[1][best], law)
    # the step lies after the last day of the old level
    earliest = int(day[likely[0] - 1]) + 1
    last, statistic = int(day[likely[-1]]), min(float(ratio[best]), statistic)
    return Step(-1, int(day[split]), earliest, last, statistic, change, error)


def _level(
    law: Law, noise: Noise, weight: Floats, right: Floats, scale: Floats | float
) -> tuple[Floats, Floats]:
    """Level from the sums of days, and its covariance with the drift."""
    # a level is the mean of many days: use the inflation of a year
    inflated = noise.inflation(365.0) * np.asarray(scale)[..., np.newaxis, np.newaxis]
    precision = weight / inflated + np.diag(law.level**-2.0)
    inverse = np.linalg.inv(precision)
    level = (inverse @ (right / inflated[..., 0])[..., np.newaxis])[..., 0]
    return np.asarray(level, np.float64), np.asarray(inverse + np.diag(law.drift**2), np.float64)


def _relative(
    law: Law,
    noise: Noise,
    before: tuple[Floats, Floats],
    after: tuple[Floats, Floats],
    scale: Floats,
    inflated: Floats,
) -> tuple[Floats, Floats]:
    """Weight and score of days after a date relative to the level of the days before."""
    level, covariance = _level(law, noise, *before, scale)
    score = after[1] - np.einsum("...ij,...j->...i", after[0], level)
    return _marginal(
        after[0] / inflated[..., np.newaxis, np.newaxis],
        score / inflated[..., np.newaxis],
        covariance,
    )


def _marginal(weight: Floats, score: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Weight and score with the level's error included."""
    inside = np.eye(weight.shape[-1]) + weight @ covariance
    solution = np.linalg.solve(inside, np.concatenate([weight, score[..., np.newaxis]], axis=-1))
    return solution[..., :-1], solution[..., -1]


def _mixture(weight: Floats, score: Floats, shapes: Floats) -> Floats:
    """Log likelihood ratio of a step over none, a mixture of the shapes."""
    ratios = []
    for shape in shapes:
        # components that do not step have no part in the ratio
        moving = np.flatnonzero(shape)
        width = shape[moving]
        block = weight[..., moving[:, np.newaxis], moving]
        inside = np.eye(width.size) + width[:, np.newaxis] * block * width
        scaled = score[..., moving] * width
        solved = np.linalg.solve(inside, scaled[..., np.newaxis])[..., 0]
        gain = np.einsum("...i,...i->...", scaled, solved)
        ratios.append(0.5 * gain - 0.5 * np.linalg.slogdet(inside)[1])
    return np.asarray(np.logaddexp.reduce(ratios, axis=0) - np.log(len(ratios)))


def _step_estimate(weight: Floats, score: Floats, law: Law) -> tuple[Floats, Floats]:
    """Step and its standard error, under a prior three times as wide as the widest shape."""
    root = np.diag(3.0 * law.shapes.max(axis=0))
    posterior = root @ np.linalg.inv(np.eye(len(root)) + root @ weight @ root) @ root
    return posterior @ score, np.sqrt(np.diag(posterior))


def _distance(weight: Floats, score: Floats, wide: Floats) -> tuple[Floats, Floats]:
    """Squared distance of days from their expectation, and its degrees of freedom."""
    # a prior of ten times the widest step makes days without information on a component solvable
    root = 10.0 * wide
    inside = np.eye(wide.size) + root[:, np.newaxis] * weight * root
    scaled = score * root
    solved = np.linalg.solve(inside, scaled[..., np.newaxis])[..., 0]
    freedom = wide.size - np.trace(np.linalg.inv(inside), axis1=-2, axis2=-1)
    return np.einsum("ni,ni->n", scaled, solved), np.asarray(freedom)


def corroborated_ratio(weight: Floats, score: Floats, level: Floats, shapes: Floats) -> float:
    """Log likelihood ratio of a step before some days over none, with Student's t errors.

    The density of a day at squared distance d from its expectation is that of a multivariate t of
    :data:`FREEDOM` degrees of freedom. The integral over the unknown level and step is Laplace's at
    its maximum, found by reweighted least squares (Lange, Little & Taylor 1989, J. Am. Stat. Assoc.
    84, 881-896). At most :data:`SINGLE_DAY` more than without the day farthest from the level.

    ``weight`` (n, p, p) and ``score`` (n, p) of each day are relative to the level before, whose
    error has covariance ``level``; ``shapes`` (shape, p) are standard deviations of the step, all
    equally probable.
    """
    ratio, farthest = _student_ratio(weight, score, level, shapes)
    if ratio <= SINGLE_DAY:
        return ratio
    near = np.arange(score.shape[0]) != farthest
    rest = _student_ratio(weight[near], score[near], level, shapes)[0] if near.any() else 0.0
    return min(ratio, max(rest, 0.0) + SINGLE_DAY)


def _student_ratio(
    weight: Floats, score: Floats, level: Floats, shapes: Floats
) -> tuple[float, int]:
    """Log likelihood ratio, and the day farthest from the level."""
    stepped = level + np.einsum("si,ij->sij", shapes**2, np.eye(level.shape[0]))
    density, distance = _student_densities(
        weight, score, np.concatenate([level[np.newaxis], stepped])
    )
    mixed = np.logaddexp.reduce(density[1:]) - np.log(shapes.shape[0])
    return float(mixed - density[0]), int(np.argmax(distance))


def _student_densities(weight: Floats, score: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Log density of the days for prior covariances (m, p, p), up to a common constant.

    The second array is the squared distance of every day from the maximum under the first prior.
    """
    unit = np.sqrt(np.diagonal(covariance[-1]))
    weight, score = unit[:, np.newaxis] * weight * unit, score * unit
    covariance = covariance / unit[:, np.newaxis] / unit
    value, vector = np.linalg.eigh(weight)
    regular = value > _SINGULAR * value[:, -1:]
    projected = np.einsum("nji,nj->ni", vector, score)
    square = (np.where(regular, projected, 0.0) ** 2 / np.where(regular, value, 1.0)).sum(1)
    dimensions = regular.sum(1)
    flat = weight.reshape(dimensions.size, -1)
    eye, best = np.eye(unit.size), np.full(covariance.shape[0], -np.inf)
    first = np.zeros(dimensions.size)
    # from equal weights and from the days near the level: gross errors may cause two maxima
    for start in (np.ones(dimensions.size), (FREEDOM + dimensions) / (FREEDOM + square)):
        share = np.tile(start, (best.size, 1))
        for _ in range(_ROUNDS):
            total, right = (share @ flat).reshape(covariance.shape), share @ score
            inside = eye + covariance @ total
            drawn = np.einsum("mij,mj->mi", covariance, right)[..., np.newaxis]
            x = np.linalg.solve(inside, drawn)[..., 0]
            quadratic = np.einsum("mi,nij,mj->mn", x, weight, x, optimize=True)
            distance = np.maximum(square - 2.0 * x @ score.T + quadratic, 0.0)
            share = (FREEDOM + dimensions) / (FREEDOM + distance)
        # x = V (right - total x): the prior's x' V^-1 x needs no inverse of V
        prior = ((right - np.einsum("mij,mj->mi", total, x)) * x).sum(1)
        density = -0.5 * ((FREEDOM + dimensions) * np.log1p(distance / FREEDOM)).sum(1)
        evidence = density - 0.5 * prior - 0.5 * np.linalg.slogdet(inside)[1]
        first = np.where(evidence[0] > best[0], distance[0], first)
        best = np.maximum(best, evidence)
    return best, first
