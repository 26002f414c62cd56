"""Pieces of an archive: what they are cut by, what they are known by, what is made of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from airswing.compass import kept_headings as pieces
from airswing.compass.headings import DERIVED, derive_columns, derive_headings
from airswing.compass.kept_headings import KeptHeadings, Record, _marks_of, cut
from tests.compass.test_headings import flown, model, with_own

FIXES = 9
NAMES = ("ruc", "nam")


@pytest.fixture
def reports() -> xr.Dataset:
    """A flight a day: of the first aircraft 18 in March and 12 in April, of the other 18 and 12 in
    April and May."""
    return flown(flights=30, fixes=FIXES)


def own(reports: xr.Dataset, only: slice) -> xr.Dataset:
    """Some reports tell their true heading and airspeed."""
    truth = reports.attrs["truth"]
    there = np.zeros(reports.sizes["report"], dtype=bool)
    there[only] = True
    told = (np.where(there, truth[name], np.nan) for name in ("unit_heading", "unit_airspeed"))
    return with_own(reports, *told)


def same(found: xr.Dataset, expected: xr.Dataset) -> None:
    assert set(found.variables) == set(expected.variables)
    for name in expected.variables:
        assert found[name].dtype == expected[name].dtype, name
        assert found[name].variable.identical(expected[name].variable), name


def test_months_of_an_aircraft_by_hand(reports):
    found = cut(reports)
    np.testing.assert_array_equal(
        np.diff([*found.start, found.stop[-1]]) // FIXES, [18, 12, 18, 12]
    )
    assert found.aircraft.tolist() == [0, 0, 1, 1]
    assert found.start[1:].tolist() == found.stop[:-1].tolist()


def test_an_aircraft_of_one_month_is_cut_by_days(reports):
    """A month under way that grows by a day keeps the pieces it had; one day more is one piece."""
    march = reports.isel(report=slice(0, 18 * FIXES), aircraft=slice(0, 1))
    march = march.assign(row_size=("aircraft", [18 * FIXES]))
    begins = march["time"].to_numpy()[::FIXES]
    days = np.unique(begins.astype("M8[D]")).size
    found = cut(march)
    assert days > 1 and found.start.size == days and found.stop[-1] == 18 * FIXES
    winds = model(march, names=NAMES)
    marks = _marks_of(march, winds, found)
    last = int(found.start[-1])
    less = march.isel(report=slice(0, last)).assign(row_size=("aircraft", [last]))
    assert _marks_of(less, winds.isel(report=slice(0, last)), cut(less)) == marks[:-1]


def test_a_flight_over_the_end_of_a_month_is_where_it_began(reports):
    april = np.datetime64("2009-04-01")
    first = int(np.flatnonzero(reports["time"].to_numpy() >= april)[0])
    over = reports["time"].copy()
    over[first - 3 : first] = april + np.arange(3) * np.timedelta64(1, "s")
    assert cut(reports.assign(time=over)).start.tolist() == cut(reports).start.tolist()


def test_an_aircraft_with_its_own_heading_is_one_piece(reports):
    """Whether it is believed is judged over all of its reports."""
    assert cut(own(reports, slice(5, 6))).aircraft.tolist() == [0, 1, 1]


def test_no_report_no_piece(reports):
    none = reports.isel(report=slice(0), aircraft=slice(0))
    assert cut(none).start.size == 0


def test_numbers_of_the_fleet_do_not_count(reports):
    winds = model(reports, names=NAMES)
    known = _marks_of(reports, winds, cut(reports))
    later = reports.isel(report=slice(30 * FIXES, None), aircraft=slice(1, None))
    later = later.assign(flight=later["flight"] + 77)
    own_winds = winds.isel(report=slice(30 * FIXES, None))
    assert _marks_of(later, own_winds, cut(later)) == known[2:]
    assert len(set(known)) == 4


@pytest.mark.parametrize("name", ["time", "latitude", "pressure", "phase", "eastward_wind"])
def test_a_value_of_a_report_changes_its_piece_alone(reports, name):
    winds = model(reports, names=NAMES)
    before = _marks_of(reports, winds, cut(reports))
    changed = reports.copy(deep=True)
    values = changed[name].to_numpy()
    octets = values.view(f"u{values.dtype.itemsize}")
    octets[18 * FIXES + 4] ^= 1  # the last bit of one value of the second piece
    after = _marks_of(changed, winds, cut(changed))
    assert [one == other for one, other in zip(before, after, strict=True)] == [1, 0, 1, 1]


def test_winds_resolutions_names_references_and_code_count(reports, monkeypatch):
    winds = model(reports, names=NAMES)
    found = cut(reports)
    before = _marks_of(reports, winds, found)

    def changed(reports: xr.Dataset, winds: xr.Dataset) -> list[bool]:
        after = _marks_of(reports, winds, found)
        return [one != other for one, other in zip(before, after, strict=True)]

    other = winds.copy(deep=True)
    other["lead_time"][1, -1] += 1.0
    assert changed(reports, other) == [0, 0, 0, 1]
    assert changed(reports.assign(time_resolution=("aircraft", [0.0, 60.0])), winds) == [0, 0, 1, 1]
    assert changed(reports.assign_coords(aircraft=["N000", "N007"]), winds) == [0, 0, 1, 1]
    assert all(changed(reports, winds.assign_coords(reference=["ruc", "gfs"])))
    cut_in_two = reports.assign(flight=reports["flight"] + (np.arange(540) >= 4 * FIXES + 4))
    assert changed(cut_in_two, winds) == [1, 0, 0, 0]
    monkeypatch.setattr(pieces, "code_digest", lambda *names: "changed")
    assert all(changed(reports, winds))


@pytest.mark.parametrize("known", [[], [0], [1, 2], [0, 1, 2, 3]])
@pytest.mark.parametrize("told", [slice(0), slice(0, 270)])
def test_pieces_taken_up_and_derived_are_the_whole(reports, known, told, monkeypatch):
    """Bit for bit, the account of the evidence too, for an aircraft that is believed as well."""
    reports = own(reports, told)
    winds = model(reports, noise=2.0, names=NAMES)
    whole = derive_headings(reports, winds)
    assert set(DERIVED) == set(whole.variables) - set(reports.variables) - set(winds.variables)
    first = KeptHeadings()
    first.derive(reports, winds)
    record = first.record("a product")
    keep = [mark if k in known else "" for k, mark in enumerate(record.marks)]
    number = len([k for k in known if k < len(keep)])
    derived: list[int] = []

    def noted(reports: xr.Dataset, winds: xr.Dataset):
        derived.append(reports.sizes["aircraft"])
        return derive_columns(reports, winds)

    monkeypatch.setattr(pieces, "derive_columns", noted)
    earlier = whole.assign_attrs(uuid="a product")
    kept = KeptHeadings(earlier, record._replace(marks=keep))
    found = kept.derive(reports, winds)
    same(found, whole)
    assert kept.evidence == json.loads(whole.attrs["ground_vector_evidence"])
    assert sum(derived) == len(keep) - number
    assert kept.record("a product") == record


def test_a_record_is_read_as_it_was_written(tmp_path: Path, reports):
    kept = KeptHeadings()
    kept.derive(reports, model(reports))
    record, path = kept.record("a product"), tmp_path / "kept" / "headings.json"
    assert Record.read(path) is None
    record.write(path)
    assert Record.read(path) == record
    path.write_text('{"product": "a product"}')
    assert Record.read(path) is None
