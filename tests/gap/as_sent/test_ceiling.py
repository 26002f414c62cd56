"""A bound on the speeds sent is found, lifted and closed; what ends by chance is not."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from tests.gap.toy import make_frame
from tests.gap.witness.test_sent_winds import sent_as

from airswing.gap.as_sent.ceiling import _gibbs, ceiling_of
from airswing.gap.diagnose import diagnose
from airswing.gap.effects.empirical import mapped_speed
from airswing.units import KNOT


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=6, aircraft=6, days=14, noise=1.5)


def bounded(frame, knots, aircraft):
    own = np.isin(frame.aircraft, aircraft)

    def cut(speed, direction):
        return np.where(own, np.minimum(speed, knots * KNOT), speed), direction

    return sent_as(frame, cut)


def lost(frame, plain):
    return float(np.hypot(*frame.residual.T).mean() - np.hypot(*plain.residual.T).mean())


def test_speeds_that_end_by_chance_are_no_bound(plain):
    assert ceiling_of(plain) is None
    coarse = sent_as(plain, lambda s, d: (np.round(s / (5 * KNOT)) * 5 * KNOT, d))
    assert ceiling_of(coarse) is None


@pytest.mark.parametrize("aircraft", [(0, 1, 2, 3, 4, 5), (1, 4)])
def test_a_bound_is_found_and_what_it_costs(plain, aircraft):
    speed = np.hypot(plain.u_rep, plain.v_rep) / KNOT
    knots = float(np.round(np.quantile(speed, 0.7)))
    frame = bounded(plain, knots, aircraft)
    found = ceiling_of(frame)
    assert found is not None and found.tails == aircraft
    assert found.values[-1] / KNOT == pytest.approx(knots, abs=0.01)
    true = lost(frame, plain)
    assert abs(found.saved.mean() - true) < max(3 * found.drawn.std(), 0.05 * true)
    untouched = speed < knots - 0.21
    np.testing.assert_allclose(found.lifted.u_rep[untouched], frame.u_rep[untouched])
    lifted = np.hypot(found.lifted.u_rep, found.lifted.v_rep)
    assert (lifted >= np.hypot(frame.u_rep, frame.v_rep) - 1e-9).all()


def test_a_speed_stuck_for_a_day_is_no_bound(plain):
    speed = np.hypot(plain.u_rep, plain.v_rep)
    day = plain.day == np.unique(plain.day)[3]
    limit = np.quantile(speed[day], 0.5)
    stuck = sent_as(plain, lambda s, d: (np.where(day, np.minimum(s, limit), s), d))
    rows = np.flatnonzero(day | (speed < limit - 1.0))
    assert ceiling_of(stuck.take(rows)) is None


def test_order_of_reports_changes_nothing_found(plain):
    frame = bounded(plain, 40.0, range(6))
    order = np.random.default_rng(0).permutation(frame.size)
    found, again = ceiling_of(frame), ceiling_of(frame.take(order))
    assert (found.tails, found.values[:2]) == (again.tails, again.values[:2])
    np.testing.assert_allclose(again.saved, found.saved[order], atol=1e-12)


def test_bounded_values_are_drawn_from_the_truncated_law():
    """One in three bounded: each follows the normal law of its neighbours, cut off below."""
    rng = np.random.default_rng(1)
    count, phi = 30_000, 0.6
    start = np.tile([0.5, 0.2, -0.3], count)
    mask = np.tile([False, True, False], count)
    made = _gibbs(start, mask, np.full(3 * count - 1, phi), rng)[1::3]
    precision = 1 / (1 - phi**2) + phi**2 / (1 - phi**2)
    middle = phi * (0.5 - 0.3) / (1 - phi**2) / precision
    spread = precision**-0.5
    law = stats.truncnorm((0.2 - middle) / spread, np.inf, loc=middle, scale=spread)
    assert made.min() >= 0.2
    assert made.mean() == pytest.approx(law.mean(), abs=5 * law.std() / np.sqrt(count))
    assert made.std() == pytest.approx(law.std(), rel=0.03)


def test_the_diagnosis_tells_the_bound_and_nothing_else(plain):
    frame = bounded(plain, 40.0, range(6))
    report = diagnose(dataclasses.replace(frame), catalogue={}).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert (place.component, place.variables) == ("reported_speed", ["wind_speed"])
    low, high = report.unknown.closure.reduction_ci
    true = lost(frame, plain) / KNOT
    assert low - 0.05 * true <= true <= high + 0.05 * true
    assert report.closure.before == pytest.approx(np.hypot(*frame.residual.T).mean() / KNOT)
    sent = mapped_speed(np.array([10.0, 40.0]), np.array(place.curve.edges[0]), place.curve.values)
    np.testing.assert_allclose(sent, [10.0, 40 * KNOT], rtol=1e-6)
