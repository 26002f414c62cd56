"""FSL/MADIS ACARS NetCDF: the file's own codes to raw pieces.

Assumptions
-----------
One hour a file, dimension ``recNum``; flags are bytes that hold ASCII codes; ``altitude`` is
pressure altitude (m); ``timeObs`` is seconds since 1970. Files may be gzip-compressed. Files that
other programs wrote again may hold text as strings or with a dimension of one more, and numbers in
any numeric type. ``heading`` is never read: it is atan2(dlon, dlat) of the last leg, neither
heading nor track.

Codes
-----
Error flags (``tempError``, ``windDirError``, ``windSpeedError``): ``p`` passed, ``-`` or blank
not tested, any letter failed (the real files hold letters their own units text leaves out, such
as H and D). ``errorType``: T temperature, W wind, B both. ``dataDescriptor`` X without an error
type fails both. Later versions add ``<variable>DD``: C, S, V, G passed; X, Q, B failed; Z not
checked. Every code of every flag field is tallied, ``correctedFlag`` among them (f: longitude and
wind direction flipped, t: time set to the receipt, T, l: temperature, position corrected).

References
----------
The attributes of the files (title "ACARS data, encrypted tail numbers, version 2.1"); MADIS ACARS
variable list, madis.noaa.gov.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PLATFORM, ROLL, TEMPERATURE_QC
from airswing.products.classic_netcdf import require_whole
from airswing.products.openable import require_openable
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.codes import BLANK, ROLL_CODES, decode_flags
from airswing.reports.canonical.columns import ONLY
from airswing.reports.canonical.report_formats import Mapped, ReportFormat, register
from airswing.reports.canonical.times import from_epoch

DIMENSION = "recNum"
TAILS = ("en_tailNumber", "tailNumber")
"""Variables that may hold the aircraft, best first."""
REQUIRED = ("timeObs", "latitude", "longitude", "altitude", "windDir", "windSpeed")
# Their variable to the piece's column; units are SI and degrees already.
NUMBERS = {
    "latitude": "latitude",
    "longitude": "longitude",
    "altitude": "pressure_altitude",
    "windDir": "wind_direction",
    "windSpeed": "wind_speed",
    "temperature": "air_temperature",
    "trueAirSpeed": "reported_airspeed",
}
# Data streams by the code of ``dataSource``: the files say so in its attributes.
SOURCES = {0.0: "ACARS", 1.0: "MDCRS", 2.0: "MDCRS", 3.0: "AMDAR", 4.0: "TAMDAR", 5.0: "AMDAR"}
# What assimilation systems know a stream by; MDCRS is ACARS as the U.S. carriers send it.
PLATFORM_OF = {
    "TAMDAR": PLATFORM["TAMDAR"],
    "AMDAR": PLATFORM["AMDAR"],
    "ACARS": PLATFORM["ACARS"],
    "MDCRS": PLATFORM["ACARS"],
    "": PLATFORM["ACARS"],
}
FLAG_FIELDS = (
    "dataDescriptor",
    "errorType",
    "rollFlag",
    "waterVaporQC",
    "interpolatedTime",
    "interpolatedLL",
    "tempError",
    "windDirError",
    "windSpeedError",
    "speedError",
    "bounceError",
    "correctedFlag",
    "rollQuality",
    "phaseFlight",
    "sounding_flag",
    "icingCondition",
    "icingError",
    "trueAirSpeedError",
    "temperatureDD",
    "windDirDD",
    "windSpeedDD",
    "altitudeDD",
    "latitudeDD",
    "longitudeDD",
    "timeObsDD",
    "trueAirSpeedDD",
)
"""Fields whose codes are tallied."""
_MOST_OCTETS = 1 << 30  # unpacked: few packed octets could fill any memory
_BEST_PACKING = 1100  # Deflate packs no better than one in 1,032
_LARGEST = 99990.0  # the fill value is 99999 in every version
_UNTESTED = (BLANK, "-", "Z")
_DESCRIPTOR_FAILED = ("X", "Q", "B")

Flags = dict[str, NDArray[np.str_]]
Variable: TypeAlias = "netCDF4.Variable[np.generic]"


def _madis_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one MADIS ACARS file."""
    try:
        require_whole(path)
        require_openable(path)
        with _open(path) as file:
            _require_size(file, path)
            file.set_auto_mask(False)
            yield _piece(file, path, audit)
    except (OSError, RuntimeError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be read as NetCDF: {error}", file=path) from error


def _open(path: Path) -> netCDF4.Dataset:
    with path.open("rb") as file:
        # gzip: the hourly files are kept packed.
        if file.read(2) != b"\x1f\x8b":
            return netCDF4.Dataset(path)
    with gzip.open(path, "rb") as packed:
        octets = packed.read(_MOST_OCTETS + 1)
    if len(octets) > _MOST_OCTETS:
        raise InputError(f"unpacks to more than {_MOST_OCTETS:,} octets", file=path)
    return netCDF4.Dataset(path.name, memory=octets)


def _require_size(file: netCDF4.Dataset, path: Path) -> None:
    """Refuse variables far larger than what could be packed into the file: a damaged header."""
    most = max(_MOST_OCTETS, _BEST_PACKING * path.stat().st_size)
    for name, variable in file.variables.items():
        octets = math.prod(map(int, variable.shape)) * getattr(variable.dtype, "itemsize", 1)
        if octets > most:
            raise InputError(
                f"damaged: a variable of {octets:,} octets in a file of {path.stat().st_size:,}",
                file=path,
                field=name,
            )


def _piece(file: netCDF4.Dataset, path: Path, audit: Audit) -> pd.DataFrame:
    tail = next((name for name in TAILS if name in file.variables), None)
    absent = [name for name in REQUIRED if name not in file.variables]
    if DIMENSION not in file.dimensions or absent or tail is None:
        absent += [] if tail else [TAILS[0]]
        raise InputError(
            "is no MADIS ACARS file",
            file=path,
            field=", ".join(absent) or DIMENSION,
            found=f"variables {', '.join(list(file.variables)[:20])}",
            remedy="Reports in NetCDF must have the variables of FSL/MADIS ACARS",
        )
    if not file.dimensions[DIMENSION].size:
        raise InputError("holds no reports", file=path)
    flags = {
        name: characters(_column(file[name], path))
        for name in FLAG_FIELDS
        if name in file.variables
    }
    seconds = _number(file["timeObs"], path)
    piece: dict[str, object] = {
        "tail": _strings(file[tail]),
        "time": from_epoch(seconds),
        "time_blank": ~(seconds > 0.0),  # a time too late is unparsable, not blank
        **{
            ours: _number(file[name], path)
            for name, ours in NUMBERS.items()
            if name in file.variables
        },
    }
    if "flight" in file.variables and file["flight"].dimensions[:1] == (DIMENSION,):
        piece["flight"] = _strings(file["flight"])
    sources = [""] * seconds.size
    if "dataSource" in file.variables:
        codes = _number(file["dataSource"], path)
        sources = piece[f"{ONLY}source"] = [SOURCES.get(code, "") for code in codes.tolist()]
    piece["platform"] = np.array([PLATFORM_OF[source] for source in sources], dtype=np.int8)
    return pd.DataFrame({**piece, **_decoded(flags, seconds.size, audit)})


def _column(variable: Variable, path: Path) -> NDArray[np.generic]:
    """One value a report, a further dimension of one left out."""
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
    labels = [_label(int(code)) for code in codes]
    return np.array(labels, dtype=np.str_)[index]


def _label(code: int) -> str:
    if 32 <= code < 127:  # printable: a letter stored as its number
        return chr(code).strip()
    return BLANK if code <= 0 or code == 127 else str(code)


def _strings(variable: Variable) -> list[str]:
    """Text of each report: characters along the last dimensions, strings, or whole numbers."""
    values = np.asarray(variable[:])
    if values.dtype.kind == "S":
        rows = np.ascontiguousarray(values.reshape(values.shape[0], -1))
        texts = [row.tobytes().decode("ascii", "replace") for row in rows]
    else:
        texts = [str(value) for value in values]
    return [text.split("\x00")[0].strip() for text in texts]


def _decoded(flags: Flags, number: int, audit: Audit) -> dict[str, NDArray[np.int8]]:
    for name, values in flags.items():
        if name != "rollFlag":
            codes, counts = np.unique(values, return_counts=True)
            audit.codes(
                name,
                {str(c) or "blank": int(n) for c, n in zip(codes, counts, strict=True)},
            )
    roll = flags.get("rollFlag", np.full(number, BLANK))
    return {
        "roll_flag": decode_flags(roll, ROLL_CODES, ROLL["missing"], name="rollFlag", audit=audit),
        "temperature_qc": _quality(flags, number, ("tempError",), ("temperatureDD",), "T"),
        "wind_qc": _quality(
            flags, number, ("windDirError", "windSpeedError"), ("windDirDD", "windSpeedDD"), "W"
        ),
    }


def _quality(
    flags: Flags, number: int, errors: tuple[str, ...], descriptors: tuple[str, ...], own: str
) -> NDArray[np.int8]:
    passed, failed = np.zeros(number, dtype=bool), np.zeros(number, dtype=bool)
    for name in errors:
        if name in flags:
            passed |= np.char.lower(flags[name]) == "p"
            failed |= ~np.isin(np.char.lower(flags[name]), ("p", "-", BLANK))
    for name in descriptors:
        if name in flags:
            passed |= ~np.isin(flags[name], (*_UNTESTED, *_DESCRIPTOR_FAILED))
            failed |= np.isin(flags[name], _DESCRIPTOR_FAILED)
    kind = flags.get("errorType", np.full(number, BLANK))
    failed |= np.isin(kind, (own, "B"))
    if "dataDescriptor" in flags:
        # X alone does not say what failed: both, then.
        failed |= (flags["dataDescriptor"] == "X") & ~np.isin(kind, ("T", "W", "B"))
    quality = np.where(passed, TEMPERATURE_QC["pass"], TEMPERATURE_QC["missing"])
    return np.where(failed, TEMPERATURE_QC["fail"], quality).astype(np.int8)


_MAGIC = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF\r\n\x1a\n")
register(ReportFormat("madis", lambda start: start.startswith(_MAGIC), _madis_pieces))
