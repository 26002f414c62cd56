"""How far the disagreement shrinks where an effect shows in scatter alone: coding, gross errors.

Assumptions: no simulation takes such an effect off report by report, but it tells what the mean
disagreement would be without. Gross errors of a share of the reports, normal with a standard
deviation known in each component, lengthen the disagreement of those reports; without them it would
be as that of the others. Coarse coding adds a uniform error of its step along and across the wind:
the same error added again and again to the reports as they stand tells how much it lengthens their
disagreement, and, continued backwards, how much it has done already. Scatter of no known kind is an
error of its size, independent of all else.

Validity: errors of one report independent of every other's; coding of no more than the disagreement
itself. Results in knots; intervals hold the doubt about share and size and that of the draws.

Source: simulation extrapolation, Cook & Stefanski (1994), J. Amer. Statist. Assoc. 89, 1314.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.direction_lattice import Lattice
from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import number
from airswing.gap.held_out.reduction import Closure
from airswing.gap.scatter.excess_scatter import Scattering
from airswing.gap.scatter.moment_verdict import MomentVerdict
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Relative standard error of a reduction beside that of its share: size, shape, continuation.
SHAPE_DOUBT = 0.08
#: Share of the mean square that is always left.
LEAST_LEFT = 0.05
#: Classes of speed in which directions sent in steps are looked at.
STRENGTHS = 10


@dataclass(frozen=True)
class Reduction:
    """How far the mean disagreement shrinks without an effect, kt."""

    # kt, error: best value and standard error
    kt: float
    error: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval; never less than nothing."""
        low, high = self.kt - NORMAL_95 * self.error, self.kt + NORMAL_95 * self.error
        return max(low, 0.0), max(high, 0.0)


def reduction_of(frame: Frame, residual: Floats, verdict: MomentVerdict, gross: Mask) -> Reduction:
    """How far the disagreement shrinks without one effect of coding or of gross errors.

    Parameters
    ----------
    residual : (n, 2) float
        With the effects that move means taken off, m s-1.
    gross : (n,) bool
        Reports taken for gross errors.

    Returns
    -------
    Reduction
        Nothing for effects that hardly move the wind (coding of positions, of times).
    """
    rng = np.random.default_rng(0)
    struck = np.isin(np.array(frame.tails)[frame.aircraft], verdict.tails)
    if verdict.name == "outliers":
        return _of_gross(frame, residual, verdict, struck & ~gross, rng)
    if verdict.name == "wind_coding":
        return _of_coding(frame, residual, verdict, struck & ~gross, rng)
    if verdict.name == "heading_coding":
        return _of_headings(frame, residual, verdict, gross)
    return Reduction(0.0, 0.0)


def reduction_of_jitter(residual: Floats, found: Scattering, gross: Mask) -> Reduction:
    """How far the disagreement shrinks without scatter of no known kind.

    Independent errors add in squares: without one the reports of a cell disagree as they do, less
    by the root of the share of the mean square that is left.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    gross : (n,) bool
        Gross errors that have a name.
    """
    struck = (found.sizes > 0) & ~gross
    longer = np.zeros(residual.shape[0])
    for size in np.unique(found.sizes[struck]):
        own = struck & (found.sizes == size)
        share = 2 * size**2 / float((residual[own] ** 2).sum(axis=1).mean())
        longer[own] = np.hypot(*residual[own].T) * (1 - np.sqrt(max(1 - share, LEAST_LEFT)))
    return _scaled(longer[struck], struck)


def reduction_of_steps(
    frame: Frame, residual: Floats, steps: Lattice, aircraft: Sequence[int]
) -> Reduction:
    """How far the disagreement shrinks without steps of the directions sent.

    A wind of speed s sent in the nearest of directions w apart is off by 2 s^2 (1 - sin a / a) in
    the mean square, a = w / 2, whatever the reference errs by: s^2 w^2 / 12 where w is small. No
    report can be turned back, but by so much less would they disagree.
    """
    speed, half = np.hypot(frame.u_rep, frame.v_rep), np.radians(steps.step) / 2
    struck = np.isin(frame.aircraft, aircraft) & (speed > 0) & (speed <= steps.below)
    square = 2 * steps.share * speed**2 * (1 - np.sin(half) / half)
    bounds = np.quantile(speed[struck], np.arange(1, STRENGTHS) / STRENGTHS)
    strength, longer = np.searchsorted(bounds, speed), np.zeros(speed.size)
    for k in range(STRENGTHS):
        own = struck & (strength == k)
        if own.any():
            share = float(square[own].sum() / (residual[own] ** 2).sum())
            longer[own] = np.hypot(*residual[own].T) * (1 - np.sqrt(max(1 - share, LEAST_LEFT)))
    return _scaled(longer[struck], struck)


def _of_gross(
    frame: Frame, residual: Floats, verdict: MomentVerdict, calm: Mask, rng: np.random.Generator
) -> Reduction:
    """Gross errors: as much longer as a normal error of their size makes the calm reports."""
    total, doubt = 0.0, 0.0
    for tail, values in verdict.per_tail.items():
        own = residual[calm & (frame.aircraft == frame.tails.index(tail))]
        if own.size == 0:
            continue
        error = number(values["size_m_s"]) * rng.standard_normal(own.shape)
        longer = float((np.hypot(*(own + error).T) - np.hypot(*own.T)).mean())
        count = float((frame.aircraft == frame.tails.index(tail)).sum())
        total += count * number(values["fraction"]) * longer
        doubt += (count * longer) ** 2 * number(values["fraction"]) / count
    kt = total / frame.size / KNOT
    return Reduction(kt, float(np.hypot(np.sqrt(doubt) / frame.size / KNOT, SHAPE_DOUBT * kt)))


def _of_coding(
    frame: Frame, residual: Floats, verdict: MomentVerdict, struck: Mask, rng: np.random.Generator
) -> Reduction:
    """Coarse coding: rounding once more, continued backwards."""
    speed_step, turn_step = np.zeros((2, len(frame.tails)))
    for tail, values in verdict.per_tail.items():
        a = frame.tails.index(tail)
        # what finer coding leaves is no part of it
        speed_step[a] = KNOT * np.sqrt(max(number(values["step"]) ** 2 - 1.0, 0.0))
        turn = number(values.get("direction_step_deg", 1.0))
        turn_step[a] = np.radians(np.sqrt(max(turn**2 - 1.0, 0.0)))
    owner = frame.aircraft[struck]
    wind = np.stack([frame.u_rep, frame.v_rep], -1)[struck]
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

    return _scaled(_backwards(residual[struck], error), struck)


def _of_headings(frame: Frame, residual: Floats, verdict: MomentVerdict, gross: Mask) -> Reduction:
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
    return _scaled(longer[touched], touched)


def _backwards(residual: Floats, error: Callable[[], Floats]) -> Floats:
    """By how much an error lengthened residuals that hold it already, (n,), m s-1.

    The error added once and twice more lengthens them by d1 and d2; before, it did by 2 d1 - d2.
    """
    once = residual + error()
    twice = once + error()
    length = [np.hypot(*values.T) for values in (residual, once, twice)]
    return np.asarray(2.0 * (length[1] - length[0]) - (length[2] - length[1]))


def _scaled(longer: Floats, struck: Mask) -> Reduction:
    """Mean over all reports of what some are longer by."""
    if longer.size == 0:
        return Reduction(0.0, 0.0)
    kt = float(longer.sum()) / struck.size / KNOT
    drawn = float(longer.std()) * np.sqrt(longer.size) / struck.size / KNOT
    return Reduction(max(kt, 0.0), float(np.hypot(drawn, 2 * SHAPE_DOUBT * kt)))


def with_scatter(closure: Closure, parts: Mapping[str, Reduction]) -> Closure:
    """Closure with what effects of scatter close beside the others.

    Parameters
    ----------
    closure : Closure
        Of effects that move means.
    parts : mapping
        Name -> reduction, independent of each other.
    """
    for name, part in parts.items():
        low, high = part.interval
        after = closure.after - part.kt
        step = (name, after, low, high)
        out = replace(
            closure,
            after=after,
            sequence=(*closure.sequence, step),
            alone=(*closure.alone, closure.before - part.kt),
        )
        if closure.reduction_ci is not None:
            stated = closure.before - closure.after
            below, above = stated - closure.reduction_ci[0], closure.reduction_ci[1] - stated
            whole, wide = stated + part.kt, NORMAL_95 * part.error
            low = float(whole - np.hypot(below, wide))
            out = out.with_interval(low, float(whole + np.hypot(above, wide)))
        closure = out
    return closure
