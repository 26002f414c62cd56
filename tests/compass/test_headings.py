"""Headings of archives flown with a known compass error, of real aircraft, and lazy."""

import dask
import numpy as np
import pandas as pd
import ppigrf
import pytest
import xarray as xr
from pyproj import Geod

from airswing.compass.correction import add_tables, correct
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.headings import derive_headings
from airswing.compass.screening import audit, mark_corrected_units, screen
from airswing.errors import InputError
from airswing.flags import GROUND_VECTOR_SOURCE, REPORTED_HEADING_USE
from airswing.physics import triangle
from airswing.vocabulary import VARIABLES
from tests.compass.flown import wrap
from tests.ragged import ragged

GEOD = Geod(ellps="WGS84")
WIND = (18.0, -7.0)
TENTH_MINUTE = 0.1 / 60.0


def deviation(magnetic):
    """A compass error of some degrees, in degrees, of a magnetic heading in degrees."""
    angle = np.radians(magnetic)
    return 1.5 + 3.0 * np.sin(angle) - 2.0 * np.cos(angle)


def flown(*, flights=16, fixes=9, aircraft=2, airspeed_scale=1.0, position=0.0, tick=0.0):
    """Reports of aircraft along geodesics in a steady wind, their compass with a deviation.

    The attribute ``truth`` holds the exact values.
    """
    rng = np.random.default_rng(2)
    total = aircraft * flights
    seconds = np.cumsum(165.0 * rng.uniform(0.8, 1.2, (total, fixes)), axis=1)
    speed = rng.uniform(110.0, 150.0, (total, 1)) * np.ones(fixes)
    start = np.repeat(np.linspace(0.0, 360.0, total, endpoint=False), fixes)
    places = (np.repeat(rng.uniform(*ends, total), fixes) for ends in ((-100, -80), (32, 46)))
    lon, lat, back_azimuth = map(np.asarray, GEOD.fwd(*places, start, (speed * seconds).ravel()))
    track = np.radians(back_azimuth + 180.0)
    ground = triangle.vector_from_bearing(speed.ravel(), track)
    air = triangle.air_vector(*ground, *WIND)
    heading, airspeed = np.degrees(triangle.bearing(*air)), np.hypot(*air)
    epoch = np.datetime64("2009-03-14T12:00", "ns")
    since = (seconds + 86400.0 * np.arange(total)[:, np.newaxis]).ravel()
    e, n, _ = (component[0] for component in ppigrf.igrf(lon, lat, 9.0, pd.Timestamp("2009-03-20")))
    true_error = deviation(heading - np.degrees(np.arctan2(e, n)))
    unit_heading, unit_airspeed = heading + true_error, airspeed * airspeed_scale
    wind = triangle.wind_from_triangle(*ground, unit_airspeed, np.radians(unit_heading))

    def coded(values, step, rounding=np.round):
        return values if step == 0.0 else rounding(values / step) * step

    coded_seconds = coded(since, tick, np.floor)
    columns = {
        "time": epoch + np.round(coded_seconds * 1e9).astype("timedelta64[ns]"),
        "latitude": coded(lat, position),
        "longitude": coded(lon, position),
        "pressure": np.full(lat.size, 30742.0),
        "pressure_altitude": np.full(lat.size, 9000.0),
        "eastward_wind": wind[0],
        "northward_wind": wind[1],
        "phase": np.full(lat.size, 2, dtype=np.int8),
        "flight": np.repeat(np.arange(total, dtype=np.int32), fixes),
    }
    truth = {"heading": heading, "error": true_error, "track": np.degrees(track)}
    truth |= {"unit_heading": unit_heading, "unit_airspeed": unit_airspeed, "airspeed": airspeed}
    sizes = np.full(aircraft, flights * fixes, dtype=np.int32)
    names = [f"N{number:03d}" for number in range(aircraft)]
    return ragged(columns, sizes, names, reading_audit="{}", truth=truth).assign(
        position_resolution=("aircraft", np.full(aircraft, position)),
        time_resolution=("aircraft", np.full(aircraft, tick)),
    )


def model(reports, *, noise=0.0, names=("ruc",)):
    """The true wind plus noise, as collocated winds."""
    rng = np.random.default_rng(9)
    shape = (len(names), reports.sizes["report"])
    east, north = (component + noise * rng.normal(size=shape) for component in WIND)
    winds = {"reference_eastward_wind": east, "reference_northward_wind": north}
    return ragged(winds | {"lead_time": np.ones(shape)}, reference=names)


def with_reported(reports, heading, airspeed):
    columns = {"reported_heading": np.mod(heading, 360.0), "reported_airspeed": airspeed}
    return reports.assign(ragged(columns))


def from_reported(ds):
    """Number of reports whose ground vector is that of the reported heading and airspeed."""
    return int((ds["ground_vector_source"] == GROUND_VECTOR_SOURCE["reported"]).sum())


def uses(ds):
    """Use of the reported heading, aircraft by aircraft."""
    words = {value: name for name, value in REPORTED_HEADING_USE.items()}
    return [words[int(code)] for code in ds["reported_heading_use"]]


def error(angle, expected):
    """Signed difference of angles in degrees."""
    return wrap(np.asarray(angle, float) - expected)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_heading_errors_equal_the_simulated_compass_errors():
    reports = flown(airspeed_scale=1.02)
    truth = reports.attrs["truth"]
    ds = derive_headings(reports, model(reports))
    assert ds.heading_error.dims == ("reference", "report")
    np.testing.assert_allclose(ds.heading_error[0], truth["error"], atol=2e-3)
    np.testing.assert_allclose(error(ds.heading, truth["unit_heading"]), 0.0, atol=2e-3)
    np.testing.assert_allclose(error(ds.track, truth["track"]), 0.0, atol=1e-3)
    np.testing.assert_allclose(ds.airspeed, 1.02 * truth["airspeed"], rtol=1e-5)
    magnetic = ds.heading - ds.declination
    np.testing.assert_allclose(error(magnetic, ds.magnetic_heading.values), 0.0, atol=1e-4)
    # an error of the airspeed shows along the heading and not across
    np.testing.assert_allclose(ds.airspeed_error[0], 0.02 * truth["airspeed"], atol=2e-3)
    for name in ("heading", "heading_error", "horizontal_field", "turn", "airspeed_error"):
        assert ds[name].attrs["units"] == VARIABLES[name].units
        assert ds[name].dtype == VARIABLES[name].dtype
    assert ds.attrs["reading_audit"] == "{}"
    assert len(set(np.floor(truth["heading"] / 45.0))) == 8, "all eight octants were flown"


def test_missing_winds_of_one_reference_leave_the_other():
    reports = flown(flights=3)
    winds = model(reports, names=("ruc", "rtfdaa"))
    winds.reference_eastward_wind[0, 5] = np.nan
    ds = derive_headings(reports, winds)
    assert np.isnan(ds.heading_error.sel(reference="ruc")[5])
    assert np.isfinite(ds.heading_error.sel(reference="rtfdaa")).all()
    assert np.isfinite(ds.heading).all()


@pytest.mark.parametrize(("position", "tick"), [(TENTH_MINUTE, 1.0), (0.01, 60.0)])
def test_stated_standard_errors_equal_the_scatter_of_heading_errors(position, tick):
    reports = flown(flights=60, position=position, tick=tick)
    ds = derive_headings(reports, model(reports), acceleration_density=0.0)
    miss = ds.heading_error[0].values - reports.attrs["truth"]["error"]
    stated = ds.heading_error_standard_error[0].values
    assert rms(miss / stated) == pytest.approx(1.0, abs=0.25)
    assert rms(miss) < 0.3, "an error of the ground vector nearly cancels"


def test_reported_heading_and_airspeed_are_used_where_they_agree():
    reports = flown(position=0.01, tick=60.0)
    truth = reports.attrs["truth"]
    reported = with_reported(reports, np.round(truth["unit_heading"]), truth["unit_airspeed"])
    chords = derive_headings(reports, model(reports))
    ds = derive_headings(reported, model(reports))
    assert from_reported(ds) == reports.sizes["report"]
    assert uses(ds) == ["used", "used"] and uses(chords) == ["absent", "absent"]
    np.testing.assert_allclose(error(ds.heading, np.round(truth["unit_heading"])), 0, atol=1e-3)
    assert rms(error(ds.track, truth["track"])) < 0.35 < rms(error(chords.track, truth["track"]))
    assert float(ds.ground_velocity_error.median()) < 1.0
    # half a degree of rounding in a whole degree, the rest is the compass
    assert rms(ds.heading_error[0] - truth["error"]) < 0.35


@pytest.mark.parametrize(
    ("column", "reason"),
    [("track", "heading_is_track"), ("magnetic", "heading_differs"), ("cas", "airspeed_differs")],
)
def test_a_column_of_another_quantity_is_not_used(column, reason):
    reports = flown(position=TENTH_MINUTE, tick=1.0)
    truth = reports.attrs["truth"]
    heading, airspeed = truth["unit_heading"], truth["unit_airspeed"]
    n001 = np.arange(heading.size) >= heading.size // 2
    wrong = {
        "track": (truth["track"], airspeed),
        "magnetic": (heading - 1.0, airspeed),  # a declination of one degree
        "cas": (heading, 0.65 * airspeed),
    }[column]
    columns = (np.where(n001, *pair) for pair in zip(wrong, (heading, airspeed), strict=True))
    ds = derive_headings(with_reported(reports, *columns), model(reports))
    assert uses(ds) == ["used", reason]
    assert from_reported(ds) == (~n001).sum()
    np.testing.assert_allclose(ds.heading_error[0].values, truth["error"], atol=0.6)


def test_reported_headings_need_enough_reports_and_tolerate_an_outlier():
    for reports, use in ((flown(flights=2, fixes=8), "too_few"), (flown(), "used")):
        truth = reports.attrs["truth"]
        heading, airspeed = truth["unit_heading"].copy(), truth["unit_airspeed"].copy()
        heading[7] += 40.0
        airspeed[9] = np.nan
        ds = derive_headings(with_reported(reports, heading, airspeed), model(reports))
        assert uses(ds) == [use] * 2
    assert from_reported(ds) == reports.sizes["report"] - 2
    np.testing.assert_allclose(ds.heading_error[0], truth["error"], atol=3e-3)


def test_inconsistent_input_is_refused():
    reports = flown(flights=2)
    winds = model(reports)
    for refused_reports, wind, says in (
        (reports.drop_vars("flight"), winds, "flight"),
        (reports, winds.drop_vars("reference_northward_wind"), "reference_northward_wind"),
        (reports, winds.isel(report=slice(1, None)), "35 winds for 36 reports"),
        (reports.assign(row_size=("aircraft", [3, 4])), winds, "row_size"),
    ):
        with pytest.raises(InputError, match=says):
            derive_headings(refused_reports, wind)
    none = reports.isel(report=[]).assign(row_size=("aircraft", [0, 0]))
    assert derive_headings(none, model(none)).heading_error.shape == (1, 0)


def test_headings_of_a_research_aircraft_follow_from_fixes_and_wind(real):
    """Derived heading and airspeed against those its instruments recorded."""
    with xr.open_dataset(real("heading/ncar_gv_20131001.nc"), engine="netcdf4") as ds:
        gv = ds.load().isel(Time=slice(0, None, 20))
    names = ("WSC", "WDC", "LATC", "LONC", "GGALT", "THDG", "TASX")
    columns = (gv[name].values.astype(float) for name in names)
    speed, direction, lat, lon, height, heading, airspeed = columns
    wind = triangle.wind_components(speed, np.radians(direction))
    columns = {
        "time": gv.Time.values.astype("datetime64[ns]"),
        "latitude": lat,
        "longitude": lon,
        "pressure_altitude": height,
        "eastward_wind": wind[0],
        "northward_wind": wind[1],
        "flight": np.zeros(lat.size, dtype=np.int32),
    }
    reports = ragged(columns, [lat.size], ["N677F"])
    derived = derive_headings(reports, model(reports), widen=False).isel(report=slice(1, -1))
    assert np.median(np.abs(error(derived.heading, heading[1:-1]))) < 0.5, "degrees"
    assert np.median(np.abs(derived.airspeed.values - airspeed[1:-1])) < 1.0
    # the drift is more than ten degrees: neither the track nor the wrong sign would do
    assert np.median(np.abs(error(derived.track, heading[1:-1]))) > 8.0


POOLS = {"both": ["ruc", "rtfdaa"]}


def refuse(*_, **__):
    raise AssertionError("something was computed")


def stages(reports, winds):
    """Every stage on what the stage before returned."""
    headings, start = screen(derive_headings(reports, winds)), np.datetime64("2009-04-01", "ns")
    headings = mark_corrected_units(headings, aircraft=["N001"], start=start)
    fits = add_tables(fit_deviation(headings, pools=POOLS, min_reports=100), headings)
    return [headings, audit(headings), fits, correct(headings, fits)]


@pytest.fixture(scope="module")
def two_references():
    # aircraft of different sizes: the last keeps a third of its reports
    reports = flown(flights=24, aircraft=3).drop_attrs().isel(report=slice(-144))
    reports["row_size"] = ("aircraft", [216, 216, 72])
    winds = model(reports, noise=1.5, names=("ruc", "rtfdaa"))
    return reports, winds, stages(reports, winds)


@pytest.mark.parametrize("chunks", [{"report": 50}, {"report": 300, "aircraft": 2}, {"report": -1}])
def test_stages_are_lazy_and_equal_the_eager_result(two_references, chunks):
    reports, winds, eager = two_references
    with dask.config.set(scheduler=refuse):
        lazy = stages(reports.chunk(chunks), winds.chunk({"report": 70}))
    for scheduler in ("synchronous", "threads"):
        for expected, computed in zip(eager, dask.compute(*lazy, scheduler=scheduler), strict=True):
            xr.testing.assert_identical(computed, expected)


def test_blocks_contain_complete_aircraft_and_processes_give_equal_results(two_references):
    """With row sizes in memory, as products have them."""
    reports, winds, eager = two_references
    with dask.config.set(scheduler=refuse):
        lazy = stages(reports.chunk({"report": 50}).assign(row_size=reports["row_size"]), winds)
    assert lazy[0]["heading"].chunks == (tuple(reports["row_size"].to_numpy().tolist()),)
    in_process = dask.compute(*lazy, scheduler="processes", num_workers=1)
    for expected, computed in zip(eager, in_process, strict=True):
        xr.testing.assert_identical(computed, expected)
