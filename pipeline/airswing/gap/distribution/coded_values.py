"""Values that come in coarser steps than a simulation sends: winds, positions, headings, times.

Steps of winds coarser than whole degrees and knots are an effect, also of a whole fleet; so are
headings in steps of two degrees and more. Steps of positions and times are an effect of an
aircraft, unless they are a format that the whole fleet uses. A value lies on a coarse lattice by
chance in one of (step / base) cases. Steps in knots, degrees and minutes of arc.

Reductions by simulation extrapolation (Cook and Stefanski 1994, J. Am. Stat. Assoc. 89, 1314-1328).
"""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import heading_lattices
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.design import unit_vectors
from airswing.gap.distribution.entries import (
    LEAST_LEFT,
    against_chance,
    closes,
    effect_of,
    mean_reduction,
)
from airswing.gap.effects.base import Stated, number
from airswing.gap.result.schema import ClosesEntry, EffectEntry
from airswing.physics.triangle import direction_in_degrees
from airswing.units import KNOT


def _by_aircraft(frame: Frame, mask: Booleans | bool = True) -> list[tuple[str, Integers]]:
    rows = [np.flatnonzero((frame.aircraft == a) & mask) for a in range(len(frame.tails))]
    return [(tail, index) for tail, index in zip(frame.tails, rows, strict=True) if index.size > 99]


def _on_lattice(values: Floats, step: float, *, base: float) -> tuple[float, float]:
    """Share of values on a lattice, and its expectation by chance."""
    offset = np.abs(values - step * np.round(values / step))
    # under half the finest coding: values rounded to it lie on the lattice or one step from it
    tolerance = min(0.25 * base, 0.05 * step)
    return float((offset <= tolerance).mean()), min(0.98, max(base, 2 * tolerance) / step)


def coarsest(values: Floats, steps: tuple[float, ...], *, base: float) -> tuple[float, float]:
    """Coarsest of increasing steps with a clear share of the values, and that share.

    The share is that above chance: 1 where all lie on the lattice. ``base`` is the fine step in
    which values come anyway; (base, 1) where there is no step.
    """
    shares = {}
    for step in steps:
        on, chance = _on_lattice(values, step, base=base) if values.size else (0.0, 0.0)
        shares[step] = (on - chance) / (1 - chance)
    # 15 % above chance, and five standard errors of a share of so many
    need = max(0.15, 5.0 / np.sqrt(max(values.size, 1)))
    for step in reversed(steps):
        finer = [shares[s] for s in steps if s < step]
        # values on a coarse lattice lie on its finer divisors too: the coarsest that holds nearly
        # as many
        if shares[step] > need and shares[step] > 0.8 * max(finer, default=0.0):
            return step, shares[step]
    return base, 1.0


def wind_coding(frame: Frame) -> EffectEntry | None:
    """Find aircraft whose winds come in steps coarser than a degree or a knot."""
    speed = np.hypot(frame.u_rep, frame.v_rep) / KNOT
    direction = direction_in_degrees(frame.u_rep, frame.v_rep)
    found: dict[str, tuple[Stated, float]] = {}
    start: list[float] = []
    for tail, index in _by_aircraft(frame, speed > 3.0):
        # a coding in steps spreads over all values; a floor or a hole sends one or two speeds too
        # often, and there are at most twelve of a few directions at weak winds
        fast, turned = index[_infrequent(speed[index], 2)], index[_infrequent(direction[index], 12)]
        steps = (2.0, 5.0, 10.0)  # kt and degrees; reports come in whole ones anyway
        step, share = coarsest(speed[fast], steps, base=1.0)
        turn, turn_share = coarsest(direction[turned], steps, base=1.0)
        if step <= 1.0 and turn <= 1.0:
            continue
        value, width = (direction[index], turn) if turn > 1 else (speed[index], step)
        evidence = against_chance(value.size, *_on_lattice(value, width, base=1.0))
        found[tail] = {"step": step, "direction_step_deg": turn}, evidence
        # nearly all on the lattice: coded so from the first report on, else it began later
        if min(share, turn_share) < 0.9:
            start.append(_change_time(value, width, frame.time[index]))
    period = None
    if start and len(start) == len(found):
        begin = datetime.fromtimestamp(float(np.median(start)), UTC)
        period = [begin.strftime("%Y-%m-%d"), None]
    return effect_of("wind_coding", found, period)


def _infrequent(values: Floats, frequent: int) -> Booleans:
    """Reports (n,) but for those of the most frequent whole values."""
    rounded, number, count = np.unique(np.round(values), return_inverse=True, return_counts=True)
    if rounded.size <= 2 * frequent:
        return np.ones(values.size, bool)
    return ~np.isin(number, np.argsort(-count, kind="stable")[:frequent])


def position_coding(frame: Frame) -> EffectEntry | None:
    """Find aircraft whose positions come in steps coarser than the fleet's."""
    found: dict[str, tuple[Stated, float]] = {}
    steps: dict[str, float] = {}
    for tail, index in _by_aircraft(frame):
        steps[tail] = step = min(
            coarsest(60.0 * values[index], (0.5, 0.6, 1.0, 2.0, 3.0, 5.0, 6.0, 10.0), base=0.1)[0]
            for values in (frame.latitude, frame.longitude)
        )
        on_lattice = _on_lattice(60.0 * frame.latitude[index], step, base=0.1)
        found[tail] = {"step": step}, against_chance(index.size, *on_lattice)
    # tenths of an arc minute are how positions come; a step of the whole fleet is its format
    common = float(np.median(list(steps.values()))) if steps else 0.1
    least = 1.2 * common if common < 1.0 else 0.1
    return effect_of("position_coding", {t: found[t] for t in steps if steps[t] > least})


def heading_coding(frame: Frame) -> EffectEntry | None:
    """Find aircraft whose headings come in coarse steps."""
    found: dict[str, tuple[Stated, float]] = {}
    for tail, lattice in zip(frame.tails, heading_lattices(frame), strict=True):
        if lattice is not None:
            steps: Stated = {"step_deg": lattice.step, "true_north": lattice.true_north or None}
            found[tail] = steps, lattice.evidence
    return effect_of("heading_coding", found)


def whole_minutes(frame: Frame) -> EffectEntry | None:
    """Find aircraft whose times are cut to the minute while others' are not."""
    cut: dict[str, tuple[Stated, float]] = {}
    aircraft = _by_aircraft(frame)
    for tail, index in aircraft:
        seconds = np.mod(frame.time[index], 60.0)
        # half a second: times come in whole ones
        share = float((np.minimum(seconds, 60 - seconds) < 0.5).mean())
        # nearly all: a time that is whole by chance is one in sixty
        if share > 0.95:
            # seconds cut off are thirty in the mean
            cut[tail] = {"offset_s": -30.0}, against_chance(seconds.size, share, 1 / 60)
    return effect_of("time_lag", cut) if len(cut) < len(aircraft) else None


def _change_time(values: Floats, step: float, time: Floats) -> float:
    """Time at which values begin to lie on a lattice: largest cumulative excess, s."""
    order = np.argsort(time)
    on = (np.abs(values - step * np.round(values / step)) < 0.05 * step)[order].astype(float)
    # before the change fewer lie on it than in the mean, after it more: the sum is least between
    excess = np.cumsum(on - on.mean())
    return float(time[order][int(np.argmin(excess))])


def coded_effects(frame: Frame) -> list[EffectEntry]:
    """All effects of coding in an archive."""
    tests = (wind_coding, position_coding, heading_coding, whole_minutes)
    return [entry for test in tests if (entry := test(frame)) is not None]


def reduction_of_coding(
    frame: Frame, residual: Floats, entry: EffectEntry, gross: Booleans
) -> ClosesEntry:
    """How far the disagreement shrinks without coarse coding.

    ``residual`` (n, 2) is without the effects that move means, ``gross`` marks gross errors.
    """
    per_tail = {tail: row.parameters for tail, row in (entry.per_tail or {}).items()}
    affected = frame.aircraft_mask(entry.tails) & ~gross
    if entry.period and entry.period[0]:
        affected &= frame.time >= np.datetime64(entry.period[0], "s").astype(float)
    if entry.name == "wind_coding":
        steps = np.zeros((2, len(frame.tails)))
        for tail, values in per_tail.items():
            widths = number(values["step"]), number(values.get("direction_step_deg", 1.0))
            # the error of the usual coding is no part of it
            steps[:, frame.tails.index(tail)] = [np.sqrt(max(x**2 - 1.0, 0.0)) for x in widths]
        owner = frame.aircraft[affected]
        wind = np.stack([frame.u_rep, frame.v_rep], -1)[affected]
        speed = np.hypot(*wind.T)
        # a calm has no direction to scatter along
        along = wind / np.maximum(speed, 1e-6)[:, None]
        across = np.stack([along[:, 1], -along[:, 0]], -1)
        size = np.stack([KNOT * steps[0, owner], np.radians(steps[1, owner]) * speed])
        # the rounding added once and twice more lengthens the residual by d1 and d2; before, it
        # did by 2 d1 - d2
        rng, rows = np.random.default_rng(0), residual[affected]
        length = [np.hypot(*rows.T)]
        for _ in range(2):
            errors = rng.uniform(-0.5, 0.5, size.shape) * size
            rows = rows + (errors[0][:, None] * along + errors[1][:, None] * across)
            length.append(np.hypot(*rows.T))
        return mean_reduction(3.0 * length[1] - 2.0 * length[0] - length[2], affected)
    if entry.name != "heading_coding":
        return closes(0.0, 0.0)
    # across the heading V^2 step^2 / 12 of the mean square would be missing
    right, _ = unit_vectors(frame.heading)
    error = (residual * right).sum(axis=1)
    longer = np.zeros(frame.size)
    for tail, values in per_tail.items():
        used = affected & frame.aircraft_mask(tail)
        step = np.radians(number(values["step_deg"]))
        rounding = float((frame.airspeed[used] ** 2).mean()) * (step**2 / 12)
        share = max(1 - rounding / float((error[used] ** 2).mean()), LEAST_LEFT)
        without = residual[used] - (error[used] * (1 - np.sqrt(share)))[:, None] * right[used]
        longer[used] = np.hypot(*residual[used].T) - np.hypot(*without.T)
    return mean_reduction(longer[affected], affected)
