"""Common forms of effects, and the pieces they are built from.

Assumptions and validity: as in `airswing.gap.effects.base`. A quantity of the context that is not
known contributes nothing (no statement is made about the report).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import (
    Effect,
    Errors,
    FloatArray,
    Kind,
    Parameter,
    Parameters,
    Stage,
    State,
    Stated,
    number,
)
from airswing.physics.atmosphere import (
    GAS_CONSTANT,
    GRAVITY,
    altitude_from_pressure,
    standard_temperature,
)

DEGREE = float(np.pi / 180.0)
"""One degree in radians."""
MAX_PHASE_ERROR = 180.0 / np.sqrt(3.0)
"""Standard error (degree) of a phase about which nothing is known (uniform over a turn)."""


class OneCoefficient(Effect):
    """An effect of one parameter proportional to its one coefficient."""

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`: the parameter's scale."""
        return np.array([self.parameters[0].scale * self.parameters[0].si])

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`: a change of unit."""
        name, unit = self.parameters[0].name, self.parameters[0].si
        value, error = float(coefficients[0]), standard_error(covariance)
        return {name: value / unit}, {name: error / unit}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`: a change of unit."""
        first = self.parameters[0]
        return np.array([number(self.complete(values)[first.name]) * first.si])


class MomentEffect(Effect):
    """An effect on variances and lattices only: it has no column."""

    kind: ClassVar[Kind] = "second_moment"
    stage: ClassVar[Stage] = "report"

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`: none."""
        return np.zeros(0)

    def columns(self, frame: Frame) -> FloatArray:
        """See `Effect.columns`: none, (0, n, 2)."""
        return np.zeros((0, frame.size, 2))

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`: nothing; the test that finds the effect states it."""
        return {}, {}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`: no coefficient."""
        return np.zeros(0)


class WindEffect(Effect):
    """A wind met (or sent) that parts from the reference by linear combination of columns."""

    stage: ClassVar[Stage] = "atmosphere"

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: coefficients times columns, exact to the order of the context."""
        change = np.tensordot(self.from_parameters(values, frame), self.columns(frame), axes=1)
        return replace(
            state, wind_u=state.wind_u + change[:, 0], wind_v=state.wind_v + change[:, 1]
        )


class HeadingEffect(Effect):
    """A heading error that is a linear combination of known functions of the context."""

    @abstractmethod
    def basis(self, frame: Frame) -> FloatArray:
        """Heading error per unit of each coefficient, (k, n)."""

    def columns(self, frame: Frame) -> FloatArray:
        """See `Effect.columns`: ``-V n(psi)`` times the basis."""
        return known(self.basis(frame))[:, :, None] * heading_derivative(frame)

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: the basis at the indicated magnetic heading, added to the error."""
        error = self.from_parameters(values, frame) @ known(self.basis(frame))
        return replace(state, heading_error=state.heading_error + error)


class OffsetAndCycle(HeadingEffect):
    """A heading error of an offset and one cycle in magnetic heading, under some condition."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset_deg", "degree", 1.5, "indicated minus true heading", si=DEGREE),
        Parameter("amplitude_deg", "degree", 3.0, "amplitude of one cycle", si=DEGREE),
        Parameter("phase_deg", "degree", 180.0, "of amplitude sin(magnetic heading + phase)"),
    )
    column_names: ClassVar[tuple[str, ...]] = ("offset", "sin", "cos")

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; rad."""
        return np.radians([1.5, 2.0, 2.0])

    def condition(self, frame: Frame) -> FloatArray:
        """Return how much of the effect is on, (n,)."""
        return np.ones(frame.size)

    def basis(self, frame: Frame) -> FloatArray:
        """Return one, sine and cosine of the magnetic heading where the condition holds."""
        cycle = cycles(frame.magnetic_heading)
        return np.concatenate([np.ones((1, frame.size)), cycle]) * self.condition(frame)

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`."""
        cycle = amplitude_phase(coefficients[1:], np.asarray(covariance)[1:, 1:])
        (amplitude, phase), (error, phase_error) = cycle
        return (
            {
                "offset_deg": float(np.degrees(coefficients[0])),
                "amplitude_deg": amplitude,
                "phase_deg": phase,
            },
            {
                "offset_deg": float(np.degrees(standard_error(covariance))),
                "amplitude_deg": error,
                "phase_deg": phase_error,
            },
        )

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        cycle = sine_cosine(number(full["amplitude_deg"]), number(full["phase_deg"]))
        return np.array([np.radians(number(full["offset_deg"])), *cycle])


def known(values: FloatArray) -> FloatArray:
    """Put 0 where the context is not known: no statement, so no contribution."""
    return np.where(np.isfinite(values), values, 0.0)


def heading_derivative(frame: Frame) -> FloatArray:
    """Give the reported wind per radian of heading error, (n, 2): ``-V (cos psi, -sin psi)``."""
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], axis=-1)
    return np.asarray(-frame.airspeed[:, None] * right)


def airspeed_derivative(frame: Frame) -> FloatArray:
    """Give the reported wind per m/s of airspeed error, (n, 2): ``-(sin psi, cos psi)``."""
    return -np.stack([np.sin(frame.heading), np.cos(frame.heading)], axis=-1)


def log_pressure_lapse(frame: Frame) -> FloatArray:
    """Return minus d ln p / d(pressure altitude), (n,) m-1: g / (R T), standard atmosphere."""
    altitude = altitude_from_pressure(frame.pressure)
    return np.asarray(GRAVITY / (GAS_CONSTANT * standard_temperature(altitude)))


def cycles(angle: FloatArray, number: int = 1) -> FloatArray:
    """Return sine and cosine of `number` cycles of an angle, (2, n)."""
    return np.stack([np.sin(number * angle), np.cos(number * angle)])


def amplitude_phase(
    coefficients: FloatArray, covariance: FloatArray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Give amplitude and phase of ``B sin + C cos = amplitude sin(. + phase)``, in degrees.

    Parameters
    ----------
    coefficients : ndarray (2,)
        B and C, rad.
    covariance : ndarray (2, 2)
        rad squared.

    Returns
    -------
    (amplitude, phase), (their standard errors)
        Degrees; phase in (-180, 180]; errors by the delta method.
    """
    sine, cosine = float(coefficients[0]), float(coefficients[1])
    size = float(np.hypot(sine, cosine))
    phase = float(np.degrees(np.arctan2(cosine, sine)))
    covariance = np.asarray(covariance, dtype=np.float64)
    if size == 0.0:
        # of nothing the phase is any, and the gradients below divide by the size
        spread = float(np.degrees(np.sqrt(max(0.0, np.trace(covariance) / 2.0))))
        return (0.0, 0.0), (spread, MAX_PHASE_ERROR)
    amplitude_error = _spread(np.array([sine, cosine]) / size, covariance)
    phase_error = _spread(np.array([-cosine, sine]) / size**2, covariance)
    return (float(np.degrees(size)), phase), (amplitude_error, min(phase_error, MAX_PHASE_ERROR))


def _spread(gradient: FloatArray, covariance: FloatArray) -> float:
    variance = float(gradient @ covariance @ gradient)
    return float(np.degrees(np.sqrt(max(0.0, variance))))


def sine_cosine(amplitude: float, phase: float) -> FloatArray:
    """Return B and C (rad) of an amplitude and a phase (degrees)."""
    angle = np.radians(phase)
    return np.asarray(np.radians(amplitude) * np.array([np.cos(angle), np.sin(angle)]))


def standard_error(covariance: FloatArray, index: int = 0) -> float:
    """Return the standard error of one coefficient."""
    return float(np.sqrt(max(0.0, float(np.asarray(covariance)[index, index]))))
