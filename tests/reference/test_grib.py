"""Headers and values of GRIB against ecCodes, and messages that are damaged."""

import functools
import os
import struct

import eccodes
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import scan_file
from airswing.reference.grib.values import (
    UnreadableMessageError,
    decode_guarded,
    field_message,
    sparse_values,
)
from airswing.reference.winds import ISOBARIC, U, V
from tests.reference.builders import LAMBERT, LATLON, SIZE, build, write

WRF = "grib/wrf_ruc13_g212/"
REAL_FILES = [
    WRF + "2005080700_wrfprs_ruc13_00.tm00_G212",
    WRF + "2005080700_wrfprs_ruc13_24.tm00_G212",
    "grib/uv_on_different_levels.grib",
    "grib/nam_g211_20180917_00z.grib2",
    "grib/jma_meps_20190605_regular_ll.grib2",
]
PLANE = 10.0 + 8.0 * np.sin(np.arange(LAMBERT["Nx"] * LAMBERT["Ny"]) / 9.0)


def field_values(path, row, size, points):
    """Values of a field at some points, as the reader takes them."""
    with open(path, "rb") as file:
        if row["sparse"]:
            return sparse_values(file.fileno(), row, size, points)
        (values,) = decode_guarded([(field_message(file.fileno(), row), size, points)])
    if isinstance(values, str):
        raise UnreadableMessageError(values)
    return values


def decoded(message):
    """Values of a message by ecCodes alone, NaN where missing."""
    handle = eccodes.codes_new_from_message(message)
    eccodes.codes_set(handle, "missingValue", 1e300)
    values = eccodes.codes_get_values(handle)
    eccodes.codes_release(handle)
    return np.where(values == 1e300, np.nan, values)


def nanoseconds(date, clock):
    text = f"{date // 10000:04d}-{date // 100 % 100:02d}-{date % 100:02d}"
    return int(np.datetime64(f"{text}T{clock // 100:02d}:{clock % 100:02d}", "ns").astype(np.int64))


@pytest.mark.parametrize("name", REAL_FILES)
def test_headers_and_values_equal_eccodes(name, real):
    """Every isobaric wind of a real file: keys, and values at every point, bit for bit."""
    path = str(real(name))
    contents = scan_file(path)
    table = iter(row for row in contents.table() if row["level_kind"] == ISOBARIC)
    eccodes.codes_grib_multi_support_on()
    try:
        with open(path, "rb") as file:
            while (handle := eccodes.codes_grib_new_from_file(file)) is not None:
                get = functools.partial(eccodes.codes_get, handle)
                if get("shortName") in ("u", "v") and get("typeOfLevel") == "isobaricInhPa":
                    row = next(table)
                    grid = read_grid(*contents.grids[int(row["grid"])])
                    assert row["kind"] == {"u": U, "v": V}[get("shortName")]
                    assert row["level"] == get("level") * 100.0
                    base = nanoseconds(get("dataDate"), get("dataTime"))
                    assert row["valid"] == nanoseconds(get("validityDate"), get("validityTime"))
                    assert row["valid"] - row["lead"] * 10**9 == base
                    assert (grid.ni, grid.nj) == (get("Ni"), get("Nj"))
                    assert grid.wind_along_grid == bool(get("uvRelativeToGrid"))
                    eccodes.codes_set(handle, "missingValue", 1e300)
                    theirs = eccodes.codes_get_values(handle)
                    mine = field_values(path, row, grid.size, np.arange(grid.size))
                    np.testing.assert_array_equal(mine, np.where(theirs == 1e300, np.nan, theirs))
                eccodes.codes_release(handle)
    finally:
        eccodes.codes_grib_multi_support_off()
    assert next(table, None) is None


def test_garbage_between_messages_is_passed_over(tmp_path):
    first, second = build(LATLON), build(LATLON, edition=1, parameter="v")
    path = write(tmp_path / "x", b"\0" * 70000, first, b"header GRI noise", second, b"tail")
    contents = scan_file(path)
    places = [(row.offset, row.edition) for row in contents.fields]
    assert places == [(70000, 2), (70000 + len(first) + 16, 1)]
    assert contents.messages == 2 and not contents.skipped


@pytest.mark.parametrize("edition", [1, 2])
def test_incomplete_messages_are_named(edition, tmp_path):
    message = build(LATLON, edition=edition)
    contents = scan_file(write(tmp_path / "x", message, message[: len(message) // 2]))
    assert len(contents.fields) == 1
    assert contents.skipped["message", "truncated message"] == 1
    contents = scan_file(write(tmp_path / "x", message[:-4] + b"8888", message))
    assert contents.skipped["message", "garbage: no 7777 at the message's end"] == 1
    for data in (b"", b"tail,time\nN1,2009\n"):
        contents = scan_file(write(tmp_path / "x", data))
        assert contents.skipped == {("file", "no whole GRIB message"): 1}


UNITS = {0: 60, 1: 3600, 2: 86400, 10: 10800, 11: 21600, 12: 43200}  # s, of both editions


@pytest.mark.parametrize(
    ("edition", "stated", "seconds"),
    [
        *((1, (unit, 3, 0, 0), 3 * size) for unit, size in (UNITS | {13: 900, 14: 1800}).items()),
        (1, (254, 30, 0, 0), 30),
        (1, (1, 1, 44, 10), 300 * 3600),
        (1, (1, 0, 0, 1), 0),
        *((2, (unit, 3), 3 * size) for unit, size in (UNITS | {13: 1}).items()),
    ],
)
def test_leads(edition, stated, seconds, tmp_path):
    message = bytearray(build(LATLON, edition=edition))
    if edition == 1:
        message[8 + 17 : 8 + 21] = bytes(stated)
    else:
        extra = {"indicatorOfUnitOfTimeRange": stated[0], "forecastTime": stated[1]}
        message = bytearray(build(LATLON, extra=extra))
    (row,) = scan_file(write(tmp_path / "x", bytes(message))).fields
    assert row.lead == seconds
    assert row.valid == nanoseconds(20090801, 1200) + seconds * 10**9


@pytest.mark.parametrize(
    ("table", "centre", "parameter", "kind"),
    [
        *((2, 7, 33, U), (3, 59, 34, V), (1, 8, 33, U), (130, 7, 34, V), (128, 98, 131, U)),
        *((128, 98, 132, V), (128, 98, 33, None), (2, 7, 131, None), (200, 7, 33, None)),
    ],
)
def test_parameters_of_edition_1(table, centre, parameter, kind, tmp_path):
    message = bytearray(build(LATLON, edition=1))
    message[8 + 3], message[8 + 4], message[8 + 8] = table, centre, parameter
    fields = scan_file(write(tmp_path / "x", bytes(message))).fields
    assert [row.kind for row in fields] == ([] if kind is None else [kind])


def test_scaled_levels_and_layers(tmp_path):
    fine = {"scaleFactorOfFirstFixedSurface": 1, "scaledValueOfFirstFixedSurface": 500125}
    layer = {"typeOfSecondFixedSurface": 100, "scaleFactorOfSecondFixedSurface": 0}
    layer["scaledValueOfSecondFixedSurface"] = 60000
    messages = build(LATLON, extra=fine), build(LATLON, extra=layer)
    contents = scan_file(write(tmp_path / "x", *messages))
    assert [row.level for row in contents.fields] == [50012.5]
    assert sum(contents.skipped.values()) == 1


def test_messages_of_edition_1_above_8_mb(tmp_path):
    """Their length counts in units of 120 bytes."""
    side = {**LATLON, "Ni": 1700, "Nj": 1700}
    side |= {f"{c}DirectionIncrementInDegrees": 0.05 for c in "ij"}
    side |= {"latitudeOfFirstGridPointInDegrees": 80.0, "latitudeOfLastGridPointInDegrees": -4.95}
    side |= {"longitudeOfFirstGridPointInDegrees": 0.0, "longitudeOfLastGridPointInDegrees": 84.95}
    values = np.random.default_rng(1).integers(-30, 30, 1700 * 1700).astype(float)
    long = build(side, values, edition=1, bits=24)
    assert len(long) > 2**23
    path = write(tmp_path / "x", long, build(LATLON, edition=1, parameter="v"))
    contents = scan_file(path)
    assert [row.offset for row in contents.fields] == [0, len(long)]
    points = np.array([0, 1700 * 1700 // 2, 1700 * 1700 - 1])
    read = field_values(path, contents.table()[0], values.size, points)
    np.testing.assert_allclose(read, values[points], atol=1e-4)


@given(
    edition=st.sampled_from([1, 2]),
    bits=st.integers(1, 32),
    decimal=st.integers(-4, 8),
    limits=st.tuples(*[st.floats(-149.0, 149.0, width=32, allow_subnormal=False)] * 2),
    gaps=st.sampled_from([0.0, 0.0, 0.1, 0.6, 0.9]),
    seed=st.integers(0, 2**32 - 1),
)
@example(1, 8, 2, (-13.5, -13.5), 0.0, 0)  # a constant field: no bits
@example(2, 8, 2, (-13.5, -13.5), 0.3, 0)
@example(1, 8, 0, (-0.0, -0.0), 0.0, 0)
@example(2, 8, 0, (-0.0, -0.0), 0.0, 0)
@example(2, 32, 0, (1.5, 149.0), 0.0, 1)
def test_sparse_values_equal_eccodes(tmp_path_factory, edition, bits, decimal, limits, gaps, seed):
    """Bit for bit."""
    assume(decimal >= 0 or limits[0] != limits[1])  # ecCodes does not scale constants
    rng = np.random.default_rng(seed)
    values = rng.uniform(*sorted(limits), SIZE)
    values[rng.random(SIZE) < gaps] = np.nan
    keys = LATLON | {"decimalScaleFactor": decimal}
    message = build(keys, values, edition=edition, bits=bits)
    path = write(tmp_path_factory.mktemp("p") / "m.grib", message)
    (row,) = scan_file(path).table()
    assert row["sparse"]
    points = rng.permutation(SIZE)[: rng.integers(1, SIZE)]
    mine, theirs = field_values(path, row, SIZE, points), decoded(message)[points]
    present = ~np.isnan(theirs)
    np.testing.assert_array_equal(np.isnan(mine), ~present)
    np.testing.assert_array_equal(mine[present].view(np.uint64), theirs[present].view(np.uint64))


@pytest.mark.parametrize(
    "packing",
    ["complex", "complex_spatial_differencing", "png", "jpeg", "ccsds", "ieee", "second_order"],
)
def test_every_packing_is_decoded(packing, tmp_path):
    values, edition = PLANE.copy(), 1 if packing == "second_order" else 2
    if packing == "complex":
        values[5:40] = np.nan
    packing = f"grid_{packing}"
    message = build(LAMBERT, values, edition=edition, packing=packing)
    path = write(tmp_path / "m.grib", build(LATLON, edition=edition), message)
    row = scan_file(path).table()[1]
    assert not row["sparse"]
    every = np.arange(PLANE.size)
    np.testing.assert_array_equal(field_values(path, row, PLANE.size, every), decoded(message))
    np.testing.assert_allclose(decoded(message), values, atol=0.01)


def test_one_message_that_ends_the_decoder_costs_one_message(tmp_path):
    messages = [build(LAMBERT, PLANE, packing=p) for p in ("grid_ccsds", "grid_png")]
    path = write(tmp_path / "m.grib", *messages)
    descriptor = os.open(path, os.O_RDONLY)
    sound, png = (field_message(descriptor, row) for row in scan_file(path).table())
    os.close(descriptor)
    deadly = bent(png, section(png, 5) + 19, b"\x08")  # another depth than the stream's
    first, reason, last = decode_guarded([(m, PLANE.size, None) for m in (sound, deadly, sound)])
    assert isinstance(reason, str) and "ends the process" in reason
    for values in (first, last):
        np.testing.assert_array_equal(values, decoded(sound))


def section(message, number):
    """Start of a section of a GRIB2 message."""
    at = 16
    while message[at + 4] != number:
        at += int.from_bytes(message[at : at + 4], "big")
    return at


def bent(message, place, replacement):
    return message[:place] + replacement + message[place + len(replacement) :]


@pytest.mark.parametrize(
    ("number", "offset", "replacement", "expected"),
    [  # section 0: a message of edition 1
        (0, 8 + 13, b"\x0e", "impossible reference time"),  # month 14
        (0, 8 + 24, b"\x00", "impossible reference time"),  # the century 0
        (0, 8 + 24, b"\x64", "base time not of the years"),
        (0, 8 + 10, b"\xff\xff", "pressure level of"),
        (0, 36 + 6, b"\x00\x01", "contradict"),  # Ni 1, contrary to its increments
        (0, 36 + 17, b"\x7f\xff\xff", "beyond the earth"),
        (0, 36, b"\x00\x00\x1f", "grid section too short"),
        (1, 12, b"\x00\x00", "impossible reference time"),  # the year 0
        (1, 12, b"\x27\x0f", "base time not of the years"),  # 9999
        (1, 14, b"\x0d", "impossible reference time"),  # month 13
        (4, 18, b"\x7f\xff\xff\xff", "lead time of"),
        (4, 24, b"\x7f\xff\xff\xff", "pressure level of"),
        (3, 6, b"\x00\x00\x01\x00", "data points on a grid"),
        (3, 30, b"\x00\x00\x00\x00", "grid of 0 by 11 points"),
        (3, 55, b"\x06\x00\x00\x00", "grid beyond the earth"),
        (3, 63, b"\x00\x00\x00\x01", "corners and increments contradict"),
        (5, 5, b"\x00\x00\x00\x01", "1 values on a grid of 176 points"),
        (5, 11, struct.pack(">f", 1e20), "lowest value of a field"),
        (5, 11, struct.pack(">f", float("nan")), "lowest value of a field"),
        (5, 15, b"\x7f\xff", "scale factors"),
        (5, 17, b"\xff\xff", "scale factors"),
        (5, 19, b"\x07", "data section longer than its grid"),
        (5, 19, b"\x20", "data section too short"),
        (5, 19, b"\xff", "255 bits a value"),
        (7, 0, b"\x00\x00\x00\x05", "section lengths do not add up"),
        (4, 0, b"\xff\xff\xff\xff", "section lengths do not add up"),
        (4, 4, b"\x02", "section 2 after section 3"),
    ],
)
def test_damaged_headers_are_named(number, offset, replacement, expected, tmp_path):
    values = np.round(10 + 8 * np.sin(np.arange(SIZE) / 9.0), 2)
    message = build(LATLON, values, edition=2 if number else 1)
    place = offset + (section(message, number) if number else 0)
    contents = scan_file(write(tmp_path / "m.grib", bent(message, place, replacement)))
    assert not contents.fields
    reasons = " ".join(reason for _, reason in contents.skipped)
    assert expected in reasons or (not number and "data section" in reasons)
