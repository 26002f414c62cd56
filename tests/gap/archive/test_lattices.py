"""Headings in coarse steps are found by their lattice; repeated courses are no lattice."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.archive.lattices import direction_lattice, heading_lattices
from airswing.gap.design import exogenous, heading_doubt
from airswing.gap.diagnose import diagnose
from airswing.gap.distribution.coded_values import heading_coding
from airswing.gap.distribution.gross_errors import outliers
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise import fit_noise, gross_errors
from airswing.gap.simulation.forward import Coding


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=4, aircraft=4, days=14, noise=1.5)


def stepped(frame, step, tails, *, true_north=False, spread=0.0, seed=0):
    """The frame with headings rounded to steps, with an error of some tenths of a degree."""
    rng = np.random.default_rng(seed)
    north = 0.0 if true_north else frame.heading - frame.magnetic_heading
    width = np.radians(step)
    heading = width * np.round((frame.heading - north) / width) + north
    heading += np.radians(spread) * rng.standard_normal(frame.size)
    heading = np.where(np.isin(frame.aircraft, tails), heading, frame.heading)
    return replace(
        frame,
        u_rep=frame.ground_u - frame.airspeed * np.sin(heading),
        v_rep=frame.ground_v - frame.airspeed * np.cos(heading),
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(heading - frame.declination, 2 * np.pi),
    )


@pytest.mark.parametrize("true_north", [False, True])
@pytest.mark.parametrize(("step", "spread"), [(2.0, 0.2), (10.0, 1.0), (30.0, 1.0)])
def test_steps_and_their_north_are_found(plain, step, spread, true_north):
    frame = stepped(plain, step, [1], true_north=true_north, spread=spread)
    found = heading_lattices(frame)[1]
    assert found is not None
    assert (found.step, found.true_north) == (step, true_north)
    assert found.evidence > 100.0
    assert heading_lattices(frame)[0] is None


@pytest.mark.parametrize("seed", range(2))
def test_unrounded_headings_have_no_lattice(seed):
    frame = make_frame(seed=seed, aircraft=4, days=7)
    assert heading_coding(frame) is None


def test_a_few_courses_are_no_lattice(plain):
    """Six flights on one course each, on whole tens by chance, are too few."""
    rows = np.flatnonzero(np.isin(plain.flight, np.unique(plain.flight)[:6]))
    few = plain.take(rows)
    straight = replace(few, magnetic_heading=np.radians(10.0 * (few.flight % 6)))
    assert not any(heading_lattices(straight))


def test_diagnosis_states_step_and_closure(plain):
    frame = stepped(plain, 5.0, [0, 2], spread=0.3)
    catalogue = {"heading_coding": CATALOGUE["heading_coding"]}
    report = diagnose(frame, catalogue=catalogue, dictionary=False).report
    (effect,) = report.effects
    assert effect.name == "heading_coding"
    assert effect.tails == [plain.tails[0], plain.tails[2]]
    assert effect.parameters == {"step_deg": 5.0, "true_north": None}
    true = (np.hypot(*frame.residual.T).mean() - np.hypot(*plain.residual.T).mean()) / 0.514444
    low, high = report.closure.reduction_ci
    assert low < true < high
    assert report.closure.reduction == pytest.approx(true, rel=0.25)


@pytest.mark.parametrize("true_north", [False, True])
def test_simulated_winds_have_the_steps_found(plain, true_north):
    frame = stepped(plain, 15.0, [1], true_north=true_north)
    assert [one is not None for one in heading_lattices(frame)] == [False, True, False, False]
    u, v = Coding.as_found(frame).apply(plain.u_rep, plain.v_rep)
    affected = frame.aircraft == 1
    flown = np.hypot(plain.ground_u - plain.u_rep, plain.ground_v - plain.v_rep)
    sent = np.hypot(frame.ground_u - u, frame.ground_v - v)
    np.testing.assert_allclose(sent, flown, atol=1e-9)
    heading = np.arctan2(frame.ground_u - u, frame.ground_v - v)
    north = 0.0 if true_north else frame.declination
    steps = np.degrees(heading - north)[affected] / 15.0
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    without_steps = Coding.of_archive(frame).apply(plain.u_rep, plain.v_rep)
    np.testing.assert_allclose(
        np.stack([u, v])[:, ~affected], np.stack(without_steps)[:, ~affected], atol=1e-9
    )


def test_jumps_between_steps_are_no_gross_errors_and_no_scatter(plain):
    made = diagnose(stepped(plain, 15.0, [1])).report
    assert [effect.name for effect in made.effects] == ["heading_coding"]
    assert not [place for place in made.unknown.where if place.component == "scatter"]


@pytest.mark.parametrize(("step", "share"), [(2.0, 0.02), (5.0, 0.05), (5.0, 0.0), (15.0, 0.0)])
def test_gross_errors_are_distinguished_from_steps(plain, step, share):
    rng = np.random.default_rng(3)
    frame = stepped(plain, step, [1])
    hit = (rng.random(frame.size) < share) & (frame.aircraft == 1)
    error = hit[:, None] * rng.normal(0, 15, (frame.size, 2))
    frame = replace(frame, u_rep=frame.u_rep + error[:, 0], v_rep=frame.v_rep + error[:, 1])
    noise = fit_noise(plain.residual, exogenous(plain))
    gross = gross_errors(frame.residual, noise.order)
    effect = outliers(frame, frame.residual, replace(noise, gross=gross))
    assert (effect is not None) == (share > 0)
    if effect is not None:
        assert effect.tails == [frame.tails[1]]
        assert effect.parameters["fraction"] == pytest.approx(share, rel=0.4)


def test_coarse_headings_have_a_larger_uncertainty(plain):
    frame = stepped(plain, 10.0, [1])
    more = heading_doubt(frame, frame) ** 2 - heading_doubt(plain, plain) ** 2
    affected = frame.aircraft == 1
    assert np.allclose(more[~affected], 0.0)
    assert np.sqrt(more[affected].mean()) == pytest.approx(
        np.radians(10.0) / np.sqrt(12.0) * frame.airspeed[affected].mean(), rel=0.1
    )


def test_directions_of_weak_winds_in_steps():
    rng = np.random.default_rng(0)
    speed, direction = rng.uniform(0, 20, 2000), np.round(rng.uniform(0, 360, 2000))
    direction = np.where(speed < 3.0, 30.0 * np.round(direction / 30.0), direction)
    angle = np.radians(direction)
    found = direction_lattice(speed * np.sin(angle), speed * np.cos(angle))
    assert (found.step, found.share) == (30.0, pytest.approx(1.0, abs=0.02))
    assert found.below == pytest.approx(3.0, abs=0.1)


def test_only_a_deviated_aircraft_is_doubted_and_only_in_a_turn():
    heading = np.radians([0.0, 0.0, 60.0, 60.0] * 2)
    error = np.radians([np.nan, 12.0, 12.0, 0.0] * 2)
    frame = SimpleNamespace(
        tails=("N1", "N2"),
        aircraft=np.repeat([0, 1], 4),
        flight=np.repeat([0, 1], 4),
        time=np.arange(8.0),
        ground_u=100 * np.sin(heading),
        ground_v=100 * np.cos(heading),
        u_ref=np.zeros(8),
        v_ref=np.zeros(8),
        heading_error=error,
        heading=heading,
        magnetic_heading=heading,
    )
    deviated = np.repeat([0.0, np.radians(3.0)], 4)
    columns = SimpleNamespace(
        heading=heading + deviated, airspeed=np.full(8, 100.0), u_ref=np.zeros(8), v_ref=np.zeros(8)
    )
    doubt = heading_doubt(frame, columns)
    np.testing.assert_allclose(doubt[:4], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[[4, 7]], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[5:7], 100 * np.radians(3.0) * np.radians(12.0), rtol=1e-6)
