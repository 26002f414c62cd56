"""Variances of day fields and climatology: recovered, not raised by what lasts or by an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import DictionaryPlan, plan_dictionary
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.layout import build_columns, make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise.whitening import whiten
from airswing.gap.sums.accumulate import SumColumns, accumulate, day_of_report
from airswing.gap.sums.variance_components import (
    LEAST_CLIMATOLOGY,
    lasting_prior,
    shared_prior,
    shared_variances,
)

EFFECTS = {n: CATALOGUE[n] for n in ("compass_offset", "altitude_offset", "reference_speed_bias")}
TRUE = np.tile([0.6, 0.3, 0.3, 0.2, 0.05, 0.05, 0.05, 0.1, 0.1, 0.05], 2)


@pytest.fixture(scope="module")
def made():
    frame = exogenous(make_frame(seed=4, aircraft=5, days=24))
    noise = noise_of(frame)
    plan = plan_dictionary(frame)
    plan = DictionaryPlan(plan.knots, (), plan.centre, plan.means, plan.flags)
    layout = make_layout(EFFECTS, plan, frame)
    stats = accumulate(frame, frame.residual, SumColumns(noise, layout, EFFECTS, plan))
    raw = build_columns(frame, layout, EFFECTS, plan).astype(float).T
    white = whiten(raw, noise.order, noise.gains).reshape(-1, layout.size)
    days, _ = day_of_report(frame)
    return frame, layout, stats, white, np.searchsorted(stats.days, days)


def _with_residual(made, residual):
    """Sums with another whitened residual (2n,)."""
    frame, layout, stats, white, day = made
    score = np.zeros_like(stats.day_score)
    products = (white * residual[:, None]).reshape(-1, 2, layout.size).sum(axis=1)
    np.add.at(score, (frame.aircraft, day), products)
    return replace(stats, day_score=score)


def _drawn(made, seed):
    """Whitened residual of day fields of the true variances, and unit noise."""
    _, _, stats, white, day = made
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(stats.days.size, TRUE.size)) * np.sqrt(TRUE)
    fields = np.einsum("iq,iq->i", white[:, : TRUE.size], coefficients[np.repeat(day, 2)])
    return fields + rng.normal(size=fields.size)


def test_variances_are_recovered(made):
    drawn = [shared_variances(_with_residual(made, _drawn(made, s))) for s in range(6)]
    ratios = np.mean([v.day for v in drawn], 0)
    assert np.mean(ratios / TRUE) == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(ratios[[0, 10]], TRUE[[0, 10]], rtol=0.4)


def test_a_lasting_error_and_an_effect_do_not_pass_for_weather(made):
    _, layout, _, white, _ = made
    drawn = _drawn(made, 3)
    bare = shared_variances(_with_residual(made, drawn)).day
    bias = white[:, layout.columns("climatology")[0]] * 3.0
    biased = shared_variances(_with_residual(made, drawn + bias)).day
    np.testing.assert_allclose(biased, bare, rtol=0.1)
    effect = white[:, layout.columns("reference_speed_bias")[4]] * 0.2
    stats = _with_residual(made, drawn + effect)
    beside = shared_prior(layout, EFFECTS)
    assert np.max(shared_variances(stats).day / bare) > 1.5
    np.testing.assert_allclose(shared_variances(stats, beside).day, bare, rtol=0.3, atol=0.02)


def test_which_columns_may_be_taken_for_weather(made):
    _, layout, *_ = made
    columns, precision = shared_prior(layout, EFFECTS)
    expected = [*layout.columns("altitude_offset"), *layout.columns("reference_speed_bias")]
    assert columns.tolist() == [int(j) for j in expected]
    scale = CATALOGUE["reference_speed_bias"].column_scales[0]
    assert precision[-1] == pytest.approx(1 / scale**2)
    many = layout.columns("climatology").size
    lasting, precision = lasting_prior(layout, np.full(many, 0.25))
    assert lasting.size == layout.columns("climatology").size + 2
    assert precision[0] == pytest.approx(4.0)


def test_the_size_of_the_climatology_is_recovered(made):
    _, layout, _, white, _ = made
    columns = layout.columns("climatology")
    found = []
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        drawn = _drawn(made, seed) + white[:, columns] @ rng.normal(0, 1.0, columns.size)
        variances = shared_variances(_with_residual(made, drawn)).climatology
        found.append(np.sqrt(1 / np.mean(1 / variances)))
    assert np.mean(found) == pytest.approx(1.0, rel=0.25)


def test_a_reference_without_climatology_is_not_given_much(made):
    found = [
        np.median(shared_variances(_with_residual(made, _drawn(made, seed))).climatology)
        for seed in range(6)
    ]
    assert LEAST_CLIMATOLOGY**2 <= np.median(found) < 0.15**2
