"""Native levels of GRIB: the pressure of ECMWF's by the pv section."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import airswing
from tests.reference.builders import GLOBE, build
from tests.reference.gridded.datasets import by_hand, points, winds

RNG = np.random.default_rng(21)


def message(values: np.ndarray, pv: np.ndarray | None = None, **keys: int) -> bytes:
    return build(GLOBE, values.ravel(), when=(20221111, 0), bits=24, extra=keys, pv=pv)


@pytest.mark.parametrize("surface", ["lnsp", "sp"])
def test_ecmwf_model_levels(surface: str, tmp_path: Path) -> None:
    count = 8
    half = np.linspace(0.0, 1.0, count + 1)
    a, b = 15000.0 * half * (1 - half), half**1.3
    pv = np.concatenate([a, b])
    u, v = RNG.normal(10, 15, (2, count, 19, 36))
    ps = RNG.uniform(85000.0, 102000.0, (19, 36))
    found = [
        message(field[k], pv, parameterNumber=number, typeOfFirstFixedSurface=105, level=k + 1)
        for k in range(count)
        for number, field in ((2, u), (3, v))
    ]
    if surface == "lnsp":
        keys = {"parameterCategory": 3, "parameterNumber": 25, "typeOfFirstFixedSurface": 105}
        found.append(message(np.log(ps), pv, **keys, level=1))
    else:
        keys = {"parameterCategory": 3, "parameterNumber": 0, "typeOfFirstFixedSurface": 1}
        found.append(message(ps, **keys))
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
