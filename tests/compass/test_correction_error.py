"""The error a correction states, by hand and against reports of compasses without a deviation."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import airswing  # noqa: F401
from airswing.compass.correction import correct
from airswing.compass.correction_error import (
    At,
    coding_variance,
    correction_error,
    curve_slope,
    table_slope,
)
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.headings import derive_headings
from airswing.compass.screening import screen
from airswing.compass.table import add_tables, deviation_curve
from airswing.reports.read import read_reports
from airswing.synthetic.sample.sample_archive import simulate_arrays, write_reports

ARCHIVE = {"days": 16, "aircraft": 6, "seed": 11, "references": ("ruc",), "derivatives": False}


def test_parts_by_hand():
    # 100 m/s, curve known to 0.003 rad: 0.3 m/s
    none = np.zeros(1)
    at = At(np.array([100.0]), none, none, np.array([0.1]), none)
    assert correction_error(at, [0.003]) == pytest.approx([0.3])
    # airspeed known to 4 m/s under a deviation of 0.1: 0.4 m/s
    assert correction_error(at._replace(airspeed_error=np.array([4.0])), [0.0]) == pytest.approx(
        [0.4]
    )
    # heading known to 0.05 rad: the correction of 10 m/s turns with it, 0.5 m/s
    doubtful = at._replace(heading_error=np.array([0.05]))
    assert correction_error(doubtful, [0.0]) == pytest.approx([0.5], rel=1e-3)
    # where the curve is steep and crosses nothing, as much
    steep = doubtful._replace(deviation=none, slope=np.array([0.1]))
    assert correction_error(steep, [0.0]) == pytest.approx([0.5], rel=1e-3)
    # nothing known of the heading: at most the correction back and forth
    lost = at._replace(heading_error=np.array([50.0]))
    assert correction_error(lost, [0.0]) == pytest.approx([np.sqrt(2.0) * 10.0])
    assert correction_error(at, [0.0], [0.09]) == pytest.approx([0.3])


def test_coding_of_two_reports():
    # steps of 0.5 m/s and of 0.01 rad at 20 m/s: uniform, variance step^2 / 12, of two reports
    expected = 2.0 * (0.5**2 + 0.2**2) / 12.0
    assert coding_variance([20.0], [0.5], [0.01]) == pytest.approx([expected])
    rng = np.random.default_rng(0)
    speed = rng.uniform(0.0, 40.0, (2, 100_000))
    off = np.round(speed / 0.5) * 0.5 - speed
    assert np.var(off[0] - off[1]) == pytest.approx(
        coding_variance([9.0], [0.5], [0.0])[0], rel=0.02
    )


def test_slopes_are_those_of_the_curves():
    rng = np.random.default_rng(2)
    coefficients, heading = rng.normal(size=(50, 5)), rng.uniform(0, 360, 50)
    by_step = (
        deviation_curve(coefficients, (heading + 1e-4)[:, None])
        - deviation_curve(coefficients, (heading - 1e-4)[:, None])
    )[:, 0] / 2e-4
    np.testing.assert_allclose(curve_slope(coefficients, heading), by_step, atol=1e-7)
    table = np.tile(np.array([0.0, 4.5, 0, 0, 0, 0, 0, 9.0]), (3, 1))
    np.testing.assert_allclose(table_slope(table, [10.0, 80.0, -20.0]), [0.1, -0.1, -0.2])


@pytest.fixture(scope="module")
def twins(tmp_path_factory):
    """Reports of six compasses off by five to seven degrees, corrected, and as they should be."""
    rng = np.random.default_rng(5)
    effects = [
        {
            "name": "hard_iron",
            "tails": [f"N{401 + k}"],
            "parameters": {"amplitude_deg": rng.uniform(5, 7), "phase_deg": rng.uniform(0, 360)},
        }
        for k in range(6)
    ]
    with_effect, right = (simulate_arrays(effects=e, **ARCHIVE) for e in (effects, []))
    folder = tmp_path_factory.mktemp("twins")
    write_reports(folder, with_effect)
    reports = read_reports(str(folder / "*.csv"))
    tails = np.repeat(reports["aircraft"].to_numpy().astype(str), reports["row_size"].to_numpy())
    place = {
        key: k for k, key in enumerate(zip(with_effect["tail"], with_effect["time"], strict=True))
    }
    row = np.array([place[key] for key in zip(tails, reports["time"].to_numpy(), strict=True)])
    model = {
        f"reference_{side}_wind": (
            ("reference", "report"),
            with_effect[f"{name}_ruc"].to_numpy()[None, row],
        )
        for side, name in (("eastward", "u"), ("northward", "v"))
    }
    winds = xr.Dataset(model, coords={"reference": ["ruc"]})
    headings = screen(derive_headings(reports, winds))
    fits = add_tables(fit_deviation(headings), headings)
    done = correct(headings, fits)
    error = np.hypot(
        done["corrected_eastward_wind"].to_numpy() - right["u"].to_numpy()[row],
        done["corrected_northward_wind"].to_numpy() - right["v"].to_numpy()[row],
    )
    truth = right.iloc[row]
    return error, done, truth, with_effect.iloc[row]


def test_corrected_winds_are_within_what_they_state_of_those_of_right_compasses(twins):
    error, done, truth, _ = twins
    stated = done["corrected_wind_standard_error"].to_numpy()
    known = np.isfinite(stated)
    turning = np.abs(np.degrees(truth["bank"].to_numpy())) > 2.0
    straight, turns = known & ~turning, known & turning
    assert straight.sum() > 8_000
    assert turns.sum() > 250
    assert np.mean(error[straight] <= 2.0 * stated[straight]) > 0.95
    assert np.mean(error[turns] <= 2.0 * stated[turns]) > 0.90
    # and no more is stated than there is, by much
    for chosen in (straight, turns):
        assert np.sqrt(np.mean(stated[chosen] ** 2)) < 1.6 * np.sqrt(np.mean(error[chosen] ** 2))


def test_turns_are_corrected_nearly_as_well_as_straight_flight(twins):
    error, done, truth, _ = twins
    known = np.isfinite(done["corrected_wind_standard_error"].to_numpy())
    turning = np.abs(np.degrees(truth["bank"].to_numpy())) > 2.0
    for phase, most in ((1, 1.9), (3, 1.6)):  # ascent, descent
        chosen = known & turning & (truth["phase"].to_numpy() == phase)
        assert np.sqrt(np.mean(error[chosen] ** 2)) < most
    assert np.sqrt(np.mean(error[known & ~turning] ** 2)) < 0.9
