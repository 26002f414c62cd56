"""Sums and evidence against dense algebra; unknowns put into small archives and found again."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tests.gap.toy import make_frame, noise_of
from tests.gap.witness.test_learned import setting_of

from airswing.gap.archive.other_winds import without
from airswing.gap.archive.reported_variables import KINDS, Variable, values_of
from airswing.gap.archive.value_tables import Grid, axis_of
from airswing.gap.design.basis import unit_vectors
from airswing.gap.design.weather import climatology_columns, day_field_columns, slope_columns
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise.whitening import whiten
from airswing.gap.result.effect_entries import active_effects
from airswing.gap.sums.variance_components import SLOPE_SD, Variances
from airswing.gap.taken_off import closed_by_table, table_or_names
from airswing.gap.taken_off.remainders import small_beside
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.fitted_tables import (
    LEAST_EVIDENCE,
    explained,
    field_of,
    fitted,
    left_out,
    stands,
)
from airswing.gap.witness.ground import BACKGROUND, plain_sums, prepare, steady_columns
from airswing.gap.witness.scan import SIZES, evidence
from airswing.gap.witness.unknowns import exchanged, weighed

SMALL = {n: CATALOGUE[n] for n in ("compass_offset", "hard_iron", "tas_scale")}


@pytest.fixture(scope="module")
def few():
    """Some flights of two aircraft on two days."""
    frame = make_frame(seed=2, aircraft=2, days=2)
    return frame.take(np.isin(frame.flight, np.unique(frame.flight)[:8]))


def test_sums_are_those_of_generalised_least_squares(few):
    from airswing.gap.design.basis import plan_dictionary

    noise = noise_of(few)
    plan = plan_dictionary(few, {})
    fields = day_field_columns(few, plan)
    lasting = np.concatenate([climatology_columns(few, plan), slope_columns(few)], -1)
    steady = steady_columns(few)
    m = lasting.shape[-1] - 2
    variances = Variances(np.full(fields.shape[-1], 0.3), np.full(m, 0.05))
    _, day = np.unique(few.day, return_inverse=True)
    ground = prepare(few, noise=noise, plan=plan, variances=variances, day=day)
    cells = (few.longitude > np.median(few.longitude)).astype(int)
    cross, _ = unit_vectors(few.heading)
    sums = ground.sums(cells, 2, cross, ground.solved(few.residual[None]))

    def white(columns):
        return whiten(columns, noise.order, noise.gains).reshape(2 * few.size, -1)

    blocks = [white(lasting) * np.sqrt(np.r_[np.full(m, 0.05), np.square(SLOPE_SD)])]
    for d in np.unique(day):
        blocks.append(white(fields * (day == d)[:, None, None]) * np.sqrt(0.3))
    for a in np.unique(few.aircraft):
        blocks.append(white(steady * (few.aircraft == a)[:, None, None]) * BACKGROUND)
    known = np.concatenate(blocks, axis=1)
    inverse = np.linalg.inv(np.eye(2 * few.size) + known @ known.T)
    table = np.stack([cross * (cells == k)[:, None] for k in range(2)], -1)
    x, r = white(table), np.clip(white(few.residual[..., None]), -5, 5)
    np.testing.assert_allclose(sums.fleet_gram, x.T @ inverse @ x, rtol=2e-3, atol=0.3)
    score = sums.score[0].sum(axis=(0, 1))
    np.testing.assert_allclose(score, (x.T @ inverse @ r)[:, 0], rtol=2e-2, atol=0.5)
    own = white(table * (few.aircraft == 1)[:, None, None])
    np.testing.assert_allclose(sums.gram[1], own.T @ inverse @ own, rtol=2e-3, atol=0.3)


def test_evidence_is_a_ratio_of_normal_densities():
    rng = np.random.default_rng(1)
    half = rng.normal(size=(4, 4))
    gram, prior = half @ half.T + np.eye(4), 0.5 * np.eye(4) + 0.5
    score, error, factor = rng.normal(size=4) * 3, 0.2, 1.7
    made, _ = evidence(gram, score[None], prior, error=error, factor=np.array([factor]))
    own = gram / factor
    said = [
        multivariate_normal(cov=own + own @ prior @ own * (error**2 + extra)).logpdf(score / factor)
        for extra in (0.0, *SIZES**2)
    ]
    expected = np.logaddexp.reduce(np.array(said[1:]) - said[0]) - np.log(SIZES.size)
    assert made[0] == pytest.approx(expected, rel=1e-6)


def test_plain_sums_are_counts_and_means():
    values = np.array([[1.0, 3.0, 5.0, 7.0]])
    sums = plain_sums(
        values,
        np.ones(4),
        np.array([0, 0, 1, -1]),
        2,
        aircraft=np.array([0, 0, 1, 1]),
        day=np.array([0, 1, 1, 1]),
    )
    unit = 1 / np.mean(values**2)
    np.testing.assert_allclose(np.diagonal(sums.fleet_gram), np.array([2, 1]) * unit)
    np.testing.assert_allclose(sums.score[0].sum(axis=(0, 1)), np.array([4, 5]) * unit)
    np.testing.assert_allclose(sums.score[0, 0, 1], [3 * unit, 0])


def box(context):
    """Two aircraft turn by 2.5 degrees east of a meridian, nowhere else."""
    own = np.isin(context["aircraft"], [1, 4])
    return np.where(own & (context["longitude"] > -88), np.radians(2.5), 0.0)


@pytest.fixture(scope="module")
def told():
    frame = make_frame(seed=5, aircraft=6, days=16, noise=0.3, heading_error=box)
    return frame, diagnose(frame, catalogue=SMALL)


def test_an_unknown_has_variables_aircraft_curve_and_closure(told):
    frame, made = told
    unknown = made.report.unknown
    place = unknown.where[0]
    assert "longitude" in place.variables
    assert place.component in ("across_heading", "heading_angle")
    assert place.tails == [frame.tails[1], frame.tails[4]]
    assert place.probability > 0.95
    bare = make_frame(seed=5, aircraft=6, days=16, noise=0.3)
    true = (np.hypot(*frame.residual.T).mean() - np.hypot(*bare.residual.T).mean()) / 0.514444
    assert unknown.closure.reduction == pytest.approx(true, abs=0.1)
    low, high = unknown.closure.reduction_ci
    assert low < true < high
    steps = [step.kt for step in made.report.waterfall]
    assert steps[0] == pytest.approx(np.hypot(*frame.residual.T).mean() / 0.514444, rel=1e-5)
    assert unknown.closure.before - unknown.closure.after == pytest.approx(
        unknown.closure.reduction
    )


def test_the_loop_closes(told):
    """With the unknown in the simulation there is nothing left beside it."""
    from airswing.gap.simulation.forward import simulate

    frame, made = told
    active = [effect for effect in active_effects(made.report) if effect.name == "empirical"]
    assert active
    bare = make_frame(seed=5, aircraft=6, days=16, noise=0.3)
    through = dataclasses.replace(bare, u_ref=bare.u_rep, v_ref=bare.v_rep)
    sent = simulate(through, effects=active)
    left = np.hypot(sent.u_rep - frame.u_rep, sent.v_rep - frame.v_rep)
    was = np.hypot(bare.u_rep - frame.u_rep, bare.v_rep - frame.v_rep)
    assert (left**2).mean() < 0.35 * (was**2).mean()


def test_an_error_along_the_wind_that_grows_with_the_date_shows_in_means_of_days():
    """All aircraft share it and on one day it is smooth in place, as the weather's own error is."""
    frame = make_frame(seed=6, aircraft=4, days=24, noise=0.3, model_error=1.0)
    date = (frame.time - frame.epoch) / 86400
    _, day = np.unique(frame.day, return_inverse=True)
    mean = [np.bincount(day, wind) for wind in (frame.u_ref, frame.v_ref)]
    unit = (np.stack(mean) / np.hypot(*mean)).T[day]
    grown = 5.0 * np.clip(date / 24 - 0.5, 0, None)[:, None] * unit
    struck = without(frame, frame.residual - grown)
    for archive, raised in ((struck, True), (frame, False)):
        setting = setting_of(archive)
        bench = Bench.of(setting, archive.residual)
        axis = axis_of(bench.variables["date"], KINDS["date"][1])
        told = weighed(bench, Grid((axis,)), "along_wind")
        assert (told.nats > LEAST_EVIDENCE) is raised
        if not raised:
            continue
        assert told.by_means
        made = fitted(bench, told, np.arange(day.max() + 1) // 7)
        assert stands(made) and made.tails == (0, 1, 2, 3)
        cells = bench.cells(made.grid)
        true = [-np.hypot(*grown[cells == k].T).mean() for k in range(made.grid.size)]
        np.testing.assert_allclose(made.values[0], true, atol=0.5)
        assert np.corrcoef(made.values[0], true)[0, 1] > 0.9


def test_a_table_by_date_is_judged_on_days_between_those_that_tell_it():
    axes = {
        name: axis_of(Variable(name, "linear", np.arange(24.0)), 4) for name in ("date", "altitude")
    }
    weeks = np.arange(28) // 7
    assert left_out(Grid((axes["altitude"],)), np.arange(35) // 7).tolist() == [
        k // 7 for k in range(35)
    ]
    for fold in (weeks, np.arange(14) // 5):
        dealt = left_out(Grid((axes["date"],)), fold)
        assert dealt[:12].tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 0, 0]
    short = left_out(Grid((axes["altitude"],)), np.arange(14) // 5)
    assert np.all(np.diff(short) >= 0) and np.bincount(short).tolist() == [3, 3, 3, 3, 2]


def test_kinds_have_cells_of_their_own():
    frame = make_frame(seed=2, aircraft=2, days=2)
    from airswing.gap.archive.reported_variables import record

    for name, variable in record(frame, frame).items():
        grid = Grid((axis_of(variable, KINDS[name][1]),))
        cells = grid.cells((variable.values,))
        assert cells.min() >= 0 and cells.max() < grid.size


def test_a_fifth_of_what_names_explain_is_their_remainder():
    errors = np.tile([[3.0, 4.0]], (8, 1))
    assert small_beside(errors, 0.99) and not small_beside(errors, 1.01)
    assert not small_beside(0 * errors, 0.01)


def test_cells_merged_are_means_of_their_reports():
    from airswing.gap.archive.value_tables import Axis
    from airswing.gap.witness.fitted_tables import Unknown, merged

    axes = (
        Axis("longitude", "linear", np.arange(4.0)),
        Axis("icing", "category", np.arange(3) - 0.5),
    )
    values = np.array([[1.0, 10.0, 4.0, 20.0, 7.0, 30.0]])
    grid = Grid(axes)
    table = Unknown("across_wind", grid, (0,), True, 9.0, values, values[None], (), 1, 1, 1, 1)
    cells = np.repeat(np.arange(6), [3, 1, 1, 1, 5, 0])
    made = merged(SimpleNamespace(cells=lambda grid: cells), table, 0)
    np.testing.assert_allclose(made.values, [[42 / 9, 15, 42 / 9, 15, 42 / 9, 15]])
    np.testing.assert_allclose(made.by_fold[0], made.values)
    made = merged(SimpleNamespace(cells=lambda grid: cells), table, 1)
    np.testing.assert_allclose(made.values, [[3.25, 3.25, 12, 12, 7, 7]])


def test_a_table_of_single_aircraft_is_larger_than_the_little_each_has_of_its_own():
    def one(tails, size, peak, run=0.0):
        told = {"size": size, "peak": peak, "run": run, "held_out": 9, "held_out_error": 1}
        return SimpleNamespace(tails=tails, values=np.zeros((3, 2)), **told)

    assert stands(one((0, 1), 0.14, 0.3))
    assert not stands(one((2,), 0.14, 0.3))
    assert stands(one((2,), 0.14, 0.4))
    assert stands(one((2,), 0.2, 0.3))
    assert stands(one((2,), 0.14, 0.2, run=0.35))  # of a run its own size is what counts
    assert not stands(one((2,), 0.07, 0.2, run=0.35))


def weeks_left_out(monkeypatch, fields):
    """A bench of 60 reports of 30 days, on which tables make the fields of their place."""
    from airswing.gap.witness import fitted_tables

    monkeypatch.setattr(fitted_tables, "field_of", lambda bench, table, fold: fields[table])
    residual = np.ones((1, 60, 2))
    residual[0, 0] = 50.0  # gross: counts for nothing
    return SimpleNamespace(residuals=residual, setting=SimpleNamespace(day=np.arange(60) // 2))


def test_another_table_takes_the_place_where_it_explains_more_of_most_weeks(monkeypatch):
    from airswing.gap.witness.fitted_tables import clearly_more, explained

    half, whole, lucky = np.full((60, 2), 0.5), np.ones((60, 2)), np.full((60, 2), 0.5)
    lucky[6:12] = 1.0  # one block of three days alone speaks for it
    fields = [half, whole, lucky, half * 1.01]
    bench = weeks_left_out(monkeypatch, fields)
    assert explained(bench, half) == pytest.approx(2 * 0.75 * 59 / 60)
    assert clearly_more(bench, 0, 1, None) and not clearly_more(bench, 1, 0, None)
    assert not clearly_more(bench, 0, 2, None) and not clearly_more(bench, 0, 3, None)


def test_reported_and_reference_wind_are_not_in_one_table():
    from airswing.gap.witness.unknowns import _tells_itself

    assert _tells_itself(("wind_speed", "drift")) and not _tells_itself(("track", "wind_speed"))
    assert _tells_itself(("ground_speed", "wind_direction")) and not _tells_itself(("drift",))


def test_a_slope_that_simulated_archives_do_not_agree_about_counts_little():
    """Of direction all agree and the real archive shows 0.9; of speed they do not, and it -1."""
    from airswing.gap.witness.null import LEAST_SPREAD, _median_slope, shown_share

    simulated = np.linspace(1.0, 2.0, 24)
    direction = simulated * np.array([[0.9], [1.0], [1.1], [0.9], [1.0]])
    speed = simulated * np.array([[-1.0], [0.2], [2.0], [0.1], [1.7]])
    variance = max(np.var([1.0, 1.1, 0.9, 1.0]), LEAST_SPREAD), np.var([0.2, 2.0, 0.1, 1.7])
    told = (0.9 / variance[0] - 1.0 / variance[1]) / (1 / variance[0] + 1 / variance[1])
    assert shown_share([direction, speed]) == pytest.approx(told)
    assert told > 0.8
    assert shown_share([]) == 1.0 and shown_share([speed]) == 0.0
    assert _median_slope(np.zeros(3), np.ones(3)) == 0.0
    assert _median_slope(np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 99.0])) == 0.5


def test_cells_miss_what_their_halves_explain_more():
    from airswing.gap.archive.value_tables import Axis
    from airswing.gap.taken_off.closed_by_table import MISSED, missed
    from airswing.gap.witness.fitted_tables import Unknown, halved

    def step(context):
        return np.where(context["longitude"] > -88, np.radians(3.0), 0.0)

    frame = make_frame(seed=3, aircraft=4, days=10, noise=0.3, heading_error=step)
    bench = Bench.of(setting_of(frame), frame.residual)
    fold = np.arange(bench.setting.day.max() + 1) // 2

    def cut(edge):
        low, high = frame.longitude.min(), frame.longitude.max()
        grid = Grid((Axis("longitude", "linear", np.array([low, edge, high])),))
        candidate = weighed(bench, grid, "heading_angle")
        table = fitted(bench, candidate, fold)
        assert isinstance(table, Unknown)
        return table

    at_the_step, beside = cut(-88.0), cut(-92.0)
    edges = halved(bench, at_the_step, fold)[0].grid.axes[0].edges
    west = frame.longitude[frame.longitude < -88]
    assert edges.size == 5 and edges[1] == pytest.approx(np.median(west), abs=1e-3)
    assert missed(bench, at_the_step, fold) < MISSED + 0.1
    assert missed(bench, beside, fold) > MISSED + 0.4


def test_a_table_does_not_lead_by_small_scales_that_a_name_cannot_help(monkeypatch):
    """A model 8 % too weak, whose small scales are in part wrong: name and table say the same."""
    rng = np.random.default_rng(3)
    large, small, error = (sd * rng.standard_normal((500, 2)) for sd in (10.0, 4.0, 2.0))
    bench = SimpleNamespace(residuals=(0.08 * large - 0.4 * small + error)[None])
    name, columns = 0.08 * (large + small), 0.08 * large
    monkeypatch.setattr(table_or_names, "field_of", lambda *_: 0.079 * large)
    monkeypatch.setattr(table_or_names, "from_nothing", lambda table: None)
    fold = np.zeros(1, int)
    assert table_or_names.leads(bench, None, (name,), fold)
    assert not table_or_names.leads(bench, None, (name, columns), fold)
    assert table_or_names.leads(bench, None, (0.5 * name, 0.5 * columns), fold)


def test_a_table_of_the_wind_closes_less_where_the_reference_errs():
    """Its own small scales are in part wrong: a reference 8 % too weak, set right in full."""
    rng = np.random.default_rng(4)
    large, small, error = (sd * rng.standard_normal((4000, 2)) for sd in (10.0, 4.0, 2.0))
    wind, residual = large + small, 0.08 * large - 0.4 * small + error
    frame = SimpleNamespace(
        aircraft=np.zeros(4000, int), heading=np.zeros(4000), airspeed=np.full(4000, 100.0)
    )
    frame.tails, frame.residual, frame.u_ref, frame.v_ref = ("N400",), residual, *wind.T
    bench = SimpleNamespace(
        setting=SimpleNamespace(frame=frame), cells=lambda _: np.zeros(4000, int)
    )
    table = SimpleNamespace(grid=None, component="wind_factor", values=np.array([[8.0]]))
    closed = np.hypot(*residual.T).sum() - np.hypot(*(residual - 0.08 * wind).T).sum()
    assert closed_by_table._of_reference(bench, table) == pytest.approx(closed)
    on_large = np.hypot(*residual.T).sum() - np.hypot(*(residual - 0.08 * large).T).sum()
    assert closed < 0.8 * on_large


def test_an_error_across_the_heading_by_the_reported_speed_shows_in_its_means():
    """A saw of all aircraft, whose cells one flight hardly leaves: changes along it tell little."""
    frame = make_frame(seed=3, aircraft=6, days=24, noise=0.5)

    def told(reported):
        bench = Bench.of(setting_of(reported), reported.residual)
        grid = Grid((axis_of(bench.variables["wind_speed"], 16),))
        return {name: weighed(bench, grid, name) for name in ("across_heading", "along_heading")}

    speed = np.hypot(frame.u_rep, frame.v_rep)
    across, _ = unit_vectors(frame.heading)
    saw = np.where(np.mod(speed, 8.0) < 4.0, 0.6, -0.6)
    struck = told(without(frame, frame.residual + saw[:, None] * across))
    assert struck["across_heading"].by_means
    assert struck["across_heading"].nats > LEAST_EVIDENCE + 4
    plain = told(frame)
    assert max(one.nats for one in plain.values()) < LEAST_EVIDENCE
    assert struck["along_heading"].nats < LEAST_EVIDENCE


def test_a_pair_found_by_one_variable_is_told_by_the_other_that_explains_more():
    """Where most winds blow from one side a track tells the drift, and is not what it goes by."""
    frame = make_frame(seed=5, aircraft=4, days=12, noise=0.5)
    drift = values_of(frame, frame, "drift")
    late = frame.day > np.median(frame.day)
    cross, _ = unit_vectors(frame.heading)
    error = cross * (1.5 * (late & (drift > np.median(drift))))[:, None]
    reported = without(frame, frame.residual + error)
    bench = Bench.of(setting_of(reported), reported.residual)
    fold = np.arange(int(bench.setting.day.max()) + 1) // 3
    axes = [axis_of(bench.variables[name], count) for name, count in (("date", 6), ("track", 12))]
    found = fitted(bench, weighed(bench, Grid((axes[0], axes[1])), "across_heading"), fold)
    made = exchanged(bench, found, fold)
    assert set(made.grid.variables) == {"date", "drift"}
    more, less = (explained(bench, field_of(bench, one, fold)) for one in (made, found))
    assert more > 1.2 * less
    alone = fitted(bench, weighed(bench, Grid((axes[0],)), "across_heading"), fold)
    assert exchanged(bench, alone, fold) is alone
