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
from airswing.handover.platforms import CODES, PLATFORMS
from airswing.handover.records import (
    MISSING,
    Records,
    dates,
    fixed,
    joined,
    lines,
    speed_and_direction,
    write_records,
)
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
_GAP = f"{'':11}"
_BEFORE = (
    f"%-12s %19s %-40s %6d%12.3f{_GAP}%12.3f{_GAP} -888888.000{_GAP}{'':6}%-40s\n"
    " -888888.000 -88 200.00 -888888.000 -88  0.200\n"
)
# Value, quality and error by EACH_FMT. Errors other than that of the wind are those of
# var/obsproc/obserr.txt: 200 Pa, 1 K, 10 %.
_LEVEL = (
    f"%12.3f   0 200.00%12.3f   0%7.2f%12.3f   0%7.2f{_GAP}"
    f" -888888.000 -88  10.00%12.3f%4d   1.00 -888888.000 -88   1.00{_GAP}"
    " -888888.000 -88  10.00\n"
)
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


def _encode(records: Records, *, errors: WindErrors) -> bytes:
    places, levels = records.places, records.levels
    before = [
        records.by_platform([CODES[name][:12] for name in PLATFORMS]),
        dates(places["time"], separators=True),
        records.names(),
        records.size.tolist(),
        fixed(places["latitude"], 3),
        fixed(places["longitude"], 3),
        records.aircraft(),
    ]
    # A smaller direction would be written as 0.000.
    speed, direction = speed_and_direction(levels["u"], levels["v"], least=0.0005)
    error = errors.of(levels)
    # The angle of the component error across the wind.
    angle = np.degrees(np.arctan2(error, speed))
    missing = np.isnan(levels["temperature"])
    columns = [
        fixed(levels["pressure"], 3),
        fixed(speed, 3),
        fixed(np.clip(error, LEAST_ERROR, LARGEST_ERROR), 2),
        fixed(direction, 3),
        fixed(np.clip(angle, LEAST_ERROR, LARGEST_ERROR), 2),
        fixed(np.where(missing, MISSING, levels["temperature"]), 3),
        np.where(missing, -88, 0).tolist(),
    ]
    return joined(records, lines(_BEFORE, before), lines(_LEVEL, columns))
