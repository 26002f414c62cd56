"""FSL/MADIS ACARS NetCDF.

Assumptions
-----------
One hour a file, dimension ``recNum``; flags are bytes that hold ASCII codes; ``altitude`` is
pressure altitude (m); ``timeObs`` is seconds since 1970. Files that other programs wrote again may
hold text as strings or with a further dimension of one, and numbers of any numeric type.
``heading`` is never read: it is atan2(dlon, dlat) of the last leg, neither heading nor track.

Codes
-----
Error flags (``tempError``, ``windDirError``, ``windSpeedError``): ``p`` passed, ``-`` or blank not
tested, any other letter failed (real files hold letters that their units text does not list, such
as H and D). ``errorType``: T temperature, W wind, B both. ``dataDescriptor`` X without an error
type fails both. Later versions add ``<variable>DD``: C, S, V, G passed; X, Q, B failed; Z not
checked. The codes of every flag field are counted, ``correctedFlag`` among them (f: longitude and
wind direction flipped, t: time set to the receipt, T, l: temperature, position corrected).

References
----------
The attributes of the files (title "ACARS data, encrypted tail numbers, version 2.1"); MADIS ACARS
variable list, madis.noaa.gov.
"""

from __future__ import annotations

import math
import zlib
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
from airswing.flags import PLATFORM, TEMPERATURE_QC
from airswing.products.damaged_netcdf import require_sound
from airswing.reports.audit import Audit
from airswing.reports.columns import ONLY, Mapped
from airswing.reports.formats import (
    LARGEST_FILE,
    ReportFormat,
    compression_of,
    content_of,
    register,
)
from airswing.reports.values import FLAG_CODES, decode_flags, from_epoch

NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF\r\n\x1a\n")
"""First bytes of NetCDF files."""
DIMENSION = "recNum"
TAILS = ("en_tailNumber", "tailNumber")
"""Variables that may hold the aircraft, best first."""
REQUIRED = ("timeObs", "latitude", "longitude", "altitude", "windDir", "windSpeed")
# All are in SI units and degrees.
NUMBERS = {
    "latitude": "latitude",
    "longitude": "longitude",
    "altitude": "pressure_altitude",
    "windDir": "wind_direction",
    "windSpeed": "wind_speed",
    "temperature": "air_temperature",
    "trueAirSpeed": "reported_airspeed",
}
# Data streams by the code of ``dataSource``, as in its attributes.
SOURCES = {0.0: "ACARS", 1.0: "MDCRS", 2.0: "MDCRS", 3.0: "AMDAR", 4.0: "TAMDAR", 5.0: "AMDAR"}
# As assimilation systems call a stream; MDCRS is ACARS as the U.S. carriers send it.
PLATFORM_OF = {
    "TAMDAR": PLATFORM["TAMDAR"],
    "AMDAR": PLATFORM["AMDAR"],
    **dict.fromkeys(("ACARS", "MDCRS", ""), PLATFORM["ACARS"]),
}
FLAG_FIELDS = (
    *("dataDescriptor", "errorType", "rollFlag", "waterVaporQC", "interpolatedTime"),
    *("interpolatedLL", "tempError", "windDirError", "windSpeedError", "speedError"),
    *("bounceError", "correctedFlag", "rollQuality", "phaseFlight", "sounding_flag"),
    *("icingCondition", "icingError", "trueAirSpeedError", "temperatureDD", "windDirDD"),
    *("windSpeedDD", "altitudeDD", "latitudeDD", "longitudeDD", "timeObsDD", "trueAirSpeedDD"),
)
"""Fields whose codes are counted."""
_BEST_PACKING = 1100  # Deflate packs no better than one in 1,032
_LARGEST = 99990.0  # the fill value is 99999 in every version
_NOT_TESTED = ("", "-", "Z")
_DESCRIPTOR_FAILED = ("X", "Q", "B")

Flags = dict[str, NDArray[np.str_]]
Variable: TypeAlias = "netCDF4.Variable[np.generic]"


def _read_madis(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with open_netcdf(path) as file:
        yield _raw(file, path, audit)


@contextmanager
def open_netcdf(path: Path) -> Iterator[netCDF4.Dataset]:
    """Open a NetCDF file, compressed or not, that is whole and no larger than it can be.

    Values are not masked. Errors of the library become an InputError.
    """
    try:
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
                        f"damaged: a variable of {size:,} bytes in a file of "
                        f"{path.stat().st_size:,}",
                        file=path,
                        field=name,
                    )
            yield file
    except (OSError, RuntimeError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be read as NetCDF: {error}", file=path) from error


def _raw(file: netCDF4.Dataset, path: Path, audit: Audit) -> pd.DataFrame:
    tail = next((name for name in TAILS if name in file.variables), None)
    absent = [name for name in REQUIRED if name not in file.variables]
    if DIMENSION not in file.dimensions or absent or tail is None:
        absent += [] if tail else [TAILS[0]]
        names = [*file.variables, *(f"group {name}" for name in file.groups)]
        raise InputError(
            "is no MADIS ACARS file",
            file=path,
            field=", ".join(absent) or DIMENSION,
            found=f"variables {', '.join(names[:20])}",
            remedy="Reports in NetCDF must have the variables of FSL/MADIS ACARS or of IODA; name "
            "a file of model winds under references",
        )
    if not file.dimensions[DIMENSION].size:
        raise InputError("holds no reports", file=path)
    flags = {
        name: characters(_column(file[name], path))
        for name in FLAG_FIELDS
        if name in file.variables
    }
    seconds = _number(file["timeObs"], path)
    raw: dict[str, object] = {
        "tail": strings(file[tail]),
        "time": from_epoch(seconds),
        "time_blank": ~(seconds > 0.0),  # a time too late is unparsable, not blank
        **{
            ours: _number(file[name], path)
            for name, ours in NUMBERS.items()
            if name in file.variables
        },
    }
    if "flight" in file.variables and file["flight"].dimensions[:1] == (DIMENSION,):
        raw["flight"] = strings(file["flight"])
    streams = [""] * seconds.size
    if "dataSource" in file.variables:
        codes = _number(file["dataSource"], path)
        streams = raw[f"{ONLY}source"] = [SOURCES.get(code, "") for code in codes.tolist()]
    raw["platform"] = np.array([PLATFORM_OF[stream] for stream in streams], dtype=np.int8)
    for name, values in flags.items():
        if name != "rollFlag":
            audit.codes(name, Counter(value or "blank" for value in values.tolist()))
    roll, missing = FLAG_CODES["roll_flag"]
    blank = np.full(seconds.size, "")
    raw["roll_flag"] = decode_flags(
        flags.get("rollFlag", blank), roll, missing, name="rollFlag", audit=audit
    )
    raw["temperature_qc"] = _quality(flags, blank, ("tempError",), ("temperatureDD",), "T")
    errors, descriptors = ("windDirError", "windSpeedError"), ("windDirDD", "windSpeedDD")
    raw["wind_qc"] = _quality(flags, blank, errors, descriptors, "W")
    return pd.DataFrame(raw)


def _column(variable: Variable, path: Path) -> NDArray[np.generic]:
    """One value a report, without a further dimension of one."""
    values = np.asarray(variable[:])
    reports = variable.group().dimensions[DIMENSION].size
    if variable.dimensions[:1] != (DIMENSION,) or values.size != reports:
        raise InputError(
            "is not one value a report",
            file=path,
            field=variable.name,
            found=f"dimensions ({', '.join(variable.dimensions)}), shape {values.shape}",
        )
    return values.reshape(reports)


def _number(variable: Variable, path: Path) -> NDArray[np.float64]:
    if not np.issubdtype(variable.dtype, np.number):
        raise InputError(
            "holds no numbers", file=path, field=variable.name, found=f"type {variable.dtype}"
        )
    values = _column(variable, path).astype(np.float64)
    fill = getattr(variable, "_FillValue", None)
    # Negated, so that NaN is absent too.
    absent = ~(np.abs(values) < _LARGEST) if variable.name != "timeObs" else ~(values > 0.0)
    if fill is not None:
        absent |= values == float(fill)
    return np.where(absent, np.nan, values)


def characters(values: NDArray[np.generic]) -> NDArray[np.str_]:
    """Turn bytes of ASCII codes (int8, int, S1 or str) into one-character strings.

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


def strings(variable: Variable) -> list[str]:
    """Text of each report: characters along the last dimensions, strings, or whole numbers."""
    values = np.asarray(variable[:])
    if values.dtype.kind == "S":
        rows = np.ascontiguousarray(values.reshape(values.shape[0], -1))
        texts = [row.tobytes().decode("ascii", "replace") for row in rows]
    else:
        texts = [str(value) for value in values]
    return [text.split("\x00")[0].strip() for text in texts]


def _quality(
    flags: Flags,
    blank: NDArray[np.str_],
    errors: tuple[str, ...],
    descriptors: tuple[str, ...],
    kind_of_error: str,
) -> NDArray[np.int8]:
    passed, failed = np.zeros(blank.size, dtype=bool), np.zeros(blank.size, dtype=bool)
    for name in errors:
        if name in flags:
            passed |= np.char.lower(flags[name]) == "p"
            failed |= ~np.isin(np.char.lower(flags[name]), ("p", "-", ""))
    for name in descriptors:
        if name in flags:
            passed |= ~np.isin(flags[name], (*_NOT_TESTED, *_DESCRIPTOR_FAILED))
            failed |= np.isin(flags[name], _DESCRIPTOR_FAILED)
    kind = flags.get("errorType", blank)
    failed |= np.isin(kind, (kind_of_error, "B"))
    if "dataDescriptor" in flags:
        # X alone does not say what failed: both, then.
        failed |= (flags["dataDescriptor"] == "X") & ~np.isin(kind, ("T", "W", "B"))
    quality = np.where(passed, TEMPERATURE_QC["pass"], TEMPERATURE_QC["missing"])
    return np.where(failed, TEMPERATURE_QC["fail"], quality).astype(np.int8)


register(ReportFormat("madis", lambda start: start.startswith(NETCDF), _read_madis, priority=1))
