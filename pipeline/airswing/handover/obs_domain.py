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
from airswing.handover.platforms import CODES, PLATFORMS
from airswing.handover.records import (
    MISSING,
    Records,
    dates,
    fixed,
    joined,
    lines,
    write_records,
)
from airswing.handover.selection import selected_rows

HIGHEST = 8000.0  # Pa; WRF takes no wind at this pressure and above
CALM = 0.001  # m/s; smallest component the format holds
LARGEST_STEP = 20_000.0  # Pa between levels; default of ``obs_max_sndng_gap`` (20 cbar)
LEAST_DEPTH = 15_000.0  # Pa; twice the reach of a single level
_BEFORE = " %14s\n  %9.4f %9.4f \n  %-40s   %-40s   \n  %-16s  %-16s  -888888.     T     F  %5d\n"
# Format 104: pairs of value and quality of pressure, height, temperature, u, v and humidity.
_NONE = "-888888.000 -888888.000 "
_EARTH_RELATIVE = "    129.000 "
_LEVEL = (
    f" %11.3f       0.000 {_NONE}%11.3f %11.3f %11.3f {_EARTH_RELATIVE}%11.3f {_EARTH_RELATIVE}"
    f"{_NONE}\n"
)


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


def _encode(records: Records) -> bytes:
    places, levels = records.places, records.levels
    codes = [CODES["AIREP" if name == "ACARS" else name] for name in PLATFORMS]
    before = [
        dates(places["time"], separators=False),
        fixed(places["latitude"], 4),
        fixed(places["longitude"], 4),
        records.aircraft(),
        records.names(),
        records.by_platform(codes),
        records.by_platform(PLATFORMS),
        records.size.tolist(),
    ]
    # Rounded to the three decimals of the format.
    calm = np.hypot(np.round(levels["u"], 3), np.round(levels["v"], 3)) == 0.0
    missing = np.isnan(levels["temperature"])
    columns = [
        fixed(levels["pressure"], 3),
        fixed(np.where(missing, MISSING, levels["temperature"]), 3),
        np.where(missing, MISSING, 0.0).tolist(),
        fixed(np.where(calm, CALM, levels["u"]), 3),
        fixed(np.where(calm, 0.0, levels["v"]), 3),
    ]
    return joined(records, lines(_BEFORE, before), lines(_LEVEL, columns))
