import numpy as np
import pytest
import xarray as xr
from tests.compass.flown import Setting, fleet_deviations, fly

from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.flags import STATUS

NO_ERROR = {"day_error": 0.0, "flight_error": 0.0, "ground_error": 0.0, "bias_spread": 0.0}
QUIET = Setting(aircraft=1, days=20, noise=1e-3, **NO_ERROR)


def errors_of(fits):
    return np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=-2, axis2=-1))


def test_exact_for_ten_degrees_with_bias_and_scale():
    truth = [2.0, 8.0, -6.0, 1.5, -1.0]
    headings, made = fly([truth], QUIET, 1)
    fits = fit_deviation(headings)
    assert fits["deviation"].to_numpy()[0, 0] == pytest.approx(truth, abs=1e-3)
    assert fits["airspeed_scale"].item() == pytest.approx(made["scale"][0], abs=1e-5)
    assert fits["reference_bias"].to_numpy()[0] == pytest.approx(made["bias"][0, 0], abs=1e-3)
    assert fits["harmonics"].item() == 2


@pytest.mark.parametrize("fleets", [8, pytest.param(30, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shared_error", [False, True])
def test_coverage_and_bias_over_fleets(shared_error, fleets):
    """The whole of it (200 fleets) is benchmarks/coverage.py."""
    z, apart = [], []
    for seed in range(fleets):
        deviation = fleet_deviations(5, np.random.default_rng([seed, 9]))
        headings, _ = fly(deviation, Setting(aircraft=5, days=30, outliers=0.01), 500 + seed)
        fits = fit_deviation(headings, shared_error=shared_error)
        apart.append(fits["deviation"].to_numpy()[0] - deviation)
        z.append(apart[-1] / errors_of(fits)[0])
    z, apart = np.concatenate(z), np.concatenate(apart)
    assert np.isfinite(z).all(axis=1).mean() > 0.97
    inside = np.nanmean(np.abs(z) < 1.96)
    assert 0.92 < inside < (0.98 if fleets > 10 else 0.995)
    # the mean of n aircraft with errors of 0.1 degree
    assert np.all(np.abs(np.nanmean(apart, axis=0)[1:3]) < 0.4 / np.sqrt(len(apart)))


def test_model_bias_spoils_the_heading_error_alone_but_not_the_joint_fit():
    deviation = np.tile([0.5, 2.0, -1.2, 0.0, 0.0], (8, 1))
    setting = Setting(aircraft=8, days=60, bias=(0.6, -0.5), bias_spread=0.0, day_error=0.0)
    headings, _ = fly(deviation, setting, 2)
    joint = fit_deviation(headings)["deviation"].to_numpy()[0].mean(axis=0)
    alone = fit_deviation(headings, joint=False)["deviation"].to_numpy()[0].mean(axis=0)
    assert np.abs(joint[1:3] - [2.0, -1.2]).max() < 0.06
    # b / V = 0.6 / 110 and 0.5 / 110 rad, as the heading error sees them
    assert alone[1] - 2.0 == pytest.approx(np.degrees(0.5 / 110), abs=0.08)
    assert abs(alone[2] + 1.2) == pytest.approx(np.degrees(0.6 / 110), abs=0.08)


def test_nga_swing_gives_its_published_a():
    # NGA Handbook of Magnetic Compass Adjustment: easterly positive, N NE E SE S SW W NW
    card = np.array([10.5, 20.0, 11.5, -1.2, -5.5, -8.0, -12.5, -6.8])
    points = np.arange(0, 360, 45.0)
    ds, _ = fly([[0.0] * 5], Setting(aircraft=1, days=15, flights_a_day=4, reports_a_flight=8), 0)
    noise = np.random.default_rng(0).normal(0, 0.01, ds.sizes["report"])
    heading = ("report", np.tile(points, 60))
    error = np.tile(-card, 60) + noise  # psi_err = compass - magnetic
    ds = ds.assign(heading=heading, magnetic_heading=heading)
    ds["heading_error"][0] = error
    fits = fit_deviation(ds, joint=False)
    expected_b = -np.mean(card * np.sin(np.radians(points))) * 2
    got = fits["deviation"].to_numpy()[0, 0]
    assert got[0] == pytest.approx(-card.mean(), abs=0.02)
    assert card.mean() == pytest.approx(1.0, abs=1e-9)
    assert got[1] == pytest.approx(expected_b, abs=0.02)


def test_gross_errors_move_nothing_much():
    deviation = fleet_deviations(2, np.random.default_rng(5))
    clean = fly(deviation, Setting(aircraft=2, days=30), 4)[0]
    dirty = fly(deviation, Setting(aircraft=2, days=30, outliers=0.05), 4)[0]
    one, two = (fit_deviation(ds)["deviation"].to_numpy() for ds in (clean, dirty))
    assert np.abs(one - two).max() < 0.06


def test_pool_fits_members_together_and_covers():
    deviation = fleet_deviations(4, np.random.default_rng(3))
    headings, truth = fly(deviation, Setting(aircraft=4, days=30, references=2), 12)
    fits = fit_deviation(headings, pools={"both": ["ruc", "rtfdaa"]})
    assert fits["reference"].to_numpy().tolist() == ["ruc", "rtfdaa", "both"]
    error = errors_of(fits)[:, :, :3]
    assert np.all(error[2] < np.maximum(error[0], error[1]))
    assert np.abs(fits["deviation"].to_numpy()[2] - deviation).max() < 0.5
    assert fits["reference_bias"].to_numpy()[2] == pytest.approx(
        truth["bias"].mean(axis=(0, 1)), abs=0.6
    )
    with pytest.raises(InputError, match="nam"):
        fit_deviation(headings, pools={"bad": ["ruc", "nam"]})
    with pytest.raises(InputError, match="airspeed_error"):
        fit_deviation(headings.drop_vars("airspeed_error"))


def test_cycles_by_evidence():
    none = np.array([[1.0, 4.0, -2.0, 0.0, 0.0]] * 8)
    headings, _ = fly(none, Setting(aircraft=8, days=30), 6)
    fits = fit_deviation(headings)
    one = fits["harmonics"].to_numpy()[0] == 1
    assert one.sum() >= 7
    assert np.all(fits["deviation"].to_numpy()[0][one][:, 3:] == 0)
    assert np.all(errors_of(fits)[0][:, 3:] > 0)  # a small second cycle is not ruled out
    forced = fit_deviation(headings, harmonics=2)["deviation"].to_numpy()[0]
    assert np.all(forced[:, 3:] != 0)
    single = fit_deviation(headings, harmonics=1)
    assert np.all(single["harmonics"] == 1)
    assert np.all(errors_of(single)[0][:, 3:] == 0)


def test_status_gives_the_reason():
    deviation = np.array([[1.0, 3, 0, 0, 0]] * 4)
    headings, _ = fly(deviation, Setting(aircraft=4, days=20), 7)
    screening = headings["screening"].to_numpy().copy().reshape(4, -1)
    m = headings["magnetic_heading"].to_numpy().reshape(4, -1)
    screening[0, 150:] = 1
    screening[1][(m[1] > 100) & (m[1] < 330)] = 1
    screening[2, :] = 1
    headings["screening"] = ("report", screening.reshape(-1))
    fits = fit_deviation(headings)
    assert fits["status"].to_numpy()[0].tolist() == [
        STATUS["too_few_reports"],
        STATUS["offset_only"],
        STATUS["too_few_reports"],
        STATUS["ok"],
    ]
    refused = fits["deviation"].to_numpy()[0, [0, 2]]
    assert np.isnan(refused).all()
    assert np.isfinite(fits["deviation"].to_numpy()[0, 3]).all()
    assert fits["report_count"].to_numpy()[0].tolist()[:3] == [
        150,
        int((screening[1] == 0).sum()),
        0,
    ]
    assert fits["compass_points"].to_numpy()[0, 3] == 8


def test_b_and_c_are_those_at_the_mean_horizontal_field():
    # the same iron in a field of 16 and of 24 microtesla; what is published is at their mean
    parts = []
    for part, field in enumerate((16000.0, 24000.0)):
        iron = np.array([[0.5, 4.0 * 2e4 / field, -2.0 * 2e4 / field, 0, 0]])
        flown, _ = fly(iron, Setting(aircraft=1, days=30), 31 + part)
        flown["time"] = flown["time"] + part * np.timedelta64(40, "D")
        flown["flight"] = flown["flight"] + part * 1000
        flown["horizontal_field"] = ("report", np.full(flown.sizes["report"], field))
        parts.append(flown.drop_vars("row_size"))
    both = xr.concat(parts, "report", data_vars="minimal", coords="minimal", compat="override")
    both["row_size"] = ("aircraft", [both.sizes["report"]])
    fits = fit_deviation(both)
    assert np.abs(fits["deviation"].to_numpy()[0, 0] - [0.5, 4.0, -2.0, 0, 0]).max() < 0.3
    assert fits["mean_horizontal_field"].item() == pytest.approx(20000.0)
    both["screening"][: both.sizes["report"] // 4] = 1
    # a third of 16,000 and two thirds of 24,000: screened reports do not count
    part = fit_deviation(both)["mean_horizontal_field"].item()
    assert part == pytest.approx(16000 / 3 + 2 * 24000 / 3)
    both["screening"][:] = 0
    # unaware of the field, the fit takes the compass for one that has changed
    unaware = fit_deviation(both.drop_vars("horizontal_field"))
    assert unaware["status"].item() == STATUS["unstable_fit"]
    assert np.isnan(unaware["deviation"]).all()
    assert np.isnan(unaware["mean_horizontal_field"].item())


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_fit_that_diverges_is_refused():
    """Of 40 aircraft with two flights on a heading each, the fit of the fourth runs away."""
    few = Setting(aircraft=40, days=1, flights_a_day=2, reports_a_flight=14, legs=1)
    headings, _ = fly(fleet_deviations(40, np.random.default_rng(7)), few, 7)
    assert set(fit_deviation(headings)["status"].to_numpy().ravel()) == {STATUS["too_few_reports"]}
