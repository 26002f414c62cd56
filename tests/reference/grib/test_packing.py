"""Sparse reading against eccodes, to the last bit."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import eccodes
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.reference.builders import LAMBERT, LATLON, build, write

from airswing.reference.grib.messages import scan_file
from airswing.reference.grib.values import field_values
from airswing.reference.packing.octets import ibm_float
from airswing.reference.packing.simple_packing import (
    MAX_BITS,
    SimplePacking,
    UnreadableMessageError,
    power,
    sparse_values,
)

SIZE = LATLON["Ni"] * LATLON["Nj"]
WRF = "grib/wrf_ruc13_g212/"


def both_ways(path: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """(sparse, decoded) values of every point of every field of a file."""
    contents = scan_file(path)
    descriptor = os.open(path, os.O_RDONLY)
    pairs = []
    try:
        for row in contents.table():
            size = grid_size(contents, int(row["grid"]))
            points = np.arange(size)
            pairs.append(
                tuple(field_values(descriptor, row, size, points, sparse=s) for s in (True, False))
            )
    finally:
        os.close(descriptor)
    return pairs


def grid_size(contents, number: int) -> int:
    from airswing.reference.grib.gridsections import read_grid

    return read_grid(*contents.grids[number]).size


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return np.array_equal(a.view(np.uint64)[~np.isnan(a)], b.view(np.uint64)[~np.isnan(b)]) and (
        np.array_equal(np.isnan(a), np.isnan(b))
    )


def eccodes_values(message: bytes) -> np.ndarray:
    """Values of a message by eccodes alone."""
    handle = eccodes.codes_new_from_message(message)
    eccodes.codes_set(handle, "missingValue", 1e300)
    values = eccodes.codes_get_values(handle)
    eccodes.codes_release(handle)
    return np.where(values == 1e300, np.nan, values)


def simple_message(
    edition: int,
    raw: np.ndarray,
    bits: int,
    reference: float,
    binary: int,
    decimal: int,
    present: np.ndarray,
) -> bytes:
    """A simply packed message put together octet by octet around a grid eccodes wrote."""
    base = build(LATLON, edition=edition, bits=8)
    packed = (
        np.packbits(
            ((raw[present][:, None] >> np.arange(bits - 1, -1, -1, dtype=np.uint64)) & np.uint64(1))
            .astype(np.uint8)
            .ravel()
        ).tobytes()
        if bits
        else b""
    )
    packed += b"\0" * (len(packed) % 2)
    mask = b"" if present.all() else np.packbits(present).tobytes()
    sign = lambda n: (abs(n) | 0x8000 if n < 0 else n).to_bytes(2, "big")  # noqa: E731
    if edition == 1:
        product = bytearray(base[8:36])
        product[7] = 0x80 | (0x40 if mask else 0)
        product[26:28] = sign(decimal)
        length = int.from_bytes(base[36:39], "big")
        body = bytes(product) + base[36 : 36 + length]
        if mask:
            mask += b"\0" * (len(mask) % 2)
            unused = len(mask) * 8 - present.size
            body += (6 + len(mask)).to_bytes(3, "big") + bytes([unused, 0, 0]) + mask
        exponent = ibm_bytes(reference)
        unused = len(packed) * 8 - int(present.sum()) * bits
        body += (11 + len(packed)).to_bytes(3, "big") + bytes([unused & 0x0F])
        body += sign(binary) + exponent + bytes([bits]) + packed
        return b"GRIB" + (8 + len(body) + 4).to_bytes(3, "big") + b"\x01" + body + b"7777"
    at, body = 16, b""
    while base[at : at + 4] != b"7777":
        length, number = int.from_bytes(base[at : at + 4], "big"), base[at + 4]
        section = base[at : at + length]
        if number == 5:
            section = (
                (21).to_bytes(4, "big")
                + b"\x05"
                + int(present.sum()).to_bytes(4, "big")
                + b"\0\0"
                + struct.pack(">f", reference)
                + sign(binary)
                + sign(decimal)
                + bytes([bits, 0])
            )
        elif number == 6:
            section = (6 + len(mask)).to_bytes(4, "big") + b"\x06" + (b"\0" if mask else b"\xff")
            section += mask
        elif number == 7:
            section = (5 + len(packed)).to_bytes(4, "big") + b"\x07" + packed
        body += section
        at += length
    return base[:8] + (16 + len(body) + 4).to_bytes(8, "big") + body + b"7777"


def ibm_bytes(value: float) -> bytes:
    """An IBM float near a value."""
    if value == 0:
        return b"\0\0\0\0"
    exponent, fraction = 64, abs(value)
    while fraction >= 1:
        fraction, exponent = fraction / 16, exponent + 1
    while fraction < 1 / 16:
        fraction, exponent = fraction * 16, exponent - 1
    word = int(fraction * 2**24)
    return bytes([exponent | (0x80 if value < 0 else 0)]) + word.to_bytes(3, "big")


@given(
    edition=st.sampled_from([1, 2]),
    bits=st.integers(0, 32),
    binary=st.integers(-20, 12),
    decimal=st.integers(-4, 8),
    lowest=st.floats(-149.0, 149.0, width=32, allow_subnormal=False),
    missing_share=st.sampled_from([0.0, 0.0, 0.1, 0.6, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
@example(1, 0, 0, 2, -13.5, 0.0, 0)
@example(2, 0, 3, 2, -13.5, 0.3, 0)
@example(2, 32, -31, 0, 1.5, 0.0, 1)
@example(2, 0, 0, 0, -0.0, 0.0, 0)
@example(1, 0, 0, 0, -0.0, 0.0, 0)
def test_sparse_equals_eccodes_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory,
    edition: int,
    bits: int,
    binary: int,
    decimal: int,
    lowest: float,
    missing_share: float,
    seed: int,
) -> None:
    reference = lowest * 10.0**decimal  # winds beyond 150 m/s are no winds
    rng = np.random.default_rng(seed)
    raw = rng.integers(0, 2**bits, SIZE, dtype=np.uint64)
    present = rng.random(SIZE) >= missing_share
    message = simple_message(edition, raw, bits, reference, binary, decimal, present)
    path = write(tmp_path_factory.mktemp("p") / "m.grib", message)
    contents = scan_file(path)
    (row,) = contents.table()
    assert row["sparse"]
    descriptor = os.open(path, os.O_RDONLY)
    try:
        points = rng.permutation(SIZE)[: rng.integers(1, SIZE)]
        mine = field_values(descriptor, row, SIZE, points, sparse=True)
    finally:
        os.close(descriptor)
    theirs = eccodes_values(message)[points]
    assert same_bits(mine, theirs), (mine[:5], theirs[:5])
    assert np.isnan(mine).any() == (~present[points]).any()


@pytest.mark.parametrize("edition", [1, 2])
@pytest.mark.parametrize("bits", [1, 7, 8, 12, 16, 24, 25, 31, 32])
def test_fields_packed_by_eccodes(edition: int, bits: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(bits)
    values = rng.normal(5, 20, SIZE)
    values[rng.random(SIZE) < 0.2] = np.nan
    message = build(LATLON, values, edition=edition, bits=bits)
    ((mine, _),) = both_ways(write(tmp_path / "f.grib", message))
    assert same_bits(mine, eccodes_values(message))
    if bits >= 12:
        np.testing.assert_allclose(mine, values, atol=0.05)


def test_widths_above_the_limit_are_left_to_eccodes(tmp_path: Path) -> None:
    raw = np.zeros(SIZE, dtype=np.uint64)
    for bits, sparse in ((MAX_BITS, True), (MAX_BITS + 1, False)):
        message = simple_message(2, raw, bits, 1.0, 0, 0, np.ones(SIZE, dtype=bool))
        (row,) = scan_file(write(tmp_path / "w.grib", message)).table()
        assert row["sparse"] == sparse


@pytest.mark.parametrize(
    "name",
    [
        *(WRF + f"2005080700_wrfprs_ruc13_{h:02d}.tm00_G212" for h in range(0, 25, 3)),
        WRF + "2005080712_wrfprs_ruc13_00.tm00_G212",
        "grib/uv_on_different_levels.grib",
        "grib/nam_g211_20180917_00z.grib2",
        "grib/jma_meps_20190605_regular_ll.grib2",
    ],
)
def test_every_real_wind_is_the_same_both_ways(name: str, real: Callable[[str], Path]) -> None:
    path = str(real(name))
    pairs = both_ways(path)
    assert pairs
    for mine, theirs in pairs:
        assert same_bits(mine, theirs)
    eccodes.codes_grib_multi_support_on()
    try:
        with open(path, "rb") as file:
            seen = independent_winds(file)
    finally:
        eccodes.codes_grib_multi_support_off()
    assert len(seen) == len(pairs)
    for (mine, _), theirs in zip(pairs, seen, strict=True):
        assert same_bits(mine, theirs)


def independent_winds(file) -> list[np.ndarray]:
    """Isobaric u and v of a file by eccodes' own multi-field reading, in order."""
    found = []
    while (handle := eccodes.codes_grib_new_from_file(file)) is not None:
        name = eccodes.codes_get(handle, "shortName")
        kind = eccodes.codes_get(handle, "typeOfLevel")
        if name in ("u", "v") and kind == "isobaricInhPa":
            eccodes.codes_set(handle, "missingValue", 1e300)
            values = eccodes.codes_get_values(handle)
            found.append(np.where(values == 1e300, np.nan, values))
        eccodes.codes_release(handle)
    return found


@pytest.mark.parametrize(
    "packing", ["grid_complex", "grid_complex_spatial_differencing", "grid_jpeg", "grid_ccsds"]
)
def test_other_packings_go_through_eccodes(packing: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.normal(0, 1, SIZE))
    message = build(LATLON, values, packing=packing, bits=16)
    path = write(tmp_path / "c.grib2", message)
    (row,) = scan_file(path).table()
    assert not row["sparse"]
    ((mine, _),) = both_ways(path)
    assert same_bits(mine, eccodes_values(message))
    np.testing.assert_allclose(mine, values, atol=np.ptp(values) / 2**15)


def test_missing_points_of_complex_packing_are_nan(tmp_path: Path) -> None:
    values = np.cumsum(np.random.default_rng(1).normal(0, 1, SIZE))
    values[5:40] = np.nan
    message = build(LATLON, values, packing="grid_complex", bits=16)
    ((mine, _),) = both_ways(write(tmp_path / "c.grib2", message))
    np.testing.assert_array_equal(np.isnan(mine), np.isnan(values))


def test_hand_packed_values(tmp_path: Path) -> None:
    """Three 12-bit integers 0x001, 0xABC, 0xFFF; R = -5, E = 1, D = 1: (R + 2 X) / 10."""
    path = tmp_path / "raw"
    path.write_bytes(b"\x00\x1a\xbc\xff\xf0")
    packing = SimplePacking(-5.0, 1, 1, 12, 0, 5, -1, 3)
    descriptor = os.open(path, os.O_RDONLY)
    values = sparse_values(descriptor, packing, np.array([[2, 0], [1, 1]]))
    os.close(descriptor)
    expected = np.array([[(4095 * 2 - 5) / 10, -0.3], [(0xABC * 2 - 5) / 10] * 2])
    np.testing.assert_allclose(values, expected, rtol=1e-15)


def test_ibm_floats_of_the_edition_1_guide() -> None:
    assert ibm_float(bytes.fromhex("c276a000"), 0) == -118.625
    assert ibm_float(bytes.fromhex("41100000"), 0) == 1.0
    assert ibm_float(bytes(4), 0) == 0.0


def test_powers_round_as_repeated_division_does() -> None:
    assert power(10, -2) == 1.0 / 10 / 10
    assert power(2, -20) == 2.0**-20
    assert power(10, 3) == 1000.0


@pytest.mark.parametrize("edition", [1, 2])
def test_a_file_cut_short_after_the_scan_is_unreadable(edition: int, tmp_path: Path) -> None:
    path = write(tmp_path / "cut.grib", build(LAMBERT, edition=edition))
    (row,) = scan_file(path).table()
    size = LAMBERT["Nx"] * LAMBERT["Ny"]
    os.truncate(path, int(row["length"]) - 40)
    descriptor = os.open(path, os.O_RDONLY)
    try:
        for sparse in (True, False):
            with pytest.raises(UnreadableMessageError):
                field_values(descriptor, row, size, np.array([size - 1]), sparse=sparse)
    finally:
        os.close(descriptor)


@pytest.mark.parametrize("reference", [1.401298464324817e-45, -1e-40])
def test_a_subnormal_reference_is_left_to_eccodes(tmp_path: Path, reference: float) -> None:
    raw, present = np.zeros(SIZE, np.uint64), np.ones(SIZE, dtype=bool)
    message = simple_message(2, raw, 8, reference, 0, 0, present)
    path = write(tmp_path / "m.grib", message)
    (row,) = scan_file(path).table()
    assert not row["sparse"]
    descriptor = os.open(path, os.O_RDONLY)
    try:
        mine = field_values(descriptor, row, SIZE, np.arange(SIZE), sparse=True)
    finally:
        os.close(descriptor)
    assert same_bits(mine, eccodes_values(message))
