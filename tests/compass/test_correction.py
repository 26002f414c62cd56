"""Tables of the units and corrected winds: interpolation, signs, rounding, errors, CSV file."""

import csv

import benchmarks.observation_errors as archive
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from airswing.compass.correction import (
    FINE,
    NODES,
    add_tables,
    coding_variance,
    correct,
    corrected_wind,
    correction_error,
    deviation_curve,
    error_from_table,
    unit_interpolation,
    write_tables_csv,
)
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.flags import CORRECTION, STATUS
from airswing.synthetic.archive import simulate_arrays
from tests.compass.flown import Setting, fleet_deviations, fly, wrap
from tests.gap.toy import effect
from tests.ragged import ragged

EVEN = np.ones((1, 360), dtype=int)
"""Numbers of reports at headings that are flown equally often."""


def fits_of(*coefficients):
    rows = np.array(coefficients, float)
    axes = ("reference", "aircraft", "coefficient")
    covariance = np.tile(0.01 * np.eye(5), (1, len(rows), 1, 1))
    return xr.Dataset(
        {
            "deviation": (axes, rows[None]),
            "deviation_covariance": ((*axes, "coefficient_2"), covariance),
            "status": (axes[:2], np.zeros((1, len(rows)), np.int8)),
        },
        coords={"reference": ["ruc"], "aircraft": [f"N{k}" for k in range(len(rows))]},
    )


def headings_of(*parts):
    m = np.concatenate(parts)
    return ragged({"magnetic_heading": m, "screening": 0 * m.astype(int)}, [*map(len, parts)])


@given(st.lists(st.floats(-20, 20), min_size=8, max_size=8), st.floats(-720, 720) | st.just(np.nan))
def test_interpolation_is_the_periodic_one_of_numpy(table, heading):
    expected = np.interp(heading, NODES, table, period=360)
    for given_table in (np.array(table), np.array([table])):
        value = unit_interpolation(given_table, [heading])[0]
        assert value == pytest.approx(expected, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("cycles", "curve", "gain", "residual"),
    [(1, [0, 1, 0, 0, 0], 1.052, 0.025), (2, [0, 0, 0, 1, 0], 1.216, 0.120)],
)
def test_projection_has_the_known_gain_and_residual(cycles, curve, gain, residual):
    # the nodes sample sin at 45 degrees (one cycle) and at its maxima (two cycles)
    nodes = error_from_table(add_tables(fits_of(curve), EVEN, resolution=0.0))[0, 0].to_numpy()
    assert nodes == pytest.approx(gain * np.sin(np.radians(cycles * NODES)), abs=2e-3)
    error = unit_interpolation(nodes, FINE) - deviation_curve(curve, FINE)
    assert np.sqrt(2.0 * np.mean(error**2)) == pytest.approx(residual, abs=2e-3)


@pytest.mark.parametrize("sign", ["subtract_error", "add_error"])
def test_round_trip_of_the_sign(sign):
    # headings with the error of the curve are right after the table's rule for its sign
    coefficients = [1.5, 4.0, -3.0, 0.0, 0.0]
    indicated = np.linspace(0, 360, 721)
    fits = add_tables(fits_of(coefficients), headings_of(indicated), resolution=0.0, sign=sign)
    true = indicated - deviation_curve(coefficients, indicated)
    table = unit_interpolation(fits["table_correction"][0, 0].to_numpy(), indicated)
    corrected = indicated + table if sign == "subtract_error" else indicated - table
    assert np.abs(corrected - true).max() < 0.35
    rms = np.sqrt(np.mean((corrected - true) ** 2))
    assert rms == pytest.approx(fits["table_residual_rms"].item(), abs=5e-3)
    # a navigator's deviation (magnetic - compass) is what subtract_error adds
    east = fits["table_correction"][0, 0, 2].item()
    assert np.sign(east) == (-1 if sign == "subtract_error" else 1)
    assert error_from_table(fits)[0, 0, 2].item() == pytest.approx(5.5, abs=0.3)
    with pytest.raises(InputError, match=r"table\.sign.*add_error"):
        add_tables(fits, headings_of(indicated), sign="east")


def test_rounding_to_the_unit_and_refused_fits():
    m = np.random.default_rng(0).uniform(0, 360, 3000)
    fits = fits_of([1, 2, 3, 0, 0], [np.nan] * 5)
    fine = add_tables(fits, headings_of(m, m), resolution=0.0)
    coarse = add_tables(fits, headings_of(m, m), resolution=0.1)
    np.testing.assert_array_equal(coarse["table_correction"], fine["table_correction"].round(1))
    assert np.isnan(coarse["table_correction"].to_numpy()).all(axis=-1).tolist() == [[False, True]]
    assert coarse["table_residual_rms"][0, 0] > fine["table_residual_rms"][0, 0]
    assert np.isnan(coarse["table_residual_rms"][0, 1])
    assert fine["table_heading"].to_numpy().tolist() == NODES.tolist()
    assert fine["table_correction"].attrs["units"] == "degree"
    zero = add_tables(fits_of([-0.01, 0, 0, 0, 0]), EVEN, resolution=0.1)["table_correction"]
    assert (zero == 0).all() and not np.signbit(zero).any()


def test_the_csv_file_lists_every_node_also_of_refused_fits(tmp_path):
    fits = fits_of([1, 3, -2, 0, 0], [np.nan] * 5)
    with pytest.raises(InputError, match="add_tables"):
        write_tables_csv(fits, tmp_path / "tables.csv")
    fits["status"][0, 1] = STATUS["implausible_reports"]  # has coefficients, but no table to load
    fits["deviation"][0, 1] = 1.0
    fits = add_tables(fits, np.tile(EVEN, (2, 1)))
    path = write_tables_csv(fits, tmp_path / "tables.csv")
    rows = list(csv.DictReader(path.open(newline="")))
    assert [float(row["heading_deg"]) for row in rows] == [*NODES, *NODES]
    written = [float(row["table_correction_deg"]) for row in rows[:8]]
    assert written == pytest.approx(fits["table_correction"][0, 0].to_numpy())
    # A, C and E at north: sqrt(3) of 0.1
    assert rows[0]["standard_error_deg"] == "0.173"
    shared = {"reference": "ruc", "sign": "subtract_error"}
    fitted = shared | {"aircraft": "N0", "status": "ok"}
    refused = shared | {"aircraft": "N1", "status": "implausible_reports"}
    refused |= dict.fromkeys(("table_correction_deg", "standard_error_deg"), "")
    for row, expected in zip(rows, [fitted] * 8 + [refused] * 8, strict=True):
        assert row.items() >= expected.items()


@pytest.fixture(scope="module")
def fleet():
    deviation = fleet_deviations(3, np.random.default_rng(3))
    headings, truth = fly(deviation, Setting(aircraft=3, days=30, scale_spread=0.03), 21)
    return headings, truth, add_tables(fit_deviation(headings), headings)


@given(st.floats(-20, 20), st.floats(0, 360), st.floats(40, 250), st.floats(-50, 50))
def test_correction_undoes_a_deviation(error, true, speed, wind):
    # fly at a true heading, report along the deviated one, correct: the wind is back
    ground = speed * np.array([np.sin(np.radians(true)), np.cos(np.radians(true))]) + [wind, -wind]
    indicated = np.radians(true + error)
    reported = ground - speed * np.array([np.sin(indicated), np.cos(indicated)])
    result = corrected_wind(*reported, speed, indicated, np.radians(error))
    assert np.allclose(result, [wind, -wind], atol=1e-9)


@pytest.mark.parametrize("method", ["table", "curve"])
def test_corrected_wind_is_near_the_truth(fleet, method):
    headings, truth, fits = fleet
    size = int(headings["row_size"][0])

    def rms_error(ds, name):
        wind = np.stack([ds[f"{name}eastward_wind"], ds[f"{name}northward_wind"]], -1)
        miss = np.hypot(*(wind - truth["true_wind"]).T).reshape(3, size)
        return np.sqrt(np.mean(miss**2, axis=1))

    options = ({"method": method, "apply_airspeed_scale": scaling} for scaling in (False, True))
    done, scaled = (correct(headings, fits, **option) for option in options)
    assert (rms_error(done, "corrected_") < 0.6 * rms_error(headings, "")).all()
    assert (rms_error(scaled, "corrected_") < 0.15 * rms_error(headings, "")).all()
    assert np.all(done["correction_applied"] == CORRECTION["corrected"])
    assert np.abs(wrap(done["corrected_heading"] - headings["heading"])).max() < 15


def test_only_reports_of_fitted_aircraft_are_corrected(fleet):
    headings, _, fits = fleet
    headings, fits = headings.copy(deep=True), fits.copy(deep=True)
    size = int(headings["row_size"][0])
    with pytest.raises(InputError, match="add_tables"):
        correct(headings, fits.drop_vars("table_correction"), method="table")
    with pytest.raises(InputError, match="nam"):
        correct(headings, fits, reference="nam")
    with pytest.raises(InputError, match=r"unknown method \(found: tables"):
        correct(headings, fits, method="tables")
    headings["screening"][:size] = 2  # screened out, yet it has a heading: corrected
    headings["heading"][5] = np.nan
    headings["eastward_wind"][6] = np.nan
    fits["status"][0, 1] = 1
    fits["status"][0, 2] = STATUS["no_correction_needed"]
    done = correct(headings, fits)
    flag = done["correction_applied"].to_numpy()
    assert flag[5] == CORRECTION["no_heading"]
    assert flag[6] == CORRECTION["missing_wind"]
    assert np.all(np.delete(flag[:size], [5, 6]) == CORRECTION["corrected"])
    assert np.all(flag[size : 2 * size] == CORRECTION["no_fit"])
    assert np.all(flag[2 * size :] == CORRECTION["no_correction_needed"])
    unchanged = slice(size, None)
    for name in ("eastward_wind", "northward_wind", "heading"):
        assert np.array_equal(done[f"corrected_{name}"][unchanged], headings[name][unchanged])
    assert np.isnan(done["corrected_wind_standard_error"][unchanged]).all()
    tables = add_tables(fits, headings)["table_correction"]
    assert (tables[0, 2] == 0).all() and (tables[0, 0] != 0).any()
    assert np.isnan(done["corrected_eastward_wind"][6])


def test_the_one_cycle_term_grows_where_the_field_is_weak(fleet):
    # B = 3 degrees at a mean of 20,000 nT is 4 degrees at 15,000 nT; A, D, E stay, and the table
    headings, _, fits = fleet
    headings, fits = headings.copy(deep=True), fits.copy(deep=True)
    fits["deviation"][0, 0] = np.array([0.5, 3.0, -1.0, 0.25, 2.0])
    fits["deviation_covariance"][0, 0] = np.diag([0.01, 0.04, 0.09, 0.16, 0.25])
    assert np.isnan(fits["mean_horizontal_field"]).all()
    fits["mean_horizontal_field"][0] = 20_000.0
    field = np.full(headings.sizes["report"], 20_000.0)
    field[[0, 1, 2]] = 15_000.0, 25_000.0, np.nan
    headings["magnetic_heading"][:4] = np.array([90.0, 0.0, 90.0, 90.0])
    default = correct(headings, fits)
    headings["horizontal_field"] = ("report", field)
    done = correct(headings, fits, method="curve")
    turns = wrap(headings["heading"] - done["corrected_heading"]).to_numpy()[:4]
    # A + g B - E at 090; A + g C + E at 000
    assert turns == pytest.approx([0.5 + 4 - 2, 0.5 - 0.8 + 2, 0.5 + 3 - 2, 0.5 + 3 - 2], abs=1e-3)
    error = np.degrees(done["corrected_wind_standard_error"] / headings["airspeed"]).to_numpy()[:4]
    at_mean_error = np.sqrt([0.01 + 0.04 + 0.25, 0.01 + 0.09 + 0.25])
    weak, strong = (np.sqrt(0.01 + one_cycle + 0.25) for one_cycle in (0.04 * 16 / 9, 0.09 * 0.64))
    assert error == pytest.approx([weak, strong, at_mean_error[0], at_mean_error[0]], rel=1e-4)
    stated = "corrected_wind_standard_error"
    by_table = correct(headings, fits)  # one table for all fields; its error says so
    xr.testing.assert_identical(by_table.drop_vars(stated), default.drop_vars(stated))
    # A + B sin m + C cos m + ... of the field there, less the table: known, and stated
    table = wrap(headings["heading"] - by_table["corrected_heading"]).to_numpy()[:2]
    table_error, table_error_at_mean = np.array([2.5, 1.7]) - table, np.array([1.5, 1.5]) - table
    table_variance = np.radians(table_error) ** 2 - np.radians(table_error_at_mean) ** 2
    added_variance = (by_table[stated] ** 2 - default[stated] ** 2).to_numpy()[:2]
    variance = np.radians([weak, strong]) ** 2 - np.radians(at_mean_error) ** 2
    expected = headings["airspeed"].to_numpy()[:2] ** 2 * (table_variance + variance)
    assert added_variance == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("slope", "deviation", "options", "expected"),
    [
        (0.0, 0.1, {"curve_error": 0.003}, 0.3),  # the curve known to 0.003 rad
        (0.0, 0.1, {"airspeed_error": 4.0}, 0.4),
        (0.0, 0.1, {"heading_error": 0.05}, 0.5),  # the correction of 10 m/s turns with it
        (0.1, 0.0, {"heading_error": 0.05}, 0.5),  # as much where the curve is steep and zero
        (0.0, 0.1, {"heading_error": 50.0}, np.sqrt(2.0) * 10.0),  # at most back and forth
        (0.0, 0.1, {"coding": 0.09}, 0.3),
    ],
)
def test_parts_of_the_standard_error_by_hand(slope, deviation, options, expected):
    """At 100 m/s."""
    assert correction_error(100.0, deviation, slope, **options) == pytest.approx(expected, rel=1e-3)


def test_coding_of_two_reports():
    # steps of 0.5 m/s and of 0.01 rad at 20 m/s: uniform, variance step^2 / 12, of two reports
    assert coding_variance(20.0, 0.5, 0.01) == pytest.approx(2.0 * (0.5**2 + 0.2**2) / 12.0)
    speed = np.random.default_rng(0).uniform(0.0, 40.0, (2, 100_000))
    off = np.round(speed / 0.5) * 0.5 - speed
    assert np.var(off[0] - off[1]) == pytest.approx(coding_variance(9.0, 0.5, 0.0), rel=0.02)


def test_corrected_winds_are_within_their_errors_of_those_of_perfect_compasses():
    """Six compasses with errors of 5 to 7 degrees, in level flight and in turns."""
    rng = np.random.default_rng(5)
    drawn = ({"amplitude_deg": a, "phase_deg": p} for a, p in rng.uniform((5, 0), (7, 360), (6, 2)))
    effects = [effect("hard_iron", [k], **values) for k, values in enumerate(drawn)]
    size = {"days": 16, "aircraft": 6}
    _, done, wrong = archive.archive(11, **size, effects=effects)
    right = simulate_arrays(**size, seed=11, effects=[]).set_index(["tail", "time"])
    right = right.loc[wrong.index]
    error = np.hypot(
        done["corrected_eastward_wind"] - right["u"].to_numpy(),
        done["corrected_northward_wind"] - right["v"].to_numpy(),
    ).to_numpy()
    stated = done["corrected_wind_standard_error"].to_numpy()
    turning = np.abs(np.degrees(right["bank"].to_numpy())) > 2.0
    for rows, number, share in ((~turning, 8_000, 0.95), (turning, 250, 0.90)):
        rows &= np.isfinite(stated)
        assert rows.sum() > number
        assert np.mean(error[rows] <= 2.0 * stated[rows]) > share
        # and no more is stated than there is, by much
        assert np.sqrt(np.mean(stated[rows] ** 2)) < 1.6 * np.sqrt(np.mean(error[rows] ** 2))
