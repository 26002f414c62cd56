"""GRIB messages of every grid and packing, built by eccodes for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import eccodes
import numpy as np

import airswing  # noqa: F401

LAMBERT = {
    "gridType": "lambert",
    "Nx": 31,
    "Ny": 21,
    "latitudeOfFirstGridPointInDegrees": 22.5,
    "longitudeOfFirstGridPointInDegrees": 240.0,
    "LoVInDegrees": 265.0,
    "Latin1InDegrees": 25.0,
    "Latin2InDegrees": 25.0,
    "DxInMetres": 81271,
    "DyInMetres": 81271,
    "iScansNegatively": 0,
    "jScansPositively": 1,
    "uvRelativeToGrid": 1,
}
LATLON = {
    "gridType": "regular_ll",
    "Ni": 16,
    "Nj": 11,
    "latitudeOfFirstGridPointInDegrees": 60.0,
    "longitudeOfFirstGridPointInDegrees": 5.0,
    "latitudeOfLastGridPointInDegrees": 40.0,
    "longitudeOfLastGridPointInDegrees": 35.0,
    "iDirectionIncrementInDegrees": 2.0,
    "jDirectionIncrementInDegrees": 2.0,
    "iScansNegatively": 0,
    "jScansPositively": 0,
    "uvRelativeToGrid": 0,
}
ROTATED = {
    **LATLON,
    "gridType": "rotated_ll",
    "latitudeOfFirstGridPointInDegrees": 10.0,
    "longitudeOfFirstGridPointInDegrees": 350.0,
    "latitudeOfLastGridPointInDegrees": -10.0,
    "longitudeOfLastGridPointInDegrees": 20.0,
    "latitudeOfSouthernPoleInDegrees": -35.0,
    "longitudeOfSouthernPoleInDegrees": 15.0,
    "angleOfRotationInDegrees": 0.0,
    "uvRelativeToGrid": 1,
}
POLAR = {
    "gridType": "polar_stereographic",
    "Nx": 25,
    "Ny": 19,
    "latitudeOfFirstGridPointInDegrees": 30.0,
    "longitudeOfFirstGridPointInDegrees": 230.0,
    "orientationOfTheGridInDegrees": 255.0,
    "DxInMetres": 190500,
    "DyInMetres": 190500,
    "iScansNegatively": 0,
    "jScansPositively": 1,
    "resolutionAndComponentFlags": 8,
    "projectionCentreFlag": 0,
}
MERCATOR = {
    "gridType": "mercator",
    "Ni": 21,
    "Nj": 15,
    "latitudeOfFirstGridPointInDegrees": 10.0,
    "longitudeOfFirstGridPointInDegrees": 175.0,
    "latitudeOfLastGridPointInDegrees": 32.0,
    "longitudeOfLastGridPointInDegrees": 205.0,
    "DiInMetres": 160000,
    "DjInMetres": 160000,
    "LaDInDegrees": 20.0,
    "iScansNegatively": 0,
    "jScansPositively": 1,
    "uvRelativeToGrid": 1,
}
_EDITION_1 = {
    "polar_stereographic": "polar_stereographic_pl_grib1",
    "rotated_ll": "rotated_ll_pl_grib1",
}


def build(
    keys: dict[str, Any],
    values: np.ndarray | None = None,
    *,
    edition: int = 2,
    parameter: str = "u",
    level: int = 500,
    when: tuple[int, int] = (20090801, 1200),
    step: int = 0,
    packing: str = "grid_simple",
    bits: int = 16,
    extra: dict[str, Any] | None = None,
    pv: np.ndarray | None = None,
) -> bytes:
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


def _identify(
    handle: int, edition: int, parameter: str, level: int, when: tuple[int, int], step: int
) -> None:
    if edition == 1:
        number = {"u": 33, "v": 34, "t": 11}[parameter]
        keys: dict[str, Any] = {"centre": 59, "table2Version": 2, "indicatorOfParameter": number}
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


def write(path: Path, *messages: bytes) -> str:
    """A file of messages; its path."""
    path.write_bytes(b"".join(messages))
    return str(path)
