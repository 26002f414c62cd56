"""OBS_DOMAIN: reports as WRF's observation nudging reads them.

Layout of share/wrf_fddaobs_in.F (subroutine in4dob) of WRF 4.7: formats 101 to 104, a report of
four lines and a line a level, no header. What the reader makes of a value decides how it is
written:

* a quality of 129 on both components says that the wind is earth-relative, and WRF turns it; any
  other number takes it as grid-relative. Quality is a gate, not a weight: there is no error;
* u = v = 0 counts as missing: a wind that rounds to calm gets an eastward component of 0.001 m/s;
* ``is_sound`` is true also for a single level: false would make it a surface report;
* at 80 hPa and above no wind is taken; such reports are left out and counted;
* a platform or name that says ACARS makes a later report of the same place, time and pressure
  overwrite the earlier one: ACARS reports are written as ``FM-97 AIREP``, their source says ACARS;
* reports must stand in order of time and the levels of one in descending pressure, which also is
  how they come.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.errors import InputError
from airswing.handover.records.fixed_columns import (
    MISSING,
    Lines,
    line_starts,
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

HIGHEST = 8000.0  # Pa: at this pressure and above WRF takes no wind
CALM = 0.001  # m/s; the smallest component the format can tell from none
# Quality by which WRF knows components to true east and north, and turns them to its own grid.
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
_QUALITY = 12  # From a value's first column to its quality's


def _too_high(rows: NDArray[np.void]) -> dict[str, NDArray[np.bool_]]:
    # Rounded as it will be written: WRF compares what it reads.
    return {"above_80_hPa": np.round(rows["pressure"], 3) <= HIGHEST}


def _encode(records: Records) -> bytes | memoryview:
    return interleaved(
        records, _heads(records), _levels(records.levels), lines_of("", records.size.size)
    )


def _heads(records: Records) -> Lines:
    heads = records.heads
    lines, own = lines_of(_HEAD, heads.size), heads["aircraft"]
    put_time(lines, _TIME + 2, heads["time"], pattern="yyyymmddhhmmss")
    put_number(lines, _PLACE + 3, 9, heads["latitude"], decimals=4)
    put_number(lines, _PLACE + 13, 9, heads["longitude"], decimals=4)
    put_text(lines, _NAMES + 3, records.identifiers[own])
    put_text(lines, _NAMES + 46, names(records))
    codes = [CODES["AIREP" if name == "ACARS" else name] for name in PLATFORMS]
    put_text(lines, _KIND + 3, text_table(codes, 16)[records.platform[own]])
    put_text(lines, _KIND + 21, text_table(PLATFORMS, 16)[records.platform[own]])
    put_number(lines, _KIND + 61, 5, records.size)
    return lines


def _levels(rows: NDArray[np.void]) -> Lines:
    lines = lines_of(_LEVEL, rows.size)
    # Rounded to the three decimals of the format: what it cannot hold is calm to the reader.
    calm = np.hypot(np.round(rows["u"], 3), np.round(rows["v"], 3)) == 0.0
    _put_pair(lines, _PRESSURE, rows["pressure"], 0.0)
    known = np.isfinite(rows["temperature"])
    _put_pair(
        lines,
        _TEMPERATURE,
        np.where(known, rows["temperature"], MISSING),
        np.where(known, 0.0, MISSING),
    )
    _put_pair(lines, _EAST, np.where(calm, CALM, rows["u"]), _EARTH_RELATIVE)
    _put_pair(lines, _NORTH, np.where(calm, 0.0, rows["v"]), _EARTH_RELATIVE)
    return lines


def _put_pair(lines: Lines, column: int, values: ArrayLike, quality: ArrayLike) -> None:
    put_number(lines, column, 11, values, decimals=3)
    put_number(lines, column + _QUALITY, 11, quality, decimals=3)


def _write(request: Request) -> Account:
    """Write reports for WRF's observation nudging.

    ``max_obs`` is what the namelist needs at most, since WRF stops where it holds more levels.
    """
    domain = request.settings.domain
    _check_name(request.path, domain, folder=request.folder)
    told = write_records(request, Layout(f"OBS_DOMAIN{domain}01", _encode, barred=_too_high))
    told["max_obs"] = max(file["levels"] for file in told["files"]) + 2
    told["notes"] = [f"WRF namelist, &fdda: max_obs = {told['max_obs']} holds every file whole"]
    return told


def _check_name(path: Path, domain: int, *, folder: bool) -> None:
    """Refuse a name that another nest would read."""
    # WRF opens OBS_DOMAINd01 by the number of each nest.
    match = re.fullmatch(r"OBS_DOMAIN(\d)01", path.name)
    if match and not folder and int(match[1]) != domain:
        raise InputError(
            "WRF reads a file of this name for another domain",
            file=path,
            found=f"domain {domain}",
            remedy=f"Name it OBS_DOMAIN{domain}01 or give --domain {match[1]}",
        )


register(ExportFormat("obs_domain", "reports for WRF's observation nudging", _write))
