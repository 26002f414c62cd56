"""The exact fit: the size of a deviation is that put in, and aircraft with one fault share it."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.model.passes import prepared
from airswing.gap.model.refit import without_errors
from airswing.gap.model.terms import Term

AMPLITUDE = 2.0


def iron(context):
    affected = np.isin(context["aircraft"], [1, 4])
    cycle = np.radians(AMPLITUDE) * np.sin(context["magnetic_heading"] + 0.7)
    return np.where(affected, cycle, 0.0)


@pytest.fixture(scope="module")
def fitted():
    frame = make_frame(seed=5, aircraft=6, days=8, noise=0.3, heading_error=iron)
    effects = {"hard_iron": CATALOGUE["hard_iron"]}
    made = prepared(frame, effects, tables=False, seed=0)
    group = next(g for g in made.model.sums.candidates.groups if g.named and g.form == (0, 1))
    made.terms = [Term(group, "a", (1, 4), 2.7)]
    made.model.condition(made.terms)
    made.refit(effects)
    return made


def amplitudes(fitted):
    group = fitted.terms[0].group
    own = fitted.exact.theta[fitted.model.offsets[1] :].reshape(2, group.size)
    scales = np.asarray(CATALOGUE["hard_iron"].column_scales)
    return np.degrees(np.hypot(*((own @ group.transform.T) * scales).T))


def test_the_amplitude_is_that_put_in(fitted):
    assert amplitudes(fitted) == pytest.approx([AMPLITUDE, AMPLITUDE], rel=0.03)


def test_aircraft_with_one_fault_share_its_size(fitted):
    first, second = amplitudes(fitted)
    assert abs(first - second) < 0.02 * AMPLITUDE


def test_coefficients_without_a_group_of_days_scatter_about_those_of_all(fitted):
    spread = fitted.exact.by_fold - fitted.exact.theta
    assert np.abs(spread[:, fitted.model.offsets[1] :]).max() < 0.2
    assert np.linalg.eigvalsh(fitted.exact.covariance)[0] > 0


def test_a_sensor_effect_is_removed_exactly(fitted):
    frame = fitted.frame
    sine, cosine = np.sin(frame.heading), np.cos(frame.heading)
    turn = np.radians(3.0)
    effect = -frame.airspeed[:, None] * turn * np.stack([cosine, -sine], -1)
    corrected, off, faster = without_errors(frame, effect)
    assert off == pytest.approx(turn) and faster == pytest.approx(0.0, abs=1e-9)
    rotated = corrected.ground_u - corrected.airspeed * np.sin(frame.heading - turn)
    before = frame.ground_u - frame.airspeed * sine
    assert corrected.u_rep - frame.u_rep == pytest.approx(rotated - before, abs=1e-9)
