"""Deviations beside the reference's shared error: better where the fleet shares the air."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.compass.flown import Setting, fleet_deviations, fly

from airswing.compass.fit.deviation import fit_deviation, fit_sums, sum_aircraft
from airswing.compass.fleet.inverse import UNKNOWN_VARIANCE, group_variances


def errors(seed: int, **options) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard errors of A, B, C where days of model error dominate."""
    setting = Setting(aircraft=8, days=25, day_error=2.5, flight_error=0.5, noise=1.0)
    deviation = fleet_deviations(8, np.random.default_rng(seed), two_cycles=0.0)
    ds, _ = fly(deviation, setting, seed)
    fits = fit_deviation(ds, harmonics=1, **options).isel(reference=0)
    spread = np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=1, axis2=2))
    return (fits["deviation"].to_numpy() - deviation)[:, :3], spread[:, :3]


def test_the_shared_error_is_taken_off_and_intervals_stay_honest():
    with_field = [errors(seed) for seed in range(6)]
    without = [errors(seed, shared_error=False) for seed in range(6)]
    rms = [np.sqrt(np.mean([e**2 for e, _ in runs])) for runs in (with_field, without)]
    assert rms[0] < 0.85 * rms[1]
    score = np.concatenate([(e / s).ravel() for e, s in with_field])
    assert (np.abs(score) < 1.96).mean() >= 0.88
    assert np.abs(score).max() < 4.5


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("small", [0.0, 0.03])
def test_variances_are_at_the_restricted_likelihoods_top(seed, small):
    """Against a search over the likelihood itself, also where one of the variances is nothing."""
    rng = np.random.default_rng(seed)
    groups = [np.arange(20), 20 + np.arange(60)]
    effects = np.concatenate([rng.normal(0, 0.5, 20), rng.normal(0, np.sqrt(small), 60), [3.0]])
    design = rng.normal(size=(200, effects.size))
    information = design.T @ design / 4.0
    score = design.T @ (design @ effects + 2.0 * rng.normal(size=200)) / 4.0

    def minus_twice_log_likelihood(logarithms):
        variance = np.full(effects.size, UNKNOWN_VARIANCE)
        for group, logarithm in zip(groups, logarithms, strict=True):
            variance[group] = np.exp(logarithm)
        total = information + np.diag(1.0 / variance)
        return (
            np.linalg.slogdet(total)[1]
            + np.log(variance).sum()
            - score @ np.linalg.solve(total, score)
        )

    best = minimize(
        minus_twice_log_likelihood,
        np.log([0.05, 0.05]),
        method="L-BFGS-B",
        bounds=[(np.log(1e-4), np.log(9.0))] * 2,
    )
    found = group_variances(information, score, groups)
    at = minus_twice_log_likelihood(np.log([found[0], found[20]]))
    assert at < best.fun + 0.05
    assert found[-1] == UNKNOWN_VARIANCE


def test_the_headings_are_left_as_they_were_and_the_fit_repeats():
    setting = Setting(aircraft=3, days=15, references=2)
    ds, _ = fly(fleet_deviations(3, np.random.default_rng(3)), setting, 3)
    before = ds["heading_error"].to_numpy().copy()
    pools = {"both": ["ruc", "rtfdaa"]}
    first, again = fit_deviation(ds, pools=pools), fit_deviation(ds, pools=pools)
    np.testing.assert_array_equal(ds["heading_error"].to_numpy(), before)
    np.testing.assert_array_equal(first["deviation"].to_numpy(), again["deviation"].to_numpy())


def test_few_reports_are_fitted_without_a_field():
    setting = Setting(aircraft=1, days=12, flights_a_day=2)
    ds, _ = fly(fleet_deviations(1, np.random.default_rng(4)), setting, 4)
    plain = fit_deviation(ds, shared_error=False)
    np.testing.assert_array_equal(
        fit_deviation(ds)["deviation"].to_numpy(), plain["deviation"].to_numpy()
    )


def test_a_pool_can_be_fitted_without_its_members_alone():
    setting = Setting(aircraft=2, days=15, references=2)
    ds, _ = fly(fleet_deviations(2, np.random.default_rng(5)), setting, 5)
    pools = {"both": ["ruc", "rtfdaa"]}
    every, one = fit_deviation(ds, pools=pools), fit_deviation(ds, pools=pools, alone=False)
    assert list(one["reference"].to_numpy()) == ["both"]
    np.testing.assert_array_equal(
        one["deviation"].to_numpy(), every["deviation"].sel(reference=["both"]).to_numpy()
    )


def test_a_fleet_summed_in_parts_gives_the_same_fits_bit_for_bit():
    setting = Setting(aircraft=5, days=15)
    ds, _ = fly(fleet_deviations(5, np.random.default_rng(6)), setting, 6)
    whole = fit_deviation(ds)
    size = int(ds["row_size"][0])
    cuts = [(0, 2), (2, 3), (3, 5)]
    parts = [
        sum_aircraft(ds.isel(aircraft=slice(a, b), report=slice(a * size, b * size)))
        for a, b in cuts
    ]
    assert fit_sums(parts).identical(whole)


def test_some_segments_stand_for_all(monkeypatch):
    setting = Setting(aircraft=5, days=60)
    deviation = fleet_deviations(5, np.random.default_rng(7))
    ds, _ = fly(deviation, setting, 7)
    exact = fit_deviation(ds)
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 700)
    thinned = fit_deviation(ds)
    spread = np.sqrt(np.diagonal(exact["deviation_covariance"].to_numpy(), axis1=-2, axis2=-1))
    apart = np.abs(thinned["deviation"].to_numpy() - exact["deviation"].to_numpy())
    assert (apart / spread).max() < 0.2
    other = np.sqrt(np.diagonal(thinned["deviation_covariance"].to_numpy(), axis1=-2, axis2=-1))
    np.testing.assert_allclose(other, spread, rtol=0.1)
