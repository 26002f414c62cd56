"""Faults a unit, a fleet or a reference can have, as plain lists of names and numbers.

A fault is a mapping ``{"name", "tails", "parameters", "period"}``: ``tails`` null or ``all`` for
the whole fleet, ``period`` null or ``[start, end]`` in ISO 8601 (either may be null). Names and
parameters are those of the published catalogue of effects, but each is realised here by physics
of the vector instrument (`airswing.synthetic.aircraft.instrument`), not by a formula for the curve
it makes.
``heading_by_temperature``, ``three_cycle`` and ``outside`` are in no catalogue.

Assumptions and stated scales
-----------------------------
* one and two cycles: error = amplitude sin(m + phase), m the indicated magnetic heading; hard
  iron is stated at ``at_horizontal_field_nT`` (the reports' median H by default);
* ``acceleration_error``: amplitude of sin(m) at 1 g along the heading and 45 degrees of dip,
  ``turn_error``: amplitude of cos(m) at one radian of bank and 45 degrees of dip; a freely hanging
  sensor has -57.3 degrees of both;
* ``heater_current`` with ``between_degC`` acts by temperature, ``acceleration_error`` with
  ``by_phase`` by phase (+ in climb, - in descent, as at 0.03 g);
* ``outside`` moves any component of the wind by any variables
  (`airswing.synthetic.aircraft.outside_effects`);
* ``wind_coding``: ``step`` in kt and ``direction_step_deg``; ``position_coding``: ``step`` in
  arc-minutes;
* ``reference_grid_relative``: ``fraction`` 1 leaves the rotation out, -1 makes it once too often;
* ``declination_error``: the table of ``epoch_year``, or ``factor`` times the declination, scaled
  to a mean of ``mean_deg`` over the reports where that is given.

Units: degrees in the mappings, radians inside, SI otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.synthetic.aircraft.instrument import Unit
from airswing.synthetic.aircraft.parameter_values import listed, number
from airswing.synthetic.world.earthfield import declination_of_year
from airswing.synthetic.world.gridded_fields import ReferenceChange

__all__ = ["UNIT_FAULTS", "Fault", "Setting", "apply_unit_faults", "parse_faults"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# m/s2, standard gravity.
_G = 9.80665
# What an error by phase takes for the acceleration of a climb, in units of gravity.
_USUAL_ACCELERATION = 0.03


@dataclass(frozen=True)
class Fault:
    """One fault: see the module docstring."""

    name: str  # what
    tails: tuple[str, ...] | None  # who; None for all
    parameters: Mapping[str, object]  # how much
    period: tuple[float, float]  # hours since the archive's start; infinite where open

    def value(self, key: str, default: float = 0.0) -> float:
        """Return one parameter as a number."""
        found = self.given(key)
        return default if found is None else found

    def given(self, key: str) -> float | None:
        """Return one parameter as a number; None where it is left open."""
        found = self.parameters.get(key)
        return None if found is None else number(found)

    def cycle(self) -> tuple[float, float]:
        """Return sine and cosine coefficient of the fault's cycle in radians."""
        size, phase = np.radians(self.value("amplitude_deg")), np.radians(self.value("phase_deg"))
        return float(size * np.cos(phase)), float(size * np.sin(phase))


@dataclass
class Setting:
    """What surrounds the unit at every report, each (n,), and what faults change there."""

    tail: NDArray[np.int64]  # aircraft index
    # hours, latitude, longitude, altitude: hours since the start, degrees, m
    hours: Array
    latitude: Array
    longitude: Array
    altitude: Array
    # magnetic, declination, horizontal, down: true magnetic heading and declination (radians), H
    # and Z (nT)
    magnetic: Array
    declination: Array
    horizontal: Array
    down: Array
    # acceleration, bank, temperature: along the heading (m s-2), radians, K
    acceleration: Array
    bank: Array
    temperature: Array
    icing: Mask  # icing protection is on
    phase: NDArray[np.int64]  # 1 ascent, 2 cruise, 3 descent
    box: tuple[float, float, float, float]  # south, north, west, east in degrees
    unit: Unit = field(init=False)
    # H (nT) at which hard iron turns the compass by its stated amplitude where the fault names no
    # field: the median of `horizontal`
    usual_field: float = field(init=False)
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
    field_ = fault.value("at_horizontal_field_nT", setting.usual_field)
    setting.unit.hard_forward[where] -= field_ * sine
    setting.unit.hard_right[where] -= field_ * cosine


def _soft_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    sine, cosine = fault.cycle()
    setting.unit.soft_sine[where] += sine
    setting.unit.soft_cosine[where] += cosine


def _both(setting: Setting, fault: Fault, where: Mask) -> None:
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
    _both(setting, fault, where & on)


def _acceleration(setting: Setting, fault: Fault, where: Mask) -> None:
    gain = np.radians(fault.value("amplitude_deg"))
    speeding = setting.acceleration / _G
    if fault.parameters.get("by_phase"):
        speeding = _USUAL_ACCELERATION * np.select(
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


# Faults of the unit itself.
UNIT_FAULTS: dict[str, Callable[[Setting, Fault, Mask], None]] = {
    "compass_offset": _offset,
    "hard_iron": _hard_iron,
    "soft_iron": _soft_iron,
    "compass_step": _both,
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

_REFERENCE = ("reference_speed_bias", "reference_time_offset", "reference_grid_relative")
_REPORTING = (
    "altitude_offset",
    "time_lag",
    "tail_swap",
    "wind_coding",
    "position_coding",
    "heading_coding",
    "outliers",
    "outside",
)


def _hours(text: object, start: datetime, otherwise: float) -> float:
    """Return an ISO time as hours since the start."""
    if text is None:
        return otherwise
    when = text if isinstance(text, datetime) else datetime.fromisoformat(str(text))
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when
    return (when - start.replace(tzinfo=UTC)).total_seconds() / 3600.0


def parse_faults(
    effects: Sequence[Mapping[str, object]], *, start: datetime, tails: Sequence[str]
) -> list[Fault]:
    """Return a list of mappings as faults.

    Parameters
    ----------
    effects : sequence of mapping
        See the module docstring.
    start : datetime
        Start of the archive, UTC.

    Returns
    -------
    list of Fault
        In the order given.

    Raises
    ------
    InputError
        Where a name or a tail is unknown.
    """
    known = {*UNIT_FAULTS, *_REFERENCE, *_REPORTING}
    out = []
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
        how_much = effect.get("parameters") or {}
        if not isinstance(how_much, Mapping):
            raise TypeError(f"{how_much!r} are no parameters")
        out.append(
            Fault(
                name=name,
                tails=None if chosen is None else tuple(str(tail) for tail in chosen),
                parameters=how_much,
                period=(_hours(period[0], start, -np.inf), _hours(period[1], start, np.inf)),
            )
        )
    return out


def acts(fault: Fault, tail: NDArray[np.int64], hours: Array, tails: Sequence[str]) -> Mask:
    """Return where a fault acts: its aircraft, its period."""
    where = (hours >= fault.period[0]) & (hours < fault.period[1])
    if fault.tails is not None:
        where &= np.isin(tail, [list(tails).index(name) for name in fault.tails])
    return where


def apply_unit_faults(setting: Setting, faults: Sequence[Fault], tails: Sequence[str]) -> None:
    """Put every fault of the unit into the setting, in order.

    Parameters
    ----------
    setting : Setting
        Changed in place.
    faults : sequence of Fault
        Others than the unit's are passed over.
    """
    for fault in faults:
        if fault.name in UNIT_FAULTS:
            where = acts(fault, setting.tail, setting.hours, tails)
            UNIT_FAULTS[fault.name](setting, fault, where)


def reference_changes(faults: Sequence[Fault], names: Sequence[str]) -> dict[str, ReferenceChange]:
    """Return what the faults do to each reference.

    Parameters
    ----------
    faults : sequence of Fault
        A fault with the parameter ``references`` acts on those alone.

    Returns
    -------
    dict of ReferenceChange
        By name.
    """
    out = {}
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
        out[name] = change
    return out
