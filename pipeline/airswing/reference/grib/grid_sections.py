"""Grids of GRIB messages, by the keys of ecCodes: each distinct grid section is read once.

Lambert conformal, polar stereographic, Mercator, Lambert azimuthal equal area, regular and rotated
latitude/longitude, and regular Gaussian grids of both editions, and the native grid of the Rapid
Refresh; others are refused by name. Grid lengths of polar stereographic and Mercator grids count at
the latitude LaD (60 degrees for the former in edition 1). Values are in the order of the scanning
mode (WMO regulation 92.8, table 3.4); components "relative to the grid" point to increasing x and y
whatever the scanning direction (code table 3.3).
"""

from __future__ import annotations

import math
from functools import lru_cache
from types import ModuleType

import numpy as np

from airswing.physics.triangle import wrap_degrees
from airswing.reference.grids import (
    LONGITUDE_LATITUDE,
    AxesGrid,
    Floats,
    Frame,
    UnplaceableGridError,
    rotated_frame,
)

MAX_POINTS = 100_000_000  # ten times the largest grid on which winds are published
_RADII = (6.3e6, 6.4e6)  # limits of the semi-axes of every earth in use, m
_GRID_LENGTHS = 10.0, 6e7  # shortest grid length and largest extent of a projected grid, m
_STEP_TOLERANCE = 0.02  # of a step: increments are written to a few digits only
#: Names of GRIB2 grid templates and GRIB1 representation types, for messages.
_NAMES = {
    2: {50: "spherical harmonics", 101: "unstructured", 150: "HEALPix", 32768: "Arakawa E"},
    1: {50: "spherical harmonics", 201: "Arakawa E", 202: "Arakawa E", 203: "Arakawa E"},
}
#: Bytes of the sections, by edition and grid.
_SHORTEST = {
    1: {0: 32, 1: 34, 3: 34, 4: 32, 5: 28, 10: 42, 14: 42},
    2: {0: 72, 1: 84, 10: 72, 20: 65, 30: 73, 40: 72, 41: 84, 140: 64, 32769: 80},
}
#: Semi-axes (m) by code table 3.2, where ecCodes gives no key for them.
_OBLATE = {
    2: (6378160.0, 6356775.0),
    4: (6378137.0, 6356752.314140347),
    5: (6378137.0, 6356752.314245179),
    9: (6377563.396, 6356256.909),
}


def unsigned(data: bytes, start: int, width: int) -> int:
    """Unsigned integer of `width` bytes."""
    return int.from_bytes(data[start : start + width], "big")


def signed(data: bytes, start: int, width: int) -> int:
    """Integer of `width` bytes whose first bit is the sign."""
    value, top = unsigned(data, start, width), 1 << (8 * width - 1)
    return top - value if value >= top else value


@lru_cache(maxsize=512)
def read_grid(edition: int, section: bytes) -> AxesGrid:
    """Grid of a whole grid section: section 2 of edition 1, section 3 of edition 2."""
    number = section[5] if edition == 1 else int.from_bytes(section[12:14], "big")
    shortest = _SHORTEST[edition].get(number)
    if shortest is None:
        name = _NAMES[edition].get(number, "unknown")
        where = "representation type " if edition == 1 else "template 3."
        raise UnplaceableGridError(f"{name} grid (GRIB{edition} {where}{number})")
    if len(section) < shortest:
        raise UnplaceableGridError("grid section too short for its type")
    if edition == 2 and section[5]:
        raise UnplaceableGridError("predefined grid without its definition")
    if edition == 2 and section[10]:
        raise UnplaceableGridError("reduced grid (rows of different length)")
    if edition == 1:  # without the list of vertical coordinates, which may lie outside
        section = section[:3] + b"\x00\xff" + section[5:]
    if number == 32769:
        return _rapid_refresh(section)
    import eccodes

    handle = eccodes.codes_new_from_message(_message(eccodes, edition, section))
    try:
        return _Keys(eccodes, handle).grid()
    except (eccodes.CodesInternalError, ArithmeticError, ValueError) as error:
        raise UnplaceableGridError("grid section whose numbers contradict each other") from error
    finally:
        eccodes.codes_release(handle)


def _message(eccodes: ModuleType, edition: int, section: bytes) -> bytes:
    """A message of ecCodes' samples with another grid section."""
    handle = eccodes.codes_grib_new_from_samples("GRIB2" if edition == 2 else "regular_ll_pl_grib1")
    sample = bytes(eccodes.codes_get_message(handle))
    eccodes.codes_release(handle)
    if edition == 1:
        first = 8 + int.from_bytes(sample[8:11], "big")
        rest = sample[first + int.from_bytes(sample[first : first + 3], "big") :]
        body = sample[8:first] + section + rest
        return b"GRIB" + (8 + len(body)).to_bytes(3, "big") + b"\x01" + body
    parts, at = [], 16
    while at < len(sample) - 4:
        length = int.from_bytes(sample[at : at + 4], "big")
        parts.append(section if sample[at + 4] == 3 else sample[at : at + length])
        at += length
    body = b"".join([*parts, b"7777"])
    return sample[:8] + (16 + len(body)).to_bytes(8, "big") + body


class _Keys:
    """Keys of one message, and the grid they describe."""

    def __init__(self, eccodes: ModuleType, handle: int) -> None:
        self.eccodes, self.handle = eccodes, handle
        self.edition = self.integer("edition")

    def number(self, key: str) -> float:
        return float(self.eccodes.codes_get_double(self.handle, key))

    def integer(self, key: str) -> int:
        return int(self.eccodes.codes_get_long(self.handle, key))

    def degrees(self, key: str) -> float:
        value = self.number(f"{key}InDegrees")
        if not abs(value) <= (90.0 if key.startswith(("lat", "La")) else 720.0):
            raise UnplaceableGridError("grid beyond the earth")
        return value

    def increment(self, key: str) -> float:
        """An increment in degrees, NaN if it is not given."""
        try:
            if self.eccodes.codes_is_missing(self.handle, key):
                return math.nan
            value = self.number(f"{key}InDegrees")
        except self.eccodes.CodesInternalError:
            return math.nan
        return value if value > 0.0 else math.nan

    def grid(self) -> AxesGrid:
        kind = self.eccodes.codes_get_string(self.handle, "gridType")
        if kind.startswith("reduced") or any(
            self.eccodes.codes_is_missing(self.handle, key) for key in ("Ni", "Nj")
        ):
            raise UnplaceableGridError("reduced grid (rows of different length)")
        self.ni, self.nj = self.integer("Ni"), self.integer("Nj")
        if not (1 <= self.ni * self.nj <= MAX_POINTS and self.ni > 0):
            raise UnplaceableGridError(f"grid of {self.ni:,} by {self.nj:,} points")
        scanning = self.integer("scanningMode")
        if scanning & 0x0F:
            raise UnplaceableGridError(f"grid with staggered rows (scanning mode {scanning})")
        # bit 1: towards -i, bit 2: towards +j (GRIB1 table 8, GRIB2 table 3.4)
        self.si = -1.0 if scanning & 0x80 else 1.0
        self.sj = 1.0 if scanning & 0x40 else -1.0
        if kind in ("regular_ll", "rotated_ll", "regular_gg", "rotated_gg"):
            frame, x, y = self._degrees(kind)
        else:
            frame, x, y = self._projected(kind)
        along = bool(self.integer("resolutionAndComponentFlags") & 0x08)
        return AxesGrid(frame, x, y, along, bool(scanning & 0x20), bool(scanning & 0x10))

    def _degrees(self, kind: str) -> tuple[Frame, Floats, Floats]:
        first, last = (
            tuple(self.degrees(f"{axis}Of{end}GridPoint") for axis in ("latitude", "longitude"))
            for end in ("First", "Last")
        )
        unit = 1e-3 if self.edition == 1 else 1e-6
        stated = self.increment("iDirectionIncrement"), self.increment("jDirectionIncrement")
        if kind.endswith("gg"):
            stated = stated[0], math.nan
        x, y = _axes((self.ni, self.nj), (self.si, self.sj), first, last, unit, stated)
        if kind.endswith("gg"):
            from scipy.special import roots_legendre

            # the list of latitudes of ecCodes ends the process at some damaged sections
            count = 2 * self.integer("N")
            if not 2 <= count <= 10_000:
                raise UnplaceableGridError(f"Gaussian grid of {count:,} latitudes")
            y = np.degrees(np.arcsin(roots_legendre(count)[0]))[:: 1 if self.sj > 0 else -1]
            start = int(np.argmin(np.abs(y - first[0])))
            y = y[start : start + self.nj]
            if y.size != self.nj or max(abs(y[0] - first[0]), abs(y[-1] - last[0])) > 0.01:
                raise UnplaceableGridError("corners that are not latitudes of a Gaussian grid")
        if not kind.startswith("rotated"):
            return LONGITUDE_LATITUDE, x, y
        turned = self.number("angleOfRotationInDegrees")
        if turned:
            raise UnplaceableGridError(
                f"rotated grid turned by {turned:g} degrees about its pole "
                "(programs do not agree on its meaning)"
            )
        south = self.degrees("latitudeOfSouthernPole")
        return rotated_frame(-south, self.degrees("longitudeOfSouthernPole") + 180.0), x, y

    def _projected(self, kind: str) -> tuple[Frame, Floats, Floats]:
        latitude = self.degrees("latitudeOfFirstGridPoint")
        longitude = self.degrees("longitudeOfFirstGridPoint")
        names = ("Di", "Dj") if kind == "mercator" else ("Dx", "Dy")
        di, dj = (self.number(f"{name}InMetres") for name in names)
        shortest, longest = _GRID_LENGTHS
        if not (di >= shortest and dj >= shortest):
            raise UnplaceableGridError(f"grid lengths of {di:g} by {dj:g} m")
        if max(di * (self.ni - 1), dj * (self.nj - 1)) > longest:
            raise UnplaceableGridError("grid larger than the earth")
        earth = self._earth()
        polar = kind in ("lambert", "polar_stereographic")
        if polar and self.integer("projectionCentreFlag") & 0x40:
            raise UnplaceableGridError("bipolar projection")
        if kind == "lambert":
            first, second = self.degrees("Latin1"), self.degrees("Latin2")
            if max(abs(first), abs(second)) >= 90.0 or abs(first + second) < 1e-9:
                raise UnplaceableGridError(f"no Lambert cone with parallels {first}, {second}")
            meridian = self.degrees("LoV")
            proj = f"lcc +lat_1={first!r} +lat_2={second!r} +lat_0={first!r} +lon_0={meridian!r}"
        elif kind == "polar_stereographic":
            pole = -90.0 if self.integer("projectionCentreFlag") & 0x80 else 90.0
            true = math.copysign(self.degrees("LaD") if self.edition == 2 else 60.0, pole)
            meridian = self.degrees("orientationOfTheGrid")
            proj = f"stere +lat_0={pole} +lat_ts={true!r} +lon_0={meridian!r}"
        elif kind == "lambert_azimuthal_equal_area":
            middle = self.degrees("standardParallel"), self.degrees("centralLongitude")
            proj = f"laea +lat_0={middle[0]!r} +lon_0={middle[1]!r}"
        else:
            if self.edition == 2 and self.number("orientationOfTheGridInDegrees"):
                raise UnplaceableGridError("Mercator grid turned against the equator")
            proj = f"merc +lat_ts={self.degrees('LaD')!r}"
        frame = Frame("projected", f"+proj={proj} {earth}")
        # lengths are whole metres or millimetres: a full circle to a hundredth of a column
        if abs(frame.turn / di - self.ni) < 0.01:
            di = frame.turn / self.ni
        x0, y0 = frame.xy(np.array([latitude]), np.array([longitude]))
        x = x0[0] + self.si * di * np.arange(self.ni, dtype=np.float64)
        y = y0[0] + self.sj * dj * np.arange(self.nj, dtype=np.float64)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise UnplaceableGridError("first grid point where the projection has no image")
        return frame, x, y

    def _earth(self) -> str:
        if self.edition == 1:
            oblate = self.integer("earthIsOblate")
            axes = (6378160.0, 6356775.0) if oblate else (6367470.0, 6367470.0)
        elif (shape := self.integer("shapeOfTheEarth")) in _OBLATE:
            axes = _OBLATE[shape]
        elif shape in (3, 7):
            axes = self.number("earthMajorAxisInMetres"), self.number("earthMinorAxisInMetres")
        elif shape in (0, 1, 6, 8):
            axes = (self.number("radiusInMetres"),) * 2
        else:
            raise UnplaceableGridError(f"unknown shape of the earth (code {shape})")
        if not _RADII[1] >= axes[0] >= axes[1] >= _RADII[0]:
            raise UnplaceableGridError(
                f"impossible shape of the earth, axes {axes[0]}, {axes[1]} m"
            )
        return f"+a={axes[0]!r} +b={axes[1]!r} +units=m +no_defs"


def _axes(
    shape: tuple[int, int],
    signs: tuple[float, float],
    first: tuple[float, ...],
    last: tuple[float, ...],
    unit: float,
    stated: tuple[float, float],
) -> tuple[Floats, Floats]:
    """Longitudes and latitudes along the axes, from the corners (latitude, longitude), degrees.

    Corners are written to `unit` degrees; stated increments (NaN: not given) must agree with them.
    """
    (ni, nj), (si, sj) = shape, signs
    extent = (si * (last[1] - first[1])) % 360.0
    if ni > 1 and (extent < unit or 360.0 - extent < unit):  # first and last on one meridian
        extent = 360.0
    di = si * extent / (ni - 1) if ni > 1 else si
    dj = (last[0] - first[0]) / (nj - 1) if nj > 1 else sj
    if di == 0 or dj == 0 or (nj > 1 and dj * sj < 0):
        raise UnplaceableGridError("corners and scanning direction contradict each other")
    for step, increment, number in ((di, stated[0], ni), (dj, stated[1], nj)):
        if number > 1 and abs(abs(step) - increment) > 2.0 * unit + _STEP_TOLERANCE * abs(step):
            raise UnplaceableGridError("corners and increments contradict each other")
    if abs(abs(di) * ni - 360.0) < ni * unit:
        di = si * 360.0 / ni
    columns, rows = (np.arange(n, dtype=np.float64) for n in shape)
    return first[1] + di * columns, first[0] + dj * rows


def _rapid_refresh(section: bytes) -> AxesGrid:
    """Grid of NCEP's template 3.32769, which ecCodes does not describe in degrees.

    A rotated grid that is symmetric about its centre, where its equator and meridian cross; first,
    centre and last point are geographic. Steps are those from the first point to the centre.
    Increments are stated in several units and the last point is absent in some versions: one of
    them must agree.
    """

    def degrees(at: int) -> float:
        return signed(section, at, 4) / 1e6

    ni, nj = unsigned(section, 30, 4), unsigned(section, 34, 4)
    if not (2 <= ni < 2**31 and nj >= 2 and ni * nj <= MAX_POINTS):
        raise UnplaceableGridError(f"grid of {ni:,} by {nj:,} points")
    first, centre, scanning = (degrees(46), degrees(50)), (degrees(55), degrees(59)), section[71]
    if max(abs(first[0]), abs(centre[0])) > 90.0 or scanning & 0x0F:
        raise UnplaceableGridError("grid beyond the earth or with staggered rows")
    frame = rotated_frame(90.0 - centre[0], centre[1] + 180.0)
    x, y = frame.xy(np.array([first[0]]), np.array([first[1]]))
    x0, y0 = float(wrap_degrees(x)[0]), float(y[0])
    steps = -2.0 * x0 / (ni - 1), -2.0 * y0 / (nj - 1)
    signs = (-1.0 if scanning & 0x80 else 1.0), (1.0 if scanning & 0x40 else -1.0)
    stated = [step for step in (degrees(63), degrees(67)) if step > 0.0]
    agree = all(
        any(abs(abs(s) - size * unit) <= _STEP_TOLERANCE * abs(s) for unit in (1e-3, 1.0, 1e3))
        for s, size in zip(steps, stated, strict=False)
    )
    if not agree and len(section) >= 80:
        last = frame.xy(np.array([degrees(72)]), np.array([degrees(76)]))
        agree = bool(np.hypot(wrap_degrees(last[0] + x0), last[1] + y0)[0] < min(map(abs, steps)))
    if not agree or any(step * sign <= 0.0 for step, sign in zip(steps, signs, strict=True)):
        raise UnplaceableGridError("corners and increments contradict each other")
    columns, rows = (np.arange(n, dtype=np.float64) for n in (ni, nj))
    flags = (bool(byte) for byte in (section[54] & 0x08, scanning & 0x20, scanning & 0x10))
    return AxesGrid(frame, x0 + steps[0] * columns, y0 + steps[1] * rows, *flags)
