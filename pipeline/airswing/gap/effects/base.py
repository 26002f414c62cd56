"""Definition of an effect, the catalogue of effects, and common forms of effects.

An effect acts at one stage of the simulated measurement (docs/gap.md, section 1): ``identity`` the
airframe behind a reported identifier; ``atmosphere`` the wind met, where it differs from the
reference wind as sampled; ``sensor`` the indicated heading (error: indicated minus true) or
airspeed, functions of the INDICATED magnetic heading; ``report`` changes of the computed wind by
the unit before it is sent. An unknown quantity of the context contributes nothing. Coefficients are
in radians and SI, parameters in files as given by each `Parameter`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, SupportsFloat

import numpy as np

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats, Integers
from airswing.gap.design import unit_vectors
from airswing.gap.result.schema import Parameter as Value
from airswing.physics.atmosphere import (
    GAS_CONSTANT,
    GRAVITY,
    altitude_from_pressure,
    standard_temperature,
)
from airswing.synthetic.sealed.draws import Draw
from airswing.units import DAY, FOOT, HOUR

Random = np.random.Generator
Scope = Literal["aircraft", "fleet", "reference", "pair"]
Kind = Literal["mean", "step", "drift", "swap", "second_moment"]
Stage = Literal["identity", "atmosphere", "sensor", "report"]
Parameters = dict[str, object]  # as given by the user or a file
Stated = dict[str, Value]  # as stated by the diagnosis
Errors = dict[str, float]
Estimate = tuple[Stated, Errors]

DEGREE = float(np.pi / 180.0)
"""One degree in radians."""
_SI = {"degree": DEGREE, "degree/day": DEGREE / DAY, "percent": 0.01, "ft": FOOT, "hour": HOUR}


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect in files and results."""

    name: str  # name, with the unit at its end
    # unit in words of the configuration ("degree", "percent", "kt"); empty for a parameter that is
    # not a number (the pair of a swap)
    units: str
    scale: float  # plausible size, the prior standard deviation
    description: str  # meaning, and meaning of the sign
    default: float | None = 0.0  # value where none is given
    required: bool = False  # whether a value must be given

    @property
    def si(self) -> float:
        """One unit in radians or SI."""
        return _SI.get(self.units, 1.0)


@dataclass(frozen=True)
class ActiveEffect:
    """An effect with parameters, affected aircraft and period."""

    name: str  # name in the catalogue
    # values in the catalogue's units
    parameters: Mapping[str, object] = field(default_factory=dict)
    tails: tuple[str, ...] | None = None  # affected aircraft; None for all
    # (start, end): s since 1970, either may be None; None for the whole archive
    period: tuple[float | None, float | None] | None = None


def number(value: object) -> float:
    """Return the value of a numeric parameter; TypeError for another."""
    if isinstance(value, str | SupportsFloat):
        return float(value)
    raise TypeError(f"{value!r} is no number")


@dataclass(frozen=True)
class State:
    """State of a simulated measurement, arrays over the ``n`` reports of a frame."""

    airframe: Integers  # (n,): index of the aircraft that physically flew the report
    # (n,): wind met by the aircraft, m s-1
    wind_u: Floats
    wind_v: Floats
    heading_error: Floats  # (n,): indicated minus true heading, rad
    airspeed: Floats  # (n,): indicated true airspeed, m s-1
    # (n,): wind as sent, m s-1; valid after the sensor stage
    report_u: Floats
    report_v: Floats
    # (n,): position as sent, degrees
    latitude: Floats
    longitude: Floats


class Effect(ABC):
    """One physical cause of a difference between reports and reference."""

    name: ClassVar[str]  # name in the catalogue
    title: ClassVar[str] = ""  # name in plain words
    physics: ClassVar[str]  # the physical process
    source: ClassVar[str]  # citation
    parameters: ClassVar[tuple[Parameter, ...]]
    scope: ClassVar[Scope] = "aircraft"  # set of reports with common coefficients
    kind: ClassVar[Kind] = "mean"  # kind of change of the reports
    stage: ClassVar[Stage] = "sensor"  # stage of the measurement
    # fields of the frame that must be known and vary
    needs: ClassVar[tuple[str, ...]] = ()
    # similar effects and under which conditions (in words; the Gram matrix decides on an archive)
    confused_with: ClassVar[tuple[str, ...]] = ()
    # other effect -> data that would separate the two
    distinguished_by: ClassVar[Mapping[str, str]] = {}
    # sets of columns that are one candidate each; empty: all columns together
    alternatives: ClassVar[tuple[tuple[int, ...], ...]] = ()
    # share of the effect's energy in its columns: below 1 where the context is inferred (bank,
    # acceleration, gradients of the wind)
    reliability: ClassVar[float] = 1.0
    # whether an effect that acts on no sensor reverses with the direction of flight, so that
    # the lasting error of the reference averages out
    reverses: ClassVar[bool] = False
    # whether it is part of the deviation that the product corrects
    deviates: ClassVar[bool] = False
    draw: ClassVar[Draw | None] = None  # draw of the blind check; None: not part of it

    @property
    @abstractmethod
    def column_scales(self) -> Floats:
        """Prior standard deviation of each coefficient, (k,)."""

    @abstractmethod
    def columns(self, frame: Frame) -> Floats:
        """Derivative of the reported wind by each coefficient at zero effect, (k, n, 2).

        Eastward and northward component, m s-1 per unit of the coefficient, at the INDICATED
        heading and airspeed of the frame.
        """

    def curvature(self, frame: Frame) -> Floats | None:
        """Change of the reported wind by each squared coefficient, (k, n, 2).

        None where the columns are exact, or the effect is one of the indicated heading or
        airspeed, of which every order is known.
        """
        return None

    def tied(self, subset: tuple[int, ...]) -> Floats:
        """Linear map (k, m) from free coefficients to those of one of `alternatives`."""
        return np.eye(len(subset))

    def softened_columns(self, frame: Frame) -> Floats:
        """Return the columns with soft edges where they have edges in pressure, (k, n, 2)."""
        return self.columns(frame)

    @abstractmethod
    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        """Transform every report exactly (the simulation restricts aircraft and period).

        The frame holds the simulated indicated heading and airspeed, ``values`` complete parameters
        in the catalogue's units.
        """

    @abstractmethod
    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        """Convert coefficients (k,), rad and SI, and their covariance to parameters.

        Parameters and standard errors (delta method) are in the catalogue's units.
        """

    def testable(self, frame: Frame) -> str | None:
        """Return the reason why the effect cannot be tested on these reports, or None."""
        reasons = (missing_context(frame, name) for name in self.needs)
        return next((reason for reason in reasons if reason is not None), None)

    def complete(self, values: Mapping[str, object]) -> Parameters:
        """Complete parameters by their defaults; InputError for an unknown or absent one."""
        by_name = {parameter.name: parameter for parameter in self.parameters}
        for name in values:
            if name not in by_name:
                raise InputError(
                    f"effect {self.name} has no parameter {name}",
                    field=name,
                    remedy=f"it takes {', '.join(by_name)}",
                )
        for name, parameter in by_name.items():
            if parameter.required and values.get(name) is None:
                raise InputError(f"effect {self.name} needs a value of {name}", field=name)
        return {name: parameter.default for name, parameter in by_name.items()} | dict(values)


# ------------------------------------------------------------------------------ common forms
class ProportionalEffect(Effect):
    """Effect whose parameters are its coefficients in other units."""

    @property
    def column_scales(self) -> Floats:
        return np.array([p.scale * p.si for p in self.parameters])

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        return (
            {p.name: float(coefficients[k]) / p.si for k, p in enumerate(self.parameters)},
            {p.name: standard_error(covariance, k) / p.si for k, p in enumerate(self.parameters)},
        )

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """Convert parameters to coefficients, (k,): the inverse of `to_parameters`."""
        full = self.complete(values)
        return np.array([number(full[p.name]) * p.si for p in self.parameters])


class MomentEffect(Effect):
    """Effect on variances and coding only, without columns; its test states the parameters."""

    kind: ClassVar[Kind] = "second_moment"
    stage: ClassVar[Stage] = "report"
    column_scales = np.zeros(0)

    def columns(self, frame: Frame) -> Floats:
        return np.zeros((0, frame.size, 2))

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        return {}, {}


class WindEffect(ProportionalEffect):
    """Difference of the wind met from the reference: columns, exact to the order of the context."""

    stage: ClassVar[Stage] = "atmosphere"

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        coefficients = self.from_parameters(values, frame)
        change = np.tensordot(coefficients, self.columns(frame), axes=1)
        curvature = self.curvature(frame)
        if curvature is not None:
            change = change + np.tensordot(coefficients**2, curvature, axes=1)
        u, v = state.wind_u + change[:, 0], state.wind_v + change[:, 1]
        return replace(state, wind_u=u, wind_v=v)


class AirspeedEffect(Effect):
    """Error of the indicated airspeed; columns are ``-h(psi)`` times a factor."""

    needs: ClassVar[tuple[str, ...]] = ("heading",)

    @abstractmethod
    def indicated(self, airspeed: Floats, values: Parameters) -> Floats:
        """Indicated airspeed for a true one, (n,) m s-1."""

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        return replace(state, airspeed=self.indicated(state.airspeed, values))

    def columns(self, frame: Frame) -> Floats:
        _, along = unit_vectors(frame.heading)
        return -along[None]


class HeadingEffect(Effect):
    """Heading error as a linear combination of known functions of the context."""

    @abstractmethod
    def basis(self, frame: Frame) -> Floats:
        """Heading error per unit of each coefficient, (k, n) rad."""

    @abstractmethod
    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """Convert parameters to coefficients, (k,): the inverse of `to_parameters`."""

    def error(self, frame: Frame, values: Parameters) -> Floats:
        """Heading error at the indicated magnetic heading, (n,) rad."""
        return np.asarray(self.from_parameters(values, frame) @ np.nan_to_num(self.basis(frame)))

    def columns(self, frame: Frame) -> Floats:
        right, _ = unit_vectors(frame.heading)
        derivative = -frame.airspeed[:, None] * right
        return np.asarray(np.nan_to_num(self.basis(frame))[:, :, None] * derivative)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        return replace(state, heading_error=state.heading_error + self.error(frame, values))


class CycleEffect(HeadingEffect):
    """Heading error of one or more cycles in magnetic heading."""

    number_of_cycles: ClassVar[int] = 1

    def basis(self, frame: Frame) -> Floats:
        angle = self.number_of_cycles * frame.magnetic_heading
        return np.stack([np.sin(angle), np.cos(angle)])

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # B sin + C cos as amplitude sin(. + phase)
        sine, cosine = (float(value) for value in coefficients)
        amplitude = float(np.hypot(sine, cosine))
        unknown = 180.0 / np.sqrt(3.0)  # standard error of a phase anywhere in a full turn
        if amplitude == 0.0:
            error, phase_error = np.degrees(np.sqrt(max(0.0, np.trace(covariance) / 2.0))), unknown
        else:
            by_phase = [-cosine / amplitude, sine / amplitude]
            gradient = np.array([[sine, cosine], by_phase]) / amplitude
            variance = np.einsum("ij,jk,ik->i", gradient, covariance, gradient)
            error, phase_error = np.degrees(np.sqrt(np.maximum(variance, 0.0)))
        phase = float(np.degrees(np.arctan2(cosine, sine)))
        values: Stated = {"amplitude_deg": float(np.degrees(amplitude)), "phase_deg": phase}
        phase_error = min(float(phase_error), unknown)
        return values, {"amplitude_deg": float(error), "phase_deg": phase_error}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        full = self.complete(values)
        amplitude, angle = np.radians([number(full[p]) for p in ("amplitude_deg", "phase_deg")])
        return np.array([amplitude * np.cos(angle), amplitude * np.sin(angle)])


class OffsetAndCycle(CycleEffect):
    """Heading error of an offset and one cycle in magnetic heading, under some condition."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset_deg", "degree", 1.5, "indicated minus true heading"),
        Parameter("amplitude_deg", "degree", 3.0, "amplitude of one cycle"),
        Parameter("phase_deg", "degree", 180.0, "of amplitude sin(magnetic heading + phase)"),
    )
    column_scales = np.radians([1.5, 2.0, 2.0])

    def basis(self, frame: Frame) -> Floats:
        return np.concatenate([np.ones((1, frame.size)), super().basis(frame)])

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        values, errors = super().to_parameters(coefficients[1:], covariance[1:, 1:], frame)
        offset: Stated = {"offset_deg": float(np.degrees(coefficients[0]))}
        error = {"offset_deg": float(np.degrees(standard_error(covariance)))}
        return offset | values, error | errors

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        offset = np.radians(number(self.complete(values)["offset_deg"]))
        return np.array([offset, *super().from_parameters(values, frame)])


def log_pressure_lapse(frame: Frame) -> Floats:
    """Return minus d ln p / d(pressure altitude), (n,) m-1: g / (R T), standard atmosphere."""
    altitude = altitude_from_pressure(frame.pressure)
    return np.asarray(GRAVITY / (GAS_CONSTANT * standard_temperature(altitude)))


def standard_error(covariance: Floats, index: int = 0) -> float:
    """Return the standard error of one coefficient."""
    return float(np.sqrt(max(0.0, float(np.asarray(covariance)[index, index]))))


# ------------------------------------------------------------------------------------ context
_ABSENT = {
    "icing": "no icing column",
    "dudt": "no tendency of the reference wind",
    "dudlnp": "no vertical derivative of the reference wind",
    "dudx": "no horizontal derivative of the reference wind",
}
_CONSTANT = {
    "heading": "all reports on one heading",
    "magnetic_heading": "all reports on one heading",
    "icing": "icing protection never changes in these reports",
    "dudt": "the reference wind has no tendency (one valid time)",
    "dudlnp": "the reference wind has no vertical derivative (one level)",
    "grid_convergence": "the grid's north is true north everywhere",
}


def missing_context(frame: Frame, name: str, *, may_be_constant: bool = False) -> str | None:
    """Return a message where a field of the frame is unknown everywhere or constant, or None."""
    values = np.asarray(getattr(frame, name), dtype=np.float64)
    values = values[values >= 0.0] if name == "icing" else values[np.isfinite(values)]
    if not values.size:
        return _ABSENT.get(name, f"no {name.replace('_', ' ')}")
    if name in {"heading", "magnetic_heading"}:
        # one minus the mean resultant length: headings within about 4 degrees are one heading
        varies = 1.0 - np.hypot(np.mean(np.cos(values)), np.mean(np.sin(values))) > 2e-3
    else:  # more than rounding
        varies = float(np.ptp(values)) > 1e-9 * max(1e-6, float(np.max(np.abs(values))))
    if varies or may_be_constant:
        return None
    return _CONSTANT.get(name, f"{name.replace('_', ' ')} does not vary in these reports")


# ---------------------------------------------------------------------------------- catalogue
CATALOGUE: dict[str, Effect] = {}
"""All known effects by name, in alphabetical order of their files."""
