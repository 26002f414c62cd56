"""Kernels of the change-points: sums, scores, permutations and dates against plain algebra."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.evaluation.compass_changes.change_kernels import (
    DAY_BIAS_PRECISION,
    FLIGHT_BIAS_PRECISION,
    FREE,
    block_orders,
    coefficients,
    date_of_change,
    day_sums,
    design_of_days,
    largest_statistic,
    orders_of,
    scores,
    without_changes,
)

DAYS, EACH = 40, 60


def reports(seed: int, *, change_deg=(0.0, 0.0, 0.0), at: int = 20, day_bias: float = 0.0):
    """Reports of one aircraft in the linear model itself, A = 1, B = 2, C = -1 degrees."""
    rng = np.random.default_rng(seed)
    day = np.repeat(np.arange(DAYS), EACH)
    heading = rng.uniform(0, 2 * np.pi, day.size)
    magnetic, airspeed = heading + 0.05, rng.normal(120, 5, day.size)
    cross_rows, along_rows = design_of_days(magnetic, heading, airspeed)
    truth = np.radians([1.0, 2.0, -1.0, 0, 0, 0.5, 0, 0, 0.3, 0]) * np.ones((day.size, FREE))
    truth[:, :3] += np.radians(change_deg) * (day >= at)[:, np.newaxis]
    truth[:, -1] = 0.004
    bias = (day_bias * rng.normal(size=(DAYS, 2)))[day]
    theta = np.hstack([truth, bias])
    cross = (cross_rows * theta).sum(1) + rng.normal(0, 2, day.size)
    along = (along_rows * theta).sum(1) + rng.normal(0, 2, day.size)
    return magnetic, heading, airspeed, cross, along, day


def test_day_sums_are_the_mixed_model_solution():
    """Eliminating each day's random bias is ridge regression with the biases' own columns."""
    columns = reports(1, day_bias=1.5)
    values, _ = coefficients(day_sums(*columns))
    magnetic, heading, airspeed, cross, along, day = columns
    one, two = design_of_days(magnetic, heading, airspeed)
    x = np.vstack([one, two])
    y = np.r_[cross, along]
    who = np.r_[day, day]
    design = np.hstack([x[:, :FREE], *[x[:, FREE:] * (who == d)[:, None] for d in range(DAYS)]])
    ridge = np.diag(np.r_[np.zeros(FREE), np.full(2 * DAYS, DAY_BIAS_PRECISION)])
    expected = np.linalg.solve(design.T @ design + ridge, design.T @ y)[:FREE]
    np.testing.assert_allclose(values, expected, atol=1e-8)


def test_a_strong_deviation_hides_no_gross_error():
    magnetic, heading, airspeed, cross, along, day = reports(2, change_deg=(0, 30, 0), at=0)
    wrong = np.abs(np.sin(magnetic)) < 0.02  # where the fit itself is next to nothing
    sums = day_sums(magnetic, heading, airspeed, np.where(wrong, 40.0, cross), along, day)
    assert sums.count.sum() == (~wrong).sum()


def test_sums_by_flight_are_weighed_by_the_covariance_of_a_flights_reports():
    """A day of two flights: X' S^-1 X with the covariance S of reports that share a bias."""
    magnetic, heading, airspeed, cross, along, _ = (column[:7] for column in reports(8))
    flight, day = np.array([4, 9, 4, 9, 4, 4, 9]), np.array([0, 0, 0, 0, 0, 1, 1])
    found = day_sums(magnetic, heading, airspeed, cross, along, day, flight=flight)
    x = np.vstack(design_of_days(magnetic, heading, airspeed))
    y, bias = np.r_[cross, along], x[:, -2:]
    group = np.tile(10 * day + flight, 2)
    shared = (bias @ bias.T) * (group[:, None] == group) / FLIGHT_BIAS_PRECISION
    for number, rows in enumerate((np.r_[0:5, 7:12], np.r_[5:7, 12:14])):
        precision = np.linalg.inv(np.eye(rows.size) + shared[np.ix_(rows, rows)])
        np.testing.assert_allclose(found.normal[number], x[rows].T @ precision @ x[rows], atol=1e-6)
        np.testing.assert_allclose(found.right[number], x[rows].T @ precision @ y[rows], atol=1e-6)
    assert found.count.tolist() == [5.0, 2.0] and found.day.tolist() == [0, 1]


def test_higher_harmonics_stand_after_a_to_e():
    """m = 30 degrees at 100 m/s: 3m = 90, 4m = 120 degrees; no compass moves the airspeed."""
    one = np.array([np.pi / 6.0])
    cross, along = design_of_days(one, one, np.array([100.0]))
    root = np.sqrt(3.0) / 2.0
    expected = [100, 50, 100 * root, 100 * root, 50, 100, 0, 100 * root, -50, 0, root, -0.5]
    np.testing.assert_allclose(cross[0], expected, atol=1e-12)
    np.testing.assert_allclose(along[0], [0] * 9 + [100, 0.5, root], atol=1e-12)


def test_gross_errors_leave_the_sums_alone():
    magnetic, heading, airspeed, cross, along, day = reports(2)
    wrong = np.arange(day.size) % 50 == 0
    sums = day_sums(magnetic, heading, airspeed, np.where(wrong, 80.0, cross), along, day)
    assert sums.count.sum() == (~wrong).sum()


def test_scores_sum_to_nothing_and_shares_to_one():
    score, share = scores(day_sums(*reports(3)))
    np.testing.assert_allclose(score.sum(0), 0.0, atol=1e-6)
    assert share.sum() == pytest.approx(1.0)
    assert (share > 0).all()


def test_the_statistic_is_the_brute_force_one():
    score, share = scores(day_sums(*reports(4, change_deg=(0.5, 0, 0))))
    order = np.arange(DAYS)[np.newaxis]
    inverse = np.linalg.inv(score.T @ score)
    best = 0.0
    for k in range(5, DAYS - 4):
        part = share[:k].sum()
        moved = score[:k].sum(0) - part * score.sum(0)
        if 0.05 <= part <= 0.95:
            best = max(best, moved @ inverse @ moved / (part * (1 - part)))
    found = largest_statistic(score, share, order, trim=0.05, fewest=5)[0]
    assert found == pytest.approx(best / (1 - best / DAYS), rel=1e-9)


def test_permutations_keep_blocks_together_and_every_day_once():
    keys = block_orders(30, block=4, draws=20, rng=np.random.default_rng(0))
    order = np.argsort(keys, axis=1)
    for row in order:
        assert sorted(row) == list(range(30))
        # 30 days in blocks of 4: at least 22 - 8 neighbours stay neighbours.
        assert (np.diff(row) == 1).sum() >= 20
    assert len({tuple(row) for row in order}) == 20


@pytest.mark.parametrize("twice", [[], [3], [0, 11, 19]])
def test_the_orders_of_some_days_are_those_of_all_without_the_others(twice):
    rng = np.random.default_rng(1)
    keys = block_orders(40, block=4, draws=30, rng=rng)
    days = np.sort(rng.choice(40, 20, replace=False))
    days = np.sort(np.append(days, days[twice]))
    found = orders_of(days, np.argsort(keys, axis=1))
    np.testing.assert_array_equal(found, np.argsort(keys[:, days], axis=1, kind="stable"))


def test_taking_a_change_out_leaves_no_step():
    score, share = scores(day_sums(*reports(5, change_deg=(2.0, 0, 0))))
    limits = {"trim": 0.05, "fewest": 5}
    order = np.arange(DAYS)[np.newaxis]
    before = largest_statistic(score, share, order, **limits)[0]
    rest = without_changes(score, share, most=1, **limits)
    after = largest_statistic(rest, share, order, **limits)[0]
    assert before > 100
    assert after < 25


@pytest.mark.parametrize("change", [(2.0, 0.0, 0.0), (0.0, -2.5, 1.0)])
def test_a_clear_change_is_dated_to_the_day_with_its_size(change):
    first, (low, high), size, covariance, statistic = date_of_change(
        day_sums(*reports(6, change_deg=change, at=17, day_bias=1.0)), fewest=5
    )
    assert abs(first - 17) <= 1
    assert low <= 17 <= high
    error = np.sqrt(np.diag(covariance))
    assert (np.abs(size - np.radians(change)) < 4 * error).all()
    assert np.degrees(error).max() < 0.5
    assert statistic > 50


def test_the_interval_of_a_faint_change_holds_its_date():
    inside, wide = 0, []
    for seed in range(60):
        _, (low, high), *_ = date_of_change(
            day_sums(*reports(seed, change_deg=(0.35, 0, 0), day_bias=1.0)), fewest=5
        )
        inside += low <= 20 <= high
        wide.append(high - low)
    # 95 % of 60, less three standard deviations.
    assert inside >= 52
    assert 1 <= np.median(wide) < 25
