"""Forward simulation: the reports a unit would have sent along the paths of an archive.

Assumptions: positions, times and ground velocity are the archive's. The wind met is the reference
wind, with the effects on it and the noise added; the true air vector is the ground velocity less
that wind. Indicated heading and airspeed follow by the sensor effects, evaluated at the INDICATED
magnetic heading (a fixed point, found by iteration); the wind sent is
``V_G - V_ind h(psi_ind)``, then whatever the unit does to it, then its coding. With neither effects
nor noise the wind sent is the reference wind as the unit codes it: the perfect instrument.

Validity: effects of reference and path (time, height) are exact to first order in the derivatives
the frame carries. Deviations must change by less than a degree per degree of heading.

Effects are given as `ActiveEffect`; who and when is decided here, how by the effect itself.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import HeadingSteps
from airswing.gap.effects import CATALOGUE, ActiveEffect, Effect, State, effect_named
from airswing.gap.effects.base import Parameters, Stage, absent_context
from airswing.gap.noise.whitening import DirectionFactors
from airswing.physics.triangle import (
    bearing,
    wind_components,
    wind_from_direction,
    wind_from_triangle,
    wrap_positive,
)

FloatArray = NDArray[np.float64]
# The error changes by much less than the heading does: it settles in some ten rounds.
MOST_ITERATIONS = 100
TOLERANCE = 1e-12
"""rad: the indicated heading has settled."""


class NoiseLike(Protocol):
    """What the noise along flights must offer; `airswing.gap.noise.model.NoiseModel` does."""

    @property
    def correlated_sd(self) -> float:
        """Standard deviation of the correlated part, m s-1 per component."""

    @property
    def white_sd(self) -> float:
        """Standard deviation of the independent part, m s-1 per component."""

    def factor(self, log_pressure: FloatArray) -> FloatArray:
        """Return what multiplies both at a level."""

    def decay(self, distance: FloatArray, step: FloatArray) -> FloatArray:
        """Return the correlation over a distance (m) and a step of ln p."""

    def direction_factors(self, heading: FloatArray) -> DirectionFactors | None:
        """Return the scaling of errors along and across headings (rad)."""


@dataclass(frozen=True)
class Coding:
    """Steps in which a unit takes its heading and codes its wind; 0 for as it is."""

    speed: FloatArray | float  # (n,) or float; m s-1
    direction: FloatArray | float  # (n,) or float; degree
    headings: HeadingSteps | None = None

    @classmethod
    def of_archive(cls, frame: Frame) -> Coding:
        """Return the coding found in the archive, aircraft by aircraft.

        Returns
        -------
        Coding
            0 where the archive shows no step.
        """
        speed = np.nan_to_num(frame.wind_speed_resolution)[frame.aircraft]
        return cls(speed, np.nan_to_num(frame.wind_direction_resolution)[frame.aircraft])

    @classmethod
    def as_found(cls, frame: Frame) -> Coding:
        """Return the same with the steps that headings are found to come in, an effect by name."""
        return replace(cls.of_archive(frame), headings=HeadingSteps.of_archive(frame))

    def apply(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Wind, m s-1, as it is sent of what was met or measured."""
        if self.headings is not None:
            u, v = self.headings.apply(u, v)
        speed, direction = wind_from_direction(u, v)
        turned = _rounded(np.degrees(np.where(speed > 0.0, direction, 0.0)), self.direction)
        return wind_components(_rounded(speed, self.speed), np.radians(turned))


@dataclass(frozen=True)
class Work:
    """One effect with its complete parameters, whom it strikes, and its own random numbers."""

    effect: Effect
    active: ActiveEffect
    values: Parameters
    seed: np.random.SeedSequence

    def counted_from(self, frame: Frame) -> Frame:
        """Return the reports with their time counted from where an effect's period begins."""
        start = self.active.period[0] if self.active.period else None
        if start is None or start <= frame.epoch:
            return frame
        return replace(frame, epoch=start)

    def rng(self) -> np.random.Generator:
        """Return its random numbers, the same each time."""
        return np.random.default_rng(self.seed)


def simulate(
    frame: Frame,
    *,
    effects: Sequence[ActiveEffect] = (),
    noise: NoiseLike | None = None,
    coding: Coding | None = None,
    seed: int = 0,
) -> Frame:
    """Simulate the reports of a frame.

    Parameters
    ----------
    frame : Frame
        Paths, context and reference wind; its reported wind is not used.
    effects : sequence of ActiveEffect
        What is wrong, on whom and when.
    noise : NoiseLike, optional
        Error of the reference along flights; none where not given.
    coding : Coding, optional
        Steps of the coded wind; `Coding.of_archive` for the archive's own, none where not given.
    seed : int
        Of noise and random effects. Noise does not depend on the effects, so two simulations
        differ by the effects alone.

    Returns
    -------
    Frame
        The same reports with the simulated reported wind, the heading and airspeed it implies,
        and the position as sent.

    Raises
    ------
    InputError
        An effect or aircraft is unknown, or the context an effect acts on is absent.
    """
    noise_seed, *seeds = np.random.SeedSequence(seed).spawn(1 + len(effects))
    work = [prepared(active, frame, s) for active, s in zip(effects, seeds, strict=True)]
    wind = np.stack([frame.u_ref, frame.v_ref], axis=-1)
    if noise is not None:
        wind = wind + draw_noise(frame, noise, rng=np.random.default_rng(noise_seed))
    empty = np.zeros(frame.size)
    state = State(
        airframe=frame.aircraft.copy(),
        wind_u=wind[:, 0],
        wind_v=wind[:, 1],
        heading_error=empty,
        airspeed=empty,
        report_u=wind[:, 0],
        report_v=wind[:, 1],
        latitude=frame.latitude,
        longitude=frame.longitude,
    )
    for stage in ("identity", "atmosphere"):
        state = apply_stage(state, frame, work, stage)
    state = _measured(state, frame, work)
    state = apply_stage(state, frame, work, "report")
    return _sent(state, frame, coding)


def draw_noise(frame: Frame, noise: NoiseLike, *, rng: np.random.Generator) -> FloatArray:
    """Draw the error of the reference wind at the reports.

    Parameters
    ----------
    frame : Frame
        Reports, any order.
    noise : NoiseLike
        Correlated part along each flight, and white part.
    rng : numpy.random.Generator
        Random numbers.

    Returns
    -------
    ndarray (n, 2)
        m s-1, stationary along each flight by the exact one-step recursion.
    """
    order = np.lexsort((frame.time, frame.flight))
    path = frame.take(order)
    log_pressure = np.log(path.pressure)
    distance = path.step_distance()
    first = np.isnan(distance)
    step = np.abs(np.diff(log_pressure, prepend=log_pressure[:1]))
    decay = np.where(first, 0.0, noise.decay(np.where(first, 0.0, distance), step))
    correlated = rng.standard_normal((frame.size, 2))
    # what is new at a report, so that the variance stays the same along the flight; all of it at
    # the first
    correlated *= np.sqrt(1.0 - decay**2)[:, None]
    place = np.arange(frame.size) - np.maximum.accumulate(np.where(first, np.arange(frame.size), 0))
    # all second reports at once, then all third ones: as many steps as the longest flight has
    # reports
    by_place = np.argsort(place, kind="stable")
    bounds = np.cumsum(np.bincount(place))
    for k in range(1, bounds.size):
        rows = by_place[bounds[k - 1] : bounds[k]]
        correlated[rows] += decay[rows, None] * correlated[rows - 1]
    white = rng.standard_normal((frame.size, 2))
    both = noise.correlated_sd * correlated + noise.white_sd * white
    out = np.empty((frame.size, 2))
    direction = noise.direction_factors(path.heading)
    if direction is not None:
        both = np.asarray(direction.scale_reports(both), np.float64)
    out[order] = noise.factor(log_pressure)[:, None] * both
    return out


def prepared(active: ActiveEffect, frame: Frame, seed: np.random.SeedSequence) -> Work:
    """Return an effect made ready to act on a frame.

    Parameters
    ----------
    active : ActiveEffect
        Which, on whom, when, how much.
    seed : numpy.random.SeedSequence
        Of what it draws.

    Raises
    ------
    InputError
        The effect or an aircraft is unknown, a parameter missing, or the context absent.
    """
    effect = effect_named(active.name)
    if effect is None:
        # cutoff 0: the nearest is named, however far it is
        near = difflib.get_close_matches(active.name, list(CATALOGUE), n=1, cutoff=0.0)
        raise InputError(
            "unknown effect", found=active.name, remedy=f"Did you mean {', '.join(near)}?"
        )
    if active.tails is not None:
        # for its message alone: further on an aircraft that is not there is an error without one
        frame.aircraft_mask(active.tails)
    for name in effect.needs:
        reason = absent_context(frame, name)
        if reason is not None:
            raise InputError(f"{active.name} cannot be simulated: {reason}", field=active.name)
    return Work(effect, active, effect.complete(active.parameters), seed)


def affected_reports(work: Work, state: State, frame: Frame) -> NDArray[np.bool_]:
    """Reports the effect strikes, (n,): the physical airframes named, within the period."""
    affected = np.ones(frame.size, dtype=np.bool_)
    if work.active.tails is not None:
        affected &= np.isin(state.airframe, [frame.tails.index(t) for t in work.active.tails])
    start, end = work.active.period or (None, None)
    if start is not None:
        affected &= frame.time >= start
    if end is not None:
        affected &= frame.time < end
    return affected


def apply_stage(state: State, frame: Frame, work: Sequence[Work], stage: Stage | str) -> State:
    """Pass a state through all effects of one stage, in the order given.

    Parameters
    ----------
    work : sequence of Work
        From `prepared`; those of other stages are passed over.
    stage : str
        Of `airswing.gap.effects.base.Stage`.
    """
    for item in work:
        if item.effect.stage != stage:
            continue
        affected = affected_reports(item, state, frame)
        after = item.effect.apply(state, item.counted_from(frame), item.values, item.rng())
        state = State(
            **{
                f.name: np.where(affected, getattr(after, f.name), getattr(state, f.name))
                for f in fields(State)
            }
        )
    return state


def _measured(state: State, frame: Frame, work: Sequence[Work]) -> State:
    """Find the indicated heading and airspeed, and the wind computed from them."""
    air_u, air_v = frame.ground_u - state.wind_u, frame.ground_v - state.wind_v
    airspeed = np.hypot(air_u, air_v)
    # an air vector of nothing has no heading: north, for the wind computed from it is the same
    heading = np.nan_to_num(bearing(air_u, air_v))
    clean = replace(state, airspeed=airspeed, heading_error=np.zeros(frame.size))
    after = clean
    for _ in range(MOST_ITERATIONS):
        indicated = heading + after.heading_error
        view = replace(
            frame,
            heading=indicated,
            magnetic_heading=indicated - frame.declination,
            airspeed=airspeed,
        )
        before = after.heading_error
        after = apply_stage(clean, view, work, "sensor")
        moved = np.max(np.abs(after.heading_error - before), initial=0.0)
        if moved < TOLERANCE:
            break
    else:
        raise InputError(
            "effects turn the heading faster than the heading itself: it does not settle",
            field="effects",
            found=f"still moving by {np.degrees(moved):.2g} degrees",
            remedy="give a smaller amplitude (a compass errs by degrees, not tens of them)",
        )
    report_u, report_v = wind_from_triangle(
        frame.ground_u, frame.ground_v, after.airspeed, heading + after.heading_error
    )
    return replace(after, report_u=report_u, report_v=report_v)


def _sent(state: State, frame: Frame, coding: Coding | None) -> Frame:
    u, v = state.report_u, state.report_v
    if coding is not None:
        u, v = coding.apply(u, v)
    air_u, air_v = frame.ground_u - u, frame.ground_v - v
    heading = np.nan_to_num(bearing(air_u, air_v))
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=heading,
        magnetic_heading=wrap_positive(heading - frame.declination),
        airspeed=np.hypot(air_u, air_v),
        latitude=state.latitude,
        longitude=state.longitude,
    )


def _rounded(values: FloatArray, step: FloatArray | float) -> FloatArray:
    wide = np.broadcast_to(np.asarray(step, dtype=np.float64), values.shape)
    # aircraft that code in no step stand among those that do
    safe = np.where(wide > 0.0, wide, 1.0)
    return np.where(wide > 0.0, np.round(values / safe) * safe, values)
