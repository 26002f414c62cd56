"""Reports that scatter more than simulated ones: found where they do, by what, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.closure.of_scatter import reduction_of_jitter
from airswing.gap.design.exogenous import exogenous
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE, ActiveEffect
from airswing.gap.scatter.excess_scatter import scattering
from airswing.gap.simulation.forward import simulate
from airswing.units import KNOT


@pytest.fixture(scope="module")
def archive():
    frame = make_frame(seed=11, aircraft=8, days=20)
    columns = exogenous(frame)
    return frame, columns, noise_of(frame, columns)


def jittered(frame, acts, sd, seed):
    rng = np.random.default_rng(seed)
    return frame.residual + acts[:, None] * rng.normal(0, sd, (frame.size, 2))


def found_in(archive, residual, frame=None, **options):
    own, columns, noise = archive
    frame = own if frame is None else frame
    nobody, fold = np.zeros(frame.size, bool), (frame.day // 7) % 3
    return scattering(frame, columns, residual, noise, gross=nobody, fold=fold, **options)


def test_nothing_scatters_where_all_are_alike(archive):
    assert found_in(archive, archive[0].residual) is None


@pytest.mark.parametrize("seed", range(2))
def test_aircraft_that_jitter_are_found_with_their_size(archive, seed):
    frame = archive[0]
    found = found_in(archive, jittered(frame, np.isin(frame.aircraft, [2, 5]), 1.2, seed))
    assert found.tails == (frame.tails[2], frame.tails[5]) and found.axis is None
    np.testing.assert_allclose(found.excess, 1.2, rtol=0.15)
    assert found.evidence > 3


@pytest.mark.parametrize("aircraft", [[3], [0, 1, 6], list(range(8))])
def test_scatter_in_a_sector_of_the_track(archive, aircraft):
    frame = archive[0]
    track = np.degrees(np.arctan2(frame.ground_u, frame.ground_v)) % 360
    acts = (track > 90) & (track < 180) & np.isin(frame.aircraft, aircraft)
    residual = jittered(frame, acts, 2.0, 4)
    found = found_in(archive, residual)
    assert found.axis.variable in ("track", "magnetic_heading")
    assert found.tails == tuple(frame.tails[a] for a in aircraft)
    assert found.sizes[acts].mean() == pytest.approx(2.0, rel=0.15)
    assert found.sizes[~acts].mean() < 0.1
    true = (np.hypot(*residual.T).mean() - np.hypot(*frame.residual.T).mean()) / KNOT
    part = reduction_of_jitter(residual, found, np.zeros(frame.size, bool))
    assert part.interval[0] < true < part.interval[1]


def test_scatter_is_an_unknown_of_the_diagnosis():
    frame = make_frame(seed=11, aircraft=6, days=10)
    jitter = jittered(frame, frame.aircraft == 2, 1.5, 3) - frame.residual
    struck = replace(frame, u_rep=frame.u_rep + jitter[:, 0], v_rep=frame.v_rep + jitter[:, 1])
    effects = {"compass_offset": CATALOGUE["compass_offset"]}
    report = diagnose(struck, catalogue=effects).report
    (place,) = report.unknown.where
    assert (place.group, place.tails) == ("scatter", [frame.tails[2]])
    assert report.effects == [] and report.gap.significance < 0.01


def test_what_has_a_name_is_not_unknown(archive):
    frame = archive[0]
    residual = jittered(frame, frame.aircraft == 2, 1.2, 7)
    assert found_in(archive, residual, explained={frame.tails[2]}) is None


def test_gross_errors_that_have_a_name_do_not_scatter(archive):
    frame, columns, noise = archive
    gross = (np.random.default_rng(1).random(frame.size) < 0.03) & (frame.aircraft == 2)
    residual = jittered(frame, gross, 20.0, 7)
    fold = (frame.day // 7) % 3
    assert scattering(frame, columns, residual, noise, gross=gross, fold=fold) is None


def test_few_aircraft_tell_no_scatter(archive):
    frame = archive[0]
    few = replace(frame, aircraft=np.minimum(frame.aircraft, 3))
    assert found_in(archive, jittered(few, few.aircraft == 2, 2.0, 7), few) is None


def test_a_table_of_scatter_is_simulated(archive):
    frame = archive[0]
    values = {"component": "scatter", "variables": ["track"], "edges": [[0.0, 180.0, 360.0]]}
    effect = ActiveEffect("empirical", values | {"values": [0.0, 2.5]})
    made = simulate(frame, effects=[effect])
    added = np.stack([made.u_rep - frame.u_ref, made.v_rep - frame.v_ref], -1)
    west = np.degrees(np.arctan2(frame.ground_u, frame.ground_v)) % 360 > 180
    assert np.abs(added[~west]).max() < 1e-9
    assert added[west].std() == pytest.approx(2.5, rel=0.03)
