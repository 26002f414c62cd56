"""Definition of an effect, the catalogue of effects, and common forms of effects.

Assumptions and validity: an effect acts at one stage of the simulated measurement,

``identity``     the airframe behind a reported identifier;
``atmosphere``   the wind met, where it differs from the reference wind as sampled;
``sensor``       the indicated heading or airspeed, functions of the INDICATED magnetic heading;
``report``       changes of the computed wind by the unit before it is sent;

and the wind computed between the last two is ``V_G - V_ind h(psi_ind)`` with
``h = (sin psi, cos psi)``. A heading error is indicated minus true. Design columns are the exact
derivatives of the simulated reported wind at zero effect, as functions of the indicated heading
``psi``: ``d W = -V n d psi`` with ``n = (cos psi, -sin psi)`` and ``d W = -h d V``. An unknown
quantity of the context contributes nothing.

Units: radians, m/s and SI for coefficients; degrees, hours, feet and the like for the parameters
in files, as given by each `Parameter`.
"""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.result.schema.entries import Parameter as Value
from airswing.physics.atmosphere import (
    GAS_CONSTANT,
    GRAVITY,
    altitude_from_pressure,
    standard_temperature,
)
from airswing.synthetic.sealed.draws import Draw

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
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
LEAST_SPREAD = 2e-3
"""One minus the mean resultant length of headings (about 4 degrees) below which they are equal."""
SPREAD = 1e-9
"""Relative range of a quantity below which it is constant."""
MAX_PHASE_ERROR = 180.0 / np.sqrt(3.0)
"""Standard error of an unknown phase, uniform over a full turn, degrees."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect in files and results."""

    name: str  # name, with the unit at its end
    units: str  # unit in words of the configuration ("degree", "percent", "kt")
    scale: float  # plausible size, the prior standard deviation
    description: str  # meaning, and meaning of the sign
    default: float | None = 0.0  # value where none is given
    required: bool = False  # whether a value must be given
    si: float = 1.0  # one unit in radians or SI
    number: bool = True  # False for a parameter that is not a number (the pair of a swap)


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
    """Return the value of a numeric parameter.

    Raises
    ------
    TypeError
        The value is not a number.
    """
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
    # names of the linear coefficients, in the order of `columns`
    column_names: ClassVar[tuple[str, ...]] = ()
    # sets of columns that are one candidate each; empty: all columns together
    alternatives: ClassVar[tuple[tuple[int, ...], ...]] = ()
    # share of the effect's energy in its columns: below 1, as headings in turns are those of
    # chords, and lower where more of the context is inferred (bank, acceleration)
    reliability: ClassVar[float] = 0.99
    deviates: ClassVar[bool] = (
        False  # whether it is part of the deviation that the product corrects
    )
    draw: ClassVar[Draw | None] = None  # draw of the blind check; None: not part of it

    @property
    @abstractmethod
    def column_scales(self) -> Floats:
        """Prior standard deviation of each coefficient, (k,)."""

    @abstractmethod
    def columns(self, frame: Frame) -> Floats:
        """Compute the derivative of the reported wind by each coefficient at zero effect.

        Parameters
        ----------
        frame : Frame
            Reports, with INDICATED heading and airspeed.

        Returns
        -------
        (k, n, 2) float
            Eastward and northward component, m s-1 per unit of the coefficient.
        """

    def curvature(self, frame: Frame) -> Floats | None:
        """Compute what each squared coefficient adds to the reported wind.

        Returns
        -------
        (k, n, 2) float or None
            None where the columns are exact, or the effect is one of the indicated heading or
            airspeed, of which every order is known.
        """
        return None

    def tied(self, subset: tuple[int, ...]) -> Floats:
        """Return the linear map from free coefficients to those of an alternative.

        Parameters
        ----------
        subset : tuple of int
            One of :attr:`alternatives`, with k columns.

        Returns
        -------
        (k, m) float
            The identity unless coefficients are constrained.
        """
        return np.eye(len(subset))

    def softened_columns(self, frame: Frame) -> Floats:
        """Return the columns with soft edges where they have edges in pressure, (k, n, 2)."""
        return self.columns(frame)

    @abstractmethod
    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        """Transform every report exactly (the simulation restricts aircraft and period).

        Parameters
        ----------
        state : State
            State before the effect.
        frame : Frame
            Context, with the simulated indicated heading and airspeed.
        values : dict
            Complete parameters in the catalogue's units.
        rng : numpy.random.Generator
            For random effects.

        Returns
        -------
        State
        """

    @abstractmethod
    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        """Convert coefficients to parameters, with standard errors by the delta method.

        Parameters
        ----------
        coefficients : (k,) float
            rad and SI.
        covariance : (k, k) float
            Covariance of the coefficients.
        frame : Frame
            For constants of the archive.

        Returns
        -------
        parameters, standard_errors : dict
            In the catalogue's units.
        """

    @abstractmethod
    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """Convert parameters to coefficients, (k,): the inverse of `to_parameters`."""

    def testable(self, frame: Frame) -> str | None:
        """Return the reason why the effect cannot be tested on these reports, or None."""
        for name in self.needs:
            reason = missing_context(frame, name)
            if reason is not None:
                return reason
        return None

    def acts(self, frame: Frame) -> NDArray[np.bool_] | None:
        """Mark the reports over which the rms size of the effect is computed, (n,).

        None for all reports with nonzero columns. Columns may be nonzero on other reports (the end
        of a turn, levelling off after a climb).
        """
        return None

    def complete(self, values: Mapping[str, object]) -> Parameters:
        """Complete parameters by their defaults.

        Parameters
        ----------
        values : mapping
            Given parameters.

        Returns
        -------
        dict

        Raises
        ------
        InputError
            A parameter is unknown or a required one absent.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        for name in values:
            if name not in known:
                raise InputError(
                    f"effect {self.name} has no parameter {name}",
                    field=name,
                    remedy=f"it takes {', '.join(known)}",
                )
        for name, parameter in known.items():
            if parameter.required and values.get(name) is None:
                raise InputError(f"effect {self.name} needs a value of {name}", field=name)
        return {name: parameter.default for name, parameter in known.items()} | dict(values)


# ------------------------------------------------------------------------------ common forms
class ProportionalEffect(Effect):
    """Effect whose parameters are its coefficients in other units."""

    @property
    def column_scales(self) -> Floats:
        """See `Effect.column_scales`: the scales of the parameters."""
        return np.array([p.scale * p.si for p in self.parameters])

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        """See `Effect.to_parameters`."""
        values: Stated = {}
        errors: Errors = {}
        for k, parameter in enumerate(self.parameters):
            values[parameter.name] = float(coefficients[k]) / parameter.si
            errors[parameter.name] = standard_error(covariance, k) / parameter.si
        return values, errors

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        return np.array([number(full[p.name]) * p.si for p in self.parameters])


class MomentEffect(Effect):
    """Effect on variances and coding only, without columns."""

    kind: ClassVar[Kind] = "second_moment"
    stage: ClassVar[Stage] = "report"

    @property
    def column_scales(self) -> Floats:
        """See `Effect.column_scales`: none."""
        return np.zeros(0)

    def columns(self, frame: Frame) -> Floats:
        """See `Effect.columns`: none, (0, n, 2)."""
        return np.zeros((0, frame.size, 2))

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        """See `Effect.to_parameters`: none; they are stated by the test of the effect."""
        return {}, {}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """See `Effect.from_parameters`: no coefficient."""
        return np.zeros(0)


class WindEffect(Effect):
    """Difference of the wind met from the reference as a linear combination of columns."""

    stage: ClassVar[Stage] = "atmosphere"

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        """See `Effect.apply`: coefficients times columns, exact to the order of the context."""
        coefficients = self.from_parameters(values, frame)
        change = np.tensordot(coefficients, self.columns(frame), axes=1)
        curvature = self.curvature(frame)
        if curvature is not None:
            change = change + np.tensordot(coefficients**2, curvature, axes=1)
        return replace(
            state, wind_u=state.wind_u + change[:, 0], wind_v=state.wind_v + change[:, 1]
        )


class HeadingEffect(Effect):
    """Heading error as a linear combination of known functions of the context."""

    @abstractmethod
    def basis(self, frame: Frame) -> Floats:
        """Heading error per unit of each coefficient, (k, n)."""

    def columns(self, frame: Frame) -> Floats:
        """See `Effect.columns`: ``-V n(psi)`` times the basis."""
        right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], axis=-1)
        derivative = -frame.airspeed[:, None] * right
        return np.asarray(known(self.basis(frame))[:, :, None] * derivative)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        """See `Effect.apply`: the basis at the indicated magnetic heading, added to the error."""
        error = self.from_parameters(values, frame) @ known(self.basis(frame))
        return replace(state, heading_error=state.heading_error + error)


class CycleEffect(HeadingEffect):
    """Heading error of one or more cycles in magnetic heading."""

    number_of_cycles: ClassVar[int] = 1

    def basis(self, frame: Frame) -> Floats:
        """Return sine and cosine of the cycles of the magnetic heading, (2, n)."""
        return cycles(frame.magnetic_heading, self.number_of_cycles)

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        """See `Effect.to_parameters`."""
        (amplitude, phase), (error, phase_error) = amplitude_phase(coefficients, covariance)
        values: Stated = {"amplitude_deg": amplitude, "phase_deg": phase}
        return values, {"amplitude_deg": error, "phase_deg": phase_error}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        return sine_cosine(number(full["amplitude_deg"]), number(full["phase_deg"]))


class OffsetAndCycle(HeadingEffect):
    """Heading error of an offset and one cycle in magnetic heading, under some condition."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("offset_deg", "degree", 1.5, "indicated minus true heading", si=DEGREE),
        Parameter("amplitude_deg", "degree", 3.0, "amplitude of one cycle", si=DEGREE),
        Parameter("phase_deg", "degree", 180.0, "of amplitude sin(magnetic heading + phase)"),
    )
    column_names: ClassVar[tuple[str, ...]] = ("offset", "sin", "cos")

    @property
    def column_scales(self) -> Floats:
        """See `Effect.column_scales`; rad."""
        return np.radians([1.5, 2.0, 2.0])

    def basis(self, frame: Frame) -> Floats:
        """Return one, sine and cosine of the magnetic heading, (3, n)."""
        return np.concatenate([np.ones((1, frame.size)), cycles(frame.magnetic_heading)])

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
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

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        cycle = sine_cosine(number(full["amplitude_deg"]), number(full["phase_deg"]))
        return np.array([np.radians(number(full["offset_deg"])), *cycle])


def known(values: Floats) -> Floats:
    """Replace unknown values by 0."""
    return np.where(np.isfinite(values), values, 0.0)


def airspeed_derivative(frame: Frame) -> Floats:
    """Return the reported wind per m/s of airspeed error, (n, 2): ``-(sin psi, cos psi)``."""
    return -np.stack([np.sin(frame.heading), np.cos(frame.heading)], axis=-1)


def log_pressure_lapse(frame: Frame) -> Floats:
    """Return minus d ln p / d(pressure altitude), (n,) m-1: g / (R T), standard atmosphere."""
    altitude = altitude_from_pressure(frame.pressure)
    return np.asarray(GRAVITY / (GAS_CONSTANT * standard_temperature(altitude)))


def cycles(angle: Floats, number_of_cycles: int = 1) -> Floats:
    """Return sine and cosine of cycles of an angle, (2, n)."""
    return np.stack([np.sin(number_of_cycles * angle), np.cos(number_of_cycles * angle)])


def amplitude_phase(
    coefficients: Floats, covariance: Floats
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Convert ``B sin + C cos`` to ``amplitude sin(. + phase)``.

    Parameters
    ----------
    coefficients : (2,) float
        B and C, rad.
    covariance : (2, 2) float
        rad squared.

    Returns
    -------
    (amplitude, phase), (standard errors)
        Degrees; phase in (-180, 180]; errors by the delta method.
    """
    sine, cosine = float(coefficients[0]), float(coefficients[1])
    covariance = np.asarray(covariance, dtype=np.float64)
    amplitude = float(np.hypot(sine, cosine))
    if amplitude == 0.0:  # the phase is undefined
        spread = float(np.degrees(np.sqrt(max(0.0, np.trace(covariance) / 2.0))))
        return (0.0, 0.0), (spread, MAX_PHASE_ERROR)
    gradient = np.array([[sine, cosine], [-cosine / amplitude, sine / amplitude]]) / amplitude
    variance = np.einsum("ij,jk,ik->i", gradient, covariance, gradient)
    errors = np.degrees(np.sqrt(np.maximum(variance, 0.0)))
    phase = float(np.degrees(np.arctan2(cosine, sine)))
    return (
        (float(np.degrees(amplitude)), phase),
        (float(errors[0]), min(float(errors[1]), MAX_PHASE_ERROR)),
    )


def sine_cosine(amplitude: float, phase: float) -> Floats:
    """Return B and C (rad) of an amplitude and a phase (degrees)."""
    angle = np.radians(phase)
    return np.asarray(np.radians(amplitude) * np.array([np.cos(angle), np.sin(angle)]))


def standard_error(covariance: Floats, index: int = 0) -> float:
    """Return the standard error of one coefficient."""
    return float(np.sqrt(max(0.0, float(np.asarray(covariance)[index, index]))))


# ------------------------------------------------------------------------------------ context
_ABSENT = {
    "icing": "no icing column",
    "temperature": "no temperature",
    "acceleration": "no longitudinal acceleration",
    "bank": "no bank",
    "climb_rate": "no climb rate",
    "dip": "no dip",
    "declination": "no declination",
    "dudt": "no tendency of the reference wind",
    "dudlnp": "no vertical derivative of the reference wind",
    "dudx": "no horizontal derivative of the reference wind",
    "grid_convergence": "no convergence angle of the grid",
}
_CONSTANT = {
    "heading": "all reports on one heading",
    "magnetic_heading": "all reports on one heading",
    "icing": "icing protection never changes in these reports",
    "time": "all reports at one time",
    "dudt": "the reference wind has no tendency (one valid time)",
    "dudlnp": "the reference wind has no vertical derivative (one level)",
    "grid_convergence": "the grid's north is true north everywhere",
    "bank": "no turns in these reports",
    "acceleration": "no acceleration in these reports",
}


def absent_context(frame: Frame, name: str) -> str | None:
    """Return a message where a field of the frame is unknown everywhere, or None."""
    if _known_values(frame, name).size == 0:
        return _ABSENT.get(name, f"no {name.replace('_', ' ')}")
    return None


def missing_context(frame: Frame, name: str) -> str | None:
    """Return a message where a field of the frame is unknown or constant, or None."""
    reason = absent_context(frame, name)
    if reason is not None:
        return reason
    values = _known_values(frame, name)
    if name in {"heading", "magnetic_heading"}:
        varies = 1.0 - np.hypot(np.mean(np.cos(values)), np.mean(np.sin(values))) > LEAST_SPREAD
    else:
        varies = float(np.ptp(values)) > SPREAD * max(1e-6, float(np.max(np.abs(values))))
    if not varies:
        return _CONSTANT.get(name, f"{name.replace('_', ' ')} does not vary in these reports")
    return None


def _known_values(frame: Frame, name: str) -> Floats:
    values = np.asarray(getattr(frame, name), dtype=np.float64)
    return values[values >= 0.0] if name == "icing" else values[np.isfinite(values)]


# ---------------------------------------------------------------------------------- catalogue
CATALOGUE: dict[str, Effect] = {}
"""All known effects by name, in alphabetical order of their files, then of registration."""


def register(effect: Effect) -> Effect:
    """Add an effect to the catalogue.

    Parameters
    ----------
    effect : Effect
        An instance with a new name.

    Returns
    -------
    Effect
        The same.

    Raises
    ------
    ValueError
        Another effect has the name.
    """
    if CATALOGUE.get(effect.name, effect) is not effect:
        raise ValueError(f"an effect named {effect.name} is already in the catalogue")
    CATALOGUE[effect.name] = effect
    return effect


def unregister(name: str) -> Effect:
    """Remove an effect from the catalogue and return it (for leave-one-effect-out checks)."""
    return CATALOGUE.pop(name)


def discover(package: str) -> None:
    """Register the ``EFFECT`` of every module of a package, in alphabetical order."""
    folder = importlib.import_module(package)
    for found in sorted(pkgutil.iter_modules(folder.__path__), key=lambda module: module.name):
        module = importlib.import_module(f"{package}.{found.name}")
        effect = getattr(module, "EFFECT", None)
        if isinstance(effect, Effect):
            register(effect)
