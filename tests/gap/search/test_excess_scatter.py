"""Aircraft that scatter more than the fleet's: found where they are, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.exogenous import exogenous
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise.model import NoiseModel
from airswing.gap.search.excess_scatter import expected_departure, scattering


@pytest.fixture(scope="module")
def archive():
    frame = make_frame(seed=11, aircraft=8, days=20)
    columns = exogenous(frame)
    noise = noise_of(frame, columns)
    return frame, noise


def jittered(frame, aircraft, sd, seed):
    rng = np.random.default_rng(seed)
    own = np.isin(frame.aircraft, aircraft)
    return frame.residual + own[:, None] * rng.normal(0, sd, (frame.size, 2))


def test_expected_departure_is_that_of_the_simulated_process():
    rng, n = np.random.default_rng(1), 400_000
    model = NoiseModel(2.3, 1.1, 150e3, 0.7, np.zeros(1), np.ones(1))
    first, second = 0.7, 0.5
    state = rng.normal(size=n)
    middle = first * state + np.sqrt(1 - first**2) * rng.normal(size=n)
    last = second * middle + np.sqrt(1 - second**2) * rng.normal(size=n)
    process = model.correlated_sd * np.stack([state, middle, last])
    process += model.white_sd * rng.normal(size=(3, n))
    departure = process[1] - (process[0] + process[2]) / 2
    expected = expected_departure(model, np.array([first]), np.array([second]))[0]
    assert departure.std() == pytest.approx(expected, rel=0.005)


def test_nothing_scatters_where_all_are_alike(archive):
    frame, noise = archive
    assert scattering(frame, frame.residual, noise) is None


@pytest.mark.parametrize("seed", range(4))
def test_aircraft_that_jitter_are_found_with_their_size(archive, seed):
    frame, noise = archive
    found = scattering(frame, jittered(frame, [2, 5], 1.2, seed), noise)
    assert found.tails == (frame.tails[2], frame.tails[5])
    np.testing.assert_allclose(found.excess, 1.2, rtol=0.3)
    assert found.evidence > 3


def test_scatter_is_an_unknown_of_the_diagnosis():
    frame = make_frame(seed=11, aircraft=6, days=10)
    jitter = jittered(frame, [2], 1.5, 3) - frame.residual
    struck = replace(frame, u_rep=frame.u_rep + jitter[:, 0], v_rep=frame.v_rep + jitter[:, 1])
    effects = {"compass_offset": CATALOGUE["compass_offset"]}
    report = diagnose(struck, catalogue=effects, maps=False).report
    (place,) = report.unknown.where
    assert (place.group, place.tails) == ("scatter", [frame.tails[2]])
    assert report.effects == [] and report.gap.significance < 0.01


def test_what_has_a_name_is_not_unknown(archive):
    frame, noise = archive
    residual = jittered(frame, [2], 1.2, 7)
    assert scattering(frame, residual, noise, explained={frame.tails[2]}) is None


def test_few_aircraft_tell_no_scatter(archive):
    frame, noise = archive
    few = replace(frame, aircraft=np.minimum(frame.aircraft, 3))
    assert scattering(few, jittered(frame, [2], 2.0, 7), noise) is None
