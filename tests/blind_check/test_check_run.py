"""The check end to end with made-up diagnosers, its archives, baselines and reports."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pandas as pd
import pytest
import yaml
from tests.blind_check.made_up import claimed, diagnosis
from tests.gap.toy import make_frame

from airswing.blind_check import Plan, baselines, gap_check
from airswing.blind_check.check_figures import check_figure, confusion, wilson
from airswing.blind_check.check_report import as_markdown, short_text, write_reports
from airswing.blind_check.check_run import _written
from airswing.blind_check.scoring import draws
from airswing.errors import InputError
from airswing.synthetic.sample.sample_archive import simulate_arrays
from airswing.synthetic.sealed import sealed_archives as archives
from airswing.synthetic.sealed.cases import Case, Size, World
from airswing.synthetic.sealed.draws import Drawn
from airswing.synthetic.sealed.injection import real_sensor, sensor_record, with_real_sensor
from airswing.synthetic.sealed.sealed_archives import Archivist, strength_of, twin_closure
from airswing.synthetic.sealed.sealing import digest_of

TINY = World(3, "default", 3, 3, coarse=True)
KNOT = 1852.0 / 3600.0


PLAN = Plan(
    10, 4, True, rungs=(1, 3), names=("compass_offset", "hard_iron", "tas_scale", "outliers")
)


def drawn(name, tails, **parameters):
    one = {"name": name, "tails": tails, "parameters": parameters, "period": None}
    return Drawn(name, (one,), draws()[name])


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A tiny check by a diagnoser that has read the labels, and what it saw of them."""
    root = tmp_path_factory.mktemp("check")
    tiny = Size(days=3, aircraft=3, sizes=(0.8, 1.6), coarse=True)
    seen: list[dict] = []
    labels: dict[str, dict] = {}

    def oracle(config, output, without):
        published = root / "sealed.sha256"
        seen.append({"config": config, "digest": published.read_text().split()[0]})
        if not labels:
            found = json.loads((root / "sealed" / "labels.json").read_text())
            labels.update({entry["name"]: entry for entry in found})
        return perfect(labels[config.parent.name], without)

    patch = pytest.MonkeyPatch()
    patch.setattr(Size, "fast", classmethod(lambda cls: tiny))
    check = gap_check(root, PLAN, diagnoser=oracle, baselines=False)
    yield root, check, seen
    patch.undo()


def perfect(label, without):
    """What a diagnosis that knows the label would write."""
    effects = [
        claimed(**effect, probability=1.0, share_of_gap=0.5)
        for effect in label["effects"]
        if effect["name"] not in without
    ]
    after = label["closure"]["after"]
    return diagnosis(effects, closure={**label["closure"], "ci": [after - 0.1, after + 0.1]})


def test_a_diagnosis_that_knows_everything_scores_everything(checked):
    _, check, _ = checked
    effects = [s for s in check.scores if s["kind"] != "null"]
    assert effects and all(s["first_right"] and s["all_named"] for s in effects)
    assert all(s["closure_error"] < 1e-9 and s["closure_covered"] for s in check.scores)
    assert all(s["jaccard"] == 1.0 for s in effects)
    assert not any(s["false_names"] for s in check.scores)


def test_the_digest_stands_before_every_diagnosis(checked):
    root, check, seen = checked
    assert len(seen) == 10
    assert {entry["digest"] for entry in seen} == {check.digest}
    assert digest_of(root / "sealed" / "labels.json") == check.digest


def test_nothing_handed_to_the_diagnosis_tells_the_effect(checked):
    root, _, seen = checked
    for entry in seen:
        folder = entry["config"].parent
        paths = " ".join(str(path.relative_to(root)) for path in folder.rglob("*"))
        text = entry["config"].read_text() + paths
        assert not any(name in text for name in (*draws(), "outside"))
        assert "null" not in text and "sealed" not in text
        assert not (folder / "truth").exists()


def test_cases_of_a_world_share_their_winds(checked):
    root, check, seen = checked
    globs = {
        json.dumps(yaml.safe_load(entry["config"].read_text())["references"]) for entry in seen
    }
    nulls = sum(score["kind"] == "null" for score in check.scores)
    assert nulls < len(seen) // 2
    assert len(globs) == nulls  # a world for each null, shared with cases that hold an effect
    assert len(list((root / "winds").iterdir())) == nulls


def test_strengths_are_what_was_asked_for(checked):
    _, check, _ = checked
    label = next(
        e for e in check.labels if e["kind"] == "single" and e["focus"] == ["compass_offset"]
    )
    offset = np.radians(label["effects"][0]["parameters"]["offset_deg"])
    # an offset turns the air vector: |dW| = V |offset|, V about 120 m/s for these aircraft
    assert abs(offset) * 120.0 == pytest.approx(label["size"], rel=0.25)


def test_a_finished_check_is_not_diagnosed_again_and_failures_are_told(checked, tmp_path):
    root, check, _ = checked

    def never(config, output, without):
        raise AssertionError("diagnosed again")

    again = gap_check(root, PLAN, diagnoser=never, baselines=False)
    assert again.scores == check.scores and again.digest == check.digest
    lost = root / "diagnosed" / "case_001" / "gap.json"
    kept = lost.read_text()
    lost.unlink()

    def broken(config, output, without):
        raise RuntimeError("exit status 1: no")

    part = gap_check(root, PLAN, diagnoser=never, baselines=False, so_far=True)
    assert [s["name"] for s in part.scores] == [s["name"] for s in check.scores[1:]]
    assert "9 of 10 sealed archives" in as_markdown(part, command="x")
    after = gap_check(root, PLAN, diagnoser=broken, baselines=False)
    lost.write_text(kept)
    assert after.failures == {"case_001": "exit status 1: no"}
    assert after.scores[0]["failure"] == "exit status 1: no"
    assert "exit status 1: no" in as_markdown(after, command="x")


def test_another_draw_of_the_same_number_is_another_check():
    assert PLAN.settings() == PLAN.settings()
    other = replace(PLAN, names=PLAN.names[:2])
    assert PLAN.settings()["drawn"] != other.settings()["drawn"]


def test_reports_tell_every_target_and_case(checked, tmp_path):
    _, check, _ = checked
    text = as_markdown(check, command="airswing gap-check --seed 4", proof={"wind": 0.001})
    assert check.digest in text and "0.0010" in text
    for label in check.labels:
        assert f"| {label['name']} |" in text
    assert "| 100 % |" in text and "no case" in text  # everything right; no dates to judge
    page = write_reports(tmp_path, check, command="airswing gap-check")
    assert page.read_text().count("<table") >= 4
    assert (tmp_path / "gap_check.png").stat().st_size > 20_000
    assert "first name right" in short_text(check)


def test_a_case_worth_closing_takes_a_draw_that_closes(tmp_path):
    def one(tails, size):
        saw = {"variable": "hour", "shape": "saw", "at": 0.1, "width": 0.26}
        parameters = {
            "component": "across_heading",
            "parts": [saw],
            "shape": "saw",
            "size_m_s": size,
            "sign": 1.0,
        }
        effect = {"name": "outside", "tails": tails, "parameters": parameters, "period": None}
        return Drawn("outside", (effect,))

    small, large = one(["N401"], 1.0), one(None, 2.0)
    case = Case("case_1", 4, "outside", TINY, (small,), (1.0,), (), "saw", (large,))
    archivist = Archivist(tmp_path)
    assert archivist.write(case)["size"] == pytest.approx(1.0, rel=0.05)
    worth = archivist.write(replace(case, name="case_2", worth=True))
    assert worth["size"] == pytest.approx(2.0, rel=0.05)
    assert worth["outside"]["closes_kt"] > 0.1


def test_worlds_written_side_by_side_are_the_same(tmp_path):
    tiny = World(5, "default", 2, 2, coarse=True)
    part = drawn("heater_current", ["N401"], offset_deg=1.0)  # its functions go to a process too
    worlds = [
        [Case("case_1", 1, "single", tiny, (part,), (1.6,))],
        [Case("case_2", 1, "null", replace(tiny, seed=6))],
    ]
    labels = [
        list(_written(tmp_path / str(workers), worlds, None, workers, lambda text: None))
        for workers in (1, 2)
    ]
    assert labels[0] == labels[1] and labels[0][0][0]["size"] == 1.6


def test_confusion_counts_by_hand():
    def score(kind, focus, claimed, *, unknown=False, right=False):
        return {
            "kind": kind,
            "focus": focus,
            "claimed": claimed,
            "unknown": unknown,
            "first_right": right,
            "failure": None,
        }

    truths, told, counts = confusion(
        [
            score("single", ["hard_iron"], ["hard_iron"], right=True),
            score("single", ["hard_iron"], ["soft_iron"]),
            score("null", [], []),
            score("outside", ["three_cycle"], [], unknown=True),
            score("outside", ["three_cycle"], ["soft_iron"], unknown=True)
            | {"unknown_first": True},
        ]
    )
    assert truths == ["hard_iron", "three_cycle", "nothing"]
    assert told == ["hard_iron", "soft_iron", "unknown", "nothing"]
    assert counts.tolist() == [[1, 1, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]


def test_figure_without_cases_says_so():
    assert check_figure([]).caption.startswith("Sealed cases: 0")
    low, high = wilson(5, 10)
    assert (low + high) / 2 == pytest.approx(0.5) and 0.3 < low < 0.4


def test_strength_of_an_airspeed_offset_is_itself():
    part = drawn("tas_offset", ["N402"], offset_m_s=0.7)
    assert strength_of(part, TINY) == pytest.approx(0.7, rel=0.01)


def test_strength_grows_with_the_archive_for_a_drift_alone():
    part = drawn("compass_drift", ["N402"], rate_deg_per_day=0.1)
    longer = replace(TINY, days=20)
    assert strength_of(part, longer) == pytest.approx(
        4.0 * strength_of(part, replace(TINY, days=5)), rel=1e-6
    )


def test_a_drift_of_the_last_days_is_as_strong_as_it_becomes_in_them():
    part = drawn("compass_drift", ["N402"], rate_deg_per_day=0.1)
    longer, begins = replace(TINY, days=20), (archives.START + timedelta(days=15)).isoformat()
    late = replace(part, effects=({**part.effects[0], "period": [begins, None]},))
    assert strength_of(late, longer) == pytest.approx(strength_of(part, replace(TINY, days=5)))


def test_the_true_closure_is_that_of_the_twin_without_the_effect(tmp_path):
    archivist = Archivist(tmp_path)
    effect = drawn("tas_offset", None, offset_m_s=1.0)
    label = archivist.write(Case("case_1", 1, "single", TINY, (effect,), (3.0,)))
    options = archives.generator_options(TINY) | {"derivatives": False}
    with_it = simulate_arrays(effects=label["effects"], **options)
    without = simulate_arrays(effects=[], **options)
    for name, frame in (("before", with_it), ("after", without)):
        u, v = (frame[c] - (frame[f"{c}_ruc"] + frame[f"{c}_rtfdaa"]) / 2 for c in "uv")
        used = (frame["temperature_qc"] == "pass") & u.notna()
        assert label["closure"][name] == pytest.approx(np.hypot(u, v)[used].mean() / KNOT, rel=1e-9)
    assert label["closure"]["before"] > label["closure"]["after"] + 0.3


def test_the_twin_is_compared_on_the_same_reports_whatever_their_order():
    made = simulate_arrays(effects=[], **archives.generator_options(TINY), derivatives=False)
    twin = made.sample(frac=1.0, random_state=1).reset_index(drop=True)
    assert not (made["made"].to_numpy() == twin["made"].to_numpy()).all()
    both = twin_closure(made, twin)
    assert both["before"] == pytest.approx(both["after"], rel=1e-12)
    twin.loc[twin["speed"] > 20, "temperature_qc"] = "fail"
    fewer = twin_closure(made, twin)  # what one of them does not use counts in neither
    assert fewer["before"] == pytest.approx(fewer["after"], rel=1e-12)
    assert fewer["before"] != pytest.approx(both["before"], rel=1e-3)


def test_a_case_on_real_data_needs_the_data(tmp_path):
    with pytest.raises(ValueError, match="real data"):
        Archivist(tmp_path).write(Case("case_1", 5, "null", replace(TINY, kind="sensor")))


def record(seconds=3000, noise=0.5, seed=0):
    """A made-up G1000 record: circles in a steady wind, a deviation curve, known noise."""
    rng = np.random.default_rng(seed)
    heading = np.radians(np.arange(seconds) * 0.7 % 360)
    error = np.radians(2.0 + 3.0 * np.sin(heading) + noise * rng.normal(size=seconds))
    true = heading - error
    east = 60.0 * np.sin(true) + 5.0
    north = 60.0 * np.cos(true) - 8.0
    return pd.DataFrame(
        {
            "HDG": np.degrees(heading),
            "TRK": np.degrees(np.arctan2(east, north)) % 360,
            "TAS": np.full(seconds, 60.0 / KNOT),
            "GndSpd": np.hypot(east, north) / KNOT,
            "AltMSL": np.full(seconds, 3000.0) + np.arange(seconds) % 7,
            "Roll": np.zeros(seconds),
        }
    )


def test_what_a_record_leaves_is_its_noise_and_not_its_deviation():
    left = np.degrees(sensor_record(record(noise=0.5)).heading_error)
    assert left.std() == pytest.approx(0.5, rel=0.06)
    silent = sensor_record(record(noise=0.0))
    assert np.degrees(np.abs(silent.heading_error)).max() < 0.06


def test_a_record_leaves_nothing_that_lasts_at_a_heading():
    one = sensor_record(record(noise=0.5))
    bins = (np.mod(one.magnetic, 2 * np.pi) / (2 * np.pi) * 36).astype(int)
    for error in (one.heading_error, one.airspeed_error):
        means = np.bincount(bins, error) / np.bincount(bins)
        assert np.abs(means).max() < 1e-12


def test_a_record_on_the_ground_is_refused():
    with pytest.raises(InputError, match="too little level flight"):
        sensor_record(record().assign(TAS=20.0))


def test_real_records_hold_errors_of_a_flux_valve(real):
    records = real_sensor(real("heading"))
    spread = [np.degrees(one.heading_error.std()) for one in records]
    assert len(records) == 3 and all(0.5 < value < 8.0 for value in spread)


def test_real_noise_comes_from_the_same_heading_and_repeats():
    options = archives.generator_options(TINY) | {"derivatives": False}
    frame = simulate_arrays(effects=[], **options)
    one = sensor_record(record(noise=0.5))
    marked = replace(one, heading_error=one.magnetic % (2 * np.pi), airspeed_error=0 * one.magnetic)
    out = with_real_sensor(frame, [marked], seed=1)
    own = np.mod(frame["heading"] - frame["declination"], 2 * np.pi)
    taken = np.mod(out["heading"] - frame["heading"], 2 * np.pi)
    apart = np.abs(np.angle(np.exp(1j * (own - taken))))
    assert np.degrees(apart.max()) <= 10.0 + 1e-6
    pd.testing.assert_frame_equal(out, with_real_sensor(frame, [marked], seed=1))


def test_least_squares_finds_an_offset_it_is_given():
    frame = make_frame(
        aircraft=4,
        days=8,
        model_error=0.5,
        heading_error=lambda c: np.where(c["aircraft"] == 1, np.radians(3.0), 0.0),
    )
    assert baselines.least_squares_bic(frame)["names"][0] == "compass_offset"
    assert "compass_offset" not in baselines.least_squares_bic(frame, ["compass_offset"])["names"]
    tree = baselines.slice_tree(frame)
    assert tree["detected"] and max(tree["importance"], key=tree["importance"].get) == "aircraft"
    assert tree["names"] == ["compass_offset"]


def test_the_classifier_needs_a_difference():
    rng = np.random.default_rng(1)
    frame = make_frame(aircraft=4, days=8)
    white = rng.normal(0, 2, (2, frame.size))
    noise = replace(frame, u_rep=frame.u_ref + white[0], v_rep=frame.v_ref + white[1])
    shifted = replace(noise, u_rep=noise.u_rep + 1.5)
    turned = replace(
        noise,
        u_rep=noise.u_rep + 1.5 * np.sin(frame.heading),
        v_rep=noise.v_rep + 1.5 * np.cos(frame.heading),
    )
    assert not baselines.classifier(noise)["detected"]
    assert baselines.classifier(turned)["area"] > baselines.classifier(noise)["area"] + 0.1
    assert baselines.classifier(shifted)["names"] == []


def test_gross_errors_close_what_they_add(tmp_path):
    pair = (drawn("outliers", None, fraction=0.04), drawn("tas_offset", None, offset_m_s=1.0))
    archivist = Archivist(tmp_path)
    alone = archivist.write(Case("case_1", 1, "single", TINY, pair[:1], (0.8,)))
    both = archivist.write(Case("case_2", 3, "pair", TINY, pair, (0.8, 3.0)))
    assert alone["closure"]["before"] > alone["closure"]["after"] + 0.3
    assert both["closure"]["after"] == pytest.approx(alone["closure"]["after"], rel=1e-9)


def test_an_outside_case_takes_the_first_draw_that_no_name_explains(tmp_path):
    def one(part, component="across_heading"):
        parameters = {
            "component": component,
            "parts": [part],
            "shape": part["shape"],
            "size_m_s": 1.5,
            "sign": 1.0,
        }
        effect = {"name": "outside", "tails": None, "parameters": parameters, "period": None}
        return Drawn("outside", (effect,))

    always = {"variable": "airspeed", "shape": "hinge", "at": 0.0, "width": 0.1}
    cycle = {"variable": "magnetic_heading", "shape": "linear", "at": 0.3, "width": 0.1}
    saw = {"variable": "hour", "shape": "saw", "at": 0.1, "width": 0.26}
    case = Case(
        "case_1",
        4,
        "outside",
        TINY,
        (one(cycle),),
        (1.5,),
        (),
        "saw",
        (one(always, "along_heading"), one(saw)),
    )
    label = Archivist(tmp_path).write(case)
    truth = label["outside"]
    assert truth["variables"] == ["hour"] and truth["named_share"] < 0.35
    assert label["size"] == truth["size_m_s"] == pytest.approx(1.5, rel=0.02)
    assert truth["carried"]["hour"] > 0.6  # bins smooth its edges
    closed = label["closure"]["before"] - label["closure"]["after"]
    assert truth["closes_kt"] == pytest.approx(closed, abs=0.02)
    assert label["closure"]["before"] > label["closure"]["after"]
