"""Columns of a report table: canonical names and units, and mappings of other names and units.

A canonical name is a quantity with its unit at the end (``wind_speed_kt``). The same quantity with
another unit at the end (``wind_speed_m_s``) is understood without a mapping. Tables of programs in
use are recognised by the names of their columns (:data:`LAYOUTS`). Any other name is mapped by the
configuration, in one of these forms:

* ``theirs: canonical`` or ``theirs: {name: canonical, unit: their unit}``;
* ``theirs: {name: time, format: "%d.%m.%Y %H:%M"}``: a time in another notation than
  :mod:`airswing.reports.values` reads (codes of :meth:`datetime.datetime.strftime`);
* ``canonical: [theirs, other]``: several columns of one quantity; in each row the first that holds
  a value is used;
* ``canonical: {value: N510}``: the same for every report;
* ``time: {date: theirs, time: theirs, offset: theirs}``: a time made of two columns, or of three
  where the third is the offset from UTC; with ``format`` of the two with a blank between;
* ``name: {only: [value, ...]}``: reports with another value in that column are left out.

Units are converted by pint; every conversion used here has a factor and an offset.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, SupportsFloat

from airswing.errors import InputError

if TYPE_CHECKING:  # imported at the first unit
    import pint

ColumnMapping = Mapping[str, "str | Sequence[str] | Mapping[str, object]"]
"""A mapping in the forms that the module describes."""
ONLY = "only:"
"""Prefix of a column whose values select the reports."""


@dataclass(frozen=True)
class Quantity:
    """A numeric column: the variable it becomes, the unit of that, its canonical name."""

    variable: str
    si_unit: str
    canonical: str


TEXT = ("tail", "time", "roll_flag", "temperature_qc", "wind_qc", "phase", "flight", "icing")
"""Columns without a unit."""

_WITHOUT_SUFFIX = {"latitude": "degree", "longitude": "degree", "mach": "dimensionless"}

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
"""Numeric columns by the name without its unit."""

_SUFFIXES = {
    **dict.fromkeys(("deg", "degree", "degrees"), "degree"),
    **dict.fromkeys(("kt", "kts", "kn", "knots"), "kt"),
    **dict.fromkeys(("m_s", "mps", "ms", "m_s-1"), "m/s"),
    **dict.fromkeys(("km_h", "kmh"), "km/h"),
    **dict.fromkeys(("hPa", "mb", "mbar"), "hPa"),
    **dict.fromkeys(("degC", "C"), "degC"),
    **dict.fromkeys(("degF", "F"), "degF"),
    **{unit: unit for unit in ("ft", "m", "km", "hft", "Pa", "kPa", "mph", "K")},
    "rad": "radian",
}
_SPELLINGS = {
    **_SUFFIXES,
    **dict.fromkeys(("hft", "hundreds of feet", "flight level"), "hectofoot"),
    **dict.fromkeys(("m s-1", "m s**-1"), "m/s"),
    **dict.fromkeys(("meters", "metres"), "m"),
    **dict.fromkeys(("celsius", "°C", "deg C"), "degC"),
    "°": "degree",
    "kelvin": "K",
    "feet": "ft",
    "arcmin": "arcminute",
}

NO_WIND = (
    "a required column is missing (for model winds alone give wind_direction_deg and wind_speed_kt "
    "the constant .nan)"
)
REQUIRED = ("tail", "time", "latitude", "longitude")
# A wind can be derived from one of the first two each and from both of the last.
HEADINGS = ("reported_heading", "magnetic_heading")
AIRSPEEDS = ("reported_airspeed", "mach", "indicated_airspeed")
GROUND = ("ground_speed", "track")


@dataclass(frozen=True)
class Source:
    """The column or columns of a file that one variable is read from."""

    column: str  # in the file
    factor: float = 1.0  # value * factor + offset is in SI (or degrees); 1 and 0 for text
    offset: float = 0.0
    others: tuple[str, ...] = ()  # used in rows where the first holds nothing
    parts: tuple[str, ...] = ()  # appended to the first in a time made of several columns
    format: str | None = None  # of a time
    value: str | float | None = None  # the same for every report, before factor and offset
    wanted: tuple[str, ...] = ()  # values that select reports

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column of the file that is read."""
        first = () if self.value is not None else (self.column,)
        return (*first, *self.others, *self.parts)


Mapped = Mapping[str, tuple[str, Source]]
"""The user's name and the source of each variable; of :func:`parse_mapping`."""


@dataclass(frozen=True)
class Layout:
    """A program whose tables are recognised by column names that are always there."""

    program: str
    signature: frozenset[str]
    columns: Mapping[str, str | tuple[str, ...]]
    messages: bool = False  # a row holds one message, not all values of a report

    def mapping(self, names: Iterable[str]) -> ColumnMapping:
        """Mapping of the columns that are in a table."""
        there = {name.strip() for name in names}
        mapping: dict[str, str | list[str]] = {}
        for key, target in self.columns.items():
            if isinstance(target, tuple):
                if some := [name for name in target if name in there]:
                    mapping[key] = some
            elif key in there:
                mapping[key] = target
        return mapping


LAYOUTS = (
    Layout(
        "meteo-particle-model, decoded Mode-S",
        frozenset({"ts", "icao", "lat", "lon", "alt", "hdg"}),
        {
            "icao": "tail",
            "ts": "time",
            "lat": "latitude",
            "lon": "longitude",
            "alt": "pressure_altitude_ft",
            "hdg": "magnetic_heading_deg",
            "ias": "indicated_airspeed_kt",
            "ground_speed_kt": ("gs_adsb", "gs"),
            "track_deg": ("trk_adsb", "trk"),
            "tas": "true_airspeed_kt",
        },
    ),
    Layout(
        "traffic, Mode-S",
        frozenset({"timestamp", "icao24", "latitude", "longitude", "altitude"}),
        {
            "icao24": "tail",
            "timestamp": "time",
            "altitude": "pressure_altitude_ft",
            "groundspeed": "ground_speed_kt",
            "track": "track_deg",
            "heading": "magnetic_heading_deg",
            "IAS": "indicated_airspeed_kt",
            "TAS": "true_airspeed_kt",
            "Mach": "mach",
            "callsign": "flight",
        },
        messages=True,
    ),
    Layout(
        "OpenSky state vectors",
        frozenset({"time", "icao24", "lat", "lon", "velocity", "heading", "baroaltitude"}),
        {
            "icao24": "tail",
            "lat": "latitude",
            "lon": "longitude",
            "baroaltitude": "pressure_altitude_m",
            "velocity": "ground_speed_m_s",
            "heading": "track_deg",  # the direction of movement over ground
            "callsign": "flight",
        },
    ),
)
"""Headings of Mode-S register 6,0 are magnetic; tracks are true (ADS-B, register 5,0)."""


def layout_of(names: Iterable[str]) -> Layout | None:
    """Return the layout of a table with these columns, or None."""
    there = {name.strip() for name in names}
    return next((layout for layout in LAYOUTS if layout.signature <= there), None)


def canonical_names() -> list[str]:
    """List the canonical column names."""
    return [*TEXT, *(quantity.canonical for quantity in QUANTITIES.values())]


def parse_mapping(columns: ColumnMapping | None) -> dict[str, tuple[str, Source]]:
    """Check a user's column mapping before any file is opened.

    Returns
    -------
    dict
        The user's name and the source of each mapped variable.

    Raises
    ------
    InputError
        Unknown canonical name, unknown unit, or a unit of another kind than the column's.
    """
    mapping: dict[str, tuple[str, Source]] = {}
    for key, target in (columns or {}).items():
        theirs = str(key)
        name, variable, source = _mapped(theirs, target)
        if variable in mapping:
            raise InputError(
                f"two columns are mapped to {name}",
                field="reports.columns",
                found=f"{mapping[variable][1].column}, {theirs}",
                remedy="Keep one of them",
            )
        mapping[variable] = (theirs, source)
    return mapping


def _mapped(key: str, target: object) -> tuple[str, str, Source]:
    """Canonical name, variable and source of one entry of a mapping."""
    if isinstance(target, str):
        return target, *_resolve(key, target, None)
    if isinstance(target, list | tuple) and target:
        first, *others = map(str, target)
        variable, source = _resolve(first, key, None)
        return key, variable, replace(source, others=tuple(others))
    keys = set(target) if isinstance(target, Mapping) else set()
    entry: Mapping[str, object] = target if isinstance(target, Mapping) else {}
    if entry.get("name") == "time" and keys == {"name", "format"}:
        return "time", "time", Source(key, format=_format(key, entry["format"]))
    if "name" in keys and keys <= {"name", "unit"}:
        unit = entry.get("unit")
        return str(entry["name"]), *_resolve(
            key, str(entry["name"]), None if unit is None else str(unit)
        )
    if keys == {"value"}:
        variable, source = _resolve(key, key, None)
        return key, variable, replace(source, value=_constant(key, entry["value"]))
    if key == "time" and {"date", "time"} <= keys <= {"date", "time", "offset", "format"}:
        parts = tuple(str(entry[part]) for part in ("time", "offset") if part in keys)
        format = _format(key, entry["format"]) if "format" in keys else None
        return key, key, Source(str(entry["date"]), parts=parts, format=format)
    if keys == {"only"}:
        values = entry["only"]
        several = values if isinstance(values, list | tuple) else [values]
        return key, f"{ONLY}{key}", Source(key, wanted=tuple(map(str, several)))
    raise InputError(
        "a mapped column must be a canonical name or {name: ..., unit: ...}",
        field=f"reports.columns.{key}",
        found=target,
        remedy="Or, after a canonical name: [theirs, other], {value: ...}, {only: [...]}, and for "
        "time {date: ..., time: ...}",
    )


def _format(theirs: str, written: object) -> str:
    import pandas as pd

    try:
        pd.to_datetime([""], format=str(written), errors="coerce")
    except ValueError as error:
        raise InputError(
            f"is no format of a time: {error}",
            field=f"reports.columns.{theirs}.format",
            found=written,
            remedy='Such as "%d.%m.%Y %H:%M"',
        ) from error
    return str(written)


def _constant(name: str, value: object) -> str | float:
    if name in TEXT:
        return str(value)
    try:
        return float(value if isinstance(value, str | bytes | SupportsFloat) else str(value))
    except (TypeError, ValueError) as error:
        raise InputError("is no number", field=f"reports.columns.{name}", found=value) from error


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
    quantity, unit = known[0], unit or known[1]
    if not compatible(unit, quantity.si_unit):
        raise InputError(
            f"unit {unit!r} is no unit of {quantity.canonical}",
            field=f"reports.columns.{theirs}",
            found=unit,
            remedy=f"Give a unit that converts to {quantity.si_unit!r}",
        )
    return quantity.variable, Source(theirs, *conversion(unit, quantity.si_unit))


def split_name(name: str) -> tuple[Quantity, str] | None:
    """Quantity and unit of a name such as ``wind_speed_m_s``; None for any other name."""
    # The longest first: ``pressure_altitude_ft`` is no pressure.
    for stem in sorted(QUANTITIES, key=len, reverse=True):
        if not name.lower().startswith(stem):
            continue
        quantity, suffix = QUANTITIES[stem], name[len(stem) :]
        if not suffix:
            return (quantity, _WITHOUT_SUFFIX[stem]) if stem in _WITHOUT_SUFFIX else None
        folded = {key.lower(): unit for key, unit in _SUFFIXES.items()}
        unit = folded.get(suffix[1:].lower()) if suffix[0] == "_" else None
        return None if unit is None or not compatible(unit, quantity.si_unit) else (quantity, unit)
    return None


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[float]:
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry()
    registry.define("hectofoot = 100 * foot = hft")
    return registry


@lru_cache(maxsize=256)
def conversion(unit: str, si_unit: str) -> tuple[float, float]:
    """Factor and offset from a unit to another; pint's errors where there is none."""
    quantity = _registry().Quantity
    unit = _SPELLINGS.get(unit.strip(), unit.strip())
    zero = quantity(0.0, unit).to(si_unit).magnitude
    one = quantity(1.0, unit).to(si_unit).magnitude
    return float(one - zero), float(zero)


def compatible(unit: str, si_unit: str) -> bool:
    """Return True where one unit converts to another."""
    try:
        conversion(unit, si_unit)
    except Exception:  # pint raises many kinds, some of them from its parser
        return False
    return True


def sources(names: Iterable[str], mapping: Mapped, file: object) -> dict[str, Source]:
    """Find the columns of a file that its variables are read from.

    Parameters
    ----------
    names : iterable of str
        Columns of the file.
    mapping : mapping
        Of :func:`parse_mapping`; overrides names that are understood without it.
    file : path
        Named in messages.

    Returns
    -------
    dict of Source
        By variable.

    Raises
    ------
    InputError
        A mapped column or a required one is absent; names the nearest that are there.
    """
    names = list(names)
    by_stripped = {name.strip(): name for name in names}
    found = {
        variable: _present(source, by_stripped, names, file)
        for variable, (_, source) in mapping.items()
    }
    taken = {column for source in found.values() for column in source.columns}
    for stripped, name in by_stripped.items():
        if name in taken:
            continue
        if stripped.lower() in TEXT:
            found.setdefault(stripped.lower(), Source(name))
        elif (known := split_name(stripped)) is not None:
            quantity, unit = known
            found.setdefault(quantity.variable, Source(name, *conversion(unit, quantity.si_unit)))
    _check_required(found, names, file)
    return found


def _present(
    source: Source, by_stripped: Mapping[str, str], names: list[str], file: object
) -> Source:
    """A mapped source with its columns as the file writes them."""
    if source.value is not None:
        return source
    if source.others:
        wanted = (source.column, *source.others)
        if there := [by_stripped[name] for name in wanted if name in by_stripped]:
            return replace(source, column=there[0], others=tuple(there[1:]))
    for name in (source.column, *source.parts):
        if name not in by_stripped:
            raise _absent(name, names, file, "the mapped column is not in the file")
    parts = tuple(by_stripped[name] for name in source.parts)
    return replace(source, column=by_stripped[source.column], parts=parts)


def _check_required(found: Mapping[str, Source], names: list[str], file: object) -> None:
    taken = {column for source in found.values() for column in source.columns}
    free = [name for name in names if name not in taken]
    for variable in REQUIRED:
        if variable not in found:
            raise _absent(variable, names, file, "a required column is missing", free)
    if "pressure_altitude" not in found and "pressure" not in found:
        what = "neither pressure_altitude_ft nor pressure_hPa is there"
        raise _absent("pressure_altitude_ft", names, file, what, free)
    derivable = (
        not found.keys().isdisjoint(HEADINGS)
        and not found.keys().isdisjoint(AIRSPEEDS)
        and found.keys() >= set(GROUND)
    )
    if derivable or found.keys() >= {"eastward_wind", "northward_wind"}:
        return
    for variable in ("wind_direction", "wind_speed"):
        if variable not in found:
            raise _absent(QUANTITIES[variable].canonical, names, file, NO_WIND, free)


def _absent(
    wanted: str, names: list[str], file: object, what: str, free: list[str] | None = None
) -> InputError:
    folded = {name.strip().lower(): name for name in (names if free is None else free)}
    folded = {key: name for key, name in folded.items() if len(key) > 1}
    # Looser than the library's 0.6: two names of one column share little but a stem.
    near = difflib.get_close_matches(wanted.lower(), list(folded), n=3, cutoff=0.4)
    stem = wanted.split("_")[0].lower()
    near += [key for key in folded if key not in near and (stem in key or key[:3] == stem[:3])]
    remedy = (
        "Map the file's own name to it under reports.columns; `airswing inspect FILE` proposes a "
        "mapping"
    )
    if near:
        remedy = f"Nearest there: {', '.join(folded[key] for key in near[:3])}. " + remedy
    return InputError(what, file=file, field=wanted, found=", ".join(names), remedy=remedy)
