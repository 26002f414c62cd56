"""ob.ascii: reports as WRFDA reads them, each with its error.

Layout of var/da/da_obs_io/da_read_obs_ascii.inc of WRF 4.7 (``ob_format = 2``): a header that ends
one line after the formats, then a line of information, one of surface values and a line a level.
The rules of the reader decide how a value is written:

* the error of the speed weighs both components; that of the direction counts only with
  ``wind_sd_tamdar`` or ``wind_sd_airep``. Every error is positive and has its decimal point, also
  that of a missing value;
* the elevation is missing: a TAMDAR report whose height equals its elevation is a surface report;
* pressure alone gives the level. A missing value has quality -88;
* exactly one line is between the formats and the first report, and no line is blank;
* seconds are written, but WRFDA reads minutes.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from airswing.handover.export import ERRORS, Request
from airswing.handover.fixed_columns import (
    lines_of,
    put_number,
    put_text,
    put_time,
    speed_and_direction,
)
from airswing.handover.platforms import CODES, PLATFORMS
from airswing.handover.records import Records, write_records
from airswing.handover.selection import selected_rows
from airswing.handover.wind_errors import WindErrors, known_errors

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
# Errors other than that of the wind are those of var/obsproc/obserr.txt: 200 Pa, 1 K, 10 %.
_LEVEL = (
    f"{'':12}{0:4} 200.00{'':12}{0:4}{'':7}{'':12}{0:4}{'':7}{_GAP}"
    f" -888888.000 -88  10.00 -888888.000 -88   1.00 -888888.000 -88   1.00{_GAP}"
    " -888888.000 -88  10.00\n"
)
# First columns in the line of a level, by EACH_FMT: a value takes 12, its quality 4, its error 7,
# with 11 blanks after every third.
_PRESSURE, _SPEED, _DIRECTION, _TEMPERATURE = 1, 24, 47, 104
_QUALITY, _ERROR = 12, 16  # from the first column of a value to those of its quality and its error
# Range of F7.2 with a blank before it; an error of zero would have infinite weight.
LEAST_ERROR, LARGEST_ERROR = 0.01, 999.99


def write(request: Request) -> dict[str, Any]:
    """Write reports for WRFDA."""
    selected, known = selected_rows(request), known_errors(request)
    errors = WindErrors(request, selected.rows, known)
    encode = partial(_encode, errors=errors)
    result = write_records(request, selected, "ob.ascii", encode, header=_header)
    result["errors_from"] = errors.source
    unknown = known is not None and errors.source != ERRORS
    result["notes"] += [
        f"errors of the winds from {errors.source}"
        + ", with the uncertainty of each correction" * (request.winds == "corrected")
        + f" ({ERRORS} holds none for these)" * unknown,
        "WRFDA namelist: ob_format = 2; its gross check rejects a component that departs from the "
        "first guess by more than max_error_uv (5.0) times the report's error",
    ]
    return result


def _header(numbers: dict[str, int]) -> bytes:
    kinds = dict(numbers)
    # WRFDA counts FM-97 as AIREP.
    kinds["AIREP"] += kinds.pop("ACARS")
    lines = [
        "".join(f"{kind:<6}={kinds.get(kind, 0):7}, " for kind in line.split()) for line in _KINDS
    ]
    total = f"TOTAL ={sum(kinds.values()):7}, MISS. =-888888.,"
    return "\n".join([total, *lines, _FORMATS]).encode("ascii")


def _encode(records: Records, *, errors: WindErrors) -> bytes | memoryview:
    heads = records.heads
    head = lines_of(_HEAD, heads.size)
    put_text(head, 1, records.texts([CODES[name][:12] for name in PLATFORMS], 12))
    put_time(head, 14, heads["time"], pattern="yyyy-mm-dd_hh:mm:ss")
    put_text(head, 34, records.names())
    put_number(head, 75, 6, records.size)
    put_number(head, 81, 12, heads["latitude"], decimals=3)
    put_number(head, 104, 12, heads["longitude"], decimals=3)
    put_text(head, 156, records.identifiers[heads["aircraft"]])

    rows = records.levels
    level = lines_of(_LEVEL, rows.size)
    # A smaller direction would be written as 0.000.
    speed, direction = speed_and_direction(rows["u"], rows["v"], least=0.0005)
    error = errors.of(rows)
    put_number(level, _PRESSURE, 12, rows["pressure"], decimals=3)
    for column, values, value_error in (
        (_SPEED, speed, error),
        # The angle of the component error across the wind.
        (_DIRECTION, direction, np.degrees(np.arctan2(error, speed))),
    ):
        put_number(level, column, 12, values, decimals=3)
        written = np.clip(value_error, LEAST_ERROR, LARGEST_ERROR)
        put_number(level, column + _ERROR, 7, written, decimals=2)
    known = np.isfinite(rows["temperature"])
    put_number(level, _TEMPERATURE, 12, rows["temperature"], decimals=3, where=known)
    put_number(level, _TEMPERATURE + _QUALITY, 4, 0, where=known)
    return records.joined(head, level)
