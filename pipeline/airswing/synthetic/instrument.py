"""The unit on board: flux valve, airspeed, the wind it computes, its faults; the earth's field.

The flux valve is a vector instrument. The earth's field (H, declination, Z) is turned into the
airframe by the true magnetic heading, distorted by soft iron (a matrix) and hard iron (a constant
vector), then projected on the plane of a pendulous sensing element normal to the apparent vertical:
acceleration or bank tilts the plane and admits the vertical field. Indicated heading = angle of the
sensed vector + misalignment + the declination stored in the unit. Wind = GPS ground velocity -
indicated airspeed along the indicated heading. No formula of a deviation curve is used: curves
follow from the vectors. Heading error = indicated - true; with hard iron p, sin(error) = -(p_f sin
m + p_r cos m) / H exactly, m the indicated magnetic heading.

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

import contextlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import ppigrf
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from airswing.errors import InputError
from airswing.synthetic.atmosphere import Array
from airswing.synthetic.fields import ReferenceChange

Mask = NDArray[np.bool_]
_G = 9.80665  # standard gravity, m/s2
_CLIMB_ACCELERATION = 0.03  # g that an error by phase assumes in a climb


_LATTICE = 1.5  # degrees
# The field falls by 0.05 % a kilometre: one height serves climb and cruise.
_HEIGHT_KM = 4.0


class EarthField:
    """The earth's field over a region (south, north, west, east, degrees) and some days, from IGRF.

    Linear in time, bilinear on a lattice; apart from the package's, so that the truth of the
    archives is independent of it.
    """

    def __init__(
        self, start: datetime, days: float, box: tuple[float, float, float, float]
    ) -> None:
        self.days, self.box = days, box
        south, north, west, east = box
        lat = np.arange(np.floor(south) - 1, north + 1 + _LATTICE, _LATTICE)
        lon = np.arange(np.floor(west) - 1, east + 1 + _LATTICE, _LATTICE)
        columns, rows = np.meshgrid(lon, lat)
        ends = []
        for span in (0.0, days):
            when = start + timedelta(days=span)
            with contextlib.redirect_stdout(io.StringIO()):
                parts = ppigrf.igrf(columns.ravel(), rows.ravel(), _HEIGHT_KM, when)
            east_, north_, up = (np.asarray(component).reshape(rows.shape) for component in parts)
            ends.append(np.stack([east_, north_, -up], axis=-1))
        self._first = RegularGridInterpolator((lat, lon), ends[0])
        self._change = RegularGridInterpolator((lat, lon), ends[1] - ends[0])

    def at(self, latitude: Array, longitude: Array, hours: Array) -> tuple[Array, Array, Array]:
        """Declination (radians, east positive), H and Z (nT) at points (n,)."""
        points = np.stack([latitude, longitude], axis=-1)
        share = (hours / (24.0 * self.days))[:, None]
        east, north, down = (self._first(points) + share * self._change(points)).T
        return np.arctan2(east, north), np.hypot(east, north), down


def declination_of_year(
    latitude: Array, longitude: Array, year: float, box: tuple[float, float, float, float]
) -> Array:
    """Declination (radians) of a table of some epoch, at points in degrees inside a box."""
    when = datetime(int(year), 1, 1) + timedelta(days=365.25 * (year - int(year)))
    return EarthField(when, 1.0, box).at(latitude, longitude, np.zeros_like(latitude))[0]


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
    """Indicated magnetic heading, radians, in the earth's field ``horizontal``, ``down`` (nT).

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
    """Direction (degrees, (0, 360], 0 for a calm) and speed (kt) of a wind (m/s), in steps."""
    speed = np.hypot(eastward, northward) * 3600.0 / 1852.0
    direction = np.degrees(np.arctan2(-eastward, -northward)) % 360.0
    degrees = np.round(np.round(direction / direction_step) * direction_step, 9) % 360.0
    strength = np.round(np.round(speed / speed_step) * speed_step, 9)
    return np.where(strength == 0, 0.0, np.where(degrees == 0, 360.0, degrees)), strength


def deviation_curve(horizontal: float, down: float, unit: Unit) -> dict[str, float]:
    """Coefficients A to E (degrees) of a unit's heading error against indicated magnetic heading.

    By least squares over evenly spread headings, with ``residual_rms``; the unit is of length 1.
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
    coefficients = {name: float(value) for name, value in zip("ABCDE", values, strict=True)}
    return coefficients | {"residual_rms": float(np.sqrt(np.mean((curve - basis @ values) ** 2)))}


@dataclass(frozen=True)
class Fault:
    """One fault, see the module docstring."""

    name: str
    tails: tuple[str, ...] | None  # None for all
    parameters: Mapping[str, Any]
    period: tuple[float, float]  # hours since the start of the archive; infinite where open

    def value(self, key: str, default: float = 0.0) -> float:
        """One parameter as a number, or the default."""
        number = self.optional(key)
        return default if number is None else number

    def optional(self, key: str) -> float | None:
        """One parameter as a number; None where it is absent."""
        number = self.parameters.get(key)
        return None if number is None else float(number)

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


UnitFault = Callable[[Setting, Fault, Mask], None]
"""Puts a fault into a setting, where it acts."""


def _adds(quantity: str, parameter: str, unit: float = 1.0) -> UnitFault:
    def add(setting: Setting, fault: Fault, where: Mask) -> None:
        getattr(setting.unit, quantity)[where] += unit * fault.value(parameter)

    return add


def _adds_cycle(name: str) -> UnitFault:
    def add(setting: Setting, fault: Fault, where: Mask) -> None:
        for axis, size in zip(("sine", "cosine"), fault.cycle(), strict=True):
            getattr(setting.unit, f"{name}_{axis}")[where] += size

    return add


_offset = _adds("rotation", "offset_deg", np.pi / 180.0)


def _hard_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    sine, cosine = fault.cycle()
    strength = fault.value("at_horizontal_field_nT", setting.usual_field)
    setting.unit.hard_forward[where] -= strength * sine
    setting.unit.hard_right[where] -= strength * cosine


def _offset_and_hard_iron(setting: Setting, fault: Fault, where: Mask) -> None:
    _offset(setting, fault, where)
    _hard_iron(setting, fault, where)


def _drift(setting: Setting, fault: Fault, where: Mask) -> None:
    since = max(fault.period[0], float(setting.hours.min()))
    days = (setting.hours[where] - since) / 24.0
    names = ("rate_deg_per_day", "offset_deg", "sine_rate_deg_per_day", "cosine_rate_deg_per_day")
    rate, offset, sine, cosine = (np.radians(fault.value(name)) for name in names)
    heading = setting.magnetic[where]
    rate = rate + sine * np.sin(heading) + cosine * np.cos(heading)
    setting.unit.rotation[where] += rate * days + offset


def _heater(setting: Setting, fault: Fault, where: Mask) -> None:
    if fault.parameters.get("between_degC") is None:
        on = setting.icing
    else:
        low, high = (float(edge) + 273.15 for edge in fault.parameters["between_degC"])
        on = (setting.temperature >= low) & (setting.temperature < high)
    _offset_and_hard_iron(setting, fault, where & on)


def _acceleration(setting: Setting, fault: Fault, where: Mask) -> None:
    gain = np.radians(fault.value("amplitude_deg"))
    speeding = setting.acceleration / _G
    if fault.parameters.get("by_phase"):
        climbs = [setting.phase == 1, setting.phase == 3]
        speeding = _CLIMB_ACCELERATION * np.select(climbs, [1.0, -1.0], 0.0)
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


def _by_temperature(setting: Setting, fault: Fault, where: Mask) -> None:
    cold = (setting.temperature[where] - 260.0) / 15.0
    setting.unit.rotation[where] += np.radians(fault.value("amplitude_deg")) * cold


UNIT_FAULTS: dict[str, UnitFault] = {
    "compass_offset": _offset,
    "hard_iron": _hard_iron,
    "soft_iron": _adds_cycle("soft"),
    "compass_step": _offset_and_hard_iron,
    "compass_drift": _drift,
    "heater_current": _heater,
    "acceleration_error": _acceleration,
    "turn_error": _turn,
    "declination_error": _declination,
    "tas_scale": _tas_scale,
    "tas_offset": _adds("airspeed_offset", "offset_m_s"),
    "heading_by_temperature": _by_temperature,
    "three_cycle": _adds_cycle("third"),
}
"""Faults of the unit itself."""
_OTHER_FAULTS = (
    *("reference_speed_bias", "reference_time_offset", "reference_grid_relative", "time_lag"),
    *("altitude_offset", "tail_swap", "wind_coding", "position_coding", "heading_coding"),
    *("outliers", "outside"),
)


def parse_faults(
    effects: Sequence[Mapping[str, Any]], *, start: datetime, tails: Sequence[str]
) -> list[Fault]:
    """Mappings as faults, in the order given; InputError if a name or an aircraft is unknown."""

    def hours(text: object, otherwise: float) -> float:
        if text is None:
            return otherwise
        when = text if isinstance(text, datetime) else datetime.fromisoformat(str(text))
        when = when.replace(tzinfo=UTC) if when.tzinfo is None else when
        return (when - start.replace(tzinfo=UTC)).total_seconds() / 3600.0

    names = {*UNIT_FAULTS, *_OTHER_FAULTS}
    faults = []
    for effect in effects:
        name, who = str(effect.get("name")), effect.get("tails")
        if name not in names:
            remedy = f"One of {', '.join(sorted(names))}"
            raise InputError("unknown effect", field="name", found=name, remedy=remedy)
        listed = [who] if isinstance(who, str) else who or ()
        affected = None if who is None or who == "all" else tuple(map(str, listed))
        missing = [tail for tail in affected or () if tail not in tails]
        if missing:
            raise InputError("unknown aircraft", field="tails", found=str(missing))
        when = effect.get("period") or (None, None)
        begin, end = (when, None) if isinstance(when, str) else when
        period = hours(begin, -np.inf), hours(end, np.inf)
        faults.append(Fault(name, affected, effect.get("parameters") or {}, period))
    return faults


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
    changes = {}
    for name in names:
        change = ReferenceChange()
        for fault in faults:
            if name not in (fault.parameters.get("references") or names):
                continue
            if fault.name == "reference_speed_bias":
                change = replace(
                    change,
                    speed_percent=fault.value("bias_percent"),
                    above_hpa=fault.optional("above_hPa"),
                    below_hpa=fault.optional("below_hPa"),
                )
            elif fault.name == "reference_time_offset":
                change = replace(change, offset_hours=fault.value("offset_h"))
            elif fault.name == "reference_grid_relative":
                change = replace(change, unrotated=fault.value("fraction", 1.0))
        changes[name] = change
    return changes
