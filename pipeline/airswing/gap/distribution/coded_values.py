"""Values that come in coarser steps than a simulation sends: winds, positions, headings, times.

Assumptions: the simulation sends winds in whole degrees and whole knots: coarser is an effect,
whoever has it. Positions come in tenths of a minute of arc or finer and times in seconds; coarser
is an effect of an aircraft, unless the whole fleet is alike in steps that formats use. Headings in
steps of two degrees and more are an effect, whoever has it. A value lies
on a coarse lattice by chance in one of (step / base) cases; the share above chance is the share
coded coarsely.

Validity: at least 100 reports an aircraft. Steps in knots, degrees and minutes of arc.

Reductions by simulation extrapolation: the same rounding added once and twice more shows how much
it lengthens the disagreement, and, extrapolated backwards, how much it has done already.

References
----------
Cook, J. R. and Stefanski, L. A. (1994). Simulation-extrapolation estimation in parametric
measurement error models. J. Am. Stat. Assoc. 89, 1314-1328.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import heading_lattices
from airswing.gap.distribution.verdict import (
    Mask,
    Reduction,
    Verdict,
    against_chance,
    mean_reduction,
    verdict_of,
)
from airswing.gap.effects.base import Stated, number
from airswing.physics.triangle import direction_in_degrees
from airswing.units import KNOT

Floats = NDArray[np.float64]

# Steps looked for: kt, degrees, arc minutes. Finer ones than 1 kt, 1 degree and 0.1 arc minute are
# how reports come anyway.
SPEED_STEPS = (2.0, 5.0, 10.0)
DIRECTION_STEPS = (2.0, 5.0, 10.0)
POSITION_STEPS = (0.5, 0.6, 1.0, 2.0, 3.0, 5.0, 6.0, 10.0)
FREQUENT = {"speed": 2, "direction": 12}
"""Most frequent values that a lattice must show without: a floor or a hole sends one or two speeds
too often, a few directions at weak winds are at most twelve; a coding in steps spreads over all."""
# Share of the values, above chance, from which a lattice is one.
LEAST_SHARE = 0.15


def lattice_evidence(values: Floats, step: float, *, base: float) -> float:
    """Log likelihood ratio of values on a lattice against chance."""
    on, chance = _on_lattice(values, step, base=base)
    return against_chance(values.size, on, chance)


def _on_lattice(values: Floats, step: float, *, base: float) -> tuple[float, float]:
    """Share of values on a lattice, and what chance puts there."""
    offset = np.abs(values - step * np.round(values / step))
    # under half the finest coding: what is rounded to it lies on the lattice or a whole one
    # next to it
    tolerance = min(0.25 * base, 0.05 * step)
    return float((offset <= tolerance).mean()), min(0.98, max(base, 2 * tolerance) / step)


def lattice_share(values: Floats, step: float, *, base: float) -> float:
    """Share of values on a lattice above what chance gives.

    Parameters
    ----------
    values : (n,) float
    step, base : float
        The coarse step, and the fine one in which values come anyway.

    Returns
    -------
    float
        1 where all lie on the coarse lattice, about 0 where only chance puts them there.
    """
    if values.size == 0:
        return 0.0
    on, chance = _on_lattice(values, step, base=base)
    return (on - chance) / (1 - chance)


def coarsest(values: Floats, steps: tuple[float, ...], *, base: float) -> tuple[float, float]:
    """Coarsest step with a clear share, and that share; (base, 1) where none.

    Parameters
    ----------
    values : (n,) float
    steps : tuple of float
        Increasing.
    """
    # five standard errors of a share of so many
    need = max(LEAST_SHARE, 5.0 / np.sqrt(max(values.size, 1)))
    for step in reversed(steps):
        share = lattice_share(values, step, base=base)
        finer = [lattice_share(values, s, base=base) for s in steps if s < step]
        # values on a coarse lattice lie on its finer divisors too: the coarsest that holds nearly
        # as many
        if share > need and share > 0.8 * max(finer, default=0.0):
            return step, share
    return base, 1.0


def wind_coding(frame: Frame) -> Verdict | None:
    """Find aircraft whose winds come in steps coarser than a degree or a knot."""
    speed = np.hypot(frame.u_rep, frame.v_rep) / KNOT
    direction = direction_in_degrees(frame.u_rep, frame.v_rep)
    moving = speed > 3.0
    per_tail: dict[str, Stated] = {}
    evidence: list[float] = []
    start: list[float] = []
    for a, tail in enumerate(frame.tails):
        own = np.flatnonzero((frame.aircraft == a) & moving)
        if own.size < 100:
            continue
        fast = own[_usual(speed[own], FREQUENT["speed"])]
        turned = own[_usual(direction[own], FREQUENT["direction"])]
        step, share = coarsest(speed[fast], SPEED_STEPS, base=1.0)
        turn, turn_share = coarsest(direction[turned], DIRECTION_STEPS, base=1.0)
        if step <= 1.0 and turn <= 1.0:
            continue
        per_tail[tail] = {"step": step if step > 1 else 1.0, "direction_step_deg": turn}
        value, width = (direction[own], turn) if turn > 1 else (speed[own], step)
        evidence.append(lattice_evidence(value, width, base=1.0))
        # nearly all on the lattice: coded so from the first report on, else it began later
        if min(share if step > 1 else 1.0, turn_share if turn > 1 else 1.0) < 0.9:
            start.append(_change_time(value, width, frame.time[own]))
    if not per_tail:
        return None
    period = [_date(float(np.median(start))), None] if len(start) == len(per_tail) else None
    return verdict_of("wind_coding", per_tail, period, evidence)


def _usual(values: Floats, frequent: int) -> NDArray[np.bool_]:
    """Reports (n,) but for those of the most frequent whole values."""
    whole, number, count = np.unique(np.round(values), return_inverse=True, return_counts=True)
    if whole.size <= 2 * frequent:
        return np.ones(values.size, bool)
    return ~np.isin(number, np.argsort(-count, kind="stable")[:frequent])


def position_coding(frame: Frame) -> Verdict | None:
    """Find aircraft whose positions come in steps coarser than the fleet's."""
    per_tail: dict[str, Stated] = {}
    evidence: dict[str, float] = {}
    steps = []
    for a, tail in enumerate(frame.tails):
        own = np.flatnonzero(frame.aircraft == a)
        if own.size < 100:
            continue
        found = [
            coarsest(60.0 * values[own], POSITION_STEPS, base=0.1)[0]
            for values in (frame.latitude, frame.longitude)
        ]
        steps.append(min(found))
        # tenths of an arc minute are how positions come
        if min(found) > 0.1:
            per_tail[tail] = {"step": min(found)}
            evidence[tail] = lattice_evidence(60.0 * frame.latitude[own], min(found), base=0.1)
    common = float(np.median(steps)) if steps else 0.1
    if common < 1.0:
        # what all send in is their format and no effect
        per_tail = {t: v for t, v in per_tail.items() if number(v["step"]) > 1.2 * common}
    found = [evidence[tail] for tail in per_tail]
    return verdict_of("position_coding", per_tail, None, found) if per_tail else None


def heading_coding(frame: Frame) -> Verdict | None:
    """Find aircraft whose headings come in coarse steps."""
    per_tail: dict[str, Stated] = {}
    evidence = []
    for tail, found in zip(frame.tails, heading_lattices(frame), strict=True):
        if found is not None:
            per_tail[tail] = {"step_deg": found.step, "true_north": found.true_north or None}
            evidence.append(found.evidence)
    return verdict_of("heading_coding", per_tail, None, evidence) if per_tail else None


def whole_minutes(frame: Frame) -> Verdict | None:
    """Find aircraft whose times are cut to the minute while others' are not."""
    cut, evidence = [], []
    for a, tail in enumerate(frame.tails):
        seconds = np.mod(frame.time[frame.aircraft == a], 60.0)
        if seconds.size < 100:
            continue
        # half a second: times come in whole ones
        whole = float((np.minimum(seconds, 60 - seconds) < 0.5).mean())
        # nearly all: a time that is whole by chance is one in sixty
        if whole > 0.95:
            cut.append(tail)
            evidence.append(against_chance(seconds.size, whole, 1 / 60))
    counted = np.bincount(frame.aircraft, minlength=len(frame.tails)) >= 100
    if not cut or len(cut) == int(counted.sum()):
        return None
    # seconds cut off are thirty in the mean
    return verdict_of("time_lag", {t: {"offset_s": -30.0} for t in cut}, None, evidence)


def _change_time(values: Floats, step: float, time: Floats) -> float:
    """Time at which values begin to lie on a lattice: largest cumulative excess, s."""
    order = np.argsort(time)
    on = (np.abs(values - step * np.round(values / step)) < 0.05 * step)[order].astype(float)
    # before the change fewer lie on it than in the mean, after it more: the sum is least between
    excess = np.cumsum(on - on.mean())
    return float(time[order][int(np.argmin(excess))])


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


#: Share of the mean square that is always left.
LEAST_LEFT = 0.05


def coded_effects(frame: Frame) -> list[Verdict]:
    """All effects of coding in an archive."""
    found = (
        wind_coding(frame),
        position_coding(frame),
        heading_coding(frame),
        whole_minutes(frame),
    )
    return [one for one in found if one is not None]


def reduction_of_coding(frame: Frame, residual: Floats, verdict: Verdict, gross: Mask) -> Reduction:
    """How far the disagreement shrinks without coarse coding.

    Parameters
    ----------
    residual : (n, 2) float
        With the effects that move means taken off, m/s.
    gross : (n,) bool
        Reports taken for gross errors.
    """
    affected = np.isin(np.array(frame.tails)[frame.aircraft], verdict.tails) & ~gross
    if verdict.name == "wind_coding":
        return _without_wind_coding(frame, residual, verdict, affected, np.random.default_rng(0))
    if verdict.name == "heading_coding":
        return _without_heading_coding(frame, residual, verdict, gross)
    return Reduction(0.0, 0.0)


def _without_wind_coding(
    frame: Frame, residual: Floats, verdict: Verdict, affected: Mask, rng: np.random.Generator
) -> Reduction:
    """Coarse coding: rounding once more, continued backwards."""
    speed_step, turn_step = np.zeros((2, len(frame.tails)))
    for tail, values in verdict.per_tail.items():
        a = frame.tails.index(tail)
        # what finer coding leaves is no part of it
        speed_step[a] = KNOT * np.sqrt(max(number(values["step"]) ** 2 - 1.0, 0.0))
        turn = number(values.get("direction_step_deg", 1.0))
        turn_step[a] = np.radians(np.sqrt(max(turn**2 - 1.0, 0.0)))
    owner = frame.aircraft[affected]
    wind = np.stack([frame.u_rep, frame.v_rep], -1)[affected]
    speed = np.hypot(*wind.T)
    # a calm has no direction to scatter along
    along = wind / np.maximum(speed, 1e-6)[:, None]
    across = np.stack([along[:, 1], -along[:, 0]], -1)

    def error() -> Floats:
        first, second = rng.uniform(-0.5, 0.5, (2, owner.size))
        return np.asarray(
            (first * speed_step[owner])[:, None] * along
            + (second * turn_step[owner] * speed)[:, None] * across
        )

    return mean_reduction(_backwards(residual[affected], error), affected)


def _without_heading_coding(
    frame: Frame, residual: Floats, verdict: Verdict, gross: Mask
) -> Reduction:
    """Coarse headings: across the heading V^2 step^2 / 12 of the mean square would be missing."""
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    across = (residual * right).sum(axis=1)
    longer, touched = np.zeros(frame.size), np.zeros(frame.size, bool)
    for tail, values in verdict.per_tail.items():
        own = (frame.aircraft == frame.tails.index(tail)) & ~gross
        rounding = float((frame.airspeed[own] ** 2).mean()) * (
            np.radians(number(values["step_deg"])) ** 2 / 12
        )
        left = max(1 - rounding / float((across[own] ** 2).mean()), LEAST_LEFT)
        without = residual[own] - (across[own] * (1 - np.sqrt(left)))[:, None] * right[own]
        longer[own] = np.hypot(*residual[own].T) - np.hypot(*without.T)
        touched |= own
    return mean_reduction(longer[touched], touched)


def _backwards(residual: Floats, error: Callable[[], Floats]) -> Floats:
    """By how much an error lengthened residuals that hold it already, (n,), m s-1.

    The error added once and twice more lengthens them by d1 and d2; before, it did by 2 d1 - d2.
    """
    once = residual + error()
    twice = once + error()
    length = [np.hypot(*values.T) for values in (residual, once, twice)]
    return np.asarray(2.0 * (length[1] - length[0]) - (length[2] - length[1]))
