"""Winds of some aircraft in another unit, turned or exchanged are told and turned back."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.as_sent.wind_maps import mapped_of
from airswing.gap.diagnose import diagnose
from airswing.gap.effects.base import ActiveEffect
from airswing.gap.effects.empirical import EMPIRICAL
from airswing.gap.result.effect_entries import active_effects
from airswing.units import KNOT

MAPS = {
    "wind_factor": 1.151 * np.eye(2),
    "wind_angle": np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]]),
    "wind_map": np.array([[0.0, 1.0], [1.0, 0.0]]),
}


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=6, aircraft=6, days=20, noise=1.0)


def mapped(frame, matrix, aircraft):
    own = np.isin(frame.aircraft, aircraft)[:, None]
    sent = np.stack([frame.u_rep, frame.v_rep], -1)
    u, v = np.where(own, sent @ np.asarray(matrix).T, sent).T
    return dataclasses.replace(frame, u_rep=u, v_rep=v)


def lost(frame, plain):
    return float(np.hypot(*frame.residual.T).mean() - np.hypot(*plain.residual.T).mean())


def test_winds_as_they_are_have_no_map(plain):
    assert mapped_of(plain) is None
    # what all aircraft have is the reference's as well
    assert mapped_of(mapped(plain, 1.15 * np.eye(2), range(6))) is None


@pytest.mark.parametrize("kind", list(MAPS))
@pytest.mark.parametrize("aircraft", [(1, 4), (0, 2, 3, 5)])
def test_a_map_is_told_turned_back_and_closed(plain, kind, aircraft):
    frame = mapped(plain, MAPS[kind], aircraft)
    found = mapped_of(frame)
    assert found is not None
    assert (found.component, found.tails) == (kind, aircraft)
    true = lost(frame, plain)
    low, high = np.quantile(found.drawn, (0.005, 0.995))
    assert low - 0.02 * true <= true <= high + 0.02 * true
    value = {"wind_factor": 15.1, "wind_angle": -np.degrees(0.3), "wind_map": 0.0}[kind]
    assert found.values[0] == pytest.approx(value, abs=4.0)


def test_the_diagnosis_tells_a_factor_that_the_simulation_takes(plain):
    frame = mapped(plain, 1.3 * np.eye(2), (1, 4))
    report = diagnose(frame, catalogue={}).report
    assert report.effects == []
    place = report.unknown.where[0]
    assert (place.component, place.variables) == ("wind_factor", ["wind_speed"])
    assert list(place.tails) == [plain.tails[1], plain.tails[4]]
    assert place.closure.reduction == pytest.approx(lost(frame, plain) / KNOT, rel=0.1)
    (active,) = [one for one in active_effects(report) if one.parameters["values"]][:1]
    assert isinstance(active, ActiveEffect) and active.name == EMPIRICAL.name
    assert active.parameters["values"][0] == pytest.approx(30.0, abs=5.0)


def test_aircraft_at_a_wrong_height_are_no_map(plain):
    # winds of another height by 0.06 in ln p: stronger by a fifth where they grow upward
    climate = np.stack([plain.u_ref, plain.v_ref], -1)
    own = np.isin(plain.aircraft, (1, 4))[:, None]
    change = 0.2 * climate + np.random.default_rng(3).normal(0, 2.0, climate.shape)
    sent = np.stack([plain.u_rep, plain.v_rep], -1) + np.where(own, change, 0.0)
    higher = dataclasses.replace(
        plain,
        u_rep=sent[:, 0],
        v_rep=sent[:, 1],
        dudlnp=change[:, 0] / 0.06,
        dvdlnp=change[:, 1] / 0.06,
    )
    assert mapped_of(higher) is None
    # the same winds where the change with height is another
    unlike = dataclasses.replace(higher, dudlnp=plain.dudlnp, dvdlnp=plain.dvdlnp)
    assert mapped_of(unlike) is not None
