"""Winds that stuck are found and drawn as they would have been; what repeats by chance is not."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame
from tests.gap.witness.test_sent_winds import sent_as

from airswing.gap.as_sent.repeated import repeated_of
from airswing.gap.diagnose import diagnose
from airswing.gap.simulation.forward import Coding
from airswing.units import KNOT

WHICH = ("reported_wind", "reported_direction", "reported_speed")


@pytest.fixture(scope="module")
def plain():
    frame = make_frame(seed=6, aircraft=6, days=14, noise=1.5)
    u, v = Coding(speed=KNOT, direction=1.0).apply(frame.u_rep, frame.v_rep)
    return dataclasses.replace(frame, u_rep=u, v_rep=v)


def stuck(frame, aircraft, which, length=30):
    """Every third day of some aircraft the first value is sent for ``length`` reports."""
    rows = np.arange(frame.size)
    first = rows.copy()
    for a in aircraft:
        for day in np.unique(frame.day)[::3]:
            own = np.flatnonzero((frame.aircraft == a) & (frame.day == day))
            own = own[np.argsort(frame.time[own], kind="stable")][3 : 3 + length]
            first[own] = own[0]

    def held(speed, direction):
        return (
            speed if which == "reported_direction" else speed[first],
            direction if which == "reported_speed" else direction[first],
        )

    return sent_as(frame, held)


def lost(frame, plain):
    return float(np.hypot(*frame.residual.T).mean() - np.hypot(*plain.residual.T).mean())


def test_values_that_repeat_by_chance_are_not_stuck(plain):
    assert repeated_of(plain) is None
    floored = sent_as(plain, lambda s, d: (np.maximum(s, np.quantile(s, 0.6)), d))
    assert repeated_of(floored) is None
    coarse = sent_as(plain, lambda s, d: (s, np.round(d / 0.3) * 0.3))
    assert repeated_of(coarse) is None


@pytest.mark.parametrize("which", WHICH)
def test_what_stuck_is_found_and_what_it_costs(plain, which):
    frame = stuck(plain, (1, 4), which)
    found = repeated_of(frame)
    assert found is not None
    assert (found.component, found.tails) == (which, (1, 4))
    true = lost(frame, plain)
    assert abs(found.saved.mean() - true) < 0.12 * true
    low, high = np.quantile(found.drawn, (0.005, 0.995))
    assert low - 0.05 * true <= true <= high + 0.05 * true
    others = ~np.isin(frame.aircraft, (1, 4))
    np.testing.assert_allclose(found.lifted.u_rep[others], frame.u_rep[others], atol=1e-9)


def test_a_value_stuck_on_one_day_is_not_confirmed(plain):
    day = np.unique(plain.day)[3]
    once = np.where(plain.day == day, stuck(plain, (1,), "reported_wind").u_rep, plain.u_rep)
    assert repeated_of(dataclasses.replace(plain, u_rep=once)) is None


def test_the_diagnosis_tells_the_winds_that_stuck_and_nothing_else(plain):
    frame = stuck(plain, (1, 4), "reported_wind")
    report = diagnose(frame, catalogue={}).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert (place.component, place.variables) == ("reported_wind", ["unchanged"])
    assert list(place.tails) == [plain.tails[1], plain.tails[4]]
    low, high = report.unknown.closure.reduction_ci
    true = lost(frame, plain) / KNOT
    assert low - 0.05 * true <= true <= high + 0.05 * true
