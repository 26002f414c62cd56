"""Chunks compressed beside the library are read by it, and copied as they are."""

from __future__ import annotations

import zlib
from pathlib import Path

import h5py
import netCDF4
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airswing.products.chunks import GrowingColumn, _deflated, _shuffled, copy_column

KINDS = ("i1", "i4", "i8", "f4", "f8")


def created(path: Path, kind: str, sizes: tuple[int, ...], chunk: int, **options) -> Path:
    """A file as products are: one variable, empty, one index of the first dimension a chunk."""
    with netCDF4.Dataset(path, "w") as file:
        names = ("reference", "report")[-len(sizes) :]
        for name, size in zip(names, sizes, strict=True):
            file.createDimension(name, size)
        chunks = (*(1 for _ in sizes[:-1]), min(chunk, sizes[-1]))
        asked = {"zlib": True, "complevel": 1, "shuffle": True, "chunksizes": chunks} | options
        file.createVariable("x", kind, names, **asked)
    return path


def read(path: Path) -> np.ndarray:
    with netCDF4.Dataset(path) as file:
        file.set_auto_maskandscale(False)
        return file["x"][...]


def numbers(kind: str, shape: tuple[int, ...], seed: int) -> np.ndarray:
    octets = np.random.default_rng(seed).integers(0, 256, (*shape, np.dtype(kind).itemsize), "u1")
    return octets.view(kind)[..., 0]


@settings(max_examples=60, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    parts=st.lists(st.integers(0, 25), min_size=1, max_size=8).filter(sum),
    references=st.sampled_from([None, 1, 3]),
    chunk=st.integers(1, 40),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_parts_in_any_chunks_are_read_as_given(
    tmp_path_factory, kind, parts, references, chunk, seed
):
    path = tmp_path_factory.mktemp("chunks") / "x.nc"
    sizes = (sum(parts),) if references is None else (references, sum(parts))
    values = numbers(kind, sizes, seed)
    with h5py.File(created(path, kind, sizes, chunk), "r+") as file:
        column = GrowingColumn(file["x"])
        for stop, size in zip(np.cumsum(parts), parts, strict=True):
            column.append(values[..., stop - size : stop])
    assert read(path).tobytes() == values.tobytes()


def test_what_is_written_is_smaller_and_says_how_it_is_stored(tmp_path):
    values = np.arange(100_000, dtype="i4")
    with h5py.File(created(tmp_path / "x.nc", "i4", values.shape, 65_536), "r+") as file:
        GrowingColumn(file["x"]).append(values)
    assert (tmp_path / "x.nc").stat().st_size < 0.1 * values.nbytes
    with netCDF4.Dataset(tmp_path / "x.nc") as file:
        filters = file["x"].filters()
        assert filters["zlib"] and filters["shuffle"] and filters["complevel"] == 1


def test_the_shuffle_worked_by_hand():
    values = np.array([0x04030201, 0x14131211], dtype="<i4")
    assert _shuffled(values).tolist() == [[0x01, 0x11], [0x02, 0x12], [0x03, 0x13], [0x04, 0x14]]


def test_the_stream_is_one_that_zlib_takes():
    octets = np.arange(1000, dtype="u1")
    assert zlib.decompress(_deflated(octets)) == octets.tobytes()


@pytest.mark.parametrize("sizes", [(100,), (3, 100), (1,)])
@pytest.mark.parametrize("options", [{}, {"shuffle": False}, {"chunksizes": None}, {"zlib": False}])
def test_a_copy_is_what_was_copied_however_it_is_stored(tmp_path, sizes, options):
    values = numbers("f4", sizes, 1)
    created(tmp_path / "a.nc", "f4", sizes, 16)
    created(tmp_path / "b.nc", "f4", sizes, 16, **options)
    with h5py.File(tmp_path / "a.nc", "r+") as a, h5py.File(tmp_path / "b.nc", "r+") as b:
        GrowingColumn(a["x"]).append(values)
        copy_column(a["x"], b["x"])
    assert read(tmp_path / "b.nc").tobytes() == values.tobytes()


def test_a_copy_of_the_same_storage_is_the_same_octets(tmp_path):
    for name in ("a.nc", "b.nc"):
        created(tmp_path / name, "f4", (3, 100), 16)
    with h5py.File(tmp_path / "a.nc", "r+") as a, h5py.File(tmp_path / "b.nc", "r+") as b:
        a["x"][...] = numbers("f4", (3, 100), 1)  # by the library, with zlib
        copy_column(a["x"], b["x"])
        for place in np.ndindex(3, 7):
            at = (place[0], 16 * place[1])
            assert a["x"].id.read_direct_chunk(at) == b["x"].id.read_direct_chunk(at)
