"""ob.ascii: reports as WRFDA reads them, each with an error of its own.

Layout of var/da/da_obs_io (da_read_obs_ascii.inc, ob_format = 2) of WRF 4.7: a header up to the
formats and one line more, then a line of information, one of surface values and a line a level.
What the reader makes of a value decides how it is written:

* the speed's error is what WRFDA weighs both components with; the direction's counts only where
  ``wind_sd_tamdar`` or ``wind_sd_airep`` is set. Every error is positive, missing values' too, and
  has its point;
* the elevation is missing: a TAMDAR report whose height is its elevation would be a surface one;
* the level is the pressure alone. A value that is missing has quality -88;
* exactly one line stands between the formats and the first report, and no line is blank;
* seconds of the date are written, but WRFDA reads minutes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airswing.handover.records.fixed_columns import (
    Lines,
    lines_of,
    put_number,
    put_text,
    put_time,
    text_table,
)
from airswing.handover.records.platforms import CODES, PLATFORMS
from airswing.handover.records.record_files import (
    Layout,
    Records,
    interleaved,
    names,
    write_records,
)
from airswing.handover.records.registry import Account, ExportFormat, Request, register
from airswing.handover.records.wind import speed_and_direction
from airswing.handover.records.wind_error import PRODUCT, WindErrors, known_errors

_KINDS = (
    "SYNOP METAR SHIP BUOY BOGUS TEMP",
    "AMDAR AIREP TAMDAR PILOT SATEM SATOB",
    "GPSPW GPSZD GPSRF GPSEP SSMT1 SSMT2",
    "TOVS QSCAT PROFL AIRSR OTHER",
)
_FORMATS = (
    "INFO  = PLATFORM, DATE, NAME, LEVELS, LATITUDE, LONGITUDE, ELEVATION, ID.\n"
    "SRFC  = SLP, PW (DATA,QC,ERROR).\n"
    "EACH  = PRES, SPEED, DIR, HEIGHT, TEMP, DEW PT, HUMID (DATA,QC,ERROR)*LEVELS.\n"
    "INFO_FMT = (A12,1X,A19,1X,A40,1X,I6,3(F12.3,11X),6X,A40)\n"
    "SRFC_FMT = (F12.3,I4,F7.2,F12.3,I4,F7.3)\n"
    "EACH_FMT = (3(F12.3,I4,F7.2),11X,3(F12.3,I4,F7.2),11X,3(F12.3,I4,F7.2))\n"
    f"#{78 * '-'}#\n"
)
_HEAD = (
    f"{'':12} {'':19} {'':40} {'':6}{'':12}{'':11}{'':12}{'':11}{' -888888.000':12}{'':11}{'':6}"
    f"{'':40}\n"
    " -888888.000 -88 200.00 -888888.000 -88  0.200\n"
)
_GAP = f"{'':11}"
# Errors of what is not the wind are those of var/obsproc/obserr.txt: 200 Pa, 1 K, 10 %.
_LEVEL = (
    f"{'':12}{0:4} 200.00{'':12}{0:4}{'':7}{'':12}{0:4}{'':7}{_GAP}"
    f" -888888.000 -88  10.00 -888888.000 -88   1.00 -888888.000 -88   1.00{_GAP}"
    " -888888.000 -88  10.00\n"
)
# First columns in a level's line, by EACH_FMT below the header: a value takes 12, its quality 4,
# its error 7, with 11 blanks after every third.
_PRESSURE, _SPEED, _DIRECTION, _TEMPERATURE = 1, 24, 47, 104
_QUALITY, _ERROR = 12, 16  # From a value's first column to those of its quality and its error
# What F7.2 holds with a blank before it; an error of zero would be infinite weight.
LEAST_ERROR, LARGEST_ERROR = 0.01, 999.99


def _header(counts: Mapping[str, int]) -> bytes:
    kinds = {name: counts.get(name, 0) for name in PLATFORMS}
    # WRFDA counts by what it takes a report for, and FM-97 is its airep.
    kinds["AIREP"] += kinds.pop("ACARS")
    lines = [
        "".join(f"{kind:<6}={kinds.get(kind, 0):7}, " for kind in line.split()) for line in _KINDS
    ]
    total = f"TOTAL ={sum(kinds.values()):7}, MISS. =-888888.,"
    return "\n".join([total, *lines, _FORMATS]).encode("ascii")


def _encode(records: Records, *, errors: WindErrors) -> bytes | memoryview:
    head, own = lines_of(_HEAD, records.size.size), records.heads["aircraft"]
    codes = [CODES[name][:12] for name in PLATFORMS]
    put_text(head, 1, text_table(codes, 12)[records.platform[own]])
    put_time(head, 14, records.heads["time"], pattern="yyyy-mm-dd_hh:mm:ss")
    put_text(head, 34, names(records))
    put_number(head, 75, 6, records.size)
    put_number(head, 81, 12, records.heads["latitude"], decimals=3)
    put_number(head, 104, 12, records.heads["longitude"], decimals=3)
    put_text(head, 156, records.identifiers[own])
    error = errors.of(records.levels, records.platform[records.levels["aircraft"]])
    empty = lines_of("", records.size.size)
    return interleaved(records, head, _levels(records.levels, error), empty)


def _levels(rows: NDArray[np.void], error: NDArray[np.float64]) -> Lines:
    lines = lines_of(_LEVEL, rows.size)
    # Less would be written as 0.000.
    speed, direction = speed_and_direction(rows["u"], rows["v"], least=0.0005)
    put_number(lines, _PRESSURE, 12, rows["pressure"], decimals=3)
    put_number(lines, _SPEED, 12, speed, decimals=3)
    _put_error(lines, _SPEED, error)
    put_number(lines, _DIRECTION, 12, direction, decimals=3)
    _put_error(lines, _DIRECTION, _direction_error(speed, error))
    known = np.isfinite(rows["temperature"])
    some = lines[known]
    put_number(some, _TEMPERATURE, 12, rows["temperature"][known], decimals=3)
    put_number(some, _TEMPERATURE + _QUALITY, 4, 0)
    lines[known] = some
    return lines


def _put_error(lines: Lines, column: int, error: NDArray[np.float64]) -> None:
    put_number(lines, column + _ERROR, 7, np.clip(error, LEAST_ERROR, LARGEST_ERROR), decimals=2)


def _direction_error(speed: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Degrees: the component error across the wind, at most that of a wind as small as itself."""
    return np.degrees(np.arctan2(error, speed))


def _write(request: Request) -> Account:
    """Write reports for WRFDA."""
    known = known_errors(request.products)
    aircraft = request.corrected["aircraft"].to_numpy().astype(str)
    errors = WindErrors(known, request.winds, aircraft.tolist())
    layout = Layout("ob.ascii", partial(_encode, errors=errors), _header, look=errors.look)
    told = write_records(request, layout)
    told["errors_from"] = errors.source
    unknown = known is not None and errors.source != PRODUCT
    told["notes"] = [
        f"errors of the winds from {errors.source}"
        + ", with each correction's own" * (request.winds == "corrected")
        + f" ({PRODUCT} knows none of these)" * unknown,
        "WRFDA namelist: ob_format = 2; its gross check rejects a component that departs from the "
        "first guess by more than max_error_uv (5.0) times the report's error",
    ]
    return told


register(ExportFormat("ob_ascii", "reports for WRFDA, each with its error", _write))
