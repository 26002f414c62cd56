"""Aircraft whose single reports scatter more than the fleet's, for no reason in the catalogue.

Assumptions: a report less the mean of its two neighbours holds little but what is its own: noise,
coding, an instrument that jitters. What the noise model expects of that difference, by distance and
level, is divided out; aircraft then differ as much as their routes and instruments ordinarily do,
and the fleet itself tells how much that is. Scatter that coarse coding or gross errors explain is
theirs.

Validity: level flight, neighbours within :data:`REACH`; five aircraft and more with 200 such
reports. Effects that move means are taken off before. A fleet that scatters as one is not seen.

Source: docs/gap.md section 6; robust scale: Rousseeuw & Croux (1993), J. Amer. Statist.
Assoc. 88, 1273.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.noise.model import NoiseFit, NoiseModel
from airswing.gap.noise.residual_statistics import previous_and_next
from airswing.gap.noise.whitening import flight_steps

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Seconds from the report before to the one after.
REACH = 1900.0
#: Change of ln p between them in level flight.
LEVEL = 0.02
#: Reports an aircraft must have, and aircraft a fleet.
LEAST_REPORTS, LEAST_AIRCRAFT = 200, 5
#: Smallest excess of scatter that is stated, and the least by which aircraft are taken to differ.
LEAST_EXCESS, LEAST_SPREAD = 0.15, 0.03
#: Evidence needed, nats, less what looking at a hundred aircraft for the clearest costs.
NEEDED = 3.0 + float(np.log(100.0))


@dataclass(frozen=True)
class Scattering:
    """Aircraft that scatter more than the others.

    Attributes
    ----------
    tails : tuple of str
    excess : tuple of float
        Standard deviation per component of what they scatter beyond the others, m s-1.
    evidence : float
        Of the clearest, nats.
    """

    tails: tuple[str, ...]
    excess: tuple[float, ...]
    evidence: float


def scattering(
    frame: Frame, residual: Floats, noise: NoiseFit, *, explained: Collection[str] = ()
) -> Scattering | None:
    """Find aircraft whose single reports scatter more than the fleet's.

    Parameters
    ----------
    frame : Frame
    residual : (n, 2) float
        With the effects found taken off, m s-1.
    noise : NoiseFit
    explained : collection of str
        Aircraft whose scatter has a name already.

    Returns
    -------
    Scattering or None
    """
    own, jump, expected = single_departures(frame, residual, noise)
    aircraft = np.asarray(frame.aircraft)[own]
    size = np.abs(jump / expected[:, None])
    count = np.bincount(aircraft, minlength=len(frame.tails))
    used = np.flatnonzero(count >= LEAST_REPORTS)
    if used.size < LEAST_AIRCRAFT:
        return None
    # medians of absolute values as standard deviations: 0.6745 is that of a normal variable of unit
    # size
    scale = np.array([np.median(size[aircraft == a]) for a in used]) / 0.6745
    if scale.min() <= 0:
        return None
    middle = float(np.median(scale))
    ratio = np.log(scale / middle)
    spread = max(1.4826 * float(np.median(np.abs(ratio))), LEAST_SPREAD)
    evidence = 0.5 * (ratio / spread) ** 2
    named = np.isin(np.array(frame.tails)[used], list(explained))
    high = np.flatnonzero((ratio > LEAST_EXCESS) & (evidence > NEEDED) & ~named)
    if high.size == 0:
        return None
    white = noise.model.white_sd
    excess = white * np.sqrt(scale[high] ** 2 - middle**2)
    tails = tuple(frame.tails[a] for a in used[high])
    top = float(evidence[high].max() - np.log(100.0))
    return Scattering(tails, tuple(float(x) for x in excess), top)


def single_departures(
    frame: Frame, residual: Floats, noise: NoiseFit
) -> tuple[Integers, Floats, Floats]:
    """Departures of reports from the mean of their two neighbours, and what noise makes of them.

    Parameters
    ----------
    frame : Frame
    residual : (n, 2) float
    noise : NoiseFit

    Returns
    -------
    own : (m,) int
        Reports in level flight with both neighbours near.
    departure : (m, 2) float
        m s-1.
    expected : (m,) float
        Standard deviation per component by the noise model, m s-1.
    """
    log_pressure = np.log(frame.pressure)
    before, after = previous_and_next(noise.order, frame.size)
    own = np.flatnonzero((before >= 0) & (after >= 0))
    first, second = before[own], after[own]
    near = frame.time[second] - frame.time[first] <= REACH
    near &= np.abs(log_pressure[second] - log_pressure[first]) < LEVEL
    near &= ~(noise.gross[own] | noise.gross[first] | noise.gross[second])
    own, first, second = own[near], first[near], second[near]
    distance, step = flight_steps(frame.latitude, frame.longitude, log_pressure, noise.order)
    expected = expected_departure(
        noise.model,
        noise.model.decay(distance[own], step[own]),
        noise.model.decay(distance[second], step[second]),
    ) * noise.model.factor(log_pressure[own])
    return own, residual[own] - (residual[first] + residual[second]) / 2, expected


def expected_departure(model: NoiseModel, before: Floats, after: Floats) -> Floats:
    """Standard deviation of a report less the mean of its neighbours, m s-1, at level factor 1.

    Parameters
    ----------
    model : NoiseModel
    before, after : (m,) float
        Correlation of the correlated part with the report before and with the one after.

    Returns
    -------
    (m,) float
    """
    # variance of x - (before + after) / 2 where neighbours of the report are tied through it alone
    correlated = 1.5 - before - after + 0.5 * before * after
    return np.sqrt(model.correlated_sd**2 * correlated + 1.5 * model.white_sd**2)
