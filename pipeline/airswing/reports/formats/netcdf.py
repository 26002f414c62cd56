"""NetCDF reports of aircraft: FSL/MADIS ACARS, and IODA files as JEDI reads them.

MADIS: one hour a file, dimension ``recNum``; flags are bytes that hold ASCII codes; ``altitude`` is
pressure altitude (m); ``heading`` is never read: it is atan2(dlon, dlat) of the last leg. Error
flags: ``p`` passed, ``-`` or blank not tested, any other letter failed. ``errorType``: T
temperature, W wind, B both. Later versions add ``<variable>DD``: C, S, V, G passed; X, Q, B failed;
Z not checked. IODA: groups ``MetaData`` and ``ObsValue``, or variables named ``variable@Group``;
``height`` is taken as pressure altitude; 0 to 3 in ``PreQC`` or ``QualityMarker`` are usable.

Sources: attributes and variable list of MADIS ACARS; JEDI, "Naming conventions" (2022).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PLATFORM, QC
from airswing.products.damaged_netcdf import require_sound
from airswing.reports.audit import Audit
from airswing.reports.columns import (
    ONLY,
    Mapped,
    conversion,
    decode_flags,
    from_epoch,
    parse_times,
)
from airswing.reports.formats import LARGEST_FILE, ReportFormat, content_of

_NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF\r\n\x1a\n")  # first bytes
_BEST_PACKING = 1100  # Deflate packs no better than one in 1,032

# MADIS
_DIMENSION = "recNum"
_MADIS_TAILS = ("en_tailNumber", "tailNumber")  # best first
_REQUIRED = ("timeObs", "latitude", "longitude", "altitude", "windDir", "windSpeed")
_MADIS_NUMBERS = {  # all in SI units and degrees
    "latitude": "latitude",
    "longitude": "longitude",
    "altitude": "pressure_altitude",
    "windDir": "wind_direction",
    "windSpeed": "wind_speed",
    "temperature": "air_temperature",
    "trueAirSpeed": "reported_airspeed",
}
# Data streams by the code of ``dataSource``, as in its attributes.
_STREAMS = {0.0: "ACARS", 1.0: "MDCRS", 2.0: "MDCRS", 3.0: "AMDAR", 4.0: "TAMDAR", 5.0: "AMDAR"}
_FLAG_FIELDS = (  # whose codes are counted
    *("dataDescriptor", "errorType", "rollFlag", "waterVaporQC", "interpolatedTime"),
    *("interpolatedLL", "tempError", "windDirError", "windSpeedError", "speedError"),
    *("bounceError", "correctedFlag", "rollQuality", "phaseFlight", "sounding_flag"),
    *("icingCondition", "icingError", "trueAirSpeedError", "temperatureDD", "windDirDD"),
    *("windSpeedDD", "altitudeDD", "latitudeDD", "longitudeDD", "timeObsDD", "trueAirSpeedDD"),
)
_LARGEST_MADIS, _LARGEST_IODA = 99990.0, 1e30  # fill values are 99999 and more than 1e30
_DESCRIPTOR_FAILED = ("X", "Q", "B")

# IODA
_IODA_TAILS = (
    *("aircraftTailNumber", "aircraftIdentifier", "aircraftRegistrationNumber"),
    *("stationIdentification", "station_id", "aircraftFlightNumber"),
)
_IODA_NUMBERS = {
    "pressure": ("pressure", "air_pressure"),
    "pressure_altitude": ("height", "altitude", "aircraftAltitude"),
    "latitude": ("latitude",),
    "longitude": ("longitude",),
    "eastward_wind": ("windEastward", "eastward_wind"),
    "northward_wind": ("windNorthward", "northward_wind"),
    "air_temperature": ("airTemperature", "air_temperature"),
}
_META = ("pressure", "pressure_altitude", "latitude", "longitude")  # in the group MetaData
_LARGEST_GOOD = 3.0

Variable: TypeAlias = "netCDF4.Variable[np.generic]"


@contextmanager
def _open_netcdf(path: Path) -> Iterator[netCDF4.Dataset]:
    """Open a file, compressed or not, without masks; refuse impossible sizes of variables."""
    require_sound(path)
    with path.open("rb") as binary:
        packed = binary.read(2) in (b"\x1f\x8b", b"BZ")
    with netCDF4.Dataset(path, memory=content_of(path) if packed else None) as file:
        file.set_auto_mask(False)
        # Damaged headers name variables larger than what can be compressed into the file.
        most = max(LARGEST_FILE, _BEST_PACKING * path.stat().st_size)
        for name, variable in file.variables.items():
            size = math.prod(variable.shape) * getattr(variable.dtype, "itemsize", 1)
            if size > most:
                where = f"in a file of {path.stat().st_size:,}"
                raise InputError(f"damaged: a variable of {size:,} bytes {where}", field=name)
        yield file


def _numbers(variable: Variable, largest: float, above: float = -np.inf) -> NDArray[np.float64]:
    """Numbers of a variable, NaN where its fill value, not above the least or too large."""
    numbers = np.asarray(variable[:]).reshape(-1).astype(np.float64)
    fill = float(getattr(variable, "_FillValue", np.nan))
    # Without NaN, for which both comparisons are false.
    is_valid = (np.abs(numbers) < largest) & (numbers > above) & (numbers != fill)
    return np.where(is_valid, numbers, np.nan)


def _strings(variable: Variable) -> list[str]:
    """Text of each report: characters along the last dimensions, strings, or whole numbers."""
    values = np.asarray(variable[:])
    if values.dtype.kind == "S":
        rows = np.ascontiguousarray(values.reshape(values.shape[0], -1))
        texts = [row.tobytes().decode("ascii", "replace") for row in rows]
    else:
        texts = [str(value) for value in values]
    return [text.split("\x00")[0].strip() for text in texts]


def _letters(variable: Variable) -> NDArray[np.str_]:
    """Bytes of ASCII codes (int8, int, S1 or str) as text; numbers over 127 in decimal."""

    def letter(value: bytes | str | float) -> str:
        if isinstance(value, bytes | str):
            return (value if isinstance(value, str) else value.decode("ascii", "replace")).strip()
        return chr(int(value)).strip() if 32 <= value < 127 else f"{value:.0f}" * (value > 127)

    index, labels = pd.factorize(np.asarray(variable[:]).reshape(-1))
    return np.array([letter(label) for label in labels.tolist()], dtype=np.str_)[index]


def _read_madis(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with _open_netcdf(path) as file:
        yield _madis(file, audit)


def _madis(file: netCDF4.Dataset, audit: Audit) -> pd.DataFrame:
    there = file.variables
    tail = next((name for name in _MADIS_TAILS if name in there), None)
    absent = [name for name in _REQUIRED if name not in there]
    if _DIMENSION not in file.dimensions or absent or tail is None:
        absent += [] if tail else [_MADIS_TAILS[0]]
        names = [*there, *(f"group {name}" for name in file.groups)]
        raise InputError(
            "is not a MADIS ACARS file",
            field=", ".join(absent) or _DIMENSION,
            found=f"variables {', '.join(names[:20])}",
            remedy="Reports in NetCDF must have the variables of FSL/MADIS ACARS or of IODA; name "
            "a file of model winds under references",
        )
    size = file.dimensions[_DIMENSION].size
    if not size:
        raise InputError("holds no reports")

    def column(name: str) -> Variable:
        dimensions, shape = there[name].dimensions, there[name].shape
        if dimensions[:1] != (_DIMENSION,) or math.prod(shape) != size:
            dimensions_text = f"dimensions ({', '.join(dimensions)}), shape {shape}"
            raise InputError("is not one value a report", field=name, found=dimensions_text)
        return there[name]

    def number(name: str) -> NDArray[np.float64]:
        if not np.issubdtype(there[name].dtype, np.number):
            raise InputError("holds no numbers", field=name, found=f"type {there[name].dtype}")
        if name == "timeObs":
            return _numbers(column(name), np.inf, above=0.0)
        return _numbers(column(name), _LARGEST_MADIS)

    flags = {name: _letters(column(name)) for name in _FLAG_FIELDS if name in there}
    for name, values in flags.items():
        if name != "rollFlag":
            audit.codes(name, Counter(value or "blank" for value in values.tolist()))
    seconds, blank = number("timeObs"), np.full(size, "")
    raw: dict[str, object] = {
        "tail": _strings(there[tail]),
        "time": from_epoch(seconds),
        "time_blank": ~(seconds > 0.0),  # an impossibly late time is unparsable, not blank
        **{ours: number(name) for name, ours in _MADIS_NUMBERS.items() if name in there},
        "roll_flag": decode_flags(
            flags.get("rollFlag", blank), "roll_flag", audit, name="rollFlag"
        ),
    }
    if "flight" in there and there["flight"].dimensions[:1] == (_DIMENSION,):
        raw["flight"] = _strings(there["flight"])
    streams = [""] * size
    if "dataSource" in there:
        streams = [_STREAMS.get(code, "") for code in number("dataSource").tolist()]
        raw[f"{ONLY}source"] = streams
    # Names of streams in assimilation systems; MDCRS is ACARS of the U.S. carriers.
    raw["platform"] = np.array(
        [PLATFORM[name if name in ("TAMDAR", "AMDAR") else "ACARS"] for name in streams], np.int8
    )
    kind = flags.get("errorType", blank)
    # X does not state which quantity failed: both are marked.
    failed_alone = (flags.get("dataDescriptor", blank) == "X") & ~np.isin(kind, ("T", "W", "B"))
    for ours, letter, variables in (
        ("temperature_qc", "T", ("temp", "temperature")),
        ("wind_qc", "W", ("windDir", "windSpeed")),
    ):
        passed, failed = np.zeros(size, dtype=bool), failed_alone | np.isin(kind, (letter, "B"))
        for name in variables:
            error = np.char.lower(flags.get(f"{name}Error", blank))
            descriptor = flags.get(f"{name}DD", blank)
            passed |= (error == "p") | ~np.isin(descriptor, ("", "-", "Z", *_DESCRIPTOR_FAILED))
            failed |= ~np.isin(error, ("p", "-", "")) | np.isin(descriptor, _DESCRIPTOR_FAILED)
        codes = [QC[name] for name in ("fail", "pass", "missing")]
        raw[ours] = np.select([failed, passed], codes[:2], codes[2]).astype(np.int8)
    return pd.DataFrame(raw)


def _read_ioda(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with _open_netcdf(path) as file:
        inside = [(group, *item) for group in file.groups for item in file[group].variables.items()]
        every = {f"{name}@{group}": variable for group, name, variable in inside} | file.variables
        there = ", ".join([*file.variables, *(f"{group}/{name}" for group, name, _ in inside)][:30])

        def first(group: str, names: tuple[str, ...]) -> Variable | None:
            return next((every[key] for n in names if (key := f"{n}@{group}") in every), None)

        times = first("MetaData", ("dateTime", "datetime", "time"))
        variables = {
            ours: variable
            for ours, names in _IODA_NUMBERS.items()
            if (variable := first("MetaData" if ours in _META else "ObsValue", names)) is not None
        }
        absent = [name for name in ("latitude", "longitude") if name not in variables]
        absent += [] if times is not None else ["dateTime"]
        absent += [] if variables.keys() & {"pressure", "pressure_altitude"} else ["pressure"]
        if absent or times is None:
            problem = "is an IODA file without a variable that is needed in MetaData"
            raise InputError(problem, field=", ".join(absent), found=there)
        if not variables.keys() & {"eastward_wind", "air_temperature"}:
            problem = "is an IODA file without winds or temperatures in ObsValue"
            raise InputError(problem, found=there, remedy="Name a file of aircraft observations")
        raw: dict[str, object] = {ours: _numbers(v, _LARGEST_IODA) for ours, v in variables.items()}
        if times.dtype is str or np.dtype(times.dtype).kind in "SU":
            raw["time"], raw["time_blank"] = parse_times(pd.Series(_strings(times), dtype=object))
        else:
            units = getattr(times, "units", "seconds since 1970-01-01")
            unit, _, epoch = units.partition(" since ")
            start = pd.to_datetime(epoch.strip(), utc=True).timestamp()
            seconds = _numbers(times, _LARGEST_IODA) * conversion(unit, "s")[0] + start
            raw["time"], raw["time_blank"] = from_epoch(seconds), np.isnan(seconds)
        flight = first("MetaData", ("aircraftFlightNumber",))
        named = first("MetaData", _IODA_TAILS)
        raw["tail"] = path.name.split(".")[0] if named is None else _strings(named)
        if named is None and "tail" not in mapping:
            audit.remark(f"{path.name} does not name the aircraft: all reports count as one")
        if flight is not None:
            raw["flight"] = _strings(flight)
        for ours, name in (("wind_qc", "eastward_wind"), ("temperature_qc", "air_temperature")):
            for group in ("PreQC", "QualityMarker"):
                if (codes := first(group, _IODA_NUMBERS[name])) is not None:
                    fails = _numbers(codes, _LARGEST_IODA) > _LARGEST_GOOD
                    raw[ours] = np.where(fails, QC["fail"], QC["missing"])
        yield pd.DataFrame(raw)


FORMATS = (
    ReportFormat(
        "ioda",
        lambda start: start.startswith(_NETCDF) and (b"MetaData" in start or b"ObsValue" in start),
        _read_ioda,
        title="NetCDF",
    ),
    ReportFormat("madis", lambda start: start.startswith(_NETCDF), _read_madis, 1, "NetCDF"),
)
