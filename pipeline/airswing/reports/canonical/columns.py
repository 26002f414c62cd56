"""Columns of a report table: canonical names, their units, and a user's own names and units.

A canonical name is a quantity with its unit at the end (``wind_speed_kt``). The same quantity
with another unit at the end (``wind_speed_m_s``) is understood as it stands; any other name is
mapped by the configuration, in one of these forms:

* ``theirs: canonical`` or ``theirs: {name: canonical, unit: their unit}``;
* ``canonical: [theirs, other]``: several columns of one quantity; row by row the first that holds
  a value counts;
* ``canonical: {value: N510}``: the same for every report;
* ``time: {date: theirs, time: theirs, offset: theirs}``: a time made of two columns, or of three
  where the third is the offset from UTC;
* ``name: {only: [value, ...]}``: reports with another value in that column are left out.

Units are converted by pint; every _conversion used here is affine (factor and offset).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, SupportsFloat

from airswing.errors import InputError

if TYPE_CHECKING:  # taken up at the first unit
    import pint

ColumnMapping = Mapping[str, "str | Sequence[str] | Mapping[str, object]"]
"""The forms of a mapping that the module describes."""
ONLY = "only:"
"""Before the name of a column whose values decide which reports are wanted."""


@dataclass(frozen=True)
class Quantity:
    """A numeric column: the piece's column it fills, the unit there, its canonical name."""

    variable: str
    si_unit: str
    canonical: str


TEXT = ("tail", "time", "roll_flag", "temperature_qc", "wind_qc", "phase", "flight", "icing")
"""Columns without a unit."""

_PLAIN = {"latitude": "degree", "longitude": "degree", "mach": "dimensionless"}

QUANTITIES = {
    "latitude": Quantity("latitude", "degree", "latitude"),
    "longitude": Quantity("longitude", "degree", "longitude"),
    "pressure_altitude": Quantity("pressure_altitude", "m", "pressure_altitude_ft"),
    "pressure": Quantity("pressure", "Pa", "pressure_hPa"),
    "wind_direction": Quantity("wind_direction", "degree", "wind_direction_deg"),
    "wind_speed": Quantity("wind_speed", "m/s", "wind_speed_kt"),
    "eastward_wind": Quantity("eastward_wind", "m/s", "eastward_wind_kt"),
    "northward_wind": Quantity("northward_wind", "m/s", "northward_wind_kt"),
    "temperature": Quantity("air_temperature", "K", "temperature_degC"),
    "true_airspeed": Quantity("reported_airspeed", "m/s", "true_airspeed_kt"),
    "heading": Quantity("reported_heading", "degree", "heading_deg"),
    "magnetic_heading": Quantity("magnetic_heading", "degree", "magnetic_heading_deg"),
    "ground_speed": Quantity("ground_speed", "m/s", "ground_speed_kt"),
    "track": Quantity("track", "degree", "track_deg"),
    "indicated_airspeed": Quantity("indicated_airspeed", "m/s", "indicated_airspeed_kt"),
    "mach": Quantity("mach", "dimensionless", "mach"),
}
"""Numeric columns by the stem of their name."""

_SUFFIXES = {
    "deg": "degree",
    "degree": "degree",
    "degrees": "degree",
    "rad": "radian",
    "ft": "ft",
    "m": "m",
    "km": "km",
    "hft": "hft",
    "hPa": "hPa",
    "Pa": "Pa",
    "mb": "hPa",
    "mbar": "hPa",
    "kPa": "kPa",
    "kt": "kt",
    "kts": "kt",
    "kn": "kt",
    "knots": "kt",
    "m_s": "m/s",
    "mps": "m/s",
    "ms": "m/s",
    "m_s-1": "m/s",
    "km_h": "km/h",
    "kmh": "km/h",
    "mph": "mph",
    "degC": "degC",
    "C": "degC",
    "K": "K",
    "degF": "degF",
    "F": "degF",
}
_ALIASES = {
    **_SUFFIXES,
    "hft": "hectofoot",
    "hundreds of feet": "hectofoot",
    "flight level": "hectofoot",
    "m s-1": "m/s",
    "m s**-1": "m/s",
    "°": "degree",
    "celsius": "degC",
    "kelvin": "K",
    "°C": "degC",
    "meters": "m",
    "metres": "m",
    "feet": "ft",
    "arcmin": "arcminute",
}

NO_WIND = (
    "a required column is missing (for model winds alone give wind_direction_deg and wind_speed_kt "
    "the constant .nan)"
)
REQUIRED = ("tail", "time", "latitude", "longitude")
HEADINGS = ("reported_heading", "magnetic_heading")
AIRSPEEDS = ("reported_airspeed", "mach", "indicated_airspeed")
# What a wind can be derived from: one of the first two each, and both of these.
GROUND = ("ground_speed", "track")


@dataclass(frozen=True)
class Source:
    """Where a column of the piece comes from."""

    column: str  # in the file
    factor: float = 1.0  # value * factor + offset is in SI (or degrees); 1 and 0 for text
    offset: float = 0.0
    others: tuple[str, ...] = ()  # stand in, row by row, where the first holds nothing
    parts: tuple[str, ...] = ()  # follow the first in a time made of several
    value: str | float | None = None  # the same for every report, before factor and offset
    wanted: tuple[str, ...] = ()  # values of which reports are wanted

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column of the file that is read for it."""
        own = () if self.value is not None else (self.column,)
        return (*own, *self.others, *self.parts)


def canonical_names() -> list[str]:
    """List the canonical column names."""
    return [*TEXT, *(quantity.canonical for quantity in QUANTITIES.values())]


def parse_mapping(columns: ColumnMapping | None) -> dict[str, tuple[str, Source]]:
    """Check a user's column mapping before any file is opened: the piece's column to theirs.

    Raises
    ------
    InputError
        Unknown canonical name, unknown unit, or a unit of another kind than the column's.
    """
    found: dict[str, tuple[str, Source]] = {}
    for theirs, target in (columns or {}).items():
        special = _special(str(theirs), target)
        if special is None:
            name, unit = _target(str(theirs), target)
            variable, source = _resolve(str(theirs), name, unit)
        else:
            (variable, source), name = special, str(theirs)
        if variable in found:
            raise InputError(
                f"two columns are mapped to {name}",
                field="reports.columns",
                found=f"{found[variable][1].column}, {theirs}",
                remedy="Keep one of them",
            )
        found[variable] = (str(theirs), source)
    return found


def _special(name: str, target: object) -> tuple[str, Source] | None:
    """Forms in which the canonical name stands first; None for the others."""
    if isinstance(target, list | tuple) and target:
        names = [str(one) for one in target]
        variable, source = _resolve(names[0], name, None)
        return variable, replace(source, others=tuple(names[1:]))
    if not isinstance(target, Mapping):
        return None
    keys = set(target)
    if keys == {"value"}:
        variable, source = _resolve(name, name, None)
        return variable, replace(source, value=_constant(name, target["value"]))
    if name == "time" and {"date", "time"} <= keys <= {"date", "time", "offset"}:
        parts = tuple(str(target[key]) for key in ("time", "offset") if key in target)
        return "time", Source(str(target["date"]), parts=parts)
    if keys == {"only"}:
        values = target["only"]
        several = values if isinstance(values, list | tuple) else [values]
        return f"{ONLY}{name}", Source(name, wanted=tuple(str(value) for value in several))
    return None


def _constant(name: str, value: object) -> str | float:
    """Value of every report: text for columns without a unit, else a number."""
    if name in TEXT:
        return str(value)
    try:
        # what is nothing of these is no number as text either
        return float(value if isinstance(value, str | bytes | SupportsFloat) else str(value))
    except (TypeError, ValueError) as error:
        raise InputError("is no number", field=f"reports.columns.{name}", found=value) from error


def _target(theirs: str, target: object) -> tuple[str, str | None]:
    if isinstance(target, str):
        return target, None
    if isinstance(target, Mapping) and "name" in target and set(target) <= {"name", "unit"}:
        unit = target.get("unit")
        return str(target["name"]), None if unit is None else str(unit)
    raise InputError(
        "a mapped column must be a canonical name or {name: ..., unit: ...}",
        field=f"reports.columns.{theirs}",
        found=target,
        remedy="Or, after a canonical name: [theirs, other], {value: ...}, {only: [...]}, and for "
        "time {date: ..., time: ...}",
    )


def _resolve(theirs: str, name: str, unit: str | None) -> tuple[str, Source]:
    if name in TEXT:
        if unit is not None:
            raise InputError(f"{name} has no unit", field=f"reports.columns.{theirs}", found=unit)
        return name, Source(theirs)
    known = split_name(name)
    if known is None:
        near = difflib.get_close_matches(name, canonical_names(), n=3, cutoff=0.5)
        raise InputError(
            f"{name!r} is no canonical column",
            field=f"reports.columns.{theirs}",
            remedy=f"Nearest: {', '.join(near)}" if near else "See the list of columns",
        )
    quantity, own_unit = known
    factor, offset = _conversion(unit or own_unit, quantity.si_unit, theirs, quantity.canonical)
    return quantity.variable, Source(theirs, factor, offset)


def split_name(name: str) -> tuple[Quantity, str] | None:
    """Quantity and unit at the end of a name such as ``wind_speed_m_s``; None for any other."""
    # Longest first: ``pressure_altitude_ft`` is no pressure.
    for stem in sorted(QUANTITIES, key=len, reverse=True):
        if not name.lower().startswith(stem):
            continue
        quantity, suffix = QUANTITIES[stem], name[len(stem) :]
        if not suffix:
            return (quantity, _PLAIN[stem]) if stem in _PLAIN else None
        unit = _unit_of_suffix(suffix[1:]) if suffix[0] == "_" else None
        return None if unit is None or not compatible(unit, quantity.si_unit) else (quantity, unit)
    return None


def _unit_of_suffix(suffix: str) -> str | None:
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    folded = {key.lower(): value for key, value in _SUFFIXES.items()}
    return folded.get(suffix.lower())


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[float]:
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry()
    registry.define("hectofoot = 100 * foot = hft")
    return registry


@lru_cache(maxsize=256)
def _affine(unit: str, si_unit: str) -> tuple[float, float]:
    quantity = _registry().Quantity
    unit = _ALIASES.get(unit.strip(), unit.strip())
    # Two points tell factor and offset of any affine unit, degrees Celsius too.
    zero = quantity(0.0, unit).to(si_unit).magnitude
    one = quantity(1.0, unit).to(si_unit).magnitude
    return float(one - zero), float(zero)


def compatible(unit: str, si_unit: str) -> bool:
    """Tell whether one unit converts to another."""
    try:
        _affine(unit, si_unit)
    except Exception:  # pint raises many kinds, some of them from its parser
        return False
    return True


def _conversion(unit: str, si_unit: str, column: str, canonical: str) -> tuple[float, float]:
    """Factor and offset from a user's unit to ours; a message that names their column."""
    if not compatible(unit, si_unit):
        raise InputError(
            f"unit {unit!r} cannot stand for {canonical}",
            field=f"reports.columns.{column}",
            found=unit,
            remedy=f"Give a unit that converts to {si_unit!r}",
        )
    return _affine(unit, si_unit)


def sources(
    names: Iterable[str], mapping: Mapping[str, tuple[str, Source]], file: object
) -> dict[str, Source]:
    """Find the file's column for every column of the piece.

    Parameters
    ----------
    names : iterable of str
        Columns of the file.
    mapping : mapping
        From :func:`parse_mapping`; comes before names understood as they stand.
    file : path
        Named in the message.

    Raises
    ------
    InputError
        If a mapped column or a required one is absent; names the nearest that are there.
    """
    names = list(names)
    by_stripped = {name.strip(): name for name in names}
    found: dict[str, Source] = {}
    for variable, (_, source) in mapping.items():
        found[variable] = _present(source, by_stripped, names, file)
    taken = {column for source in found.values() for column in source.columns}
    for stripped, name in by_stripped.items():
        if name in taken:
            continue
        known = _understood(stripped, name)
        if known is not None:
            found.setdefault(*known)
    _check_required(found, names, file)
    return found


def _present(
    source: Source, by_stripped: Mapping[str, str], names: list[str], file: object
) -> Source:
    """A mapped source with the columns as the file writes them."""
    if source.value is not None:
        return source
    if source.others:
        wanted = (source.column, *source.others)
        there = [by_stripped[name] for name in wanted if name in by_stripped]
        if there:
            return replace(source, column=there[0], others=tuple(there[1:]))
    for name in (source.column, *source.parts):
        if name not in by_stripped:
            raise _absent(name, names, file, "the mapped column is not in the file")
    parts = tuple(by_stripped[name] for name in source.parts)
    return replace(source, column=by_stripped[source.column], parts=parts)


def _understood(stripped: str, name: str) -> tuple[str, Source] | None:
    if stripped.lower() in TEXT:
        return stripped.lower(), Source(name)
    known = split_name(stripped)
    if known is None:
        return None
    quantity, unit = known
    return quantity.variable, Source(name, *_affine(unit, quantity.si_unit))


def _check_required(found: Mapping[str, Source], names: list[str], file: object) -> None:
    def refuse(wanted: str, what: str = "a required column is missing") -> InputError:
        return _absent(wanted, names, file, what, found)

    for variable in REQUIRED:
        if variable not in found:
            raise refuse(variable)
    if "pressure_altitude" not in found and "pressure" not in found:
        raise refuse(
            "pressure_altitude_ft", "neither pressure_altitude_ft nor pressure_hPa is there"
        )
    if {"eastward_wind", "northward_wind"} <= set(found) or _tells_wind(found):
        return
    for variable in ("wind_direction", "wind_speed"):
        if variable not in found:
            raise refuse(QUANTITIES[variable].canonical, NO_WIND)


def _tells_wind(columns: Iterable[str]) -> bool:
    """Tell whether heading, airspeed and ground vector are among the columns of a piece."""
    present = set(columns)
    some = present.intersection(HEADINGS) and present.intersection(AIRSPEEDS)
    return bool(some) and present.issuperset(GROUND)


def _absent(
    wanted: str, names: list[str], file: object, what: str, used: Mapping[str, Source] | None = None
) -> InputError:
    taken = {column for source in (used or {}).values() for column in source.columns}
    folded = {name.strip().lower(): name for name in names if name not in taken}
    # looser than the library's 0.6: names of one column share little but a stem
    near = difflib.get_close_matches(wanted.lower(), list(folded), n=3, cutoff=0.4)
    stem = wanted.split("_")[0].lower()
    near += [key for key in folded if key not in near and (stem in key or key[:3] == stem[:3])]
    remedy = "Map the file's own name to it under reports.columns"
    if near:
        remedy = f"Nearest there: {', '.join(folded[key] for key in near[:3])}. " + remedy
    return InputError(what, file=file, field=wanted, found=", ".join(names), remedy=remedy)
