"""What sets in on a date: sums by window against plain ones, and archives in which it does."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import candidates
from airswing.gap.diagnose import diagnose, usable_effects
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.change_windows import windows, windows_tried
from airswing.gap.evidence.terms import day_factors, given_terms
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.candidate_ranking import evaluate_named
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

CHANGING = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "compass_drift")}
RATE = 0.25  # degrees a day
SETS_IN = 22


def setting_in(context):
    days = (context["time"] - context["time"].min()) / 86400 - SETS_IN
    return np.where(context["aircraft"] < 2, np.radians(RATE) * np.maximum(days, 0.0), 0.0)


def fleet(seed=0, error=setting_in):
    return make_frame(seed=seed, aircraft=7, days=30, noise=1.0, heading_error=error)


@pytest.fixture(scope="module")
def summed():
    """Sums of the archive, and the drift that sets in among its candidates."""
    archive = held_archive(fleet())
    effects, _ = usable_effects(archive.view, CHANGING)
    base = run_pass(archive, Search(effects, Rules(), False, 0, lambda *a: None)).problem.base
    pool = candidates(base.stats.layout, effects, dictionary=False)
    (onset,) = [c for c in pool if c.kind == "onset"]
    return base, onset


@settings(max_examples=20, deadline=None)
@drawn(steps=st.lists(st.integers(1, 9), min_size=32, max_size=32))
def test_sums_by_window_are_those_of_the_days_since(summed, steps):
    base, onset = summed
    days = 14_000 + np.cumsum([0, *steps])[: base.stats.days.size]
    tried, prior = windows_tried(replace(base.stats, days=days), onset, None)
    by_day = np.random.default_rng(sum(steps)).normal(size=(days.size, 2, 2))
    assert np.exp(prior).sum() == pytest.approx(1.0)
    for power in (1, 2):
        sums = tried.sums(by_day, power)
        for own, (first, last) in zip(sums[:-1], tried.windows[:-1], strict=True):
            assert last == days.size
            factors = day_factors(onset, (first, last), days)
            np.testing.assert_allclose(own, np.tensordot(factors**power, by_day, 1), atol=1e-6)
        np.testing.assert_allclose(sums[-1], by_day.sum(axis=0), atol=1e-9)


def test_windows_lie_inside_and_are_long_enough():
    pairs = windows(20)
    assert (pairs[:, 1] - pairs[:, 0] >= 3).all()
    assert not ((pairs[:, 0] == 0) & (pairs[:, 1] == 20)).any()
    assert {tuple(p) for p in pairs} >= {(0, 10), (10, 20), (5, 12)}
    assert len(windows(400)) < 2500


def test_what_sets_in_grows_from_nothing_across_days_without_reports():
    (onset,) = [c for c in _pool() if c.kind == "onset"]
    days = np.array([100, 101, 102, 103, 110, 111])
    assert day_factors(onset, (2, 6), days).tolist() == [0, 0, 0.5, 1.5, 8.5, 9.5]
    assert day_factors(replace(onset, kind="step"), (2, 6), days).tolist() == [0, 0, 1, 1, 1, 1]


def _pool():
    archive = held_archive(make_frame(seed=1, aircraft=3, days=8))
    effects, _ = usable_effects(archive.view, CHANGING)
    made = run_pass(archive, Search(effects, Rules(), False, 0, lambda *a: None))
    return candidates(made.problem.base.stats.layout, effects, dictionary=False)


def test_its_evidence_is_of_the_two_and_its_date_theirs(summed):
    base, onset = summed
    score = evaluate_named(base, given_terms(base, []), onset, np.ones(7, bool), None)
    assert abs(score.period[0] - SETS_IN) <= 1
    assert set(np.flatnonzero(score.posterior > 0.9)) == {0, 1}
    # on eight days from nothing to two degrees at about 120 m/s
    assert score.size[:2] == pytest.approx(120 * np.radians(RATE * 8) / np.sqrt(3), rel=0.3)
    later = replace(onset, kind="step")
    step = evaluate_named(base, given_terms(base, []), later, np.ones(7, bool), None)
    assert score.raw > step.raw + 3.0


def test_a_drift_that_sets_in_is_told_with_its_date_and_what_it_closes():
    frame = fleet()
    report = diagnose(frame, catalogue=CHANGING, dictionary=False).report
    (effect,) = report.effects
    assert (effect.name, effect.tails) == ("compass_drift", list(frame.tails[:2]))
    error = effect.standard_errors["rate_deg_per_day"]
    assert effect.parameters["rate_deg_per_day"] == pytest.approx(RATE, abs=3 * error)
    assert 0.0 < error < 0.2 * RATE
    assert effect.period[1] is None
    # its days lie in two weeks: those left out are single ones
    assert report.closure.reduction > 0.5 * (report.closure.before - _closed(frame))


def _closed(frame):
    """Disagreement in kt with the error itself taken off."""
    days = np.maximum((frame.time - frame.epoch) / 86400 - SETS_IN, 0.0)
    turn = np.where(frame.aircraft < 2, np.radians(RATE) * days, 0.0)
    across = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], axis=1)
    left = frame.residual + (frame.airspeed * turn)[:, None] * across
    return float(np.hypot(*left.T).mean()) * 3600 / 1852


def test_a_step_as_late_stays_a_step():
    def stepping(context):
        late = context["time"] - context["time"].min() > SETS_IN * 86400
        return np.where((context["aircraft"] < 2) & late, np.radians(1.0), 0.0)

    report = diagnose(fleet(error=stepping), catalogue=CHANGING, dictionary=False).report
    assert [e.name for e in report.effects] == ["compass_step"]
