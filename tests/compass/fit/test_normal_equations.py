import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

import airswing  # noqa: F401
from airswing.compass.fit.normal_equations import (
    LOCAL,
    Scatter,
    _robust_scatter,
    accumulate,
)
from airswing.compass.fit.observations import Reports
from airswing.compass.fit.row_blocks import fill, rows_for
from airswing.compass.fit.sandwich import degrees_of_freedom, influences, inverse_root


def vector_reports(theta_deg, rng, n=400, noise=0.0, flights=20):
    """Reports that obey the vector equation, made from components alone."""
    a, b, c, d, e, s, bu, bv = theta_deg
    psi = rng.uniform(0, 360, n)
    m = psi + 4.0
    x = np.radians(m)
    delta = a + b * np.sin(x) + c * np.cos(x) + d * np.sin(2 * x) + e * np.cos(2 * x)
    v = rng.uniform(90, 130, n)
    true = np.radians(psi - delta)
    implied = (v * (1 - s))[:, None] * np.column_stack([np.sin(true), np.cos(true)])
    implied += -np.array([bu, bv]) + noise * rng.normal(size=(n, 2))
    error = (psi - np.degrees(np.arctan2(*implied.T)) + 180) % 360 - 180
    flight = np.sort(rng.integers(0, flights, n))
    return Reports(psi, m, v, error, v - np.hypot(*implied.T), np.full(n, 0.1), flight)


THETA = (1.0, 8.0, -6.0, 1.5, -1.0, 0.02, 0.6, -0.5)


def radians(theta):
    found = np.array(theta, float)
    found[:5] = np.radians(found[:5])
    return found


def residuals(obs, theta, joint):
    """Vector residual along and across the fitted true heading, m/s."""
    rows = rows_for(obs.size)
    fill(obs, theta, joint, rows)
    return rows.along[0].copy(), rows.cross[7].copy()


def test_residual_vanishes_at_the_truth_for_ten_degrees_of_deviation():
    reports = vector_reports(THETA, np.random.default_rng(0))
    along, cross = residuals(reports.take(slice(None)), radians(THETA), True)
    assert np.abs(along).max() < 1e-4
    assert np.abs(cross).max() < 1e-4


def test_iron_turns_the_compass_more_where_the_field_is_weak():
    rng, n = np.random.default_rng(9), 500
    psi, gain, speed = rng.uniform(0, 360, n), rng.uniform(0.8, 1.25, n), rng.uniform(90, 130, n)
    x = np.radians(psi)
    delta = 1.0 + gain * (8.0 * np.sin(x) - 6.0 * np.cos(x)) + 1.5 * np.sin(2 * x) - np.cos(2 * x)
    implied = speed * np.array([np.sin(x - np.radians(delta)), np.cos(x - np.radians(delta))])
    error, slow = np.degrees(x - np.arctan2(*implied)), speed - np.hypot(*implied)
    error = (error + 180) % 360 - 180
    flight = np.sort(rng.integers(0, 20, n))
    reports = Reports(psi, psi, speed, error, slow, np.full(n, 0.1), flight, gain)
    at = radians((1.0, 8.0, -6.0, 1.5, -1.0, 0.0, 0.0, 0.0))
    along, cross = residuals(reports.take(slice(None)), at, True)
    assert np.abs(along).max() < 1e-4
    assert np.abs(cross).max() < 1e-4
    start = at + radians((0.2, -0.5, 0.5, 0.1, 0.1, 0.0, 0.0, 0.0))
    sums = accumulate(reports, start, Scatter(1e8, 1e8, 0.0), 20, joint=True)
    found = start + np.linalg.solve(sums.normal, sums.score)
    assert np.degrees(found[:5]) == pytest.approx([1.0, 8.0, -6.0, 1.5, -1.0], abs=0.01)


def test_one_report_by_hand():
    # heading north, the model's air vector 100 m/s toward 350: heading error +10 degrees
    one = Reports(
        *(np.array([value]) for value in (0.0, 0.0, 100.0, 10.0, 0.0, 0.0)), np.array([0])
    )
    along, cross = residuals(one.take(slice(None)), np.zeros(LOCAL), True)
    assert along[0] == pytest.approx(100 * np.cos(np.radians(10)) - 100, abs=1e-4)
    assert cross[0] == pytest.approx(-100 * np.sin(np.radians(10)), abs=1e-4)
    # a bias of (1, 2) m/s of the reference adds its east part across, its north part along
    bias = np.array([0, 0, 0, 0, 0, 0, 1.0, 2.0])
    more = residuals(one.take(slice(None)), bias, True)
    assert more[0][0] - along[0] == pytest.approx(2, abs=1e-5)
    assert more[1][0] - cross[0] == pytest.approx(1, abs=1e-5)


def test_normal_equations_against_a_numerical_derivative():
    reports = vector_reports(THETA, np.random.default_rng(1), noise=1.0)
    obs, theta = reports.take(slice(None)), radians(THETA)
    scatter = Scatter(1e8, 1e8, 0.0)  # so wide that every robust weight is one

    def stacked(at):
        along, cross = residuals(obs, at, True)
        return np.concatenate([along, cross]).astype(float)

    sums = accumulate(reports, theta, scatter, 20, joint=True)
    step = np.diag([2e-3] * 5 + [1e-3, 0.1, 0.1])
    jacobian = np.column_stack(
        [(stacked(theta + h) - stacked(theta - h)) / (2 * h.max()) for h in step]
    )
    expected = jacobian.T @ jacobian / 1e8
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # the derivative of the frame times the small residual is left out by Gauss and Newton
    assert np.abs(sums.normal - expected).max() / size.max() < 0.02
    assert np.all(np.abs(sums.normal - expected) < 0.03 * size)
    score = -jacobian.T @ stacked(theta) / 1e8
    assert np.allclose(sums.score, score, atol=0.03 * np.sqrt(np.diag(expected)).max() / 1e4 * 20)
    assert np.allclose(sums.flight_score.sum(axis=0), sums.score, rtol=1e-3, atol=1e-6)


def test_gross_error_weighs_nothing():
    reports = vector_reports(THETA, np.random.default_rng(2), n=50, noise=1.0)
    error = reports.heading_error.copy()
    error[7] += 120.0
    bad = Reports(
        reports.heading,
        reports.abscissa,
        reports.airspeed,
        error,
        reports.airspeed_error,
        reports.standard_error,
        reports.flight,
    )
    keep = np.arange(50) != 7
    without = Reports(*(getattr(reports, name)[keep] for name in Reports.__dataclass_fields__))
    scatter = Scatter(1.0, 1.0, 0.0)
    one = accumulate(bad, radians(THETA), scatter, 20, joint=True)
    two = accumulate(without, radians(THETA), scatter, 20, joint=True)
    assert np.allclose(one.normal, two.normal, rtol=1e-4, atol=0.5)
    assert np.allclose(one.score, two.score, rtol=1e-4, atol=0.05)


def test_sums_of_flights_add_up_across_blocks():
    reports = vector_reports(THETA, np.random.default_rng(3), n=40_000, noise=1.0, flights=900)
    sums = accumulate(
        reports, radians(THETA), Scatter(1.0, 1.0, 0.0), 900, joint=True, by_flight=True
    )
    assert np.allclose(sums.flight_normal.sum(axis=0), sums.normal, rtol=1e-3, atol=1.0)
    assert np.allclose(sums.flight_score.sum(axis=0), sums.score, rtol=1e-3, atol=1.0)
    part = reports.flight == 450
    one = Reports(*(getattr(reports, name)[part] for name in Reports.__dataclass_fields__))
    alone = accumulate(one, radians(THETA), Scatter(1.0, 1.0, 0.0), 900, joint=True)
    assert np.allclose(sums.flight_normal[450], alone.normal, rtol=1e-4, atol=1e-3)


def test_scatter_tells_known_from_unknown_variance():
    rng = np.random.default_rng(4)
    n = 20_000
    known = np.where(np.arange(n) % 2 == 0, 1.0, 4.0)
    reports = vector_reports((0,) * 8, rng, n=n)
    noise = rng.normal(size=n) * np.sqrt(4.0 + known**2)
    error = np.degrees(noise / reports.airspeed)
    made = Reports(
        reports.heading,
        reports.abscissa,
        reports.airspeed,
        error,
        2.0 * rng.normal(size=n),
        np.degrees(known / reports.airspeed),
        reports.flight,
    )
    obs = made.take(slice(None))
    scatter = _robust_scatter(*residuals(obs, np.zeros(8), True), obs.variance)
    assert scatter.part == pytest.approx(1.0, abs=0.1)
    assert scatter.cross == pytest.approx(4.0, rel=0.15)
    assert scatter.along == pytest.approx(4.0 - 1.0, rel=0.15)  # the known part is in both


@given(st.permutations(range(60)))
def test_order_of_rows_does_not_matter(order):
    reports = vector_reports(THETA, np.random.default_rng(6), n=60, noise=1.0, flights=9)
    mixed = Reports(*(getattr(reports, name)[list(order)] for name in Reports.__dataclass_fields__))
    scatter = Scatter(2.0, 2.0, 0.0)
    one = accumulate(reports, radians(THETA), scatter, 9, joint=True)
    two = accumulate(mixed.sorted(), radians(THETA), scatter, 9, joint=True)
    assert np.allclose(one.normal, two.normal, rtol=1e-4, atol=0.1)
    assert np.allclose(one.flight_score, two.flight_score, rtol=1e-3, atol=0.05)


def test_unit_weights_give_least_squares():
    reports = vector_reports(THETA, np.random.default_rng(7), n=300, noise=1.5)
    obs = reports.take(slice(None))

    def stacked(at):
        along, cross = residuals(obs, at, True)
        return np.concatenate([along, cross]).astype(float)

    best = least_squares(
        stacked, radians(THETA), x_scale=[0.01] * 6 + [1, 1], diff_step=1e-3, xtol=1e-12
    ).x
    theta = np.zeros(8)
    for _ in range(8):
        sums = accumulate(reports, theta, Scatter(1e8, 1e8, 0.0), 20, joint=True)
        theta = theta + np.linalg.solve(sums.normal, sums.score)
    assert np.degrees(theta[:5]) == pytest.approx(np.degrees(best[:5]), abs=0.01)
    assert theta[6:] == pytest.approx(best[6:], abs=0.02)


def test_cr2_is_unbiased_where_the_working_model_holds():
    rng = np.random.default_rng(8)
    x = np.column_stack([np.ones(60), rng.normal(size=60)])
    cluster = np.repeat(np.arange(6), 10)
    normals = np.array([x[cluster == g].T @ x[cluster == g] for g in range(6)])
    normal = normals.sum(axis=0)
    found = np.zeros((2, 2))
    for _ in range(3000):
        y = rng.normal(size=60)
        residual = y - x @ np.linalg.solve(normal, x.T @ y)
        score = np.array([x[cluster == g].T @ residual[cluster == g] for g in range(6)])
        influence = influences(score, inverse_root(normal), normals, 1.0)
        found += influence.T @ influence / 3000
    assert np.diag(found) == pytest.approx(np.diag(np.linalg.inv(normal)), rel=0.06)
    assert np.all(degrees_of_freedom(normal, normals, 6) <= 5)
    even = np.array([np.eye(2)] * 6)
    assert degrees_of_freedom(even.sum(axis=0), even, 6) == pytest.approx([5, 5])
