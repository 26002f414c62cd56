"""Scores and sums by day against dense columns with what is included taken off."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.gap.sums.beyond import beyond
from airswing.gap.sums.day_scores import day_scores, fleet_day_grams, fleet_day_scores
from airswing.gap.sums.elimination import condition


@pytest.mark.parametrize("fleet", [False, True])
def test_scores_by_day_equal_dense_products_of_what_is_left(made, mixed, fleet):
    layout, stats = made[3], made[4]
    base, included, m, out, day, aircraft, x, r = mixed
    g = m.T @ out(m) + np.diag([j.precision for j in included])
    beta = np.linalg.solve(g, m.T @ out(r))
    pull = np.array([j.precision for j in included]) * beta / stats.days.size
    given = condition(base, included)
    asked = np.r_[layout.columns("compass_offset"), layout.core + np.arange(3)]
    found = fleet_day_scores(given, asked) if fleet else day_scores(given, asked)[2]
    total = given.fleet_score[asked] if fleet else given.score[2, asked]
    scale = np.sqrt(np.diagonal(given.fleet_gram if fleet else given.gram[2])[asked])
    np.testing.assert_allclose(found.sum(axis=0) / scale, total / scale, atol=2e-3)
    own = x[:, asked] * (1.0 if fleet else (aircraft == 2)[:, None])
    share = np.linalg.solve(g, m.T @ out(own))
    each = (own - m @ share) * out(r - m @ beta)[:, None]
    by_day = np.stack([each[day == d].sum(axis=0) for d in range(stats.days.size)])
    by_day += pull @ share
    # of the core: dictionary columns are summed by week
    size = layout.columns("compass_offset").size
    np.testing.assert_allclose(
        found[:, :size] / scale[:size], by_day[:, :size] / scale[:size], atol=5e-3
    )
    weeks = np.unique(stats.week_of_day)
    for w in weeks:
        these = stats.week_of_day == w
        np.testing.assert_allclose(
            found[these].sum(axis=0) / scale, by_day[these].sum(axis=0) / scale, atol=0.1
        )


def test_fleet_sums_by_day_equal_dense_products_of_what_is_left(made, mixed):
    layout, stats = made[3], made[4]
    base, included, m, out, day, _, x, _ = mixed
    g = m.T @ out(m) + np.diag([j.precision for j in included])
    asked = np.r_[layout.columns("compass_offset"), layout.columns("tas_scale")]
    own = x[:, asked]
    share = np.linalg.solve(g, m.T @ out(own))
    left = own - m @ share
    each = left[:, :, None] * out(left)[:, None]
    expected = np.stack([each[day == d].sum(axis=0) for d in range(stats.days.size)])
    pull = np.array([j.precision for j in included])
    expected += (share.T * pull) @ share / stats.days.size
    given = condition(base, included)
    (found,) = fleet_day_grams(given, asked[None])
    size = np.sqrt(np.diagonal(expected.sum(axis=0)))
    scale = np.outer(size, size)
    np.testing.assert_allclose(found / scale, expected / scale, atol=2e-3)
    whole = given.fleet_gram[np.ix_(asked, asked)]
    np.testing.assert_allclose(found.sum(axis=0) / scale, whole / scale, atol=2e-3)
    both = fleet_day_grams(given, asked[:, None])
    np.testing.assert_allclose(both[1, :, 0, 0], found[:, 1, 1])


def test_scores_by_day_are_those_beyond_what_is_projected_out(made, mixed):
    layout = made[3]
    base, included = mixed[:2]
    given = condition(base, included)
    gone, asked = layout.columns("hard_iron"), layout.columns("compass_offset")
    less = beyond(given, gone)
    by_day = day_scores(less, asked)
    np.testing.assert_allclose(by_day.sum(axis=1), less.score[:, asked], atol=1e-3)
    share = np.linalg.lstsq(
        given.gram[0][np.ix_(gone, gone)], given.gram[0][np.ix_(gone, asked)], rcond=None
    )[0]
    expected = day_scores(given, asked)[0] - day_scores(given, gone)[0] @ share
    scale = np.sqrt(given.gram[0][asked[0], asked[0]])
    np.testing.assert_allclose(by_day[0] / scale, expected / scale, atol=0.01)
    fleet = fleet_day_scores(less, asked).sum(axis=0)
    np.testing.assert_allclose(fleet, less.fleet_score[asked], atol=1e-3)
