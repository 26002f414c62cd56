"""The noise fit recovers its parameters; whitening is that of the full covariance; gross errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.archive.reported_variables import record
from airswing.gap.design import exogenous
from airswing.gap.distribution.gross_errors import gross_by_variable, outliers, reduction_of_gross
from airswing.gap.noise import (
    direction_factors,
    fit_noise,
    flight_order,
    flight_steps,
    gross_errors,
    interpolation_errors,
    kalman_gains,
    level_factors,
    whiten,
)
from airswing.units import KNOT


def flown_archive(seed=0, flights=900):
    rng = np.random.default_rng(seed)
    length = rng.integers(8, 25, flights)
    flight = np.repeat(np.arange(flights), length)
    position = np.arange(flight.size) - np.repeat(np.r_[0, np.cumsum(length)[:-1]], length)
    latitude = 30 + 0.25 * position
    phi = np.exp(-np.radians(0.25) * 6.371e6 / 150e3)
    signal = np.zeros((flight.size, 2))
    for j in range(length.max()):
        now = np.flatnonzero(position == j)
        fresh = rng.normal(size=(now.size, 2))
        signal[now] = fresh if j == 0 else phi * signal[now - 1] + np.sqrt(1 - phi**2) * fresh
    return {
        "residual": 2.3 * signal + 0.9 * rng.normal(size=signal.shape),
        "aircraft": flight % 5,
        "flight": flight,
        "time": flight * 1e4 + position * 120.0,
        "latitude": latitude,
        "longitude": np.full(flight.size, -90.0),
        "pressure": np.full(flight.size, 5e4),
        "heading": rng.uniform(0, 2 * np.pi, flights)[flight],
        "airspeed": np.full(flight.size, 110.0),
    }


def fitted(data):
    return fit_noise(data["residual"], SimpleNamespace(**data))


def test_parameters_recovered_and_innovations_white():
    data = flown_archive()
    fit = fitted(data)
    assert fit.model.correlated_sd == pytest.approx(2.3, rel=0.06)
    assert fit.model.white_sd == pytest.approx(0.9, rel=0.08)
    assert fit.model.length == pytest.approx(150e3, rel=0.15)
    white = whiten(data["residual"], fit.order, fit.gains)
    assert white.std() == pytest.approx(1.0, abs=0.03)
    same = data["flight"][1:] == data["flight"][:-1]
    assert abs((white[1:] * white[:-1])[same].mean()) < 0.03
    good = fit.pair_count > 500
    np.testing.assert_allclose(fit.autocovariance[good], fit.autocovariance_model[good], atol=0.5)


def test_larger_scatter_across_the_heading():
    data = flown_archive(2)
    isotropic = fitted(data)
    assert isotropic.model.along == isotropic.model.across == 1.0
    assert isotropic.gains.direction is None
    beam = np.stack([np.cos(data["heading"]), -np.sin(data["heading"])], -1)
    across = (data["residual"] * beam).sum(axis=1)
    data["residual"] = data["residual"] + 0.8 * across[:, None] * beam
    fit = fitted(data)
    assert fit.model.across / fit.model.along == pytest.approx(1.8, rel=0.03)
    assert fit.model.across**2 + fit.model.along**2 == pytest.approx(2.0)
    spread = np.sqrt((1.8**2 + 1) / 2)
    assert fit.model.correlated_sd == pytest.approx(2.3 * spread, rel=0.06)
    white = whiten(data["residual"], fit.order, fit.gains)
    for side in (beam, beam @ np.array([[0, 1], [-1, 0]])):
        assert (white * side).sum(axis=1).std() == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("wrong", [[3], [0], [3, 4]], ids=["one", "the first", "two in turn"])
def test_gross_errors_are_a_report_or_two_and_not_long_departures(wrong):
    data = flown_archive(2, flights=300)
    first = np.flatnonzero(data["flight"] == 50)
    residual = data["residual"].copy()
    residual[first] += 15.0
    residual[first[wrong]] += 25.0
    marked = np.flatnonzero(gross_errors(residual, flight_order(data["flight"], data["time"])))
    assert set(first) & set(marked) == {*first[wrong]}


def test_level_factors_follow_the_spread():
    rng = np.random.default_rng(3)
    log_pressure = np.linspace(np.log(2e4), np.log(9e4), 10_000)
    residual = rng.normal(size=(10_000, 2))
    residual[:4000] *= 2.0  # two of the five levels
    nodes, factors = level_factors(residual, log_pressure)
    assert nodes.size == 5 and (np.diff(nodes) > 0).all()
    np.testing.assert_allclose(factors[:2] / factors[2:4], 2.0, rtol=0.1)
    assert np.mean(factors**2) == pytest.approx(1.0)
    nodes, factors = level_factors(residual, np.full(10_000, 11.0))
    assert nodes.tolist() == [11.0] and factors.tolist() == [1.0]


LENGTH = 150.0
SIGNAL, WHITE = 2.1, 0.5


def flights(keep=None, *, anisotropic=False):
    """Three flights in any order: order, gains and covariance (2 n, 2 n) of east and north."""
    rng = np.random.default_rng(4)
    flight = np.repeat([7, 3, 9], [5, 7, 1])
    keep = np.ones(13, bool) if keep is None else keep
    step = np.where(np.r_[True, flight[1:] != flight[:-1]], np.inf, rng.uniform(5, 60, 13))
    order = flight_order(flight, np.arange(13.0))
    level = rng.uniform(0.8, 1.3, 13)
    size = {"correlated_sd": SIGNAL, "white_sd": WHITE}
    gains = kalman_gains(order, np.exp(-step / LENGTH), level, keep, **size)
    position = np.cumsum(np.where(np.isfinite(step), step, 0.0))
    gap = np.abs(position[:, None] - position)
    signal = np.where(flight[:, None] == flight, SIGNAL**2 * np.exp(-gap / LENGTH), 0.0)
    covariance = (signal + WHITE**2 * np.eye(13)) * level[:, None] * level
    covariance = np.kron(covariance, np.eye(2))
    if anisotropic:
        heading = rng.uniform(0, 2 * np.pi, 13)
        gains = replace(gains, direction=direction_factors(heading, 1 / 0.7, 1 / 1.2))
        root = np.zeros((13, 2, 13, 2))
        for i, a in enumerate(heading):
            along, across = np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])
            root[i, :, i] = 0.7 * np.outer(along, along) + 1.2 * np.outer(across, across)
        root = root.reshape(26, 26)
        covariance = root @ covariance @ root
    return flight, order, gains, covariance


MASKED = np.isin(np.arange(13), [2, 8])


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("columns", [3, 40])  # above 32 columns the memory layout is another
@pytest.mark.parametrize("keep", [None, ~MASKED])
def test_whitening_is_that_of_the_full_covariance(keep, columns, anisotropic):
    _, order, gains, covariance = flights(keep, anisotropic=anisotropic)
    values = np.random.default_rng(1).normal(size=(13, 2, columns))
    white = whiten(values, order, gains)
    used = np.ones(13, bool) if keep is None else keep
    assert not white[~used].any()
    rows = np.repeat(used, 2)
    flat, white = values.reshape(26, -1)[rows], white.reshape(26, -1)[rows]
    expected = flat.T @ np.linalg.solve(covariance[np.ix_(rows, rows)], flat)
    np.testing.assert_allclose(white.T @ white, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("keep", [None, ~MASKED])
def test_interpolation_errors_are_those_of_the_inverse_covariance(keep, anisotropic):
    _, order, gains, covariance = flights(keep, anisotropic=anisotropic)
    values = np.random.default_rng(2).normal(size=(13, 2))
    errors, precision = interpolation_errors(values, order, gains)
    used = np.ones(13, bool) if keep is None else keep
    assert not errors[~used].any() and not precision[~used].any()
    rows = np.repeat(used, 2)
    inverse = np.linalg.inv(covariance[np.ix_(rows, rows)])
    score = (inverse @ values.ravel()[rows]).reshape(-1, 2)
    blocks = [inverse[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(used.sum())]
    expected = [np.linalg.solve(block, row) for block, row in zip(blocks, score, strict=True)]
    np.testing.assert_allclose(errors[used], expected, atol=1e-10)
    if not anisotropic:
        np.testing.assert_allclose(precision[used], [b[0, 0] for b in blocks], rtol=1e-10)


def test_flight_steps_by_hand():
    order = flight_order(np.array([1, 1, 2]), np.array([0.0, 60.0, 0.0]))
    place = np.array([40.0, 41.0, 10.0]), np.array([-90.0, -90.0, 0.0]), np.log([9e4, 8e4, 5e4])
    distance, step = flight_steps(*place, order)
    assert np.isinf(distance[[0, 2]]).all()
    assert distance[1] == pytest.approx(np.radians(1) * 6.371e6, rel=1e-9)
    assert step[1] == pytest.approx(np.log(9 / 8))


@pytest.fixture(scope="module")
def archive():
    frame = make_frame(seed=11, aircraft=8, days=20)
    return frame, fit_noise(frame.residual, exogenous(frame))


def with_gross_errors(archive, aircraft, share, size=20.0, where=True):
    """The archive with normal errors in a share of some aircraft's reports, and its noise."""
    clean, noise = archive
    rng = np.random.default_rng(5)
    hit = np.isin(clean.aircraft, aircraft) & (rng.random(clean.size) < share) & where
    error = hit[:, None] * rng.normal(0, size, (clean.size, 2))
    frame = replace(clean, u_rep=clean.u_rep + error[:, 0], v_rep=clean.v_rep + error[:, 1])
    return frame, replace(noise, gross=gross_errors(frame.residual, noise.order))


@pytest.mark.parametrize(("aircraft", "share"), [([2], 0.01), ([1, 4, 5], 0.03), (range(8), 0.01)])
def test_share_of_gross_errors_and_aircraft(archive, aircraft, share):
    frame, noise = with_gross_errors(archive, aircraft, share)
    entry = outliers(frame, frame.residual, noise)
    assert entry.tails == [frame.tails[a] for a in aircraft]
    assert entry.evidence_nats > 7.0
    count = share * np.isin(frame.aircraft, aircraft).sum()
    assert entry.parameters["fraction"] == pytest.approx(share, abs=3 * share / np.sqrt(count))
    reduction = reduction_of_gross(frame, frame.residual, entry, noise.gross)
    clean, _ = archive
    true = (np.hypot(*frame.residual.T).mean() - np.hypot(*clean.residual.T).mean()) / KNOT
    assert reduction.reduction_ci[0] < true < reduction.reduction_ci[1]


def test_moderate_scatter_is_no_gross_error(archive):
    frame, noise = with_gross_errors(archive, [1, 2], 0.3, size=2.8)
    assert noise.gross.mean() > 0.001
    assert outliers(frame, frame.residual, noise) is None


def test_gross_errors_depend_on_a_variable_or_on_none(archive):
    clean, _ = archive
    variables = record(clean, exogenous(clean))
    high = clean.pressure < np.quantile(clean.pressure, 0.3)
    for where, variable in ((high, "altitude"), (True, None)):
        frame, noise = with_gross_errors(archive, range(8), 0.03, where=where)
        entry = outliers(frame, frame.residual, noise)
        closure = reduction_of_gross(frame, frame.residual, entry, noise.gross)
        place = gross_by_variable(frame, replace(entry, closure=closure), noise.gross, variables)
        assert (place and place.variable) == variable
