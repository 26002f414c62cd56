"""What is off between two dates: of the whole fleet, and of some aircraft beside the others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm
from tests.gap.toy import make_frame
from tests.gap.witness.test_learned import setting_of

from airswing.gap.archive.other_winds import without
from airswing.gap.archive.value_tables import Axis, Grid
from airswing.gap.witness.bench import PERSISTENT, Bench
from airswing.gap.witness.fitted_tables import LEAST_EVIDENCE, field_of, fitted, stands
from airswing.gap.witness.periods import SHORTEST, _likeliest, _starts, periods
from airswing.gap.witness.scan import SIZES
from airswing.gap.witness.unknowns import edged, weighed


def test_every_period_is_weighed_beside_what_is_there_on_all_days():
    rng = np.random.default_rng(3)
    half = rng.normal(size=(12, 9))
    gram, score, factor = half.T @ half + np.eye(9), rng.normal(size=9) * 9, 1.6
    told = {}
    for first in range(10):
        for last in range(first + SHORTEST, min(9, first + 9 - SHORTEST) + 1):
            inside = np.isin(np.arange(9), np.arange(first, last)).astype(float)
            inside -= (gram @ inside).sum() / gram.sum()
            square, here = inside @ gram @ inside / factor, inside @ score / factor
            sd = np.sqrt(square + square**2 * (PERSISTENT**2 + np.r_[0.0, SIZES] ** 2))
            density = norm.logpdf(here, scale=sd)
            told[first, last] = logsumexp(density[1:] - density[0]) - np.log(SIZES.size)
    made = _likeliest("across_wind", gram, score, factor)
    assert (made.first, made.last) == max(told, key=lambda key: told[key])
    assert made.nats == pytest.approx(logsumexp(list(told.values())) - np.log(len(told)))


def test_a_period_of_all_aircraft_has_its_days_and_none_is_where_none_was():
    frame = make_frame(seed=6, aircraft=3, days=16, noise=0.3, model_error=1.0)
    day = setting_of(frame).day
    turned = np.radians(8.0) * ((day >= 5) & (day < 10))[:, None]
    wind = np.stack([frame.v_ref, -frame.u_ref], -1)
    for archive, raised in ((without(frame, frame.residual + turned * wind), True), (frame, False)):
        bench = Bench.of(setting_of(archive), archive.residual)
        best = periods(bench)[0]
        assert (best.nats > LEAST_EVIDENCE) is raised
        if not raised:
            assert not any("date" in one.grid.variables for one in edged(bench))
            continue
        assert (best.component, best.first, best.last) == ("across_wind", 5, 10)
        cut = edged(bench)[0]
        assert cut.strength > LEAST_EVIDENCE and cut.by_means
        own = replace(weighed(bench, cut.grid, "wind_angle"), by_means=True)
        table = fitted(bench, own, np.arange(day.max() + 1) // 7)
        assert stands(table)
        assert table.values[0] == pytest.approx([0, 8, 0], abs=2.0)


def test_a_saw_by_date_of_some_aircraft_is_told_by_the_others_of_the_day():
    """No other day tells what a cell at its jump holds: every other flight does."""
    frame = make_frame(seed=6, aircraft=6, days=18, noise=0.3, model_error=1.0)
    setting = setting_of(frame)
    along = np.stack([np.sin(frame.heading), np.cos(frame.heading)], -1)
    saw = 2.0 * (setting.day % 9 - 4) / 4.0 * np.isin(frame.aircraft, (1, 3))
    struck = without(frame, frame.residual + saw[:, None] * along)
    bench = Bench.of(setting_of(struck), struck.residual)
    grid = Grid((Axis("date", "linear", _starts(bench)),))
    fold = np.arange(setting.day.max() + 1) // 7
    made = fitted(bench, weighed(bench, grid, "along_heading"), fold)
    assert made.tails == (1, 3) and stands(made)
    own = np.isin(frame.aircraft, (1, 3))
    error = (field_of(bench, made, fold) * along).sum(axis=1)
    assert np.sqrt(np.mean((error - saw)[own] ** 2)) < 0.35 * np.sqrt(np.mean(saw[own] ** 2))
    assert not error[~own].any()
    # held out by flights: a table of all, of whole days, has no such halves
    assert made.by_fold.shape[0] == 10
    everyone = bench.cell_sums(grid, "along_heading", range(6), fold)
    assert everyone.scatter is not None
