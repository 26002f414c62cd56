"""Scores against hand-worked values: names, aircraft, parameters, dates, closures."""

import hashlib
import json

import numpy as np
import pytest
from tests.blind_check.made_up import claim, gap, place

from airswing.blind_check import score_case, targets
from airswing.blind_check.score import date_error, parameter_errors, standardised_errors
from airswing.blind_check.summary import check_figure, confusion, of_default, reliability
from airswing.errors import InputError
from airswing.synthetic.sealed.labels import open_seal, seal

FLEET = ["N401", "N402", "N403", "N404"]
HARD_IRON = {"name": "hard_iron", "tails": ["N401", "N402"], "period": None}
HARD_IRON |= {"parameters": {"amplitude_deg": 2.0, "phase_deg": 30.0}}


def label(kind="single", effects=None, **changes):
    effects = [HARD_IRON] if effects is None else effects
    names = list(dict.fromkeys(effect["name"] for effect in effects))
    return {
        "name": "case_001",
        "rung": 1,
        "kind": kind,
        "variant": "plain",
        "outside": None,
        "world": "default",
        "size": 0.8,
        "focus": names,
        "names": names,
        "effects": effects,
        "without": [],
        "background": [],
        "closure": {"before": 7.0, "after": 6.5},
    } | changes


def outside(tails=("N401",), variables=("hour",)):
    effect = {"name": "outside", "tails": tails, "parameters": {}, "period": None}
    return label("outside", effects=[effect], outside={"variables": list(variables)})


def closing(reduction):
    """An entry's closure, kt."""
    return {"closure": {"reduction": reduction}}


NULL = label("null", effects=[], closure={"before": 6.5, "after": 6.5})
ZERO, NEAR = pytest.approx(0.0, abs=1e-9), pytest.approx
OUTLIERS = claim("outliers", closure={"reduction": 0.5, "reduction_ci": [0.4, 0.6]})
SCORES = {
    "a perfect diagnosis": (
        label(),
        gap(claim()),
        {"first_right": True, "all_named": True, "in_set": True, "detected": True}
        | {"precision": 1.0, "recall": 1.0, "parameter_error": ZERO, "unknown": False}
        | {"closure_error": ZERO, "closure_covered": True, "false_names": []},
    ),
    "a wrong first name whose credible set has the truth": (
        label(),
        gap(claim("soft_iron", ambiguous_with=["hard_iron"])),
        {"first_right": False, "all_named": False, "in_set": True}
        | {"false_names": ["soft_iron"], "parameter_error": None},
    ),
    "false claim": (NULL, gap(claim("tas_scale")), {"in_set": None, "false_names": ["tas_scale"]}),
    "a name that was removed": (
        label("removed", without=["hard_iron"]),
        gap(claim("compass_step")),
        {"first_right": False, "false_names": ["compass_step"]},
    ),
    "other aircraft": (
        label(),
        gap(claim(tails=["N402", "N403", "N404"])),
        {"precision": NEAR(1 / 3), "recall": 0.5},
    ),
    "a failure": (label(), None, {"failure": "exit status 1"}),
    "no claim": (outside(), gap(), {"unknown_first": False}),
    "a variable that implies the true one": (
        outside(variables=["heading"]),
        gap(unknown=[place("magnetic_heading")]),
        {"variable_first": True},
    ),
    "another variable": (outside(), gap(unknown=[place("bank")]), {"variable_first": False}),
    "the entry that closes most states the variable": (
        outside(),
        gap(unknown=[place("bank", **closing(0.1)), place("hour", **closing(0.4))]),
        {"variable_first": True},
    ),
    "an unknown on other aircraft": (
        outside(tails=["N401", "N402"]),
        gap(unknown=[place(tails=["N401", "N403"])]),
        {"unknown_first": True, "variable_first": True, "precision": 0.5, "recall": 0.5},
    ),
    "an unknown of the fleet": (
        outside(tails=None),
        gap(unknown=[place(tails=[])]),
        {"precision": 1.0, "recall": 1.0},
    ),
    "a false name that closes less than the unknown": (
        outside(),
        gap(claim("time_lag", **closing(0.2)), unknown=[place(**closing(0.3))]),
        {"unknown_first": True},
    ),
    "a false name that closes more": (
        outside(),
        gap(claim("time_lag", **closing(0.5)), unknown=[place(**closing(0.3))]),
        {"unknown_first": False},
    ),
    "the closure of the background is subtracted": (
        label(background=["outliers"]),
        gap(OUTLIERS, claim(), closure={"before": 7.0, "after": 6.0, "reduction_ci": [0.8, 1.2]}),
        {"closure_error": ZERO, "closure_interval": NEAR([0.3, 0.7]), "closure_covered": True},
    ),
    "an interval without the truth": (
        label(),  # the true reduction is 0.5
        gap(claim(), closure={"before": 7.0, "after": 6.7, "reduction_ci": [0.1, 0.45]}),
        {"closure_error": NEAR(0.2), "closure_interval": NEAR([0.1, 0.45])}
        | {"closure_covered": False},
    ),
    "a phase of 90 degrees: amplitude and phase are one vector": (
        label(),
        gap(claim(parameters={"amplitude_deg": 2.0, "phase_deg": 120.0})),
        {"parameter_error": NEAR(np.sqrt(2))},
    ),
    "the opposite amplitude and phase": (
        label(),
        gap(claim(parameters={"amplitude_deg": -2.0, "phase_deg": 210.0})),
        {"parameter_error": ZERO},
    ),
}


@pytest.mark.parametrize("name", SCORES)
def test_a_case_is_scored(name):
    truth, content, expected = SCORES[name]
    score = score_case(truth, content, failure="exit status 1", fleet=FLEET)
    assert {name: score[name] for name in expected} == expected


def test_effects_of_the_background_are_neither_right_nor_wrong():
    hard = label("null", effects=[], background=["outliers"], world="hard")
    score = score_case(hard, gap(claim("outliers")))
    assert score["false_names"] == [] and not score["detected"] and score["claims"] == []
    sensor = label("null", effects=[], background_components=["across_heading"])
    heading = place(component="across_heading")
    assert not score_case(sensor, gap(unknown=[heading]))["unknown"]
    score = score_case(sensor, gap(unknown=[heading, place(component="along_wind")]))
    assert score["unknown"] and score["claims"] == [("unknown", 0.97, False)]


def test_parameters_of_each_affected_aircraft_are_compared():
    true = {"tails": ["a", "b"], "parameters": {"offset_deg": 2.0}}
    per_tail = {
        tail: {"parameters": {"offset_deg": value}, "standard_errors": {"offset_deg": 0.1}}
        for tail, value in {"a": 2.2, "b": 1.0, "x": 9.0}.items()
    }
    claims = [claim(per_tail=per_tail)]
    assert parameter_errors(("offset_deg",), true, claims) == pytest.approx([0.1, 0.5])
    assert standardised_errors(("offset_deg",), true, claims) == pytest.approx([2.0, -10.0])


def test_date_error_takes_the_nearest_stated_start():
    true = ["2009-03-11T00:00:00", None]
    assert date_error(true, [["2009-03-13", None], None, [None, "2009-03-11"]]) == 2.0
    assert date_error(true, [None]) is None


def test_reliability_by_hand():
    claims = [("name", 0.97, True)] * 18 + [("name", 0.97, False)] * 2 + [("unknown", 0.6, True)]
    table = reliability(claims)
    assert table["right"].tolist() == [1.0, 0.9] and table["number"].tolist() == [1, 20]


def test_targets_by_hand():
    right, silent = score_case(label(), gap(claim())), score_case(label(), gap())
    failed = score_case(label(), None, failure="no")
    table = targets([right, silent, failed]).set_index("figure")
    first = table.loc["first name right, single effects"]
    assert (first["reached"], first["number"], first["met"]) == (0.5, 2, False)
    assert table.loc["nulls with any claim", "met"] is None
    interval = "closure interval contains the truth"
    assert table.loc[interval, "reached"] == 1.0 and table.loc[interval, "met"]
    many = targets([right] * 60).set_index("figure")
    assert not many.loc[interval, "met"]  # 60 of 60 exceed 98 %
    assert of_default([right, silent | {"world": "hard"}]) == [right]


def test_confusion_and_figure():
    scores = [
        score_case(label(), gap(claim())),
        score_case(label(), gap(claim("soft_iron"))),
        score_case(label("null", effects=[]), gap()),
        score_case(outside(), gap(unknown=[place()]), fleet=FLEET),
    ]
    counts = confusion(scores)
    assert list(counts.index) == ["hard_iron", "outside", "nothing"]
    assert list(counts.columns) == ["hard_iron", "soft_iron", "nothing", "unknown"]
    assert counts.to_numpy().tolist() == [[1, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]
    assert len(check_figure(scores).axes) == 4 and len(check_figure([]).axes) == 4


def test_the_figure_draws_closure_intervals_to_their_ends():
    above = {"before": 7.0, "after": 6.7, "reduction_ci": [0.4, 0.6]}  # 0.3 is stated
    axes = check_figure([score_case(label(), gap(claim(), closure=above))]).axes
    closure = next(panel for panel in axes if panel.get_title() == "Closure")
    _, _, (bars,) = closure.containers[0].lines
    (ends,) = (segment[:, 1] for segment in bars.get_segments())
    assert ends.tolist() == pytest.approx([0.3, 0.6])


def test_the_published_digest_is_that_of_the_sealed_bytes(tmp_path):
    digest = seal([label()], tmp_path / "sealed")
    path = tmp_path / "sealed" / "labels.json"
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (tmp_path / "sealed.sha256").read_text().split() == [digest, "labels.json"]
    assert open_seal(tmp_path / "sealed", digest=digest) == json.loads(json.dumps([label()]))
    path.write_text(path.read_text().replace("hard_iron", "soft_iron"))
    with pytest.raises(InputError, match="labels"):
        open_seal(tmp_path / "sealed", digest=digest)
    with pytest.raises(InputError, match="no sealed labels"):
        open_seal(tmp_path, digest=digest)
