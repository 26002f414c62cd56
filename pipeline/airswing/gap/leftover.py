"""What effects that were not named could still close: silence excludes nothing.

Assumptions: every effect of the catalogue is at work beside those named with small odds, which its
own evidence raises or lowers; on which aircraft its mixture tells, how large its estimate and that
estimate's error. What it then closes is worked out to second order in its size, draw by draw; most
draws hold nothing. Effects are drawn independently of each other.

Validity: effects well under the disagreement itself (several m/s); those that act from a date on
count with the days they were found to act on. Swaps of tails, outliers and coding are not in it.

Source: GAP.md section 7; posterior of a spike-and-slab mixture.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.attribute import Found
from airswing.gap.closure import term_fields
from airswing.gap.dictionary import DictionaryPlan
from airswing.gap.evidence import LEAST_ACTING, Score
from airswing.gap.terms import Term

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Probability of any one effect to be at work that is not named, before its evidence is seen.
BESIDE = 0.05
#: Probability under which an effect is passed over.
LEAST_CHANCE = 0.002
#: Disagreement, m/s, under which a report no longer curves the closure.
LEAST_SPEED = 0.5


def left_over(
    frame: Any,
    found: Found,
    rng: np.random.Generator,
    draws: int,
    *,
    effects: Mapping[str, Any],
    plan: DictionaryPlan,
    day: Integers,
) -> Floats:
    """Draws of what the effects that were not named would close together.

    Parameters
    ----------
    frame : Frame
    found : Found
    rng : numpy.random.Generator
    draws : int
    effects : mapping
    plan : DictionaryPlan
    day : (n,) int
        Index of each report's day in the statistics.

    Returns
    -------
    (draws,) float
        Mean reduction over all reports, m s-1.
    """
    total = np.zeros(draws)
    for score in alternatives(found):
        odds = score.tempered + np.log(BESIDE / (1 - BESIDE))
        chance = 1 / (1 + np.exp(-odds))
        units = _units(found, score)
        if chance < LEAST_CHANCE or not units.any():
            continue
        term = Term(score.candidate, tuple(range(units.size)), score.period, score)
        fields = term_fields(frame, term, effects=effects, plan=plan)
        acts = _acting(frame, score, units, day)
        owner = np.zeros_like(frame.aircraft) if _of_fleet(score) else frame.aircraft
        slope, curve = closure_slopes(frame.residual[acts], fields[acts], owner[acts], units.size)
        steps = _drawn(found, score, units, rng, draws)
        steps *= (rng.uniform(size=draws) < chance)[:, None, None]
        closed = np.einsum("dak,ak->d", steps, slope)
        closed -= 0.5 * np.einsum("dak,akl,dal->d", steps, curve, steps, optimize=True)
        total += closed / frame.size
    return total


def alternatives(found: Found) -> list[Score]:
    """Likeliest form of every effect of the catalogue that was left over."""
    best: dict[tuple[str, str], Score] = {}
    for score in found.left:
        key = score.candidate.name, score.candidate.scope
        if score.candidate.known and (key not in best or score.tempered > best[key].tempered):
            best[key] = score
    return list(best.values())


def closure_slopes(
    residual: Floats, fields: Floats, owner: Integers, units: int
) -> tuple[Floats, Floats]:
    """First and second derivative of the summed disagreement by the coefficients of each unit.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    fields : (n, 2, k) float
        Wind error per unit of each coefficient.
    owner : (n,) int
        Unit whose coefficients act on the report.
    units : int

    Returns
    -------
    slope : (units, k) float
    curve : (units, k, k) float
        Taken off, coefficients c close ``slope c - c' curve c / 2``, summed over reports, m s-1.
    """
    speed = np.hypot(*residual.T)
    along = np.einsum("nc,nck->nk", residual / np.maximum(speed, 1e-9)[:, None], fields)
    inner = np.einsum("nck,ncl->nkl", fields, fields) - along[:, :, None] * along[:, None, :]
    inner /= np.maximum(speed, LEAST_SPEED)[:, None, None]
    k = fields.shape[-1]
    slope, curve = np.zeros((units, k)), np.zeros((units, k, k))
    np.add.at(slope, owner, along)
    np.add.at(curve, owner, inner)
    return slope, curve


def _of_fleet(score: Score) -> bool:
    return score.candidate.scope == "fleet"


def _units(found: Found, score: Score) -> NDArray[np.bool_]:
    """Aircraft, or the one fleet, that the effect may strike beside what is named."""
    key = score.candidate.name, score.candidate.scope
    taken = [t for term in found.terms if term.key == key for t in term.tails]
    if _of_fleet(score):
        return np.array([not taken])
    out = score.acting >= LEAST_ACTING
    out[taken] = False
    return np.asarray(out)


def _acting(frame: Any, score: Score, units: NDArray[np.bool_], day: Integers) -> NDArray[np.bool_]:
    """Reports on which the effect may act."""
    out = np.ones(frame.size, bool) if _of_fleet(score) else units[frame.aircraft]
    if score.period is not None:
        out &= (day >= score.period[0]) & (day < score.period[1])
    return np.asarray(out)


def _drawn(
    found: Found, score: Score, units: NDArray[np.bool_], rng: np.random.Generator, draws: int
) -> Floats:
    """Coefficients (draws, units, k) where the effect is at work; zero on aircraft not struck."""
    columns, given = score.candidate.columns, found.given
    pick = np.ix_(columns, columns)
    out = np.zeros((draws, units.size, columns.size))
    for unit in np.flatnonzero(units).tolist():
        if _of_fleet(score):
            gram, own, struck = given.fleet_gram[pick], given.fleet_score.sum(axis=0), 1.0
        else:
            gram, own = given.gram[unit][pick], given.score[unit].sum(axis=0)
            struck = float(score.posterior[unit])
        spread = np.linalg.inv(gram / score.factor + np.diag(1 / score.candidate.scales**2))
        middle = spread @ own[columns] / score.factor
        values, vectors = np.linalg.eigh(spread)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        steps = middle + rng.standard_normal((draws, columns.size)) @ root.T
        out[:, unit] = steps * (rng.uniform(size=draws) < struck)[:, None]
    return out
