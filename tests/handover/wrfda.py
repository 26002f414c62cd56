"""ob.ascii as WRFDA reads it (var/da/da_obs_io/da_read_obs_ascii.inc, da_scan_obs_ascii.inc).

Written for tests: the same columns, rules for using and losing reports, and fatal errors.
"""

import re
from datetime import datetime

import numpy as np

from tests.handover.fortran import FileEndError, Lines, ReadError, fields, integer

MISSING, NO_DATA = -888888.0, -88
COLUMNS = {"p": 0, "speed": 23, "dir": 46, "height": 80, "t": 103, "td": 126, "rh": 160}
TYPES = {42: "airep", 96: "airep", 97: "airep", 101: "tamdar"}


class CrashError(RuntimeError):
    """The program ends with a run-time error."""


def formats(lines):
    """Read up to the formats and the one line behind them."""
    while not lines.next().startswith("EACH  "):
        pass
    by_section = {}
    for name in ("info", "srfc", "each"):
        by_section[name] = lines.next()[11:].strip()
    skipped = lines.next()
    by_section["skipped"] = skipped.rstrip()
    if skipped.startswith("MODIFIED FILTERED OBS"):
        raise NotImplementedError("winds as components")
    return by_section


def read(text):
    """Every report as read, and whether the file ended where a report ended."""
    lines, reports = Lines(text), []
    formats(lines)
    while True:
        try:
            report = _info(lines.next())
        except FileEndError:
            return reports, True
        except ReadError:
            return reports, False  # the rest of the file goes unread without a word
        try:
            _surface(lines.next())
            report["levels"] = [_level(lines.next()) for _ in range(report["count"])]
        except (ReadError, FileEndError) as err:
            raise CrashError(str(err)) from err
        if report["count"] < 1:
            continue
        reports.append(_assigned(report))


def _info(line):
    header = fields(
        line,
        *(("platform", 12, "a"), ("", 1, "a"), ("date", 19, "a"), ("", 1, "a"), ("name", 40, "a")),
        *(("", 1, "a"), ("count", 6, "i"), ("lat", 12, 3), ("", 11, "a"), ("lon", 12, 3)),
        *(("", 11, "a"), ("elv", 12, 3), ("", 17, "a"), ("id", 40, "a")),
    )
    if header["lon"] == 180.0:
        header["lon"] = -180.0
    code = line[3:5] if line[5] == " " else line[3:6]
    try:
        header["fm"] = integer(code)
    except ReadError as err:
        raise CrashError(str(err)) from err
    return header


def _surface(line):
    layout = (("value", 12, 3), ("qc", 4, "i"), ("error", 7, 2))
    fields(line, *layout), fields(line[23:], *layout[:2], ("error", 7, 3))


def _level(line):
    layout = (("value", 12, 3), ("qc", 4, "i"), ("error", 7, 2))
    return {name: tuple(fields(line[first:], *layout).values()) for name, first in COLUMNS.items()}


def _assigned(report):
    report["type"] = TYPES.get(report["fm"], "other")
    date = report["date"]
    if not re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d:\d\d:\d\d", date):
        raise CrashError(f"date {date!r}")
    report["minutes"] = datetime.strptime(date[:16], "%Y-%m-%d_%H:%M")
    for level in report["levels"]:
        (speed, speed_qc, error), (direction, direction_qc, _) = level["speed"], level["dir"]
        without_pressure = "height" if level["height"][0] > 0.0 else "none"
        level["vertical"] = "pressure" if level["p"][0] > 1.0 else without_pressure
        missing = NO_DATA in (speed_qc, direction_qc)
        angle = np.radians(direction)
        wind = -speed * np.sin(angle), -speed * np.cos(angle)
        level["earth"] = (MISSING, MISSING) if missing else wind
        level["qc"] = NO_DATA if missing else speed_qc
        level["error"] = MISSING if missing else error
        level["wind_used"] = not missing and speed_qc >= 0 and level["vertical"] != "none"
    surface = [
        level
        for level in report["levels"]
        if MISSING not in (report["elv"], level["height"][0])
        and abs(report["elv"] - level["height"][0]) < 0.1
    ]
    if report["fm"] == 101 and surface:
        report["type"], report["levels"] = "tamdar_sfc", surface[:1]
    return report
