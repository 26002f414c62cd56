"""Checks of the assumptions of a diagnosis on the archive at hand (docs/gap.md, section 9).

They are made after the search, on held-out residuals of the model without gross errors, and change
no claim. Limits are of practical size, not of significance: with 100,000 reports every model is
significantly wrong. Standard errors and intervals count days, not reports. Scatter, rounding and
exchanged identifiers remain where claims are fitted again.

Source: Gneiting, Balabdaoui and Raftery (2007), J. R. Stat. Soc. B 69, 243-268 (PIT, CRPS of the
normal distribution); Lopez-Paz and Oquab (2017) (two-sample classifier); Hanley and McNeil (1982)
(area under the curve as the Mann-Whitney statistic).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import mannwhitneyu, norm

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.design import unit_vectors
from airswing.gap.effects import separated_by
from airswing.gap.model.candidates import Group
from airswing.gap.model.closure import Closure, day_interval
from airswing.gap.model.passes import Fitted
from airswing.gap.model.refit import fold_of_day
from airswing.gap.noise import NoiseFit, whiten
from airswing.gap.result.schema import (
    AliasEntry,
    AssumptionEntry,
    CalibrationEntry,
    CalibrationPair,
    ClaimsEntry,
    FieldTestEntry,
    FitEntry,
    PlaceboEntry,
)
from airswing.physics.robust_spread import robust_sd
from airswing.physics.triangle import wrap_degrees
from airswing.units import KNOT, NORMAL_95

Options = Mapping[str, Any]  # a section of the configuration as keyword arguments
_SIDES = ("eastward", "northward")


def run_checks(
    fitted: Fitted, closure: Closure, *, seed: int = 0
) -> tuple[dict[str, Any], dict[str, tuple[str, object]]]:
    """Check the assumptions of a diagnosis: fields of `GapReport`, and variables of gap.nc.

    ``closure`` holds the held-out residual of all stated effects; ``seed`` is that of simulated
    flights and placebos.
    """
    frame, noise, model = fitted.frame, fitted.noise, fitted.model
    day, fold = model.sums.day, fold_of_day(model.sums.D)[model.sums.day]
    # the climatology of the reference as fitted to other days
    group = model.base.group
    theta = fitted.exact.by_fold[:, : group.size] @ group.transform.T
    columns = model.sums.candidates.raw(group.columns)
    climatology = np.einsum("ncq,nq->nc", columns, theta[fold])
    (after, pit_after), (before, pit_before) = (
        calibrate(frame, residual - climatology, noise=noise, day=day, seed=seed)
        for residual in (closure.residual, frame.residual)
    )
    placebo = fit_placebo(frame, closure.residual, noise=noise, day=day, fold=fold, seed=seed)
    fields = {
        "calibration": CalibrationPair(after, before),
        "placebo": placebo,
        "aliases": aliases(fitted),
        "assumptions": _assumptions(noise, model.kappa, after, pit_after, placebo),
    }
    return fields, {
        "pit_bin": ("pit_bin", np.arange(pit_after.size) / pit_after.size),
        "pit_count": ("pit_bin", pit_after.astype(np.int32)),
        "pit_count_before": ("pit_bin", pit_before.astype(np.int32)),
    }


def _assumptions(
    noise: NoiseFit, kappa: float, after: CalibrationEntry, pit: Integers, placebo: PlaceboEntry
) -> list[AssumptionEntry]:
    valid = np.isfinite(noise.autocovariance) & (noise.pair_count > 100)
    misfit = np.abs(noise.autocovariance - noise.autocovariance_model)[valid]
    correlation, worst = "too few pairs of reports", float("nan")
    if misfit.size and noise.autocovariance_model[0] > 0:
        worst = float(misfit.max() / noise.autocovariance_model[0])
        distance = float(noise.distance_km[valid][int(misfit.argmax())])
        correlation = f"largest misfit {100 * worst:.0f} % of the variance, at {distance:.0f} km"
    size, calibrated = "too few held-out reports", False
    if np.isfinite(after.spread):
        bin_error = float(np.abs(pit * pit.size / max(int(pit.sum()), 1) - 1).max())
        size = (
            f"spread {after.spread:.2f} of the predicted, largest deviation of a PIT bin "
            f"{100 * bin_error:.0f} %, CRPS {after.crps_m_s:.2f} m/s "
            f"({after.crps_expected_m_s:.2f} m/s expected)"
        )
        calibrated = abs(after.spread - 1) < 0.1 and bin_error < 0.25
    neighbours, classifier = "too few neighbours", "too few flights"
    if np.isfinite(after.lag_one):
        neighbours = f"{after.lag_one:.3f} ± {NORMAL_95 * after.lag_one_standard_error:.3f}"
    if np.isfinite(after.auc):
        error = NORMAL_95 * after.auc_standard_error
        classifier = f"area under the curve {after.auc:.2f} ± {error:.2f} (0.5: no difference)"
    gross = float(noise.gross.mean())
    reductions = placebo.reduction_kt, placebo.reduction_where_fitted_kt, *placebo.reduction_ci_kt
    held_out, where_fitted, low, high = (round(kt, 3) + 0.0 for kt in reductions)
    return [
        AssumptionEntry(
            "the correlation of errors along a flight follows the noise model",
            "autocovariance against distance",
            correlation,
            bool(worst < 0.1),
        ),
        AssumptionEntry(
            "the error predicted for a report has the right size and shape",
            "PIT and CRPS of held-out reports",
            size,
            bool(calibrated),
        ),
        AssumptionEntry(
            "neighbours on a flight are independent after whitening",
            "correlation of whitened held-out residuals at lag 1",
            neighbours,
            bool(abs(after.lag_one) < 0.1),
        ),
        AssumptionEntry(
            "real flights cannot be distinguished from flights of the improved simulation",
            "linear classifier, evaluated on flights on which it was not trained",
            classifier,
            bool(after.auc < 0.6),
        ),
        AssumptionEntry(
            "gross errors are few and do not influence the fit",
            "reports that differ from their neighbours by five standard deviations",
            f"{100 * gross:.2f} % set aside",
            gross < 0.02,
        ),
        AssumptionEntry(
            "days are independent enough",
            "scatter of daily scores over that of independent reports",
            f"factor {kappa:.1f}, by which the noise variance is multiplied",
            kappa < 2.0,
        ),
        AssumptionEntry(
            "an effect that cannot exist closes nothing on held-out days",
            "a placebo, the deviation evaluated at the headings of other flights",
            f"closes {held_out:+.3f} kt [{low:+.3f}, {high:+.3f}] on held-out days "
            f"({where_fitted:+.3f} where it was fitted)",
            placebo.closes_nothing,
        ),
    ]


# ------------------------------------------------------------------------------------- aliases
def aliases(fitted: Fitted) -> list[AliasEntry]:
    """List pairs of effects whose whitened columns share 80 % of their energy, largest first.

    The shared energy of an effect is tr(T' G_12 G_22^-1 G_21 T) / tr(T' G_11 T) over the aircraft
    of the effect, whitened by the noise along flights.
    """
    sums = fitted.model.sums
    shares: dict[tuple[str, str], float] = {}

    def whitened(group: Group) -> Floats:
        columns = sums.rows[:, group.columns]
        return np.asarray(columns @ group.transform.astype(np.float32), np.float64)

    for term in fitted.terms:
        if not term.group.named or term.period:
            continue
        columns = whitened(term.group)
        total = max(sum(float((columns[sums.rows_of(a)] ** 2).sum()) for a in term.tails), 1e-12)
        for group in sums.candidates.groups:
            if not group.named or group.dated or group.name == term.group.name:
                continue
            rival = whitened(group)
            energy = 0.0
            for rows in (sums.rows_of(a) for a in term.tails):
                gram, cross = rival[rows].T @ rival[rows], rival[rows].T @ columns[rows]
                ridge = (1e-6 * np.trace(gram) + 1e-12) * np.eye(len(gram))
                energy += float((cross * np.linalg.solve(gram + ridge, cross)).sum())
            key = (term.group.name, group.name)
            shares[key] = max(energy / total, shares.get(key, 0.0))
    return [
        AliasEntry(effect, rival, float(share), separated_by(effect, rival))
        for (effect, rival), share in sorted(shares.items(), key=lambda item: -item[1])
        if share >= 0.8
    ]


# --------------------------------------------------------------------------------- calibration
def calibrate(
    frame: Frame, residual: Floats, *, noise: NoiseFit, day: Integers, seed: int = 0
) -> tuple[CalibrationEntry, Integers]:
    """Compare held-out residuals (n, 2) with the noise model that predicts them.

    Where the prediction is correct the CRPS has its expectation (m s-1), the whitened residual the
    standard deviation 1, neighbours the correlation 0, and the area under the curve of the
    classifier is 0.5. Also returns the PIT histogram, (20,).
    """
    rng = np.random.default_rng(seed)
    real = np.asarray(whiten(residual, noise.order, noise.gains))
    used = noise.gains.weight > 0
    simulated: Floats = rng.normal(size=(real.shape[0], 2))
    values = real[used]
    sd = 1.0 / (noise.gains.weight[used] * noise.gains.scale[used])
    lag, lag_error = lag_one(frame, real, used, day)
    auc, auc_error = two_sample(
        flight_features(frame, real, used), flight_features(frame, simulated, used), rng
    )
    # in standard deviations; with the uniform probability integral transform
    probability = norm.cdf(values)
    score = values * (2 * probability - 1) + 2 * norm.pdf(values) - 1 / np.sqrt(np.pi)
    entry = CalibrationEntry(
        crps_m_s=float((sd[:, None] * score).mean()),
        crps_expected_m_s=float(sd.mean() / np.sqrt(np.pi)),
        spread=float(np.sqrt(np.mean(values**2))),
        lag_one=lag,
        lag_one_standard_error=lag_error,
        auc=auc,
        auc_standard_error=auc_error,
    )
    return entry, np.histogram(probability, 20, (0.0, 1.0))[0]


def lag_one(frame: Frame, values: Floats, used: Booleans, day: Integers) -> tuple[float, float]:
    """Correlation of neighbours on a flight and its standard error over days; NaN without any.

    ``values`` are whitened residuals (n, 2), ``used`` marks the reports in use.
    """
    order = np.lexsort((frame.time, frame.flight))
    order = order[used[order]]
    same = frame.flight[order[:-1]] == frame.flight[order[1:]]
    before, after = order[:-1][same], order[1:][same]
    product = (values[before] * values[after]).sum(axis=1)
    power = 0.5 * (values[before] ** 2 + values[after] ** 2).sum(axis=1)
    if before.size < 2 or power.sum() <= 0.0:
        return float("nan"), float("nan")
    _, index = np.unique(day[after], return_inverse=True)
    daily_product, daily_power = np.bincount(index, product), np.bincount(index, power)
    ratio = daily_product.sum() / daily_power.sum()
    scatter = np.sqrt(((daily_product - ratio * daily_power) ** 2).sum())
    return float(ratio), float(scatter / daily_power.sum())


def flight_features(frame: Frame, values: Floats, used: Booleans) -> Floats:
    """Features (f, k) of every flight with five reports or more for the classifier.

    Sums divided by the root of the number of reports: u, v, components across and along the
    heading, these times sine and cosine of the magnetic heading; their squares; energy; product of
    neighbours.
    """
    index = np.lexsort((frame.time, frame.flight))
    index = index[used[index]]
    _, number, reports = np.unique(frame.flight[index], return_inverse=True, return_counts=True)
    vectors = values[index]
    sine, cosine = (f(frame.magnetic_heading[index]) for f in (np.sin, np.cos))
    sides = [(vectors * axis).sum(axis=1) for axis in unit_vectors(frame.heading[index])]
    features = [*vectors.T, *sides, *(side * f for side in sides for f in (sine, cosine))]
    neighbour = np.zeros(index.size)
    same = number[1:] == number[:-1]
    neighbour[1:][same] = (vectors[1:] * vectors[:-1]).sum(axis=1)[same]
    root = np.sqrt(reports)
    means = np.stack([np.bincount(number, np.nan_to_num(x)) / root for x in features], -1)
    energy = np.bincount(number, (vectors**2).sum(axis=1) - 2.0) / root
    linked = np.bincount(number, neighbour) / root
    return np.asarray(np.column_stack([means, means**2, energy, linked])[reports >= 5])


def two_sample(real: Floats, simulated: Floats, rng: np.random.Generator) -> tuple[float, float]:
    """Cross-validated area under the curve of a linear discriminant, and its standard error.

    Row i of both samples of features is the same flight and is in the same part; NaN with fewer
    than 8 flights in a part.
    """
    number = real.shape[0]
    folds = 4
    if number < 8 * folds:
        return float("nan"), float("nan")
    fold = rng.permutation(np.arange(number) % folds)
    areas = []
    for p in range(folds):
        weights = _discriminant(real[fold != p], simulated[fold != p])
        first, second = (sample[fold == p] @ weights for sample in (real, simulated))
        # the probability that a value of the first sample exceeds one of the second
        areas.append(float(mannwhitneyu(first, second).statistic / (first.size * second.size)))
    # standard error of the rank sum of two samples of one distribution (Mann and Whitney 1947)
    return float(np.mean(areas)), float(np.sqrt((2 * number + 1) / (12.0 * number**2)))


def _discriminant(first: Floats, second: Floats) -> Floats:
    """Weights (k,) of Fisher's linear discriminant, with features clipped at 5 robust sd."""
    samples = np.vstack([first, second])
    scale = np.array([robust_sd(feature) for feature in samples.T]) + 1e-9  # constant features
    middle = np.median(samples, axis=0)
    low, high = middle - 5.0 * scale, middle + 5.0 * scale
    x, y = (np.clip(sample, low, high) / scale for sample in (first, second))
    spread = np.cov(x.T) + np.cov(y.T) + 0.02 * np.eye(scale.size)
    return np.asarray(np.linalg.solve(spread, x.mean(axis=0) - y.mean(axis=0)) / scale)


# ------------------------------------------------------------------------------------- placebo
def fit_placebo(
    frame: Frame, residual: Floats, *, noise: NoiseFit, day: Integers, fold: Integers, seed: int = 0
) -> PlaceboEntry:
    """Fit placebos to a residual on all folds but one, and measure the reduction on that one, kt.

    ``day`` and ``fold`` are those of each report; the 95 % interval is over days.
    """
    rng = np.random.default_rng(seed)
    target = np.asarray(whiten(residual, noise.order, noise.gains))
    before = np.hypot(*residual.T)
    draws, (fitted, held_out) = 4, np.zeros((2, frame.size))
    for _ in range(draws):
        columns = placebo_columns(frame, rng)
        white = np.asarray(whiten(columns, noise.order, noise.gains))
        errors = placebo_errors(columns, white, target, frame.aircraft, fold)
        for total, error in zip((fitted, held_out), errors, strict=True):
            total += (before - np.hypot(*(residual - error).T)) / draws
    low, high = day_interval(held_out / KNOT, day, seed)
    reduction = float(held_out.mean()) / KNOT
    return PlaceboEntry(
        reduction_kt=reduction,
        reduction_ci_kt=[low, high],
        reduction_where_fitted_kt=float(fitted.mean()) / KNOT,
        draws=draws,
        closes_nothing=low <= 0.0 or reduction < 0.01,
    )


def placebo_columns(frame: Frame, rng: np.random.Generator) -> Floats:
    """Columns (n, 2, 2) of one cycle in the magnetic heading of other flights, m s-1 per rad."""
    order = np.lexsort((frame.time, frame.flight))
    _, start, number, reports = np.unique(
        frame.flight[order], return_index=True, return_inverse=True, return_counts=True
    )
    source = rng.permutation(start.size)[number]
    position = np.arange(order.size) - start[number]
    donor = order[start[source] + np.mod(position, reports[source])]
    heading = np.empty(order.size)
    heading[order] = np.nan_to_num(frame.magnetic_heading)[donor]
    across, _ = unit_vectors(frame.heading)
    cycle = np.stack([np.sin(heading), np.cos(heading)], -1)
    return np.asarray(-(frame.airspeed[:, None] * across)[:, :, None] * cycle[:, None, :])


def placebo_errors(
    columns: Floats, white: Floats, target: Floats, aircraft: Integers, fold: Integers
) -> tuple[Floats, Floats]:
    """Fit columns (n, 2, k) to each aircraft on all folds, and on all but that of the report.

    ``white`` are the same whitened, ``target`` the whitened residual. Returns the wind errors of
    the two fits, (n, 2) m s-1.
    """
    fleet, folds, k = int(aircraft.max()) + 1, int(fold.max()) + 1, columns.shape[-1]
    score, gram = np.zeros((fleet, folds, k)), np.zeros((fleet, folds, k, k))
    np.add.at(score, (aircraft, fold), np.einsum("nci,nc->ni", white, target))
    np.add.at(gram, (aircraft, fold), np.einsum("nci,ncj->nij", white, white))
    ridge = np.eye(k) / np.radians(2.0) ** 2  # prior of a deviation
    all_score, all_gram = score.sum(axis=1, keepdims=True), gram.sum(axis=1, keepdims=True)
    everything = np.linalg.solve(all_gram + ridge, all_score[..., None])[:, 0, :, 0]
    by_fold = np.linalg.solve(all_gram - gram + ridge, (all_score - score)[..., None])[..., 0]
    fitted = np.einsum("nck,nk->nc", columns, everything[aircraft])
    return np.asarray(fitted), np.asarray(np.einsum("nck,nk->nc", columns, by_fold[aircraft, fold]))


# -------------------------------------------------------------------------------- claims again
@dataclass(frozen=True)
class Adjustment:
    """Corrections of the winds for all diagnosed effects other than the deviation."""

    report: Integers  # (n,): rows of the headings
    # (n, 2): to be added to the reported and to the reference wind (u, v), m s-1
    reported: Floats
    reference: Floats
    names: tuple[str, ...]  # the removed effects


def adjusted_headings(headings: xr.Dataset, adjustment: Adjustment) -> xr.Dataset:
    """Correct winds, headings, airspeeds and their errors on the rows of an adjustment."""
    rows = adjustment.report
    names = ["heading", "magnetic_heading", "airspeed", "heading_error", "airspeed_error"]
    names += [f"{prefix}{side}_wind" for prefix in ("", "reference_") for side in _SIDES]
    old = {name: headings[name].transpose(..., "report") for name in names}
    new = {name: np.array(values.to_numpy(), np.float64) for name, values in old.items()}
    air, implied = [], []
    for k, side in enumerate(_SIDES):
        ground = headings[f"ground_{side}_velocity"].to_numpy()[rows].astype(np.float64)
        new[f"{side}_wind"][rows] += adjustment.reported[:, k]
        new[f"reference_{side}_wind"][:, rows] += adjustment.reference[:, k]
        air.append(ground - new[f"{side}_wind"][rows])
        implied.append(ground - new[f"reference_{side}_wind"][:, rows])
    heading, airspeed = np.degrees(np.arctan2(*air)), np.hypot(*air)
    new["heading"][rows] = heading % 360.0
    new["airspeed"][rows] = airspeed
    declination = headings["declination"].to_numpy()[rows].astype(np.float64)
    new["magnetic_heading"][rows] = (heading - declination) % 360.0
    new["heading_error"][:, rows] = wrap_degrees(heading - np.degrees(np.arctan2(*implied)))
    new["airspeed_error"][:, rows] = airspeed - np.hypot(*implied)
    return headings.assign({name: (old[name].dims, values) for name, values in new.items()})


def review_claims(
    headings: xr.Dataset,
    adjustment: Adjustment,
    *,
    pools: Mapping[str, Sequence[str]],
    reference: str,
    fit: Options,
    field_test: Options | None = None,
) -> ClaimsEntry:
    """Fit the deviations and the field test before and after the other effects are removed.

    ``reference`` is one of the ``pools``; ``fit`` and ``field_test`` are options of `fit_deviation`
    and `field_test`. Without fits where no effect was removed.
    """
    names = list(adjustment.names)
    if not names:
        return ClaimsEntry(names)
    from airswing.compass.fit.deviation import fit_deviation

    adjusted = adjusted_headings(headings, adjustment)
    members = list(pools[reference])
    before, after = (
        fit_deviation(ds, pools={reference: members}, alone=False, **fit).sel(reference=reference)
        for ds in (headings, adjusted)
    )
    fits = compared_fits(before, after)
    judged = [entry.stays for entry in fits if entry.stays is not None]
    claims = ClaimsEntry(names, fits, stay=sum(judged), of=len(judged))
    if field_test is None:
        return claims
    from airswing.evaluation.field_test import field_test as tested

    first, second = (
        tested(ds, pools={reference: members}, reference=reference, **field_test)
        for ds in (headings, adjusted)
    )
    low, high = (float(end) for end in first["adjusted_reduction_ci_kt"])
    now, then = (float(test["adjusted_reduction_kt"]) for test in (second, first))
    return replace(claims, field_test=FieldTestEntry(then, [low, high], now, low <= now <= high))


def compared_fits(before: xr.Dataset, after: xr.Dataset) -> list[FitEntry]:
    """Compare offset and amplitude of each aircraft with the 95 % intervals of the first fit."""
    entries = []
    for tail in before["aircraft"].to_numpy():
        first, second = before.sel(aircraft=tail), after.sel(aircraft=tail)
        numbers: dict[str, float] = {}
        stays = True
        for name in ("offset", "amplitude"):
            value, adjusted = float(first[name]), float(second[name])
            error = float(first[f"{name}_standard_error"])
            numbers |= {
                f"{name}_deg": value,
                f"{name}_deg_after": adjusted,
                f"{name}_deg_standard_error": error,
            }
            stays &= abs(adjusted - value) <= NORMAL_95 * error
        trusted = int(first["status"]) == 0 and int(second["status"]) == 0
        entries.append(FitEntry(str(tail), **numbers, stays=bool(stays) if trusted else None))
    return entries
