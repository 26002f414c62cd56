"""What an effect is, the catalogue that holds them, and the pieces they share.

Assumptions and validity: an effect acts at one stage of the simulated measurement,

``identity``     which airframe stands behind a reported identifier;
``atmosphere``   the wind the aircraft met, where it is not the reference wind as sampled;
``sensor``       the indicated heading or airspeed, functions of the INDICATED magnetic heading;
``report``       what the unit makes of its computed wind before it is sent;

and the wind computed between the last two is ``V_G - V_ind h(psi_ind)`` with
``h = (sin psi, cos psi)``. A heading error is indicated minus true. Design columns are the exact
derivatives of the simulated reported wind at zero effect, so of the indicated heading ``psi``:
``d W = -V n d psi`` with ``n = (cos psi, -sin psi)`` and ``d W = -h d V``.

Units: radians, m/s and SI inside (``coefficients``); degrees, hours, feet and the like in the
parameters a person reads, as each `Parameter` states.
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
from airswing.synthetic.sealed.draws import Draw

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Scope = Literal["aircraft", "fleet", "reference", "pair"]
Kind = Literal["mean", "step", "drift", "swap", "second_moment"]
Stage = Literal["identity", "atmosphere", "sensor", "report"]
Parameters = dict[str, object]  # as a person or a file gives them
Stated = dict[str, Value]  # as the diagnosis tells them
Errors = dict[str, float]

LEAST_SPREAD = 2e-3
"""One minus the mean resultant of headings: below it (about 4 degrees) they are one heading."""
SPREAD = 1e-9
"""A context quantity that varies by less than this does not vary."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect as a person reads it."""

    name: str  # name, with the unit at its end
    units: str  # unit, in words of the config ("degree", "percent", "kt")
    scale: float  # a plausible size, used as prior standard deviation
    description: str  # what it is and which sign means what
    default: float | None = 0.0  # value where none is given
    required: bool = False  # it must be given
    si: float = 1.0  # what one unit is in radians or SI
    number: bool = True  # false for a parameter that is no number (the pair of a swap)


@dataclass(frozen=True)
class ActiveEffect:
    """An effect at work: which, on whom, when, how much."""

    name: str  # name in the catalogue
    # values in the catalogue's units
    parameters: Mapping[str, object] = field(default_factory=dict)
    tails: tuple[str, ...] | None = None  # aircraft it acts on; None for all
    # (start, end): s since 1970, either may be None; None for always
    period: tuple[float | None, float | None] | None = None


def number(value: object) -> float:
    """Return the value of a parameter that is a number.

    Raises
    ------
    TypeError
        If it is none.
    """
    if isinstance(value, str | SupportsFloat):
        return float(value)
    raise TypeError(f"{value!r} is no number")


@dataclass(frozen=True)
class State:
    """A simulated measurement under way, arrays over the ``n`` reports of a frame."""

    airframe: IntArray  # (n,): which aircraft physically flew the report
    # wind_u, wind_v: (n,): wind the aircraft met, m s-1
    wind_u: FloatArray
    wind_v: FloatArray
    heading_error: FloatArray  # (n,): indicated minus true heading, rad
    airspeed: FloatArray  # (n,): indicated true airspeed, m s-1
    # report_u, report_v: (n,): wind as sent, m s-1; set once the sensors are done
    report_u: FloatArray
    report_v: FloatArray
    # latitude, longitude: (n,): position as sent, degrees
    latitude: FloatArray
    longitude: FloatArray


class Effect(ABC):
    """One physical reason why a report parts from the reference; see the class attributes."""

    name: ClassVar[str]  # name in the catalogue
    # physics, source: what happens, and who says so
    physics: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]  # what a person states about it
    # {"aircraft", "fleet", "reference", "pair"}; whom it strikes together
    scope: ClassVar[Scope] = "aircraft"
    # {"mean", "step", "drift", "swap", "second_moment"}; how it shows
    kind: ClassVar[Kind] = "mean"
    # {"identity", "atmosphere", "sensor", "report"}; where in the measurement it acts
    stage: ClassVar[Stage] = "sensor"
    # fields of the frame that must be known and vary for it to be seen
    needs: ClassVar[tuple[str, ...]] = ()
    # which others look like it and when (hints; the Gram matrix decides on an archive)
    confused_with: ClassVar[tuple[str, ...]] = ()
    # names of the linear coefficients, in the order of `columns`
    column_names: ClassVar[tuple[str, ...]] = ()
    # sets of columns that make one candidate each; empty: all columns together
    alternatives: ClassVar[tuple[tuple[int, ...], ...]] = ()
    # part of the effect's energy that its columns carry: a little less than 1, for the heading in
    # turns is that of chords; less where more of the context is inferred (bank, acceleration)
    reliability: ClassVar[float] = 0.99
    # what it is, in plain words; the name with its underscores gone where not given
    title: ClassVar[str] = ""
    # other effect -> the data that would tell the two apart
    distinguished_by: ClassVar[Mapping[str, str]] = {}
    # it is the deviation that the product corrects, or a change of it
    deviates: ClassVar[bool] = False
    draw: ClassVar[Draw | None] = None  # how the blind check draws it; None leaves it out

    @property
    @abstractmethod
    def column_scales(self) -> FloatArray:
        """Prior standard deviation of each coefficient, (k,)."""

    @abstractmethod
    def columns(self, frame: Frame) -> FloatArray:
        """Return the derivative of the reported wind by each coefficient, at zero effect.

        Parameters
        ----------
        frame : Frame
            Reports, with INDICATED heading and airspeed.

        Returns
        -------
        ndarray (k, n, 2)
            Eastward and northward component, m s-1 per unit of the coefficient.
        """

    def tied(self, subset: tuple[int, ...]) -> FloatArray:
        """Return how the coefficients of an alternative (k) follow from its free ones (m), (k, m).

        Parameters
        ----------
        subset : tuple of int
            One of :attr:`alternatives`.
        """
        return np.eye(len(subset))

    def softened_columns(self, frame: Frame, shifts: FloatArray) -> FloatArray:
        """Return the columns' mean over shifts of ln p, which softens edges in pressure.

        Parameters
        ----------
        shifts : ndarray (m,)
            Shifts of ln p.

        Returns
        -------
        ndarray (k, n, 2)
        """
        moved = [replace(frame, pressure=frame.pressure * np.exp(shift)) for shift in shifts]
        return np.asarray(sum(self.columns(one) for one in moved) / shifts.size)

    @abstractmethod
    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """Transform every report exactly (the simulation picks whom and when).

        Parameters
        ----------
        frame : Frame
            Context; heading and airspeed in it are the simulated indicated ones.
        values : dict
            Complete parameters in the catalogue's units.
        rng : numpy.random.Generator
            For effects that draw.
        """

    @abstractmethod
    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """Return parameters in the catalogue's units, standard errors by the delta method.

        Parameters
        ----------
        coefficients : ndarray (k,)
            rad and SI.
        covariance : ndarray (k, k)
            Their covariance.
        frame : Frame
            For constants of the archive.

        Returns
        -------
        parameters, standard_errors : dict, dict
        """

    @abstractmethod
    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """Coefficients (k,) of parameters: the inverse of `to_parameters`."""

    def testable(self, frame: Frame) -> str | None:
        """Say why the effect cannot be looked for in these reports; None where it can."""
        for name in self.needs:
            reason = missing_context(frame, name)
            if reason is not None:
                return reason
        return None

    def acts(self, frame: Frame) -> NDArray[np.bool_] | None:
        """Say on which reports (n,) it acts by its nature; None: wherever its columns are not 0.

        The rms of an effect, its practical size, is over these reports. Columns may be other than
        zero elsewhere: the last of a turn, the levelling off after a climb.
        """
        return None

    def complete(self, values: Mapping[str, object]) -> Parameters:
        """Parameters with defaults filled in.

        Raises
        ------
        InputError
            A parameter is unknown or a required one absent.
        """
        known = {p.name: p for p in self.parameters}
        for name in values:
            if name not in known:
                raise InputError(
                    f"effect {self.name} has no parameter {name}",
                    field=name,
                    remedy=f"it takes {', '.join(known)}",
                )
        for parameter in self.parameters:
            if parameter.required and values.get(parameter.name) is None:
                raise InputError(
                    f"effect {self.name} needs a value of {parameter.name}", field=parameter.name
                )
        return {p.name: p.default for p in self.parameters} | dict(values)


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
    """Say why a field of the frame is not known anywhere; None where it is known somewhere."""
    if _known_values(frame, name).size == 0:
        return _ABSENT.get(name, f"no {name.replace('_', ' ')}")
    return None


def missing_context(frame: Frame, name: str) -> str | None:
    """Say why a field of the frame cannot carry an effect; None where it is known and varies."""
    reason = absent_context(frame, name)
    if reason is not None:
        return reason
    there = _known_values(frame, name)
    if name in {"heading", "magnetic_heading"}:
        varies = 1.0 - np.hypot(np.mean(np.cos(there)), np.mean(np.sin(there))) > LEAST_SPREAD
    else:
        varies = float(np.ptp(there)) > SPREAD * max(1e-6, float(np.max(np.abs(there))))
    if not varies:
        return _CONSTANT.get(name, f"{name.replace('_', ' ')} does not vary in these reports")
    return None


def _known_values(frame: Frame, name: str) -> FloatArray:
    values = np.asarray(getattr(frame, name), dtype=np.float64)
    return values[values >= 0.0] if name == "icing" else values[np.isfinite(values)]


CATALOGUE: dict[str, Effect] = {}
"""Every known effect by name, in alphabetical order of its files, then in order of registration."""


def register(effect: Effect) -> Effect:
    """Put an effect into the catalogue.

    Parameters
    ----------
    effect : Effect
        An instance; its name must be new.

    Raises
    ------
    ValueError
        Another effect holds the name.
    """
    if CATALOGUE.get(effect.name, effect) is not effect:
        raise ValueError(f"an effect named {effect.name} is already in the catalogue")
    CATALOGUE[effect.name] = effect
    return effect


def unregister(name: str) -> Effect:
    """Take an effect out of the catalogue and return it (for leave-one-effect-out checks)."""
    return CATALOGUE.pop(name)


def discover(package: str) -> None:
    """Register the ``EFFECT`` of every module of a package, in alphabetical order."""
    folder = importlib.import_module(package)
    for found in sorted(pkgutil.iter_modules(folder.__path__), key=lambda module: module.name):
        module = importlib.import_module(f"{package}.{found.name}")
        effect = getattr(module, "EFFECT", None)
        if isinstance(effect, Effect):
            register(effect)
