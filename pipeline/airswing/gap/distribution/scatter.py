"""Reports that scatter more than simulated ones: of some aircraft, or as a function of a variable.

The log squared interpolation error of a report over its expectation, less that of simulated
archives, is a scalar y (Harvey 1976, Econometrica 44, 461-465), regressed on every variable
(docs/gap.md, section 6) with the usual variation of log variance in place of that of the wind. A
common curve of the bank, which is noise, is removed first; the level of each aircraft is compared
with the fleet's.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import Variable, cells_of
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.design import heading_doubt
from airswing.gap.distribution.entries import place_of, reduction_of_scatter
from airswing.gap.model.candidates import Curve, curve_of
from airswing.gap.model.evidence import ScopeEvidence, static_evidence
from airswing.gap.model.passes import Fitted
from airswing.gap.model.sums import GATE, days_of
from airswing.gap.model.terms import Statistics, noise_factor
from airswing.gap.noise import NoiseFit, interpolation_errors, whitening_gains
from airswing.gap.result.schema import CurveEntry, PlaceEntry
from airswing.gap.result.statement import curve_over
from airswing.gap.simulation.forward import Coding, draw_noise
from airswing.physics.robust_spread import robust_sd
from airswing.units import DAY

#: Simulated archives that the reports are compared with.
DRAWS = 2
#: Variance of the logarithm of an exponential variable (the squared length of two normal
#: components), pi^2 / 6, with that of the mean of the simulated ones.
LOG_VARIANCE = np.pi**2 / 6 * (1 + 1 / DRAWS)
#: Variation of log variance over weather and routes, and of single aircraft, that is no effect;
#: also the relative variation of the rate of gross errors.
NATURAL = 0.2
#: Reports an aircraft must have: the mean of their y is known to 0.11.
LEAST_REPORTS = 200


@dataclass(frozen=True)
class Excess:
    """Scatter of the reports beyond that of simulated ones."""

    logs: Floats  # (n,): y of the module; NaN where it is not used
    variance: Floats  # (n,): what the noise model expects, m2 s-2
    noise: NoiseFit  # the model, with gross errors masked only where they have a name


def log_squares(residual: Floats, noise: NoiseFit) -> tuple[Floats, Floats]:
    """Log squared interpolation error over its expectation, and that, (n,); NaN where masked."""
    errors, precision = interpolation_errors(residual, noise.order, noise.gains)
    square = 0.5 * (errors**2).sum(axis=1) * precision
    valid = (precision > 0) & (square > 0)
    unknown = np.full((2, valid.size), np.nan)
    logs = np.log(square, out=unknown[0], where=valid)
    return logs, np.divide(1.0, precision, out=unknown[1], where=valid)


def excess_log_squares(
    frame: Frame, context: Frame, residual: Floats, noise: NoiseFit, gross: Booleans, seed: int
) -> Excess:
    """Excess of the residual (n, 2), with the reports ``gross`` (n,) masked."""
    doubt = heading_doubt(frame, context)
    gains = whitening_gains(noise.model, noise.order, context, ~gross, doubt)
    noise = replace(noise, gains=gains, gross=gross)
    real, variance = log_squares(residual, noise)
    coding, rng = Coding.as_found(frame), np.random.default_rng(seed)
    total = np.zeros(frame.size)
    for _ in range(DRAWS):
        error = draw_noise(context, noise.model, rng=rng)
        u, v = coding.apply(frame.u_ref + error[:, 0], frame.v_ref + error[:, 1])
        simulated, _ = log_squares(np.stack([u - frame.u_ref, v - frame.v_ref], -1), noise)
        total += np.where(np.isfinite(simulated), simulated, 0.0) / DRAWS
    return Excess(real - total, variance, noise)


def find_scatter(
    fitted: Fitted,
    residual: Floats,
    *,
    gross: Booleans,
    named: Booleans,
    without: Collection[int] = (),
    seed: int = 0,
) -> PlaceEntry | None:
    """Reports that scatter more than simulated ones, where the log posterior odds pass the gate.

    ``residual`` (n, 2) is without the effects found; left out are gross errors that have a name
    (``named``) and aircraft (``without``) whose scatter has a name.
    """
    frame, variables = fitted.frame, fitted.model.sums.candidates.variables
    excess = excess_log_squares(frame, fitted.context, residual, fitted.noise, named, seed)
    y = np.where(np.isin(frame.aircraft, list(without)), np.nan, excess.logs)
    valid = np.isfinite(y)
    if valid.sum() < LEAST_REPORTS * 5:
        return None
    days, day, _ = days_of(frame)
    y = y - _mean_by_bank(frame, y, valid)
    excess = replace(excess, logs=y)
    best: tuple[float, str, ScopeEvidence] | None = None
    number = 2 * max(len(variables), 1)
    for name, variable in variables.items():
        curve = curve_of(name, variable.values)
        use = valid & np.isfinite(variable.values)
        if use.sum() < LEAST_REPORTS or (name != "magnetic_heading" and curve.knots.size < 2):
            continue
        functions = curve.functions(variable.values)
        statistics = _statistics(y, functions, curve, frame.aircraft, day, days.size, use)
        factor = max(1.0, statistics.mean_factor)
        scales = np.array([0.3, 0.6, 1.2])  # of log variance, of an effect
        by_scope = static_evidence(statistics, factor, "af", scales=scales, usual=NATURAL)
        for candidate in by_scope.values():
            score = candidate.evidence - np.log(number)
            if candidate.tails and score > GATE and (best is None or score > best[0]):
                best = score, name, candidate
    if best is None:
        return _by_aircraft(frame, excess, residual, gross)
    score, name, candidate = best
    return _by_variable(frame, excess, residual, gross, variables[name], candidate, score)


def _gain_of_independent(noise: NoiseFit, affected: Booleans) -> float:
    """Mean square interpolation error of independent errors of 1 m/s at affected reports."""
    errors = np.random.default_rng(0).standard_normal((affected.size, 2)) * affected[:, None]
    errors, precision = interpolation_errors(errors, noise.order, noise.gains)
    return float(np.mean(errors[affected & (precision > 0)] ** 2))


def _excess_size(excess: float, variance: Floats, gain: float) -> float:
    """Standard deviation s, m/s, with which the mean of log(1 + gain s^2 / variance) is excess."""
    sizes = np.geomspace(0.01, 100.0, 100)
    sampled = variance[:: max(1, variance.size // 2000)]
    logs = np.log1p(gain * sizes[:, None] ** 2 / sampled).mean(axis=1)
    return float(np.interp(excess, logs, sizes))


def _mean_by_bank(frame: Frame, y: Floats, valid: Booleans) -> Floats:
    bank = np.abs(np.degrees(np.nan_to_num(frame.bank)))
    edges = np.unique(np.quantile(bank[valid], np.linspace(0, 1, 13)[1:-1]))
    cell = np.searchsorted(edges, bank)
    count, total = _sums(cell, y, valid, edges.size + 1)
    return np.asarray((total / np.maximum(count, 1))[cell])


def _sums(key: Integers, y: Floats, used: Booleans, number: int) -> tuple[Floats, Floats]:
    count = np.bincount(key[used], minlength=number).astype(np.float64)
    return count, np.asarray(np.bincount(key[used], y[used], minlength=number), np.float64)


def _statistics(
    y: Floats,
    functions: Floats,
    curve: Curve,
    aircraft: Integers,
    day: Integers,
    days: int,
    use: Booleans,
) -> Statistics:
    """Scores and information of a curve of y, with the level of each aircraft free."""
    root = np.linalg.cholesky(curve.covariance + 1e-9 * np.eye(functions.shape[1]))
    number, m = int(aircraft.max()) + 1, root.shape[1]
    score = np.zeros((number, days, m))
    gram = np.zeros((number, days, m, m))
    values = functions @ root
    for a in range(number):
        index = np.flatnonzero(use & (aircraft == a))
        if index.size < LEAST_REPORTS:
            continue
        rows = values[index] - values[index].mean(axis=0)
        centred = y[index] - y[index].mean()
        order = np.argsort(day[index], kind="stable")
        cuts = np.searchsorted(day[index][order], np.arange(days + 1))
        for d in range(days):
            on_day = order[cuts[d] : cuts[d + 1]]
            if on_day.size:
                score[a, d] = rows[on_day].T @ centred[on_day] / LOG_VARIANCE
                gram[a, d] = rows[on_day].T @ rows[on_day] / LOG_VARIANCE
    return replace(noise_factor(score, gram), lasting=NATURAL**2)


def _by_variable(
    frame: Frame,
    excess: Excess,
    residual: Floats,
    gross: Booleans,
    variable: Variable,
    candidate: ScopeEvidence,
    evidence: float,
) -> PlaceEntry | None:
    """Excess over the quietest third of the cells, in m/s."""
    y = excess.logs
    edges = variable.edges(24)
    cell = cells_of(variable.values, edges)
    inside = np.isin(frame.aircraft, candidate.tails) & (cell >= 0)
    selected = inside & np.isfinite(y)
    even = frame.time // DAY % 2 == 0
    (count, total), (count_even, total_even) = (
        _sums(cell, y, reports, edges.size - 1) for reports in (selected, selected & even)
    )
    used = np.flatnonzero((count >= 30) & (count_even > 0) & (count_even < count))
    if used.size < 2:
        return None
    # even days select the quietest cells, odd ones give their mean, which is not selected
    order = np.argsort((total_even / np.maximum(count_even, 1))[used])
    lowest = used[order[: max(used.size // 3, 1)]]
    quiet = float((total - total_even)[lowest].sum() / (count - count_even)[lowest].sum())
    above = np.where(count >= 30, np.maximum(total / np.maximum(count, 1) - quiet, 0.0), 0.0)
    # three standard errors: none of two dozen cells by chance
    error = np.sqrt(LOG_VARIANCE / np.maximum(count, 1))
    above[above < np.maximum(3 * error, 0.2 * above.max())] = 0.0
    affected = inside & (above > 0)[np.maximum(cell, 0)]
    gain = _gain_of_independent(excess.noise, affected)
    values = np.zeros(above.size)
    for k in np.flatnonzero(above):
        ordinary = excess.variance[selected & (cell == k)] * np.exp(quiet)
        values[k] = _excess_size(above[k], ordinary, gain)
    sizes = np.where(inside, values[np.maximum(cell, 0)], 0.0)
    if not sizes.any():
        return None
    curve = curve_over([variable.name], [edges.tolist()], values, "m/s")
    typical = float(np.median(values[values > 0]))
    closure = reduction_of_scatter(residual, sizes, gross)
    found = candidate.tails, frame.tails, evidence, typical, curve, closure
    return place_of("scatter", variable.name, *found)


def _by_aircraft(
    frame: Frame, excess: Excess, residual: Floats, gross: Booleans
) -> PlaceEntry | None:
    y = excess.logs
    valid = np.isfinite(y)
    count, total = _sums(frame.aircraft, y, valid, len(frame.tails))
    used = np.flatnonzero(count >= LEAST_REPORTS)
    if used.size < 5:  # too few for a usual spread
        return None
    level = total[used] / count[used]
    ratio = 0.5 * (level - np.median(level))
    spread = max(robust_sd(ratio, 0.0), 0.03)
    evidence = 0.5 * (ratio / spread) ** 2 - np.log(2 * used.size)
    high = (ratio > 0.15) & (evidence > GATE)  # standard deviations 15 % above those of the fleet
    if not high.any():
        return None
    tails = tuple(int(a) for a in used[high])
    gain = _gain_of_independent(excess.noise, np.isin(frame.aircraft, tails))
    size = np.zeros(len(frame.tails))
    for a, log_ratio in zip(tails, 2 * ratio[high], strict=True):
        size[a] = _excess_size(log_ratio, excess.variance[valid & (frame.aircraft == a)], gain)
    best = float(evidence[high].max())
    curve = CurveEntry([frame.tails[a] for a in tails], size[list(tails)].tolist())
    closure = reduction_of_scatter(residual, size[frame.aircraft], gross)
    typical = float(np.median(size[size > 0]))
    return place_of("scatter", "scatter", tails, frame.tails, best, typical, curve, closure)
