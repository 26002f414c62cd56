"""Errors that last a flight or a day and differ from one to the next, so that no mean shows them.

A heading reference that is set before each flight, or a disturbance of some days, are examples. In
a flight (or an aircraft's day) with the unit change x of a component, the error t = x'V^-1 r / g,
g = x'V^-1 x, has the variance kappa / g by noise. Where an effect acts, a share of the flights has
an additional variance. Both are laws of Student, since weather has heavy tails (docs/gap.md,
section 6).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln
from scipy.stats import norm

from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.distribution.entries import place_of, reduction_of_scatter
from airswing.gap.distribution.scatter import NATURAL
from airswing.gap.model.candidates import COMPONENTS
from airswing.gap.model.evidence import INCLUDED, SCALES, log_sum, share_of_aircraft
from airswing.gap.model.pairs import report_scores
from airswing.gap.model.passes import Fitted
from airswing.gap.model.sums import GATE
from airswing.gap.result.schema import CurveEntry, PlaceEntry
from airswing.gap.result.statement import SETTLED

#: Degrees of freedom that the noise may have: from the heaviest tails with a variance to normal.
FREEDOM = np.array([3.0, 5.0, 10.0, 30.0, 300.0])
#: Factors on the largest noise factor that the values allow; most aircraft may have an effect.
KAPPAS = np.geomspace(0.2, 1.0, 6)
#: Shares of the flights that an effect acts on.
ACTING = np.array([1.0, 0.3, 0.1, 0.03])
#: Factors on the variance by noise of single aircraft, standard deviations of `NATURAL` apart.
USUAL = np.exp(NATURAL * np.array([-2.0, -1.0, 0.0, 1.0, 2.0]))


def find_lasting_errors(fitted: Fitted, residual: Floats, gross: Booleans) -> PlaceEntry | None:
    """Find errors that differ between flights or days, where the log odds pass the gate.

    ``residual`` (n, 2) is without the effects found, for the closure; ``gross`` marks gross errors.
    """
    frame, sums = fitted.frame, fitted.model.sums
    score = report_scores(fitted.model)
    days = frame.aircraft * sums.D + sums.day
    best: tuple[float, str, str, tuple[int, ...], Floats] | None = None
    for component in COMPONENTS:
        unit = sums.candidates.unit_change(component)
        unit = unit / np.sqrt((unit**2).sum(axis=1).mean())  # 1 m/s rms
        white = np.empty((frame.size, 2))
        white[sums.order] = sums.whitened(unit[:, :, None]).reshape(frame.size, 2)
        for variable, key in (("flight", frame.flight), ("date", days)):
            _, first, period = np.unique(key, return_index=True, return_inverse=True)
            information = np.bincount(period, (white**2).sum(axis=1)).astype(float)
            value = np.bincount(period, (score * unit).sum(axis=1)).astype(float)
            found = _evidence(value, information, frame.aircraft[first], len(frame.tails))
            if found is not None and (best is None or found[0] > best[0]):
                evidence, affected, square = found
                best = evidence, variable, component, affected, square[period]
    if best is None:
        return None
    evidence, variable, component, affected, square = best
    size = np.sqrt(square / 2) * np.isin(frame.aircraft, affected)  # of each direction
    closure = reduction_of_scatter(residual, size, gross)
    root = [float(np.sqrt(np.mean(square[frame.aircraft == a]))) for a in affected]
    curve = CurveEntry([frame.tails[a] for a in affected], root)
    typical = float(np.median(root))
    place = place_of(component, variable, affected, frame.tails, evidence, typical, curve, closure)
    title, settled = f"differs between {variable}s", SETTLED["flight"]
    return replace(place, title=title, settled_by=settled)


def _evidence(
    score: Floats, information: Floats, aircraft: Integers, number: int
) -> tuple[float, tuple[int, ...], Floats] | None:
    """Log evidence of an effect, the affected aircraft, and the mean square in each period."""
    used = np.flatnonzero(information > 0.0)
    if not used.size:
        return None
    owner, value = aircraft[used], score[used] / information[used]
    # half of all values are below the median of the law of those without an effect
    largest = float(np.median(value**2 * information[used])) / norm.ppf(0.75) ** 2
    noises = KAPPAS[:, None] * largest / information[used]
    by_freedom = [[_Fit.of(value, noise, owner, number, nu) for noise in noises] for nu in FREEDOM]
    # tails are known to be heavy: they are those without an effect
    fits = max(by_freedom, key=lambda fits: max(fit.nothing for fit in fits))
    best = max(fits, key=lambda fit: fit.total)
    evidence = best.total - max(fit.nothing for fit in fits) - float(np.log(2 * len(COMPONENTS)))
    tails = tuple(int(a) for a in np.flatnonzero(best.inclusion > INCLUDED))
    square = np.zeros(score.size)
    square[used] = best.square
    return (evidence, tails, square) if tails and evidence > GATE else None


class _Fit(NamedTuple):
    """Periods with given noise, with and without an effect."""

    nothing: float  # log likelihood without an effect
    total: float  # the same integrated over effects and aircraft
    inclusion: Floats  # (aircraft,): probability of an effect
    square: Floats  # (periods,): expected mean square of the error, m2 s-2

    @classmethod
    def of(cls, value: Floats, noise: Floats, owner: Integers, number: int, freedom: float) -> _Fit:
        def density(variance: Floats) -> Floats:  # Student's, but for a constant
            ratio = np.log1p(value**2 / (freedom * variance))
            return np.asarray(-0.5 * (np.log(variance) + (freedom + 1) * ratio))

        usual = density(USUAL[:, None] * noise)  # (factor, period)
        wide = density(USUAL[:, None] * noise + SCALES[:, None, None] ** 2)
        acting = np.log(ACTING)[:, None, None, None] + wide
        resting = np.log1p(-np.minimum(ACTING, 1 - 1e-12))[:, None, None, None] + usual
        mixed = np.logaddexp(acting, resting)  # (share, scale, factor, period)
        weight = -0.5 * (np.log(USUAL) / NATURAL) ** 2
        weight = weight - log_sum(weight)
        constant = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(freedom)
        nothing, gain, square = value.size * constant, np.zeros(number), np.zeros(value.size)
        for a in np.unique(owner):
            at = np.flatnonzero(owner == a)
            without = log_sum(usual[:, at].sum(axis=1) + weight)
            options = mixed[..., at].sum(axis=-1) + weight - np.log(ACTING.size * SCALES.size)
            nothing += without
            gain[a] = log_sum(options, axis=None) - without
            j, s, w = np.unravel_index(int(options.argmax()), options.shape)
            shrunk = SCALES[s] ** 2 / (SCALES[s] ** 2 + USUAL[w] * noise[at])
            expected = (shrunk * value[at]) ** 2 + shrunk * USUAL[w] * noise[at]
            square[at] = np.exp(acting[j, s, w, at] - mixed[j, s, w, at]) * expected
        evidence, inclusion = share_of_aircraft(gain)
        return cls(float(nothing), float(nothing) + evidence, inclusion, square)
