"""A product written block by block is the product written at once."""

from __future__ import annotations

import resource
import signal

import numpy as np
import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.products.netcdf import provenance, read_product, write_product
from airswing.products.ragged import blocks, joined
from airswing.products.ragged_product import ragged_writer, still_in_file

SIZES = [3, 0, 4, 1, 5]


def archive() -> xr.Dataset:
    number = np.arange(float(sum(SIZES)))
    return xr.Dataset(
        {
            "row_size": ("aircraft", np.array(SIZES, dtype="i4")),
            "position_resolution": ("aircraft", np.linspace(0.1, 0.5, len(SIZES))),
            "time": ("report", (number * 1e9).astype("M8[ns]")),
            "latitude": ("report", number),
            "heading": ("report", np.where(number == 4, np.nan, number).astype("f4")),
            "phase": ("report", (number % 4).astype("i1")),
            "screening": ("report", (number % 2).astype("i4")),
            "heading_error": (("reference", "report"), np.array([number, -number], dtype="f4")),
        },
        coords={
            "aircraft": np.array([f"N{k}" for k in range(len(SIZES))], dtype=object),
            "reference": np.array(["ruc", "a longer name"], dtype=object),
        },
    )


def written(path, limit: int) -> xr.Dataset:
    whole = archive()
    sizes = {"reports": whole.sizes["report"], "aircraft": whole.sizes["aircraft"]}
    with ragged_writer(path, **sizes) as writer:
        for block in blocks(whole, limit=limit):
            writer.append(block)
        writer.finish(provenance("test") | {"reference_audit": {"ruc": [1, 2]}})
    return whole


@pytest.mark.parametrize("limit", [1, 5, 7, 1000])
def test_blocks_make_the_product_written_at_once(tmp_path, limit):
    whole = written(tmp_path / "blocks.nc", limit)
    attrs = {"reference_audit": {"ruc": [1, 2]}}
    write_product(whole.assign_attrs(attrs), tmp_path / "whole.nc", title="test")
    options = {"engine": "netcdf4", "decode_cf": False}
    with (
        xr.open_dataset(tmp_path / "blocks.nc", **options) as one,
        xr.open_dataset(tmp_path / "whole.nc", **options) as other,
    ):
        assert set(one.attrs) == set(other.attrs)
        assert one.attrs["reference_audit"] == other.attrs["reference_audit"]
        assert set(one.variables) == set(other.variables)
        for name in one.variables:
            np.testing.assert_array_equal(one[name].to_numpy(), other[name].to_numpy(), str(name))
            assert one[name].dtype == other[name].dtype
            for key in ("zlib", "complevel", "shuffle", "chunksizes"):
                assert one[name].encoding.get(key) == other[name].encoding.get(key)
            assert set(one[name].attrs) == set(other[name].attrs)
            for key, value in one[name].attrs.items():
                np.testing.assert_array_equal(value, other[name].attrs[key])


@pytest.mark.parametrize("lazy", [True, False])
def test_blocks_of_a_product_are_the_archive(tmp_path, lazy):
    written(tmp_path / "a.nc", 1000)
    found = read_product(tmp_path / "a.nc", lazy=lazy)
    whole = read_product(tmp_path / "a.nc")
    parts = list(blocks(found, limit=4))
    assert [part.sizes["aircraft"] for part in parts] == [2, 1, 1, 1]
    xr.testing.assert_equal(joined(parts), whole)
    some = list(blocks(found, ["heading"], limit=4))
    assert set(some[0].data_vars) == {"heading", "row_size"}


def test_a_lazy_product_is_not_held(tmp_path):
    written(tmp_path / "a.nc", 1000)
    found = read_product(tmp_path / "a.nc", lazy=True)
    found["heading"].to_numpy()
    assert not found["heading"].variable._in_memory


def test_a_failure_leaves_the_earlier_product(tmp_path):
    written(tmp_path / "a.nc", 1000)
    before = (tmp_path / "a.nc").read_bytes()
    with (
        pytest.raises(InputError, match="stopped"),
        ragged_writer(tmp_path / "a.nc", reports=13, aircraft=5) as writer,
    ):
        writer.append(next(blocks(archive(), limit=4)))
        raise InputError("stopped")
    assert (tmp_path / "a.nc").read_bytes() == before
    assert not list(tmp_path.glob(".*"))


def test_what_was_not_finished_takes_no_name(tmp_path):
    with (
        pytest.raises(ValueError, match=r"a\.nc: the product was not finished"),
        ragged_writer(tmp_path / "a.nc", reports=13, aircraft=5) as writer,
    ):
        writer.append(archive())
    assert not list(tmp_path.iterdir())


def carried_on(tmp_path, columns: list[str]) -> xr.Dataset:
    """The archive written once, and again with some of its columns carried on."""
    whole = written(tmp_path / "first.nc", 1000)
    kept = read_product(tmp_path / "first.nc", lazy=True)[columns]
    sizes = {"reports": whole.sizes["report"], "aircraft": whole.sizes["aircraft"]}
    with ragged_writer(tmp_path / "second.nc", **sizes, carried=kept) as writer:
        for block in blocks(whole, limit=5):
            writer.append(block.drop_vars("time"))
        writer.finish(provenance("test"))
    return whole


def test_columns_carried_on_are_those_of_the_first_product(tmp_path):
    carried_on(tmp_path, ["time", "heading", "heading_error"])
    options = {"engine": "netcdf4", "decode_cf": False}
    with (
        xr.open_dataset(tmp_path / "first.nc", **options) as one,
        xr.open_dataset(tmp_path / "second.nc", **options) as other,
    ):
        assert set(one.variables) == set(other.variables)
        for name in one.variables:
            xr.testing.assert_identical(one[name], other[name])
            assert one[name].encoding["dtype"] == other[name].encoding["dtype"]


def test_what_was_taken_into_memory_is_not_carried_on(tmp_path):
    whole = written(tmp_path / "a.nc", 1000)
    found = read_product(tmp_path / "a.nc", lazy=True)
    assert still_in_file(found[["time", "heading"]])
    assert not still_in_file(found.assign(heading=whole["heading"])[["time", "heading"]])
    assert not still_in_file(read_product(tmp_path / "a.nc")[["time", "heading"]])
    assert not still_in_file(whole[["time", "heading"]])


@pytest.mark.parametrize("limit", [0, 1_000, 20_000, 200_000, 400_000])
def test_a_full_disk_is_one_clear_error(tmp_path, limit):
    """A limit on file size stands for the full disk, at the first octet, in the middle, late."""
    rng = np.random.default_rng(0)
    sizes = {"reports": 60_000, "aircraft": 2}
    half = xr.Dataset(
        {"row_size": ("aircraft", [30_000]), "latitude": ("report", rng.random(30_000))},
        coords={"aircraft": np.array(["N1"], dtype=object)},
    )
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
        with (
            pytest.raises(InputError, match="cannot write the product"),
            ragged_writer(tmp_path / "a.nc", **sizes) as writer,
        ):
            writer.append(half)
            writer.append(half)
            writer.finish(provenance("test"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert not list(tmp_path.iterdir())
