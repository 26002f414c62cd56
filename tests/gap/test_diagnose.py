"""The diagnosis of toy archives: what is there is named, located and closed, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.gap.frames import headings_dataset
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.diagnose import attributed, diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.simulation.effects_file import active_effects
from airswing.products.whole_files import plain

SMALL = {
    n: CATALOGUE[n]
    for n in ("compass_offset", "hard_iron", "soft_iron", "compass_step", "tas_scale")
}


@pytest.fixture(scope="module")
def quiet():
    return make_frame(seed=5, aircraft=6, days=12, noise=0.3)


@pytest.fixture(scope="module")
def iron():
    """One cycle of 1.5 degrees on two of six aircraft."""

    def error(context):
        affected = np.isin(context["aircraft"], [1, 4])
        return np.where(affected, np.radians(1.5) * np.sin(context["magnetic_heading"] + 0.7), 0.0)

    frame = make_frame(seed=5, aircraft=6, days=12, noise=0.3, heading_error=error)
    return frame, diagnose(frame, catalogue=SMALL)


def test_nothing_is_named_where_nothing_is(quiet):
    report = diagnose(quiet, catalogue=SMALL).report
    assert report.effects == []
    assert not report.unknown.present
    assert report.closure.before == report.closure.after
    low, high = report.closure.reduction_ci
    assert low < 0.0 < high <= 1.1 * report.closure.could_hide_kt + 0.01


def test_one_cycle_on_two_aircraft(iron, quiet):
    frame, made = iron
    report = made.report
    (effect,) = report.effects
    assert effect.name == "hard_iron"
    assert effect.tails == [frame.tails[1], frame.tails[4]]
    assert effect.probability > 0.8
    for tail in effect.tails:
        values = effect.per_tail[tail].parameters
        errors = effect.per_tail[tail].standard_errors
        assert values["amplitude_deg"] == pytest.approx(1.5, rel=0.05)
        assert values["phase_deg"] == pytest.approx(40.1, abs=4 * errors["phase_deg"] + 2)
    true = np.hypot(*quiet.residual.T).mean() / 0.514444
    assert report.closure.after == pytest.approx(true, abs=0.1)
    low, high = report.closure.ci
    assert low < report.closure.after < high < report.closure.before
    assert report.where[0].variable in ("aircraft", "magnetic_heading")
    assert not report.unknown.present


def test_constant_one_and_two_cycles_of_all_aircraft_are_three_names():
    """Not one table of the heading, which has more evidence than hard iron alone."""
    one, two = np.radians([3.5, 1.5, 2.5]), np.radians([0.3, 1.4, 1.2])
    constant = np.radians([0.8, -1.2, 0.4])

    def error(context):
        aircraft, magnetic = context["aircraft"], context["magnetic_heading"]
        return (
            constant[aircraft]
            + one[aircraft] * np.sin(magnetic + aircraft)
            + two[aircraft] * np.cos(2 * magnetic + aircraft)
        )

    frame = make_frame(seed=6, aircraft=3, days=10, noise=0.3, heading_error=error)
    report = diagnose(frame, catalogue=SMALL).report
    assert {e.name for e in report.effects} == {"compass_offset", "hard_iron", "soft_iron"}
    assert not report.unknown.present


def test_products_are_complete_and_serialise(iron):
    frame, made = iron
    json.dumps(plain(made.report.content()), allow_nan=False)
    assert [w.label for w in made.report.waterfall][-1] == "noise floor"
    heading = made.dataset["heading_map"]
    assert heading.dims == ("aircraft", "octant")
    assert heading.sizes["aircraft"] == len(frame.tails)
    evidence = made.dataset["log_evidence"]
    assert evidence["effect"].values[0] == "hard_iron" and evidence.values[0] > 10
    own = made.dataset["aircraft_probability"].sel(effect="hard_iron").values
    assert own[[1, 4]].min() > 0.95 and own[[0, 2, 3, 5]].max() < 0.5
    assert made.report.closure.by_effect[0].name == "hard_iron"


def test_a_change_is_dated():
    day = 9

    def error(context):
        late = context["time"] > day * 86400
        return np.where((context["aircraft"] == 2) & late, np.radians(1.2), 0.0)

    frame = make_frame(seed=6, aircraft=6, days=16, noise=0.3, heading_error=error)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    (effect,) = report.effects
    assert effect.name == "compass_step"
    assert effect.tails == [frame.tails[2]]
    start = np.datetime64(effect.period[0])
    assert abs((start - (np.datetime64("1970-01-01") + day)).astype(int)) <= 1


def test_a_drift_of_the_last_days_has_its_rate():
    begins = 12

    def error(context):
        days = np.maximum(0.0, context["time"] / 86400 - begins)
        return np.where(context["aircraft"] % 2 == 0, np.radians(1.2) * days, 0.0)

    frame = make_frame(seed=6, aircraft=6, days=16, noise=0.3, heading_error=error)
    catalogue = SMALL | {"compass_drift": CATALOGUE["compass_drift"]}
    (effect,) = diagnose(frame, catalogue=catalogue).report.effects
    assert effect.name == "compass_drift" and effect.tails == list(frame.tails[::2])
    error = effect.standard_errors["rate_deg_per_day"]
    assert effect.parameters["rate_deg_per_day"] == pytest.approx(1.2, abs=2 * error)
    assert error < 0.1


def test_an_effect_of_one_reference_is_attributed_to_it_at_its_size():
    offsets = {"right": 0.0, "late": -2.0}

    def frame_against(reference, offset):
        hours = offsets[reference] - offset
        return make_frame(seed=5, aircraft=6, days=12, noise=0.3, reference_hours=hours)

    pool = [frame_against(reference, 0.0) for reference in offsets]
    names = [f"{c}_{when}" for c in "uv" for when in ("ref", "before", "after")]
    mean = {n: (getattr(pool[0], n) + getattr(pool[1], n)) / 2 for n in names}
    catalogue = {"reference_time_offset": CATALOGUE["reference_time_offset"]}
    report = diagnose(replace(pool[0], **mean), catalogue=catalogue, dictionary=False).report
    report = attributed(replace(report, reference="both"), list(offsets), frame_against)
    (effect,) = report.effects
    assert effect.reference == "late" and set(effect.by_reference) == {"both", "late"}
    error = effect.standard_errors["offset_h"]
    assert effect.parameters["offset_h"] == pytest.approx(-2.0, abs=3 * error)
    assert error < 0.2
    # the simulation of the pool has the offset of its mean
    (active,) = active_effects(report)
    assert active.parameters["offset_h"] == pytest.approx(-1.0, abs=0.2)


def test_effect_outside_the_catalogue_is_located_and_closed():
    def factor(context):
        height = np.log(9.5e4 / context["pressure"])
        return np.where(context["aircraft"] == 3, 1 + 0.05 * (height - 0.35), 1.0)

    frame = make_frame(seed=7, aircraft=5, days=14, noise=0.3, airspeed_factor=factor)
    made = diagnose(frame, catalogue=SMALL)
    report = made.report
    assert report.unknown.present
    place = report.unknown.where[0]
    assert place.component == "along_heading"
    assert place.tails == [frame.tails[3]]
    assert {"altitude", "airspeed", "phase", "temperature"} & set(place.variables)
    assert place.closure.reduction > 0
    assert len(place.curve.values) == len(place.curve.edges[0]) - 1
    # closure is of everything stated, named or not
    total = sum(one.reduction for one in report.closure.by_effect)
    assert report.closure.reduction == pytest.approx(total, abs=1e-6)
    # the unknown is an effect that the simulation takes
    (active,) = [one for one in active_effects(report) if one.name == "empirical"]
    assert active.tails == (frame.tails[3],)


def test_exchanged_identifiers_are_found_and_given_back():
    def error(context):
        a = context["aircraft"]
        one = np.where(a == 0, np.radians(2.0) * np.sin(context["magnetic_heading"]), 0.0)
        return one + np.where(a == 2, np.radians(-1.2), 0.0)

    frame = make_frame(seed=8, aircraft=5, days=18, noise=0.3, heading_error=error)
    late = frame.time > 10 * 86400
    names = frame.aircraft.copy()
    names[(frame.aircraft == 0) & late], names[(frame.aircraft == 2) & late] = 2, 0
    order = np.lexsort((frame.time, names))
    swapped = replace(frame, aircraft=names).take(order)
    catalogue = SMALL | {"tail_swap": CATALOGUE["tail_swap"]}
    report = diagnose(swapped, catalogue=catalogue, dictionary=False).report
    found = {e.name: e for e in report.effects}
    assert set(found) == {"tail_swap", "hard_iron", "compass_offset"}
    assert found["tail_swap"].tails == [frame.tails[0], frame.tails[2]]
    start = np.datetime64(found["tail_swap"].period[0])
    assert abs((start - np.datetime64("1970-01-11")).astype(int)) <= 1
    assert found["hard_iron"].tails == [frame.tails[0]]
    assert found["compass_offset"].tails == [frame.tails[2]]


def test_a_single_day_is_diagnosed_without_unknowns():
    def error(context):
        return np.where(context["aircraft"] == 2, np.radians(4.0), 0.0)

    frame = make_frame(seed=5, aircraft=6, days=1, noise=0.3, heading_error=error)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    (effect,) = report.effects
    assert (effect.name, effect.tails) == ("compass_offset", [frame.tails[2]])


def test_missing_context_is_untestable_not_guessed(quiet):
    blind = replace(quiet, icing=np.full(quiet.size, -1), temperature=np.full(quiet.size, np.nan))
    catalogue = SMALL | {"heater_current": CATALOGUE["heater_current"]}
    made = diagnose(blind, catalogue=catalogue, dictionary=False)
    assert "icing" in made.report.untestable["heater_current"]


def test_an_error_of_the_whole_fleet_is_no_change_of_all_aircraft():
    def error(context):
        return np.full(context["time"].size, np.radians(1.5))

    frame = make_frame(seed=9, aircraft=6, days=12, noise=0.3, heading_error=error)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    assert [effect.name for effect in report.effects] == ["compass_offset"]
    assert report.effects[0].scope == "fleet"
    assert report.effects[0].parameters["offset_deg"] == pytest.approx(1.5, abs=0.3)


def test_too_few_reports_and_headings_without_derivatives_are_refused(quiet):
    with pytest.raises(InputError, match="too few reports"):
        diagnose(quiet.take(slice(0, 100)))
    ds = headings_dataset()
    ds = ds.drop_vars([name for name in ds if "tendency" in name or "derivative" in name])
    with pytest.raises(InputError, match="derivatives"):
        diagnose(ds, reference=str(ds["reference"].values[0]))
