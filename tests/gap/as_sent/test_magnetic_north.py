"""Headings and directions against magnetic north are told by how they go with the declination."""

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.magnetic_north import against_magnetic_north_of
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.empirical import grid_of
from airswing.gap.result.effect_entries import active_effects
from airswing.gap.simulation.forward import simulate
from airswing.report.gap.words import verdict


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=6, aircraft=6, days=21, noise=1.5)


@pytest.fixture(scope="module")
def small():
    """Enough to be told, small enough to be searched in seconds."""
    return make_frame(seed=6, aircraft=5, days=8, noise=0.5)


def off_headings(frame, k, tails, degrees=0.0):
    """The frame with headings off by k declinations, and a fixed angle, on some aircraft."""
    own = np.isin(frame.aircraft, tails)
    heading = frame.heading + own * (k * frame.declination + np.radians(degrees))
    air = frame.airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    return without(frame, np.stack([frame.ground_u, frame.ground_v], -1) - air - reference)


def off_directions(frame, k, tails):
    """The frame with winds turned to the right by k declinations on some aircraft."""
    angle = np.where(np.isin(frame.aircraft, tails), k * frame.declination, 0.0)
    sine, cosine = np.sin(angle), np.cos(angle)
    u, v = cosine * frame.u_rep + sine * frame.v_rep, cosine * frame.v_rep - sine * frame.u_rep
    return without(frame, np.stack([u - frame.u_ref, v - frame.v_ref], -1))


def true_closure(frame, plain):
    return np.hypot(*frame.residual.T).mean() - np.hypot(*plain.residual.T).mean()


@pytest.mark.parametrize("seed", range(6))
def test_right_headings_are_left(seed):
    assert against_magnetic_north_of(make_frame(seed=seed, aircraft=5, days=12)) is None


@pytest.mark.parametrize(
    ("k", "words"), [(-1.0, "without"), (1.0, "added twice"), (-2.0, "sign turned round")]
)
def test_headings_are_found_and_turned_back(plain, k, words):
    frame = off_headings(plain, k, (1, 4))
    found = against_magnetic_north_of(frame)
    assert found is not None and words in found.title
    assert (found.component, found.variables, found.tails) == (
        "heading_angle",
        ("longitude",),
        (1, 4),
    )
    assert found.saved.mean() == pytest.approx(true_closure(frame, plain), rel=0.01)
    np.testing.assert_allclose(found.lifted.residual, plain.residual, atol=1e-6)
    grid = grid_of({"variables": ["longitude"], "edges": [found.edges]})
    assert grid.size == len(found.values)


def test_an_offset_beside_it_changes_nothing_and_alone_is_none(plain):
    found = against_magnetic_north_of(off_headings(plain, -1.0, (2,), degrees=3.0))
    assert found is not None and found.tails == (2,)
    assert against_magnetic_north_of(off_headings(plain, 0.0, (2,), degrees=3.0)) is None
    assert against_magnetic_north_of(off_headings(plain, 0.4, (2,))) is None  # of nothing forgotten


def test_a_whole_fleet_may_forget_it(plain):
    found = against_magnetic_north_of(off_headings(plain, -1.0, range(6)))
    assert found is not None and found.tails == tuple(range(6))


def test_wind_directions_are_found_but_of_all_aircraft_left_to_names(plain):
    frame = off_directions(plain, -1.0, (0, 3))
    found = against_magnetic_north_of(frame)
    assert found is not None
    assert (found.component, found.tails) == ("wind_angle", (0, 3))
    true = true_closure(frame, plain)
    low, high = np.quantile(found.drawn, (0.005, 0.995))
    assert low < true < high
    assert against_magnetic_north_of(off_directions(plain, -1.0, range(6))) is None


@pytest.mark.parametrize("seed", range(6))
def test_compasses_that_deviate_are_no_directions_against_magnetic_north(seed):
    """Every fleet's do, and what a deviation makes of winds goes with the routes."""
    frame = make_frame(seed=seed, aircraft=8, days=30, noise=1.0)
    rng = np.random.default_rng(seed)
    sine, cosine = np.radians(rng.normal(0.0, 3.0, (2, 8)))[:, frame.aircraft]
    angle = frame.magnetic_heading
    error = sine * np.sin(angle) + cosine * np.cos(angle)
    heading = frame.heading + error
    air = frame.airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    left = np.stack([frame.ground_u, frame.ground_v], -1) - air - reference
    assert against_magnetic_north_of(without(frame, left)) is None


def test_it_is_named_where_the_catalogue_has_the_name(small):
    frame = off_headings(small, -1.0, (1, 4))
    catalogue = {name: CATALOGUE[name] for name in ("declination_error", "compass_offset")}
    report = diagnose(frame, catalogue=catalogue).report
    (effect,) = report.effects
    assert effect.name == "declination_error" and effect.parameters["factor"] == 0.0
    assert effect.tails == [small.tails[1], small.tails[4]]
    assert not report.unknown.present and effect.share_of_gap == 1.0
    true = true_closure(frame, small) * 3600 / 1852
    closure = report.closure
    assert closure.reduction_ci[0] < true < closure.reduction_ci[1]
    assert closure.reduction == pytest.approx(true, rel=0.02)
    assert closure.before - closure.after == pytest.approx(closure.reduction)
    first, step, *_ = report.waterfall
    assert (first.kt, step.label) == (pytest.approx(closure.before), "declination_error")
    (active,) = active_effects(report)
    sent = simulate(small, effects=[active])
    # simulated, these aircraft err by as much
    late = small.aircraft == 1
    off = np.angle(np.exp(1j * (sent.heading - small.heading)))[late]
    assert np.corrcoef(off, -small.declination[late])[0, 1] > 0.5


def test_without_its_name_it_is_told_with_what_was_done(small):
    report = diagnose(off_headings(small, -1.0, (1, 4)), catalogue={}).report
    (place,) = report.unknown.where
    assert place.component == "heading_angle" and place.variables == ["longitude"]
    assert place.tails == [small.tails[1], small.tails[4]]
    assert place.title == "headings without the declination"
    assert any(place.title in step.label for step in report.waterfall)
    assert f"{place.title}: N" in verdict(report)
