"""Choosing profiles, pairing u with v, caching, and saying what was left out."""

import os
from pathlib import Path

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.quantities import lead_condition
from airswing.reference.catalogue import build_catalogue
from tests.reference.builders import LAMBERT, LATLON, build, profile, write

LEVELS = (300, 500, 700)


@pytest.fixture
def catalogued(tmp_path):
    """Catalogue of the files in a folder, to which one of some messages is added."""

    def find(*messages, name="x.grib", files=None, **options):
        if messages:
            write(tmp_path / name, *messages)
        options = {"cache_dir": tmp_path / "c"} | options
        return build_catalogue(files or str(tmp_path / "*.grib"), name="x", **options)

    return find


def content(catalogue):
    arrays = catalogue.valid, catalogue.leads, catalogue.bounds, catalogue.rows
    return [catalogue.files, catalogue.grids, *(array.tobytes() for array in arrays)]


def test_the_catalogue_of_a_real_run(real, tmp_path):
    folder = real("grib/wrf_ruc13_g212")
    catalogue = build_catalogue(f"{folder}/*", name="ruc", cache_dir=tmp_path)
    assert len(catalogue) == 9 and len(catalogue.files) == 10
    hours = (catalogue.times - catalogue.times[0]) / np.timedelta64(1, "h")
    np.testing.assert_array_equal(hours, np.arange(0, 25, 3))
    # 12Z comes from the analysis, not from the older run's 12 h forecast.
    np.testing.assert_array_equal(catalogue.leads / 3600, [0, 3, 6, 9, 0, 15, 18, 21, 24])
    for number in range(9):
        levels = catalogue.levels(number)
        assert levels.size == 39 and (np.diff(levels) > 0).all()
        assert (levels[0], levels[-1]) == (5000.0, 100000.0)
    (grid,) = catalogue.grids
    assert (grid.frame.kind, grid.ni, grid.nj) == ("projected", 185, 129)
    assert "+a=6367470.0 +b=6367470.0" in grid.frame.proj
    assert grid.wind_along_grid


def test_shortest_lead_that_meets_the_condition_wins(catalogued, tmp_path):
    for run, step in ((600, 6), (900, 3), (1200, 0)):
        write(tmp_path / f"run{run:04d}.grib", *profile(LEVELS, when=(20090801, run), step=step))
    for lead, expected in (("any", 0), (">= 1 h", 3), ("> 180 min", 6), ("== 6 h", 6)):
        catalogue = catalogued(lead=lead)
        assert list(catalogue.leads / 3600) == [expected]
        assert (len(catalogue.notes) == 1) == (lead in ("any", ">= 1 h"))
        assert all("shortest is used" in note for note in catalogue.notes)
    text = "1 model times of 3 files, 2009-08-01T12:00 to 2009-08-01T12:00, lead == 6 h"
    assert repr(catalogue) == f"<Catalogue 'x': {text}>"


def test_levels_come_in_any_order_and_u_and_v_in_different_files(catalogued, tmp_path):
    write(tmp_path / "a.grib", *profile((500, 300, 700), parameters="u"))
    catalogue = catalogued(*profile((700, 300, 500), parameters="v"), name="b.grib")
    np.testing.assert_array_equal(catalogue.levels(0), [30000.0, 50000.0, 70000.0])
    model = catalogue.model_time(0)
    assert [Path(file.path).name for file in model.files] == ["a.grib", "b.grib"]
    assert [set(row["file"]) for row in model.rows] == [{0}, {1}]


def test_u_without_v_is_named_and_counted(real, tmp_path):
    path = str(real("grib/uv_on_different_levels.grib"))
    catalogue = build_catalogue(path, name="x", cache_dir=tmp_path)
    assert [list(catalogue.levels(n)) for n in range(2)] == [[50000.0, 70000.0, 100000.0]] * 2
    skipped = {"file": path, "what": "level", "reason": "u without v", "count": 4}
    assert catalogue.skipped == [skipped]
    with pytest.raises(InputError, match="u without v"):
        build_catalogue(path, name="x", cache_dir=tmp_path, on_bad_file="fail")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("grib/hrrr_u_without_v.grib2", "u not on pressure levels"),
        ("grib/eta_1995_no_grid_section.grb", "no grid section"),
    ],
)
def test_files_without_usable_winds_are_refused(name, expected, real, tmp_path):
    with pytest.raises(InputError, match=f"{name}.*{expected}|{expected}.*{name}"):
        build_catalogue(str(real(name)), name="x", cache_dir=tmp_path)


def hybrid(level, parameter):
    """A message of edition 1 on a hybrid level."""
    message = bytearray(build(LATLON, edition=1))
    message[16:20] = bytes([parameter, 109, 0, level])
    return bytes(message)


@pytest.mark.parametrize(
    ("messages", "says"),
    [
        ([build(LATLON, extra={"parameterNumber": 1})], "wind speed or direction, not u and v"),
        ([build(LATLON), build(LAMBERT, parameter="v")], "u without v"),  # on different grids
        ([hybrid(1, 33), hybrid(1, 34)], "hybrid level without a pressure field"),
    ],
)
def test_messages_without_a_profile_are_refused(messages, says, catalogued):
    with pytest.raises(InputError, match=says):
        catalogued(*messages)


def test_copies_of_a_field_count_once_and_the_note_names_the_file(catalogued, tmp_path):
    first = np.arange(176.0) / 4
    write(tmp_path / "a.grib", *profile((500,), first))
    # the same values in another packing are a copy, too
    catalogue = catalogued(*profile((500,), first, packing="grid_ccsds", bits=20), name="b.grib")
    assert {Path(f.path).name for f in catalogue.model_time(0).files} == {"b.grib"}
    (note,) = catalogue.notes
    assert "a.grib" in note and "b.grib is used" in note and "2009-08-01T12:00Z, lead 0 h" in note
    reversed_order = catalogued(files=[str(tmp_path / f"{name}.grib") for name in "ba"])
    assert content(reversed_order) == content(catalogue)


@pytest.mark.parametrize("edition", [1, 2])
@pytest.mark.parametrize("files", [1, 2])
def test_a_field_given_twice_with_other_values_is_not_used(edition, files, catalogued, tmp_path):
    upper, different, lower = (
        profile((level,), np.full(176, value), edition=edition)
        for level, value in ((500, 1.5), (500, 20.0), (700, 1.5))
    )
    write(tmp_path / "a.grib", *upper, *lower, *(different if files == 1 else []))
    catalogue = catalogued(*(different if files == 2 else []))
    assert catalogue.levels(0).tolist() == [70000.0]
    (skipped,) = catalogue.skipped
    assert skipped["reason"] == "a field of one level and time given again with other values"
    assert skipped["count"] == 4


def test_lead_conditions():
    leads = np.array([0, 1800, 3600, 7200])
    for text, expected in [
        ("any", [1, 1, 1, 1]),
        ("analysis", [1, 0, 0, 0]),
        (">= 1 h", [0, 0, 1, 1]),
        ("<30 min", [1, 0, 0, 0]),
        ("== 2 h", [0, 0, 0, 1]),
        ("> 3600 s", [0, 0, 0, 1]),
    ]:
        np.testing.assert_array_equal(lead_condition(text)(leads), np.array(expected, bool))
    for text in (">= 1..2 h", ">= . h", ">= 1 fortnight", "=> 1 h", ""):
        with pytest.raises(InputError, match="not understood"):
            lead_condition(text)


def test_a_replaced_file_is_read_again(catalogued, tmp_path):
    first = catalogued(*profile(LEVELS))
    stamp = os.stat(tmp_path / "x.grib").st_mtime_ns
    write(tmp_path / "x.grib", *profile(LEVELS, when=(20090801, 1800)))
    # Same size, and even the same time of modification: the sample of bytes differs.
    os.utime(tmp_path / "x.grib", ns=(stamp, stamp))
    assert catalogued().times[0] - first.times[0] == np.timedelta64(6, "h")


def test_a_cache_that_cannot_be_written_costs_a_warning(catalogued, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="cannot be written"):
        assert len(catalogued(*profile(LEVELS), cache_dir=tmp_path / "file/c")) == 1


@pytest.mark.parametrize("damage", [lambda e: b"", lambda e: b"rubbish", lambda e: e[:-9]])
def test_in_place_of_a_damaged_entry_the_file_is_read_again(damage, catalogued, tmp_path):
    first = catalogued(*profile(LEVELS))
    (entry,) = (tmp_path / "c" / "grib-headers").iterdir()
    sound = entry.read_bytes()
    entry.write_bytes(damage(sound))
    assert content(catalogued()) == content(first) and entry.read_bytes() == sound


def test_ensemble_members_are_not_mixed(catalogued):
    messages = []
    for member, value in ((3, 30.0), (1, 10.0)):
        extra = {"productDefinitionTemplateNumber": 1, "perturbationNumber": member}
        messages += profile((500,), np.full(176, value), extra=extra)
    catalogue = catalogued(*messages)
    assert list(catalogue.profiles["member"]) == [1] and len(catalogue.levels(0)) == 1
    assert any("lowest number" in note for note in catalogue.notes)
    for member in (1, 3):
        selected = catalogued(member=member)
        assert list(selected.profiles["member"]) == [member] and not selected.notes
    with pytest.raises(InputError, match=r"references\.x.*ensemble member 2.*members 1, 3"):
        catalogued(member=2)
