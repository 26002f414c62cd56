"""Products: whole or absent, described, the same when read back; damaged NetCDF is refused."""

import json
import pickle
import struct

import netCDF4
import numpy as np
import pytest
import xarray as xr
from tests.ragged import ragged

import airswing
from airswing.errors import InputError
from airswing.flags import SCREENING
from airswing.products import netcdf
from airswing.products.ragged import aircraft_of_report, row_bounds
from airswing.products.whole_files import Findings, json_types
from airswing.vocabulary import lookup


def test_round_trip_with_names_units_and_provenance(tmp_path):
    columns = {
        "time": np.array(["2009-01-01", "2009-01-02", "2009-01-03"], "M8[ns]"),
        "latitude": np.array([45.0, np.nan, 47.0]),
        "screening": np.array([0, 3, 512], dtype=np.int32),
    }
    reports = ragged(columns, [2, 1], ["007", "N412"], reading_audit={"dropped": {"duplicate": 2}})
    path = netcdf.write_product(
        reports, tmp_path / "a" / "headings.nc", title="t", config_json="{}"
    )
    back = netcdf.read_product(path)
    xr.testing.assert_equal(back.drop_vars("aircraft"), reports.drop_vars("aircraft"))
    assert list(back["aircraft"].to_numpy()) == ["007", "N412"]
    assert back["latitude"].attrs["units"] == "degrees_north"
    assert list(back["screening"].attrs["flag_masks"]) == list(SCREENING.values())
    assert back.attrs["Conventions"].startswith("CF-1.11")
    assert '"duplicate": 2' in back.attrs["reading_audit"]
    assert len(back.attrs["uuid"]) == 36
    assert [entry.name for entry in path.parent.iterdir()] == ["headings.nc"]
    with pytest.raises(KeyError, match="surprise"):
        netcdf.write_product(reports.assign(surprise=1), tmp_path / "b" / "x.nc", title="t")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("names", [["007", "N412"], ["", ""], ["Å\u00e9", "long, with a space"]])
def test_names_are_characters_of_one_length(tmp_path, names):
    """The HDF5 library crashes on strings of variable length (netcdf-c 2510)."""
    aircraft = xr.Dataset(coords={"aircraft": np.array(names, dtype=object)})
    path = netcdf.write_product(aircraft, tmp_path / "x.nc", title="t")
    with netCDF4.Dataset(path) as file:
        assert file["aircraft"].dtype == "S1"
    assert list(netcdf.read_product(path)["aircraft"].to_numpy()) == names


@pytest.mark.parametrize("times", [["2009-01-01T00:00:00.250", "NaT"], ["NaT", "NaT"]])
def test_times_may_be_missing_one_or_all(tmp_path, times):
    ds = xr.Dataset({"time": ("report", np.array(times, "M8[ns]"))})
    back = netcdf.read_product(netcdf.write_product(ds, tmp_path / "x.nc", title="t"))
    xr.testing.assert_equal(back, ds)


def test_plain_turns_not_a_number_into_none():
    value = {"a": np.float32("nan"), "b": np.arange(2), "c": [np.bool_(True), (1.5,)]}
    assert json_types(value) == {"a": None, "b": [0, 1], "c": [True, [1.5]]}


def test_findings_are_a_dict_with_a_line_a_key_and_none_of_them_long():
    pair = {"references": ["ruc", "rr"], "verdict": "poolable"}
    findings = Findings(reports=22991, references=["ruc", "rr"], pairs=[pair] * 500, end=None)
    lines = repr(findings).splitlines()
    assert lines[:2] == ["reports: 22991", "references: ['ruc', 'rr']"]
    assert [line.split(": ")[0] for line in lines] == list(findings)
    assert max(map(len, lines)) <= 100
    assert json.loads(json.dumps(findings)) == findings
    assert pickle.loads(pickle.dumps(findings)) == findings


def test_the_phase_of_flight_and_of_the_curve_are_distinguished():
    assert lookup("phase", ("report",)).flags is not None
    assert lookup("phase", ("reference", "aircraft")).units == "degree"


def test_a_heading_rounded_to_360_is_north():
    ds = xr.Dataset({"heading": ("report", [359.9999, 359.99, np.nan, 0.0])})
    expected = np.array([0.0, 359.990234375, np.nan, 0.0], dtype="f4")
    np.testing.assert_array_equal(netcdf.as_stored(ds)["heading"], expected)


def test_the_reports_of_each_aircraft():
    ds = ragged({"time": np.arange(5)}, [2, 0, 3], ["N1", "N2", "N3"])
    start, stop = row_bounds(ds["row_size"].to_numpy())
    assert start.tolist() == [0, 2, 2] and stop.tolist() == [2, 2, 5]
    assert aircraft_of_report(ds).tolist() == [0, 0, 2, 2, 2]
    assert airswing.aircraft_reports(ds, "N3")["time"].values.tolist() == [2, 3, 4]
    assert airswing.aircraft_reports(ds, "N2").sizes["report"] == 0
    with pytest.raises(KeyError, match="known: N1, N2, N3"):
        airswing.aircraft_reports(ds, "N9")


def written(path, kind, records=7):
    with netCDF4.Dataset(path, "w", format=kind) as file:
        file.createDimension("time", None)
        file.createDimension("x", 5)
        file.title = "three words"
        file.createVariable("x", "f8", ("x",))[:] = np.arange(5.0)
        for name, numbers in (("a", "i2"), ("b", "f4")):
            file.createVariable(name, numbers, ("time", "x"))[:] = np.ones((records, 5))
    return path


@pytest.mark.parametrize("kind", ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"])
def test_a_count_of_records_that_is_not_there_is_refused(kind, tmp_path):
    netcdf.require_sound(written(tmp_path / "b.nc", kind, records=0))
    path = written(tmp_path / "a.nc", kind)
    netcdf.require_sound(path)
    data = bytearray(path.read_bytes())
    wide = kind == "NETCDF3_64BIT_DATA"
    data[4 : 12 if wide else 8] = struct.pack(">Q" if wide else ">I", 9)
    path.write_bytes(data)
    with pytest.raises(InputError, match="9 records"):
        netcdf.require_sound(path)


@pytest.mark.parametrize(
    ("kind", "lengths"), [("NETCDF3_CLASSIC", range(4, 200, 7)), ("NETCDF4", [2000])]
)
def test_cut_files_are_refused_and_one_this_process_wrote_is_not_opened(tmp_path, kind, lengths):
    path = written(tmp_path / "a.nc", kind)
    netcdf.require_sound(path)
    data = path.read_bytes()
    for length in lengths:
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="damaged"):
            netcdf.require_sound(path)
    if kind == "NETCDF4":
        netcdf.written_here(path)
        netcdf.require_sound(path)
