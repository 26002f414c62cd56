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

SLOWEST = 0.10001  # m/s; OBSPROC takes slower winds as missing
LEAST_DIRECTION = 0.00101  # degrees; OBSPROC takes smaller ones as missing
_NO_VALUE = "-888888.00000      0"
# Latitude, longitude, identifier, name, platform, source, elevation; numbers of fields, errors,
# warnings, order, duplicates; sounding, bogus, discarded; seconds since a date and a Julian day
# that no reader uses, the date, 13 surface values.
_BEFORE = (
    f"%20.5f%20.5f%-40s%-40s%-40s%-40s{'0.00000':>20}"
    f"%10d{0:10}{0:10}%10d{0:10}{'T':>10}{'F':>10}{'F':>10}{-888888:10}{-888888:10}"
    f"{'':6}%14s{_NO_VALUE * 13}\n"
)
# Pairs of a value (F13.5) and its quality (I7): pressure, height, temperature, dew point, speed,
# direction, u, v, humidity, thickness.
_LEVEL = (
    f"%13.5f      0-888888.00000%7d%13.5f      0{_NO_VALUE}%13.5f      0%13.5f      0"
    f"{_NO_VALUE * 4}\n"
)
_AFTER = f"{'-777777.00000      0' * 2}%13.5f      0{_NO_VALUE * 7}\n%7d{0:7}{0:7}\n"


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


def _encode(records: Records, *, winds: str) -> bytes:
    places, levels, size = records.places, records.levels, records.size.tolist()
    before = [
        fixed(places["latitude"], 5),
        fixed(places["longitude"], 5),
        records.aircraft(),
        records.names(),
        records.by_platform([CODES[name] for name in PLATFORMS]),
        records.by_platform([f"airswing {winds} {name}" for name in PLATFORMS]),
        size,
        records.number.tolist(),
        dates(places["time"], separators=False),
    ]
    speed, direction = speed_and_direction(levels["u"], levels["v"], least=LEAST_DIRECTION)
    tamdar = records.platform[levels["aircraft"]] == PLATFORMS.index("TAMDAR")
    temperature = levels["temperature"]
    columns = [
        fixed(levels["pressure"], 5),
        np.where(tamdar, 0, 1).tolist(),
        fixed(np.where(np.isnan(temperature), MISSING, temperature), 5),
        fixed(np.maximum(speed, SLOWEST), 5),
        fixed(direction, 5),
    ]
    return joined(
        records, lines(_BEFORE, before), lines(_LEVEL, columns), lines(_AFTER, [size, size])
    )
