"""LITTLE_R as OBSPROC reads it (var/obsproc/src/module_decoded.F90 and what follows it there).

Written for tests: the same columns, the same rules for losing, merging, replacing and rejecting,
for aircraft reports in 3D-Var mode. The domain is left out.
"""

from datetime import datetime, timedelta

import numpy as np

from tests.handover.fortran import FileEndError, Lines, ReadError, fields, integer

MISSING, END, NO_DATA = -888888.0, -777777.0, -88
KINDS = {42: "AMDAR", 96: "AIREP", 97: "AIREP", 101: "TAMDAR"}
NAMES = ("p", "z", "t", "td", "speed", "dir", "u", "v", "rh", "thickness")
COUNTS = ("num_vld_fld", "num_error", "num_warning", "seq_num", "num_dups")
HIGHEST_REPORTED = 3000.0


def raw(text):
    """Reports as read; those that trouble the reader are lost as they are in OBSPROC."""
    lines, reports = Lines(text), []
    while True:
        try:
            report = _report(lines)
        except FileEndError:
            return reports
        if report is not None:
            reports.append(report | {"n": len(reports) + 1})


def _report(lines):
    try:
        report = _header(lines.next())
        report["levels"] = _measurements(lines)
    except ReadError:
        _skip(lines)
        return None
    try:
        trailer = lines.next()
        [integer(trailer[first : first + 7]) for first in (0, 7, 14)]
    except ReadError as err:
        raise FileEndError from err  # io_error ends the loop over the reports
    return report


def _skip(lines):
    """Lines are tried as levels up to the next end record."""
    while True:
        try:
            level = _level(lines.next())
        except ReadError:
            continue
        if abs(level["p"][0] - END) < 1.0:
            lines.next()
            return


def _header(line):
    header = fields(
        line,
        *(("lat", 20, 5), ("lon", 20, 5), ("id", 40, "a"), ("name", 40, "a")),
        *(("platform", 40, "a"), ("source", 40, "a"), ("elevation", 20, 5)),
        *((name, 10, "i") for name in COUNTS),
        *((name, 10, "l") for name in ("is_sound", "bogus", "discard")),
        *(("sut", 10, "i"), ("julian", 10, "i"), ("", 6, "a"), ("date", 14, "a")),
    )
    ground = pairs(line[340:], 13)
    header |= {"slp": ground[0], "ref_pres": ground[1], "psfc": ground[4]}
    header["fm"] = integer(header["platform"][3:6])
    if header["fm"] <= 0:
        raise ReadError("no WMO code")
    return header | {"obsproc_type": KINDS.get(header["fm"], "OTHER")}


def pairs(line, number):
    """Values and their qualities."""
    parts = (fields(line[20 * k :], ("x", 13, 5), ("q", 7, "i")) for k in range(number))
    return [(pair["x"], pair["q"]) for pair in parts]


def _level(line):
    return dict(zip(NAMES, pairs(line, len(NAMES)), strict=True))


def _measurements(lines):
    levels = []
    while True:
        level = _level(lines.next())
        if any(abs(level[name][0] - END) < 1.0 for name in ("p", "z")):
            return levels
        levels.append(level)


def processed(text, begin, analysis, end):
    """Reports that reach ob.ascii, in order of time, of the three kinds of aircraft."""
    accepted = []
    for report in raw(text):
        moment = _moment(report["date"])
        inside = begin <= moment <= end - timedelta(seconds=1)
        levels = _joined([_converted(level, report["fm"]) for level in report["levels"]])
        usable = report["obsproc_type"] != "OTHER" and not report["discard"]
        if inside and usable and levels:
            accepted.append(report | {"time": moment, "levels": levels})
    accepted = _without_duplicates(accepted, analysis)
    for report in accepted:
        report["levels"] = [_judged(level) for level in report["levels"]]
    return sorted(accepted, key=lambda report: report["time"])


def _moment(date):
    try:
        moment = datetime.strptime(date, "%Y%m%d%H%M%S")
    except ValueError:
        return datetime(1900, 1, 1)
    return moment if date[:2] in ("19", "20") and date.isdigit() else datetime(1900, 1, 1)


def _converted(level, fm):
    """Pressure from an aircraft's height, where its quality says that the height is good."""
    height, quality = level["z"]
    if fm in (42, 96, 97) and quality == 0 and height > HIGHEST_REPORTED:
        pressure = 101325.0 * (1.0 - 0.0065 * height / 288.15) ** (9.80665 / (287.04 * 0.0065))
        return level | {"p": (pressure, 0)}
    return level


def _joined(levels):
    """In order of falling pressure; of levels less than 1 Pa apart the first stays."""
    joined = []
    for level in levels:
        if level["p"][0] == MISSING and level["z"][0] == MISSING:
            continue
        same = [earlier for earlier in joined if abs(earlier["p"][0] - level["p"][0]) < 1.0]
        if not same or level["p"][0] == MISSING:
            joined.append(level)
    return sorted(joined, key=lambda level: -level["p"][0])


def _without_duplicates(reports, analysis):
    """Merge reports of one place and time; of one place keep the nearest to the analysis."""
    groups = []
    for report in reports:
        same = (group for group in groups if _of_one_place(group[0], report))
        if (group := next(same, None)) is None:
            groups.append(group := [])
        group.append(report)
    nearest = []
    for group in groups:
        merged = {}
        for report in group:
            first = merged.setdefault(report["time"], report)
            if first is not report:
                first["levels"] = _joined(first["levels"] + report["levels"])
        nearest.append(min(merged.values(), key=lambda report: abs(report["time"] - analysis)))
    return nearest


def _of_one_place(first, second):
    names = all(first[name] == second[name] for name in ("id", "name"))
    near = all(abs(first[name] - second[name]) < 1e-3 for name in ("lat", "lon"))
    return names and near and first["platform"][3:6] == second["platform"][3:6]


def _judged(level):
    """Wind and qualities as they go into ob.ascii."""
    (speed, speed_qc), (direction, direction_qc) = level["speed"], level["dir"]
    wind = speed >= np.float32(0.1) and 0.001 < direction <= 360.0
    none = (MISSING, NO_DATA)
    return {
        "p": level["p"],
        "t": level["t"],
        "z": level["z"],
        "speed": (speed, reduced(speed_qc)) if wind else none,
        "dir": (direction, reduced(direction_qc)) if wind else none,
    }


def reduced(quality):
    """Quality of ob.ascii for one of LITTLE_R (qc_reduction.F90)."""
    if quality < 0:
        return NO_DATA
    small = {0: 0, 1: 4, 2: 2, 3: 3, 4: 1}
    if quality in small:
        return small[quality]
    for bit, code in ((18, -77), (17, -15), (16, -14), (15, -13), (10, -8), (7, -5), (6, -4)):
        if quality >= 2**bit:
            return code
    return 0
