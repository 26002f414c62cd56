"""Shares of wind effects that an estimate holds: the operator, the instrument, the closure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.candidates import candidates
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.layout import effect_columns, make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import evaluate, evaluate_each, fleet_allowance
from airswing.gap.evidence.term_covariance import (
    term_covariance,
    term_covariances,
    term_offsets,
)
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.attenuation import (
    _regressed,
    _shrunk,
    readout_factors,
    with_large_scale_tendency,
)
from airswing.gap.held_out.reduction import retimed, whole_coefficients
from airswing.gap.sums.accumulate import SumColumns, accumulate
from airswing.gap.sums.elimination import climatology, condition, eliminate_days
from airswing.gap.sums.problem import Problem
from airswing.gap.sums.variance_components import shared_variances

EFFECTS = {
    n: CATALOGUE[n]
    for n in ("compass_offset", "altitude_offset", "reference_speed_bias", "declination_error")
}


@pytest.fixture(scope="module")
def made():
    frame = make_frame(seed=6, aircraft=5, days=14)
    columns_frame = exogenous(frame)
    noise = noise_of(frame, columns_frame)
    plan = plan_dictionary(columns_frame)
    plan = replace(plan, groups=())
    layout = make_layout(EFFECTS, plan, columns_frame)
    stats = accumulate(columns_frame, frame.residual, SumColumns(noise, layout, EFFECTS, plan))
    base = eliminate_days(stats, shared_variances(stats))
    return Problem(frame, columns_frame, EFFECTS, plan, noise, base, frame.size, 1)


def _term(base, name, subset, tails):
    given = condition(base, climatology(base))
    pool = candidates(base.stats.layout, EFFECTS)
    chosen = next(
        c
        for c in pool
        if c.name == name and c.subset == subset and (c.scope == "fleet") == (tails is None)
    )
    everyone = tuple(range(len(base.stats.tails)))
    return Term(
        chosen, everyone if tails is None else tails, None, evaluate(base.stats, given, chosen)
    )


def test_share_of_a_column_scaled_down_is_the_scale(made):
    columns_frame, base = made.context, made.base
    term = _term(base, "reference_speed_bias", (4,), None)
    effect = EFFECTS["reference_speed_bias"]
    x = 0.7 * effect_columns(columns_frame, effect)[4]
    share, error = _regressed(made, columns_frame, x, term, effect)
    assert share == pytest.approx(0.7, rel=2e-3)
    assert 0 < error < 0.1


def test_share_of_an_effect_on_the_references_own_wind(made):
    base = made.base
    term = _term(base, "reference_speed_bias", (4,), None)
    values = [np.array([[0.05]])]
    share, doubts = readout_factors(made, [term], values)
    assert 0.6 < share["reference_speed_bias"] < 1.3
    assert doubts == {}
    again, _ = readout_factors(made, [term], values, again=True)
    left = (1 - share["reference_speed_bias"]) ** 2
    assert again["reference_speed_bias"] == pytest.approx(1 - left)
    offset = _term(base, "compass_offset", (0,), (1,))
    assert readout_factors(made, [offset], values) == ({}, {})


def test_tendency_of_the_large_scale_reported_wind():
    frame = make_frame(seed=2, aircraft=4, days=4)
    x = frame.longitude - frame.longitude.mean()
    rate = 3e-4 + 2e-5 * x
    since = frame.time - frame.time.mean()
    made = with_large_scale_tendency(
        replace(frame, u_rep=8.0 + rate * since, v_rep=2.0 + 0.5 * x + 0.0 * since)
    )
    assert np.median(np.abs(made.dudt / rate - 1)) < 0.03
    assert np.median(np.abs(made.dvdt)) < 1e-5


def test_a_share_told_badly_is_drawn_to_one():
    assert _shrunk(0.5, 0.0) == pytest.approx((0.5, 0.0))
    assert _shrunk(0.5, 0.4) == pytest.approx((np.sqrt(0.5), 0.4 / np.sqrt(2)))
    assert _shrunk(0.5, 1e3) == pytest.approx((1.0, 0.4), abs=1e-3)
    assert _shrunk(-0.2, 0.1) == (1.0, 0.4)


def test_retimed_fields_take_off_their_covariance():
    residual = np.array([[3.0, 4.0], [0.0, 5.0], [1.0, 0.0]])
    linear = np.array([[1.08, 1.44], [0.0, 1.8], [0.0, 1.0]])
    error = retimed(residual, linear, np.array([0, 0, 1]))
    np.testing.assert_allclose(error[:2], 0.2 * residual[:2])
    np.testing.assert_allclose(error[2], 0.0, atol=1e-12)


def test_coefficients_are_made_whole(made):
    term = _term(made.base, "altitude_offset", (0,), (0, 2))
    whole = whole_coefficients([np.array([[2.0], [4.0]])], [term], {"altitude_offset": 0.8})
    np.testing.assert_allclose(whole[0], [[2.5], [5.0]])
    np.testing.assert_allclose(whole_coefficients([np.eye(2)], [term], None)[0], np.eye(2))


def test_persistent_error_is_allowed_for_where_the_climatology_reaches(made):
    base = made.base
    given = condition(base, climatology(base))
    layout = base.stats.layout
    wind = fleet_allowance(given, layout.columns("reference_speed_bias")[:1])
    turned = fleet_allowance(given, layout.columns("declination_error")[1:])
    assert turned < 0.5 * wind < 0.09


def test_what_lasts_is_also_tried_for_all_aircraft_and_what_has_a_date_is_not(made):
    effects = EFFECTS | {"compass_step": CATALOGUE["compass_step"]}
    layout = make_layout(effects, made.plan, made.context)
    scopes = {}
    for one in candidates(layout, effects):
        scopes.setdefault(one.name, set()).add(one.scope)
    assert scopes["altitude_offset"] == scopes["compass_offset"] == {"aircraft", "fleet"}
    assert scopes["compass_step"] == {"aircraft"}
    assert scopes["reference_speed_bias"] == {"fleet"}


def test_candidates_weighed_together_are_those_weighed_alone(made):
    base = made.base
    given = condition(base, climatology(base))
    pool = candidates(base.stats.layout, EFFECTS)
    assert len({(c.scope, c.columns.size) for c in pool}) == 3
    free = [np.arange(len(base.stats.tails)) != n % 7 for n in range(len(pool))]
    together = evaluate_each(base.stats, given, pool, allowed=free)
    for candidate, may, score in zip(pool, free, together, strict=True):
        alone = evaluate(base.stats, given, candidate, allowed=may)
        assert score.candidate is candidate
        assert (score.tempered, score.raw) == pytest.approx((alone.tempered, alone.raw), abs=1e-9)
        np.testing.assert_allclose(score.estimate, alone.estimate, atol=1e-10)
        np.testing.assert_allclose(score.posterior, alone.posterior, atol=1e-10)


def test_the_covariance_of_a_term_is_that_of_its_own_coefficients(made):
    base = made.base
    terms = [_term(base, "compass_offset", (0,), tails) for tails in ((0,), (1, 3))]
    terms = [replace(t, score=replace(t.score, factor=1.5, background=0.1)) for t in terms]
    given = given_terms(base, terms)
    assert term_offsets(given, terms) == [given.coefficients.size - 3, given.coefficients.size - 2]
    start = term_offsets(given, terms)[1]
    formal, allowed = term_covariances(base.stats, given, terms[1], start, 1)
    assert formal.item() == pytest.approx(1.5 * given.covariance[-1, -1])
    column = terms[1].candidate.columns[0]
    energy = base.stats.raw_gram[3, column, column] / base.stats.acting[3, column]
    # 0.1 m/s where it acts; a fiftieth is added for directions in which a candidate hardly acts
    assert allowed.item() == pytest.approx(0.1**2 / energy / 1.02, rel=1e-6)
    both = term_covariance(base.stats, given, terms[1], start, 1)
    np.testing.assert_allclose(both, formal + allowed)
