"""The check on tiny archives, also of an effect added as one file, and by the command."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import pytest
import yaml
from tests.blind_check.made_up import informed
from tests.command import airswing
from tests.gap.toy import effect, make_frame

from airswing.blind_check import Plan, gap_check, write_report
from airswing.blind_check.check import run_command
from airswing.blind_check.score import draws
from airswing.blind_check.summary import case_table, summary_table
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE, Parameter, separated_by
from airswing.gap.effects.base import HeadingEffect, ProportionalEffect
from airswing.gap.simulation.effects_file import read_effects
from airswing.gap.simulation.forward import remove_effects
from airswing.report.gap.gap_page import write_gap_page
from airswing.report.gap.words import verdict
from airswing.synthetic.instrument import UNIT_FAULTS
from airswing.synthetic.sealed.cases import Size
from airswing.synthetic.sealed.draws import Draw, Signed

NAMES = ("compass_offset", "hard_iron", "tas_scale", "outliers")
PLAN = Plan(10, 4, True, rungs=(1, 3), names=NAMES)


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A tiny check, and what its diagnosis received."""
    root = tmp_path_factory.mktemp("check")
    tiny = Size(days=3, aircraft=3, sizes=(0.8, 1.6), coarse=True)
    seen = []

    def oracle(config, output, without):
        digest = (root / "sealed.sha256").read_text().split()[0]
        seen.append({"config": config, "digest": digest})
        return informed(root)(config, output, without)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Size, "fast", classmethod(lambda cls: tiny))
        check = gap_check(root, PLAN, diagnoser=oracle, workers=2)
        yield root, check, seen


def test_a_diagnosis_that_knows_the_labels_is_right(checked):
    _, check, _ = checked
    effects = [score for score in check.scores if score["kind"] != "null"]
    assert effects and all(s["first_right"] and s["all_named"] for s in effects)
    assert all(s["closure_error"] < 1e-9 and s["closure_covered"] for s in check.scores)
    assert not any(score["false_names"] for score in check.scores)


def test_the_diagnosis_receives_sealed_cases_that_share_their_winds(checked):
    root, check, seen = checked
    assert len(seen) == 10 and {case["digest"] for case in seen} == {check.digest}
    labels = (root / "sealed" / "labels.json").read_bytes()
    assert hashlib.sha256(labels).hexdigest() == check.digest
    references = set()
    for config in (case["config"] for case in seen):
        paths = " ".join(str(path.relative_to(root)) for path in config.parent.rglob("*"))
        text = config.read_text()
        assert not any(name in text + paths for name in (*draws(), "outside", "null", "sealed"))
        assert not (config.parent / "truth").exists()
        references.add(json.dumps(yaml.safe_load(text)["references"]))
    nulls = sum(score["kind"] == "null" for score in check.scores)
    assert len(references) == nulls == len(list((root / "winds").iterdir())) < len(seen) // 2


def test_a_finished_check_is_kept_and_failures_are_stated(checked):
    root, check, _ = checked

    def broken(config, output, without):
        raise RuntimeError("exit status 1: no")

    messages = []
    # diagnoses nothing again
    again = gap_check(root, PLAN, diagnoser=broken, say=messages.append)
    assert not any("rung 5" in message for message in messages)  # it was not asked for
    assert again.scores == check.scores and again.digest == check.digest
    missing = root / "diagnosed" / "case_001" / "gap.json"
    content = missing.read_text()
    missing.unlink()
    failed = gap_check(root, PLAN, diagnoser=broken)
    assert [s["failure"] for s in failed.scores if s["failure"]] == ["exit status 1: no"]
    missing.unlink(missing_ok=True)
    assert len(gap_check(root, PLAN, diagnoser=broken, so_far=True).scores) == 9
    missing.write_text(content)


def test_a_rung_that_is_given_twice_is_drawn_once():
    once, twice = (Plan(10, 4, True, rungs=rungs, names=NAMES) for rungs in ((1,), (1, 1)))
    assert len(twice.drawn()) == len(once.drawn()) == 10


def test_the_report_lists_every_figure_and_case(checked, tmp_path):
    _, check, _ = checked
    text = write_report(tmp_path, check, command=PLAN.command).read_text()
    assert check.digest in text and "airswing gap-check --cases 10 --seed 4 --fast" in text
    assert all(score["name"] in text for score in check.scores)
    assert summary_table(check) in text and (tmp_path / "gap_check.png").stat().st_size > 10_000


def diagnosed(config, output, without):
    """Run the public command: in a new process for the first archive, else in this one."""
    if config.parent.name == "case_001":
        return run_command(config, output, without)
    left_out = (f"--without={name}" for name in without)
    done = airswing("gap", config, "--output", output, "--quiet", *left_out)
    assert done.returncode == 0, done.stderr
    return json.loads((output / "gap.json").read_text())


@pytest.mark.slow
def test_a_short_check_by_the_public_command(tmp_path, monkeypatch, no_gap_page):
    short = Size(days=12, aircraft=5, sizes=(1.6,), coarse=True)
    monkeypatch.setattr(Size, "fast", classmethod(lambda cls: short))
    plan = Plan(4, 2, True, rungs=(1,), names=("compass_offset", "hard_iron", "tas_scale"))
    check = gap_check(tmp_path, plan, diagnoser=diagnosed)
    assert not any(score["failure"] for score in check.scores)
    (null,) = (score for score in check.scores if score["kind"] == "null")
    effects = [score for score in check.scores if score["kind"] == "single"]
    assert len(effects) == 3
    assert not (null["claimed"] or null["unknown"])
    assert all(score["closure_true"] >= 0.1 and score["detected"] for score in effects)
    assert sum(score["in_set"] for score in effects) >= 2
    assert sum(score["first_right"] for score in effects) >= 2
    assert max(score["closure_error"] for score in check.scores) < 0.15


NAME = "cold_soak"


def freeze(setting, fault, where):
    """The generator's physics of it: a housing that turns as it cools."""
    cold = (273.15 - setting.temperature[where]) / 10.0
    setting.unit.rotation[where] += np.radians(fault.value("rate_deg")) * cold


class ColdSoak(ProportionalEffect, HeadingEffect):
    """Heading error proportional to the cold."""

    name = NAME
    title = "heading error that grows with the cold"
    draw = Draw(Signed("rate_deg"), ("rate_deg",), fault=freeze)
    distinguished_by: ClassVar[Mapping[str, str]] = {"compass_offset": "flights in warm air"}
    physics = "The sensor's housing turns in its mount as it cools."
    source = "Made for this test."
    parameters = (Parameter("rate_deg", "degree", 0.5, "per 10 K below freezing", required=True),)
    needs = ("magnetic_heading", "temperature")
    column_names = ("rate",)

    def basis(self, frame):
        return np.asarray((273.15 - frame.temperature) / 10.0)[None]


@pytest.fixture(scope="module")
def added():
    CATALOGUE[NAME] = ColdSoak()
    yield CATALOGUE[NAME]
    CATALOGUE.pop(NAME)
    UNIT_FAULTS.pop(NAME, None)


def test_an_effect_of_one_file_is_simulated_diagnosed_and_described(added, tmp_path, names_only):
    UNIT_FAULTS[NAME] = freeze
    entry = effect(NAME, [1, 4], rate_deg=1.2)
    (tmp_path / "effects.yaml").write_text(yaml.safe_dump([entry]))
    (active,) = read_effects(tmp_path / "effects.yaml")
    undisturbed, frame = (
        make_frame(seed=5, aircraft=6, days=16, noise=0.3, effects=effects)
        for effects in ([], [entry])
    )
    restored = remove_effects(frame, [active])
    assert np.abs(frame.residual - undisturbed.residual).max() > 1.0
    # the noise is turned too
    assert restored.residual == pytest.approx(undisturbed.residual, abs=0.1)
    few = {name: CATALOGUE[name] for name in ("compass_offset", "hard_iron", "tas_scale", NAME)}
    diagnosis = diagnose(frame, catalogue=few)
    (cold_soak,) = diagnosis.report.effects
    assert cold_soak.name == NAME and cold_soak.tails == list(active.tails)
    for entry in cold_soak.per_tail.values():
        assert entry.parameters["rate_deg"] == pytest.approx(1.2, abs=0.15)
    assert f"{NAME.replace('_', ' ')} on" in verdict(diagnosis.report).lower()
    page = write_gap_page(tmp_path, gap=diagnosis.report, maps=diagnosis.dataset)
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
