"""Simulation of an archive, removal of known effects, reports of another simulation."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.gap import frames

from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.gap.effects import ActiveEffect
from airswing.gap.noise import NoiseModel
from airswing.gap.simulation.effects_file import effects_of_fits, read_known, write_effects
from airswing.gap.simulation.forward import Coding, draw_noise, remove_effects, simulate
from airswing.gap.simulation.report_table import (
    match_reports,
    simulate_reports,
    with_simulated_wind,
    write_reports,
)
from airswing.products.netcdf import write_product
from airswing.reports.read import read_reports
from airswing.units import KNOT
from airswing.workflow.gap_stage import simulation

NOISE = NoiseModel(2.3, 1.0, 155e3, 1e9, np.zeros(1), np.ones(1))
STRONG = [
    ActiveEffect("hard_iron", {"amplitude_deg": 8.0, "phase_deg": 30.0}),
    ActiveEffect("soft_iron", {"amplitude_deg": 3.0, "phase_deg": -70.0}),
    ActiveEffect("compass_offset", {"offset_deg": 1.0}),
    ActiveEffect("tas_scale", {"scale_percent": 3.0}),
]


@pytest.fixture(scope="module")
def archive():
    return frames.frame()


def test_perfect_instrument_sends_the_reference_wind(archive):
    sent = simulate(replace(archive, u_rep=archive.u_rep + 7.0))
    np.testing.assert_allclose(sent.u_rep, archive.u_ref, atol=1e-10)
    np.testing.assert_allclose(sent.v_rep, archive.v_ref, atol=1e-10)
    np.testing.assert_allclose(np.sin(sent.heading - archive.heading), 0.0, atol=1e-10)
    np.testing.assert_allclose(sent.airspeed, archive.airspeed)
    np.testing.assert_array_equal(sent.time, archive.time)


def test_errors_are_functions_of_the_indicated_heading(archive):
    sent = simulate(archive, effects=STRONG)
    true = np.arctan2(archive.ground_u - archive.u_ref, archive.ground_v - archive.v_ref)
    error = np.angle(np.exp(1j * (sent.heading - true)))
    m = sent.heading - archive.declination
    growth = archive.reference_field / archive.horizontal_field
    expected = 1.0 + 8.0 * growth * np.sin(m + np.radians(30.0))
    expected += 3.0 * np.sin(2 * m - np.radians(70.0))
    np.testing.assert_allclose(np.degrees(error), expected, atol=1e-8)
    np.testing.assert_allclose(np.cos(sent.magnetic_heading - m), 1.0)
    speed = np.hypot(archive.ground_u - archive.u_ref, archive.ground_v - archive.v_ref)
    np.testing.assert_allclose(sent.airspeed, 1.03 * speed)


@pytest.mark.parametrize(
    ("name", "values"),
    [("compass_step", {"offset_deg": 3.0}), ("compass_drift", {"rate_deg_per_day": 2.0})],
)
def test_effect_acts_on_its_aircraft_and_period(archive, name, values):
    start, end = np.quantile(archive.time, [0.3, 0.7])
    sent = simulate(archive, effects=[ActiveEffect(name, values, ("N402",), (start, end))])
    turned = np.degrees(np.angle(np.exp(1j * (sent.heading - simulate(archive).heading))))
    acts = (archive.aircraft == 1) & (archive.time >= start) & (archive.time < end)
    assert 0 < acts.sum() < archive.take(archive.aircraft_mask("N402")).size
    days = (archive.time - start) / 86400  # a drift counts from the start of its period
    size = 3.0 if name == "compass_step" else 2.0 * days
    np.testing.assert_allclose(turned, np.where(acts, size, 0.0), atol=1e-6)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (ActiveEffect("hard_irom"), "did you mean 'hard_iron'"),
        (ActiveEffect("tas_scale", {"scale_percent": 1.0}, ("N999",)), "N999"),
        (ActiveEffect("hard_iron", {"phase_deg": 3.0}), "needs a value of amplitude_deg"),
        (ActiveEffect("heater_current", {"offset_deg": 1.0}), "no icing column"),
        (ActiveEffect("reference_speed_bias", {"bias_percent": -100.0}), "weaker than none"),
        (ActiveEffect("hard_iron", {"amplitude_deg": 120.0, "phase_deg": 10.0}), "does not settle"),
    ],
)
def test_effects_that_cannot_be_simulated_are_refused(effect, message):
    with pytest.raises(InputError, match=message):
        simulate(frames.frame(icing=False), effects=[effect])


def test_wind_is_coded_in_steps(archive):
    sent = simulate(archive, coding=Coding.of_archive(archive))
    speed = np.hypot(sent.u_rep, sent.v_rep) / KNOT
    direction = np.degrees(np.arctan2(-sent.u_rep, -sent.v_rep))
    np.testing.assert_allclose(speed, np.round(speed), atol=1e-9)
    np.testing.assert_allclose(direction, np.round(direction), atol=1e-8)
    names = ("wind_speed_resolution", "wind_direction_resolution")
    unknown = replace(archive, **dict.fromkeys(names, np.full(3, np.nan)))
    uncoded = simulate(unknown, coding=Coding.of_archive(unknown))
    np.testing.assert_allclose(uncoded.u_rep, archive.u_ref, atol=1e-9)


def test_noise_has_the_stated_correlation_and_factors_of_direction(archive):
    """Straight flights along the equator with a report every 50 km."""
    flights, reports = 3000, 12
    frame = replace(
        archive.take(np.arange(flights * reports) % archive.size),
        flight=np.repeat(np.arange(flights), reports),
        time=np.add.outer(86400.0 * np.arange(flights), 60.0 * np.arange(reports)).ravel(),
        latitude=np.zeros(flights * reports),
        longitude=np.tile(50e3 * np.arange(reports) / frames.METRES_PER_DEGREE, flights),
        pressure=np.full(flights * reports, 5e4),
    )
    noise = replace(NOISE, correlated_sd=2.0, length=150e3)
    isotropic = draw_noise(frame, noise, rng=np.random.default_rng(1))
    draw = isotropic.reshape(3000, 12, 2)
    np.testing.assert_allclose((draw**2).mean(axis=(0, 2)), 5.0, rtol=0.1)
    for lag in (1, 3, 6):
        product = np.mean(draw[:, lag:] * draw[:, :-lag])
        assert product == pytest.approx(4.0 * np.exp(-lag / 3.0), abs=0.12)
    assert np.mean(draw[:, :, 0] * draw[:, :, 1]) == pytest.approx(0.0, abs=0.1)
    assert np.mean(draw[1:] * draw[:-1]) == pytest.approx(0.0, abs=0.1)  # other flights
    draw = draw_noise(frame, replace(noise, along=0.6, across=1.28), rng=np.random.default_rng(1))
    along = np.stack([np.sin(frame.heading), np.cos(frame.heading)], -1)
    across = np.stack([along[:, 1], -along[:, 0]], -1)
    for direction, factor in ((along, 0.6), (across, 1.28)):
        scaled, before = ((error * direction).sum(axis=1) for error in (draw, isotropic))
        np.testing.assert_allclose(scaled, factor * before, atol=1e-12)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_simulated_archive_is_read_back_with_the_winds_sent(tmp_path, suffix):
    headings = frames.headings_dataset(flights=4)
    headings["eastward_wind"][7] = np.nan  # a report without a wind is kept
    table = simulate_reports(headings, reference="ruc", effects=STRONG, noise=NOISE, seed=3)
    again = read_reports(write_reports(table, tmp_path / f"sent{suffix}"))
    assert again.sizes["report"] == headings.sizes["report"]
    np.testing.assert_array_equal(again.aircraft.values.astype(str), list(frames.TAILS))
    np.testing.assert_array_equal(again.time.values, headings.time.values)
    np.testing.assert_allclose(again.latitude, headings.latitude, atol=1e-6)
    np.testing.assert_allclose(again.pressure, headings.pressure, rtol=1e-4)
    np.testing.assert_array_equal(again.phase, headings.phase)
    np.testing.assert_array_equal(again.icing, headings.icing)
    frame = frames.Frame.from_headings(headings, reference="ruc")
    sent = simulate(frame, effects=STRONG, noise=NOISE, coding=Coding.of_archive(frame), seed=3)
    np.testing.assert_allclose(again.eastward_wind.values[sent.report], sent.u_rep, atol=1e-4)
    np.testing.assert_allclose(again.northward_wind.values[sent.report], sent.v_rep, atol=1e-4)
    assert np.isnan(again.eastward_wind.values[7])
    assert np.isfinite(again.eastward_wind).sum() == headings.sizes["report"] - 1
    np.testing.assert_allclose(again.wind_speed_resolution, KNOT, rtol=1e-3)
    np.testing.assert_allclose(again.wind_direction_resolution, 1.0, rtol=1e-3)


def test_airspeed_and_heading_are_written_where_the_archive_has_them():
    headings = frames.headings_dataset(flights=2)
    assert "heading_deg" not in simulate_reports(headings, reference="ruc")
    headings["reported_heading"] = headings.heading.where(headings.phase == 2)
    headings["reported_airspeed"] = headings.airspeed
    effect = [ActiveEffect("compass_offset", {"offset_deg": 2.0})]
    table = simulate_reports(headings, reference="ruc", effects=effect)
    turned = (table["heading_deg"] - headings.heading.values + 180.0) % 360.0 - 180.0
    cruise = headings.phase.values == 2
    assert table["heading_deg"].notna().to_numpy().tolist() == cruise.tolist()
    np.testing.assert_allclose(turned[cruise], 2.0, atol=0.5)  # wind coded in whole knots
    np.testing.assert_allclose(table["true_airspeed_kt"] * KNOT, headings.airspeed, atol=0.5)


def test_other_suffixes_and_closed_folders_are_refused(tmp_path):
    table = pd.DataFrame({"tail": ["N1"], "time": [np.datetime64("2009-07-01", "ms")]})
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        write_reports(table, tmp_path / "sent.xlsx")
    with pytest.raises(InputError, match="found: no suffix"):
        simulation(None, None, tmp_path / "sent")  # refused before the archive is touched
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        write_reports(table, tmp_path / "file" / "sent.csv")


START = frames.START.astype("datetime64[s]").astype(float)


def table(component, variable, edges, values, tails=None):
    """Return a table over one variable as an effect."""
    parameters = {"component": component, "variables": [variable], "edges": [edges]}
    return ActiveEffect("empirical", parameters | {"values": values}, tails)


ONE = {
    "sensors": [
        ActiveEffect("hard_iron", {"amplitude_deg": 6.0, "phase_deg": 50.0}, ("N401",)),
        ActiveEffect("soft_iron", {"amplitude_deg": 2.0, "phase_deg": -20.0}),
        ActiveEffect("tas_scale", {"scale_percent": 4.0}, ("N401", "N402")),
        ActiveEffect("compass_step", {"offset_deg": 3.0}, ("N403",), (START + 9 * 86400.0, None)),
    ],
    "reference": [ActiveEffect("reference_speed_bias", {"bias_percent": 8.0, "above_hPa": 600.0})],
    "tables": [
        table("across_heading", "latitude", [30.0, 41.0, 60.0], [0.0, 2.5], ("N401", "N402")),
        table("wind_factor", "hour", [0.0, 6.0, 12.0, 24.0], [8.0, 0.0, -5.0]),
        table("along_heading", "airspeed", [40.0, 120.0, 300.0], [-1.0, 1.5], ("N403",)),
        ActiveEffect("hard_iron", {"amplitude_deg": 6.0, "phase_deg": 50.0}, ("N401",)),
    ],
    "height": [ActiveEffect("altitude_offset", {"offset_ft": 400.0}, ("N402",))],
}


@pytest.mark.parametrize("name", ONE)
def test_simulated_effects_are_removed_to_rounding(name):
    perfect = frames.frame()
    sent = simulate(perfect, effects=ONE[name])
    assert np.hypot(*sent.residual.T).max() > 0.2
    removed = remove_effects(sent, ONE[name])
    assert np.hypot(*removed.residual.T).max() < 2e-6
    turned = np.angle(np.exp(1j * (removed.heading - perfect.heading)))
    if name in ("sensors", "tables"):
        assert np.abs(turned).max() < 1e-7
        assert removed.airspeed == pytest.approx(perfect.airspeed, abs=1e-5)


def test_exchanged_identifiers_are_exchanged_back():
    perfect = frames.frame()
    pair, date = ["N401", "N402"], START + 9 * 86400.0
    swap = ActiveEffect("tail_swap", {"pair": pair}, tuple(pair), (date, None))
    removed = remove_effects(perfect, [swap])
    late = perfect.time >= date
    exchanged = np.array([1, 0, 2])[perfect.aircraft]
    assert (removed.aircraft == np.where(late, exchanged, perfect.aircraft)).all()
    assert removed.u_rep == pytest.approx(perfect.u_rep, abs=1e-12)


def fits(status=STATUS["ok"]):
    values = np.array([[[1.5, 3.0, 4.0, 0.5, 0.0], [0.7, 1.0, 0.0, 0.0, 0.0]]])
    two = np.array([[0, status]], np.int8)
    return xr.Dataset(
        {
            "deviation": (("reference", "aircraft", "coefficient"), values),
            "airspeed_scale": (("reference", "aircraft"), np.array([[0.01, np.nan]])),
            "mean_horizontal_field": (("reference", "aircraft"), np.array([[18000.0, 19000.0]])),
            "status": (("reference", "aircraft"), two),
        },
        coords={"reference": ["ruc"], "aircraft": ["N401", "N402"], "coefficient": list("ABCDE")},
    )


def test_effects_of_a_fitted_curve_by_hand():
    effects = effects_of_fits(fits(), reference="ruc")
    names = [(effect.name, effect.tails) for effect in effects]
    assert names == [
        ("compass_offset", ("N401",)),
        ("hard_iron", ("N401",)),
        ("soft_iron", ("N401",)),
        ("tas_scale", ("N401",)),
        ("compass_offset", ("N402",)),
        ("hard_iron", ("N402",)),
    ]
    iron = effects[1].parameters
    # 3 sin m + 4 cos m = 5 sin(m + atan2(4, 3))
    assert iron["amplitude_deg"] == pytest.approx(5.0)
    assert iron["phase_deg"] == pytest.approx(np.degrees(np.arctan2(4, 3)))
    assert iron["at_horizontal_field_nT"] == 18000.0
    assert effects[3].parameters["scale_percent"] == pytest.approx(1.0)


def test_errors_for_files_without_known_effects(tmp_path):
    with pytest.raises(InputError, match="no file of known effects"):
        read_known(tmp_path / "nothing.yaml", reference="ruc")
    with pytest.raises(InputError, match=r"no fit against the gap's reference.*fitted were ruc"):
        effects_of_fits(fits(), reference="rtfdaa", file=tmp_path / "fits.nc")
    write_product(xr.Dataset({"latitude": ("report", [1.0])}), tmp_path / "other.nc", title="x")
    with pytest.raises(InputError, match="holds no fitted deviations"):
        read_known(tmp_path / "other.nc", reference="ruc")
    unknown = [ActiveEffect("hard_iron", {"amplitude_deg": 1.0}, ("N999",))]
    write_effects(unknown, tmp_path / "effects.yaml")
    with pytest.raises(InputError, match="unknown aircraft"):
        remove_effects(frames.frame(), read_known(tmp_path / "effects.yaml", reference="ruc"))


def stronger(**changes):
    """Reports on the paths of the archive, with eastward winds 1 m/s stronger."""
    ds = frames.headings_dataset()
    return ds.assign(eastward_wind=ds.eastward_wind + 1.0, **changes)


def test_the_same_paths_match_report_by_report():
    frame = frames.frame()
    ds = stronger()
    minutes = ds.time.values.astype("datetime64[m]").astype("datetime64[ns]")
    for reports in (ds.assign(time=("report", minutes)), ds):
        matched = match_reports(frame, reports)
        assert matched.found.all() and matched.same_paths
        assert matched.u == pytest.approx(frame.u_rep + 1.0)
    against = with_simulated_wind(frame, matched)
    assert against.residual[:, 0] == pytest.approx(np.full(frame.size, -1.0))


def test_other_places_times_and_aircraft_do_not_match_and_are_left_out():
    frame = frames.frame()
    ds = stronger()
    displaced = match_reports(frame, ds.assign(latitude=ds.latitude + 0.1))
    later = match_reports(frame, ds.assign(time=ds.time + np.timedelta64(61, "s")))
    renamed = match_reports(frame, ds.assign_coords(aircraft=["N901", "N402", "N403"]))
    assert not displaced.found.any() and not later.found.any()
    assert (renamed.found == (frame.aircraft != 0)).all()
    with pytest.raises(InputError, match="no simulated report is of an aircraft and time"):
        with_simulated_wind(frame, displaced)
    late = ds.time > ds.time.quantile(0.6)
    matched = match_reports(frame, ds.assign(eastward_wind=ds.eastward_wind.where(late)))
    assert not matched.same_paths  # half of them have no wind
    assert with_simulated_wind(frame, matched).size == matched.found.sum()
    few = frame.take(np.arange(150))
    assert not match_reports(few, ds).same_paths  # all match, but 150 are too few
