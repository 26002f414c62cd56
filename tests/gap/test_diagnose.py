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


def archive(error=None, *, seed=5, aircraft=6, days=12, **options):
    """Toy archive with an error of the headings in degrees, a function of the reports' context."""
    radians = error and (lambda context: np.radians(error(context)))
    options |= {"noise": 0.3, "heading_error": radians}
    return make_frame(seed=seed, aircraft=aircraft, days=days, **options)


@pytest.fixture(scope="module")
def quiet():
    return archive()


@pytest.fixture(scope="module")
def iron():
    """One cycle of 1.5 degrees on two of six aircraft."""

    def error(context):
        return (
            np.isin(context["aircraft"], [1, 4]) * 1.5 * np.sin(context["magnetic_heading"] + 0.7)
        )

    frame = archive(error)
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
    constant, one, two = np.array([[0.8, -1.2, 0.4], [3.5, 1.5, 2.5], [0.3, 1.4, 1.2]])

    def error(context):
        a, m = context["aircraft"], context["magnetic_heading"]
        return constant[a] + one[a] * np.sin(m + a) + two[a] * np.cos(2 * m + a)

    report = diagnose(archive(error, seed=6, aircraft=3, days=10), catalogue=SMALL).report
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


@pytest.mark.parametrize(
    ("error", "options", "name", "tails", "parameters", "start"),
    [
        pytest.param(
            lambda c: 1.2 * ((c["aircraft"] == 2) & (c["time"] > 9 * 86400)),
            {"seed": 6, "days": 16},
            "compass_step",
            [2],
            {"offset_deg": 1.2},
            9,
            id="a change",
        ),
        pytest.param(
            lambda c: 1.2 * (c["aircraft"] % 2 == 0) * np.maximum(0.0, c["time"] / 86400 - 12),
            {"seed": 6, "days": 16},
            "compass_drift",
            [0, 2, 4],
            {"rate_deg_per_day": 1.2},
            None,
            id="a drift of the last days",
        ),
        pytest.param(
            lambda c: 4.0 * (c["aircraft"] == 2),
            {"days": 1},
            "compass_offset",
            [2],
            {"offset_deg": 4.0},
            None,
            id="on a single day",
        ),
        pytest.param(
            lambda c: np.full(c["time"].size, 1.5),
            {"seed": 9},
            "compass_offset",
            range(6),
            {"offset_deg": 1.5},
            None,
            id="the whole fleet",
        ),
    ],
)
def test_one_effect_is_named_sized_and_dated(error, options, name, tails, parameters, start):
    frame = archive(error, **options)
    catalogue = SMALL | ({name: CATALOGUE[name]} if name == "compass_drift" else {})
    (effect,) = diagnose(frame, catalogue=catalogue, dictionary=False).report.effects
    assert effect.name == name
    assert effect.tails == [frame.tails[k] for k in tails]
    assert (effect.scope == "fleet") == (len(tails) == 6)
    for parameter, value in parameters.items():
        error = effect.standard_errors[parameter]
        assert effect.parameters[parameter] == pytest.approx(value, abs=max(3 * error, 0.05))
        assert error < 0.2
    if start:
        late = np.datetime64(effect.period[0]) - (np.datetime64("1970-01-01") + start)
        assert abs(late.astype(int)) <= 1


def test_an_offset_of_the_references_time_hides_no_other_effect():
    frame = archive(lambda c: 0.6 * (c["aircraft"] == 2), reference_hours=1.0)
    names = ("reference_time_offset", "compass_offset", "reference_speed_bias")
    report = diagnose(frame, catalogue={n: CATALOGUE[n] for n in names}, dictionary=False).report
    found = {effect.name: effect for effect in report.effects}
    assert set(found) == {"reference_time_offset", "compass_offset"}
    assert found["compass_offset"].tails == [frame.tails[2]]
    for name, parameter, true in (
        ("reference_time_offset", "offset_h", 1.0),
        ("compass_offset", "offset_deg", 0.6),
    ):
        stated, error = (
            values[parameter] for values in (found[name].parameters, found[name].standard_errors)
        )
        assert stated == pytest.approx(true, abs=3 * error) and error < 0.2


def test_an_effect_of_one_reference_is_attributed_to_it_at_its_size():
    offsets = {"right": 0.0, "late": -2.0}

    def frame_against(reference, offset):
        return archive(reference_hours=offsets[reference] - offset)

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

    frame = archive(seed=7, aircraft=5, days=14, airspeed_factor=factor)
    report = diagnose(frame, catalogue=SMALL).report
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
        return (a == 0) * 2.0 * np.sin(context["magnetic_heading"]) - 1.2 * (a == 2)

    frame = archive(error, seed=8, aircraft=5, days=18)
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


def test_missing_context_is_untestable_and_missing_derivatives_are_refused(quiet):
    blind = replace(quiet, icing=np.full(quiet.size, -1), temperature=np.full(quiet.size, np.nan))
    heater = {"heater_current": CATALOGUE["heater_current"]}
    made = diagnose(blind, catalogue=heater, dictionary=False)
    assert "icing" in made.report.untestable["heater_current"]
    with pytest.raises(InputError, match="too few reports"):
        diagnose(quiet.take(slice(0, 100)))
    ds = headings_dataset()
    ds = ds.drop_vars([name for name in ds if "tendency" in name or "derivative" in name])
    with pytest.raises(InputError, match="derivatives"):
        diagnose(ds, reference=str(ds["reference"].values[0]))
