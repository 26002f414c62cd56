"""A curve of the dictionary becomes a table that a simulation holds."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap import names_and_unknowns
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.result.effect_entries import active_effects
from airswing.gap.simulation.forward import simulate

SETTING = {"seed": 5, "aircraft": 5, "days": 12, "noise": 0.3}


def three_cycles(context):
    own = np.isin(context["aircraft"], [1, 3])
    return np.where(own, np.radians(1.5) * np.sin(3 * context["magnetic_heading"]), 0.0)


@pytest.fixture(scope="module")
def told():
    """Without tables of the witness' own, unknowns are those of the dictionary."""
    frame = make_frame(**SETTING, heading_error=three_cycles)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(names_and_unknowns, "MOST_UNKNOWNS", 0)
        made = diagnose(frame, catalogue={"compass_offset": CATALOGUE["compass_offset"]})
    return frame, made.report


def test_the_table_is_the_fitted_curve(told):
    frame, report = told
    place = report.unknown.where[0]
    assert place.component == "cross" and place.variables == ["magnetic_heading"]
    table = place.curve.per_tail[frame.tails[3]]
    middle = np.radians(np.convolve(place.curve.edges[0], [0.5, 0.5], "valid"))
    wave = -112.0 * np.radians(1.5) * np.sin(3 * middle)  # to the right of the heading, m/s
    assert np.corrcoef(table, wave)[0, 1] > 0.95
    assert np.polyfit(wave, table, 1)[0] == pytest.approx(1.0, abs=0.25)


def test_the_loop_closes(told):
    frame, report = told
    active = active_effects(report)
    assert {effect.name for effect in active} == {"empirical"}
    bare = make_frame(**SETTING)
    sent = simulate(dataclasses.replace(bare, u_ref=bare.u_rep, v_ref=bare.v_rep), effects=active)
    left = np.hypot(sent.u_rep - frame.u_rep, sent.v_rep - frame.v_rep)
    was = np.hypot(bare.u_rep - frame.u_rep, bare.v_rep - frame.v_rep)
    assert (left**2).mean() < 0.35 * (was**2).mean()
