"""Grid sections of GRIB1 (GDS) and GRIB2 (section 3) to `Grid` parameters.

Validity: the grids named in `airswing.reference.geometry.grids`; every other section
is refused with a reason a person can act on. Octet numbers follow WMO
GRIB1 code table 6 and GRIB2 grid definition templates 3.0, 3.1, 3.10, 3.20
and 3.30, and NCEP's 3.32769 (RAP's native grid), whose first and last points are
geographic and whose rotation is given by its centre.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TypedDict

import numpy as np

from airswing.reference.geometry.grids import Grid, UnplaceableGridError, rotation
from airswing.reference.packing.octets import ibm_float, ieee_float, missing, signed, unsigned

_GRIB1_NAMES = {
    4: "gaussian",
    6: "space view of the pole",
    8: "Albers equal area",
    13: "oblique Lambert conformal",
    14: "rotated gaussian",
    20: "stretched latitude/longitude",
    24: "stretched gaussian",
    50: "spherical harmonics",
    60: "rotated spherical harmonics",
    90: "space view",
    201: "Arakawa semi-staggered E",
    202: "Arakawa filled E",
    203: "Arakawa staggered E",
}
#: Octets of the sections, by edition and grid.
_LENGTHS = {
    1: {0: 32, 1: 34, 3: 34, 5: 28, 10: 42},
    2: {0: 72, 1: 84, 10: 72, 20: 65, 30: 73, 32769: 80},
}
_GRIB2_NAMES = {
    2: "stretched latitude/longitude",
    3: "stretched and rotated latitude/longitude",
    4: "variable resolution latitude/longitude",
    5: "variable resolution rotated latitude/longitude",
    12: "transverse Mercator",
    31: "Albers equal area",
    40: "gaussian",
    41: "rotated gaussian",
    42: "stretched gaussian",
    50: "spherical harmonics",
    90: "space view",
    100: "triangular icosahedral",
    101: "unstructured",
    140: "Lambert azimuthal equal area",
    150: "HEALPix",
    204: "curvilinear orthogonal",
    32768: "rotated latitude/longitude, Arakawa E staggered,",
}

MAX_POINTS = 100_000_000  # Points of a grid: ten times the largest that winds are published on
_RADII = (6.3e6, 6.4e6)  # Semi-axes of every earth in use, m
# Grid length, and extent of a projected grid (the earth once and a half around), m.
_SHORTEST, _LONGEST = 10.0, 6e7
_STEP_TOLERANCE = 0.02  # Of a step: increments are written to a few digits only

#: (semi-major axis m, semi-minor axis m) of GRIB2 code table 3.2.
_EARTHS = {
    0: (6367470.0, 6367470.0),
    2: (6378160.0, 6356775.0),
    4: (6378137.0, 6356752.314140347),
    5: (6378137.0, 6356752.314245179),
    6: (6371229.0, 6371229.0),
    8: (6371200.0, 6371200.0),
    9: (6377563.396, 6356256.909),
}


# thousands of messages share a grid section
@lru_cache(maxsize=512)
def read_grid(edition: int, section: bytes) -> Grid:
    """Grid parameters of a whole grid section: GDS (edition 1) or section 3 (edition 2).

    Raises
    ------
    UnplaceableGridError
        With the grid's name where it is one this package cannot place.
    """
    # octet 6 of the first edition, 13-14 of the second: which grid it is
    kind = section[5:6] if edition == 1 else section[12:14]
    if not kind or len(section) < _LENGTHS[edition].get(int.from_bytes(kind, "big"), 0):
        raise UnplaceableGridError("grid section too short for its type")
    try:
        grid = _grib1(section) if edition == 1 else _grib2(section)
    except (ArithmeticError, ValueError, IndexError) as error:
        raise UnplaceableGridError("grid section whose numbers contradict each other") from error
    return _on_earth(grid)


def _on_earth(grid: Grid) -> Grid:
    """Refuse a grid that no program would have written: a damaged section."""
    if grid.size > MAX_POINTS:
        raise UnplaceableGridError(f"grid of {grid.ni:,} by {grid.nj:,} points")
    latitudes = [grid.latitude_first, grid.true_latitude, grid.latin1, grid.latin2]
    latitudes.append(grid.pole_latitude)
    longitudes = (grid.longitude_first, grid.orientation, grid.pole_longitude)
    if max(map(abs, latitudes)) > 90.0 or max(map(abs, longitudes)) > 360.0:
        raise UnplaceableGridError("grid off the earth")
    metres = not grid.kind.endswith("ll")
    if metres and not (abs(grid.di) >= _SHORTEST and abs(grid.dj) >= _SHORTEST):
        raise UnplaceableGridError(f"grid lengths of {grid.di:g} by {grid.dj:g} m")
    if metres and max(abs(grid.di) * (grid.ni - 1), abs(grid.dj) * (grid.nj - 1)) > _LONGEST:
        raise UnplaceableGridError("grid larger than the earth")
    return grid


def _eccentricity(major: float, minor: float) -> float:
    if not (_RADII[1] >= major >= minor >= _RADII[0]):
        raise UnplaceableGridError(f"impossible earth shape, axes {major} m and {minor} m")
    return math.sqrt(1.0 - (minor / major) ** 2)


class _Scanning(TypedDict):
    """Order of storage, as `Grid` has it."""

    j_consecutive: bool
    alternate_rows: bool


class _Shape(TypedDict):
    """Numbers of points, and the earth."""

    ni: int
    nj: int
    radius: float
    eccentricity: float


class _Common(_Shape, _Scanning):
    """What grids of every kind have."""

    latitude_first: float
    longitude_first: float
    wind_along_grid: bool


class _Steps(TypedDict):
    """Steps in degrees."""

    di: float
    dj: float
    periodic: bool


class _Degrees(_Common, _Steps):
    """A grid in degrees."""


class _Plane(_Common):
    """A grid in a plane; lengths in metres."""

    di: float
    dj: float
    orientation: float
    true_latitude: float


def _scanning(flags: int) -> _Scanning:
    # Bits 5 to 8: rows or columns set off by half a step.
    if flags & 0x0F:
        raise UnplaceableGridError(f"grid with staggered rows (scanning mode {flags})")
    return {"j_consecutive": bool(flags & 0x20), "alternate_rows": bool(flags & 0x10)}


def _counts(section: bytes, start: int, width: int) -> tuple[int, int]:
    if missing(section, start, width) or missing(section, start + width, width):
        raise UnplaceableGridError("reduced grid (rows of different length)")
    ni, nj = unsigned(section, start, width), unsigned(section, start + width, width)
    if ni < 1 or nj < 1:
        raise UnplaceableGridError(f"grid of {ni} by {nj} points")
    return ni, nj


def _signs(scan: int) -> tuple[float, float]:
    # Bit 1 set: towards -i; bit 2 set: towards +j (GRIB1 table 8, GRIB2 table 3.4).
    return (-1.0 if scan & 0x80 else 1.0), (1.0 if scan & 0x40 else -1.0)


def _steps(
    shape: tuple[int, int],
    scan: int,
    first: tuple[float, float],
    last: tuple[float, float],
    unit: float,
    stated: tuple[float, float],
) -> _Steps:
    """Steps in degrees from the corners; `unit` is the resolution they are written to.

    `stated` increments (NaN: not given) must agree with them.
    """
    (ni, nj), (si, sj) = shape, _signs(scan)
    # longitudes may run on past a whole turn, but not past two
    if not (abs(last[0]) <= 90.0 + unit and abs(last[1]) <= 720.0):
        raise UnplaceableGridError("grid off the earth")
    extent = (si * (last[1] - first[1])) % 360.0
    # First and last column on one meridian: once around.
    if ni > 1 and (extent < unit or 360.0 - extent < unit):
        extent = 360.0
    di = si * extent / (ni - 1) if ni > 1 else si
    dj = (last[0] - first[0]) / (nj - 1) if nj > 1 else sj
    if di == 0 or dj == 0 or (nj > 1 and dj * sj < 0):
        raise UnplaceableGridError("corners and scanning direction contradict each other")
    for step, said, number in ((di, stated[0], ni), (dj, stated[1], nj)):
        if number > 1 and abs(abs(step) - said) > 2.0 * unit + _STEP_TOLERANCE * abs(step):
            raise UnplaceableGridError("corners and increments contradict each other")
    periodic = abs(abs(di) * ni - 360.0) < ni * unit
    if periodic:
        di = si * 360.0 / ni
    return {"di": di, "dj": dj, "periodic": periodic}


def _stated(
    section: bytes, places: tuple[int, int], width: int, unit: float, *, given: bool
) -> tuple[float, float]:
    """Increments in degrees as the section has them; NaN where not given."""
    steps = [
        unsigned(section, place, width) * unit
        if given and not missing(section, place, width)
        else 0.0
        for place in places
    ]
    return steps[0] or math.nan, steps[1] or math.nan


def _grib1(section: bytes) -> Grid:
    kind = section[5]
    if kind not in (0, 1, 3, 5, 10):
        name = _GRIB1_NAMES.get(kind, "unknown")
        raise UnplaceableGridError(f"{name} grid (GRIB1 representation type {kind})")
    ni, nj = _counts(section, 6, 2)
    # octets 28 and 17
    scan, flags = section[27], section[16]
    # Bit 2 of the resolution flags: the IAU 1965 ellipsoid, else a sphere (GRIB1 table 7).
    major, minor = (6378160.0, 6356775.0) if flags & 0x40 else (6367470.0, 6367470.0)
    shared: _Common = {
        "ni": ni,
        "nj": nj,
        "latitude_first": signed(section, 10, 3) / 1e3,
        "longitude_first": signed(section, 13, 3) / 1e3,
        "radius": major,
        "eccentricity": _eccentricity(major, minor),
        "wind_along_grid": bool(flags & 0x08),
        **_scanning(scan),
    }
    first = (shared["latitude_first"], shared["longitude_first"])
    si, sj = _signs(scan)
    if kind in (0, 10):
        # octets 18-23: the other corner, in thousandths of a degree; 24-27: the increments
        last = (signed(section, 17, 3) / 1e3, signed(section, 20, 3) / 1e3)
        stated = _stated(section, (23, 25), 2, 1e-3, given=bool(flags & 0x80))
        degrees: _Degrees = {**shared, **_steps((ni, nj), scan, first, last, 1e-3, stated)}
        if kind == 0:
            return Grid("regular_ll", **degrees)
        # octets 33-38: the southern pole of the rotation; 39-42: the angle about it
        pole = (signed(section, 32, 3) / 1e3, signed(section, 35, 3) / 1e3)
        return _rotated(degrees, pole, ibm_float(section, 38))
    if kind == 1:
        # octets 29-34: metres at the latitude in 24-26
        di, dj = si * unsigned(section, 28, 3), sj * unsigned(section, 31, 3)
        return _mercator(shared, di, dj, signed(section, 23, 3) / 1e3)
    # octet 27: bit 1 the south pole is on the plane, bit 2 both are
    if section[26] & 0x40:
        raise UnplaceableGridError("bipolar projection")
    # octets 18-20: the meridian along y; 21-26: lengths in metres; edition 1 has no octets for the
    # latitude of true lengths: it is 60 degrees
    plane: _Plane = {
        **shared,
        "di": si * unsigned(section, 20, 3),
        "dj": sj * unsigned(section, 23, 3),
        "orientation": signed(section, 17, 3) / 1e3,
        "true_latitude": 60.0 if kind == 5 else 0.0,
    }
    if kind == 5:
        return Grid("polar_stereographic", south=bool(section[26] & 0x80), **plane)
    return _lambert(plane, signed(section, 28, 3) / 1e3, signed(section, 31, 3) / 1e3)


def _earth(section: bytes) -> tuple[float, float]:
    """Semi-axes in metres from section 3's octets 15-30."""
    shape = section[14]
    if shape in _EARTHS:
        return _EARTHS[shape]
    if shape == 1:
        # octets 16-20: decimal scale and value
        radius = unsigned(section, 16, 4) / 10.0 ** section[15]
        return radius, radius
    if shape in (3, 7):
        # octets 21-30: both axes alike, in km where the shape is 3
        unit = 1000.0 if shape == 3 else 1.0
        major = unsigned(section, 21, 4) / 10.0 ** section[20] * unit
        return major, unsigned(section, 26, 4) / 10.0 ** section[25] * unit
    raise UnplaceableGridError(f"unknown shape of the earth (code {shape})")


def _grib2(section: bytes) -> Grid:
    kind = unsigned(section, 12, 2)
    if kind not in (0, 1, 10, 20, 30, 32769):
        name = _GRIB2_NAMES.get(kind, "unknown")
        raise UnplaceableGridError(f"{name} grid (GRIB2 template 3.{kind})")
    if section[5]:
        raise UnplaceableGridError("predefined grid without its definition")
    if section[10]:
        raise UnplaceableGridError("reduced grid (rows of different length)")
    ni, nj = _counts(section, 30, 4)
    major, minor = _earth(section)
    shape: _Shape = {
        "ni": ni,
        "nj": nj,
        "radius": major,
        "eccentricity": _eccentricity(major, minor),
    }
    if kind in (0, 1):
        return _grib2_degrees(section, kind, shape)
    if kind == 32769:
        return _grib2_centred(section, shape)
    # octet 47; 60 of a Mercator grid, 65 of the others
    flags, scan = section[46], section[59 if kind == 10 else 64]
    si, sj = _signs(scan)
    shared: _Common = {
        **shape,
        "latitude_first": signed(section, 38, 4) / 1e6,
        "longitude_first": signed(section, 42, 4) / 1e6,
        "wind_along_grid": bool(flags & 0x08),
        **_scanning(scan),
    }
    true_latitude = signed(section, 47, 4) / 1e6
    if kind == 10:
        # octets 61-64: angle between the rows and the equator
        if unsigned(section, 60, 4):
            raise UnplaceableGridError("Mercator grid turned against the equator")
        # octets 65-72, in millimetres
        di, dj = si * unsigned(section, 64, 4) / 1e3, sj * unsigned(section, 68, 4) / 1e3
        return _mercator(shared, di, dj, true_latitude)
    # octet 64: bit 1 the south pole is on the plane, bit 2 both are
    if section[63] & 0x40:
        raise UnplaceableGridError("bipolar projection")
    # octets 52-55: the meridian along y; 56-63: lengths in millimetres
    plane: _Plane = {
        **shared,
        "di": si * unsigned(section, 55, 4) / 1e3,
        "dj": sj * unsigned(section, 59, 4) / 1e3,
        "orientation": signed(section, 51, 4) / 1e6,
        "true_latitude": true_latitude,
    }
    if kind == 20:
        return Grid("polar_stereographic", south=bool(section[63] & 0x80), **plane)
    return _lambert(plane, signed(section, 65, 4) / 1e6, signed(section, 69, 4) / 1e6)


def _grib2_degrees(section: bytes, kind: int, shape: _Shape) -> Grid:
    basic, parts = unsigned(section, 38, 4), unsigned(section, 42, 4)
    # Basic angle and its subdivisions: degrees are in millionths where they are not given.
    usual = basic in (0, 0xFFFFFFFF) or parts in (0, 0xFFFFFFFF)
    unit = 1e-6 if usual else basic / parts
    scale = 1e6 if usual else parts / basic
    # octets 47-54 and 56-63: the corners; 64-71: the increments, given where 55 says so
    first = (signed(section, 46, 4) / scale, signed(section, 50, 4) / scale)
    last = (signed(section, 55, 4) / scale, signed(section, 59, 4) / scale)
    scan = section[71]
    stated = _stated(section, (63, 67), 4, 1.0 / scale, given=section[54] & 0x30 == 0x30)
    degrees: _Degrees = {
        **shape,
        "latitude_first": first[0],
        "longitude_first": first[1],
        "wind_along_grid": bool(section[54] & 0x08),
        **_scanning(scan),
        **_steps((shape["ni"], shape["nj"]), scan, first, last, unit, stated),
    }
    if kind == 0:
        return Grid("regular_ll", **degrees)
    # octets 73-80: the southern pole of the rotation; 81-84: the angle about it
    pole = (signed(section, 72, 4) / scale, signed(section, 76, 4) / scale)
    return _rotated(degrees, pole, ieee_float(section, 80))


def _grib2_centred(section: bytes, shape: _Shape) -> Grid:
    """A rotated grid whose equator and meridian cross at its centre (NCEP template 3.32769)."""
    first, centre, last = (
        (signed(section, at, 4) / 1e6, signed(section, at + 4, 4) / 1e6) for at in (46, 55, 72)
    )
    pole = (centre[0] - 90.0, centre[1])
    x, y = rotation(*pole).plane(np.array([first[0], last[0]]), np.array([first[1], last[1]]))
    scan = section[71]
    stated = _stated(section, (63, 67), 4, 1e-6, given=section[54] & 0x30 == 0x30)
    ends = [(float(y[n]), float(x[n])) for n in (0, 1)]
    degrees: _Degrees = {
        **shape,
        "latitude_first": ends[0][0],
        "longitude_first": ends[0][1],
        "wind_along_grid": bool(section[54] & 0x08),
        **_scanning(scan),
        **_steps((shape["ni"], shape["nj"]), scan, ends[0], ends[1], 1e-6, stated),
    }
    return _rotated(degrees, pole, 0.0)


def _rotated(degrees: _Degrees, pole: tuple[float, float], turned: float) -> Grid:
    if turned:
        raise UnplaceableGridError(
            f"rotated grid turned by {turned:g} degrees about its own pole "
            "(programs do not agree on what that means)"
        )
    return Grid("rotated_ll", pole_latitude=pole[0], pole_longitude=pole[1], **degrees)


def _mercator(shared: _Common, di: float, dj: float, true_latitude: float) -> Grid:
    if not (di and dj):
        raise UnplaceableGridError("Mercator grid without grid lengths")
    e, phi = shared["eccentricity"], math.radians(true_latitude)
    scale = math.cos(phi) / math.sqrt(1.0 - (e * math.sin(phi)) ** 2)
    turn = 2.0 * math.pi * shared["radius"] * scale / abs(di)
    # lengths are whole millimetres: a turn of the equator comes out to a hundredth of a column
    periodic = abs(turn - shared["ni"]) < 0.01
    return Grid("mercator", di=di, dj=dj, true_latitude=true_latitude, periodic=periodic, **shared)


def _lambert(plane: _Plane, latin1: float, latin2: float) -> Grid:
    if not (plane["di"] and plane["dj"]):
        raise UnplaceableGridError("Lambert grid without grid lengths")
    if abs(latin1) >= 90.0 or abs(latin2) >= 90.0 or abs(latin1 + latin2) < 1e-9:
        raise UnplaceableGridError(f"no Lambert cone with standard parallels {latin1} and {latin2}")
    return Grid("lambert", latin1=latin1, latin2=latin2, **plane)
