"""Sums against the dense algebra they stand for, in parts and together."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.sums.conftest import EFFECTS, dense_of
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.layout import make_layout
from airswing.gap.held_out.days_left_out import select_days
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import flight_order, take_gains
from airswing.gap.sums.accumulate import (
    SumColumns,
    accumulate,
    add_reports,
    day_of_report,
    empty_statistics,
    together,
)
from airswing.gap.sums.beyond import beyond
from airswing.gap.sums.elimination import (
    Included,
    climatology,
    condition,
    eliminate_days,
    fit_included,
    fits_by_fold,
)
from airswing.gap.sums.weighted_columns import own_row, weekly_sums
from airswing.physics.splines import hats


def test_sums_equal_dense_products(made):
    frame, _, _, layout, stats = made
    x, r = dense_of(made)
    scale = np.sqrt((x**2).sum(0)) + 1e-9
    total = stats.week_gram.sum(axis=(0, 1))
    np.testing.assert_allclose(
        total / np.outer(scale, scale), x.T @ x / np.outer(scale, scale), atol=2e-5
    )
    np.testing.assert_allclose(stats.day_score.sum(axis=(0, 1)) / scale, x.T @ r / scale, atol=2e-3)
    assert stats.day_count.sum() == (made[1].gains.weight > 0).sum()
    assert stats.day_gram.shape[-1] == layout.core
    assert frame.size > 1000


def test_an_archive_of_two_days_is_counted_by_parts_of_two_hours():
    begin = np.array([7.2, 9.4, 13.9, 31.0]) * 3600.0  # hours of four flights' first reports
    days, clock = day_of_report(SimpleNamespace(flight=np.arange(4), time=begin))
    assert clock.short and clock.hours == 2.0
    assert np.all(clock.begins(days) <= begin) and np.all(begin < clock.begins(days + 1))
    assert np.unique(days).size == 4
    long, clock = day_of_report(SimpleNamespace(flight=np.arange(4), time=begin * 3))
    assert not clock.short and np.unique(long).size < 4


def test_day_fields_and_conditioning_equal_dense_mixed_model(made, mixed):
    layout = made[3]
    base, included, m, out, _, aircraft, x, r = mixed
    g = m.T @ out(m) + np.diag([j.precision for j in included])
    expected = np.linalg.solve(g, m.T @ out(r))
    given = condition(base, included)
    np.testing.assert_allclose(given.coefficients, expected, atol=3e-3)
    np.testing.assert_allclose(fit_included(base, included).coefficients, expected, atol=3e-3)
    own = x[:, layout.columns("compass_offset")[0]] * (aircraft == 2)
    information = own @ out(own) - (own @ out(m)) @ np.linalg.solve(g, m.T @ out(own))
    score = own @ out(r) - (own @ out(m)) @ expected
    j = layout.columns("compass_offset")[0]
    assert given.gram[2, j, j] == pytest.approx(information, rel=1e-3)
    assert given.score[2, j] == pytest.approx(score, rel=5e-3, abs=0.05 * np.sqrt(information))


def test_sums_of_weighted_columns_equal_dense_products(made):
    frame, _, _, layout, stats = made
    x, _ = dense_of(made)
    days, _ = day_of_report(frame)
    day, aircraft = np.repeat(stats.day_index(days), 2), np.repeat(frame.aircraft, 2)
    steady, partly = np.ones((2, *stats.day_count.shape))
    steady[:2] = [[0.0], [0.5]]
    partly[:, : days.max() - days.min() - 3] = 0.0
    inside, outside = int(layout.columns("hard_iron")[0]), layout.core
    assert outside < layout.size
    size = np.sqrt((x**2).sum(axis=0)) + 1e-9

    def weighted(column, weights):
        return x[:, column] * weights[aircraft, day]

    # by day within the core, by week beyond it
    for column, weights, columns in (
        (inside, partly, slice(layout.core)),
        (inside, steady, slice(None)),
        (outside, steady, slice(None)),
    ):
        own = weighted(column, weights) * (aircraft == np.arange(3)[:, None])
        expected = own @ x / size / size[column]
        found = own_row(stats, column, weights) / size / size[column]
        np.testing.assert_allclose(found[:, columns], expected[:, columns], atol=2e-5)
    sums = weekly_sums(
        stats,
        np.array([inside, outside]),
        np.stack([steady, steady]),
        np.full(stats.days.size, True),
    )
    one, other = weighted(inside, steady), weighted(outside, steady)
    np.testing.assert_allclose(sums, [[0.0, one @ other], [one @ other, other @ other]], rtol=1e-4)


def test_fits_by_fold_are_those_of_the_sums_of_their_days(made):
    layout, stats = made[3], made[4]
    base, days = eliminate_days(stats), stats.days.size
    partly, one = np.zeros((2, *stats.day_count.shape))
    partly[:, days // 3 :], one[1] = 1.0, 1.0
    outside = min(layout.core, layout.size - 1)  # weekly sums, of weeks that folds cut
    columns = layout.columns("hard_iron")[0], layout.columns("tas_scale")[0], outside
    for fold in (np.arange(days) % 3, np.arange(days) * 2 // days):
        included = [
            *climatology(base),
            *(Included(int(j), w, 1e-3) for j, w in zip(columns, (partly, one, one), strict=True)),
        ]
        for f, fits in enumerate(fits_by_fold(base, included, fold)):
            for keep, fit in zip((fold != f, fold == f), fits, strict=True):
                part = eliminate_days(select_days(stats, keep), base.variances)
                own = [replace(x, weights=x.weights[:, keep]) for x in included]
                expected = fit_included(part, own)
                np.testing.assert_allclose(fit.gram, expected.gram, rtol=1e-5, atol=1e-4)
                np.testing.assert_allclose(fit.score, expected.score, rtol=1e-6, atol=1e-6)


def test_reports_may_be_added_in_parts(made):
    frame, noise, plan, layout, stats = made
    days, _ = day_of_report(frame)
    both = empty_statistics(layout, stats.tails, np.unique(days), stats.clock)
    for keep in (days < np.median(days), days >= np.median(days)):
        index = np.flatnonzero(keep)
        part = frame.take(index)
        order = flight_order(part.flight, part.time)
        own = NoiseFit(
            noise.model,
            order,
            take_gains(noise.gains, index),
            noise.distance_km,
            noise.autocovariance,
            noise.autocovariance_model,
            noise.pair_count,
            noise.gross[index],
        )
        add_reports(both, part, part.residual, SumColumns(own, layout, EFFECTS, plan), clip=50.0)
    np.testing.assert_array_equal(both.days, stats.days)
    np.testing.assert_allclose(both.day_score, stats.day_score, atol=1e-6)
    np.testing.assert_allclose(both.week_gram, stats.week_gram, rtol=1e-4, atol=1e-3)


def test_beyond_leaves_nothing_of_what_it_projects(made):
    _, _, _, layout, stats = made
    base = eliminate_days(stats)
    given = condition(base, climatology(base))
    columns = layout.columns("hard_iron")
    left = beyond(given, columns)
    j = columns[0]
    assert abs(left.gram[0, j, j]) < 1e-3 * given.gram[0, j, j]
    other = layout.columns("tas_scale")[0]
    assert left.gram[0, other, other] <= given.gram[0, other, other] * (1 + 1e-9)


def test_hats_sum_to_one_and_hit_their_knots():
    knots = np.array([1.0, 2.0, 4.0])
    values = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 9.0, np.nan])
    out = hats(values, knots)
    np.testing.assert_allclose(out[:, :-1].sum(0), 1.0)
    np.testing.assert_allclose(out[:, 2], [0.5, 0.5, 0.0])
    np.testing.assert_allclose(out[:, 4], [0.0, 0.5, 0.5])
    np.testing.assert_allclose(out[:, -1], 0.0)


def test_days_of_a_long_archive_are_taken_together():
    np.testing.assert_array_equal(
        together(np.arange(14300, 14345), 14, 3600), np.arange(14300, 14345)
    )
    year = together(np.arange(14245, 14610), 60, 3600)
    assert 40 < year.size <= 60
    assert np.unique(np.diff(year)).tolist() == [7]
    one = together(np.arange(10), 10_000, 3600)
    assert one.size == 1


def test_sums_of_days_together_are_the_sums_of_the_days(monkeypatch):
    columns = exogenous(make_frame(seed=2, aircraft=3, days=16))
    noise, plan = noise_of(columns), plan_dictionary(columns)
    made = {}
    for most in (10_000, 12):
        monkeypatch.setattr("airswing.gap.sums.accumulate.AIRCRAFT_DAYS", most)
        made[most] = accumulate(
            columns,
            columns.residual,
            SumColumns(noise, make_layout(EFFECTS, plan, columns), EFFECTS, plan),
        )
    fine, coarse = made[10_000], made[12]
    assert coarse.days.size <= 4 < fine.days.size
    for name in ("day_gram", "day_score", "day_count", "day_energy", "day_cross"):
        one, two = getattr(fine, name), getattr(coarse, name)
        scale = 1e-5 * np.abs(one).sum(axis=1).max()
        np.testing.assert_allclose(one.sum(axis=1), two.sum(axis=1), rtol=1e-3, atol=scale)
    place = coarse.day_index(fine.days)
    np.testing.assert_allclose(
        np.stack([fine.day_count[:, place == k].sum(axis=1) for k in range(coarse.days.size)], 1),
        coarse.day_count,
    )
    assert set(coarse.week_of_day) == set(range(coarse.weeks.size))
