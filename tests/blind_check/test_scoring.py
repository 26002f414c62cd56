"""Scores by hand: names, sets, aircraft, parameters, dates, closure, unknowns, probabilities."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from tests.blind_check.made_up import claimed, diagnosis, placed

from airswing.blind_check.check_summary import (
    baseline_rows,
    grouped,
    of_default,
    summarise,
    targets,
)
from airswing.blind_check.reliability_table import (
    reliability_rows,
    stated_claims,
    worst_gap,
)
from airswing.blind_check.scores import StatedClaim
from airswing.blind_check.scoring import (
    aircraft_overlap,
    date_error,
    draws,
    log_score,
    parameter_errors,
    score_case,
)
from airswing.errors import InputError
from airswing.gap.result.schema import UnknownClosureEntry, UnknownEntry
from airswing.synthetic.sealed.sealing import digest_of, open_seal, seal


def label(kind="single", effects=None, **changes):
    effects = (
        [
            {
                "name": "hard_iron",
                "tails": ["N401", "N402"],
                "parameters": {"amplitude_deg": 2.0, "phase_deg": 30.0},
                "period": None,
            }
        ]
        if effects is None
        else effects
    )
    names = list(dict.fromkeys(effect["name"] for effect in effects))
    return {
        "name": "case_001",
        "rung": 1,
        "kind": kind,
        "variant": "plain",
        "outside": None,
        "world": "default",
        "size": 0.8,
        "sizes": [0.8] * len(names),
        "focus": names,
        "names": names,
        "effects": effects,
        "without": [],
        "background": [],
        "closure": {"before": 7.0, "after": 6.5},
    } | changes


def claim(name="hard_iron", **changes):
    own = {
        "tails": ["N401", "N402"],
        "parameters": {"amplitude_deg": 2.0, "phase_deg": 30.0},
        "share_of_gap": 0.9,
    }
    return claimed(name, **own | changes)


def gap(*claims, unknown=(), closure=None):
    told = closure or {"before": 7.0, "after": 6.5, "ci": [6.4, 6.6]}
    return diagnosis(claims, places=unknown, closure=told)


def test_a_perfect_diagnosis():
    score = score_case(label(), gap(claim()))
    assert score["first_right"] and score["all_named"] and score["in_set"] and score["detected"]
    assert score["set_size"] == 1
    assert (score["precision"], score["recall"], score["jaccard"]) == (1.0, 1.0, 1.0)
    assert score["parameter_error"] == pytest.approx(0.0, abs=1e-12)
    assert score["closure_error"] == pytest.approx(0.0) and score["closure_covered"]
    assert score["false_names"] == [] and not score["unknown"]


def test_a_wrong_first_name_with_the_truth_among_its_rivals():
    score = score_case(label(), gap(claim("soft_iron", ambiguous_with=["hard_iron", "turn_error"])))
    assert not score["first_right"] and not score["all_named"]
    assert score["in_set"] and score["set_size"] == 3
    assert score["false_names"] == ["soft_iron"]
    assert score["jaccard"] is None and score["parameter_error"] is None


def test_silence_is_not_in_the_set():
    score = score_case(label(), gap())
    assert not score["detected"] and score["in_set"] is False and score["set_size"] is None


def test_a_null_has_no_truth_and_every_name_is_false():
    null = label("null", effects=[], closure={"before": 6.5, "after": 6.5}, size=0.0)
    quiet = score_case(null, gap(closure={"before": 6.5, "after": 6.5, "ci": [6.5, 6.5]}))
    assert quiet["false_names"] == [] and quiet["in_set"] is None
    loud = score_case(null, gap(claim("tas_scale")))
    assert loud["false_names"] == ["tas_scale"]


def test_gross_errors_of_the_hard_world_are_neither_right_nor_wrong():
    hard = label("null", effects=[], background=["outliers"])
    found = score_case(hard, gap(claim("outliers")))
    assert found["false_names"] == [] and not found["detected"]
    struck = {"name": "outliers", "tails": ["N401"], "parameters": {"fraction": 0.04}}
    own = label(effects=[struck | {"period": None}], background=["outliers"])
    assert score_case(own, gap(claim("outliers")))["detected"]


def test_what_a_background_name_closes_is_not_in_the_twin():
    struck = claim("outliers", closure={"reduction": 0.5, "reduction_ci": [0.4, 0.6]})
    told = {"before": 7.0, "after": 6.0, "reduction_ci": [0.8, 1.2]}
    found = gap(struck, claim(), closure=told)
    score = score_case(label(background=["outliers"]), found)
    assert score["first_right"] and score["in_set"]
    assert score["closure_error"] == pytest.approx(0.0)
    assert score["closure_interval"] == pytest.approx([0.3, 0.7]) and score["closure_covered"]
    alone = score_case(label(), found)
    assert alone["closure_error"] == pytest.approx(0.5) and alone["false_names"] == ["outliers"]


def test_heading_errors_of_a_real_record_are_neither_right_nor_wrong():
    sensor = label("null", effects=[], background_components=["across_heading"])
    heading = place(component="across_heading")
    found = score_case(sensor, gap(unknown=[heading]))
    assert found["of_background"] and not found["unknown"] and not found["detected"]
    assert found["claims"] == []
    for unknown in ([place(component="along_wind")], [heading, place(component="along_wind")]):
        other = score_case(sensor, gap(unknown=unknown))
        assert other["unknown"] and other["detected"] and not other["of_background"]
        assert other["claims"] == [("unknown", 0.97, False)]


def test_aircraft_overlap_by_hand():
    own = [{"tails": ["a", "b", "c"]}]
    found = [claimed(tails=["b", "c", "d", "e"])]
    assert aircraft_overlap(own, found) == (0.5, pytest.approx(2 / 3), pytest.approx(0.4))


def test_amplitude_and_phase_are_one_vector():
    own = [{"tails": None, "parameters": {"amplitude_deg": 1.0, "phase_deg": 0.0}}]
    turned = [claimed(parameters={"amplitude_deg": 1.0, "phase_deg": 90.0})]
    opposite = [claimed(parameters={"amplitude_deg": -1.0, "phase_deg": 180.0})]
    assert parameter_errors("hard_iron", own, turned) == [pytest.approx(np.sqrt(2))]
    assert parameter_errors("hard_iron", own, opposite) == [pytest.approx(0.0, abs=1e-12)]


def test_offset_and_cycle_weigh_by_their_root_mean_square():
    own = [{"tails": None, "parameters": {"offset_deg": 1.0, "amplitude_deg": 0.0}}]
    told = {"offset_deg": 1.0, "amplitude_deg": 1.0, "phase_deg": 17.0}
    found = [claimed(parameters=told)]
    assert parameter_errors("compass_step", own, found) == [pytest.approx(np.sqrt(0.5))]


def test_aircraft_with_parameters_of_their_own_are_judged_each():
    own = [{"tails": ["a", "b"], "parameters": {"offset_deg": 2.0}}]
    each = {t: {"parameters": {"offset_deg": v}} for t, v in {"a": 2.2, "b": 1.0, "x": 9.0}.items()}
    found = [claimed(parameters={"offset_deg": 1.6}, per_tail=each)]
    assert parameter_errors("compass_offset", own, found) == pytest.approx([0.1, 0.5])


def test_date_error_takes_the_nearest_start_told():
    true = ["2009-03-11T00:00:00", None]
    assert date_error(true, [["2009-03-13", None], None, [None, "2009-03-11"]]) == 2.0
    assert date_error(true, [None]) is None


def test_closure_interval_turns_into_one_of_the_reduction():
    closure = {"before": 7.0, "after": 6.7, "ci": [6.55, 6.9]}
    score = score_case(label(), gap(claim(), closure=closure))
    assert score["closure_error"] == pytest.approx(0.2)
    assert score["closure_covered"] is False  # the true reduction is 0.5, told 0.1 to 0.45
    low, high = score["closure_interval"]
    assert high - low == pytest.approx(0.35)


def test_log_score_by_hand():
    number = len(draws())
    assert log_score([], []) == pytest.approx(np.log2(0.999))
    half = [claimed(probability=0.5)]
    rest = (number - 1) * np.log2(0.999)
    assert log_score(half, ["hard_iron"]) == pytest.approx((np.log2(0.5) + rest) / number)
    assert log_score(half, []) == pytest.approx((np.log2(0.5) + rest) / number)
    sure = [claimed(probability=1.0)]
    assert log_score(sure, []) == pytest.approx((np.log2(0.001) + rest) / number)


FLEET = ["N401", "N402", "N403", "N404"]


def outside(tails=("N401",), variables=("hour",), **changes):
    effect = {
        "name": "outside",
        "tails": list(tails) if tails else None,
        "period": None,
        "parameters": {"component": "across_heading"},
    }
    truth = {
        "variables": list(variables),
        "component": "across_heading",
        "shape": "bump",
        "carried": {"hour": 0.9, "longitude": 0.8, "bank": 0.1},
    }
    return label("outside", effects=[effect], outside=truth | changes)


def place(variable="hour", tails=("N401",), reduction=None, ci=None, **changes):
    closure = None if reduction is None else {"reduction": reduction, "reduction_ci": ci}
    own = {"tails": list(tails), "closure": closure, "probability": 0.97}
    return placed(variable, **own | changes)


def quiet(*claims, places):
    """A diagnosis that closes nothing by name."""
    closure = {"before": 7.0, "after": 7.0, "reduction": 0.0, "reduction_ci": [0.0, 0.0]}
    return gap(*claims, unknown=places, closure=closure)


def scored(truth, found):
    return score_case(truth, found, fleet=FLEET)


def test_an_unknown_placed_with_no_false_name_ahead():
    own = place(held_out_energy=50.0)
    clean = scored(outside(), gap(unknown=[own]))
    assert clean["unknown_first"] and clean["placed"] and clean["variable_first"]
    behind = scored(outside(), gap(claim("time_lag", held_out_energy=9.0), unknown=[own]))
    assert behind["unknown_first"] and behind["false_names"] == ["time_lag"]
    ahead = scored(outside(), gap(claim("time_lag", held_out_energy=90.0), unknown=[own]))
    assert not ahead["unknown_first"]
    elsewhere = scored(outside(), gap(unknown=[place("bank", held_out_energy=50.0)]))
    assert elsewhere["unknown_first"] and not elsewhere["placed"]


def test_what_closes_more_stands_ahead_where_both_are_told_in_knots():
    unknown = [place(reduction=0.3, ci=[0.2, 0.4])]
    closure = {"before": 7.0, "after": 6.8, "reduction": 0.2, "reduction_ci": [0.1, 0.3]}
    small = claim("time_lag", share_of_gap=1.0, held_out_energy=1e6)
    assert scored(outside(), gap(small, unknown=unknown, closure=closure))["unknown_first"]
    closure |= {"after": 6.5, "reduction": 0.5}
    assert not scored(outside(), gap(small, unknown=unknown, closure=closure))["unknown_first"]


def test_a_false_name_counts_as_ahead_of_an_unknown_without_a_place():
    found = replace(gap(claim("time_lag")), unknown=UnknownEntry(True, ()))
    assert not scored(outside(), found)["unknown_first"]


def test_the_place_that_closes_most_names_the_variable_first():
    places = [place("bank", reduction=0.1, ci=[0, 0.2]), place("hour", reduction=0.4, ci=[0.3, 1])]
    assert scored(outside(), quiet(places=places))["variable_first"]
    found = scored(outside(), quiet(places=places[:1]))
    assert not found["variable_first"] and not found["variable_near"]
    assert not found["variable_any"]


def test_a_variable_that_carries_nearly_as_much_is_near_and_other_names_are_the_same():
    near = scored(outside(), quiet(places=[place("longitude")]))
    assert not near["variable_first"] and near["variable_near"]  # 0.8 of 0.9 it carries
    level = scored(
        outside(variables=["altitude"], carried={"altitude": 1.0}),
        quiet(places=[place("pressure")]),
    )
    assert level["variable_first"]


def test_aircraft_of_an_unknown():
    found = scored(outside(tails=["N401", "N402"]), quiet(places=[place(tails=["N401", "N403"])]))
    assert (found["unknown_precision"], found["unknown_recall"]) == (0.5, 0.5)
    everyone = scored(outside(tails=None), quiet(places=[place(tails=[])]))
    assert (everyone["unknown_precision"], everyone["unknown_recall"]) == (1.0, 1.0)
    one = scored(outside(tails=["N401"]), quiet(places=[place(tails=[])]))
    assert (one["unknown_precision"], one["unknown_recall"]) == (0.25, 1.0)


def test_the_closure_of_an_unknown_adds_to_that_of_the_names():
    stated = quiet(places=[place(reduction=0.4, ci=[0.3, 0.6])])
    found = scored(outside(), stated)
    assert found["unknown_closure_stated"] == pytest.approx(0.4)
    assert found["unknown_closure_error"] == pytest.approx(0.1)
    assert found["unknown_closure_covered"]
    together = replace(stated.unknown, closure=UnknownClosureEntry(7.0, 6.9, 0.1, [0.05, 0.15]))
    names = replace(stated.closure, reduction=0.2, reduction_ci=[0.1, 0.25])
    whole = scored(outside(), replace(stated, unknown=together, closure=names))
    assert whole["unknown_closure_stated"] == pytest.approx(0.3)
    assert not whole["unknown_closure_covered"]  # 0.15 to 0.4 does not hold 0.5
    silent = scored(outside(), quiet(places=[]))
    assert silent["unknown_closure_error"] == pytest.approx(0.5)
    assert silent["variable_first"] is None and not silent["unknown_closure_covered"]
    assert "could_hide_holds" not in silent and "could_hide_holds" not in found
    for most, holds in ((0.4, False), (0.6, True)):  # 0.5 is true
        nothing = quiet(places=[])
        told = replace(nothing, closure=replace(nothing.closure, could_hide_kt=most))
        assert scored(outside(), told)["could_hide_holds"] is holds


def test_an_effect_told_twice_on_an_aircraft_is_a_repeat():
    twice = [claim("compass_step", tails=["N401"]), claim("compass_step", tails=["N401", "N402"])]
    one = [{"name": "compass_step", "tails": ["N401", "N402"], "parameters": {}, "period": None}]
    assert score_case(label(effects=one), gap(*twice))["repeated_names"] == ["compass_step"]
    apart = [claim("compass_step", tails=["N401"]), claim("compass_step", tails=["N402"])]
    assert score_case(label(effects=one), gap(*apart))["repeated_names"] == []


def test_stated_probabilities_in_bins_by_hand():
    right, wrong = (StatedClaim("name", 0.97, one) for one in (True, False))
    claims = [right] * 18 + [wrong] * 2 + [StatedClaim("unknown", 0.6, True)]
    rows = reliability_rows(claims)
    assert [(row["low"], row["claims"], row["right"]) for row in rows] == [
        (0.5, 1, 1.0),
        (0.95, 20, 0.9),
    ]
    gap_, number = worst_gap(claims)
    assert gap_ == pytest.approx(0.07) and number == 20  # the bin of one claim is not judged
    assert worst_gap(claims[:19]) == (None, 0)
    assert reliability_rows([StatedClaim("name", 1.0, True)])[0]["low"] == 0.99


def test_claims_of_the_background_and_of_hard_worlds_are_not_judged():
    found = gap(claim(), claim("outliers"), unknown=[place()])
    truth = label(background=["outliers"], world="hard")
    assert stated_claims(truth, found, ["hard_iron"]) == [("name", 0.99, True)]
    assert stated_claims(label(), found, ["hard_iron"]) == [
        ("name", 0.99, True),
        ("name", 0.99, False),
        ("unknown", 0.97, False),
    ]


def test_a_removed_effect_has_no_right_name():
    removed = label("removed", without=["hard_iron"])
    score = score_case(removed, gap(claim("compass_step")))
    assert not score["first_right"] and score["false_names"] == ["compass_step"]


def test_a_failed_diagnosis_keeps_its_message():
    score = score_case(label(), None, failure="exit status 1")
    assert score["failure"] == "exit status 1" and "first_right" not in score


def test_summary_and_targets_by_hand():
    right, silent = score_case(label(), gap(claim())), score_case(label(), gap())
    failed = score_case(label(), None, failure="no")
    found = summarise([right, silent, failed])
    assert (found["cases"], found["failed"]) == (3, 1)
    assert found["first_right"] == 0.5 and found["detected"] == 0.5
    reached = {entry["what"]: entry for entry in targets([right, silent])}
    first = reached["first name right, single effects and their forms, any scope"]
    assert (first["reached"], first["cases"], first["met"]) == (0.5, 2, False)
    assert reached["claims on nulls (a name or an unknown)"]["met"] is None
    whole = reached["closure interval of what is named holds the truth"]
    assert whole["target"] == (0.90, 0.98) and whole["reached"] == 1.0 and whole["met"]
    many = {entry["what"]: entry for entry in targets([right] * 60)}
    assert not many[whole["what"]]["met"]  # 60 of 60 are more than 98 %
    assert of_default([right, silent | {"world": "hard"}, silent | {"world": "model"}]) == [right]
    assert set(grouped([right, silent], "effect")) == {"hard_iron"}


def test_baselines_stand_beside_ours_on_the_same_cases():
    ours = [score_case(label(), gap(claim()))]
    theirs = [
        {
            "kind": "single",
            "size": 0.8,
            "detected": True,
            "first_right": False,
            "false_names": ["tas_scale"],
        }
    ]
    rows = baseline_rows(ours, {"least squares": theirs})
    assert [row["first_right"] for row in rows] == [1.0, 0.0]
    assert [row["extra_names"] for row in rows] == [0.0, 1.0]


def test_the_seal_publishes_the_digest_of_the_very_bytes(tmp_path):
    digest = seal([label()], tmp_path / "sealed")
    path = tmp_path / "sealed" / "labels.json"
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest() == digest_of(path)
    assert (tmp_path / "sealed.sha256").read_text().split() == [digest, "labels.json"]
    assert open_seal(tmp_path / "sealed", digest=digest) == json.loads(json.dumps([label()]))


def test_a_touched_label_breaks_the_seal(tmp_path):
    digest = seal([label()], tmp_path / "sealed")
    path = tmp_path / "sealed" / "labels.json"
    path.write_text(path.read_text().replace("hard_iron", "soft_iron"))
    with pytest.raises(InputError, match="not those whose digest"):
        open_seal(tmp_path / "sealed", digest=digest)


def test_sealed_labels_that_are_gone(tmp_path):
    with pytest.raises(InputError, match="no sealed labels"):
        open_seal(tmp_path, digest="0" * 64)
