"""Error of the reference between flights: its covariance in place, height and time.

Assumptions: at a moment the reference errs alike over some hundred km, for some hours, through a
part of the troposphere, whoever flies there; what it errs by on all days is another such field,
wider. Reports of ten minutes of a flight are one observation of it. With a place's east x, north y
(km), t (h), z = ln p, both components alike and independent,

    cov = s_c^2 exp(-sqrt(dx^2 + dy^2) / L - |dt| / T - (dz / H)^2 / 2), plus s_w^2 / n on the same,

s_c and s_w those along flights (:mod:`airswing.gap.noise.model`), L, T, H and a factor of the whole
by maximum likelihood on some days. Days are independent of each other.

Validity: lasting fields of 500 km and more; regions up to some thousand km.

Source: Gaspari & Cohn 1999, Q. J. R. Meteorol. Soc. 125, 723 (covariances of model errors); Gelb
(1974), Applied Optimal Estimation (generalised least squares).

Units: km, h, ln p, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist

from airswing.gap.noise.model import Flown, NoiseModel
from airswing.physics.splines import hats
from airswing.units import EARTH_RADIUS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Time over which reports of a flight are one observation, s; most observations of a day.
TOGETHER, MOST = 600.0, 1500
#: Days on which the covariance is fitted.
FITTED_DAYS = 6
#: Where its search begins, and the factor of its steps.
START, STEP = (300.0, 6.0, 0.4), 1.5
#: Reach of what lasts: km, ln p; distances of its knots and those of its daily part; most knots.
REACH = (500.0, 0.6)
KNOTS, DAILY_KNOTS = ((350.0, 350.0, 0.35), 6), ((700.0, 700.0, 0.7), 4)
#: Variance of single knots beside what neighbours share.
ALONE = 0.05


@dataclass(frozen=True)
class Observations:
    """Reports of ten minutes of a flight, taken together (m of them)."""

    which: Integers  # (n,): observation of every report; -1: of none
    count: Floats  # (m,)
    place: Floats  # (m, 4): x, y (km), t (h), ln p
    day: Integers  # (m,)

    @classmethod
    def of(cls, reports: Flown, day: Integers, keep: NDArray[np.bool_]) -> Observations:
        """Take reports together, of days with too many not all."""
        step = np.floor((reports.time - reports.time.min()) / TOGETHER).astype(np.int64)
        key = (reports.flight.astype(np.int64) * (int(step.max()) + 1) + step)[keep]
        names, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        own_day = day[keep][first]
        busy = np.bincount(own_day)[own_day]
        left = np.random.default_rng(0).uniform(size=names.size) < MOST / np.maximum(busy, 1)
        number = np.where(left, np.cumsum(left) - 1, -1)
        which = np.full(day.size, -1)
        which[keep] = number[inverse]
        made = cls(which, np.bincount(which[which >= 0]).astype(float), np.empty(0), own_day[left])
        degree = np.radians(EARTH_RADIUS / 1e3)
        east = degree * np.cos(np.radians(np.median(reports.latitude)))
        told = [east * reports.longitude, degree * reports.latitude, reports.time / 3600.0]
        return replace(made, place=made.mean(np.stack([*told, np.log(reports.pressure)], -1)))

    def mean(self, values: Floats) -> Floats:
        """Means of values (n, ...) over the reports of each, (m, ...)."""
        own = np.flatnonzero(self.which >= 0)
        flat = values[own].reshape(own.size, -1)
        sums = [np.bincount(self.which[own], v, minlength=self.count.size) for v in flat.T]
        return np.reshape(np.stack(sums, -1) / self.count[:, None], (-1, *values.shape[1:]))


@dataclass(frozen=True)
class SharedError:
    """Covariance of the reference's error of a day."""

    model: NoiseModel
    reach: tuple[float, float, float]  # L, T, H
    scale: float = 1.0  # variance over what the noise along flights says

    @classmethod
    def fitted(cls, model: NoiseModel, seen: Observations, residual: Floats) -> SharedError:
        """Fit to the residual (m, 2) of some days."""
        days = np.unique(seen.day)
        some = days[:: max(1, days.size // FITTED_DAYS)]
        best, top = cls(model, START), -np.inf
        for k in (0, 1, 2, 0):
            for factor in (1.0, 1 / STEP, STEP):
                reach = [r * (factor if j == k else 1.0) for j, r in enumerate(best.reach)]
                now = cls(model, (reach[0], reach[1], reach[2]))
                found, scale = now._likelihood(seen, residual, some)
                if found > top:
                    best, top = replace(now, scale=scale), found
        return best

    def whitened(self, seen: Observations, own: Integers, values: Floats) -> Floats:
        """Values (m, k) of one day's observations, one component's, made independent."""
        return np.asarray(solve_triangular(self._root(seen, own), values[own], lower=True))

    def _root(self, seen: Observations, own: Integers) -> Floats:
        length, hours, height = self.reach
        x, y, t, z = seen.place[own].T
        flat = np.stack([x, y], -1)
        apart = cdist(flat, flat) / length + np.abs(t[:, None] - t) / hours
        apart += 0.5 * ((z[:, None] - z) / height) ** 2
        noise = self.model.correlated_sd**2 * np.exp(-apart)
        noise[np.diag_indices(own.size)] += self.model.white_sd**2 * (1 + 1 / seen.count[own])
        level = self.model.factor(z)
        return np.asarray(np.linalg.cholesky(noise * level[:, None] * level * self.scale))

    def _likelihood(
        self, seen: Observations, residual: Floats, days: Integers
    ) -> tuple[float, float]:
        """Log likelihood at the best factor of the whole, and that factor."""
        square, root, size = 0.0, 0.0, 0
        for day in days:
            own = np.flatnonzero(seen.day == day)
            lower = self._root(seen, own)
            square += float((solve_triangular(lower, residual[own], lower=True) ** 2).sum())
            root += 2 * float(np.log(np.diag(lower)).sum())
            size += 2 * own.size
        return -root - 0.5 * size * np.log(square / size), square / size


@dataclass(frozen=True)
class Lasting:
    """Fields that last, and their daily cycle: hat functions of place with a common prior."""

    columns: Floats  # (m, b): of each component alike
    blocks: tuple[slice, ...]  # of what lasts, of its sine and its cosine by day
    precision: tuple[Floats, ...]  # of the coefficients of each, at variance 1

    @classmethod
    def of(cls, place: Floats) -> Lasting:
        """Hats over the places (m, 4) of an archive."""
        steady, own = _products_of_hats(place, *KNOTS)
        daily, other = _products_of_hats(place, *DAILY_KNOTS)
        angle = 2 * np.pi * place[:, 2, None] / 24.0
        columns = [steady, daily * np.sin(angle), daily * np.cos(angle)]
        ends = np.cumsum([0, *(c.shape[1] for c in columns)])
        blocks = tuple(slice(a, b) for a, b in pairwise(ends.tolist()))
        return cls(np.concatenate(columns, 1), blocks, (own, other, other))


def _products_of_hats(place: Floats, steps: tuple[float, ...], most: int) -> tuple[Floats, Floats]:
    """Products of hats in x, y and ln p, and the inverse of their prior covariance."""
    knots, values = [], np.ones((place.shape[0], 1))
    for v, step in zip(place[:, [0, 1, 3]].T, steps, strict=True):
        # single flights far out must not stretch the knots over nothing; hats end flat, so they
        # still count
        low, high = np.quantile(v, [0.005, 0.995])
        count = max(2, int(np.ceil((high - low) / step)) + 1)
        # a hair more: knots increase where all lie at one place
        own = np.linspace(low, high + 1e-6, min(most, count))
        knots.append(own)
        values = (values[:, :, None] * hats(v, own).T[:, None]).reshape(v.size, -1)
    at = np.stack(np.meshgrid(*knots, indexing="ij"), -1).reshape(-1, 3)
    seen = (values**2).sum(axis=0) > 0
    unit = at[seen] / [REACH[0], REACH[0], REACH[1]]
    covariance = np.exp(-0.5 * cdist(unit, unit, "sqeuclidean")) + ALONE * np.eye(seen.sum())
    return values[:, seen], np.linalg.inv(covariance)
