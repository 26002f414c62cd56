"""Speeds above a ceiling that are sent as the ceiling: found and lifted before anything is fitted.

Assumptions: stronger winds are rarer, so speeds pile up at the greatest one sent only where it is
a bound; then the reference is stronger there as often as not, while a speed that is greatest by
chance errs upward. The direction sent is right. The error along the wind (reported less reference)
of a bounded report follows those of its flight and is at least what the bound leaves: an
autoregression along the flight, truncated below, drawn by Gibbs sampling. Whatever is fitted to
means would meet a truncated error: so the search begins with the speeds drawn.

Validity: one bound for all aircraft that have one, 25 reports at it each, on five days or more. The
error's scale (by level), mean and correlation are of reports whose reference is too weak to be
bounded.

Source: Geman & Geman (1984), IEEE PAMI 6, 721-741; Chib (1992), Journal of Econometrics 51, 79-99
(censored regression by data augmentation).

Units: m/s.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.mended import Mended, shortened
from airswing.gap.taken_off.closed_by_table import DRAWS
from airswing.physics.robust_spread import robust_sd
from airswing.units import KNOT

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Reports of an aircraft at the bound, at least, and how many times those of a knot below it.
LEAST_COUNT, PILED = 25, 4.0
#: What a report at the bound may differ from it by for the rounding of its components, kt.
TOUCHING = 0.2
#: Days on which a bound must have been met.
LEAST_DAYS = 5
#: Share of the reports at the bound that may lie beyond it: gross errors, added afterwards.
BEYOND = 0.1
#: What the reference must lie under the bound by for a report not to be bounded, m/s.
MARGIN = 6.0
#: Levels by which the error's scale is told, reports of each at least, sweeps, archives drawn.
LEVELS, LEAST_LEVEL, SWEEPS, CHAINS = 4, 200, 30, 8


def ceiling_of(frame: Frame) -> Mended | None:
    """Find a bound on the speeds sent, and draw the winds without it.

    Returns
    -------
    Mended or None
        With the map of speeds that ends in it.
        None where speeds do not pile up at the greatest.
    """
    speed = np.hypot(frame.u_rep, frame.v_rep)
    knots = speed / KNOT
    found = {a: _bound(knots[frame.aircraft == a]) for a in range(len(frame.tails))}
    bounds = {a: one for a, one in found.items() if one is not None}
    if not bounds:
        return None
    limit = float(np.median([bound for bound, _ in bounds.values()]))
    # kt: the median of several bounds may lie half way between two
    tails = tuple(a for a, (bound, _) in bounds.items() if abs(bound - limit) <= 0.6)
    if not tails:
        return None
    own = np.isin(frame.aircraft, tails)
    at = own & (np.abs(knots - limit) <= TOUCHING)
    along = np.divide(
        frame.u_rep * frame.u_ref + frame.v_rep * frame.v_ref,
        speed,
        out=np.zeros(frame.size),
        where=speed > 0,
    )
    if np.median(along[at]) < limit * KNOT:
        return None  # what errs upward is greatest by chance
    if np.unique(frame.day[at]).size < LEAST_DAYS:
        return None  # a speed that was stuck for a flight or a day, and nothing to confirm it
    strength = np.hypot(frame.u_ref, frame.v_ref)
    # along the reference, not along a weak wind's own direction: that would err upward
    plain = (frame.residual * np.stack([frame.u_ref, frame.v_ref], -1)).sum(axis=1)
    error = np.where(at, speed - along, plain / np.maximum(strength, 0.1))
    drawn = _drawn(frame, error, at, calm=own & (strength < limit * KNOT - MARGIN))
    if drawn is None:
        return None
    factors = 1 + (drawn - error) / np.maximum(speed, 1.0)
    winds = factors[..., None] * np.stack([frame.u_rep, frame.v_rep], -1)
    saved = shortened(frame, winds)
    means = saved.mean(axis=1)
    middle = int(np.argmin(np.abs(means - means.mean())))  # of the archives drawn the middlemost
    bound = limit * KNOT
    edges = 0.0, bound, max(bound, float(np.hypot(*winds[middle].T).max())) + 1.0
    return Mended(
        "reported_speed",
        ("wind_speed",),
        "greatest speed sent",
        tails,
        float(sum(nats for a, (_, nats) in bounds.items() if a in tails)),
        float(np.sqrt(np.mean((drawn[middle] - error)[at] ** 2))),
        without(frame, winds[middle] - np.stack([frame.u_ref, frame.v_ref], -1)),
        saved[middle],
        _spread(means),
        tuple(f"{speed:.3g}" for speed in edges),
        (0.0, bound, bound),
        "m/s",
        edges,
    )


def _bound(knots: Floats) -> tuple[float, float] | None:
    """Speed at which an aircraft's pile up, kt, and the evidence, nats; None where they do not."""
    count = np.bincount(np.round(knots).astype(int))
    often = np.flatnonzero(count >= LEAST_COUNT)
    # kt: nobody bounds winds as weak as this; the distribution of speeds itself begins there
    if often.size == 0 or often[-1] < 10:
        return None
    top = int(often[-1])
    here = float(count[top])
    # what the five knots below would let expect; of none at least one report
    expected = max(float(count[max(top - 5, 0) : top].mean()), 1.0)
    if here < PILED * expected or count[top + 1 :].sum() > BEYOND * here:
        return None
    limit = float(np.median(knots[np.abs(knots - top) <= 0.5]))
    return limit, here * np.log(here / expected) - (here - expected)


def _drawn(frame: Frame, error: Floats, at: Mask, *, calm: Mask) -> Floats | None:
    """Errors along the wind with those of bounded reports drawn, (chains, n), m/s."""
    if calm.sum() < LEAST_LEVEL:
        return None
    order = np.lexsort((frame.time, frame.flight))
    near = frame.flight[order][1:] == frame.flight[order][:-1]
    mean, *doubts = _by_strength(np.hypot(frame.u_ref, frame.v_ref), error, calm)
    scale = scale_by_level(frame, error - mean, calm)
    whitened = ((error - mean) / scale)[order]
    both = near & calm[order][1:] & calm[order][:-1]
    pair = np.clip(whitened, -4, 4)
    shared = (pair[1:] * pair[:-1])[both].mean() if both.any() else 0.0
    # below one: the next error is drawn with what is left, sqrt(1 - phi^2)
    phi = float(np.clip(shared / np.mean(pair[calm[order]] ** 2), 0.0, 0.98))
    out = np.empty((CHAINS, frame.size))
    for chain in range(CHAINS):
        rng = np.random.default_rng(chain)
        # what the reference errs by in winds as strong as these is known no better than this
        shift, larger = doubts[0] * rng.standard_normal(), np.exp(doubts[1] * rng.standard_normal())
        own = larger * scale
        made = _gibbs(((error - mean - shift) / own)[order], at[order], phi * near, rng)
        out[chain, order] = made * own[order] + mean + shift
    return np.where(at, np.maximum(out, error), error)


def _by_strength(strength: Floats, error: Floats, calm: Mask) -> tuple[float, float, float]:
    """Mean of the error, and how far it and its scale's logarithm differ by strength of wind."""
    edges = np.quantile(strength[calm], np.linspace(0, 1, LEVELS + 1)[1:-1])
    part, own = np.searchsorted(edges, strength[calm]), error[calm]
    parts = [own[part == k] for k in range(LEVELS) if np.count_nonzero(part == k) > 1]
    middles = [float(np.median(one)) for one in parts]
    scales = [_scale(one - middle) for one, middle in zip(parts, middles, strict=True)]
    return float(np.median(own)), float(np.std(middles)), float(np.std(np.log(scales)))


def _scale(error: Floats) -> float:
    """Standard deviation by the median, m/s."""
    # it divides: a level whose few reports agree must not make others infinitely far off
    return max(robust_sd(error, 0.0), 0.1)


def scale_by_level(frame: Frame, error: Floats, calm: Mask) -> Floats:
    """Scale of the error at every report's level, (n,)."""
    level = np.log(frame.pressure)
    edges = np.quantile(level[calm], np.linspace(0, 1, LEVELS + 1))
    centres, scales = [], []
    for low, high in pairwise(edges):
        own = calm & (level >= low) & (level <= high)
        if own.sum() >= LEAST_LEVEL // LEVELS:
            centres.append(float(np.median(level[own])))
            scales.append(_scale(error[own]))
    if not centres:
        return np.full(frame.size, _scale(error[calm]))
    return np.asarray(np.interp(level, centres, scales))


def _gibbs(start: Floats, bounded: Mask, phi: Floats, rng: np.random.Generator) -> Floats:
    """Draw bounded values, at least what they are, beside their neighbours along the flight.

    Parameters
    ----------
    start : (n,) float
        Standardised errors in the order of the flights.
    bounded : (n,) bool
    phi : (n - 1,) float
        Correlation of each with the next; 0 between flights.

    Returns
    -------
    (n,) float
    """
    value, least = np.where(bounded, np.maximum(start, 0.0), start), start
    before, after = np.append(0.0, phi), np.append(phi, 0.0)
    precision = 1 / (1 - before**2) + after**2 / (1 - after**2)
    turns = [np.flatnonzero(bounded & (np.arange(start.size) % 2 == k)) for k in (0, 1)]
    for _ in range(SWEEPS):
        for rows in turns:  # of two neighbours one is held while the other is drawn
            earlier = value[rows - 1] * before[rows] / (1 - before[rows] ** 2)
            later = value[(rows + 1) % value.size] * after[rows] / (1 - after[rows] ** 2)
            middle, spread = (earlier + later) / precision[rows], precision[rows] ** -0.5
            beyond = ndtr(-(least[rows] - middle) / spread)
            # far out the tail underflows: its quantile would be infinite
            chance = np.maximum(rng.uniform(size=rows.size) * beyond, 1e-300)
            value[rows] = np.maximum(middle - spread * ndtri(chance), least[rows])
    return value


def _spread(means: Floats) -> Floats:
    """Draws of a mean as the archives drawn spread about it, (draws,)."""
    rng = np.random.default_rng(0)
    error = means.std(ddof=1) * np.sqrt(1 + 1 / means.size)
    return np.asarray(means.mean() + error * rng.standard_normal(DRAWS))
