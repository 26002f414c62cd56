"""Chunks read as they are stored give what xarray reads, in every way they are stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from airswing.reference.gridded.raw_chunks import raw_variable

SHAPE, CHUNKS = (3, 5, 7, 9), (1, 2, 4, 5)
DIMS = ("time", "level", "y", "x")
PACKED = {"dtype": "int16", "scale_factor": 0.01, "add_offset": 5.0, "_FillValue": -32767}


def dataset() -> xr.Dataset:
    values = np.random.default_rng(2).normal(0, 20, SHAPE).astype("f4")
    values[0, 1, 2, 3] = np.nan
    return xr.Dataset({"u": (DIMS, values)})


def check(path: Path, engine: str, *, expected: bool = True) -> None:
    with xr.open_dataset(path, engine=engine, cache=False) as ds:
        raw = raw_variable(ds, "u", CHUNKS)
        assert (raw is not None) == expected
        if raw is None:
            return
        plain = ds["u"].to_numpy()
        starts = [range(0, n, c) for n, c in zip(SHAPE, CHUNKS, strict=True)]
        for place in np.array(np.meshgrid(*starts, indexing="ij")).reshape(4, -1).T:
            box = tuple(
                slice(a, min(a + c, n)) for a, c, n in zip(place, CHUNKS, SHAPE, strict=True)
            )
            part = plain[box]
            inside = np.indices(part.shape).reshape(4, -1)
            flat = np.ravel_multi_index(tuple(inside), CHUNKS)
            found = raw.values(tuple(int(one) for one in place), flat)
            assert found is not None
            np.testing.assert_allclose(found, part.ravel(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "how",
    [
        {"zlib": True, "shuffle": True},
        {"zlib": True, "shuffle": False},
        {},
        {"zlib": True, **PACKED},
        {"zlib": True, "dtype": "f8", "_FillValue": 1e20},
        {"zlib": True, "dtype": ">f4"},
        {"dtype": "float32", "_FillValue": np.float32(-9999)},
    ],
)
def test_netcdf(how: dict, tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    dataset().to_netcdf(path, encoding={"u": {"chunksizes": CHUNKS, **how}})
    check(path, "netcdf4")


@pytest.mark.parametrize(
    "how", [{"zlib": True, "fletcher32": True}, {"zlib": True, "_Unsigned": 1}]
)
def test_other_filters_are_left_to_the_library(how: dict, tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    unsigned = how.pop("_Unsigned", None)
    ds = dataset()
    if unsigned:
        ds = xr.Dataset({"u": (DIMS, np.ones(SHAPE, "i2"), {"_Unsigned": "true"})})
    ds.to_netcdf(path, encoding={"u": {"chunksizes": CHUNKS, **how}})
    check(path, "netcdf4", expected=False)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("codec", ["default", "none", "blosc", "gzip", "zstd"])
@pytest.mark.parametrize("packed", [False, True])
def test_zarr(version: int, codec: str, packed: bool, tmp_path: Path) -> None:
    import numcodecs
    from zarr.codecs import BloscCodec, GzipCodec, ZstdCodec

    if version == 3:
        known = {"none": None, "blosc": BloscCodec(), "gzip": GzipCodec(), "zstd": ZstdCodec()}
    else:
        known = {
            "none": None,
            "blosc": numcodecs.Blosc(),
            "gzip": numcodecs.GZip(),
            "zstd": numcodecs.Zstd(),
        }
    encoding: dict = dict(PACKED) if packed else {}
    if codec != "default":
        encoding["compressors"] = known[codec]
    path = tmp_path / "a.zarr"
    dataset().chunk(dict(zip(DIMS, CHUNKS, strict=True))).to_zarr(
        path, zarr_format=version, consolidated=False, encoding={"u": encoding}
    )
    check(path, "zarr")


def test_shards_and_damage(tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    dataset().to_zarr(
        path,
        zarr_format=3,
        consolidated=False,
        encoding={"u": {"chunks": CHUNKS, "shards": (1, 4, 8, 10)}},
    )
    check(path, "zarr", expected=False)
    path = tmp_path / "d.zarr"
    encoding = {"u": {"chunks": CHUNKS, "compressors": None}}
    dataset().to_zarr(path, zarr_format=3, consolidated=False, encoding=encoding)
    with xr.open_dataset(path, engine="zarr", cache=False) as ds:
        raw = raw_variable(ds, "u", CHUNKS)
        assert raw is not None
        (path / "u" / "c" / "0" / "0" / "0" / "0").write_bytes(b"\0" * 12)
        with pytest.raises(ValueError, match="12 octets"):
            raw.values((0, 0, 0, 0), np.arange(3))
        (path / "u" / "c" / "0" / "0" / "0" / "0").unlink()
        assert raw.values((0, 0, 0, 0), np.arange(3)) is None
