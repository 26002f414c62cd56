"""Is the improved simulation's error the one it states: PIT, CRPS, autocorrelation, a classifier.

Assumptions: given the reports before it on its flight, a report's held-out residual is normal with
the mean and the standard deviation of the noise model's one-step prediction (the innovation of
:mod:`airswing.gap.noise.whitening`), u and v alike and independent. Held-out: the effects taken off
were fitted to other weeks. The classifier tries to tell held-out flights from flights of the
improved simulation: unit noise along the flight, and the fields that the aircraft of a day share.

Validity: reports taken for gross errors are left out (they are counted elsewhere). A flat PIT is
needed, not enough: it cannot see what the classifier looks for, a dependence on heading, level or
the rest of the flight. Intervals and standard errors count days, not reports.

Source: Gneiting, Balabdaoui & Raftery (2007), J. R. Stat. Soc. B 69, 243-268 (PIT, CRPS of the
normal distribution); Lopez-Paz & Oquab (2017) (two-sample classifier); the area under the curve as
the Mann-Whitney statistic, Hanley & McNeil (1982).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

from airswing.gap.archive.frame import Frame
from airswing.gap.design.weather import unit_vectors
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import whiten
from airswing.gap.result.schema import CalibrationEntry
from airswing.physics.robust_spread import robust_sd

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Bins of the PIT histogram.
BINS = 20
PARTS = 4  # of the flights, for the classifier


@dataclass(frozen=True)
class Calibration:
    """How well held-out residuals keep to what was predicted for them."""

    # (b,): wind components by predicted probability of a value below the one reported
    pit_count: Integers
    # crps_m_s, crps_expected_m_s: mean continuous ranked probability score, and what it is when the
    # prediction is right
    crps_m_s: float
    crps_expected_m_s: float
    spread: float  # standard deviation of the whitened residual, 1 when right
    # lag_one, lag_one_standard_error: correlation of the whitened residuals of neighbours on a
    # flight, 0 when right
    lag_one: float
    lag_one_standard_error: float
    # auc, auc_standard_error: chance that the classifier tells a held-out flight from a simulated
    # one, 0.5 when right
    auc: float
    auc_standard_error: float

    def entry(self) -> CalibrationEntry:
        """Everything but the histogram as ``gap.json`` holds it."""
        numbers = {k: float(value) for k, value in vars(self).items() if k != "pit_count"}
        return CalibrationEntry(**numbers)


def calibrate(
    frame: Frame,
    residual: Floats,
    *,
    noise: NoiseFit,
    day: Integers,
    seed: int = 0,
) -> Calibration:
    """Check held-out residuals against the noise model that predicts them.

    Parameters
    ----------
    residual : (n, 2) float
        Held-out residuals, m s-1.
    day : (n,) int
        Day of each report's flight.
    seed : int
        Of the simulated flights and of the classifier's halves.
    """
    rng = np.random.default_rng(seed)
    real = np.asarray(whiten(residual, noise.order, noise.gains))
    kept = noise.gains.weight > 0
    simulated: Floats = rng.normal(size=(real.shape[0], 2))
    values = real[kept]
    error = 1.0 / (noise.gains.weight[kept] * noise.gains.scale[kept])
    lag, lag_error = lag_one(real, kept, frame.flight, frame.time, day)
    auc, auc_error = two_sample(
        flight_features(frame, real, kept), flight_features(frame, simulated, kept), rng
    )
    return Calibration(
        pit_histogram(values),
        float(crps_normal(values, error[:, None]).mean()),
        float(error.mean() / np.sqrt(np.pi)),
        float(np.sqrt(np.mean(values**2))),
        lag,
        lag_error,
        auc,
        auc_error,
    )


def pit_histogram(values: Floats) -> Integers:
    """Count standardised values in bins of equal predicted probability; shape (BINS,).

    Parameters
    ----------
    values : (...) float
        Of unit variance where the prediction is right.
    """
    where = np.clip((norm.cdf(values) * BINS).astype(np.int64), 0, BINS - 1)
    return np.bincount(where.ravel(), minlength=BINS)


def crps_normal(values: Floats, error: Floats) -> Floats:
    """Continuous ranked probability score of a normal prediction.

    Parameters
    ----------
    values : (...) float
        Departures from the mean in standard deviations.
    error : (...) float
        The standard deviation.

    Returns
    -------
    (...) float
        In the unit of ``error``.
    """
    inner = values * (2 * norm.cdf(values) - 1) + 2 * norm.pdf(values) - 1 / np.sqrt(np.pi)
    return np.asarray(error * inner)


def lag_one(
    values: Floats, kept: NDArray[np.bool_], flight: Integers, time: Floats, day: Integers
) -> tuple[float, float]:
    """Correlation of neighbours on a flight, and its standard error over days.

    Parameters
    ----------
    values : (n, 2) float
        Whitened residuals.
    kept : (n,) bool
    flight, day : (n,) int
    time : (n,) float
        s.

    Returns
    -------
    correlation, standard_error : float
        NaN without neighbours, or where nothing is left of them.
    """
    order = np.lexsort((time, flight))
    order = order[kept[order]]
    before, after = order[:-1], order[1:]
    same = flight[before] == flight[after]
    before, after = before[same], after[same]
    if before.size < 2:
        return float("nan"), float("nan")
    product = (values[before] * values[after]).sum(axis=1)
    power = 0.5 * (values[before] ** 2 + values[after] ** 2).sum(axis=1)
    _, index = np.unique(day[after], return_inverse=True)
    top, bottom = np.bincount(index, product), np.bincount(index, power)
    if bottom.sum() <= 0.0:
        return float("nan"), float("nan")
    ratio = top.sum() / bottom.sum()
    return float(ratio), float(np.sqrt(((top - ratio * bottom) ** 2).sum()) / bottom.sum())


def flight_features(frame: Frame, values: Floats, kept: NDArray[np.bool_]) -> Floats:
    """Simple features of every flight with five reports or more.

    Parameters
    ----------
    values : (n, 2) float
        Whitened residuals (u, v).
    kept : (n,) bool

    Returns
    -------
    (f, k) float
        Sums over the root of the number of reports, of the residual along wind axes, across and
        along the heading plain and times sine and cosine of the magnetic heading; their squares;
        energy; product of neighbours.
    """
    index = np.lexsort((frame.time, frame.flight))
    index = index[kept[index]]
    _, number, count = np.unique(frame.flight[index], return_inverse=True, return_counts=True)
    own = values[index]
    cross, along = unit_vectors(frame.heading[index])
    sine, cosine = (f(frame.magnetic_heading[index]) for f in (np.sin, np.cos))
    sides = [(own * axis).sum(axis=1) for axis in (cross, along)]
    parts = [own[:, 0], own[:, 1], *sides, *(s * f for s in sides for f in (sine, cosine))]
    neighbour = np.zeros(index.size)
    same = number[1:] == number[:-1]
    neighbour[1:][same] = (own[1:] * own[:-1]).sum(axis=1)[same]
    root = np.sqrt(count)
    means = np.stack([np.bincount(number, np.nan_to_num(p)) / root for p in parts], -1)
    power = np.bincount(number, (own**2).sum(axis=1) - 2.0) / root
    linked = np.bincount(number, neighbour) / root
    features = np.column_stack([means, means**2, power, linked])
    # of fewer reports a flight's means are single values
    return np.asarray(features[count >= 5])


def two_sample(real: Floats, simulated: Floats, rng: np.random.Generator) -> tuple[float, float]:
    """Area under the curve of a linear discriminant, on flights it was not trained on.

    Each of `PARTS` parts is judged by the discriminant of the others.

    Parameters
    ----------
    real, simulated : (f, k) float
        Features by flight; row i of both is the same flight, and falls into the same part.

    Returns
    -------
    auc, standard_error : float
        NaN with fewer than 8 flights a part.
    """
    if real.shape[0] < 8 * PARTS:
        return float("nan"), float("nan")
    part = rng.permutation(np.arange(real.shape[0]) % PARTS)
    areas = []
    for p in range(PARTS):
        weights = discriminant(real[part != p], simulated[part != p])
        areas.append(area(real[part == p] @ weights, simulated[part == p] @ weights))
    number = real.shape[0]
    mean = float(np.mean(areas))
    # of a rank sum of two samples of one size where nothing tells them apart (Mann and Whitney
    # 1947)
    return mean, float(np.sqrt((2 * number + 1) / (12.0 * number**2)))


def discriminant(first: Floats, second: Floats) -> Floats:
    """Weights (k,) of Fisher's linear discriminant, extreme features drawn in to 5 robust sd."""
    both = np.vstack([first, second])
    # a feature all flights have alike would be divided by nothing
    scale = np.array([robust_sd(one) for one in both.T]) + 1e-9
    limit = 5.0 * scale
    middle = np.median(both, axis=0)
    low, high = middle - limit, middle + limit
    one, two = np.clip(first, low, high) / scale, np.clip(second, low, high) / scale
    # features in robust standard deviations: a constant one is not divided by nothing
    spread = np.cov(one.T) + np.cov(two.T) + 0.02 * np.eye(scale.size)
    return np.asarray(np.linalg.solve(spread, one.mean(axis=0) - two.mean(axis=0)) / scale)


def area(first: Floats, second: Floats) -> float:
    """Chance that a value of the first sample exceeds one of the second."""
    rank = rankdata(np.r_[first, second])
    n, m = first.size, second.size
    return float((rank[:n].sum() - n * (n + 1) / 2) / (n * m))
