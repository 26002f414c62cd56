"""An offset is no drift, a drift is; what the day fields take up is said to be untestable."""

from __future__ import annotations

import numpy as np
from tests.gap.toy import make_frame

from airswing.gap.attribute import Rules, choose
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence import Candidate, Score

DRIFTING = {n: CATALOGUE[n] for n in ("compass_offset", "compass_drift")}


def found(error, catalogue):
    def own(context):
        return np.where(context["aircraft"] == 2, error(context), 0.0)

    frame = make_frame(seed=3, aircraft=5, days=16, noise=0.3, heading_error=own)
    made = diagnose(frame, catalogue=catalogue, maps=False, dictionary=False)
    return [(e["name"], e["tails"]) for e in made.report["effects"]], frame.tails[2]


def test_a_lasting_offset_is_not_named_a_drift():
    named, tail = found(lambda c: np.radians(1.0), DRIFTING)
    assert named == [("compass_offset", [tail])]


def test_a_drift_is_named():
    named, tail = found(lambda c: np.radians(0.2) * (c["time"] - c["time"].min()) / 86400, DRIFTING)
    assert named == [("compass_drift", [tail])]


def score(name, known, tempered, size):
    one = np.ones(2)
    what = Candidate(name, np.array([0]), "aircraft", np.ones(1), known)
    return Score(what, tempered, tempered, 1.0, one, tempered * one, one[:, None], size * one, one)


def test_an_unknown_must_beat_effects_too_small_to_be_stated():
    rules = Rules(size=0.2, unknown_margin=3.0)
    small, group = score("heater_current", True, 8.0, 0.1), score("cross:icing", False, 9.0, 0.4)
    assert choose([group, small], rules) is None
    clear = score("cross:icing", False, 12.0, 0.4)
    assert choose([clear, small], rules) is clear
