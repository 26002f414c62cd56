"""Adding an effect is one new file: diagnosis, words, page, simulation and blind check have it.

The effect is made here, as a file of the catalogue would make it, and registered; nothing else in
the package knows of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
import yaml
from tests.blind_check.made_up import informed
from tests.gap.toy import make_frame

from airswing.blind_check import Plan, gap_check
from airswing.blind_check.summary import case_table
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE, Parameter, register, separated_by, unregister
from airswing.gap.effects.base import DEGREE, HeadingEffect, ProportionalEffect
from airswing.gap.simulation.effects_file import read_effects
from airswing.gap.simulation.forward import remove_effects, simulate
from airswing.report.gap.gap_page import write_gap_page
from airswing.report.gap.words import verdict
from airswing.synthetic.instrument import UNIT_FAULTS
from airswing.synthetic.sealed.cases import Size
from airswing.synthetic.sealed.draws import Draw, Signed

NAME = "cold_soak"


def freeze(setting, fault, where):
    """The generator's physics of it: a housing that turns as it cools."""
    cold = (273.15 - setting.temperature[where]) / 10.0
    setting.unit.rotation[where] += np.radians(fault.value("rate_deg")) * cold


class ColdSoak(ProportionalEffect, HeadingEffect):
    """Heading error proportional to the cold."""

    name = NAME
    title = "heading error that grows with the cold"
    draw = Draw(
        Signed("rate_deg"),
        ("rate_deg",),
        compared=("rate_deg",),
        places=("temperature",),
        fault=freeze,
    )
    distinguished_by: ClassVar[Mapping[str, str]] = {"compass_offset": "flights in warm air"}
    physics = "The sensor's housing turns in its mount as it cools."
    source = "Made for this test."
    parameters = (
        Parameter("rate_deg", "degree", 0.5, "per 10 K below freezing", required=True, si=DEGREE),
    )
    needs = ("magnetic_heading", "temperature")
    column_names = ("rate",)

    def basis(self, frame):
        return np.asarray((273.15 - frame.temperature) / 10.0)[None]


@pytest.fixture(scope="module")
def added():
    register(ColdSoak())
    yield CATALOGUE[NAME]
    unregister(NAME)
    UNIT_FAULTS.pop(NAME, None)


@pytest.fixture(scope="module")
def cold(added, tmp_path_factory):
    """A toy archive whose true wind the units with the effect report, and the effect."""
    plain = make_frame(seed=5, aircraft=6, days=16, noise=0.3)
    entry = {
        "name": NAME,
        "tails": [plain.tails[1], plain.tails[4]],
        "parameters": {"rate_deg": 1.2},
    }
    path = tmp_path_factory.mktemp("added") / "effects.yaml"
    path.write_text(yaml.safe_dump([entry]))
    (active,) = read_effects(path)
    blown = replace(plain, u_ref=plain.u_rep, v_ref=plain.v_rep)
    sent = simulate(blown, effects=[active])
    return plain, replace(sent, u_ref=plain.u_ref, v_ref=plain.v_ref), active


def test_the_simulation_takes_it_and_it_is_taken_off_again(cold):
    plain, affected, active = cold
    left = remove_effects(affected, [active])
    assert np.abs(affected.residual - plain.residual).max() > 1.0
    assert left.residual == pytest.approx(plain.residual, abs=1e-6)


def test_the_diagnosis_words_and_page_have_it(cold, tmp_path, names_only):
    _, frame, active = cold
    few = {name: CATALOGUE[name] for name in ("compass_offset", "hard_iron", "tas_scale", NAME)}
    made = diagnose(frame, catalogue=few)
    (effect,) = made.report.effects
    assert effect.name == NAME and effect.tails == list(active.tails)
    for entry in effect.per_tail.values():
        assert entry.parameters["rate_deg"] == pytest.approx(1.2, abs=0.15)
    assert f"{NAME.replace('_', ' ')} on" in verdict(made.report).lower()
    page = write_gap_page(tmp_path, gap=made.report, maps=made.dataset)
    assert "Cold soak (heading error that grows with the cold)" in page.read_text()
    assert separated_by("compass_offset", NAME) == "flights in warm air"


def test_the_blind_check_draws_writes_seals_and_scores_it(added, tmp_path, monkeypatch):
    tiny = Size(days=3, aircraft=3, sizes=(0.8,), coarse=True)
    monkeypatch.setattr(Size, "fast", classmethod(lambda cls: tiny))
    plan = Plan(2, 3, True, nulls=0, rungs=(1,), names=(NAME,))
    check = gap_check(tmp_path, plan, diagnoser=informed(tmp_path))
    assert [label["focus"] for label in check.labels] == [[NAME], [NAME]]
    assert all(s["first_right"] and s["parameter_error"] == 0.0 for s in check.scores)
    for label in check.labels:
        assert label["closure"]["before"] > label["closure"]["after"]
    assert f"| {NAME} |" in case_table(check)
