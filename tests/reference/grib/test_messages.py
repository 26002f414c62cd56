"""The header scan against eccodes, key by key, and on files that are not what they should be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import eccodes
import numpy as np
import pytest
from tests.reference.builders import LAMBERT, LATLON, POLAR, build, write

from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.grib.fields import PRESSURE, U, V
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.grib.messages import scan_file
from airswing.reference.grib.values import field_values

WRF = "grib/wrf_ruc13_g212/"
REAL_FILES = [
    *(WRF + f"2005080700_wrfprs_ruc13_{h:02d}.tm00_G212" for h in range(0, 25, 3)),
    WRF + "2005080712_wrfprs_ruc13_00.tm00_G212",
    "grib/uv_on_different_levels.grib",
    "grib/nam_g211_20180917_00z.grib2",
    "grib/jma_meps_20190605_regular_ll.grib2",
    "grib/hrrr_u_without_v.grib2",
    "grib/eta_1995_no_grid_section.grb",
]
PACKINGS = {
    (1, 0): "grid_simple",
    (2, 0): "grid_simple",
    (2, 2): "grid_complex",
    (2, 3): "grid_complex_spatial_differencing",
}


def by_eccodes(path: str) -> tuple[list[dict[str, Any]], int]:
    """Keys of every isobaric u and v with a grid, in file order, and the number of fields."""
    eccodes.codes_grib_multi_support_on()
    found, fields = [], 0
    try:
        with open(path, "rb") as file:
            while (handle := eccodes.codes_grib_new_from_file(file)) is not None:
                fields += 1
                keys = _keys(handle)
                if keys is not None:
                    found.append(keys)
                eccodes.codes_release(handle)
    finally:
        eccodes.codes_grib_multi_support_off()
    return found, fields


def _keys(handle: int) -> dict[str, Any] | None:
    get = lambda key: eccodes.codes_get(handle, key)  # noqa: E731
    if get("shortName") not in ("u", "v") or get("typeOfLevel") != "isobaricInhPa":
        return None
    if get("edition") == 1 and get("gridDefinition") != 255 and not get("GDSPresent"):
        return None
    names = [
        "edition",
        "shortName",
        "level",
        "dataDate",
        "dataTime",
        "validityDate",
        "validityTime",
        "gridType",
        "Ni",
        "Nj",
        "uvRelativeToGrid",
        "packingType",
        "bitmapPresent",
        "bitsPerValue",
        "numberOfPoints",
        "iScansNegatively",
        "jScansPositively",
        "jPointsAreConsecutive",
        "latitudeOfFirstGridPointInDegrees",
        "longitudeOfFirstGridPointInDegrees",
    ]
    keys = {name: get(name) for name in names}
    keys["radius"] = get("radius") if eccodes.codes_is_defined(handle, "radius") else None
    if keys["packingType"] == "grid_simple":
        for name in ("referenceValue", "binaryScaleFactor", "decimalScaleFactor"):
            keys[name] = get(name)
    for name in (
        "perturbationNumber",
        "LoVInDegrees",
        "Latin1InDegrees",
        "Latin2InDegrees",
        "DxInMetres",
        "DyInMetres",
        "offset",
        "totalLength",
    ):
        keys[name] = get(name) if eccodes.codes_is_defined(handle, name) else None
    return keys


def nanoseconds(date: int, clock: int) -> int:
    text = f"{date // 10000:04d}-{date // 100 % 100:02d}-{date % 100:02d}"
    return int(np.datetime64(f"{text}T{clock // 100:02d}:{clock % 100:02d}", "ns").astype(np.int64))


@pytest.mark.parametrize("name", REAL_FILES)
def test_scan_equals_eccodes_on_every_real_file(name: str, real: Callable[[str], Path]) -> None:
    path = str(real(name))
    contents = scan_file(path)
    expected, fields = by_eccodes(path)
    assert contents.parts == fields
    assert len(contents.fields) == len(expected)
    for row, keys in zip(contents.fields, expected, strict=True):
        grid = read_grid(*contents.grids[row.grid])
        assert row.edition == keys["edition"]
        assert row.kind == {"u": U, "v": V}[keys["shortName"]]
        assert (row.level_kind, row.level) == (ISOBARIC, keys["level"] * 100.0)
        assert row.valid - row.lead * 10**9 == nanoseconds(keys["dataDate"], keys["dataTime"])
        assert row.valid == nanoseconds(keys["validityDate"], keys["validityTime"])
        assert row.member == (keys["perturbationNumber"] or 0)
        assert grid.kind == keys["gridType"]
        assert (grid.ni, grid.nj, grid.size) == (keys["Ni"], keys["Nj"], keys["numberOfPoints"])
        assert grid.wind_along_grid == bool(keys["uvRelativeToGrid"])
        assert (grid.di < 0) == bool(keys["iScansNegatively"])
        assert (grid.dj > 0) == bool(keys["jScansPositively"])
        assert grid.j_consecutive == bool(keys["jPointsAreConsecutive"])
        assert grid.latitude_first == pytest.approx(keys["latitudeOfFirstGridPointInDegrees"])
        assert (
            grid.longitude_first - keys["longitudeOfFirstGridPointInDegrees"]
        ) % 360 == pytest.approx(0.0)
        if keys["radius"] is not None:
            assert grid.radius == keys["radius"]
        if grid.kind == "lambert":
            assert grid.orientation % 360 == pytest.approx(keys["LoVInDegrees"] % 360)
            assert grid.latin1 == pytest.approx(keys["Latin1InDegrees"])
            assert grid.latin2 == pytest.approx(keys["Latin2InDegrees"])
            assert (abs(grid.di), abs(grid.dj)) == (keys["DxInMetres"], keys["DyInMetres"])
        assert PACKINGS[row.edition, row.packing] == keys["packingType"]
        assert (row.section_bitmap >= 0) == bool(keys["bitmapPresent"])
        if keys["packingType"] == "grid_simple":
            assert row.sparse
            assert row.bits == keys["bitsPerValue"]
            assert row.reference_value == keys["referenceValue"]
            assert row.binary_scale == keys["binaryScaleFactor"]
            assert row.decimal_scale == keys["decimalScaleFactor"]


def test_multi_field_messages_give_their_second_fields(real: Callable[[str], Path]) -> None:
    contents = scan_file(str(real("grib/nam_g211_20180917_00z.grib2")))
    assert (contents.messages, contents.parts) == (154, 181)
    assert [sum(row.kind == kind for row in contents.fields) for kind in (U, V)] == [19, 19]
    assert all(row.part == 1 for row in contents.fields if row.kind == V)


def test_a_file_without_grid_sections_is_named(real: Callable[[str], Path]) -> None:
    contents = scan_file(str(real("grib/eta_1995_no_grid_section.grb")))
    assert not contents.fields
    assert contents.skipped["grid", "no grid section (predefined grid 6)"] == 22


def test_u_alone_at_10_m_is_named(real: Callable[[str], Path]) -> None:
    contents = scan_file(str(real("grib/hrrr_u_without_v.grib2")))
    assert not contents.fields
    assert contents.skipped == {("wind", "u not on pressure levels (level type 103)"): 1}


def test_garbage_between_messages_is_passed_over(tmp_path: Path) -> None:
    one, two = build(LATLON), build(LATLON, edition=1, parameter="v")
    path = write(tmp_path / "x", b"\0" * 70000, one, b"header GRI noise", two, b"tail")
    contents = scan_file(path)
    assert contents.messages == 2
    assert [(row.offset, row.edition) for row in contents.fields] == [
        (70000, 2),
        (70000 + len(one) + 16, 1),
    ]
    assert not contents.skipped


@pytest.mark.parametrize("edition", [1, 2])
def test_a_truncated_message_is_named_and_the_ones_before_kept(
    edition: int, tmp_path: Path
) -> None:
    one = build(LATLON, edition=edition)
    contents = scan_file(write(tmp_path / "x", one, one[: len(one) // 2]))
    assert len(contents.fields) == 1
    assert contents.skipped["message", "truncated message"] == 1


@pytest.mark.parametrize("edition", [1, 2])
@pytest.mark.parametrize("seed", range(15))
def test_random_damage_never_stops_the_scan(edition: int, seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    good = build(LAMBERT, edition=edition)
    bad = bytearray(good)
    for place in rng.integers(4, 130, 6):
        bad[place] = rng.integers(0, 256)
    contents = scan_file(write(tmp_path / "x", bytes(bad), good))
    ours = [row for row in contents.fields if row.offset >= len(good)]
    damaged_length = int.from_bytes(bad[8:16] if edition == 2 else bad[4:7], "big")
    if damaged_length == len(good) or len(contents.skipped):
        assert len(ours) == 1 or contents.skipped


def test_a_wrong_end_mark_is_garbage(tmp_path: Path) -> None:
    bad = bytearray(build(LATLON))
    bad[-4:] = b"8888"
    contents = scan_file(write(tmp_path / "x", bytes(bad), build(LATLON)))
    assert contents.skipped["message", "garbage: no 7777 at the message's end"] == 1
    assert len(contents.fields) == 1


def test_an_empty_file_and_a_text_file_hold_no_message(tmp_path: Path) -> None:
    for data in (b"", b"tail,time\nN1,2009\n"):
        contents = scan_file(write(tmp_path / "x", data))
        assert contents.skipped == {("file", "no whole GRIB message"): 1}


@pytest.mark.parametrize(
    ("unit", "first", "second", "indicator", "seconds"),
    [
        (1, 6, 0, 0, 21600),
        (0, 90, 0, 0, 5400),
        (2, 1, 0, 0, 86400),
        (10, 2, 0, 0, 21600),
        (11, 1, 0, 0, 21600),
        (12, 1, 0, 0, 43200),
        (13, 3, 0, 0, 2700),
        (14, 3, 0, 0, 5400),
        (254, 30, 0, 0, 30),
        (1, 1, 44, 10, 300 * 3600),
        (1, 0, 0, 1, 0),
    ],
)
def test_time_units_of_edition_1(
    unit: int, first: int, second: int, indicator: int, seconds: int, tmp_path: Path
) -> None:
    extra = {"unitOfTimeRange": unit, "P1": first, "P2": second, "timeRangeIndicator": indicator}
    message = bytearray(build(LATLON, edition=1))
    message[8 + 17 : 8 + 21] = bytes([unit, first, second, indicator])
    (row,) = scan_file(write(tmp_path / "x", bytes(message))).fields
    assert row.lead == seconds, extra
    assert row.valid == nanoseconds(20090801, 1200) + seconds * 10**9


@pytest.mark.parametrize("indicator", [2, 3, 4, 5, 113])
def test_averages_and_accumulations_of_edition_1_are_no_wind(
    indicator: int, tmp_path: Path
) -> None:
    message = bytearray(build(LATLON, edition=1))
    message[8 + 20] = indicator
    contents = scan_file(write(tmp_path / "x", bytes(message)))
    assert not contents.fields
    assert any("not instantaneous" in why for _, why in contents.skipped)


@pytest.mark.parametrize(
    ("unit", "steps", "seconds"),
    [
        (0, 90, 5400),
        (1, 300, 1080000),
        (2, 1, 86400),
        (10, 2, 21600),
        (11, 1, 21600),
        (12, 1, 43200),
        (13, 30, 30),
    ],
)
def test_time_units_of_edition_2(unit: int, steps: int, seconds: int, tmp_path: Path) -> None:
    extra = {"indicatorOfUnitOfTimeRange": unit, "forecastTime": steps}
    (row,) = scan_file(write(tmp_path / "x", build(LATLON, extra=extra))).fields
    assert row.lead == seconds
    assert row.valid == nanoseconds(20090801, 1200) + seconds * 10**9


def test_averages_of_edition_2_are_no_wind(tmp_path: Path) -> None:
    message = build(LATLON, extra={"productDefinitionTemplateNumber": 8})
    contents = scan_file(write(tmp_path / "x", message))
    assert not contents.fields
    assert any("not instantaneous" in why for _, why in contents.skipped)


def test_impossible_dates_are_named(tmp_path: Path) -> None:
    message = bytearray(build(LATLON, edition=1))
    message[8 + 13] = 14
    contents = scan_file(write(tmp_path / "x", bytes(message)))
    assert not contents.fields
    assert any("impossible reference time" in why for _, why in contents.skipped)


@pytest.mark.parametrize(
    ("table", "centre", "parameter", "kind"),
    [
        (2, 7, 33, U),
        (3, 59, 34, V),
        (1, 8, 33, U),
        (130, 7, 34, V),
        (128, 98, 131, U),
        (128, 98, 132, V),
        (128, 98, 33, None),
        (2, 7, 131, None),
        (200, 7, 33, None),
    ],
)
def test_parameters_of_edition_1(
    table: int, centre: int, parameter: int, kind: int | None, tmp_path: Path
) -> None:
    message = bytearray(build(LATLON, edition=1))
    message[8 + 3], message[8 + 4], message[8 + 8] = table, centre, parameter
    fields = scan_file(write(tmp_path / "x", bytes(message))).fields
    assert [row.kind for row in fields] == ([] if kind is None else [kind])


def test_hybrid_levels_and_their_pressure(tmp_path: Path) -> None:
    wind, pressure = bytearray(build(LATLON, edition=1)), bytearray(build(LATLON, edition=1))
    for message in (wind, pressure):
        message[8 + 9], message[8 + 10 : 8 + 12] = 109, (7).to_bytes(2, "big")
    pressure[8 + 8] = 1
    fields = scan_file(write(tmp_path / "x", bytes(wind), bytes(pressure))).fields
    assert [(row.kind, row.level_kind, row.level) for row in fields] == [
        (U, HYBRID, 7.0),
        (PRESSURE, HYBRID, 7.0),
    ]


def test_scaled_levels_and_layers_of_edition_2(tmp_path: Path) -> None:
    fine = {"scaleFactorOfFirstFixedSurface": 1, "scaledValueOfFirstFixedSurface": 500125}
    layer = {
        "typeOfSecondFixedSurface": 100,
        "scaleFactorOfSecondFixedSurface": 0,
        "scaledValueOfSecondFixedSurface": 60000,
    }
    contents = scan_file(
        write(tmp_path / "x", build(LATLON, extra=fine), build(LATLON, extra=layer))
    )
    assert [row.level for row in contents.fields] == [50012.5]
    assert sum(contents.skipped.values()) == 1


def test_identical_grid_sections_are_kept_once(tmp_path: Path) -> None:
    messages = [build(LATLON), build(POLAR), build(LATLON, parameter="v")]
    contents = scan_file(write(tmp_path / "x", *messages))
    assert [row.grid for row in contents.fields] == [0, 1, 0]


def test_long_messages_of_edition_1_are_measured_by_eccodes(tmp_path: Path) -> None:
    """Above 8 MB a GRIB1 length counts in units of 120 octets."""
    side = {
        **LATLON,
        "Ni": 1700,
        "Nj": 1700,
        "latitudeOfFirstGridPointInDegrees": 80.0,
        "latitudeOfLastGridPointInDegrees": -4.95,
        "longitudeOfFirstGridPointInDegrees": 0.0,
        "longitudeOfLastGridPointInDegrees": 84.95,
        "iDirectionIncrementInDegrees": 0.05,
        "jDirectionIncrementInDegrees": 0.05,
    }
    values = np.random.default_rng(1).integers(-30, 30, 1700 * 1700).astype(float)
    long = build(side, values, edition=1, bits=24)
    assert len(long) > 2**23
    path = write(tmp_path / "x", long, build(LATLON, edition=1, parameter="v"))
    contents = scan_file(path)
    assert [row.length for row in contents.fields] == [len(long), row_length(path, len(long))]
    points = np.array([0, 1700 * 1700 // 2, 1700 * 1700 - 1])
    with open(path, "rb") as file:
        for sparse in (True, False):
            read = field_values(
                file.fileno(), contents.table()[0], values.size, points, sparse=sparse
            )
            np.testing.assert_allclose(read, values[points], atol=1e-4)


def row_length(path: str, start: int) -> int:
    """Octets from `start` to the end of a file."""
    return Path(path).stat().st_size - start
