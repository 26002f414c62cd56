"""Deviations, their errors and status; offsets where no curve can be fitted."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import least_squares
from tests.compass.flown import NO_ERROR, Setting, curve, fleet_deviations, fly, wrap

from airswing.compass.correction import add_tables, correct, curve_standard_error, write_tables_csv
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.flags import CORRECTION, STATUS, published
from airswing.gap.simulation.effects_file import effects_of_fits
from airswing.products.ragged import some_reports


def errors_of(fits):
    return np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=-2, axis2=-1))


def test_exact_for_ten_degrees_with_bias_and_scale():
    truth = [2.0, 8.0, -6.0, 1.5, -1.0]
    headings, simulated = fly([truth], Setting(aircraft=1, days=20, noise=1e-3, **NO_ERROR), 1)
    fits = fit_deviation(headings)
    assert fits["deviation"].to_numpy()[0, 0] == pytest.approx(truth, abs=1e-3)
    assert fits["airspeed_scale"].item() == pytest.approx(simulated["scale"][0], abs=1e-5)
    assert fits["reference_bias"].to_numpy()[0] == pytest.approx(simulated["bias"][0, 0], abs=1e-3)
    assert fits["harmonics"].item() == 2


@pytest.mark.parametrize("fleets", [8, pytest.param(30, marks=pytest.mark.slow)])
@pytest.mark.parametrize("shared_error", [False, True])
def test_coverage_and_bias_over_fleets(shared_error, fleets):
    """``benchmarks/coverage.py`` runs 200 fleets."""
    z, errors = [], []
    for seed in range(fleets):
        deviation = fleet_deviations(5, np.random.default_rng([seed, 9]))
        headings, _ = fly(deviation, Setting(aircraft=5, days=30, outliers=0.01), 500 + seed)
        fits = fit_deviation(headings, shared_error=shared_error)
        errors.append(fits["deviation"].to_numpy()[0] - deviation)
        z.append(errors[-1] / errors_of(fits)[0])
    z, errors = np.concatenate(z), np.concatenate(errors)
    assert np.isfinite(z).all(axis=1).mean() > 0.97
    inside = np.nanmean(np.abs(z) < 1.96)
    assert 0.92 < inside < (0.98 if fleets > 10 else 0.995)
    # the mean of n aircraft with errors of 0.1 degree
    assert np.all(np.abs(np.nanmean(errors, axis=0)[1:3]) < 0.4 / np.sqrt(len(errors)))


def test_model_bias_spoils_the_heading_error_alone_but_not_the_joint_fit():
    deviation = np.tile([0.5, 2.0, -1.2, 0.0, 0.0], (8, 1))
    setting = Setting(aircraft=8, days=60, bias=(0.6, -0.5), bias_spread=0.0, day_error=0.0)
    headings, _ = fly(deviation, setting, 2)
    joint = fit_deviation(headings)["deviation"].to_numpy()[0].mean(axis=0)
    heading_only = fit_deviation(headings, joint=False)["deviation"].to_numpy()[0].mean(axis=0)
    assert np.abs(joint[1:3] - [2.0, -1.2]).max() < 0.06
    # b / V = 0.6 / 110 and 0.5 / 110 rad, as the heading error sees them
    assert heading_only[1] - 2.0 == pytest.approx(np.degrees(0.5 / 110), abs=0.08)
    assert abs(heading_only[2] + 1.2) == pytest.approx(np.degrees(0.6 / 110), abs=0.08)


def test_nga_swing_gives_its_published_a():
    # NGA Handbook of Magnetic Compass Adjustment: easterly positive, N NE E SE S SW W NW; A is 1.0
    card = np.array([10.5, 20.0, 11.5, -1.2, -5.5, -8.0, -12.5, -6.8])
    points = np.arange(0, 360, 45.0)
    ds, _ = fly([[0.0] * 5], Setting(aircraft=1, days=15, flights_a_day=4, reports_a_flight=8), 0)
    noise = np.random.default_rng(0).normal(0, 0.01, ds.sizes["report"])
    heading = ("report", np.tile(points, 60))
    ds = ds.assign(heading=heading, magnetic_heading=heading)
    ds["heading_error"][0] = np.tile(-card, 60) + noise  # compass less magnetic
    coefficients = fit_deviation(ds, joint=False)["deviation"].to_numpy()[0, 0]
    b = -np.mean(card * np.sin(np.radians(points))) * 2
    assert coefficients[:2] == pytest.approx([-1.0, b], abs=0.02)


def test_gross_errors_hardly_change_the_coefficients():
    deviation = fleet_deviations(2, np.random.default_rng(5))
    clean = fly(deviation, Setting(aircraft=2, days=30), 4)[0]
    dirty = fly(deviation, Setting(aircraft=2, days=30, outliers=0.05), 4)[0]
    clean_fit, dirty_fit = (fit_deviation(ds)["deviation"].to_numpy() for ds in (clean, dirty))
    assert np.abs(clean_fit - dirty_fit).max() < 0.06


def test_pool_fits_members_together_and_covers():
    deviation = fleet_deviations(4, np.random.default_rng(3))
    headings, truth = fly(deviation, Setting(aircraft=4, days=30, references=2), 12)
    fits = fit_deviation(headings, pools={"both": ["ruc", "rtfdaa"]})
    assert fits["reference"].to_numpy().tolist() == ["ruc", "rtfdaa", "both"]
    error, pooled = errors_of(fits)[:, :, :3], fits.isel(reference=2)
    assert np.all(error[2] < np.maximum(error[0], error[1]))
    assert np.abs(pooled["deviation"].to_numpy() - deviation).max() < 0.5
    bias = truth["bias"].mean(axis=(0, 1))
    assert pooled["reference_bias"].to_numpy() == pytest.approx(bias, abs=0.6)
    with pytest.raises(InputError, match="nam"):
        fit_deviation(headings, pools={"bad": ["ruc", "nam"]})
    with pytest.raises(InputError, match="airspeed_error"):
        fit_deviation(headings.drop_vars("airspeed_error"))


def test_the_number_of_cycles_follows_the_evidence():
    headings, _ = fly([[1.0, 4.0, -2.0, 0.0, 0.0]] * 8, Setting(aircraft=8, days=30), 6)
    fits = fit_deviation(headings)
    one_cycle = fits["harmonics"].to_numpy()[0] == 1
    assert one_cycle.sum() >= 7
    assert np.all(fits["deviation"].to_numpy()[0][one_cycle][:, 3:] == 0)
    assert np.all(errors_of(fits)[0][:, 3:] > 0)  # a small second cycle is not ruled out
    forced = fit_deviation(headings, harmonics=2)["deviation"].to_numpy()[0]
    assert np.all(forced[:, 3:] != 0)
    single = fit_deviation(headings, harmonics=1)
    assert np.all(single["harmonics"] == 1)
    assert np.all(errors_of(single)[0][:, 3:] == 0)


def test_status_gives_the_reason():
    headings, _ = fly([[1.0, 3, 0, 0, 0]] * 4, Setting(aircraft=4, days=20), 7)
    m = headings["magnetic_heading"].to_numpy().reshape(4, -1)
    screening = np.zeros(m.shape, np.int32)
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
    assert np.isfinite(fits["deviation"].to_numpy()[0]).all(axis=1).tolist() == [0, 1, 0, 1]
    accepted = (screening == 0).sum(axis=1)
    assert accepted[0] == 150 and (fits["report_count"].to_numpy()[0] == accepted).all()
    assert fits["compass_points"].to_numpy()[0, 3] == 8


def test_b_and_c_are_those_at_the_mean_horizontal_field():
    # the same iron in a field of 16 and of 24 microtesla; what is published is at their mean
    parts = []
    for number, field in enumerate((16000.0, 24000.0)):
        iron = [[0.5, 4.0 * 2e4 / field, -2.0 * 2e4 / field, 0, 0]]
        flown, _ = fly(iron, Setting(aircraft=1, days=30), 31 + number)
        later = flown.assign(time=flown["time"] + number * np.timedelta64(40, "D"))
        later = later.assign(flight=flown["flight"] + number * 1000).drop_vars("row_size")
        parts.append(later.assign(horizontal_field=0 * flown["latitude"] + field))
    reports = xr.concat(parts, "report", data_vars="minimal", coords="minimal", compat="override")
    reports["row_size"] = ("aircraft", [reports.sizes["report"]])
    fits = fit_deviation(reports)
    assert np.abs(fits["deviation"].to_numpy()[0, 0] - [0.5, 4.0, -2.0, 0, 0]).max() < 0.3
    assert fits["mean_horizontal_field"].item() == pytest.approx(20000.0)
    reports["screening"][: reports.sizes["report"] // 4] = 1
    # a third of 16,000 and two thirds of 24,000: screened reports do not count
    mean_field = fit_deviation(reports)["mean_horizontal_field"].item()
    assert mean_field == pytest.approx(16000 / 3 + 2 * 24000 / 3)
    reports["screening"][:] = 0
    # unaware of the field, the fit takes the compass for one that has changed
    unaware = fit_deviation(reports.drop_vars("horizontal_field"))
    assert unaware["status"].item() == STATUS["unstable_fit"]
    assert np.isnan(unaware["deviation"]).all()
    assert np.isnan(unaware["mean_horizontal_field"].item())


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_fit_that_diverges_is_refused():
    """Of 40 aircraft with two flights on a heading each, the fit of the fourth diverges."""
    few = Setting(aircraft=40, days=1, flights_a_day=2, reports_a_flight=14, legs=1)
    headings, _ = fly(fleet_deviations(40, np.random.default_rng(7)), few, 7)
    assert set(fit_deviation(headings)["status"].to_numpy().ravel()) == {STATUS["too_few_reports"]}


def test_without_gross_errors_the_fit_is_least_squares_of_the_vector():
    setting = Setting(aircraft=1, days=30, day_error=0.0, flight_error=0.0)
    headings, _ = fly([[1.0, 8.0, -6.0, 1.5, -1.0]], setting, 7)
    fits = fit_deviation(headings, harmonics=2, shared_error=False).isel(reference=0, aircraft=0)
    indicated, magnetic = headings["heading"].to_numpy(), headings["magnetic_heading"].to_numpy()
    winds = ("eastward_wind", "northward_wind")
    reported, model = (
        np.stack([headings[f"{kind}{name}"].to_numpy().ravel() for name in winds])
        for kind in ("", "reference_")
    )
    airspeed = headings["airspeed"].to_numpy()

    def air(heading):
        return airspeed * np.stack([np.sin(np.radians(heading)), np.cos(np.radians(heading))])

    def residuals(theta):
        right = indicated - curve(np.degrees(theta[:5]), magnetic)
        difference = model - theta[6:, None] - reported
        return (difference - air(indicated) + (1 - theta[5]) * air(right)).ravel()

    best = least_squares(residuals, np.zeros(8), x_scale=[0.01] * 6 + [1, 1]).x
    error = np.sqrt(np.diagonal(fits["deviation_covariance"]))
    curve_difference = fits["deviation"].to_numpy() - np.degrees(best[:5])
    assert (np.abs(curve_difference) < 0.35 * error).all()  # 95 % efficiency
    assert fits["airspeed_scale"].item() == pytest.approx(best[5], abs=1e-3)
    assert fits["reference_bias"].to_numpy() == pytest.approx(best[6:], abs=0.1)


def statuses(size, seeds, **setting):
    """Status of fleets of 20 aircraft with one cycle of this amplitude (degrees)."""
    by_fleet = []
    for seed in seeds:
        phase, zero = np.random.default_rng(seed).uniform(0, 2 * np.pi, 20), np.zeros(20)
        cycle = size * np.cos(phase), size * np.sin(phase)
        deviation = np.stack([zero, *cycle, zero, zero], axis=1)
        headings, _ = fly(deviation, Setting(aircraft=20, **setting), seed + 100)
        by_fleet.append(fit_deviation(headings)["status"].to_numpy()[0])
    return np.concatenate(by_fleet)


def test_without_deviation_no_correction_is_needed():
    status = statuses(0.0, range(3), days=30)
    assert np.mean(status == STATUS["no_correction_needed"]) >= 0.88  # 95 % in the mean
    assert np.mean(status == STATUS["ok"]) <= 0.1
    assert published(STATUS["no_correction_needed"]) and not published(STATUS["no_improvement"])


@pytest.mark.parametrize("bias", [(0.5, -0.4), (1.0, -0.8)])
def test_a_small_deviation_is_corrected_whatever_the_bias_of_the_reference(bias):
    assert (statuses(0.7, range(2), days=30, bias=bias) == STATUS["ok"]).mean() > 0.94


@pytest.mark.slow
def test_rates_of_false_corrections_and_false_refusals():
    status = statuses(0.0, range(10))
    assert 0.02 <= np.mean(status != STATUS["no_correction_needed"]) <= 0.09
    status = statuses(0.3, range(10))
    assert np.mean(status == STATUS["ok"]) > 0.9
    assert np.mean(status == STATUS["no_improvement"]) < 0.03


def test_the_improvement_is_that_of_the_winds():
    """On days that the fit has not seen, in the mean square."""
    setting = Setting(aircraft=4, days=60, bias=(0.0, 0.0), bias_spread=0.0)
    headings, _ = fly([[1.0, 3.0, -2.0, 0.0, 0.0]] * 4, setting, 5)
    first_half = (headings["time"] < headings["time"].quantile(0.5)).to_numpy()
    learned = headings.assign(screening=("report", np.where(first_half, 0, 1).astype(np.int32)))
    done = correct(headings, add_tables(fit_deviation(learned), learned), method="curve")
    fall = sum(
        (done[name] - headings[f"reference_{name}"][0]) ** 2
        - (done[f"corrected_{name}"] - headings[f"reference_{name}"][0]) ** 2
        for name in ("eastward_wind", "northward_wind")
    )
    later = np.where(first_half, np.nan, fall.to_numpy()).reshape(4, -1)
    fits = fit_deviation(headings).isel(reference=0)
    names = ("held_out_improvement", "held_out_improvement_standard_error")
    stated, error = (fits[name].to_numpy() for name in names)
    assert (fits["status"] == STATUS["ok"]).all()
    assert (np.abs(np.nanmean(later, axis=1) - stated) < 4 * error + 0.1 * stated).all()


def test_one_day_with_reports_that_are_no_gross_errors_holds_nothing_out():
    setting = Setting(aircraft=1, days=6, flights_a_day=1, reports_a_flight=400, legs=40)
    headings, _ = fly([[2.0, 8.0, -6.0, 0.0, 0.0]], setting, 1)
    first = headings["flight"].to_numpy() == 0
    headings["heading_error"] += np.where(first, 0.0, 170.0)
    few = some_reports(headings, first | (np.arange(first.size) % 400 == 0))
    assert np.isnan(fit_deviation(few)["held_out_improvement"].item())


@pytest.mark.parametrize("kind", ["half", "twice", "opposite"])
def test_winds_that_contradict_the_reference_have_no_table(kind):
    """Half is m/s read as kt, twice kt read as m/s, opposite a direction toward."""
    factor = {"half": 0.5144, "twice": 1.944, "opposite": -1.0}[kind]
    setting = Setting(aircraft=3, days=30, wind_factor=factor)
    headings, _ = fly([[1.0, 3.0, -2.0, 0.0, 0.0]] * 3, setting, 6)
    fits = add_tables(fit_deviation(headings), headings)
    assert not published(fits["status"]).any()
    assert (fits["status"] == STATUS["implausible_reports"]).sum() >= 2
    assert np.isnan(fits["table_correction"]).all()
    assert np.isfinite(fits["held_out_improvement"]).all()


FLEET = Setting(aircraft=10, days=40, flights_a_day=4)
HOUR = Setting(aircraft=30, days=1, flights_a_day=1, reports_a_flight=300, legs=1, bias=(0.2, 0.1))


def on_one_octant(setting, seed, aircraft):
    """A fleet of constant deviations, some of its aircraft left with the headings of one octant."""
    deviation = np.zeros((setting.aircraft, 5))
    deviation[:, 0] = np.random.default_rng([seed, 1]).normal(0, 1, setting.aircraft)
    headings, _ = fly(deviation, setting, seed)
    heading = headings["heading"].to_numpy().reshape(setting.aircraft, -1)
    off = np.abs(wrap(heading - heading[:, :1])) > 22.5
    off &= np.isin(np.arange(setting.aircraft), aircraft)[:, None]
    headings["screening"] = ("report", np.where(off.ravel(), 8, 0).astype(np.int32))
    return headings, deviation[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "aircraft", "seeds", "least", "most"),
    [
        # together with aircraft with curves: their bias and its scatter are those of the simulation
        pytest.param(FLEET, range(6, 10), 20, 0.90, 0.995, id="with_curves"),
        # without: airspeed sensors' errors are taken for the reference's, the interval is wide
        pytest.param(FLEET, range(10), 8, 0.95, 1.0, id="no_curve_in_the_fleet"),
        pytest.param(HOUR, range(30), 12, 0.90, 1.0, id="one_flight_each"),
    ],
)
def test_intervals_hold_the_truth(setting, aircraft, seeds, least, most):
    z = []
    for seed in range(seeds):
        headings, truth = on_one_octant(setting, seed, list(aircraft))
        fits = fit_deviation(headings, min_reports=100).isel(reference=0, aircraft=list(aircraft))
        offset_only = fits["status"].to_numpy() == STATUS["offset_only"]
        error = fits["offset"].to_numpy() - truth[list(aircraft)]
        z.append((error / fits["offset_standard_error"].to_numpy())[offset_only])
    inside = np.abs(np.concatenate(z)) < 1.96
    assert inside.size >= 60
    assert least <= inside.mean() <= most


@pytest.fixture(scope="module")
def one_octant():
    headings, truth = on_one_octant(FLEET, 3, [8, 9])
    return headings, truth, add_tables(fit_deviation(headings), headings)


def test_two_hundred_reports_in_one_octant_are_an_offset_never_an_amplitude(one_octant):
    headings, truth, fits = one_octant
    fit = fits.isel(reference=0, aircraft=9)
    assert int(fit["status"]) == STATUS["offset_only"]
    assert int(fit["compass_points"]) <= 3
    assert int(fit["report_count"]) >= 200
    error = float(fit["offset_standard_error"])
    assert float(fit["offset"]) == pytest.approx(truth[9], abs=3 * error)
    for name in ("amplitude", "phase", "airspeed_scale", "amplitude_standard_error"):
        assert np.isnan(fit[name])
    assert int(fit["harmonics"]) == 0
    table = fit["table_correction"].to_numpy()
    assert np.ptp(table) == 0
    assert table[0] == pytest.approx(-float(fit["offset"]), abs=0.051)
    # on the headings flown the constant is known as well as stated, on others it is not
    reports = headings.isel(report=slice(-int(headings["row_size"][9]), None))
    flown = reports["heading"].to_numpy()[reports["screening"] == 0]
    flown_error, opposite_error = (
        curve_standard_error(fit["deviation_covariance"].to_numpy(), flown + turn)
        for turn in (0.0, 180.0)
    )
    assert np.median(flown_error) == pytest.approx(error, rel=0.02)
    assert (opposite_error > 1.1 * error).all()


def test_corrections_tables_and_the_simulation_use_the_offset(one_octant, tmp_path):
    headings, _, fits = one_octant
    name = str(fits["aircraft"].to_numpy()[9])
    corrected = correct(headings, fits, apply_airspeed_scale=True)
    reports = slice(-int(headings["row_size"][9]), None)
    applied = corrected["correction_applied"].to_numpy()
    assert (applied[reports] == CORRECTION["offset_only"]).all()
    curve = np.repeat(fits["status"].to_numpy()[0] == STATUS["ok"], headings["row_size"])
    assert (applied[curve] != CORRECTION["offset_only"]).all()
    change = corrected["corrected_heading"] - headings["heading"]
    expected = float(fits["table_correction"][0, 9, 0])
    assert np.abs(wrap(change.to_numpy()[reports] - expected)).max() < 1e-3
    assert np.isfinite(corrected["corrected_eastward_wind"].to_numpy()[reports]).all()
    rows = write_tables_csv(fits, tmp_path / "tables.csv").read_text().splitlines()
    mine = [row.split(",") for row in rows if row.startswith(name)]
    assert len(mine) == 8 and {row[2] for row in mine} == {"offset_only"}
    stated = [float(row[5]) for row in mine]
    assert min(stated) >= float(fits["offset_standard_error"][0, 9]) - 0.001
    effects = effects_of_fits(fits, reference=str(fits["reference"].item()))
    assert [effect.name for effect in effects if effect.tails == (name,)] == ["compass_offset"]


def test_the_refusal_names_the_limit_that_refused():
    few = Setting(aircraft=2, days=1, flights_a_day=4, reports_a_flight=60)
    headings, _ = on_one_octant(few, 1, [])
    # four flights of sixty reports; no other aircraft shows the reference error of a flight
    for least, status in ((200, "too_few_flights"), (1000, "too_few_reports")):
        statuses = fit_deviation(headings, min_reports=least)["status"].to_numpy()
        assert statuses.tolist() == [[STATUS[status]] * 2] and not published(statuses).any()


def test_a_compass_that_changed_has_no_offset():
    headings, _ = on_one_octant(FLEET, 5, list(range(10)))
    half = headings["time"] > headings["time"].quantile(0.5)
    changed_error = headings["heading_error"] + 6.0 * half
    fits = fit_deviation(headings.assign(heading_error=changed_error))
    status = fits["status"].to_numpy()[0]
    enough = fits["report_count"].to_numpy()[0] >= 200
    assert enough.sum() >= 6
    assert (status[enough] == STATUS["unstable_fit"]).all()


def test_an_offset_on_two_headings_is_the_mean_of_both():
    """The robust weights must not keep one heading and discard the other as gross errors."""
    setting = replace(FLEET, hub_and_spoke=True, noise=0.4, flight_error=0.3, day_error=0.1)
    deviation = np.zeros((setting.aircraft, 5))
    deviation[:2, :2] = [[0.5, 6.0], [0.5, 8.0]]
    headings, _ = fly(deviation, setting, 8)
    magnetic = headings["magnetic_heading"].to_numpy().reshape(setting.aircraft, -1)
    near = [np.abs(wrap(magnetic - at)) < 15 for at in (75.0, 255.0)]
    keep = near[0] | (near[1] & (np.random.default_rng(3).random(magnetic.shape) < 0.4))
    keep[2:] = True
    headings["screening"] = ("report", np.where(keep, 0, 8).astype(np.int32).ravel())
    fits = fit_deviation(headings).isel(reference=0, aircraft=[0, 1])
    error = headings["heading_error"][0].to_numpy().reshape(setting.aircraft, -1)
    means = [error[number][keep[number]].mean() for number in (0, 1)]
    assert (fits["status"] == STATUS["offset_only"]).all()
    np.testing.assert_allclose(fits["offset"], means, atol=1.0)
