"""Error of the reports: neighbours by hand, fields of known error, a simulated archive."""

import benchmarks.observation_errors as archive
import numpy as np
import pytest

from airswing.errors import InputError
from airswing.evaluation.observation_errors import (
    REACH,
    added_variance,
    half_squares,
    neighbouring_pairs,
    observation_errors,
)
from airswing.evaluation.resampling import day_weights, interval, widened
from airswing.products.netcdf import read_product, write_product
from airswing.report.html import Figures
from airswing.report.run.evaluation import report_errors_section, worth_sentence
from tests.ragged import ragged


def test_neighbours_by_hand():
    # 0.1 degree of longitude on the equator is 11.12 km; the third is 33 km off, the fourth late.
    ends, separation = neighbouring_pairs(
        np.zeros(5),
        np.array([179.95, -179.95, 179.65, 179.95, 179.95]),
        np.array([50e3, 50.5e3, 50e3, 50e3, 50e3]),
        np.array([0.0, 60, 0, 1400, 10]),
        np.array([0, 1, 1, 1, 0]),
    )
    assert sorted(map(tuple, ends.tolist())) == [(0, 1), (1, 4)]
    distance, depth, late = separation[ends[:, 0].tolist().index(0)]
    assert distance * REACH[0] == pytest.approx(11_120, rel=1e-3)
    assert depth * REACH[1] == pytest.approx(np.log(1.01))
    assert late * REACH[2] == pytest.approx(60.0)
    squares = half_squares(np.array([1.0, 4, 0, 0, 2]), np.array([0.0, -1, 0, 0, 0]), ends)
    assert sorted(squares) == pytest.approx([0.25 * (4 + 1), 0.25 * (9 + 1)])


def fleet(seed, *, days=30, aircraft=8, references=(("a", 2.0),), shared=0.0, size=0.5, far=False):
    """Aircraft over one place in smooth errors of references: size is the reports' true error."""
    rng = np.random.default_rng(seed)
    shape = (aircraft, days, 12)
    x, y = rng.uniform(-40, 40, (2, *shape)).reshape(2, -1)
    if far:
        x += np.repeat(500.0 * np.arange(aircraft), days * 12)
    t = (1.5 * np.arange(12) + rng.uniform(0, 0.5, shape)).ravel()
    day = np.broadcast_to(np.arange(days)[:, None], shape).ravel()

    def field():
        """Sum of waves some 150 km long, drawn anew each day."""
        angle, waves = rng.uniform(0, 2 * np.pi, 6), rng.normal(size=(2, days, 6, 2))[:, day]
        phase = (np.outer(x, np.cos(angle)) + np.outer(y, np.sin(angle))) / 60.0 + t[:, None] / 3.0
        total = waves[..., 0] * np.sin(phase) + waves[..., 1] * np.cos(phase)
        return total.sum(axis=-1) / np.sqrt(6.0)

    common = np.sqrt(shared) * field()
    winds = [spread * field() + common for _, spread in references]
    noise = size * rng.normal(size=(2, x.size))
    fault = np.repeat(rng.normal(0, 2.0, (2, aircraft)), days * 12, axis=1)
    time = np.datetime64("2009-01-01", "ns") + (day * 86400e9 + t * 3600e9).astype(int)
    columns = {
        "latitude": 40.0 + y / 111.2,
        "longitude": -90.0 + x / (111.2 * np.cos(np.radians(40))),
        "pressure": rng.uniform(44_000, 46_000, x.size),
        "time": time.astype("datetime64[ns]"),
        "phase": np.full(x.size, 2, dtype=np.int8),
        "screening": np.zeros(x.size, dtype=np.int32),
        "eastward_wind": 20.0 + noise[0] + fault[0],
        "northward_wind": noise[1] + fault[1],
        "reference_eastward_wind": np.array([w[0] for w in winds]) + 20.0,
        "reference_northward_wind": np.array([w[1] for w in winds]),
    }
    sizes = np.full(aircraft, days * 12)
    headings = ragged(columns, sizes, reference=[name for name, _ in references])
    right = {"corrected_eastward_wind": 20.0 + noise[0], "corrected_northward_wind": noise[1]}
    error = np.sqrt(0.5 * ((noise + fault) ** 2).sum(axis=0).mean())
    return headings, ragged(right, sizes), error


def fleet_error(errors, state="corrected"):
    return errors["fleet_observation_error"].sel(state=state).item()


def by_hat(errors):
    way = {"way": "three_cornered_hat", "state": "corrected"}
    return errors["fleet_observation_error_by_method"].sel(way).item()


def test_one_reference_and_neighbours():
    headings, corrected, reported = fleet(3)
    errors = observation_errors(headings, corrected, pools={"a": ["a"]}, reference="a")
    assert errors.attrs["method"] == "separation"
    before, after = errors["fleet_observation_error"].to_numpy()
    assert after == pytest.approx(0.5, rel=0.1)
    assert before == pytest.approx(reported, rel=0.05)
    low, high = errors["fleet_observation_error_interval"].sel(state="corrected").to_numpy()
    assert low < 0.5 < high and high - low < 0.2
    assert errors["fleet_weight_gain"].item() == pytest.approx((before / after) ** 2)
    assert np.isnan(by_hat(errors))
    cell = errors["observation_error"].sel(flight_phase="cruise", state="corrected").to_numpy()
    assert np.isfinite(cell).sum() == 1 and cell[5] == pytest.approx(after, rel=1e-6)
    filled = errors["observation_error_filled"].sel(state="corrected").to_numpy()
    assert np.isfinite(filled).all() and filled[1, 0] == pytest.approx(after)


def test_two_independent_references_use_the_three_cornered_hat():
    headings, corrected, reported = fleet(5, references=(("a", 2.0), ("b", 1.5)), far=True, days=60)
    pools = {"a": ["a"], "b": ["b"], "a+b": ["a", "b"]}
    errors = observation_errors(headings, corrected, pools=pools, reference="a+b")
    assert errors.attrs["method"] == "three_cornered_hat"
    assert "too few neighbours" in errors.attrs["method_reason"]
    before, after = errors["fleet_observation_error"].to_numpy()
    low, high = errors["fleet_observation_error_interval"].sel(state="corrected").to_numpy()
    assert low < 0.5 < high and after < 0.8
    assert before == pytest.approx(reported, rel=0.1)


def test_references_with_correlated_errors_are_recognised():
    headings, corrected, _ = fleet(7, references=(("a", 1.5), ("b", 1.5)), shared=1.0, days=40)
    pools = {"a": ["a"], "b": ["b"], "a+b": ["a", "b"]}
    errors = observation_errors(headings, corrected, pools=pools, reference="a+b")
    assert errors.attrs["method"] == "separation"
    assert fleet_error(errors) == pytest.approx(0.5, rel=0.12)
    assert by_hat(errors) > 0.9
    low, high = errors["reference_error_covariance_interval"].to_numpy()
    covariance = errors["reference_error_covariance"].item()
    assert 0.3 < low < covariance < high < 2.0
    options = {"pools": pools, "reference": "a+b", "covariance": covariance}
    assumed = observation_errors(headings, corrected, **options)
    assert by_hat(assumed) == pytest.approx(fleet_error(errors), rel=1e-6)
    # the estimate of the covariance does not depend on the assumption
    assert assumed["reference_error_covariance"].item() == pytest.approx(covariance)
    with pytest.raises(InputError, match="no such reference"):
        observation_errors(headings, corrected, pools=pools, reference="nam")


def test_one_day_of_one_reference_gives_a_reason_and_no_error(tmp_path):
    headings, corrected, _ = fleet(1, days=1)
    errors = observation_errors(headings, corrected, pools={"a": ["a"]}, reference="a")
    assert errors.attrs["method"] == ""
    assert bool(errors["observation_error"].isnull().all())
    assert "could not be determined" in report_errors_section(errors, Figures()).lead


def test_uncorrected_reports_do_not_count():
    headings, corrected, _ = fleet(3, days=10)
    applied = np.zeros(headings.sizes["report"], dtype=np.int8)
    applied[: headings["row_size"].to_numpy()[0]] = 1
    corrected["correction_applied"] = ("report", applied)
    estimate = observation_errors(headings, corrected, pools={"a": ["a"]}, reference="a")
    errors = estimate["aircraft_observation_error"].sel(state="corrected").to_numpy()
    assert np.isnan(errors[0]) and np.isfinite(errors[1:]).all()
    assert int(estimate["observation_count"].sel(flight_phase="all").sum()) == (applied == 0).sum()


def test_a_model_error_that_lasts_is_in_the_interval_of_reported_winds():
    """Days alone cannot see it: each aircraft's product with it is the same every day."""
    rng = np.random.default_rng(5)
    covered = {"days": 0, "both": 0}
    for _ in range(60):
        change = np.repeat(rng.normal(0, 3.0, (12, 1)), 40, axis=1)
        lasting = np.repeat(rng.normal(0, 1.0, (12, 1)), 40, axis=1)  # where it flies
        crossed = -change * (lasting + rng.normal(0, 0.5, (12, 40)))
        key = np.stack([*np.indices((12, 40)).reshape(2, -1), np.zeros(480, np.int64)])
        weights = np.vstack([np.ones(40), day_weights(40, draws=400, seed=0)])
        columns = np.ones(480), 0.5 * change.ravel() ** 2, crossed.ravel()
        draws = added_variance(key, *columns, weights, cells=1, seed=0)[:, 0]
        true = 0.5 * (change**2).mean()
        low, high = interval(widened(draws, 40)[1:])
        covered["both"] += low <= true <= high
        by_day = (weights - 1.0) @ (crossed.sum(axis=0) - crossed.mean() * 12) / crossed.size
        low, high = interval(widened(draws[0] + by_day, 40)[1:])
        covered["days"] += low <= true <= high
    assert covered["both"] >= 54  # 90 % of 60
    assert covered["days"] < 30


def test_a_simulated_archive_against_its_truth(tmp_path):
    headings, corrected, frame = archive.archive(11, days=16, aircraft=12)
    errors = observation_errors(headings, corrected, pools=archive.POOLS, reference="ruc+rtfdaa")
    for state in ("reported", "corrected"):
        true, _ = archive.truth(headings, corrected, frame, state)
        assert fleet_error(errors, state) == pytest.approx(true, rel=0.1)
        low, high = errors["fleet_observation_error_interval"].sel(state=state).to_numpy()
        assert low < true < high
    assert errors.attrs["method"] == "separation"
    write_product(errors, tmp_path / "observation_errors.nc", title="errors")
    product = read_product(tmp_path / "observation_errors.nc")
    assert product["observation_error"].dims == ("flight_phase", "layer", "state")
    assert product["observation_error"].attrs["units"] == "m s-1"
    assert product["state"].to_numpy().tolist() == ["reported", "corrected"]
    section = report_errors_section(product, Figures())
    assert "has the weight of" in worth_sentence(product) and len(section.parts) == 2
