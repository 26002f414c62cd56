"""One constant an aircraft where headings or flights do not allow a curve."""

import numpy as np
import pytest
from tests.compass.flown import Setting, fly

from airswing.compass.correction import add_tables, correct, curve_standard_error, write_tables_csv
from airswing.compass.fit.deviation import fit_deviation
from airswing.flags import CORRECTION, STATUS, published
from airswing.gap.simulation.effects_file import effects_of_fits

FLEET = Setting(aircraft=10, days=40, flights_a_day=4)
ONE_HOUR = Setting(
    aircraft=30, days=1, flights_a_day=1, reports_a_flight=300, legs=1, bias=(0.2, 0.1)
)


def on_one_octant(setting, seed, aircraft):
    """A fleet of constant deviations, some of them left with the headings of one octant."""
    deviation = np.zeros((setting.aircraft, 5))
    deviation[:, 0] = np.random.default_rng([seed, 1]).normal(0, 1, setting.aircraft)
    headings, _ = fly(deviation, setting, seed)
    heading = headings["heading"].to_numpy().reshape(setting.aircraft, -1)
    off = np.abs((heading - heading[:, :1] + 180) % 360 - 180) > 22.5
    off &= np.isin(np.arange(setting.aircraft), aircraft)[:, None]
    headings["screening"] = ("report", np.where(off.ravel(), 8, 0).astype(np.int32))
    return headings, deviation[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "alone", "seeds", "least", "most"),
    [
        # together with aircraft with curves: their bias and its scatter are those of the simulation
        pytest.param(FLEET, range(6, 10), 20, 0.90, 0.995, id="with_curves"),
        # without: airspeed sensors' errors are taken for the reference's, the interval is wide
        pytest.param(FLEET, range(10), 8, 0.95, 1.0, id="no_curve_in_the_fleet"),
        pytest.param(ONE_HOUR, range(30), 12, 0.90, 1.0, id="one_flight_each"),
    ],
)
def test_intervals_hold_the_truth(setting, alone, seeds, least, most):
    z = []
    for seed in range(seeds):
        headings, truth = on_one_octant(setting, seed, list(alone))
        fits = fit_deviation(headings, min_reports=100).isel(reference=0, aircraft=list(alone))
        only = fits["status"].to_numpy() == STATUS["offset_only"]
        apart = fits["offset"].to_numpy() - truth[list(alone)]
        z.append((apart / fits["offset_standard_error"].to_numpy())[only])
    inside = np.abs(np.concatenate(z)) < 1.96
    assert inside.size >= 60
    assert least <= inside.mean() <= most


@pytest.fixture(scope="module")
def fleet():
    headings, truth = on_one_octant(FLEET, 3, [8, 9])
    return headings, truth, add_tables(fit_deviation(headings), headings)


def test_two_hundred_reports_in_one_octant_are_an_offset_never_an_amplitude(fleet):
    _, truth, fits = fleet
    one = fits.isel(reference=0, aircraft=9)
    assert int(one["status"]) == STATUS["offset_only"]
    assert int(one["compass_points"]) <= 3
    assert int(one["report_count"]) >= 200
    error = float(one["offset_standard_error"])
    assert float(one["offset"]) == pytest.approx(truth[9], abs=3 * error)
    for name in ("amplitude", "phase", "airspeed_scale", "amplitude_standard_error"):
        assert np.isnan(one[name])
    assert int(one["harmonics"]) == 0
    table = one["table_correction"].to_numpy()
    assert np.ptp(table) == 0
    assert table[0] == pytest.approx(-float(one["offset"]), abs=0.051)
    # on the headings flown the constant is known as well as stated, on others it is not
    last = slice(-int(fleet[0]["row_size"][9]), None)
    flown = fleet[0]["heading"][last].where(fleet[0]["screening"][last] == 0, drop=True).to_numpy()
    wide = curve_standard_error(one["deviation_covariance"].to_numpy(), flown)
    assert np.median(wide) == pytest.approx(error, rel=0.02)
    away = curve_standard_error(one["deviation_covariance"].to_numpy(), flown + 180.0)
    assert (away > 1.1 * error).all()


def test_corrections_tables_and_the_simulation_use_the_offset(fleet, tmp_path):
    headings, _, fits = fleet
    name = str(fits["aircraft"].to_numpy()[9])
    corrected = correct(headings, fits, apply_airspeed_scale=True)
    last = slice(-int(headings["row_size"][9]), None)
    applied = corrected["correction_applied"].to_numpy()
    assert (applied[last] == CORRECTION["offset_only"]).all()
    curve = np.repeat(fits["status"].to_numpy()[0] == STATUS["ok"], headings["row_size"])
    assert (applied[curve] != CORRECTION["offset_only"]).all()
    turned = corrected["corrected_heading"] - headings["heading"]
    expected = float(fits["table_correction"][0, 9, 0])
    turn = (turned.to_numpy()[last] - expected + 180) % 360 - 180
    assert np.abs(turn).max() < 1e-3
    assert np.isfinite(corrected["corrected_eastward_wind"].to_numpy()[last]).all()
    rows = write_tables_csv(fits, tmp_path / "tables.csv").read_text().splitlines()
    mine = [row.split(",") for row in rows if row.startswith(name)]
    assert len(mine) == 8 and {row[2] for row in mine} == {"offset_only"}
    stated = [float(row[5]) for row in mine]
    assert min(stated) >= float(fits["offset_standard_error"][0, 9]) - 0.001
    effects = effects_of_fits(fits, reference=str(fits["reference"].item()))
    assert [one.name for one in effects if one.tails == (name,)] == ["compass_offset"]


def test_the_refusal_names_the_limit_that_refused():
    few = Setting(aircraft=2, days=1, flights_a_day=4, reports_a_flight=60)
    headings, _ = on_one_octant(few, 1, [])
    fits = fit_deviation(headings, min_reports=200)
    # four flights of sixty reports; no other aircraft shows the reference error of a flight
    assert fits["status"].to_numpy().tolist() == [[STATUS["too_few_flights"]] * 2]
    assert fit_deviation(headings, min_reports=1000)["status"].to_numpy().tolist() == [
        [STATUS["too_few_reports"]] * 2
    ]
    assert not published(fits["status"]).any()


def test_a_compass_that_changed_has_no_offset():
    headings, _ = on_one_octant(FLEET, 5, list(range(10)))
    half = headings["time"] > headings["time"].quantile(0.5)
    moved = headings["heading_error"] + 6.0 * half
    fits = fit_deviation(headings.assign(heading_error=moved))
    found = fits["status"].to_numpy()[0]
    enough = fits["report_count"].to_numpy()[0] >= 200
    assert enough.sum() >= 6
    assert (found[enough] == STATUS["unstable_fit"]).all()
