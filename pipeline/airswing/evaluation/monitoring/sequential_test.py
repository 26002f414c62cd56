"""Did a quantity step? One test a night of many aircraft at once, from sums of days.

Assumes that a day tells the quantity x (a compass's A to E and airspeed scale; the logarithm of a
disagreement) by a normal matrix N and a right side r, with errors of covariance phi N^-1 + tau^2:
phi of the day's reports, tau^2 of what the day's reports share. A day then weighs
W = (phi N^-1 + tau^2)^-1, which is fit for singular N too (few headings). Every aircraft has its
own size of noise, from its own past, by empirical Bayes; days in a row may be alike (first-order
autoregression).

Night by night a step at any of the last 30 days is weighed against none: the levels before are
known from the days before (they count with their error and a slow drift), the step is a draw from
a prior over shapes (the offset alone, or all coefficients), and what is told is the largest
likelihood ratio over the dates (Page 1954, Biometrika 41, 100-115; window-limited, Lai 1995,
J. R. Stat. Soc. B 57, 613-658; mixtures over the step, Pollak & Siegmund 1975, Ann. Stat. 3,
1267-1282). What normal errors would tell, each day held to a largest distance, only finds the
nights to look at: whether a step is told is weighed with Student's errors of the days
(:mod:`airswing.evaluation.monitoring.heavy_tails`) and so that no single day can tell it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.compass_changes.change_kernels import LIKELIHOOD_RATIO_95
from airswing.evaluation.monitoring.heavy_tails import corroborated_ratio

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

# Not the test of `compass_changes`, which sees an archive's days at once and permutes them: asked
# anew every night, its false alarms would add up.
LONGEST = 30
"""Days a step may lie back."""
LAGS = (1, 2, 3, 4, 5, 7, 10, 14, 20, 30)
"""Lengths of the stretch after the step that are tried every night."""
OWN_NOISE_FROM = 60.0
"""Degrees of freedom of the fleet's noise in an aircraft's own."""
FEWEST_DAYS = 14
"""Days with reports before a step."""
_STATE = ("weight", "right", "straight", "days", "excess", "freedom")


@dataclass(frozen=True)
class Law:
    """What is known of a quantity beforehand."""

    # (shape, p): standard deviation of a step in each component, by shape; all shapes are as likely
    shapes: Floats
    level: Floats  # (p,): standard deviation of the level before any report
    drift: Floats  # (p,): standard deviation of what the level wanders by itself: no step
    farthest: float  # squared distance a single day may count for
    threshold: float  # logarithm of the likelihood ratio that is an alarm
    # logarithm of the ratio by normal errors from which Student's are asked; without it normal
    # errors decide
    weighed_from: float | None = None

    @property
    def size(self) -> int:
        """Number of components."""
        return int(self.level.size)


@dataclass(frozen=True)
class Noise:
    """Errors of a day."""

    within: float  # phi: of the reports
    between: Floats  # (p,): tau^2: of what the day's reports share
    persistence: float = 0.0  # correlation of a day with the next

    def weights(self, normal: Floats, right: Floats) -> tuple[Floats, Floats]:
        """Weight W of days and W x, from their sums (..., p, p) and (..., p)."""
        inside = self.within * np.eye(self.between.size) + normal * self.between
        both = np.concatenate([normal, right[..., np.newaxis]], axis=-1)
        found = np.linalg.solve(inside, both)
        weight = found[..., :-1]
        return 0.5 * (weight + np.swapaxes(weight, -1, -2)), found[..., -1]

    def inflation(self, days: float) -> float:
        """How much less a stretch of days knows than independent ones would."""
        r = self.persistence
        # 1 + 2 sum over j < days of (1 - j / days) r^j
        return float((1.0 + r) / (1.0 - r) - 2.0 * r * (1.0 - r**days) / (days * (1.0 - r) ** 2))


@dataclass
class Step:
    """A step that was found."""

    number: int  # of the aircraft
    # day, earliest, latest: first day after the step, and its 95 % interval
    day: int
    earliest: int
    latest: int
    statistic: float  # logarithm of the likelihood ratio
    # size, error: (p,): least squares' step, and its standard error
    size: Floats
    error: Floats


@dataclass
class Watch:
    """The levels of many aircraft, and whether they stepped."""

    law: Law
    noise: Noise
    number: int  # of aircraft
    weight: Floats = field(init=False)
    right: Floats = field(init=False)
    straight: Floats = field(init=False)
    days: Floats = field(init=False)
    excess: Floats = field(init=False)
    freedom: Floats = field(init=False)
    _ring: deque[tuple[int, Floats, Floats, Floats, Floats]] = field(init=False)

    def __post_init__(self) -> None:
        n, p = self.number, self.law.size
        self.weight = np.zeros((n, p, p))
        self.right, self.straight = np.zeros((2, n, p))
        self.days, self.excess, self.freedom = np.zeros((3, n))
        self._ring = deque(maxlen=LONGEST)

    def as_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Everything but the law, for a file."""
        noise = [self.noise.within, self.noise.persistence, *self.noise.between]
        found = {name: np.array(getattr(self, name)) for name in _STATE}
        ring = enumerate(zip(*self._ring, strict=True))
        return (
            found | {"noise": np.array(noise)} | {f"ring/{k}": np.array(part) for k, part in ring}
        )

    def take_up(self, kept: Mapping[str, NDArray[np.generic]]) -> None:
        """Undo :meth:`as_arrays`."""
        within, persistence, *between = kept["noise"].tolist()
        self.noise = Noise(within, np.array(between), persistence)
        for name in _STATE:
            setattr(self, name, kept[name])
        days, *levels = (kept[f"ring/{k}"] for k in range(5))
        self._ring.extend(zip(days.tolist(), *levels, strict=True))

    def scale(self, of: Index) -> Floats:
        """Variance of each aircraft's errors over the fleet's."""
        own = OWN_NOISE_FROM + self.excess[of]
        return np.asarray(own / (OWN_NOISE_FROM + self.freedom[of]))

    def level(self, of: Index) -> tuple[Floats, Floats]:
        """Level of aircraft and its covariance, the drift in it."""
        return self._level(self.weight[of], self.right[of], self.scale(of))

    def _level(self, weight: Floats, right: Floats, scale: Floats) -> tuple[Floats, Floats]:
        """Level by the sums of the days before, and its covariance."""
        # by a year of days that go together: a level is of all days before
        long = self.noise.inflation(365.0) * scale[..., np.newaxis, np.newaxis]
        precision = weight / long + np.diag(self.law.level**-2.0)
        # the inverse is asked for anyway: solving beside it would factor every matrix twice
        inverse = np.linalg.inv(precision)
        level = (inverse @ (right / long[..., 0])[..., np.newaxis])[..., 0]
        covariance = inverse + np.diag(self.law.drift**2)
        return np.asarray(level, np.float64), np.asarray(covariance, np.float64)

    def surprise(self, of: Index, weight: Floats, right: Floats) -> tuple[Floats, Floats]:
        """What a day of aircraft tells beyond their level: weight and score, the level's error in.

        Parameters
        ----------
        of : array of int, shape (n,)
        weight, right : array, shape (n, p, p) and (n, p)

        Returns
        -------
        weight, score : array, shape (n, p, p) and (n, p)
        """
        return self._beyond(self.level(of), self.scale(of), weight, right)

    @staticmethod
    def _beyond(
        known: tuple[Floats, Floats], scale: Floats, weight: Floats, right: Floats
    ) -> tuple[Floats, Floats]:
        level, covariance = known
        weight = weight / scale[:, np.newaxis, np.newaxis]
        score = right / scale[:, np.newaxis] - np.einsum("nij,nj->ni", weight, level)
        return _marginal(weight, score, covariance)

    def add(self, day: int, of: Index, weight: Floats, right: Floats) -> None:
        """Take a day in; distances beyond the law's farthest are drawn in.

        Parameters
        ----------
        day : int
            Later than any before.
        of : array of int, shape (n,)
            Aircraft that flew.
        weight, right : array, shape (n, p, p) and (n, p)
        """
        state = (self.weight, self.right, self.straight, self.days)
        first, *rest = (part.copy() for part in state)
        self._ring.append((day, first, rest[0], rest[1], rest[2]))
        if not of.size:
            return
        known = self.level(of)
        inside, score = self._beyond(known, self.scale(of), weight, right)
        distance, freedom = _distance(inside, score, self.law.shapes.max(axis=0))
        new = self.days[of] < FEWEST_DAYS
        held = np.where(new, 1.0, np.sqrt(self.law.farthest / np.maximum(distance, 1e-30)))
        held = np.minimum(held, 1.0)[:, np.newaxis]
        expected = np.einsum("nij,nj->ni", weight, known[0])
        self.weight[of] += weight
        self.right[of] += expected + held * (right - expected)
        self.straight[of] += right
        self.days[of] += 1.0
        usual = freedom + 3.0 * np.sqrt(2.0 * freedom)
        # the distance was measured with the scale as it was
        self.excess[of] += np.where(new, freedom, np.minimum(distance, usual)) * self.scale(of)
        self.freedom[of] += freedom

    def steps(self, of: Index) -> list[Step]:
        """Aircraft whose level stepped, as of the last day taken in.

        Parameters
        ----------
        of : array of int
            Aircraft to look at.
        """
        law = self.law
        if law.weighed_from is None:
            return self.likely(of, law.threshold)
        ratios = self._ratios(of, self._lags())
        best = ratios.max(axis=0, initial=-np.inf)
        found = []
        for j in np.flatnonzero(best > law.weighed_from):
            lags = [lag for lag, one in zip(self._lags(), ratios[:, j], strict=True) if one > 0.0]
            statistic = max(self._weighed(int(of[j]), lag) for lag in lags)
            if statistic > law.threshold:
                found.append(replace(self._dated(int(of[j])), statistic=statistic))
        return found

    def likely(self, of: Index, threshold: float) -> list[Step]:
        """As :meth:`steps`, by normal errors and another threshold."""
        best = self._ratios(of, self._lags()).max(axis=0, initial=-np.inf)
        return [self._dated(int(k)) for k in of[best > threshold]]

    def _lags(self) -> list[int]:
        return [lag for lag in LAGS if lag <= len(self._ring)]

    def _weighed(self, number: int, lag: int) -> float:
        """Logarithm of the likelihood ratio of a step so many days ago, by Student's errors."""
        rows = [self._ring[-one] for one in range(1, lag + 1)]
        weight = np.stack([self.weight[number], *(row[1][number] for row in rows)])
        told = np.stack([self.straight[number], *(row[3][number] for row in rows)])
        since, told = -np.diff(weight, axis=0), -np.diff(told, axis=0)
        flew = np.trace(since, axis1=1, axis2=2) > 0
        scale = self.scale(np.array([number]))
        before, drawn_in = rows[-1][1][number], rows[-1][2][number]
        level, covariance = self._level(before, drawn_in, scale[0])
        noise = scale[0] * self.noise.inflation(lag)
        score = told[flew] - since[flew] @ level
        return corroborated_ratio(since[flew] / noise, score / noise, covariance, self.law.shapes)

    def restart(self, step: Step) -> None:
        """Forget what an aircraft was before its step."""
        k = step.number
        _, weight, _, straight, days = next(row for row in self._ring if row[0] == step.day)
        before = weight[k].copy(), straight[k].copy(), float(days[k])
        for _, weight, right, straight, days in self._ring:
            # days before the step know nothing of the new level
            weight[k] = np.where(days[k] > before[2], weight[k] - before[0], 0.0)
            straight[k] = np.where(days[k] > before[2], straight[k] - before[1], 0.0)
            right[k] = straight[k]
            days[k] = max(days[k] - before[2], 0.0)
        self.weight[k] -= before[0]
        self.straight[k] -= before[1]
        self.right[k] = self.straight[k]
        self.days[k] -= before[2]

    def _ratios(self, of: Index, lags: Sequence[int]) -> Floats:
        """Likelihood ratios of a step so many days ago over none, (lag, n), logarithms."""
        rows = [self._ring[-lag] for lag in lags]
        weight = np.stack([row[1][of] for row in rows])
        right = np.stack([row[2][of] for row in rows])
        days = np.stack([row[4][of] for row in rows])
        told = self.right[of] - right
        inside, outside = self._since(of, lags, weight, right, told)
        ratios = [_mixture(inside, outside, shape) for shape in self.law.shapes]
        ratio = np.logaddexp.reduce(ratios, axis=0) - np.log(len(ratios))
        return np.where(days >= FEWEST_DAYS, ratio, -np.inf)

    def _since(
        self, of: Index, lags: Sequence[int], weight: Floats, right: Floats, told: Floats
    ) -> tuple[Floats, Floats]:
        """Weight and score of the days since, beyond the level that the days before show."""
        scale = np.broadcast_to(self.scale(of), weight.shape[:2])
        long = np.array([self.noise.inflation(lag) for lag in lags])
        inflated = (scale * long[:, np.newaxis])[..., np.newaxis]
        level, covariance = self._level(weight, right, scale)
        since = self.weight[of] - weight
        score = told - np.einsum("...ij,...j->...i", since, level)
        return _marginal(since / inflated[..., np.newaxis], score / inflated, covariance)

    def _dated(self, number: int) -> Step:
        """When an aircraft stepped, and by how much."""
        lags = range(1, len(self._ring) + 1)
        ratio = self._ratios(np.array([number]), lags)[:, 0]
        best = int(np.argmax(ratio))
        likely = np.flatnonzero(2.0 * (ratio[best] - ratio) <= LIKELIHOOD_RATIO_95)
        day = [self._ring[-lag][0] for lag in lags]
        size, error = self._size(number, best + 1)
        return Step(
            number, day[best], day[likely[-1]], day[likely[0]], float(ratio[best]), size, error
        )

    def _size(self, number: int, lag: int) -> tuple[Floats, Floats]:
        """Step by the days as they were, not drawn in, and its error; a wide prior holds it."""
        of = np.array([number])
        _, weight, right, straight, _ = self._ring[-lag]
        told = self.straight[of] - straight[of]
        inside, outside = self._since(of, [lag], weight[of][None], right[of][None], told[None])
        wide = self.law.shapes.max(axis=0)
        root = np.diag(3.0 * wide)
        posterior = root @ np.linalg.inv(np.eye(wide.size) + root @ inside[0, 0] @ root) @ root
        return posterior @ outside[0, 0], np.sqrt(np.diag(posterior))


def _marginal(weight: Floats, score: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Weight and score once the level's own error is in them."""
    inside = np.eye(weight.shape[-1]) + weight @ covariance
    both = np.concatenate([weight, score[..., np.newaxis]], axis=-1)
    found = np.linalg.solve(inside, both)
    return found[..., :-1], found[..., -1]


def _mixture(weight: Floats, score: Floats, shape: Floats) -> Floats:
    """Logarithm of the likelihood ratio of a normal step of given standard deviations."""
    # what does not step has no part in the ratio: three, not eight, unknowns for one cycle
    steps = np.flatnonzero(shape)
    shape, score = shape[steps], score[..., steps]
    weight = weight[..., steps[:, np.newaxis], steps]
    inside = np.eye(shape.size) + shape[:, np.newaxis] * weight * shape
    drawn = score * shape
    solved = np.linalg.solve(inside, drawn[..., np.newaxis])[..., 0]
    gain = np.einsum("...i,...i->...", drawn, solved)
    return np.asarray(0.5 * gain - 0.5 * np.linalg.slogdet(inside)[1])


def _distance(weight: Floats, score: Floats, wide: Floats) -> tuple[Floats, Floats]:
    """Squared distance of days from what was expected, and the degrees of freedom behind it."""
    # ten times the widest step: all but free, and a day that tells nothing of a parameter stays
    # solvable
    root = 10.0 * wide
    inside = np.eye(wide.size) + root[:, np.newaxis] * weight * root
    drawn = score * root
    solved = np.linalg.solve(inside, drawn[..., np.newaxis])[..., 0]
    freedom = wide.size - np.trace(np.linalg.inv(inside), axis1=-2, axis2=-1)
    return np.einsum("ni,ni->n", drawn, solved), np.asarray(freedom)
