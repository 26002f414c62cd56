"""LITTLE_R: reports as OBSPROC reads them on their way to WRFDA.

Layout of var/obsproc (module_decoded.F90) of WRF 4.7: a header of 600 characters, a line of 200 a
level, an end record and a trailer of three counts. What the reader makes of a value decides how it
is written:

* the wind counts as speed and direction only, the direction in (0.001, 360] degrees and the speed
  at least 0.1 m/s: north is 360, and a calmer wind is raised to 0.1 m/s where it blew from;
* the date is right-justified, and in sounding and single report alike an end record and a trailer
  follow, else the reports after are swallowed;
* the level is the pressure alone: with a height of quality 0 beside it, OBSPROC would replace the
  pressure of FM-42, 96 and 97 by the standard atmosphere's above 3,000 m. The quality of the
  missing height is 1 for them;
* reports of one place and name are merged, or dropped but for the one nearest to the analysis:
  every report has a name of its own;
* levels less than 1 Pa apart are merged: joined soundings keep 2 Pa;
* quality is 0: the number that says earth-relative in OBS_DOMAIN would reject the wind here. No
  error of its own can be carried; OBSPROC takes errors by type from obserr.txt.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from airswing.handover.records.fixed_columns import (
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
from airswing.handover.records.wind import speed_and_direction

SLOWEST = 0.10001  # m/s: OBSPROC takes slower winds as missing
LEAST_DIRECTION = 0.00101  # Degrees: OBSPROC takes smaller ones as missing
_NO_VALUE = "-888888.00000      0"
# Latitude, longitude, identifier, name, platform, source, elevation; counts of fields, errors,
# warnings, order, duplicates; sounding, bogus, discarded; seconds since a date and a Julian day
# that nobody reads, the date, 13 surface values.
_HEAD = (
    f"{'':20}{'':20}{'':40}{'':40}{'':40}{'':40}{'-888888.00000':>20}"
    f"{'':10}{0:10}{0:10}{'':10}{0:10}{'T':>10}{'F':>10}{'F':>10}{-888888:10}{-888888:10}"
    f"{'':20}{_NO_VALUE * 13}\n"
)
_LEVEL = f"{_NO_VALUE * 10}\n"
# First columns in a level: ten pairs of a value (F13.5) and its quality (I7).
_PRESSURE, _HEIGHT_QUALITY, _TEMPERATURE, _SPEED, _DIRECTION = 1, 34, 41, 81, 101
_TAIL = f"{'-777777.00000      0' * 2}{'':13}      0{_NO_VALUE * 7}\n{'':7}{0:7}{0:7}\n"
_END, _TRAILER = line_starts(_TAIL)


def _encode(records: Records, *, winds: str) -> bytes | memoryview:
    levels = records.levels
    head, own = lines_of(_HEAD, records.size.size), records.heads["aircraft"]
    put_number(head, 1, 20, records.heads["latitude"], decimals=5)
    put_number(head, 21, 20, records.heads["longitude"], decimals=5)
    put_text(head, 41, records.identifiers[own])
    put_text(head, 81, names(records))
    put_text(head, 121, text_table([CODES[name] for name in PLATFORMS], 40)[records.platform[own]])
    source = [f"airswing {winds} {name}" for name in PLATFORMS]
    put_text(head, 161, text_table(source, 40)[records.platform[own]])
    put_number(head, 221, 10, records.size)
    put_number(head, 251, 10, records.number)
    # the date has columns 321 to 340, its fourteen digits at their end
    put_time(head, 327, records.heads["time"], pattern="yyyymmddhhmmss")
    tail = lines_of(_TAIL, records.size.size)
    put_number(tail, _END + 41, 13, records.size, decimals=5)
    put_number(tail, _TRAILER + 1, 7, records.size)
    lines = _levels(levels)
    tamdar = records.platform[levels["aircraft"]] == PLATFORMS.index("TAMDAR")
    put_number(lines, _HEIGHT_QUALITY, 7, np.where(tamdar, 0, 1))
    return interleaved(records, head, lines, tail)


def _levels(rows: NDArray[np.void]) -> Lines:
    lines = lines_of(_LEVEL, rows.size)
    speed, direction = speed_and_direction(rows["u"], rows["v"], least=LEAST_DIRECTION)
    put_number(lines, _PRESSURE, 13, rows["pressure"], decimals=5)
    known = np.isfinite(rows["temperature"])
    some = lines[known]
    put_number(some, _TEMPERATURE, 13, rows["temperature"][known], decimals=5)
    lines[known] = some
    put_number(lines, _SPEED, 13, np.maximum(speed, SLOWEST), decimals=5)
    put_number(lines, _DIRECTION, 13, direction, decimals=5)
    return lines


def _write(request: Request) -> Account:
    """Write reports for OBSPROC."""
    told = write_records(request, Layout("obs.little_r", partial(_encode, winds=request.winds)))
    most = max(file["reports"] for file in told["files"])
    told["notes"] = [
        f"OBSPROC namelist, &record3: max_number_of_obs of {most} or more; it ends with status 0 "
        "whatever happens: compare the TOTAL of what it writes"
    ]
    return told


register(ExportFormat("little_r", "reports for OBSPROC, to WRFDA", _write))
