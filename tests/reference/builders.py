"""GRIB messages of every grid and packing, built by eccodes for the tests."""

import eccodes
import numpy as np

import airswing  # noqa: F401


def grid_keys(kind, size, first, last=None, **more):
    """Keys of ecCodes for a grid that scans to the east and north; points are longitude, latitude.

    Increments of grids in degrees follow from the corners.
    """
    counts = ("Nx", "Ny") if kind in ("lambert", "polar_stereographic") else ("Ni", "Nj")
    keys = {"gridType": kind, **dict(zip(counts, size, strict=True))}
    for name, point in (("First", first), ("Last", last)):
        if point is not None:
            keys[f"latitudeOf{name}GridPointInDegrees"] = point[1]
            keys[f"longitudeOf{name}GridPointInDegrees"] = point[0] % 360
    if last is not None and kind.endswith("_ll"):
        for axis, n, start, stop in zip("ij", size, first, last, strict=True):
            keys[f"{axis}DirectionIncrementInDegrees"] = round(abs(stop - start) / (n - 1), 3)
    return keys | {"iScansNegatively": 0, "jScansPositively": 1} | more


SOUTHWARD = {"jScansPositively": 0}
METRES = {"DxInMetres": 81271, "DyInMetres": 81271}
PARALLELS = {"LoVInDegrees": 265.0, "Latin1InDegrees": 25.0, "Latin2InDegrees": 25.0}
LAMBERT = grid_keys("lambert", (31, 21), (240.0, 22.5), **PARALLELS, **METRES, uvRelativeToGrid=1)
LATLON = grid_keys("regular_ll", (16, 11), (5.0, 60.0), (35.0, 40.0), **SOUTHWARD)
LATLON |= {"uvRelativeToGrid": 0}
SIZE = LATLON["Ni"] * LATLON["Nj"]
GLOBE = grid_keys("regular_ll", (36, 19), (0.0, 90.0), (350.0, -90.0), **SOUTHWARD)
POLE = {"latitudeOfSouthernPoleInDegrees": -35.0, "longitudeOfSouthernPoleInDegrees": 15.0}
ROTATED = grid_keys("rotated_ll", (16, 11), (-10.0, 10.0), (20.0, -10.0), **SOUTHWARD, **POLE)
ROTATED |= {"angleOfRotationInDegrees": 0.0, "uvRelativeToGrid": 1}
POLAR = grid_keys("polar_stereographic", (25, 19), (230.0, 30.0))
POLAR |= {"DxInMetres": 190500, "DyInMetres": 190500, "projectionCentreFlag": 0}
POLAR |= {"resolutionAndComponentFlags": 8, "orientationOfTheGridInDegrees": 255.0}
MERCATOR = grid_keys("mercator", (21, 15), (175.0, 10.0), (205.0, 32.0), LaDInDegrees=20.0)
MERCATOR |= {"DiInMetres": 160000, "DjInMetres": 160000, "uvRelativeToGrid": 1}
_EDITION_1 = {
    "polar_stereographic": "polar_stereographic_pl_grib1",
    "rotated_ll": "rotated_ll_pl_grib1",
}


def build(
    keys,
    values=None,
    *,
    edition=2,
    parameter="u",
    level=500,
    when=(20090801, 1200),
    step=0,
    packing="grid_simple",
    bits=16,
    extra=None,
    pv=None,
):
    """A message of the given grid; `values` in message order, NaN where missing."""
    sample = _EDITION_1.get(keys["gridType"], "regular_ll_pl_grib1")
    handle = eccodes.codes_grib_new_from_samples("GRIB2" if edition == 2 else sample)
    try:
        _identify(handle, edition, parameter, level, when, step)
        for key, value in keys.items():
            eccodes.codes_set(handle, key, value)
        count = eccodes.codes_get(handle, "Ni") * eccodes.codes_get(handle, "Nj")
        data = np.arange(count, dtype=float) if values is None else np.asarray(values, float)
        if np.isnan(data).any():
            eccodes.codes_set(handle, "bitmapPresent", 1)
            eccodes.codes_set(handle, "missingValue", 1e30)
            data = np.where(np.isnan(data), 1e30, data)
        eccodes.codes_set(handle, "bitsPerValue", bits)
        eccodes.codes_set_values(handle, data)
        if packing != "grid_simple":
            eccodes.codes_set(handle, "packingType", packing)
            eccodes.codes_set(handle, "bitsPerValue", bits)
            eccodes.codes_set_values(handle, data)
        for key, value in (extra or {}).items():
            eccodes.codes_set(handle, key, value)
        if pv is not None:
            eccodes.codes_set(handle, "PVPresent", 1)
            eccodes.codes_set_double_array(handle, "pv", pv.tolist())
        return bytes(eccodes.codes_get_message(handle))
    finally:
        eccodes.codes_release(handle)


def _identify(handle, edition, parameter, level, when, step):
    if edition == 1:
        number = {"u": 33, "v": 34, "t": 11}[parameter]
        keys = {"centre": 59, "table2Version": 2, "indicatorOfParameter": number}
        keys |= {"indicatorOfTypeOfLevel": 100, "timeRangeIndicator": 0, "unitOfTimeRange": 1}
    else:
        pair = {"u": (2, 2), "v": (2, 3), "t": (0, 0)}[parameter]
        keys = {"discipline": 0, "parameterCategory": pair[0], "parameterNumber": pair[1]}
        keys |= {"typeOfLevel": "isobaricInhPa"}
    keys |= {"dataDate": when[0], "dataTime": when[1], "level": level, "forecastTime": step}
    if edition == 1:
        keys |= {"P1": keys.pop("forecastTime")}
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)


def profile(levels, values=None, *, keys=LATLON, parameters="uv", **options):
    """Messages of u and v, both of the same values, on levels (hPa)."""
    return [
        build(keys, values, parameter=parameter, level=level, **options)
        for level in levels
        for parameter in parameters
    ]


def write(path, *messages):
    """A file of messages; its path."""
    path.write_bytes(b"".join(messages))
    return str(path)
