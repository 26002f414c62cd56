"""Forward simulation of the reports of an archive, and removal of known effects from reports.

Simulation (docs/gap.md, section 1). Indicated heading and airspeed follow from the sensor effects,
evaluated at the INDICATED magnetic heading by fixed-point iteration; the reported wind is ``V_G -
V_ind h(psi_ind)``, then the effects of the unit, then its coding. Deviations must change by less
than a degree per degree.

Removal. A unit that indicated ``psi`` and ``V`` flew ``psi - d(psi)`` at the airspeed that it would
indicate as ``V``, and its wind differs by ``V h(psi) - V_true h(psi - d)``. Effects on the wind met
are added to the reference wind; exchanged identifiers are exchanged back. An empirical table is
removed by iteration. Effects on scatter and coding cannot be removed from single reports.

Units: those of `airswing.gap.archive.frame`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from airswing.errors import InputError, nearest
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import HeadingSteps, in_steps
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects import CATALOGUE, EMPIRICAL, ActiveEffect, Effect, State, effect_named
from airswing.gap.effects.base import Parameters, missing_context
from airswing.gap.noise import NoiseModel, flight_order, flight_steps, neighbour_pairs, scaled
from airswing.physics.triangle import (
    bearing,
    wind_components,
    wind_from_direction,
    wind_from_triangle,
    wrap_positive,
    wrap_signed,
)


@dataclass(frozen=True)
class Coding:
    """Steps in which a unit takes its heading and codes its wind; 0 for no rounding."""

    speed: Floats | float  # (n,) or float; m s-1
    direction: Floats | float  # (n,) or float; degree
    headings: HeadingSteps | None = None

    @classmethod
    def of_archive(cls, frame: Frame) -> Coding:
        """Return the coding of winds by each aircraft of the archive; 0 where unknown."""
        speed = np.nan_to_num(frame.wind_speed_resolution)[frame.aircraft]
        return cls(speed, np.nan_to_num(frame.wind_direction_resolution)[frame.aircraft])

    @classmethod
    def as_found(cls, frame: Frame) -> Coding:
        """Return the coding of winds with the steps that are found in the headings."""
        return replace(cls.of_archive(frame), headings=HeadingSteps.of_archive(frame))

    def apply(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Code winds (u, v) as met or measured, m s-1."""
        if self.headings is not None:
            u, v = self.headings.apply(u, v)
        speed, direction = wind_from_direction(u, v)
        degrees = in_steps(np.degrees(np.where(speed > 0.0, direction, 0.0)), self.direction)
        return wind_components(in_steps(speed, self.speed), np.radians(degrees))


@dataclass(frozen=True)
class PreparedEffect:
    """An effect with complete parameters and its seed."""

    effect: Effect
    active: ActiveEffect
    values: Parameters
    seed: np.random.SeedSequence

    @classmethod
    def all_of(
        cls, effects: Sequence[ActiveEffect], frame: Frame, seeds: Sequence[np.random.SeedSequence]
    ) -> list[PreparedEffect]:
        """Check effects against a frame and complete their parameters."""
        out = []
        for active, seed in zip(effects, seeds, strict=True):
            effect = effect_named(active.name)
            if effect is None:
                message = f"unknown effect{nearest(active.name, list(CATALOGUE))}"
                raise InputError(message, found=active.name)
            if active.tails is not None:
                frame.aircraft_mask(active.tails)  # raises for an unknown aircraft
            for name in effect.needs:
                if (why := missing_context(frame, name, may_be_constant=True)) is not None:
                    raise InputError(f"{active.name} cannot be simulated: {why}", field=active.name)
            out.append(cls(effect, active, effect.complete(active.parameters), seed))
        return out

    def affected(self, state: State, frame: Frame) -> Booleans:
        """Mark the reports of the affected airframes within the period, (n,)."""
        affected = np.ones(frame.size, dtype=np.bool_)
        if self.active.tails is not None:
            affected &= np.isin(state.airframe, [frame.tails.index(t) for t in self.active.tails])
        start, end = self.active.period or (None, None)
        if start is not None:
            affected &= frame.time >= start
        if end is not None:
            affected &= frame.time < end
        return affected

    def apply(self, state: State, frame: Frame) -> State:
        """Apply the effect to the affected reports; time counts from the start of its period."""
        affected = self.affected(state, frame)
        start = self.active.period[0] if self.active.period else None
        if start is not None and start > frame.epoch:
            frame = replace(frame, epoch=start)
        after = self.effect.apply(state, frame, self.values, np.random.default_rng(self.seed))
        changed = {
            f.name: np.where(affected, getattr(after, f.name), getattr(state, f.name))
            for f in fields(State)
        }
        return State(**changed)


def simulate(
    frame: Frame,
    *,
    effects: Sequence[ActiveEffect] = (),
    noise: NoiseModel | None = None,
    coding: Coding | None = None,
    seed: int = 0,
) -> Frame:
    """Simulate the reports of a frame: winds, implied heading and airspeed, positions as sent.

    The ``noise`` of the reference does not depend on the effects, so that two simulations of one
    ``seed`` differ by the effects only. InputError for an unknown effect or aircraft, where the
    context of an effect is absent, or where no indicated heading exists.
    """
    noise_seed, *seeds = np.random.SeedSequence(seed).spawn(1 + len(effects))
    prepared = PreparedEffect.all_of(effects, frame, seeds)
    state = _initial_state(frame)
    if noise is not None:
        error = draw_noise(frame, noise, rng=np.random.default_rng(noise_seed))
        state = replace(state, wind_u=frame.u_ref + error[:, 0], wind_v=frame.v_ref + error[:, 1])
    state = _apply_stages(state, frame, prepared, "identity", "atmosphere")
    state = _measured(state, frame, prepared)
    state = _apply_stages(state, frame, prepared, "report")
    u, v = state.report_u, state.report_v
    if coding is not None:
        u, v = coding.apply(u, v)
    air = frame.ground_u - u, frame.ground_v - v
    heading = np.nan_to_num(bearing(*air))
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=heading,
        magnetic_heading=wrap_positive(heading - frame.declination),
        airspeed=np.hypot(*air),
        latitude=state.latitude,
        longitude=state.longitude,
    )


def draw_noise(frame: Frame, noise: NoiseModel, *, rng: np.random.Generator) -> Floats:
    """Error of the reference wind at reports in any order, stationary along flights, (n, 2)."""
    order = flight_order(frame.flight, frame.time)
    log_pressure = np.log(frame.pressure)
    decay = noise.decay(*flight_steps(frame.latitude, frame.longitude, log_pressure, order))
    correlated, white = np.empty((2, frame.size, 2))
    correlated[order.index], white[order.index] = rng.standard_normal((2, frame.size, 2))
    # innovations, whose variance keeps the variance of the process constant along the flight
    correlated *= np.sqrt(1.0 - decay**2)[:, None]
    for before, now in neighbour_pairs(order):
        correlated[now] += decay[now, None] * correlated[before]
    error = noise.correlated_sd * correlated + noise.white_sd * white
    anisotropic = scaled(error, noise.direction_factors(frame.heading))
    return np.asarray(noise.factor(log_pressure)[:, None] * anisotropic)


def remove_effects(frame: Frame, effects: Sequence[ActiveEffect]) -> Frame:
    """Remove known effects from the reports; those on scatter and coding are ignored.

    InputError for an unknown effect or aircraft, or where the context of an effect is absent.
    """
    seeds = np.random.SeedSequence(0).spawn(len(effects))
    prepared = PreparedEffect.all_of(effects, frame, seeds)
    frame = _without_tables(frame, prepared)
    met = _apply_stages(_initial_state(frame), frame, prepared, "identity", "atmosphere")
    frame = replace(frame, aircraft=met.airframe)
    true = frame.airspeed
    state = after = _initial_state(frame)
    for _ in range(8):  # errors of the airspeed of 10 % converge below 1e-5 m/s
        after = _apply_stages(replace(state, airspeed=true), frame, prepared, "sensor")
        true = true - (after.airspeed - frame.airspeed)
    error = after.heading_error
    heading = frame.heading - error
    change = frame.airspeed * np.stack([np.sin(frame.heading), np.cos(frame.heading)])
    change = change - true * np.stack([np.sin(heading), np.cos(heading)])
    return replace(
        frame,
        u_ref=met.wind_u,
        v_ref=met.wind_v,
        u_rep=frame.u_rep + change[0],
        v_rep=frame.v_rep + change[1],
        heading=heading,
        airspeed=true,
        magnetic_heading=wrap_positive(frame.magnetic_heading - error),
    )


def _without_tables(frame: Frame, prepared: Sequence[PreparedEffect]) -> Frame:
    """Remove empirical tables from the reported winds, the last one first."""
    tables = [item for item in prepared if item.active.name == EMPIRICAL.name]
    if not tables:
        return frame
    state = _initial_state(frame)
    for item in reversed(tables):
        affected = item.affected(state, frame)
        before = EMPIRICAL.undo(state, frame, item.values)
        u = np.where(affected, before.report_u, state.report_u)
        v = np.where(affected, before.report_v, state.report_v)
        state = replace(state, report_u=u, report_v=v)
    u, v = state.report_u, state.report_v
    # changes of the air vector are added: heading and airspeed need not close the wind triangle
    sent = np.stack([frame.ground_u - frame.u_rep, frame.ground_v - frame.v_rep])
    air = np.stack([frame.ground_u - u, frame.ground_v - v])
    rotation = wrap_signed(bearing(*air) - bearing(*sent))
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=frame.heading + rotation,
        airspeed=frame.airspeed + np.hypot(*air) - np.hypot(*sent),
        magnetic_heading=wrap_positive(frame.magnetic_heading + rotation),
    )


def _initial_state(frame: Frame) -> State:
    return State(
        airframe=frame.aircraft.copy(),
        wind_u=frame.u_ref,
        wind_v=frame.v_ref,
        heading_error=np.zeros(frame.size),
        airspeed=frame.airspeed,
        report_u=frame.u_rep,
        report_v=frame.v_rep,
        latitude=frame.latitude,
        longitude=frame.longitude,
    )


def _apply_stages(
    state: State, frame: Frame, prepared: Sequence[PreparedEffect], *stages: str
) -> State:
    for stage in stages:
        for item in prepared:
            if item.effect.stage == stage:
                state = item.apply(state, frame)
    return state


def _measured(state: State, frame: Frame, prepared: Sequence[PreparedEffect]) -> State:
    air = frame.ground_u - state.wind_u, frame.ground_v - state.wind_v
    airspeed = np.hypot(*air)
    # a zero air vector has no heading; any heading leads to the same wind
    heading = np.nan_to_num(bearing(*air))
    clean = replace(state, airspeed=airspeed, heading_error=np.zeros(frame.size))
    after, change = clean, 0.0
    for _ in range(100):  # about ten are usual
        indicated = heading + after.heading_error
        magnetic = indicated - frame.declination
        view = replace(frame, heading=indicated, magnetic_heading=magnetic, airspeed=airspeed)
        before = after.heading_error
        after = _apply_stages(clean, view, prepared, "sensor")
        change = np.max(np.abs(after.heading_error - before), initial=0.0)
        if change < 1e-12:
            break
    else:
        raise InputError(
            "effects change faster than the heading itself: the indicated heading does not settle",
            field="effects",
            found=f"still changing by {np.degrees(change):.2g} degrees",
            remedy="give a smaller amplitude (compass errors are degrees, not tens of degrees)",
        )
    report_u, report_v = wind_from_triangle(
        frame.ground_u, frame.ground_v, after.airspeed, heading + after.heading_error
    )
    return replace(after, report_u=report_u, report_v=report_v)
