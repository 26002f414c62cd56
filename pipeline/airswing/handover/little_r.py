"""LITTLE_R: reports as OBSPROC reads them on their way to WRFDA, and OBSGRID.

Layout of var/obsproc/src/module_decoded.F90 of WRF 4.7: a header of 600 characters, a line of 200
a level, an end record and a trailer of three counts. The rules of the readers decide how a value is
written:

* the wind counts as speed and direction only, the direction in (0.001, 360] degrees and the speed
  at least 0.1 m/s: north is 360, and a weaker wind is raised to 0.1 m/s in its direction;
* the date is right-justified; an end record and a trailer follow every report, else the reports
  after it are lost;
* pressure alone gives the level: with a height of quality 0 OBSPROC replaces the pressure of FM-42,
  96 and 97 by that of the standard atmosphere above 3,000 m. The quality of their missing height
  is 1;
* the elevation is 0: OBSGRID takes a level whose height equals the elevation for the surface, also
  where both are missing, and drops it;
* reports of one place and name are merged, or all but one dropped: every report has a unique name;
* levels less than 1 Pa apart are merged: joined soundings keep 2 Pa;
* quality is 0: the 129 of OBS_DOMAIN would reject the wind here. The format holds no error of a
  report; OBSPROC takes errors by type from obserr.txt.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from airswing.handover.export import Request
from airswing.handover.fixed_columns import (
    line_starts,
    lines_of,
    put_number,
    put_text,
    put_time,
    speed_and_direction,
)
from airswing.handover.platforms import CODES, PLATFORMS
from airswing.handover.records import Records, write_records
from airswing.handover.selection import selected_rows

SLOWEST = 0.10001  # m/s; OBSPROC takes slower winds as missing
LEAST_DIRECTION = 0.00101  # degrees; OBSPROC takes smaller ones as missing
_NO_VALUE = "-888888.00000      0"
# Latitude, longitude, identifier, name, platform, source, elevation; counts of fields, errors,
# warnings, order, duplicates; sounding, bogus, discarded; seconds since a date and a Julian day
# that no reader uses, the date, 13 surface values.
_HEAD = (
    f"{'':20}{'':20}{'':40}{'':40}{'':40}{'':40}{'0.00000':>20}"
    f"{'':10}{0:10}{0:10}{'':10}{0:10}{'T':>10}{'F':>10}{'F':>10}{-888888:10}{-888888:10}"
    f"{'':20}{_NO_VALUE * 13}\n"
)
_LEVEL = f"{_NO_VALUE * 10}\n"
# First columns in a level: ten pairs of a value (F13.5) and its quality (I7).
_PRESSURE, _HEIGHT_QUALITY, _TEMPERATURE, _SPEED, _DIRECTION = 1, 34, 41, 81, 101
_TAIL = f"{'-777777.00000      0' * 2}{'':13}      0{_NO_VALUE * 7}\n{'':7}{0:7}{0:7}\n"
_END, _TRAILER = line_starts(_TAIL)


def write(request: Request) -> dict[str, Any]:
    """Write reports for OBSPROC or OBSGRID."""
    encode = partial(_encode, winds=request.winds)
    result = write_records(request, selected_rows(request), "obs.little_r", encode)
    most = max(file["reports"] for file in result["files"])
    result["notes"] += [
        f"OBSPROC namelist, &record3: max_number_of_obs of {most} or more; it ends with status 0 "
        "whatever happens: compare the TOTAL of what it writes"
    ]
    if request.soundings:
        result["notes"] += [
            "OBSPROC namelist, &record4: qc_test_convective_adj = .FALSE., or it changes the "
            "temperatures of soundings"
        ]
    return result


def _encode(records: Records, *, winds: str) -> bytes | memoryview:
    heads = records.heads
    head = lines_of(_HEAD, heads.size)
    put_number(head, 1, 20, heads["latitude"], decimals=5)
    put_number(head, 21, 20, heads["longitude"], decimals=5)
    put_text(head, 41, records.identifiers[heads["aircraft"]])
    put_text(head, 81, records.names())
    put_text(head, 121, records.texts([CODES[name] for name in PLATFORMS], 40))
    put_text(head, 161, records.texts([f"airswing {winds} {name}" for name in PLATFORMS], 40))
    put_number(head, 221, 10, records.size)
    put_number(head, 251, 10, records.number)
    # The date has columns 321 to 340, its fourteen digits at their end.
    put_time(head, 327, heads["time"], pattern="yyyymmddhhmmss")
    tail = lines_of(_TAIL, heads.size)
    put_number(tail, _END + 41, 13, records.size, decimals=5)
    put_number(tail, _TRAILER + 1, 7, records.size)

    rows = records.levels
    level = lines_of(_LEVEL, rows.size)
    speed, direction = speed_and_direction(rows["u"], rows["v"], least=LEAST_DIRECTION)
    known = np.isfinite(rows["temperature"])
    put_number(level, _PRESSURE, 13, rows["pressure"], decimals=5)
    put_number(level, _TEMPERATURE, 13, rows["temperature"], decimals=5, where=known)
    put_number(level, _SPEED, 13, np.maximum(speed, SLOWEST), decimals=5)
    put_number(level, _DIRECTION, 13, direction, decimals=5)
    tamdar = records.platform[rows["aircraft"]] == PLATFORMS.index("TAMDAR")
    put_number(level, _HEIGHT_QUALITY, 7, np.where(tamdar, 0, 1))
    return records.joined(head, level, tail)
