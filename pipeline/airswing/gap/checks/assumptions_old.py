"""The assumptions a diagnosis rests on, each with a check made on the archive at hand.

Assumptions: none of its own. Every check is made after the search, on what it left, and changes no
verdict; a check that fails says which intervals and which claims deserve doubt.

Validity: limits (:data:`LIMITS`) are of practical size, not significance: with 100,000 reports
every model is wrong significantly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.checks.aliases import ALIAS, HIDDEN_ALIAS, MORE_REGION, alias_table
from airswing.gap.checks.calibration import BINS, Calibration, calibrate
from airswing.gap.checks.negative_control import Decoy, force_decoy
from airswing.gap.design.weather import climatology_columns, slope_columns
from airswing.gap.effects import separated_by
from airswing.gap.evidence.terms import Term, all_columns
from airswing.gap.held_out.days_left_out import folds_of_days
from airswing.gap.held_out.reduction import Closure
from airswing.gap.noise.model import NoiseFit
from airswing.gap.result.schema import (
    AliasEntry,
    AssumptionEntry,
    CalibrationPair,
    EffectEntry,
    GapReport,
    RivalEntry,
)
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.elimination import Base, climatology, fits_by_fold
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]

#: What is still taken for right: misfit of the autocovariance as a share of the variance,
#: departure of the whitened spread from 1 and of a PIT bin from its share, correlation of
#: neighbours, area under the classifier's curve, share of reports clipped, cluster factors of
#: one aircraft and of the fleet.
LIMITS = {
    "autocovariance": 0.1,
    "spread": 0.1,
    "pit": 0.25,
    "lag_one": 0.1,
    "auc": 0.6,
    "clipped": 0.02,
    "aircraft_factor": 2.0,
    "fleet_factor": 8.0,
}


@dataclass(frozen=True)
class Checks:
    """What the checks found."""

    # after, before: with the effects found in the simulation, and without
    after: Calibration
    before: Calibration
    decoy: Decoy
    aliases: list[AliasEntry]  # pairs of effects with more than 0.8 of their energy in common
    shares: dict[str, dict[str, float]]  # effect found -> other effect -> share of energy in common
    assumptions: list[AssumptionEntry]

    def told(self, report: GapReport) -> GapReport:
        """Return a report with what the checks found."""
        return replace(
            report,
            calibration=CalibrationPair(self.after.entry(), self.before.entry()),
            decoy=self.decoy.entry(),
            aliases=self.aliases,
            assumptions=self.assumptions,
        )

    def histograms(self) -> dict[str, tuple[str, object]]:
        """Return what ``gap.nc`` holds of them."""
        return {
            "pit_bin": ("pit_bin", np.arange(BINS) / BINS),
            "pit_count": ("pit_bin", self.after.pit_count.astype(np.int32)),
            "pit_count_before": ("pit_bin", self.before.pit_count.astype(np.int32)),
        }


def run_checks(problem: Problem, found: Found, closure: Closure) -> Checks:
    """Check what a diagnosis rests on.

    Parameters
    ----------
    closure : Closure
        Of what has a name.
    """
    frame, base, noise = problem.archive, problem.base, problem.noise
    day, seed = problem.day, problem.seed
    fold = folds_of_days(base.stats)[day]
    steady = held_out_climatology(problem, found.terms)
    after, before = (
        calibrate(frame, residual - steady, noise=noise, day=day, seed=seed)
        for residual in (closure.residual, frame.residual)
    )
    decoy = force_decoy(frame, closure.residual, noise=noise, day=day, fold=fold, seed=seed)
    aliases, shares = alias_table(base, found.terms, problem.effects)
    rows = assumptions(base=base, noise=noise, found=found, after=after, decoy=decoy)
    return Checks(after, before, decoy, aliases, shares, rows)


def held_out_climatology(problem: Problem, terms: Sequence[Term]) -> Floats:
    """Error of the reference that no effect is blamed for, fitted to other weeks.

    Parameters
    ----------
    terms : sequence of Term
        Fitted beside it.

    Returns
    -------
    (n, 2) float
        m s-1.
    """
    base, context = problem.base, problem.context
    fold = folds_of_days(base.stats)
    number = len(climatology(base))
    fits = fits_by_fold(base, all_columns(base, terms), fold)
    theta = np.stack([without.coefficients[:number] for without, _ in fits])
    columns = np.concatenate(
        [climatology_columns(context, problem.plan), slope_columns(context)], axis=-1
    )
    return np.asarray(np.einsum("ncq,nq->nc", columns, theta[fold[problem.day]]))


def assumptions(
    *, base: Base, noise: NoiseFit, found: Found, after: Calibration, decoy: Decoy
) -> list[AssumptionEntry]:
    """Every assumption with its check, the result in words, and whether it holds.

    Parameters
    ----------
    base, noise, found, after, decoy :
        Pieces of the diagnosis and its checks.
    """
    return [
        _noise_row(noise),
        _calibration_row(after),
        _neighbours_row(after),
        _classifier_row(after),
        _clipped_row(base),
        *_cluster_rows(found),
        _decoy_row(decoy),
    ]


def _row(assumption: str, check: str, result: str, ok: bool) -> AssumptionEntry:
    return AssumptionEntry(assumption, check, result, bool(ok))


def _noise_row(noise: NoiseFit) -> AssumptionEntry:
    there = np.isfinite(noise.autocovariance) & (noise.pair_count > 100)
    misfit = np.abs(noise.autocovariance - noise.autocovariance_model)[there]
    if not misfit.size or noise.autocovariance_model[0] <= 0:
        text, worst = "too few pairs of reports to tell", float("nan")
    else:
        worst = float(misfit.max() / noise.autocovariance_model[0])
        at = float(noise.distance_km[there][int(misfit.argmax())])
        text = f"largest misfit {100 * worst:.0f} % of the variance, at {at:.0f} km"
    return _row(
        "errors along a flight fall off with distance as the noise model says",
        "autocovariance against distance",
        text,
        worst < LIMITS["autocovariance"],
    )


def _calibration_row(after: Calibration) -> AssumptionEntry:
    number = after.pit_count.sum()
    if not np.isfinite(after.spread):
        return _row(
            "the error predicted for a report has the right size and shape",
            "PIT and CRPS of held-out reports",
            "too few held-out reports to tell",
            False,
        )
    share = after.pit_count * after.pit_count.size / max(int(number), 1)
    worst = float(np.abs(share - 1).max())
    excess = after.crps_m_s / after.crps_expected_m_s - 1 if after.crps_expected_m_s else 0.0
    return _row(
        "the error predicted for a report has the right size and shape",
        "PIT and CRPS of held-out reports",
        f"spread {after.spread:.2f} of the predicted, farthest PIT bin {100 * worst:.0f} % off, "
        f"CRPS {after.crps_m_s:.2f} m/s, {abs(100 * excess):.0f} % "
        f"{'over' if excess > 0 else 'under'} that expected",
        abs(after.spread - 1) < LIMITS["spread"] and worst < LIMITS["pit"],
    )


def _neighbours_row(after: Calibration) -> AssumptionEntry:
    return _row(
        "nothing is left between neighbours on a flight",
        "correlation of whitened held-out residuals at lag 1",
        f"{after.lag_one:.3f} ± {after.lag_one_standard_error:.3f}"
        if np.isfinite(after.lag_one)
        else "too few neighbours to tell",
        abs(after.lag_one) < LIMITS["lag_one"],
    )


def _classifier_row(after: Calibration) -> AssumptionEntry:
    known = np.isfinite(after.auc)
    text = (
        f"area under the curve {after.auc:.2f} ± {after.auc_standard_error:.2f} (0.5: cannot)"
        if known
        else "too few flights to tell"
    )
    return _row(
        "real flights cannot be told from flights of the improved simulation",
        "linear classifier, judged on flights it has not seen",
        text,
        bool(known and after.auc < LIMITS["auc"]),
    )


def _clipped_row(base: Base) -> AssumptionEntry:
    stats = base.stats
    number = max(float(stats.day_count.sum()), 1.0)
    clipped, gross = float(stats.clipped.sum()) / number, float(stats.gross.sum()) / number
    return _row(
        "gross errors are few, and do not steer the fit",
        "reports set aside or clipped at 5 standard deviations",
        f"{100 * gross:.2f} % set aside, {100 * clipped:.2f} % clipped",
        clipped + gross < LIMITS["clipped"],
    )


def _cluster_rows(found: Found) -> list[AssumptionEntry]:
    scores = [score for ranked in (*found.rivals, found.left) for score in ranked]
    rows = []
    for scope, who in (("aircraft", "of one aircraft"), ("fleet", "of the fleet")):
        factors = [s.factor for s in scores if s.candidate.scope == scope and s.candidate.known]
        if factors:
            middle, most = (float(np.quantile(factors, q)) for q in (0.5, 0.9))
            rows.append(
                _row(
                    f"days are independent enough for effects {who}",
                    "scatter of daily scores over that of independent reports",
                    f"factor {middle:.1f}, for one effect in ten over {most:.1f}; scores are "
                    "divided by it",
                    middle < LIMITS[f"{scope}_factor"],
                )
            )
    return rows


def _decoy_row(decoy: Decoy) -> AssumptionEntry:
    # what rounds to nothing has no sign
    held, fitted, low, high = (
        round(kt, 3) + 0.0 for kt in (decoy.held_out, decoy.fitted, *decoy.held_out_ci)
    )
    return _row(
        "what an effect closes on held-out flights is no luck",
        "a decoy, the deviation of other flights, forced in",
        f"closes {held:+.3f} kt [{low:+.3f}, {high:+.3f}] on held-out flights "
        f"({fitted:+.3f} where it was fitted)",
        decoy.closes_nothing,
    )


def with_aliases(
    entries: Sequence[EffectEntry],
    shares: Mapping[str, Mapping[str, float]],
    hidden: Mapping[str, Mapping[str, float]] | None = None,
) -> list[EffectEntry]:
    """Write the share of energy in common to each entry's rivals, and add its aliases.

    Parameters
    ----------
    entries : sequence of EffectEntry
        Rivals get an ``alias_share``; effects of a share of
        :data:`~airswing.gap.checks.aliases.ALIAS` and more are rivals however the evidence falls
        out, because a model error of a few hundredths decides between them.
    shares : mapping
        Effect -> other effect -> share.
    hidden : mapping, optional
        The same of effects that weather takes up; from
        :data:`~airswing.gap.checks.aliases.HIDDEN_ALIAS` they are rivals: silence does not exclude
        them.
    """
    out = []
    for entry in entries:
        own = shares.get(entry.name, {})
        unseen = (hidden or {}).get(entry.name, {})
        told = {rival.name for rival in entry.ambiguity}
        alike = {name: separated_by(entry.name, name) for name in own if own[name] >= ALIAS}
        alike |= {name: MORE_REGION for name in unseen if unseen[name] >= HIDDEN_ALIAS}
        rivals = [*entry.ambiguity]
        rivals += [RivalEntry(name, None, data) for name, data in alike.items() if name not in told]
        known = {**own, **unseen}
        rivals = [replace(rival, alias_share=known.get(rival.name)) for rival in rivals]
        names = [rival.name for rival in rivals]
        out.append(replace(entry, ambiguity=rivals, ambiguous_with=names))
    return out
