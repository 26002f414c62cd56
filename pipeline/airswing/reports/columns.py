"""Columns of a report table: canonical names and units, mappings of other ones, and their values.

A canonical name is a quantity of the table ``columns.csv`` with its unit at the end
(``wind_speed_kt``); with another unit at the end it needs no mapping. Tables of programs in use are
recognised by the names of their columns (:data:`LAYOUTS`). The forms of a mapping are those of
``docs/formats.md``, and ``name: {only: [value, ...]}``: reports with another value in that column
are left out. The limits of pressure are those of the standard atmosphere at the limits of pressure
altitude.

Times are ISO 8601 text (UTC where it has no offset), or a number, which is read by the first of
these notations that gives a possible time: seconds since 1970, ``yyyymmddHH``, ``yyyymmddHHMM``,
``yyyymmddHHMMSS``, milliseconds, microseconds or nanoseconds since 1970, Julian date. They do not
overlap before July 2032, when seconds since 1970 become as large as ``1973010100``. Other notations
(``01/02/2009``) are ambiguous and count as unparsable unless their format is given.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from airswing.errors import InputError, nearest
from airswing.flags import ICING, PHASE, QC, ROLL
from airswing.quantities import COMPACT, registry
from airswing.reports.audit import Audit

Column: TypeAlias = "pd.Series[Any]"  # A column of a table, of any type
Times: TypeAlias = NDArray[np.datetime64]
Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Index: TypeAlias = NDArray[np.integer]
Mask: TypeAlias = NDArray[np.bool_]

ColumnMapping = Mapping[str, "str | Sequence[str] | Mapping[str, object]"]
"""A mapping in the forms that the module describes."""
ONLY = "only:"  # prefix of a column whose values select the reports


@dataclass(frozen=True)
class Quantity:
    """A numeric column, a row of ``columns.csv``."""

    stem: str  # the name without its unit
    variable: str  # it becomes
    si_unit: str  # of the variable; degrees for angles
    unit: str  # in the canonical name; none where there is a single one
    lowest: float  # possible value of the variable
    highest: float

    @property
    def canonical(self) -> str:
        """The canonical name, such as ``wind_speed_kt``."""
        return f"{self.stem}_{self.unit}" if self.unit else self.stem


_TABLE = pd.read_csv(Path(__file__).with_suffix(".csv")).fillna({"unit": "", "other_names": "(?!)"})
TEXT: tuple[str, ...] = tuple(_TABLE["column"][_TABLE["si_unit"].isna()])  # columns without a unit
QUANTITIES = {row[0]: Quantity(*row[:-1]) for row in _TABLE.dropna().itertuples(index=False)}
"""Numeric columns by the name without its unit."""
LIMITS = {row.variable: (row.lowest, row.highest) for row in QUANTITIES.values()}
"""Lowest and highest possible value by variable, in SI (degrees for angles)."""
OTHER_NAMES: dict[str, str] = dict(zip(_TABLE["column"], _TABLE["other_names"], strict=True))
"""Pattern of the names that other programs give to a column, in small letters and digits."""

_SUFFIXES = {
    suffix: unit
    for unit, suffixes in {
        **{"degree": "deg degree degrees", "radian": "rad", "kt": "kt kts kn knots"},
        **{"m/s": "m_s mps ms m_s-1", "km/h": "km_h kmh", "mph": "mph"},
        **{"hPa": "hPa mb mbar", "Pa": "Pa", "kPa": "kPa", "degC": "degC C", "degF": "degF F"},
        **{"K": "K", "ft": "ft", "m": "m", "km": "km", "hft": "hft"},
    }.items()
    for suffix in suffixes.split()
}
# Spellings that pint does not know, or takes for another unit.
_SPELLINGS = {
    **_SUFFIXES,
    **{"hundreds of feet": "hft", "flight level": "hft", "m s-1": "m/s", "deg C": "degC"},
}

_FOLDED = {suffix.lower(): unit for suffix, unit in _SUFFIXES.items()}
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_UNITS = "ft|m|km|kts?|kn|knots|mps|m_s|ms|kmh|hPa|Pa|mb|degC|C|K|deg|rad"
_ENDING = re.compile(rf"_({_UNITS})$", re.I)
# Without an underscore the rest of the name must be long enough to be recognised with certainty.
_GLUED = re.compile(rf"(.{{3,}}?)({_UNITS})", re.I)

NO_WIND = (
    "a required column is missing (for model winds alone give wind_direction_deg and wind_speed_kt "
    "the constant .nan)"
)
REQUIRED = ("tail", "time", "latitude", "longitude")


@dataclass(frozen=True)
class Source:
    """The column or columns of a file that one variable is read from."""

    column: str  # in the file
    factor: float = 1.0  # value * factor + offset is in SI (or degrees); 1 and 0 for text
    offset: float = 0.0
    fallbacks: tuple[str, ...] = ()  # used in rows where the first is empty
    parts: tuple[str, ...] = ()  # appended to the first in a time made of several columns
    format: str | None = None  # of a time
    value: str | float | None = None  # the same for every report, before factor and offset
    wanted: tuple[str, ...] = ()  # values that select reports

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column of the file that is read."""
        return (() if self.value is not None else (self.column,)) + self.fallbacks + self.parts


Mapped = Mapping[str, Source]  # the source of each variable, from :func:`parse_mapping`


class Layout(NamedTuple):
    """Tables of one program, recognised by column names that are always present."""

    signature: set[str]
    columns: Mapping[str, str | tuple[str, ...]]
    messages: bool = False  # a row holds one message, not all values of a report


# Headings of Mode-S register 6,0 are magnetic; tracks are true (ADS-B, register 5,0).
LAYOUTS = (
    Layout(  # meteo-particle-model, decoded Mode-S
        {"ts", "icao", "lat", "lon", "alt", "hdg"},
        {
            **{"icao": "tail", "ts": "time", "lat": "latitude", "lon": "longitude"},
            **{"alt": "pressure_altitude_ft", "hdg": "magnetic_heading_deg"},
            **{"ias": "indicated_airspeed_kt", "tas": "true_airspeed_kt"},
            **{"ground_speed_kt": ("gs_adsb", "gs"), "track_deg": ("trk_adsb", "trk")},
        },
    ),
    Layout(  # traffic, Mode-S
        {"timestamp", "icao24", "latitude", "longitude", "altitude"},
        {
            **{"icao24": "tail", "timestamp": "time", "altitude": "pressure_altitude_ft"},
            **{"groundspeed": "ground_speed_kt", "track": "track_deg", "callsign": "flight"},
            **{"heading": "magnetic_heading_deg", "IAS": "indicated_airspeed_kt"},
            **{"TAS": "true_airspeed_kt", "Mach": "mach"},
        },
        messages=True,
    ),
    Layout(  # OpenSky state vectors, whose heading is the direction of movement over ground
        {"time", "icao24", "lat", "lon", "velocity", "heading", "baroaltitude"},
        {
            **{"icao24": "tail", "lat": "latitude", "lon": "longitude", "callsign": "flight"},
            **{"baroaltitude": "pressure_altitude_m", "velocity": "ground_speed_m_s"},
            "heading": "track_deg",
        },
    ),
)


def layout_of(names: Iterable[str]) -> Layout | None:
    """Return the layout of a table with these columns, or None."""
    there = {name.strip() for name in names}
    return next((layout for layout in LAYOUTS if layout.signature <= there), None)


def parse_mapping(columns: ColumnMapping | None) -> dict[str, Source]:
    """Check a user's column mapping before any file is opened; the source of each variable."""
    mapping: dict[str, Source] = {}
    for key, target in (columns or {}).items():
        name, variable, source = _mapped(str(key), target)
        if variable in mapping:
            text, pair = f"two columns are mapped to {name}", f"{mapping[variable].column}, {key}"
            raise InputError(text, field="reports.columns", found=pair, remedy="Keep one of them")
        mapping[variable] = source
    return mapping


def _mapped(key: str, target: object) -> tuple[str, str, Source]:
    match target:
        case str():
            return target, *_resolve(key, target)
        case [first, *fallbacks]:
            variable, source = _resolve(str(first), key)
            return key, variable, replace(source, fallbacks=tuple(map(str, fallbacks)))
        case {"name": "time", "format": written, **rest} if not rest:
            return "time", "time", Source(key, format=_format(key, written))
        case {"name": name, **rest} if rest.keys() <= {"unit"}:
            return str(name), *_resolve(key, str(name), rest.get("unit"))
        case {"value": value, **rest} if not rest:
            variable, source = _resolve(key, key)
            try:
                constant = str(value) if key in TEXT else float(value)
            except (TypeError, ValueError) as error:
                field = f"reports.columns.{key}"
                raise InputError("is not a number", field=field, found=value) from error
            return key, variable, replace(source, value=constant)
        case {"date": date, "time": time, **rest} if key == "time" and (
            rest.keys() <= {"offset", "format"}
        ):
            parts = (str(time), *([str(rest["offset"])] if "offset" in rest else []))
            format = _format(key, rest["format"]) if "format" in rest else None
            return key, key, Source(str(date), parts=parts, format=format)
        case {"only": wanted, **rest} if not rest:
            values = wanted if isinstance(wanted, list | tuple) else [wanted]
            return key, f"{ONLY}{key}", Source(key, wanted=tuple(map(str, values)))
    raise InputError(
        "a mapped column must be a canonical name or {name: ..., unit: ...}",
        field=f"reports.columns.{key}",
        found=target,
        remedy="Or, after a canonical name: [column, column], {value: ...}, {only: [...]}, and for "
        "time {date: ..., time: ...}",
    )


def _format(theirs: str, written: object) -> str:
    try:
        pd.to_datetime([""], format=str(written), errors="coerce")
    except ValueError as error:
        problem, field = f"is not a time format: {error}", f"reports.columns.{theirs}.format"
        remedy = 'Such as "%d.%m.%Y %H:%M"'
        raise InputError(problem, field=field, found=written, remedy=remedy) from error
    return str(written)


def _resolve(theirs: str, name: str, unit: object = None) -> tuple[str, Source]:
    field = f"reports.columns.{theirs}"
    if name in TEXT:
        if unit is not None:
            raise InputError(f"{name} has no unit", field=field, found=str(unit))
        return name, Source(theirs)
    parsed = split_name(name)
    if parsed is None:
        every = [*TEXT, *(quantity.canonical for quantity in QUANTITIES.values())]
        problem = f"{name!r} is not a canonical column{nearest(name, every)}"
        raise InputError(problem, field=field)
    quantity, unit = parsed[0], str(unit or parsed[1])
    if not compatible(unit, quantity.si_unit):
        problem = f"{unit!r} is not a unit of {quantity.canonical}"
        remedy = f"Give a unit that converts to {quantity.si_unit!r}"
        raise InputError(problem, field=field, found=unit, remedy=remedy)
    return quantity.variable, Source(theirs, *conversion(unit, quantity.si_unit))


def split_name(name: str) -> tuple[Quantity, str] | None:
    """Quantity and unit of a name such as ``wind_speed_m_s``; None for any other name."""
    return _known_names().get(name.lower())


@cache
def _known_names() -> dict[str, tuple[Quantity, str]]:
    names = {q.stem: (q, q.si_unit) for q in QUANTITIES.values() if not q.unit}
    for quantity in QUANTITIES.values():
        for suffix, unit in _SUFFIXES.items():
            if compatible(unit, quantity.si_unit):
                names[f"{quantity.stem}_{suffix}".lower()] = quantity, unit
    return names


def recognised(name: str) -> tuple[str | None, str]:
    """Column, without its unit, that a name of any program stands for, and the unit in the name.

    The unit is in brackets or at the end (``Alt (m)``, ``alt_m``, ``AltM``), empty where there is
    none that the quantity can have. An unknown name gives None.
    """
    name = name.strip()
    if parsed := split_name(name):
        return parsed[0].stem, parsed[1]
    text = _BRACKET.sub("", name)
    written = _BRACKET.search(name) or _ENDING.search(text)
    stem, unit = _other_name(_ENDING.sub("", text)), written[1] if written else ""
    glued = _GLUED.fullmatch(text) if stem is None else None
    if glued:
        stem, unit = _other_name(glued[1]), glued[2]
    # Units are often written in another case than that of the SI.
    unit = unit if unit in _SPELLINGS else _FOLDED.get(unit.lower(), unit)
    if stem in QUANTITIES and compatible(unit, QUANTITIES[stem].si_unit):
        return stem, unit
    return None if glued else stem, ""


def _other_name(text: str) -> str | None:
    text = re.sub(r"[^a-z0-9]", "", text.lower())
    return next((stem for stem, names in OTHER_NAMES.items() if re.fullmatch(names, text)), None)


@cache
def conversion(unit: str, si_unit: str) -> tuple[float, float]:
    """Factor and offset from a unit to another; raises pint's errors if there is none."""
    quantity = registry().Quantity
    unit = _SPELLINGS.get(unit.strip(), unit.strip())
    zero, unity = (quantity(value, unit).to(si_unit).magnitude for value in (0.0, 1.0))
    return float(unity - zero), float(zero)


def compatible(unit: str, si_unit: str) -> bool:
    """Return True where one unit converts to another."""
    try:
        conversion(unit, si_unit)
    except Exception:  # pint raises many kinds, some of them from its parser
        return False
    return True


def sources(names: Iterable[str], mapping: Mapped) -> dict[str, Source]:
    """Find the columns of a file that each variable is read from.

    The user's mapping goes first, then that of the program that wrote the table.
    """
    names = list(names)
    by_stripped = {name.strip(): name for name in names}
    layout = layout_of(names)
    layout_columns = {
        key: target
        for key, target in (layout.columns if layout else {}).items()
        if not by_stripped.keys().isdisjoint([key] if isinstance(target, str) else target)
    }
    matched = {}
    for variable, source in {**parse_mapping(layout_columns), **mapping}.items():
        there = [by_stripped[n] for n in (source.column, *source.fallbacks) if n in by_stripped]
        if source.fallbacks and there:
            source = replace(source, column=there[0], fallbacks=tuple(there[1:]))
        elif source.value is None:
            for name in (source.column, *source.parts):
                if name not in by_stripped:
                    raise _absent(name, names, "the mapped column is not in the file")
            column, *parts = (by_stripped[name] for name in (source.column, *source.parts))
            source = replace(source, column=column, parts=tuple(parts))
        matched[variable] = source
    taken = {
        column
        for variable, source in matched.items()
        if not variable.startswith(ONLY)  # a column that selects reports is read too
        for column in source.columns
    }
    for stripped, name in by_stripped.items():
        if name in taken:
            continue
        if stripped.lower() in TEXT:
            matched.setdefault(stripped.lower(), Source(name))
        elif (quantity_and_unit := split_name(stripped)) is not None:
            quantity, unit = quantity_and_unit
            matched.setdefault(quantity.variable, Source(name, *conversion(unit, quantity.si_unit)))
    taken = {column for source in matched.values() for column in source.columns}
    free = [name for name in names if name not in taken]
    for variable in REQUIRED:
        if variable not in matched:
            raise _absent(variable, names, "a required column is missing", free)
    if "pressure_altitude" not in matched and "pressure" not in matched:
        problem = "neither pressure_altitude_ft nor pressure_hPa is there"
        raise _absent("pressure_altitude_ft", names, problem, free)
    if not gives_wind(matched):
        absent = next(name for name in ("wind_direction", "wind_speed") if name not in matched)
        raise _absent(QUANTITIES[absent].canonical, names, NO_WIND, free)
    return matched


def gives_wind(variables: Iterable[str]) -> bool:
    """Whether variables hold a wind, or a heading, an airspeed and a ground vector."""
    names = set(variables)
    return (
        names >= {"wind_direction", "wind_speed"}
        or names >= {"eastward_wind", "northward_wind"}
        or bool(
            names & {"reported_heading", "magnetic_heading"}
            and names & {"reported_airspeed", "mach", "indicated_airspeed"}
            and names >= {"ground_speed", "track"}
        )
    )


def _absent(wanted: str, names: list[str], text: str, free: list[str] | None = None) -> InputError:
    stem = recognised(wanted)[0]
    stems = {name: recognised(name)[0] for name in (names if free is None else free)}
    near = [name for name, other in stems.items() if stem is not None and other == stem]
    if not near:
        # A column that is known to hold another quantity is not the one that is needed.
        unknown = [name for name, other in stems.items() if free is None or other is None]
        folded = {name.strip().lower(): name for name in unknown if len(name.strip()) > 1}
        # Lower than the library's 0.6: two names of one column often share only a stem.
        close = difflib.get_close_matches(wanted.lower(), list(folded), n=3, cutoff=0.4)
        near = [folded[key] for key in close]
    remedy = (
        "Map the file's own name to it under reports.columns; `airswing inspect FILE` proposes a "
        "mapping"
    )
    if near:
        remedy = f"Nearest there: {', '.join(near)}. " + remedy
    return InputError(text, field=wanted, found=", ".join(names), remedy=remedy)


# --- values -------------------------------------------------------------------------------------

EARLIEST = np.datetime64("1973-01-01", "ns")
"""First year of aircraft reports in the archives that reanalyses use (NCAR ds353.4)."""
_LARGEST_SECONDS = 4.2e9  # the year 2103
JULIAN_DATE_1970 = 2440587.5
"""Julian date of 1970-01-01T00:00."""

LARGEST_ROLL = 5.0  # degrees: limit of a good roll angle in AMDAR and ACARS

# Codes by meaning; the first meaning applies without a code.
_QC = {"missing": "-", "pass": "P PASS PASSED", "fail": "F FAIL FAILED"}
_CODES = {
    "roll_flag": (
        ROLL,
        {"missing": "- M", "good": "G GOOD", "bad": "B BAD", "not_available": "N NOT_AVAILABLE"},
    ),
    "temperature_qc": (QC, _QC),
    "wind_qc": (QC, _QC),
    "phase": (
        PHASE,
        {
            "unknown": "- UNKNOWN",
            "ascent": "ASCENT ASC CLIMB",
            "cruise": "CRUISE LEVEL ENROUTE LVR LVW",
            "descent": "DESCENT DES",
        },
    ),
    "icing": (ICING, {"missing": "- NAN", "off": "0 0.0 FALSE OFF NO", "on": "1 1.0 TRUE ON YES"}),
}
FLAGS = tuple(_CODES)  # flag columns of a table


def possible(time: Times) -> Mask:
    """Return True where a report can have been sent at a time; False for NaT."""
    latest = np.datetime64("now", "ns") + np.timedelta64(1, "D")
    return np.asarray((time >= EARLIEST) & (time < latest))


def parse_times(values: Column, format: str | None = None) -> tuple[Times, Mask]:
    """Read a column of text (in a format of ``strftime``), numbers or timestamps.

    Returns times (report,), NaT where there is none or it cannot be read, whether they are possible
    or not, and a mask (report,) of where no time was given.
    """
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        values = values.dt.tz_convert("UTC").dt.tz_localize(None)
    if np.issubdtype(getattr(values.dtype, "type", object), np.datetime64):
        time = values.to_numpy(dtype="datetime64[ns]")
        return time, np.isnat(time)
    if format is None and pd.api.types.is_numeric_dtype(values.dtype):
        numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
        return _of_numbers(numbers), np.isnan(numbers)
    index, labels = pd.factorize(values)  # many reports share a time, so each text is parsed once
    text = pd.Series(labels, dtype="object").map(lambda label: str(label).strip())
    parsed = pd.to_datetime(text, format=format or "ISO8601", utc=True, errors="coerce")
    time = parsed.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]").copy()
    digits = text.str.fullmatch(r"\d{7,19}(\.\d+)?").to_numpy(dtype=bool)
    if format is None and digits.any():
        time[digits] = _of_numbers(text[digits].to_numpy(dtype=np.float64))
    blank = np.append((text == "").to_numpy(dtype=bool), True)  # the last is that of absent values
    return np.append(time, np.datetime64("NaT", "ns"))[index], blank[index]


def seconds_since_1970(time: Times) -> Floats:
    """Times as float64 seconds since 1970-01-01 UTC."""
    return time.astype("datetime64[ns]").astype(np.int64) / 1e9


def from_epoch(seconds: Floats) -> Times:
    """Seconds since 1970 as times, to the microsecond; NaT for NaN and outside 1970-2103."""
    time = np.full(seconds.shape, np.datetime64("NaT", "ns"))
    is_valid = (seconds >= 0.0) & (seconds < _LARGEST_SECONDS)
    time[is_valid] = np.round(seconds[is_valid] * 1e6).astype(np.int64).view("datetime64[us]")
    return time


def _of_numbers(values: Floats) -> Times:
    notations = []
    for width in (10, 12, 14):
        dates = (values >= 10.0 ** (width - 1)) & (values < 10.0**width)
        if dates.any():
            text = pd.Series(np.where(dates, values, 0.0).astype(np.int64)).astype(str)
            parsed = pd.to_datetime(text, format=COMPACT[width], errors="coerce")
            notations.append(parsed.to_numpy(dtype="datetime64[ns]"))
    notations += [from_epoch(values / scale) for scale in (1e3, 1e6, 1e9)]
    # A float64 of a Julian date resolves 40 microseconds.
    notations.append(from_epoch(np.round((values - JULIAN_DATE_1970) * 86400.0, 3)))
    time = from_epoch(values)
    for candidates in notations:
        better = possible(candidates) & ~possible(time)
        time[better] = candidates[better]
    return time


def numbers(column: Column, factor: float = 1.0, offset: float = 0.0) -> Floats:
    """Numbers of a column times a factor plus an offset; NaN where a value is none."""
    values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    return np.asarray(values * factor + offset)


def roll_flags(roll: Floats) -> NDArray[np.int8]:
    """Flags of roll angles (degrees, either sign): bad beyond :data:`LARGEST_ROLL`."""
    flags = np.where(np.abs(roll) <= LARGEST_ROLL, ROLL["good"], ROLL["bad"])
    return np.where(np.isnan(roll), ROLL["missing"], flags).astype(np.int8)


def decode_flags(
    values: ArrayLike, flag: str, audit: Audit, *, name: str | None = None
) -> NDArray[np.int8]:
    """Codes (report,) as values of one of :data:`FLAGS`, counted under the name of their field."""
    name = name or flag
    meanings, words = _CODES[flag]
    codes = {code: meanings[word] for word, texts in words.items() for code in texts.split()}
    codes[""] = meanings[next(iter(words))]
    index, labels = pd.factorize(np.asarray(values, dtype=object))
    text = pd.Series([*(str(label).strip() for label in labels), ""])  # the last of absent values
    flags = text.str.upper().map(codes)
    counts = text.replace("", "blank").iloc[index].value_counts()
    audit.codes(name, {str(code): int(number) for code, number in counts.items()})
    audit.repair(f"{name}_unknown_code", flags.isna().iloc[index].sum())
    return np.asarray(flags.fillna(codes[""]), dtype=np.int8)[index]
