from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.stats import t
from tests.compass.flown import Setting, fleet_deviations, fly, wrap

import airswing  # noqa: F401
from airswing.compass.fit.acceptance import (
    choice_covariance,
    condition_number,
    halves_apart,
    one_cycle_map,
    sinusoid,
)
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.fit.pooled_bias import day_ratio
from airswing.compass.fit.sandwich import t_inflation
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.products.ragged import aircraft_of_report

QUIET = Setting(
    aircraft=1,
    days=20,
    day_error=0.0,
    flight_error=0.0,
    noise=1e-3,
    ground_error=0.0,
    bias_spread=0.0,
)
SMALL = Setting(aircraft=4, days=30)


@pytest.fixture(scope="module")
def fleet():
    deviation = fleet_deviations(4, np.random.default_rng(3))
    headings, truth = fly(deviation, SMALL, 11)
    return headings, truth, fit_deviation(headings)


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


def test_intervals_hold_the_truth(fleet):
    _, truth, fits = fleet
    z = (fits["deviation"].to_numpy()[0] - truth["deviation"]) / errors_of(fits)[0]
    assert np.abs(z).max() < 4
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.6
    scale = fits["airspeed_scale"].to_numpy()[0] - truth["scale"]
    assert np.all(np.abs(scale) < 4 * fits["airspeed_scale_standard_error"].to_numpy()[0])


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
    rng = np.random.default_rng(0)
    heading = np.tile(points, 60)
    flight = np.repeat(np.arange(60), 8)
    error = -np.tile(card, 60)  # psi_err = compass - magnetic
    n = heading.size
    speed = np.full(n, 110.0)
    ds = xr.Dataset(
        {
            "row_size": ("aircraft", [n]),
            "flight": ("report", flight),
            "time": (
                "report",
                np.datetime64("2009-01-01", "ns") + (flight * 24 * 3600).astype("timedelta64[s]"),
            ),
            "latitude": ("report", np.full(n, 50.0)),
            "longitude": ("report", np.full(n, -30.0)),
            "pressure": ("report", np.full(n, 1e5)),
            "heading": ("report", heading),
            "magnetic_heading": ("report", heading),
            "airspeed": ("report", speed),
            "screening": ("report", np.zeros(n, int)),
            "heading_error": (("reference", "report"), [error + rng.normal(0, 0.01, n)]),
            "airspeed_error": (("reference", "report"), [rng.normal(0, 0.01, n)]),
            "heading_error_standard_error": (("reference", "report"), np.full((1, n), 0.1)),
        },
        coords={"aircraft": ["ship"], "reference": ["swing"]},
    )
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
    m = np.radians(dirty["magnetic_heading"].to_numpy())
    design = np.stack([np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)], -1)
    error, own = dirty["heading_error"].to_numpy()[0], aircraft_of_report(dirty)
    plain = [np.linalg.lstsq(design[own == a], error[own == a], rcond=None)[0] for a in range(2)]
    assert np.abs(plain - deviation).max() > 0.06  # least squares of the error alone do feel them


def test_pool_fits_members_together_and_covers(fleet):
    deviation = fleet[1]["deviation"]
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


def test_sinusoid_errors_by_hand_and_near_zero():
    value, error = sinusoid(np.array([1.0, 3.0, 4.0]), np.diag([0.04, 0.01, 0.01]))
    assert value == pytest.approx([1, 5, np.degrees(np.arctan2(4, 3))])
    assert error == pytest.approx([0.2, 0.1, np.degrees(0.1 / 5)], rel=1e-3)
    value, error = sinusoid(np.zeros(3), np.diag([0.04, 0.01, 0.09]))
    assert error == pytest.approx([0.2, 0.3, 180 / 1.959964])


def test_small_helpers_by_hand():
    assert t_inflation(np.array([10.0, np.inf])) == pytest.approx(
        [t.ppf(0.975, 10) / 1.959964, 1.0], rel=1e-5
    )
    assert condition_number(np.diag([2.0, 1, 1, 1, 1]), 2) == pytest.approx(1)
    assert condition_number(np.zeros((5, 5)), 2) == np.inf
    one = SimpleNamespace(
        covariance=np.eye(8),
        day_covariance=np.diag([0.5, 3, 1, 1, 1, 1, 4, 2]),
        day_number=np.arange(10),
    )
    ratio = day_ratio([one])
    assert ratio.tolist() == [1, 2, 2, 1, 1, 1, 3, 3]
    influence = np.array([[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0], [-1.0, 0, 0]])
    assert halves_apart(influence, np.arange(4), np.eye(3)) == pytest.approx((8.0, 16.0))
    added = choice_covariance(np.array([0.2, 0, 0, 1.0, 0]), np.eye(5), 4.0)
    assert added[0, 0] == pytest.approx(0.5 * 0.04)
    assert added[3, 3] == pytest.approx(2.0)


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


def test_one_cycle_map_is_the_restricted_least_squares():
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(200, 8)), rng.normal(size=200)
    x[:, 3] += 0.5 * x[:, 1]
    full = np.linalg.lstsq(x, y, rcond=None)[0]
    kept = [0, 1, 2, 5, 6, 7]
    found = one_cycle_map(x.T @ x, np.arange(8)) @ full
    assert found[kept] == pytest.approx(np.linalg.lstsq(x[:, kept], y, rcond=None)[0])
    assert found[[3, 4]].tolist() == [0, 0]


def test_status_says_why():
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


def test_a_changed_compass_is_unstable():
    before, _ = fly([[0, 3, 0, 0, 0]], Setting(aircraft=1, days=20), 8)
    after, _ = fly([[0, -1.0, 2, 0, 0]], Setting(aircraft=1, days=20), 9)
    after["time"] = after["time"] + np.timedelta64(20, "D")
    after["flight"] = after["flight"] + 1000
    both = xr.concat(
        [before.drop_vars("row_size"), after.drop_vars("row_size")],
        dim="report",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
    )
    both["row_size"] = ("aircraft", [both.sizes["report"]])
    fits = fit_deviation(both)
    assert fits["status"].item() == STATUS["unstable_fit"]
    assert np.isnan(fits["deviation"]).all()


def test_rows_in_any_order_give_the_same_fit():
    headings, _ = fly(
        fleet_deviations(1, np.random.default_rng(4)), Setting(aircraft=1, days=15), 13
    )
    order = np.random.default_rng(0).permutation(headings.sizes["report"])
    one, two = fit_deviation(headings), fit_deviation(headings.isel(report=order))
    # another thin sample starts the passes: a few hundredths of a standard error
    assert np.abs(one["deviation"] - two["deviation"]).max() < 0.15 * errors_of(one).min()
    assert np.allclose(errors_of(one), errors_of(two), rtol=0.1)


def test_true_abscissa_smears_where_declination_varies():
    headings, _ = fly([[0, 6, 0, 0, 0]] * 2, Setting(aircraft=2, days=40), 16)
    magnetic, true = (fit_deviation(headings, abscissa=name) for name in ("magnetic", "true"))
    # psi = m + D, D about -3 degrees: the curve against true heading lags by D
    lag = wrap(true["phase"].to_numpy() - magnetic["phase"].to_numpy())
    assert lag == pytest.approx(np.full((1, 2), 3.0), abs=1.0)
    assert np.all(true["residual_rms_after"] > magnetic["residual_rms_after"])


def test_b_and_c_are_those_at_the_mean_horizontal_field():
    # the same iron in a field of 16 and of 24 microtesla; what is published is at their mean
    weak, strong = (
        fly([[0.5, scale * 4.0, scale * -2.0, 0, 0]], Setting(aircraft=1, days=30), seed)[0]
        for scale, seed in ((20 / 16, 31), (20 / 24, 32))
    )
    strong["time"] = strong["time"] + np.timedelta64(40, "D")
    strong["flight"] = strong["flight"] + 1000
    for one, field in ((weak, 16000.0), (strong, 24000.0)):
        one["horizontal_field"] = ("report", np.full(one.sizes["report"], field))
    both = xr.concat(
        [weak.drop_vars("row_size"), strong.drop_vars("row_size")],
        dim="report",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
    )
    both["row_size"] = ("aircraft", [both.sizes["report"]])
    fits = fit_deviation(both)
    assert np.abs(fits["deviation"].to_numpy()[0, 0] - [0.5, 4.0, -2.0, 0, 0]).max() < 0.3
    assert fits["mean_horizontal_field"].item() == pytest.approx(20000.0)
    both["screening"][: weak.sizes["report"] // 2] = 1
    # a third of 16,000 and two thirds of 24,000: screened reports do not count
    part = fit_deviation(both)["mean_horizontal_field"].item()
    assert part == pytest.approx(16000 / 3 + 2 * 24000 / 3)
    both["screening"][:] = 0
    # unaware of the field, the fit takes the compass for one that has changed
    unaware = fit_deviation(both.drop_vars("horizontal_field"))
    assert unaware["status"].item() == STATUS["unstable_fit"]
    assert np.isnan(unaware["mean_horizontal_field"].item())


def test_missing_variable_is_named(fleet):
    with pytest.raises(InputError, match="airspeed_error"):
        fit_deviation(fleet[0].drop_vars("airspeed_error"))


def test_nan_reports_do_not_count(fleet):
    headings = fleet[0].copy(deep=True)
    headings["heading_error"][0, :100] = np.nan
    fits = fit_deviation(headings)
    assert fits["report_count"][0, 0] == fleet[2]["report_count"][0, 0] - 100
    assert np.isfinite(fits["deviation"]).all()


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_curve_that_left_all_reports_behind_is_none():
    """Of 40 aircraft with two flights on a heading each, the fit of the fourth runs away."""
    few = Setting(aircraft=40, days=1, flights_a_day=2, reports_a_flight=14, legs=1)
    headings, _ = fly(fleet_deviations(40, np.random.default_rng(7)), few, 7)
    assert set(fit_deviation(headings)["status"].to_numpy().ravel()) == {STATUS["too_few_reports"]}


@pytest.mark.slow
def test_coarse_positions_and_times_do_not_bend_the_curve():
    # noise of the ground vector (0.1' positions; clock to the minute: tens of m/s along track)
    # is common to both air vectors: no bias, a dilution of exp(-sigma^2 / 2) at the most
    deviation = np.array([[1.0, 5.0, -4.0, 0.0, 0.0]] * 6)
    for ground_error, allowed in ((0.3, 0.06), (8.0, 0.15)):
        setting = Setting(aircraft=6, days=60, ground_error=ground_error)
        # one fleet's mean has a standard error of 0.035 degrees, its days being shared: take three
        runs = [fit_deviation(fly(deviation, setting, seed)[0]) for seed in (15, 16, 17)]
        mean = np.mean([fits["deviation"].to_numpy()[0] for fits in runs], axis=(0, 1))
        assert np.abs(mean - deviation[0]).max() < allowed
