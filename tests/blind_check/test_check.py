"""The check end to end on tiny archives, with a diagnosis that reads the sealed labels."""

from __future__ import annotations

import hashlib
import json

import pytest
import yaml
from tests.blind_check.made_up import claim, gap

from airswing.blind_check import Plan, gap_check, write_report
from airswing.blind_check.score import draws
from airswing.blind_check.summary import summary_table
from airswing.synthetic.sealed.cases import Size

NAMES = ("compass_offset", "hard_iron", "tas_scale", "outliers")
PLAN = Plan(10, 4, True, rungs=(1, 3), names=NAMES)


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A tiny check, and what its diagnosis received."""
    root = tmp_path_factory.mktemp("check")
    tiny = Size(days=3, aircraft=3, sizes=(0.8, 1.6), coarse=True)
    seen: list[dict] = []

    def oracle(config, output, without):
        digest = (root / "sealed.sha256").read_text().split()[0]
        seen.append({"config": config, "digest": digest})
        labels = json.loads((root / "sealed" / "labels.json").read_text())
        label = next(one for one in labels if one["name"] == config.parent.name)
        effects = [claim(**one) for one in label["effects"] if one["name"] not in without]
        after = label["closure"]["after"]
        return gap(*effects, closure={**label["closure"], "ci": [after - 0.1, after + 0.1]})

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


def test_the_digest_is_published_before_every_diagnosis(checked):
    root, check, seen = checked
    assert len(seen) == 10 and {one["digest"] for one in seen} == {check.digest}
    labels = (root / "sealed" / "labels.json").read_bytes()
    assert hashlib.sha256(labels).hexdigest() == check.digest


def test_the_diagnosis_receives_nothing_that_names_the_effect(checked):
    root, _, seen = checked
    for one in seen:
        folder = one["config"].parent
        paths = " ".join(str(path.relative_to(root)) for path in folder.rglob("*"))
        text = one["config"].read_text() + paths
        assert not any(name in text for name in (*draws(), "outside", "null", "sealed"))
        assert not (folder / "truth").exists()


def test_cases_of_a_world_share_their_winds(checked):
    root, check, seen = checked
    references = {json.dumps(yaml.safe_load(s["config"].read_text())["references"]) for s in seen}
    nulls = sum(score["kind"] == "null" for score in check.scores)
    assert len(references) == nulls == len(list((root / "winds").iterdir())) < len(seen) // 2


def test_a_finished_check_is_kept_and_failures_are_stated(checked):
    root, check, _ = checked

    def never(config, output, without):
        raise AssertionError("diagnosed again")

    again = gap_check(root, PLAN, diagnoser=never)
    assert again.scores == check.scores and again.digest == check.digest
    missing = root / "diagnosed" / "case_001" / "gap.json"
    content = missing.read_text()
    missing.unlink()

    def broken(config, output, without):
        raise RuntimeError("exit status 1: no")

    failed = gap_check(root, PLAN, diagnoser=broken)
    assert [s["failure"] for s in failed.scores if s["failure"]] == ["exit status 1: no"]
    missing.unlink(missing_ok=True)
    assert len(gap_check(root, PLAN, diagnoser=never, so_far=True).scores) == 9
    missing.write_text(content)


def test_the_report_lists_every_figure_and_case(checked, tmp_path):
    _, check, _ = checked
    text = write_report(tmp_path, check, command=PLAN.command).read_text()
    assert check.digest in text and "airswing gap-check --cases 10 --seed 4 --fast" in text
    assert all(score["name"] in text for score in check.scores)
    assert summary_table(check) in text and (tmp_path / "gap_check.png").stat().st_size > 10_000
