"""OBS_DOMAIN as WRF's in4dob reads it (share/wrf_fddaobs_in.F), for tests.

The same columns and the same fatal errors. A wind counts on reading where its quality is from 0 to
30,000 and it is not u = v = 0; quality 129 marks earth-relative components.
"""

from datetime import datetime

import numpy as np

from tests.handover.fortran import FileEndError, Lines, ReadError, fields

NAMES = ("p", "z", "t", "u", "v", "rh")


class FatalError(RuntimeError):
    """The model stops."""


def raw(text):
    """Every value as read, and the platform by the reader's rules."""
    lines, reports, previous = Lines(text), [], -np.inf
    while True:
        try:
            report = _report(lines, len(reports) + 1)
        except FileEndError:
            return reports
        report["chronological"] = report["seconds"] >= previous
        previous = report["seconds"]
        reports.append(report)


def _report(lines, number):
    date = lines.next()[1:15]
    try:
        moment = datetime.strptime(date, "%Y%m%d%H%M%S")
    except ValueError as err:
        raise FatalError(f"Bad ODATE: {date!r}") from err
    if not date.isdigit():
        raise FatalError(f"Bad ODATE: {date!r}")
    try:
        return _body(lines, number, date, moment)
    except (FileEndError, ReadError) as err:
        raise FatalError(str(err) or "end of file in a report") from err


def _body(lines, number, date, moment):
    report = {
        "n": number,
        "date": date,
        "seconds": (moment - datetime(1970, 1, 1)).total_seconds(),
        **fields(lines.next(), ("", 2, "a"), ("lat", 9, 4), ("", 1, "a"), ("lon", 9, 4)),
        **fields(lines.next(), ("", 2, "a"), ("id", 40, "a"), ("", 3, "a"), ("name", 40, "a")),
        **fields(
            lines.next(),
            *(("", 2, "a"), ("platform", 16, "a"), ("", 2, "a"), ("source", 16, "a")),
            *(("", 2, "a"), ("elevation", 8, 0), ("", 2, "a"), ("is_sound", 4, "l")),
            *(("", 2, "a"), ("bogus", 4, "l"), ("", 2, "a"), ("meas_count", 5, "i")),
        ),
    }
    platform, name = report["platform"], report["name"]
    report |= {"platform": platform.rstrip(), "source": report["source"].rstrip()}
    platform = _platform(platform, name)
    report["platform_after_rules"] = platform.rstrip()
    report["plfo"] = _plfo(platform)
    pairs = 6 if report["is_sound"] else 9
    count = report["meas_count"] if report["is_sound"] else 1
    report["levels"] = [_level(lines.next(), pairs) for _ in range(count)]
    return report


def _platform(platform, name):
    if name[1:9] == "PROFILER":
        platform = platform[:6] + "PROFILER" + platform[14:]
    if name[1:6] == "ACARS":
        platform = platform[:6] + "ACARS" + platform[11:]
    if name[:7] == "SATWNDS":
        platform = "SATWNDS    " + platform[11:]
    if name[:8] == "CLASS DA":
        platform = platform[:6] + "TEMP" + platform[10:]
    return platform


KINDS = {"METAR": 1.0, "SPECI": 2.0, "SHIP": 3.0, "SYNOP": 4.0, "TEMP": 5.0, "PILOT": 6.0}
KINDS |= {"SATWNDS": 7.0, "SATWI": 7.0, "SAMS": 8.0, "PROFILER": 9.0, "ACARS": 7.0}


def _plfo(platform):
    """The last of the kinds whose word is in its column."""
    kind = 99.0
    for word, number in KINDS.items():
        if platform.startswith(word, 0 if word in ("SATWNDS", "SAMS") else 6):
            kind = number
    return kind


def _level(line, pairs):
    layout = (("value", 11, 3), ("", 1, "a"), ("qc", 11, 3))
    return [tuple(fields(line[1 + 24 * k :], *layout).values()) for k in range(pairs)]
