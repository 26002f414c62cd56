"""NetCDF reports of aircraft: FSL/MADIS ACARS, and IODA files as JEDI reads them.

MADIS
    One hour a file, dimension ``recNum``; flags are bytes that hold ASCII codes; ``altitude`` is
    pressure altitude (m). ``heading`` is never read: it is atan2(dlon, dlat) of the last leg.
    Error flags: ``p`` passed, ``-`` or blank not tested, any other letter failed. ``errorType``: T
    temperature, W wind, B both; ``dataDescriptor`` X without an error type fails both. Later
    versions add ``<variable>DD``: C, S, V, G passed; X, Q, B failed; Z not checked.
IODA
    Groups ``MetaData`` and ``ObsValue``, or variables named ``variable@Group``. The level is
    ``pressure`` (Pa), else ``height`` (m; taken as pressure altitude). A value of ``PreQC`` or
    ``QualityMarker`` above 3 fails the wind (PREPBUFR: 0 to 3 usable).

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
from airswing.flags import PLATFORM, TEMPERATURE_QC, WIND_QC
from airswing.products.damaged_netcdf import require_sound
from airswing.reports.audit import Audit
from airswing.reports.columns import ONLY, Mapped
from airswing.reports.formats import (
    LARGEST_FILE,
    ReportFormat,
    compression_of,
    constant_tail,
    content_of,
    register,
)
from airswing.reports.values import decode_flags, from_epoch, parse_times

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
    *("stationIdentification", "station_id"),
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
_META = ("pressure", "pressure_altitude", "latitude", "longitude")
_LARGEST_GOOD = 3.0

Flags = dict[str, NDArray[np.str_]]
Variable: TypeAlias = "netCDF4.Variable[np.generic]"


@contextmanager
def _open_netcdf(path: Path) -> Iterator[netCDF4.Dataset]:
    """Open a file, compressed or not, that is whole and no larger than it can be; no masks."""
    require_sound(path)
    if compression_of(path) is None:
        file = netCDF4.Dataset(path)
    else:
        file = netCDF4.Dataset(path.name, memory=content_of(path))
    with file:
        file.set_auto_mask(False)
        # Damaged headers name variables larger than what can be compressed into the file.
        most = max(LARGEST_FILE, _BEST_PACKING * path.stat().st_size)
        for name, variable in file.variables.items():
            size = math.prod(variable.shape) * getattr(variable.dtype, "itemsize", 1)
            if size > most:
                raise InputError(
                    f"damaged: a variable of {size:,} bytes in a file of {path.stat().st_size:,}",
                    file=path,
                    field=name,
                )
        yield file


def _numbers(
    values: NDArray[np.generic], variable: Variable, largest: float, *, above: float = -np.inf
) -> NDArray[np.float64]:
    """Numbers of a variable, NaN where its fill value, not above the least or too large."""
    numbers = values.astype(np.float64)
    fill = getattr(variable, "_FillValue", None)
    # Negated, so that NaN is absent too.
    absent = ~((np.abs(numbers) < largest) & (numbers > above))
    if fill is not None:
        absent |= numbers == float(fill)
    return np.where(absent, np.nan, numbers)


def _strings(variable: Variable) -> list[str]:
    """Text of each report: characters along the last dimensions, strings, or whole numbers."""
    values = np.asarray(variable[:])
    if values.dtype.kind == "S":
        rows = np.ascontiguousarray(values.reshape(values.shape[0], -1))
        texts = [row.tobytes().decode("ascii", "replace") for row in rows]
    else:
        texts = [str(value) for value in values]
    return [text.split("\x00")[0].strip() for text in texts]


def _read_madis(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with _open_netcdf(path) as file:
        yield _madis(file, path, audit)


def _madis(file: netCDF4.Dataset, path: Path, audit: Audit) -> pd.DataFrame:
    tail = next((name for name in _MADIS_TAILS if name in file.variables), None)
    absent = [name for name in _REQUIRED if name not in file.variables]
    if _DIMENSION not in file.dimensions or absent or tail is None:
        absent += [] if tail else [_MADIS_TAILS[0]]
        names = [*file.variables, *(f"group {name}" for name in file.groups)]
        raise InputError(
            "is no MADIS ACARS file",
            file=path,
            field=", ".join(absent) or _DIMENSION,
            found=f"variables {', '.join(names[:20])}",
            remedy="Reports in NetCDF must have the variables of FSL/MADIS ACARS or of IODA; name "
            "a file of model winds under references",
        )
    size = file.dimensions[_DIMENSION].size
    if not size:
        raise InputError("holds no reports", file=path)

    def column(name: str) -> NDArray[np.generic]:
        """One value a report, without a further dimension of one."""
        values = np.asarray(file[name][:])
        if file[name].dimensions[:1] != (_DIMENSION,) or values.size != size:
            raise InputError(
                "is not one value a report",
                file=path,
                field=name,
                found=f"dimensions ({', '.join(file[name].dimensions)}), shape {values.shape}",
            )
        return values.reshape(size)

    def number(name: str) -> NDArray[np.float64]:
        if not np.issubdtype(file[name].dtype, np.number):
            found = f"type {file[name].dtype}"
            raise InputError("holds no numbers", file=path, field=name, found=found)
        if name == "timeObs":
            return _numbers(column(name), file[name], np.inf, above=0.0)
        return _numbers(column(name), file[name], _LARGEST_MADIS)

    there = set(file.variables)
    flags = {name: _characters(column(name)) for name in _FLAG_FIELDS if name in there}
    for name, values in flags.items():
        if name != "rollFlag":
            audit.codes(name, Counter(value or "blank" for value in values.tolist()))
    seconds = number("timeObs")
    raw: dict[str, object] = {
        "tail": _strings(file[tail]),
        "time": from_epoch(seconds),
        "time_blank": ~(seconds > 0.0),  # a time too late is unparsable, not blank
        **{ours: number(name) for name, ours in _MADIS_NUMBERS.items() if name in there},
    }
    if "flight" in there and file["flight"].dimensions[:1] == (_DIMENSION,):
        raw["flight"] = _strings(file["flight"])
    streams = [""] * size
    if "dataSource" in there:
        streams = [_STREAMS.get(code, "") for code in number("dataSource").tolist()]
        raw[f"{ONLY}source"] = streams
    # As assimilation systems call a stream; MDCRS is ACARS as the U.S. carriers send it.
    raw["platform"] = np.array(
        [PLATFORM[name if name in ("TAMDAR", "AMDAR") else "ACARS"] for name in streams], np.int8
    )
    blank = np.full(size, "")
    raw["roll_flag"] = decode_flags(
        flags.get("rollFlag", blank), "roll_flag", audit, name="rollFlag"
    )
    raw["temperature_qc"] = _quality(flags, blank, ("temp", "temperature"), "T")
    raw["wind_qc"] = _quality(flags, blank, ("windDir", "windSpeed"), "W")
    return pd.DataFrame(raw)


def _characters(values: NDArray[np.generic]) -> NDArray[np.str_]:
    """Bytes of ASCII codes (int8, int, S1 or str) as one-character strings.

    Blank where the byte is no printable character; numbers over 127 in decimal.
    """
    if values.dtype.kind == "S":
        return np.char.strip(np.char.decode(values.astype(np.bytes_), "ascii", "replace"))
    if values.dtype.kind in "OU":
        return np.char.strip(values.astype(np.str_))
    codes, index = np.unique(values, return_inverse=True)
    labels = [
        chr(code).strip() if 32 <= code < 127 else str(code) if code > 127 else ""
        for code in codes.astype(int).tolist()
    ]
    return np.array(labels, dtype=np.str_)[index]


def _quality(
    flags: Flags, blank: NDArray[np.str_], variables: tuple[str, ...], kind_of_error: str
) -> NDArray[np.int8]:
    passed, failed = np.zeros(blank.size, dtype=bool), np.zeros(blank.size, dtype=bool)
    for name in variables:
        if (error := flags.get(f"{name}Error")) is not None:
            passed |= np.char.lower(error) == "p"
            failed |= ~np.isin(np.char.lower(error), ("p", "-", ""))
        if (descriptor := flags.get(f"{name}DD")) is not None:
            passed |= ~np.isin(descriptor, ("", "-", "Z", *_DESCRIPTOR_FAILED))
            failed |= np.isin(descriptor, _DESCRIPTOR_FAILED)
    kind = flags.get("errorType", blank)
    failed |= np.isin(kind, (kind_of_error, "B"))
    if "dataDescriptor" in flags:
        # X alone does not say what failed: both, then.
        failed |= (flags["dataDescriptor"] == "X") & ~np.isin(kind, ("T", "W", "B"))
    quality = np.where(passed, TEMPERATURE_QC["pass"], TEMPERATURE_QC["missing"])
    return np.where(failed, TEMPERATURE_QC["fail"], quality).astype(np.int8)


def _read_ioda(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with _open_netcdf(path) as file:
        every = dict(file.variables)
        for group in file.groups:
            inside = file[group].variables.items()
            every = {f"{name}@{group}": variable for name, variable in inside} | every
        names = [*file.variables, *(f"{g}/{n}" for g in file.groups for n in file[g].variables)]
        there = ", ".join(names[:30])

        def first(group: str, names: tuple[str, ...]) -> Variable | None:
            return next((every[key] for n in names if (key := f"{n}@{group}") in every), None)

        def number(variable: Variable) -> NDArray[np.float64]:
            return _numbers(np.asarray(variable[:]).reshape(-1), variable, _LARGEST_IODA)

        times = first("MetaData", ("dateTime", "datetime", "time"))
        found = {
            ours: variable
            for ours, names in _IODA_NUMBERS.items()
            if (variable := first("MetaData" if ours in _META else "ObsValue", names)) is not None
        }
        absent = [name for name in ("latitude", "longitude") if name not in found]
        absent += [] if times is not None else ["dateTime"]
        absent += [] if found.keys() & {"pressure", "pressure_altitude"} else ["pressure"]
        if absent or times is None:
            raise InputError(
                "is an IODA file without a variable that is needed in MetaData",
                file=path,
                field=", ".join(absent),
                found=there,
            )
        if not found.keys() & {"eastward_wind", "air_temperature"}:
            raise InputError(
                "is an IODA file without winds or temperatures in ObsValue",
                file=path,
                found=there,
                remedy="Name a file of aircraft observations",
            )
        raw: dict[str, object] = {ours: number(variable) for ours, variable in found.items()}
        if times.dtype is str or np.dtype(times.dtype).kind in "SU":
            raw["time"], raw["time_blank"] = parse_times(pd.Series(_strings(times), dtype=object))
        else:
            seconds = _seconds(times, number(times))
            raw["time"], raw["time_blank"] = from_epoch(seconds), np.isnan(seconds)
        tail, flight = first("MetaData", _IODA_TAILS), first("MetaData", ("aircraftFlightNumber",))
        named = tail if tail is not None else flight
        if constant := constant_tail(mapping):
            raw["tail"] = constant
        elif named is not None:
            raw["tail"] = _strings(named)
        else:
            raw["tail"] = path.name.split(".")[0]
            audit.remark(f"{path.name} does not name the aircraft: its reports are taken as of one")
        if flight is not None:
            raw["flight"] = _strings(flight)
        for group in ("PreQC", "QualityMarker"):
            if (codes := first(group, _IODA_NUMBERS["eastward_wind"])) is not None:
                fails = number(codes) > _LARGEST_GOOD
                raw["wind_qc"] = np.where(fails, WIND_QC["fail"], WIND_QC["missing"])
        yield pd.DataFrame(raw)


def _seconds(variable: Variable, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seconds since 1970 of times in CF units."""
    unit, _, epoch = getattr(variable, "units", "seconds since 1970-01-01").partition(" since ")
    length = {"seconds": 1.0, "minutes": 60.0, "hours": 3600.0, "days": 86400.0}[unit.strip()]
    start = pd.Timestamp(epoch.strip())
    start = start.tz_convert(None) if start.tzinfo else start
    return np.asarray(values * length + start.timestamp())


def _is_ioda(start: bytes) -> bool:
    return start.startswith(_NETCDF) and (b"MetaData" in start or b"ObsValue" in start)


register(ReportFormat("ioda", _is_ioda, _read_ioda, title="NetCDF"))
register(ReportFormat("madis", lambda s: s.startswith(_NETCDF), _read_madis, 1, "NetCDF"))
