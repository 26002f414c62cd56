"""Blocks of a Blosc chunk are what the whole chunk has there, and damage is said."""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

import numcodecs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airswing.reference.gridded.blosc_blocks import octets_of_blocks


def octets(chunk: bytes, size: int, wanted: list[int]) -> np.ndarray:
    with tempfile.TemporaryFile(buffering=0) as file:
        file.write(chunk)
        return np.asarray(octets_of_blocks(file, size, np.array(wanted, dtype=np.int64)))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_blocks_are_what_the_whole_chunk_has_there(data: st.DataObject) -> None:
    codec = numcodecs.Blosc(
        cname=data.draw(st.sampled_from(["lz4", "zstd", "zlib", "blosclz", "lz4hc"])),
        clevel=data.draw(st.integers(0, 9)),
        shuffle=data.draw(st.sampled_from([0, 1, 2])),
        blocksize=data.draw(st.sampled_from([0, 128, 300, 4096])),
    )
    dtype = data.draw(st.sampled_from(["u1", "<i2", ">i2", "<f4", ">f4", "<f8", "<i8"]))
    count = data.draw(st.sampled_from([1, 50, 4000, 90001]))
    spread = data.draw(st.sampled_from([0, 3, 120]))
    seed = data.draw(st.integers(0, 99))
    plain = np.random.default_rng(seed).integers(0, spread + 1, count).astype(dtype).view("u1")
    wanted = data.draw(st.lists(st.integers(0, plain.size - 1), min_size=1, max_size=5))
    found = octets(codec.encode(plain.view(dtype)), plain.size, wanted)
    np.testing.assert_array_equal(found, plain[wanted])


def chunk_of_blocks() -> tuple[np.ndarray, bytes]:
    """Seven whole blocks of 65,536 octets (sixteen times what Blosc is told) and a short one."""
    plain = np.arange(7 * 16384 + 5000, dtype="f4")
    return plain.view("u1"), numcodecs.Blosc("lz4", 5, 1, blocksize=4096).encode(plain)


def test_the_other_blocks_are_not_touched() -> None:
    plain, chunk = chunk_of_blocks()
    begins = struct.unpack_from("<8I", chunk, 16)
    damaged = bytearray(chunk)
    for begin in begins[3:6]:
        damaged[begin : begin + 8] = b"\xff" * 8
    wanted = [0, 70000, 196607, plain.size - 1]  # blocks 0, 1, 2 and the last
    np.testing.assert_array_equal(octets(damaged, plain.size, wanted), plain[wanted])
    with pytest.raises(RuntimeError):
        octets(damaged, plain.size, [196608])


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda chunk: chunk[:10], "10 octets"),
        (lambda chunk: b"", "0 octets"),
        (lambda chunk: chunk[:-1], "says"),
        (lambda chunk: chunk[:8] + bytes(4) + chunk[12:], "says"),
        (lambda chunk: chunk[:4] + bytes(4) + chunk[8:], "says"),
        (lambda chunk: chunk[:16] + b"\xff" * 4 + chunk[20:], "do not lie in it"),
        (lambda chunk: chunk[:16] + bytes(4) + chunk[20:], "do not lie in it"),
    ],
)
def test_damage_is_said(damage: object, said: str) -> None:
    plain, chunk = chunk_of_blocks()
    with pytest.raises(ValueError, match=said):
        octets(damage(chunk), plain.size, [3])  # type: ignore[operator]


def test_a_store_of_version_2_reads_blocks(tmp_path: Path) -> None:
    import xarray as xr

    from airswing.reference.gridded.raw_chunks import raw_variable

    values = np.random.default_rng(1).integers(-99, 99, (4, 60, 70)).astype(">i2")
    ds = xr.Dataset({"u": (("z", "y", "x"), values)})
    how = {"u": {"compressors": numcodecs.Blosc(blocksize=512), "chunks": (4, 60, 70)}}
    ds.to_zarr(tmp_path / "a.zarr", zarr_format=2, consolidated=False, encoding=how)
    with xr.open_dataset(tmp_path / "a.zarr", engine="zarr", cache=False) as opened:
        raw = raw_variable(opened, "u", (4, 60, 70))
        assert raw is not None
        flat = np.array([9, 11, 8000, values.size - 1])
        np.testing.assert_array_equal(raw.values((0, 0, 0), flat), values.ravel()[flat])
