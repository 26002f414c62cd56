"""Native levels of GRIB: ECMWF's by the pv section, RAP's on its own grid with its pressure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import eccodes
import numpy as np
import pytest
from pyproj import Transformer

import airswing
from tests.reference.gridded.datasets import by_hand, points, turned, winds

RNG = np.random.default_rng(21)


def message(keys: dict[str, Any], values: np.ndarray, pv: np.ndarray | None = None) -> bytes:
    handle = eccodes.codes_grib_new_from_samples("GRIB2")
    try:
        for key, value in keys.items():
            eccodes.codes_set(handle, key, value)
        if pv is not None:
            eccodes.codes_set(handle, "PVPresent", 1)
            eccodes.codes_set_double_array(handle, "pv", pv.tolist())
        eccodes.codes_set(handle, "bitsPerValue", 24)
        eccodes.codes_set_values(handle, values.ravel().astype(float))
        return bytes(eccodes.codes_get_message(handle))
    finally:
        eccodes.codes_release(handle)


GLOBE = {
    "gridType": "regular_ll",
    "Ni": 36,
    "Nj": 19,
    "latitudeOfFirstGridPointInDegrees": 90.0,
    "longitudeOfFirstGridPointInDegrees": 0.0,
    "latitudeOfLastGridPointInDegrees": -90.0,
    "longitudeOfLastGridPointInDegrees": 350.0,
    "iDirectionIncrementInDegrees": 10.0,
    "jDirectionIncrementInDegrees": 10.0,
    "dataDate": 20221111,
    "dataTime": 0,
}


@pytest.mark.parametrize("surface", ["lnsp", "sp"])
def test_ecmwf_model_levels(surface: str, tmp_path: Path) -> None:
    count = 8
    half = np.linspace(0.0, 1.0, count + 1)
    a, b = 15000.0 * half * (1 - half), half**1.3
    pv = np.concatenate([a, b])
    u, v = RNG.normal(10, 15, (2, count, 19, 36))
    ps = RNG.uniform(85000.0, 102000.0, (19, 36))
    level = {"typeOfFirstFixedSurface": 105}
    found = [
        message(
            GLOBE
            | {
                "discipline": 0,
                "parameterCategory": 2,
                "parameterNumber": number,
                **level,
                "level": k + 1,
            },
            field[k],
            pv,
        )
        for k in range(count)
        for number, field in ((2, u), (3, v))
    ]
    if surface == "lnsp":
        keys = {"discipline": 0, "parameterCategory": 3, "parameterNumber": 25, **level, "level": 1}
        found.append(message(GLOBE | keys, np.log(ps), pv))
    else:
        keys = {
            "discipline": 0,
            "parameterCategory": 3,
            "parameterNumber": 0,
            "typeOfFirstFixedSurface": 1,
        }
        found.append(message(GLOBE | keys, ps))
    path = tmp_path / "ml.grib2"
    path.write_bytes(b"".join(found))
    model = airswing.build_catalogue(str(path), name="ifs", cache_dir=tmp_path)
    assert "cfgrib" in model.notes[0] and "slower" in model.notes[0]
    lat, lon = RNG.uniform(-85, 85, 120), RNG.uniform(-180, 180, 120)
    p = RNG.uniform(20000.0, 75000.0, 120)
    pressure = (a[1:] + a[:-1])[:, None, None] / 2 + (b[1:] + b[:-1])[:, None, None] / 2 * ps
    want = by_hand(u, v, pressure, np.mod(lon, 360) / 10, (90 - lat) / 10, p)
    got = winds(airswing.collocate(points(lat, lon, p), {"ifs": model}))
    assert np.isfinite(want[0]).all()
    np.testing.assert_allclose(got, want, atol=1e-3)
    assert not list(tmp_path.glob("*.idx"))


def test_rap_native_levels_on_its_own_grid(tmp_path: Path) -> None:
    """Template 3.32769: geographic corners, a centre, winds along the rotated grid."""
    ni, nj, step, count = 31, 21, 1.0, 6
    centre = (54.0, -106.0)
    text = f"+proj=ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p={90 - centre[0]} +lon_0={centre[1]}"
    # The rotated north pole lies 90 degrees north of the centre, beyond the true one.
    rotate = Transformer.from_crs("+proj=longlat +R=6371229", text + " +R=6371229", always_xy=True)
    x, y = (np.arange(ni) - 15) * step, (np.arange(nj) - 10) * step
    (lon1, lat1), (lon2, lat2) = (
        rotate.transform(x[n], y[n], direction="INVERSE") for n in (0, -1)
    )
    grid = {
        "centre": "kwbc",
        "gridDefinitionTemplateNumber": 32769,
        "shapeOfTheEarth": 6,
        "Ni": ni,
        "Nj": nj,
        "numberOfDataPoints": ni * nj,
        "latitudeOfFirstGridPoint": round(lat1 * 1e6),
        "longitudeOfFirstGridPoint": round(lon1 * 1e6) % 360_000_000,
        "resolutionAndComponentFlags": 56,
        "scanningMode": 64,
        "dataDate": 20221111,
        "dataTime": 0,
    }
    u, v = RNG.normal(10, 15, (2, count, nj, ni))
    pressure = np.linspace(95000.0, 20000.0, count)[:, None, None] * RNG.uniform(
        0.97, 1.03, (1, nj, ni)
    )
    found = []
    for k in range(count):
        for (category, number), field in (((2, 2), u), ((2, 3), v), ((3, 0), pressure)):
            keys = {
                "discipline": 0,
                "parameterCategory": category,
                "parameterNumber": number,
                "typeOfFirstFixedSurface": 105,
                "level": k + 1,
            }
            found.append(centred(message(grid | keys, field[k]), centre, step, (lat2, lon2)))
    path = tmp_path / "rap.grib2"
    path.write_bytes(b"".join(found))
    model = airswing.build_catalogue(str(path), name="rap", cache_dir=tmp_path)
    fi, fj = RNG.uniform(0, ni - 1, 150), RNG.uniform(0, nj - 1, 150)
    px, py = x[0] + fi * step, y[0] + fj * step
    lon, lat = (np.asarray(one) for one in rotate.transform(px, py, direction="INVERSE"))
    p = RNG.uniform(22000.0, 90000.0, 150)
    ahead = rotate.transform(px, py + 1e-5, direction="INVERSE")
    north = np.arctan2((ahead[0] - lon) * np.cos(np.radians(lat)), ahead[1] - lat)
    assert np.abs(north).max() > 0.1
    want = turned(*by_hand(u, v, pressure, fi, fj, p), north)
    got = winds(airswing.collocate(points(lat, lon, p), {"rap": model}))
    assert np.isfinite(want[0]).all()
    np.testing.assert_allclose(got, want, atol=2e-3)  # corners to a millionth of a degree


def centred(
    whole: bytes, centre: tuple[float, float], step: float, last: tuple[float, float]
) -> bytes:
    """Put centre, increments and last point where NCEP has them (ecCodes knows no centre)."""
    content, at = bytearray(whole), 16
    while content[at + 4] != 3:
        at += int.from_bytes(content[at : at + 4], "big")
    assert int.from_bytes(content[at : at + 4], "big") == 80
    degrees = (centre[0], centre[1] % 360, step, step, last[0], last[1] % 360)
    for place, value in zip((55, 59, 63, 67, 72, 76), degrees, strict=True):
        content[at + place : at + place + 4] = round(value * 1e6).to_bytes(4, "big")
    return bytes(content)
