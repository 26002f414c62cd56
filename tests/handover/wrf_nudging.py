"""OBS_DOMAIN as WRF's in4dob reads it (share/wrf_fddaobs_in.F), for a Lambert domain.

Written for tests: the same columns, the same rules for what is kept, changed or fatal.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
import pyproj

from tests.handover.fortran import FileEndError, Lines, ReadError, integer, logical, real

MISSING = -888888.0
NAMES = ("p", "z", "t", "u", "v", "rh")


class FatalError(RuntimeError):
    """The model stops."""


@dataclass
class Domain:
    start: datetime
    known_lat: float = 21.4965
    known_lon: float = -117.7199
    stand_lon: float = -97.0
    truelat1: float = 30.0
    truelat2: float = 60.0
    dx: float = 30000.0
    e_we: int = 150
    e_sn: int = 120
    window_hours: float = 1.0
    max_obs: int = 1000

    def __post_init__(self) -> None:
        crs = (
            f"+proj=lcc +lat_1={self.truelat1} +lat_2={self.truelat2} +lat_0=0 "
            f"+lon_0={self.stand_lon} +R=6370000"
        )
        self._plane = pyproj.Proj(crs)
        self._origin = self._plane(self.known_lon, self.known_lat)
        a, b = np.radians(self.truelat1), np.radians(self.truelat2)
        self.cone = np.log(np.cos(a) / np.cos(b)) / np.log(
            np.tan(np.pi / 4 - a / 2) / np.tan(np.pi / 4 - b / 2)
        )

    def position(self, lat: float, lon: float) -> tuple[float, float]:
        x, y = self._plane(lon, lat)
        return (x - self._origin[0]) / self.dx + 1.5, (y - self._origin[1]) / self.dx + 1.5

    def along_grid(self, lon: float, u: float, v: float) -> tuple[float, float]:
        angle = np.radians(((lon - self.stand_lon + 180.0) % 360.0 - 180.0) * self.cone)
        return u * np.cos(angle) - v * np.sin(angle), v * np.cos(angle) + u * np.sin(angle)


def raw(text: str) -> list[dict[str, Any]]:
    """Every value as read, and the platform by the reader's rules."""
    lines, found, last = Lines(text), [], -np.inf
    while True:
        try:
            report = _report(lines, len(found) + 1)
        except FileEndError:
            return found
        report["chronological"] = report["seconds"] >= last
        last = report["seconds"]
        found.append(report)


def _report(lines: Lines, number: int) -> dict[str, Any]:
    date = lines.next()[1:15]
    try:
        moment = datetime.strptime(date, "%Y%m%d%H%M%S")
    except ValueError as err:
        raise FatalError(f"Bad ODATE: {date!r}") from err
    if not date.isdigit():
        raise FatalError(f"Bad ODATE: {date!r}")
    try:
        return _rest(lines, number, date, moment)
    except (FileEndError, ReadError) as err:
        raise FatalError(str(err) or "end of file in a report") from err


def _rest(lines: Lines, number: int, date: str, moment: datetime) -> dict[str, Any]:
    place, names, kind = lines.next(), lines.next(), lines.next()
    platform, name = kind[2:18], names[45:85]
    report = {
        "n": number,
        "date": date,
        "seconds": (moment - datetime(1970, 1, 1)).total_seconds(),
        "lat": real(place[2:11], 4),
        "lon": real(place[12:21], 4),
        "id": names[2:42],
        "name": name,
        "platform": platform.rstrip(),
        "source": kind[20:36].rstrip(),
        "elevation": real(kind[38:46], 0),
        "is_sound": logical(kind[48:52]),
        "bogus": logical(kind[54:58]),
        "meas_count": integer(kind[60:65]),
    }
    platform = _platform(platform, name)
    report["platform_after_rules"] = platform.rstrip()
    report["plfo"] = _plfo(platform)
    pairs = 6 if report["is_sound"] else 9
    count = report["meas_count"] if report["is_sound"] else 1
    report["levels"] = [_level(lines.next(), pairs) for _ in range(count)]
    return report


def _platform(platform: str, name: str) -> str:
    if name[1:9] == "PROFILER":
        platform = platform[:6] + "PROFILER" + platform[14:]
    if name[1:6] == "ACARS":
        platform = platform[:6] + "ACARS" + platform[11:]
    if name[:7] == "SATWNDS":
        platform = "SATWNDS    " + platform[11:]
    if name[:8] == "CLASS DA":
        platform = platform[:6] + "TEMP" + platform[10:]
    return platform


def _plfo(platform: str) -> float:
    kind = 99.0
    for word, first, number in (
        ("METAR", 6, 1.0),
        ("SPECI", 6, 2.0),
        ("SHIP", 6, 3.0),
        ("SYNOP", 6, 4.0),
        ("TEMP", 6, 5.0),
        ("PILOT", 6, 6.0),
        ("SATWNDS", 0, 7.0),
        ("SATWI", 6, 7.0),
        ("SAMS", 0, 8.0),
        ("PROFILER", 6, 9.0),
        ("ACARS", 6, 7.0),
    ):
        if platform[first : first + len(word)] == word:
            kind = number
    return kind


def _level(line: str, pairs: int) -> list[tuple[float, float]]:
    return [
        (real(line[1 + 24 * k : 12 + 24 * k], 3), real(line[13 + 24 * k : 24 + 24 * k], 3))
        for k in range(pairs)
    ]


def in4dob(text: str, domain: Domain) -> list[dict[str, Any]]:
    """What the nudging keeps, a level an entry."""
    kept: list[dict[str, Any]] = []
    last = -999.0
    for report in raw(text):
        hours = np.float32((report["seconds"] - _seconds(domain.start)) / 3600.0)
        i, j = domain.position(report["lat"], report["lon"])
        chosen = [
            _observation(report, pair, domain, number + 1, hours, i, j)
            for number, pair in enumerate(report["levels"])
        ]
        if len(kept) + len(chosen) > domain.max_obs:
            raise FatalError("STOP 122")
        if hours < -2 * domain.window_hours or _overwrites(chosen, kept):
            continue
        if i < 2 or i > domain.e_we - 1 or j < 2 or j > domain.e_sn - 1:
            continue
        if hours < last:
            raise FatalError("STOP 111")
        last = hours
        kept += chosen
    return [one for one in kept if abs(one["timeob_h"]) <= domain.window_hours]


def _seconds(moment: datetime) -> float:
    return (moment - datetime(1970, 1, 1)).total_seconds()


def _observation(
    report: dict[str, Any],
    pairs: list[tuple[float, float]],
    domain: Domain,
    number: int,
    hours: float,
    i: float,
    j: float,
) -> dict[str, Any]:
    values = dict(zip(NAMES, pairs, strict=True)) if report["is_sound"] else _surface(pairs)
    (p, pq), (z, zq), (t, tq), (u, uq), (v, vq), (rh, rhq) = (_settled(values[n]) for n in NAMES)
    good = {
        name: 0.0 <= q < 30000.0 for name, q in zip(NAMES, (pq, zq, tq, uq, vq, rhq), strict=True)
    }
    found = {
        "timeob_h": float(hours),
        "ri": i,
        "rj": j,
        "plfo": report["plfo"],
        "rk": -99.0 if report["is_sound"] else 1.0,
        "elev": report["elevation"],
        "nlevs": float(len(report["levels"])),
        "lev": float(number),
        "id": report["id"].rstrip(),
        "t": t if good["t"] and (good["p"] or good["z"]) else MISSING,
        "z": z if good["z"] else MISSING,
        "p_cb": p / 1000.0 if good["p"] else MISSING,
        "u": MISSING,
        "v": MISSING,
        "qv": MISSING,
    }
    if 0.0 < found["p_cb"] <= 8.0:
        return found
    if good["u"] and good["v"] and (u != 0.0 or v != 0.0):
        turn = uq == 129.0 and vq == 129.0
        found["u"], found["v"] = domain.along_grid(report["lon"], u, v) if turn else (u, v)
    if good["rh"] and good["p"] and good["t"]:
        found["qv"] = _mixing_ratio(rh, t, p / 100.0)
    return found


def _surface(pairs: list[tuple[float, float]]) -> dict[str, tuple[float, float]]:
    return {
        "p": pairs[7],
        "z": pairs[2],
        "t": pairs[3],
        "u": pairs[4],
        "v": pairs[5],
        "rh": pairs[6],
    }


def _settled(pair: tuple[float, float]) -> tuple[float, float]:
    value, quality = pair
    quality = 0.0 if quality == -777777.0 else quality
    return value, MISSING if value == MISSING else quality


def _mixing_ratio(humidity: float, temperature: float, pressure: float) -> float:
    vapour = 6.1078 * np.exp(17.2693882 * (temperature - 273.16) / (temperature - 35.86))
    return float(0.01 * humidity * 0.62197 * vapour / (pressure - vapour))


def _overwrites(chosen: list[dict[str, Any]], kept: list[dict[str, Any]]) -> bool:
    """Satellite winds, and ACARS taken for such: the later of one place and level counts."""
    if len(chosen) != 1:
        return False
    new = chosen[0]
    for old in kept:
        same = all(old[name] == new[name] for name in ("timeob_h", "ri", "rj", "p_cb"))
        if same and old["nlevs"] == 1.0 and old["plfo"] == new["plfo"] == 7.0:
            old.update({name: new[name] for name in ("u", "v", "t", "qv", "p_cb", "z", "id")})
            return True
    return False
