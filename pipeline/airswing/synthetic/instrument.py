"""The unit on board: flux valve, airspeed, the wind it computes, and its faults.

Assumptions
-----------
The flux valve is a vector instrument. The earth's field (H, declination, Z) is turned into the
airframe by the true magnetic heading, distorted by soft iron (a matrix) and hard iron (a constant
vector), then seen in the plane of a pendulous sensing element along the apparent vertical:
acceleration or bank tilts the plane and admits the vertical field. Indicated heading = angle of
the sensed vector + misalignment + the declination stored in the unit. Wind = GPS ground velocity -
indicated airspeed along the indicated heading. No formula of a deviation curve is used: curves
follow from the vectors. Heading error = indicated - true; with hard iron p,
sin(error) = -(p_f sin m + p_r cos m) / H exactly, m the indicated magnetic heading.

A fault is a mapping ``{"name", "tails", "parameters", "period"}``: ``tails`` null or ``all`` for
the whole fleet, ``period`` null or ``[start, end]`` in ISO 8601 (either may be null). Names and
parameters are those of the catalogue of effects; ``heading_by_temperature``, ``three_cycle`` and
``outside`` (`airswing.synthetic.outside_effects`) are in no catalogue.

* One and two cycles: error = amplitude sin(m + phase); hard iron is stated at
  ``at_horizontal_field_nT`` (by default the median H of the reports).
* ``acceleration_error``: amplitude of sin(m) at 1 g along the heading and 45 degrees of dip;
  ``turn_error``: amplitude of cos(m) at one radian of bank and 45 degrees of dip. A freely hanging
  sensor has -57.3 degrees of both. With ``by_phase`` acceleration acts by phase, as at 0.03 g.
* ``heater_current`` with ``between_degC`` acts by temperature instead of icing protection.
* ``wind_coding``: ``step`` in kt and ``direction_step_deg``; ``position_coding``: ``step`` in
  arc-minutes.
* ``reference_grid_relative``: ``fraction`` 1 omits the rotation, -1 makes it once too often.
* ``declination_error``: the table of ``epoch_year``, or ``factor`` times the declination, scaled to
  a mean of ``mean_deg`` over the reports where that is given.

Units: degrees in the mappings, radians inside, nT, SI otherwise. Body axes forward, right, down.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import SupportsFloat

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.synthetic.atmosphere import Array
from airswing.synthetic.earth_field import declination_of_year
from airswing.synthetic.fields import ReferenceChange

Mask = NDArray[np.bool_]
_G = 9.80665  # standard gravity, m/s2
_CLIMB_ACCELERATION = 0.03  # g that an error by phase assumes in a climb


def number(value: object) -> float:
    """A parameter as a number; TypeError or ValueError if it is none."""
    if isinstance(value, str | SupportsFloat):
        return float(value)
    raise TypeError(f"{value!r} is no number")


def listed(value: object) -> list[object]:
    """A parameter of several values; TypeError if it is a single one."""
    if isinstance(value, Iterable):
        return list(value)
    raise TypeError(f"{value!r} is no list")


@dataclass
class Unit:
    """State of the unit at every report; every field broadcasts to (n,)."""

    hard_forward: Array  # hard iron and heater currents along the body axes, nT
    hard_right: Array
    soft_sine: Array  # symmetric traceless soft iron: the matrix [[1 - s, -c], [-c, 1 + s]]
    soft_cosine: Array
    rotation: Array  # misalignment and other errors that add to the heading, radians
    third_sine: Array  # three-cycle error of the valve's windings, radians
    third_cosine: Array
    tilt_forward: Array  # tilt of the sensing plane, forward or right side down, radians
    tilt_right: Array
    airspeed_factor: Array  # indicated = factor x true + offset (m/s)
    airspeed_offset: Array

    @classmethod
    def perfect(cls, reports: int) -> Unit:
        """A unit without errors."""
        unit = cls(*(np.zeros(reports) for _ in cls.__dataclass_fields__))
        unit.airspeed_factor = np.ones(reports)
        return unit


def sensed_heading(magnetic: Array, horizontal: Array, down: Array, unit: Unit) -> Array:
    """Indicated magnetic heading, radians.

    Parameters
    ----------
    magnetic : array, shape (n,)
        True magnetic heading, radians.
    horizontal, down : array, shape (n,)
        The earth's field H and Z, nT.

    Notes
    -----
    Archibald Smith's equations as in the Admiralty Manual; northerly turning error = tan(dip)
    tan(bank) at north.
    """
    level_forward = horizontal * np.cos(magnetic)
    level_right = -horizontal * np.sin(magnetic)
    forward = (1.0 - unit.soft_sine) * level_forward - unit.soft_cosine * level_right
    right = -unit.soft_cosine * level_forward + (1.0 + unit.soft_sine) * level_right
    forward = forward + unit.hard_forward
    right = right + unit.hard_right
    sensed_forward = forward * np.cos(unit.tilt_forward) + down * np.sin(unit.tilt_forward)
    below = down * np.cos(unit.tilt_forward) - forward * np.sin(unit.tilt_forward)
    sensed_right = right * np.cos(unit.tilt_right) + below * np.sin(unit.tilt_right)
    valve = np.arctan2(-sensed_right, sensed_forward)
    winding = unit.third_sine * np.sin(3 * valve) + unit.third_cosine * np.cos(3 * valve)
    return np.asarray(valve + winding + unit.rotation)


def compute_wind(
    ground_east: Array, ground_north: Array, airspeed: Array, heading: Array
) -> tuple[Array, Array]:
    """Wind (m/s) of ground velocity minus airspeed along the true heading (radians)."""
    return (
        ground_east - airspeed * np.sin(heading),
        ground_north - airspeed * np.cos(heading),
    )


def coded(
    eastward: Array, northward: Array, *, direction_step: Array, speed_step: Array
) -> tuple[Array, Array]:
    """Wind (m/s) in whole steps of direction (degrees) and speed (kt).

    Returns
    -------
    direction, speed : array, shape (n,)
        Degrees from which the wind blows, (0, 360], 0 for a calm; kt.
    """
    speed = np.hypot(eastward, northward) * 3600.0 / 1852.0
    direction = np.degrees(np.arctan2(-eastward, -northward)) % 360.0
    whole = np.round(np.round(direction / direction_step) * direction_step, 9) % 360.0
    strength = np.round(np.round(speed / speed_step) * speed_step, 9)
    return np.where(strength == 0, 0.0, np.where(whole == 0, 360.0, whole)), strength


def deviation_curve(horizontal: float, down: float, unit: Unit) -> dict[str, float]:
    """Coefficients of a unit's heading error against indicated magnetic heading.

    Parameters
    ----------
    horizontal, down : float
        The earth's field, nT.
    unit : Unit
        Of length 1.

    Returns
    -------
    dict
        A to E, degrees, by least squares over evenly spread headings, and ``residual_rms``.
    """
    true = np.linspace(0.0, 2 * np.pi, 7200, endpoint=False)
    indicated = sensed_heading(true, np.full(7200, horizontal), np.full(7200, down), unit)
    error = np.pi - (np.pi - (indicated - true)) % (2 * np.pi)
    even = np.radians(np.arange(0.0, 360.0, 0.5))
    turned = indicated % (2 * np.pi)
    order = np.argsort(turned)
    curve = np.degrees(np.interp(even, turned[order], error[order], period=2 * np.pi))
    waves = [np.ones(720), np.sin(even), np.cos(even), np.sin(2 * even), np.cos(2 * even)]
    basis = np.stack(waves, axis=1)
    values = np.linalg.lstsq(basis, curve, rcond=None)[0]
    found = {name: float(value) for name, value in zip("ABCDE", values, strict=True)}
    return found | {"residual_rms": float(np.sqrt(np.mean((curve - basis @ values) ** 2)))}


@dataclass(frozen=True)
class Fault:
    """One fault, see the module docstring."""

    name: str
    tails: tuple[str, ...] | None  # None for all
    parameters: Mapping[str, object]
    period: tuple[float, float]  # hours since the start of the archive; infinite where open

    def value(self, key: str, default: float = 0.0) -> float:
        """One parameter as a number, or the default."""
        found = self.given(key)
        return default if found is None else found

    def given(self, key: str) -> float | None:
        """One parameter as a number; None where it is absent."""
        found = self.parameters.get(key)
        return None if found is None else number(found)

    def cycle(self) -> tuple[float, float]:
        """Sine and cosine coefficient of the cycle, radians."""
        size, phase = np.radians(self.value("amplitude_deg")), np.radians(self.value("phase_deg"))
        return float(size * np.cos(phase)), float(size * np.sin(phase))


@dataclass
class Setting:
    """Surroundings of the unit at every report, each (n,), and the effect of faults."""

    tail: NDArray[np.int64]  # index of the aircraft
    hours: Array
    latitude: Array  # degrees
    longitude: Array
    altitude: Array  # m
    magnetic: Array  # true magnetic heading, radians
    declination: Array  # radians
    horizontal: Array  # H, nT
    down: Array  # Z, nT
    acceleration: Array  # along the heading, m s-2
    bank: Array  # radians
    temperature: Array  # K
    icing: Mask  # icing protection is on
    phase: NDArray[np.int64]  # 1 ascent, 2 cruise, 3 descent
    box: tuple[float, float, float, float]  # south, north, west, east, degrees
    unit: Unit = field(init=False)
    usual_field: float = field(init=False)  # nT; hard iron is stated there
    declination_error: Array = field(init=False)

    def __post_init__(self) -> None:
        """Start from a perfect unit."""
        self.unit = Unit.perfect(self.hours.size)
        self.declination_error = np.zeros(self.hours.size)
        self.usual_field = float(np.median(self.horizontal))


def _offset(setting: Setting, fault: Fault, where: Mask) -> None:
    setting.unit.rotation[where] += np.radians(fault.value("offset_deg"))


def _hard_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    sine, cosine = fault.cycle()
    strength = fault.value("at_horizontal_field_nT", setting.usual_field)
    setting.unit.hard_forward[where] -= strength * sine
    setting.unit.hard_right[where] -= strength * cosine


def _soft_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    sine, cosine = fault.cycle()
    setting.unit.soft_sine[where] += sine
    setting.unit.soft_cosine[where] += cosine


def _offset_and_hard_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    _offset(setting, fault, where)
    _hard_iron(setting, fault, where)


def _drift(setting: Setting, fault: Fault, where: Mask) -> None:
    since = max(fault.period[0], float(setting.hours.min()))
    days = (setting.hours[where] - since) / 24.0
    setting.unit.rotation[where] += np.radians(fault.value("rate_deg_per_day")) * days + np.radians(
        fault.value("offset_deg")
    )


def _heater(setting: Setting, fault: Fault, where: Mask) -> None:
    if fault.parameters.get("between_degC") is None:
        on = setting.icing
    else:
        low, high = (number(edge) + 273.15 for edge in listed(fault.parameters["between_degC"]))
        on = (setting.temperature >= low) & (setting.temperature < high)
    _offset_and_hard_iron(setting, fault, where & on)


def _acceleration(setting: Setting, fault: Fault, where: Mask) -> None:
    gain = np.radians(fault.value("amplitude_deg"))
    speeding = setting.acceleration / _G
    if fault.parameters.get("by_phase"):
        speeding = _CLIMB_ACCELERATION * np.select(
            [setting.phase == 1, setting.phase == 3], [1.0, -1.0], 0.0
        )
    setting.unit.tilt_forward[where] -= gain * speeding[where]


def _turn(setting: Setting, fault: Fault, where: Mask) -> None:
    gain = np.radians(fault.value("amplitude_deg"))
    setting.unit.tilt_right[where] -= gain * setting.bank[where]


def _declination(setting: Setting, fault: Fault, where: Mask) -> None:
    if fault.parameters.get("factor") is not None:
        error = (fault.value("factor") - 1.0) * setting.declination
    else:
        year = fault.value("epoch_year", 1995.0)
        old = declination_of_year(setting.latitude, setting.longitude, year, setting.box)
        error = old - setting.declination
    if fault.parameters.get("mean_deg") is not None:
        error = error * np.radians(fault.value("mean_deg")) / np.mean(error)
    setting.declination_error[where] += error[where]


def _tas_scale(setting: Setting, fault: Fault, where: Mask) -> None:
    setting.unit.airspeed_factor[where] *= 1.0 + fault.value("scale_percent") / 100.0


def _tas_offset(setting: Setting, fault: Fault, where: Mask) -> None:
    setting.unit.airspeed_offset[where] += fault.value("offset_m_s")


def _by_temperature(setting: Setting, fault: Fault, where: Mask) -> None:
    cold = (setting.temperature[where] - 260.0) / 15.0
    setting.unit.rotation[where] += np.radians(fault.value("amplitude_deg")) * cold


def _three_cycle(setting: Setting, fault: Fault, where: Mask) -> None:
    sine, cosine = fault.cycle()
    setting.unit.third_sine[where] += sine
    setting.unit.third_cosine[where] += cosine


UNIT_FAULTS: dict[str, Callable[[Setting, Fault, Mask], None]] = {
    "compass_offset": _offset,
    "hard_iron": _hard_iron,
    "soft_iron": _soft_iron,
    "compass_step": _offset_and_hard_iron,
    "compass_drift": _drift,
    "heater_current": _heater,
    "acceleration_error": _acceleration,
    "turn_error": _turn,
    "declination_error": _declination,
    "tas_scale": _tas_scale,
    "tas_offset": _tas_offset,
    "heading_by_temperature": _by_temperature,
    "three_cycle": _three_cycle,
}
"""Faults of the unit itself."""
_OTHER_FAULTS = (
    "reference_speed_bias",
    "reference_time_offset",
    "reference_grid_relative",
    "altitude_offset",
    "time_lag",
    "tail_swap",
    "wind_coding",
    "position_coding",
    "heading_coding",
    "outliers",
    "outside",
)


def parse_faults(
    effects: Sequence[Mapping[str, object]], *, start: datetime, tails: Sequence[str]
) -> list[Fault]:
    """Mappings as faults, in the order given.

    Parameters
    ----------
    start : datetime
        Hour zero, UTC.
    tails : sequence of str
        The fleet.

    Raises
    ------
    InputError
        If a name or an aircraft is unknown.
    """
    known = {*UNIT_FAULTS, *_OTHER_FAULTS}
    found = []
    for effect in effects:
        name = str(effect.get("name"))
        if name not in known:
            raise InputError(
                "unknown effect", field="name", found=name, remedy=f"one of {sorted(known)}"
            )
        who = effect.get("tails")
        chosen = None if who is None or who == "all" else listed(who)
        missing = [tail for tail in chosen or () if tail not in tails]
        if missing:
            raise InputError("unknown aircraft", field="tails", found=str(missing))
        when = effect.get("period") or (None, None)
        period = [when, None] if isinstance(when, str) else listed(when)
        parameters = effect.get("parameters") or {}
        if not isinstance(parameters, Mapping):
            raise TypeError(f"{parameters!r} are no parameters")
        found.append(
            Fault(
                name,
                None if chosen is None else tuple(str(tail) for tail in chosen),
                parameters,
                (_hours(period[0], start, -np.inf), _hours(period[1], start, np.inf)),
            )
        )
    return found


def _hours(text: object, start: datetime, otherwise: float) -> float:
    """An ISO time as hours since the start."""
    if text is None:
        return otherwise
    when = text if isinstance(text, datetime) else datetime.fromisoformat(str(text))
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when
    return (when - start.replace(tzinfo=UTC)).total_seconds() / 3600.0


def acts(fault: Fault, tail: NDArray[np.int64], hours: Array, tails: Sequence[str]) -> Mask:
    """Whether a fault acts on a report: its aircraft, its period."""
    where = (hours >= fault.period[0]) & (hours < fault.period[1])
    if fault.tails is not None:
        where &= np.isin(tail, [list(tails).index(name) for name in fault.tails])
    return where


def apply_unit_faults(setting: Setting, faults: Sequence[Fault], tails: Sequence[str]) -> None:
    """Put every fault of the unit into the setting, in order; other faults are ignored."""
    for fault in faults:
        if fault.name in UNIT_FAULTS:
            where = acts(fault, setting.tail, setting.hours, tails)
            UNIT_FAULTS[fault.name](setting, fault, where)


def reference_changes(faults: Sequence[Fault], names: Sequence[str]) -> dict[str, ReferenceChange]:
    """Changes of each model, by name; a fault with ``references`` acts on those alone."""
    found = {}
    for name in names:
        change = ReferenceChange()
        for fault in faults:
            chosen = fault.parameters.get("references") or names
            if isinstance(chosen, Container) and name not in chosen:
                continue
            if fault.name == "reference_speed_bias":
                change = replace(
                    change,
                    speed_percent=fault.value("bias_percent"),
                    above_hpa=fault.given("above_hPa"),
                    below_hpa=fault.given("below_hPa"),
                )
            elif fault.name == "reference_time_offset":
                change = replace(change, offset_hours=fault.value("offset_h"))
            elif fault.name == "reference_grid_relative":
                change = replace(change, unrotated=fault.value("fraction", 1.0))
        found[name] = change
    return found
