"""The readers of the target systems get every exported report and no other.

The archives contain calms, winds from due north, missing temperatures, reports at one place and
time, the antimeridian, midnight at the end of the year, winds above 80 hPa, and missing and
impossible values. A failed export ends in one message and status 2, with nothing half-written.
"""

import json
import shlex
from collections import Counter
from datetime import datetime, timedelta

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing import export
from airswing.config import Handover
from airswing.errors import InputError
from airswing.flags import CORRECTION, PHASE, PLATFORM, SCREENING
from airswing.handover.export import as_text
from airswing.physics.triangle import wind_components
from airswing.products.netcdf import write_product
from tests.command import airswing
from tests.handover import obsproc, wrf_nudging, wrfda
from tests.handover.archives import corrected

EPOCH = datetime(1970, 1, 1)
FORMATS = ("obs_domain", "little_r", "ob_ascii")
STEP = {"obs_domain": 1e-3, "little_r": 1e-4, "ob_ascii": 6e-3}
"""m/s of a component that a format's rounding may cost: direction to 0.001 degree at 150 m/s."""


def understood(to, path):
    """Winds in a file as the reader of its format gives them, in the order of the file."""
    text = path.read_text()
    if to == "obs_domain":
        rows = _of_nudging(wrf_nudging.raw(text))
    elif to == "little_r":
        later = timedelta(days=365_000)
        rows = _of_obsproc(obsproc.processed(text, EPOCH - timedelta(1), EPOCH, EPOCH + later))
    else:
        reports, complete = wrfda.read(text)
        assert complete
        rows = _of_wrfda(reports)
    return pd.DataFrame(rows, columns=["seconds", "id", "lat", "lon", "p", "u", "v", "t"])


def _of_nudging(reports):
    assert all(report["chronological"] for report in reports)
    for report in reports:
        assert report["is_sound"] and not report["bogus"] and report["plfo"] == 99.0
        assert report["elevation"] == -888888.0
        pressures = [level[0][0] for level in report["levels"]]
        assert pressures == sorted(set(pressures), reverse=True)
        place = report["seconds"], report["id"].rstrip(), report["lat"], report["lon"]
        for p, z, t, u, v, rh in report["levels"]:
            assert p[1] == 0.0 and p[0] > 8000.0 and u[1] == v[1] == 129.0
            assert z == rh == (-888888.0, -888888.0) and (u[0], v[0]) != (0.0, 0.0)
            yield *place, p[0], u[0], v[0], t[0]


def _of_obsproc(reports):
    for report in reports:
        seconds = (report["time"] - EPOCH).total_seconds()
        place = seconds, report["id"].rstrip(), report["lat"], report["lon"]
        for level in report["levels"]:
            (speed, q1), (direction, q2) = level["speed"], level["dir"]
            assert q1 == q2 == 0 and level["p"][1] == 0
            assert (level["z"][1] == 0) == (report["fm"] == 101)
            wind = wind_components(speed, np.radians(direction))
            yield *place, level["p"][0], *map(float, wind), level["t"][0]


def _of_wrfda(reports):
    for report in reports:
        assert report["type"] in ("tamdar", "airep")
        seconds = (datetime.strptime(report["date"], "%Y-%m-%d_%H:%M:%S") - EPOCH).total_seconds()
        place = seconds, report["id"].rstrip(), report["lat"], report["lon"]
        for level in report["levels"]:
            assert level["wind_used"] and level["vertical"] == "pressure"
            assert all(level[name][2] > 0.0 for name in wrfda.COLUMNS)
            assert 0.0 < level["dir"][0] <= 360.0
            yield *place, level["p"][0], *level["earth"], level["t"][0]


def expected(ds):
    """The reports of an archive that are all fit for every format."""
    time = ds["time"].to_numpy().astype("M8[ms]").astype(np.int64)
    columns = {
        "seconds": ((time + 500) // 1000).astype(float),
        "id": np.repeat(ds["aircraft"].to_numpy(), ds["row_size"].to_numpy()),
        "lat": ds["latitude"],
        "lon": ds["longitude"],
        "p": ds["pressure"],
        "u": ds["corrected_eastward_wind"],
        "v": ds["corrected_northward_wind"],
        "t": ds["air_temperature"].where(np.isfinite(ds["air_temperature"]), -888888.0),
    }
    return pd.DataFrame({name: np.asarray(values) for name, values in columns.items()})


def ordered(table):
    level = -table["p"].round()
    return table.assign(level=level).sort_values(["seconds", "id", "level"], ignore_index=True)


def assert_agree(exported, wanted, to):
    exported, wanted = ordered(exported), ordered(wanted)
    assert exported[["seconds", "id"]].values.tolist() == wanted[["seconds", "id"]].values.tolist()
    assert (((exported["lon"] - wanted["lon"] + 180.0) % 360.0 - 180.0).abs() < 6e-4).all()
    for name, close in {"lat": 6e-4, "p": 6e-3, "t": 1e-3}.items():
        np.testing.assert_allclose(exported[name], wanted[name], atol=close, rtol=1e-6)
    calm = {"obs_domain": 1.1e-3, "little_r": 0.1001, "ob_ascii": 0.0}[to]
    speed = np.hypot(wanted["u"], wanted["v"])
    close = STEP[to] + np.where(speed < 0.1, calm, 0.0) + 1e-6 * speed
    for name in "uv":
        assert ((exported[name] - wanted[name]).abs() <= close).all()


SPECIAL = [(0.0, 0.0), (0.0, -10.0), (0.0, 5.0), (-7.0, 0.0), (0.0004, -0.0004), (1e-7, -20.0)]
SPECIAL += [(-1e-7, -20.0), (0.05, 0.0), (0.0, -0.09999)]
component = st.floats(-100.0, 100.0, width=32)
winds = st.tuples(component, component) | st.sampled_from(SPECIAL)
REPORT = st.fixed_dictionaries(
    {
        "wind": winds,
        "seconds": st.integers(0, 200) | st.just(0),
        "latitude": st.sampled_from([45.0, -33.33333, 0.0, 89.9, -0.00004]) | st.floats(-80, 80),
        "longitude": st.sampled_from([180.0, -180.0, 179.99996, -0.00004, 359.0])
        | st.floats(-180, 180),
        "pressure": st.sampled_from([50000.0, 8000.01, 108000.0])
        | st.floats(8010, 105000, width=32),
        "air_temperature": st.sampled_from([np.nan, 150.0, 340.0]) | st.floats(180, 320, width=32),
    }
)


@given(
    st.lists(REPORT, min_size=1, max_size=12),
    st.sampled_from(["N1", "0000751", "ACARS", "x" * 40, "SATWNDS CLASS DA"]),
    st.sampled_from(["TAMDAR", "AMDAR", "ACARS", "AIREP"]),
    st.sampled_from(FORMATS),
)
def test_every_report_is_understood(tmp_path_factory, reports, tail, platform, to):
    reports = sorted(reports, key=lambda report: report["seconds"])
    year_end = np.datetime64("2008-12-31T23:58:00", "ns")
    seconds = np.array([report["seconds"] for report in reports])
    split = len(reports) // 2
    sizes = {tail: split, "N2": len(reports) - split} if split else {tail: len(reports)}
    names = ("latitude", "longitude", "pressure", "air_temperature")
    columns = {name: [report[name] for report in reports] for name in names}
    for number, name in enumerate(("corrected_eastward_wind", "corrected_northward_wind")):
        columns[name] = [report["wind"][number] for report in reports]
    ds = corrected(sizes, time=year_end + seconds * np.timedelta64(1, "s"), **columns)
    path = tmp_path_factory.mktemp("export") / "file"
    result = export(ds, to=to, path=path, settings=Handover(platform=platform))
    assert result["reports"] == result["levels"] == len(reports) and not result["left_out"]
    table = understood(to, path)
    assert to != "ob_ascii" or table["seconds"].is_monotonic_increasing
    assert_agree(table, expected(ds), to)


BAD = {
    "no_time": {"time": np.datetime64("NaT", "ns")},
    "impossible_time": {"time": np.datetime64("2100-01-01", "ns")},
    "no_position": {"longitude": np.inf},
    "at_a_pole": {"latitude": 90.0},
    "no_wind": {"corrected_northward_wind": np.nan},
    "impossible_wind": {"corrected_eastward_wind": -np.inf},
    "no_level": {"pressure": np.nan},
    "impossible_level": {"pressure": 2e6},
    "not_corrected_no_fit": {"correction_applied": CORRECTION["no_fit"]},
    "not_corrected_offset_only": {"correction_applied": CORRECTION["offset_only"]},
    "not_corrected_no_heading": {"correction_applied": CORRECTION["no_heading"]},
    "screened_out_roll": {"screening": SCREENING["roll"] | SCREENING["phase"]},
    "screened_out_turn": {"screening": SCREENING["turn"]},
    "screened_out_no_reference": {"screening": SCREENING["no_reference"]},
    "screened_out_gross_error": {"screening": SCREENING["gross_error"]},
    "before_the_period": {"time": np.datetime64("2008-07-15T11:59:59", "ns")},
    "after_the_period": {"time": np.datetime64("2008-07-15T13:00:00", "ns")},
}


@pytest.mark.parametrize("to", FORMATS)
def test_one_report_for_every_reason_to_leave_it_out(tmp_path, to):
    ds = corrected({"N1": len(BAD) + 4}, time=np.datetime64("2008-07-15T12:30:00", "ns"))
    for number, change in enumerate(BAD.values()):
        for name, value in change.items():
            ds[name][number] = value
    ds["screening"][-1] = SCREENING["phase"]
    ds["screening"][-2] = SCREENING["field_test"]
    ds["correction_applied"][-2] = CORRECTION["already_corrected"]
    ds["correction_applied"][-3] = CORRECTION["no_correction_needed"]
    period = Handover(start=datetime(2008, 7, 15, 12), end=datetime(2008, 7, 15, 13))
    result = export(ds, to=to, path=tmp_path / "f", settings=period)
    assert result["reports"] == 4
    assert Counter(result["left_out"]) == Counter(BAD.keys())
    assert len(understood(to, tmp_path / "f")) == 4


@pytest.mark.parametrize("to", FORMATS)
def test_pressure_altitude_replaces_missing_pressure_and_bad_temperatures_are_missing(tmp_path, to):
    temperature = [20.0, np.inf, 258.15]
    ds = corrected({"N1": 3}, pressure=[np.nan, 40000.0, 50000.0], air_temperature=temperature)
    ds["pressure_altitude"] = ("report", np.array([5574.44, 7185.4, 0.0]))
    export(ds, to=to, path=tmp_path / "f")
    table = understood(to, tmp_path / "f")
    np.testing.assert_allclose(table["p"], [50000.0, 40000.0, 50000.0], atol=1.0)
    np.testing.assert_allclose(table["t"], [-888888.0, -888888.0, 258.15], atol=1e-3)


def profile(pressure, *, phase="ascent", **columns):
    """One aircraft in one ascent or descent, by pressures in hPa, a report a minute."""
    pressure = 100.0 * np.asarray(pressure)
    return corrected(
        {"N1": pressure.size},
        pressure=pressure,
        phase=PHASE[phase],
        corrected_eastward_wind=np.arange(pressure.size) + 1.0,
        **columns,
    )


@pytest.mark.parametrize("to", FORMATS)
def test_ascents_and_descents_are_joined(tmp_path, to):
    """7 + 8 levels of each aircraft are joined; level flight and cruise remain single reports."""
    up = np.linspace(95000.0, 45000.0, 8)
    up[4] = up[3] - 0.4
    pressure = [*up, *[45000.0] * 3, *np.linspace(45500.0, 93000.0, 8)]
    ds = corrected(
        {"N1": 19, "N2": 19},
        phase=([PHASE["ascent"]] * 8 + [PHASE["cruise"]] * 3 + [PHASE["descent"]] * 8) * 2,
        pressure=pressure * 2,
        corrected_eastward_wind=np.arange(38) - 20.0,
    )
    result = export(ds, to=to, path=tmp_path / "f", soundings=True)
    assert result["levels"] == 38 and result["reports"] == 2 * (2 + 4)
    table = understood(to, tmp_path / "f").sort_values("u")
    assert table["u"].round().tolist() == list(range(-20, 18))
    np.testing.assert_allclose(table["p"], pressure * 2, atol=1e-2)
    middle = ds["time"].to_numpy()[3].astype("M8[s]").astype(int)
    assert (table["seconds"][:8] == middle).sum() == 7


@pytest.mark.parametrize(
    ("pressure", "phase", "sizes"),
    [
        ([950, 800, 650, 420, 300, 250], "ascent", [3, 3]),  # a step of 230 hPa
        ([250, 300, 420, 650, 800, 950], "descent", [3, 3]),
        ([950, 800, 600, 450], "ascent", [4]),  # 200 hPa is not over 200 hPa
        ([800, 790], "ascent", [1, 1]),  # two single levels reach more
        ([800, 700, 651], "ascent", [1, 1, 1]),
        ([800, 700, 650], "ascent", [3]),
        ([950, 930, 700, 600, 500], "ascent", [1, 1, 3]),  # split, then too shallow below
    ],
)
def test_soundings_that_the_nudging_would_ignore(tmp_path, pressure, phase, sizes):
    """nudob skips a sounding with a step over 200 hPa and does not reach beyond its ends."""
    ds = profile(pressure, phase=phase)
    result = export(ds, to="obs_domain", path=tmp_path / "f", soundings=True)
    reports = wrf_nudging.raw((tmp_path / "f").read_text())
    assert sorted(report["meas_count"] for report in reports) == sorted(sizes)
    for report in (report for report in reports if report["meas_count"] > 1):
        step = -np.diff([level[0][0] for level in report["levels"]])
        assert (step <= 20000.0).all() and step.sum() >= 15000.0
    winds = sorted(round(level[3][0]) for report in reports for level in report["levels"])
    assert winds == list(range(1, len(pressure) + 1))
    split = any(abs(np.diff(pressure)) > 200)
    assert any("split at 1 pressure step" in note for note in result["notes"]) == split
    # Other readers have no such limits.
    result = export(profile(pressure), to="little_r", path=tmp_path / "g", soundings=True)
    assert result["reports"] == 1 or phase == "descent"


@pytest.mark.parametrize("to", FORMATS)
def test_products_by_month_are_exported_as_one(tmp_path, to):
    """Reports of two aircraft over New Year: the same file as from one product."""
    count = 400
    time = np.datetime64("2008-12-31T20:00", "ns") + np.arange(count) * np.timedelta64(72, "s")
    ds = corrected(
        {"N1": 200, "N2": 200},
        time=np.concatenate([time[::2], time[::2]]),
        phase=np.tile([PHASE["ascent"]] * 20 + [PHASE["cruise"]] * 30, 8),
        pressure=np.tile(np.linspace(90000.0, 40000.0, 50), 8),
        flight=np.repeat(np.arange(8), 50),
    )
    later = ds["flight"].to_numpy() % 4 >= 2  # a flight belongs to the month of its first report
    for month, in_month in (("2008-12", ~later), ("2009-01", later)):
        month_ds = ds.isel(report=np.flatnonzero(in_month))
        month_ds["row_size"] = ("aircraft", np.array([100, 100], dtype=np.int32))
        write_product(month_ds, tmp_path / "corrected" / f"{month}.nc", title="test")
    write_product(ds, tmp_path / "whole.nc", title="test")
    export(tmp_path / "whole.nc", to=to, path=tmp_path / "whole", soundings=True)
    export(tmp_path / "corrected", to=to, path=tmp_path / "months", soundings=True)
    assert (tmp_path / "months").read_bytes() == (tmp_path / "whole").read_bytes()


def test_windows_get_a_folder_each(tmp_path):
    time = np.datetime64("2008-12-31T22:30", "ns") + np.arange(6) * np.timedelta64(30, "m")
    ds = corrected({"N1": 6}, time=time)
    second, begun = Handover(domain=2), Handover(start=datetime(2008, 12, 31, 22, 30))
    result = export(ds, to="obs_domain", path=tmp_path / "w", window="1 h", settings=second)
    files = sorted((tmp_path / "w").rglob("OBS_DOMAIN201"))
    hours = ["200812312200", "200812312300", "200901010000", "200901010100"]
    assert [file.parent.name for file in files] == hours
    assert [file["reports"] for file in result["files"]] == [1, 2, 2, 1]
    assert [len(wrf_nudging.raw(file.read_text())) for file in files] == [1, 2, 2, 1]
    result = export(ds, to="ob_ascii", path=tmp_path / "v", window="1 h", settings=begun)
    assert [file["reports"] for file in result["files"]] == [2, 2, 2]
    assert result["files"][0]["path"].endswith("200812312230/ob.ascii")


@pytest.mark.parametrize(("name", "code"), [("AMDAR", "FM-42 AMDAR "), ("unknown", "FM-101 TAMDA")])
def test_the_platform_follows_the_source(tmp_path, name, code):
    codes = np.array([PLATFORM[name], PLATFORM["ACARS"]], dtype=np.int8)
    ds = corrected({"N1": 1, "N2": 1}).assign(platform=("aircraft", codes))
    export(ds, to="ob_ascii", path=tmp_path / "f")
    read = wrfda.read((tmp_path / "f").read_text())[0]
    assert [record["platform"] for record in read] == [code, "FM-97 ACARS "]
    export(ds.drop_vars("platform"), to="ob_ascii", path=tmp_path / "g")
    read = wrfda.read((tmp_path / "g").read_text())[0]
    assert {record["platform"] for record in read} == {"FM-101 TAMDA"}


@pytest.mark.parametrize("to", FORMATS)
def test_aircraft_by_number(tmp_path, to):
    """A name that is a number keeps it; of 0000751 and 751 the first has the number."""
    names = ["0000751", "00002", "123456", "751", "N751A", "X"]
    ds = corrected(dict.fromkeys(names, 1))
    result = export(ds, to=to, path=tmp_path / "f", settings=Handover(identifiers="number"))
    numbers = ["00751", "00002", "00001", "00003", "00004", "00005"]
    assert result["identifiers"] == dict(zip(names, numbers, strict=True))
    assert understood(to, tmp_path / "f")["id"].tolist() == numbers
    assert "identifiers" not in export(ds, to=to, path=tmp_path / "g")
    assert "N751A 00004, and 1 more" in as_text(result)


CONFIG = "reports: {files: r.csv}\nreferences: {ruc: {files: x}}\noutput: out\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a configuration and the product of a run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(CONFIG)
    write_product(corrected({"N1": 5}), tmp_path / "out/corrected.nc", title="test")
    return tmp_path


def call(*words):
    done = airswing("export", "c.yaml", *words)
    return done.returncode, done.stdout, done.stderr


def files_below(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        ("grib -o f", ["no such export format", "grib", "obs_domain"]),
        ("obs_domain -o f --winds best", ["--winds", "best"]),
        ("obs_domain -o f --window soon", ["--window", "soon"]),
        ("obs_domain -o f --window '0.5 s'", ["--window", "0.5 s"]),
        ("obs_domain -o f --domain 12", ["--domain", "12"]),
        ("obs_domain -o f --platform BOAT", ["--platform", "BOAT"]),
        ("obs_domain -o f --start noon", ["--start", "noon"]),
        ("little_r -o f --start 2020-01-01 --end 2020-01-02", ["no report", "before_the_period 5"]),
        ("little_r -o f --start 2020-01-02 --end 2020-01-01", ["end must be later"]),
        ("obs_domain -o OBS_DOMAIN301", ["OBS_DOMAIN301", "--domain 3"]),
        ("ob_ascii -o c.yaml", ["c.yaml", "--overwrite"]),
        ("ob_ascii -o c.yaml/sub/f", ["c.yaml/sub/f"]),
    ],
)
def test_bad_requests(folder, words, fragments):
    before = files_below(folder)
    status, out, err = call("--to", *shlex.split(words), "--quiet")
    assert status == 2 and out == ""
    assert err.startswith("airswing: ") and len(err) < 2000 and err.count("\n") == 1
    assert all(word in err for word in fragments), err
    assert files_below(folder) == before and (folder / "c.yaml").read_text() == CONFIG


def test_the_command_writes_and_reports(folder):
    words = ("--to", "ob_ascii", "-o", "w/", "--window", "2 min", "--quiet")
    status, out, err = call(*words, "--json")
    assert (status, err) == (0, "")
    result = json.loads(out)
    assert result["reports"] == 5 and [file["reports"] for file in result["files"]] == [2, 2, 1]
    assert all((folder / file["path"]).is_file() for file in result["files"])
    status, _, err = call(*words)
    assert status == 2 and "ob.ascii" in err and "already exists" in err
    status, out, _ = call(*words, "--overwrite")
    assert status == 0 and "5 reports, 5 winds as corrected, in 3 files" in out
    assert not [*folder.rglob(".airswing*")]
    (folder / "out/corrected.nc").unlink()
    status, _, err = call("--to", "little_r", "-o", "f")
    assert status == 2 and "out/corrected: no such product" in err and "airswing run" in err


@pytest.mark.parametrize("name", ["x" * 41, "Ä1", "N1\nN2", "N\t1"])
@pytest.mark.parametrize("to", FORMATS)
def test_identifiers_no_format_can_hold(tmp_path, name, to):
    with pytest.raises(InputError, match=r"identifier.*40 characters"):
        export(corrected({"N1": 2, name: 2}), to=to, path=tmp_path / "f")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "name", ["correction_applied", "screening", "corrected_eastward_wind", "flight", "pressure"]
)
def test_a_variable_that_is_needed_is_named(tmp_path, name):
    with pytest.raises(InputError, match=name):
        export(corrected({"N1": 2}).drop_vars(name), to="obs_domain", path=tmp_path / "f")
