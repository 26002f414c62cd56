"""OBS_DOMAIN: reports as WRF's observation nudging reads them.

Layout of subroutine in4dob, share/wrf_fddaobs_in.F of WRF 4.7 (formats 101 to 104): four lines a
report, a line a level, no header. The rules of the reader decide how a value is written:

* quality 129 on both components marks the wind as earth-relative, and WRF rotates it to its grid;
  any other number marks it as grid-relative. Quality admits a report or not; there is no error;
* u = v = 0 means missing: a wind that rounds to calm gets an eastward component of 0.001 m/s;
* ``is_sound`` is true for a single level too: false makes a surface report;
* at 80 hPa and above no wind is used; such reports are left out and counted;
* where platform or name contains ACARS, a later report of equal place, time and pressure
  overwrites the earlier one: ACARS reports are written as ``FM-97 AIREP`` with ACARS as source;
* reports are in order of time, the levels of a report in order of descending pressure;
* a report of many levels is used between its lowest and its highest level only, and not at all
  where two levels are more than 200 hPa apart (``obs_max_sndng_gap``): a joined sounding is split
  there. A single level reaches 75 hPa up and down with declining weight: a sounding of less than
  150 hPa would reach fewer points than its reports, and is written as single levels.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from airswing.errors import InputError
from airswing.handover.export import Request
from airswing.handover.fixed_columns import (
    MISSING,
    line_starts,
    lines_of,
    put_number,
    put_text,
    put_time,
)
from airswing.handover.platforms import CODES, PLATFORMS
from airswing.handover.records import Records, write_records
from airswing.handover.selection import selected_rows

HIGHEST = 8000.0  # Pa; WRF takes no wind at this pressure and above
CALM = 0.001  # m/s; smallest component the format holds
LARGEST_STEP = 20_000.0  # Pa between levels; default of ``obs_max_sndng_gap`` (20 cbar)
LEAST_DEPTH = 15_000.0  # Pa; twice the reach of a single level
_EARTH_RELATIVE = 129.0
_HEAD = (
    f" {'':14}\n"
    f"  {'':9} {'':9} \n"
    f"  {'':40}   {'':40}   \n"
    f"  {'':16}  {'':16}  -888888.     T     F  {'':5}\n"
)
_TIME, _PLACE, _NAMES, _KIND = line_starts(_HEAD)
_LEVEL = " " + 6 * "-888888.000 -888888.000 " + "\n"
# Format 104: a blank, then pairs of value and quality (F11.3) with a blank after each.
_PRESSURE, _HEIGHT, _TEMPERATURE, _EAST, _NORTH, _HUMIDITY = range(2, 146, 24)
_QUALITY = 12  # from the first column of a value to that of its quality


def write(request: Request) -> dict[str, Any]:
    """Write reports for WRF's observation nudging.

    ``max_obs`` of the result is for the namelist; WRF stops at more observations than that.
    """
    domain = request.settings.domain
    match = re.fullmatch(r"OBS_DOMAIN(\d)01", request.path.name)
    if match and not request.folder and int(match[1]) != domain:
        raise InputError(
            "WRF reads a file of this name for another domain",
            file=request.path,
            found=f"domain {domain}",
            remedy=f"Name it OBS_DOMAIN{domain}01 or give --domain {match[1]}",
        )
    selected = selected_rows(
        request, above=HIGHEST, largest_step=LARGEST_STEP, least_depth=LEAST_DEPTH
    )
    result = write_records(request, selected, f"OBS_DOMAIN{domain}01", _encode)
    result["max_obs"] = max(file["levels"] for file in result["files"]) + 2
    result["notes"] += [
        f"WRF namelist, &fdda: max_obs = {result['max_obs']} holds every file whole"
    ]
    return result


def _encode(records: Records) -> bytes | memoryview:
    heads = records.heads
    head = lines_of(_HEAD, heads.size)
    put_time(head, _TIME + 2, heads["time"], pattern="yyyymmddhhmmss")
    put_number(head, _PLACE + 3, 9, heads["latitude"], decimals=4)
    put_number(head, _PLACE + 13, 9, heads["longitude"], decimals=4)
    put_text(head, _NAMES + 3, records.identifiers[heads["aircraft"]])
    put_text(head, _NAMES + 46, records.names())
    codes = [CODES["AIREP" if name == "ACARS" else name] for name in PLATFORMS]
    put_text(head, _KIND + 3, records.texts(codes, 16))
    put_text(head, _KIND + 21, records.texts(list(PLATFORMS), 16))
    put_number(head, _KIND + 61, 5, records.size)

    rows = records.levels
    level = lines_of(_LEVEL, rows.size)
    # Rounded to the three decimals of the format.
    calm = np.hypot(np.round(rows["u"], 3), np.round(rows["v"], 3)) == 0.0
    missing = np.isnan(rows["temperature"])
    for column, values, quality in (
        (_PRESSURE, rows["pressure"], np.zeros(rows.size)),
        (
            _TEMPERATURE,
            np.where(missing, MISSING, rows["temperature"]),
            np.where(missing, MISSING, 0.0),
        ),
        (_EAST, np.where(calm, CALM, rows["u"]), np.full(rows.size, _EARTH_RELATIVE)),
        (_NORTH, np.where(calm, 0.0, rows["v"]), np.full(rows.size, _EARTH_RELATIVE)),
    ):
        put_number(level, column, 11, values, decimals=3)
        put_number(level, column + _QUALITY, 11, quality, decimals=3)
    return records.joined(head, level)
