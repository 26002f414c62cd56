"""Headings that scatter leave air vectors too short: by hand, and of an archive without."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import FLEET_ALLOWANCE, fleet_allowance
from airswing.gap.evidence.scattered_headings import REGULAR, excess, of_columns


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=2, aircraft=4, days=6, noise=0.3)


def scattered(frame, degrees):
    """The same with headings scattered: the reported wind is V_G less the turned air vector."""
    turn = np.radians(np.random.default_rng(0).normal(0, degrees, frame.size))
    heading = frame.heading + turn
    air = frame.airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
    return replace(
        frame, heading=heading, u_rep=frame.ground_u - air[:, 0], v_rep=frame.ground_v - air[:, 1]
    )


def test_half_the_square_of_the_scatter_times_the_airspeed(frame):
    own, airspeed = excess(frame), np.mean(frame.airspeed)
    by_hand = np.mean((frame.airspeed * np.radians(2.0)) ** 2)
    more = excess(scattered(frame, 2.0)) - own
    assert own < 0.1 * by_hand
    assert more == pytest.approx(by_hand, rel=0.15)
    lost = (scattered(frame, 2.0).residual - frame.residual) * np.stack(
        [np.sin(frame.heading), np.cos(frame.heading)], -1
    )
    assert lost.sum(axis=1).mean() == pytest.approx(more / (2 * airspeed), rel=0.15)


def test_it_is_allowed_for_in_headings_and_airspeeds_not_in_winds(frame):
    names = ("compass_offset", "tas_offset", "altitude_offset")
    effects = {name: CATALOGUE[name] for name in names}
    layout = SimpleNamespace(
        size=3, effects=names, columns=lambda name: np.array([names.index(name)])
    )
    turned = scattered(frame, 2.0)
    lost = excess(turned) / (2 * np.mean(turned.airspeed))
    expected = [REGULAR * np.sqrt(excess(turned)), lost, 0.0]
    assert of_columns(turned, layout, effects) == pytest.approx(expected)
    given = SimpleNamespace(lasting_share=np.full(3, 0.25), scattered=np.array([0.0, 0.08, 0.0]))
    allowed = [fleet_allowance(given, np.array([k])) for k in range(3)]
    own = 0.5 * FLEET_ALLOWANCE
    assert allowed == pytest.approx([own, np.hypot(own, 0.08), own])
