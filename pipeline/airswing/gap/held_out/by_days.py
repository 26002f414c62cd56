"""Coefficients of the reference's wind as its errors of days and of the archive allow.

Assumptions: an effect of the reference's wind is the same on every day. Fields fitted to each day
take up most of it, and whitened along flights it is asked to follow small scales that its column,
made of the wind's large ones, does not hold. Here nothing is fitted to days: their error is noise
of known covariance between all reports of a day (:mod:`airswing.gap.noise.shared_error`), and
beside the column stand fields that last, with the variance the archive shows, and the slope on the
wind. Of a column z and the same of the reference's own wind x,

    c = z'Mr / z'Mx,   var c = z'Mz / (z'Mx)^2,

M the inverse covariance with what lasts taken out. A wind turned by an angle lies across itself,
error and all: there z is x. Every other z is made of the large-scale reported wind, which does not
hold the reference's error.

Validity: ten blocks of three days and more.

Source: Henderson (1975), Biometrics 31, 423 (mixed model); Fuller (1987), Measurement Error Models,
section 1.4 (instruments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.layout import effect_columns
from airswing.gap.design.weather import slope_columns
from airswing.gap.effects.base import Effect
from airswing.gap.noise.model import NoiseFit, flown
from airswing.gap.noise.shared_error import Lasting, Observations, SharedError
from airswing.gap.sums.variance_components import SLOPE_SD

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Days of a block, and blocks under which their scatter tells too little.
BLOCK, LEAST_BLOCKS = 3, 10
#: Effects whose own column lies across the reference's wind, error and all.
ACROSS = ("reference_grid_relative",)
#: Variances of fields that last, and of their daily part, before the archive is asked, m2 s-2.
VARIANCES = (0.04, 0.03)
ROUNDS = 10
#: Bound on residuals, in standard deviations.
CLIP = 5.0
#: Standard errors by which blocks of days left out must show it.
CONFIRMED = 1.64
#: Persistent error beyond the fields that last, m/s.
PERSISTENT = 0.04


@dataclass(frozen=True)
class Column:
    """A column to weigh."""

    told: Floats  # (n, 2): z
    own: Floats  # (n, 2): x

    @classmethod
    def of(cls, frame: Frame, quiet: Frame, effect: Effect, form: int) -> Column:
        """Make a column of an effect."""
        own = np.nan_to_num(effect_columns(frame, effect)[form])
        if effect.name in ACROSS:
            return cls(own, own)
        return cls(np.nan_to_num(effect_columns(quiet, effect)[form]), own)

    @property
    def size(self) -> float:
        """Root mean square where it acts."""
        square = (self.own**2).sum(axis=1)
        return float(np.sqrt(square[square > 0].mean())) if square.any() else 0.0


@dataclass(frozen=True)
class Coefficient:
    """What the days tell of a column."""

    value: float
    error: float  # standard error
    formal: float  # deviations without what may persist beyond: which of two columns it is
    # of blocks of days that the others foretell: energy explained, and its standard error
    energy: float
    doubt: float

    @property
    def deviations(self) -> float:
        """Standard errors from nothing; 0 where days left out do not confirm it."""
        confirmed = self.energy > CONFIRMED * self.doubt
        return abs(self.value) / self.error if confirmed else 0.0


@dataclass(frozen=True)
class ByDays:
    """Sums X'X of blocks of days: what lasts, slope, columns told and own, residual."""

    gram: Floats  # (B, w, w)
    lasting: Lasting
    sizes: tuple[float, ...]  # of the columns

    @classmethod
    def of(
        cls,
        frames: tuple[Frame, Frame],
        noise: NoiseFit,
        day: Integers,
        rest: Floats,
        columns: Sequence[Column],
    ) -> ByDays:
        """Sum an archive.

        Parameters
        ----------
        frames : (Frame, Frame)
            Reports as they are, and free of the residual's noise.
        day : (n,) int
            Of every report, from 0.
        rest : (n, 2) float
            Residual with what was found taken off, m/s.
        """
        quiet, model = frames[1], noise.model
        seen = Observations.of(flown(quiet), day, ~noise.gross)
        spread = CLIP * np.hypot(model.correlated_sd, model.white_sd)
        spread = spread * model.factor(np.log(quiet.pressure))[:, None]
        told = [slope_columns(quiet), *(c.told[..., None] for c in columns)]
        told += [*(c.own[..., None] for c in columns), np.clip(rest, -spread, spread)[..., None]]
        small = seen.mean(np.concatenate(told, -1))
        lasting = Lasting.of(seen.place)
        error = SharedError.fitted(model, seen, small[..., -1])
        b, m = lasting.columns.shape[1], small.shape[-1]
        gram = np.zeros((int(day.max()) // BLOCK + 1, 2 * b + m, 2 * b + m))
        for d in np.unique(seen.day):
            own = np.flatnonzero(seen.day == d)
            both = np.concatenate([lasting.columns, small.reshape(-1, 2 * m)], 1)
            white = error.whitened(seen, own, both)
            for k in range(2):
                part = np.zeros((own.size, gram.shape[1]))
                part[:, k * b : (k + 1) * b] = white[:, :b]
                part[:, 2 * b :] = white[:, b + k * m : b + (k + 1) * m]
                gram[d // BLOCK] += part.T @ part
        return cls(gram, lasting, tuple(c.size for c in columns))

    @cached_property
    def prior(self) -> Floats:
        """Precision of what lasts and of the slope, the variances those of the archive."""
        b, total = self.lasting.columns.shape[1], self.gram.sum(axis=0)
        s, steady, daily = 2 * b + 2, *VARIANCES
        for _ in range(ROUNDS):
            out = np.zeros((s, s))
            out[-2:, -2:] = np.diag(1 / np.square(SLOPE_SD))
            parts = []
            for start in (0, b):
                for k, own in enumerate(self.lasting.blocks):
                    here = slice(start + own.start, start + own.stop)
                    variance = daily if k else steady
                    out[here, here] = self.lasting.precision[k] / variance
                    parts.append((k > 0, here, self.lasting.precision[k]))
            doubt = np.linalg.inv(total[:s, :s] + out)
            mean = doubt @ total[:s, -1]
            square = [
                (late, (mean[h] @ p @ mean[h] + (doubt[h, h] * p).sum()) / p.shape[0])
                for late, h, p in parts
            ]
            steady = float(np.mean([value for late, value in square if not late]))
            daily = float(np.mean([value for late, value in square if late]))
        return out

    def weigh(self, k: int) -> Coefficient | None:
        """Weigh the ``k``-th column; None where nothing of it is left."""
        s, total = self.prior.shape[0], self.gram.sum(axis=0)
        told, own = s + k, s + len(self.sizes) + k
        inverse = np.linalg.inv(total[:s, :s] + self.prior)
        taken = inverse @ total[:s, told]
        whole = float(total[told, own] - taken @ total[:s, own])
        left = float(total[told, told] - taken @ total[:s, told])
        # what lasts takes all of it up, or told and true go opposite ways: days say nothing of its
        # size
        if self.sizes[k] == 0 or left <= 1e-6 * total[told, told] or whole <= 0:
            return None
        value = float(total[told, -1] - taken @ total[:s, -1]) / whole
        lasts = inverse @ (total[:s, -1] - value * total[:s, own])
        square = self.gram[:, told, own] - self.gram[:, own, :s] @ taken
        rest = self.gram[..., -1] - value * self.gram[..., own] - self.gram[:, :, :s] @ lasts
        apart = rest[:, told] - rest[:, :s] @ taken
        apart -= apart.mean()
        count = apart.size
        scatter = float((apart**2).sum()) * count / (count - 1)
        found = max(left, scatter) / whole**2
        error = float(np.sqrt(found + (PERSISTENT / self.sizes[k]) ** 2))
        score = apart + value * square
        others = (score.sum() - score) / (square.sum() - square)
        energy = 2 * others * score - others**2 * square
        doubt = float(energy.std(ddof=1) * np.sqrt(count))
        formal = abs(value) / float(np.sqrt(found))
        return Coefficient(value, error, formal, float(energy.sum()), doubt)
