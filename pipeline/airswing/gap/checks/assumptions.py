"""The assumptions a diagnosis rests on, each with a check on the archive at hand.

Every check is made after the search, on what it left, and changes no claim; a check that fails says
which intervals and claims deserve doubt. Limits are of practical size, not of significance: with
100,000 reports every model is significantly wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.checks.calibration import BINS, Calibration, calibrate
from airswing.gap.checks.negative_control import Placebo, fitted_placebo
from airswing.gap.effects import separated_by
from airswing.gap.model.closure import Closure
from airswing.gap.model.passes import Fitted
from airswing.gap.model.refit import fold_of_day
from airswing.gap.model.terms import Term
from airswing.gap.noise.model import NoiseFit
from airswing.gap.result.schema import AliasEntry, AssumptionEntry, CalibrationPair, DecoyEntry

Floats = NDArray[np.float64]

#: Limits of practical size: misfit of the autocovariance as a share of the variance; deviation of
#: the whitened spread from 1 and of a PIT bin from its share; correlation of neighbours; area under
#: the classifier's curve; share of reports set aside; noise factor of single aircraft.
LIMITS = {
    "autocovariance": 0.1,
    "spread": 0.1,
    "pit": 0.25,
    "lag_one": 0.1,
    "auc": 0.6,
    "gross": 0.02,
    "factor": 2.0,
}
#: Share of energy in common from which two effects are listed.
LISTED = 0.8


@dataclass(frozen=True)
class Checks:
    """Entries of gap.json on what a diagnosis rests on."""

    calibration: CalibrationPair
    decoy: DecoyEntry
    aliases: list[AliasEntry]
    assumptions: list[AssumptionEntry]


def run_checks(
    fitted: Fitted, closure: Closure, *, seed: int = 0
) -> tuple[Checks, dict[str, tuple[str, object]]]:
    """Check what a diagnosis rests on.

    Returns
    -------
    checks : Checks
        Fields of `GapReport`.
    histograms : dict
        Variables of gap.nc.
    """
    sums, noise = fitted.model.sums, fitted.noise
    fold = fold_of_day(sums.D)
    steady = _held_out_climatology(fitted, fold)
    after, before = (
        calibrate(fitted.frame, residual - steady, noise=noise, day=sums.day, seed=seed)
        for residual in (closure.residual, fitted.frame.residual)
    )
    placebo = fitted_placebo(
        fitted.frame, closure.residual, noise=noise, day=sums.day, fold=fold[sums.day], seed=seed
    )
    rows = [
        _noise_row(noise),
        _calibration_row(after),
        _neighbours_row(after),
        _classifier_row(after),
        _gross_row(noise),
        _factor_row(fitted),
        _placebo_row(placebo),
    ]
    checks = Checks(
        CalibrationPair(after.entry(), before.entry()), placebo.entry(), aliases(fitted), rows
    )
    histograms: dict[str, tuple[str, object]] = {
        "pit_bin": ("pit_bin", np.arange(BINS) / BINS),
        "pit_count": ("pit_bin", after.pit_count.astype(np.int32)),
        "pit_count_before": ("pit_bin", before.pit_count.astype(np.int32)),
    }
    return checks, histograms


def _held_out_climatology(fitted: Fitted, fold: NDArray[np.int64]) -> Floats:
    """The reference's climatology as fitted to other days, (n, 2) m/s."""
    model, sums = fitted.model, fitted.model.sums
    width = model.base.group.size
    theta = fitted.exact.by_fold[:, :width] @ model.base.group.transform.T
    columns = sums.candidates.raw(model.base.group.columns)
    return np.asarray(np.einsum("ncq,nq->nc", columns, theta[fold[sums.day]]))


def aliases(fitted: Fitted) -> list[AliasEntry]:
    """Pairs of effects whose whitened columns share energy on these flights.

    The share of an effect's energy that another copies, tr(T' G_12 G_22^-1 G_21 T) / tr(T' G_11 T),
    on the aircraft of the effect; day fields eliminated and climatology projected out.
    """
    sums = fitted.model.sums
    found = [t for t in fitted.terms if t.group.named and not t.start]
    names = [g for g in sums.candidates.groups if g.kind == "name"]
    out: dict[tuple[str, str], float] = {}
    for term in found:
        own = _rows(fitted, term)
        total = float((own * own).sum())
        for group in names:
            if group.name == term.group.name:
                continue
            other = _rows(fitted, Term(group, term.scope, term.tails, 1.0))
            share = sum(
                _copied(own[rows], other[rows]) for rows in (sums.rows_of(a) for a in term.tails)
            ) / max(total, 1e-12)
            key = (term.group.name, group.name)
            out[key] = max(share, out.get(key, 0.0))
    return [
        AliasEntry(a, b, float(share), separated_by(a, b))
        for (a, b), share in sorted(out.items(), key=lambda item: -item[1])
        if share >= LISTED
    ]


def _rows(fitted: Fitted, term: Term) -> Floats:
    sums = fitted.model.sums
    rows = sums.rows[:, term.group.columns] @ term.group.transform.astype(np.float32)
    return np.asarray(rows, np.float64)


def _copied(own: Floats, other: Floats) -> float:
    """Energy of the first columns that the second ones copy."""
    if not own.size:
        return 0.0
    gram = other.T @ other
    ridge = 1e-6 * np.trace(gram) * np.eye(len(gram)) + 1e-12 * np.eye(len(gram))
    cross = other.T @ own
    return float((cross * np.linalg.solve(gram + ridge, cross)).sum())


def _noise_row(noise: NoiseFit) -> AssumptionEntry:
    there = np.isfinite(noise.autocovariance) & (noise.pair_count > 100)
    misfit = np.abs(noise.autocovariance - noise.autocovariance_model)[there]
    text, worst = "too few pairs of reports", float("nan")
    if misfit.size and noise.autocovariance_model[0] > 0:
        worst = float(misfit.max() / noise.autocovariance_model[0])
        at = float(noise.distance_km[there][int(misfit.argmax())])
        text = f"largest misfit {100 * worst:.0f} % of the variance, at {at:.0f} km"
    return AssumptionEntry(
        "errors along a flight fall off with distance as the noise model says",
        "autocovariance against distance",
        text,
        bool(worst < LIMITS["autocovariance"]),
    )


def _calibration_row(after: Calibration) -> AssumptionEntry:
    text, ok = "too few held-out reports", False
    if np.isfinite(after.spread):
        share = after.pit_count * after.pit_count.size / max(int(after.pit_count.sum()), 1)
        worst = float(np.abs(share - 1).max())
        text = (
            f"spread {after.spread:.2f} of the predicted, largest deviation of a PIT bin "
            f"{100 * worst:.0f} %, CRPS {after.crps_m_s:.2f} m/s "
            f"({after.crps_expected_m_s:.2f} m/s expected)"
        )
        ok = abs(after.spread - 1) < LIMITS["spread"] and worst < LIMITS["pit"]
    return AssumptionEntry(
        "the error predicted for a report has the right size and shape",
        "PIT and CRPS of held-out reports",
        text,
        bool(ok),
    )


def _neighbours_row(after: Calibration) -> AssumptionEntry:
    text = "too few neighbours"
    if np.isfinite(after.lag_one):
        text = f"{after.lag_one:.3f} ± {1.96 * after.lag_one_standard_error:.3f}"
    return AssumptionEntry(
        "neighbours on a flight are independent after whitening",
        "correlation of whitened held-out residuals at lag 1",
        text,
        bool(abs(after.lag_one) < LIMITS["lag_one"]),
    )


def _classifier_row(after: Calibration) -> AssumptionEntry:
    text = "too few flights"
    if np.isfinite(after.auc):
        error = 1.96 * after.auc_standard_error
        text = f"area under the curve {after.auc:.2f} ± {error:.2f} (0.5: no difference)"
    return AssumptionEntry(
        "real flights cannot be distinguished from flights of the improved simulation",
        "linear classifier, judged on flights it was not trained on",
        text,
        bool(after.auc < LIMITS["auc"]),
    )


def _gross_row(noise: NoiseFit) -> AssumptionEntry:
    share = float(noise.gross.mean())
    return AssumptionEntry(
        "gross errors are few and do not steer the fit",
        "reports that differ from both neighbours by five standard deviations",
        f"{100 * share:.2f} % set aside",
        share < LIMITS["gross"],
    )


def _factor_row(fitted: Fitted) -> AssumptionEntry:
    kappa = fitted.model.kappa
    return AssumptionEntry(
        "days are independent enough",
        "scatter of daily scores over that of independent reports",
        f"factor {kappa:.1f}, by which the noise variance is multiplied",
        kappa < LIMITS["factor"],
    )


def _placebo_row(placebo: Placebo) -> AssumptionEntry:
    held, fitted, low, high = (
        round(kt, 3) + 0.0 for kt in (placebo.held_out, placebo.fitted, *placebo.held_out_ci)
    )
    return AssumptionEntry(
        "an effect that cannot be at work closes nothing on held-out flights",
        "a placebo, the deviation evaluated at the headings of other flights",
        f"closes {held:+.3f} kt [{low:+.3f}, {high:+.3f}] on held-out flights "
        f"({fitted:+.3f} where it was fitted)",
        placebo.closes_nothing,
    )
