"""The diagnosis of toy archives: what is there is named, located and closed, and nothing else."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter
from tests.gap.frames import headings_dataset
from tests.gap.toy import START, effect, make_frame

from airswing.errors import InputError
from airswing.gap.archive.frame import AIRCRAFT_FIELDS
from airswing.gap.archive.reported_variables import KINDS
from airswing.gap.diagnose import attributed, diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.empirical import change_of
from airswing.gap.model.refit import without_errors
from airswing.gap.result.schema import GapReport
from airswing.gap.simulation.effects_file import active_effects
from airswing.products.netcdf import open_product
from airswing.products.whole_files import json_types
from airswing.units import KNOT

NAMES = ("compass_offset", "hard_iron", "soft_iron", "compass_step", "tas_scale")
SMALL = {name: CATALOGUE[name] for name in NAMES}


def disagreement(frame, before):
    """Mean vector disagreement that the effects of a frame add to that of another, kt."""
    return (np.hypot(*frame.residual.T).mean() - np.hypot(*before.residual.T).mean()) / KNOT


def archive(*effects, seed=5, aircraft=6, days=12):
    return make_frame(seed=seed, aircraft=aircraft, days=days, effects=effects, noise=0.3)


def turned(frame, error):
    """The frame with errors (n,) of the headings, degrees."""
    at = {"heading": frame.heading, "airspeed": frame.airspeed, "u": frame.u_rep, "v": frame.v_rep}
    return without_errors(frame, -error[:, None] * change_of("heading_angle", **at))[0]


@pytest.fixture
def few_variables(monkeypatch):
    """Tables over a third of the variables, the rivals of the effect among them, for their time."""
    names = {"magnetic_heading", "airspeed", "altitude", "date", "hour", "wind_direction"}
    names |= {"latitude"}
    for name in {*KINDS} - names:
        monkeypatch.delitem(KINDS, name)


@pytest.fixture(scope="module")
def quiet():
    return archive()


@pytest.fixture(scope="module")
def iron():
    """One cycle of 1.5 degrees on two of six aircraft."""
    frame = archive(effect("hard_iron", [1, 4], amplitude_deg=1.5, phase_deg=40.0))
    return frame, diagnose(frame, catalogue=SMALL)


def test_an_archive_without_effects_has_no_findings(quiet):
    report = diagnose(quiet, catalogue=SMALL).report
    assert report.effects == []
    assert not report.unknown.present
    assert report.closure.before == report.closure.after
    low, high = report.closure.reduction_ci
    assert low < 0.0 < high <= 1.1 * report.closure.could_hide_kt + 0.01


def test_one_cycle_on_two_aircraft(iron, quiet):
    frame, diagnosis = iron
    report = diagnosis.report
    (entry,) = report.effects
    assert entry.name == "hard_iron"
    assert entry.tails == [frame.tails[1], frame.tails[4]]
    assert entry.probability > 0.8
    for tail in entry.tails:
        values = entry.per_tail[tail].parameters
        errors = entry.per_tail[tail].standard_errors
        assert values["amplitude_deg"] == pytest.approx(1.5, rel=0.05)
        assert values["phase_deg"] == pytest.approx(40.0, abs=4 * errors["phase_deg"] + 2)
    assert report.closure.after == pytest.approx(np.hypot(*quiet.residual.T).mean() / KNOT, abs=0.1)
    low, high = report.closure.ci
    assert low < report.closure.after < high < report.closure.before
    assert report.where[0].variable in ("aircraft", "magnetic_heading")
    assert not report.unknown.present


@pytest.mark.usefixtures("few_variables")
def test_an_interaction_of_variables_that_have_no_effect_alone():
    frame = archive(aircraft=4, days=8)
    hour = 2 * np.pi * frame.time / 86400.0
    place = np.argsort(np.argsort(frame.latitude)) / frame.size - 0.5
    alone = np.stack([np.ones(frame.size), np.sin(hour), np.cos(hour), place, place**2], -1)
    product = np.sin(hour) * place
    product -= alone @ np.linalg.lstsq(alone, product, rcond=None)[0]
    product *= 1.5 / product.std()
    faulty = replace(
        frame,
        u_rep=frame.u_rep + product * np.sin(frame.heading),
        v_rep=frame.v_rep + product * np.cos(frame.heading),
    )
    report = diagnose(faulty, catalogue={}).report
    (entry,) = report.unknown.where
    assert set(entry.variables) == {"hour", "latitude"}
    assert entry.component in ("along_heading", "airspeed_factor")
    true = (np.hypot(*faulty.residual.T).mean() - np.hypot(*frame.residual.T).mean()) / KNOT
    assert report.closure.reduction == pytest.approx(true, rel=0.1)


@pytest.mark.usefixtures("few_variables")
@pytest.mark.parametrize("size", [pytest.param(1.0, marks=pytest.mark.slow), 2.0])
def test_constant_one_and_two_cycles_of_all_aircraft_are_three_names(size):
    """Not one table of the heading, which has more evidence than hard iron alone."""
    effects, sizes = [], [(0.8, 3.5, 0.3), (-1.2, 1.5, 1.4), (0.4, 2.5, 1.2)]
    for k, (constant, hard, soft) in enumerate(sizes):
        effects += [
            effect("compass_offset", [k], offset_deg=size * constant),
            effect("hard_iron", [k], amplitude_deg=size * hard, phase_deg=57.0 * k),
            effect("soft_iron", [k], amplitude_deg=size * soft, phase_deg=90.0 + 57.0 * k),
        ]
    report = diagnose(archive(*effects, seed=6, aircraft=3, days=7), catalogue=SMALL).report
    assert {e.name for e in report.effects} == {"compass_offset", "hard_iron", "soft_iron"}
    assert not report.unknown.present


@pytest.mark.slow
def test_a_refined_table_leaves_its_place_to_the_names_of_the_quickstart(quickstart):
    headings = open_product(quickstart / "headings")
    report = diagnose(headings, reference="rtfdaa").report
    assert [e.name for e in report.effects] == ["hard_iron", "compass_offset", "soft_iron"]
    assert not report.unknown.present


def test_products_are_complete_and_serialise(iron):
    frame, diagnosis = iron
    content = json_types(diagnosis.report.content())
    read = TypeAdapter(GapReport).validate_python(json.loads(json.dumps(content, allow_nan=False)))
    assert json_types(read.content()) == content
    assert [w.label for w in diagnosis.report.waterfall][-1] == "noise floor"
    heading = diagnosis.dataset["heading_map"]
    assert heading.dims == ("aircraft", "octant")
    assert heading.sizes["aircraft"] == len(frame.tails)
    evidence = diagnosis.dataset["log_evidence"]
    assert evidence["effect"].values[0] == "hard_iron" and evidence.values[0] > 10
    probability = diagnosis.dataset["aircraft_probability"].sel(effect="hard_iron").values
    assert probability[[1, 4]].min() > 0.95 and probability[[0, 2, 3, 5]].max() < 0.5
    assert diagnosis.report.closure.by_effect[0].name == "hard_iron"


@pytest.mark.usefixtures("few_variables")
def test_all_forms_of_a_name_are_compared_with_a_table(monkeypatch, icing=KINDS["icing"]):
    monkeypatch.setitem(KINDS, "icing", icing)
    # the form of one coefficient represents the table of icing; that with a cycle does not
    heater = effect("heater_current", [0, 3, 5], offset_deg=0.84, amplitude_deg=0.01, phase_deg=8)
    weak = effect("declination_error", factor=1.5, mean_deg=-0.16)
    catalogue = SMALL | {name: CATALOGUE[name] for name in ("heater_current", "declination_error")}
    report = diagnose(make_frame(seed=1, effects=[heater, weak]), catalogue=catalogue).report
    tails = {entry.name: entry.tails for entry in report.effects}
    assert tails.keys() == {"heater_current", "declination_error"}
    assert tails["heater_current"] == ["N401", "N404", "N406"]
    assert not report.unknown.where


@pytest.mark.parametrize(
    ("name", "aircraft", "day", "values", "options"),
    [
        ("compass_step", [2], 9, {"offset_deg": 1.2}, {"seed": 6, "days": 16}),
        ("compass_drift", [0, 2, 4], 12, {"rate_deg_per_day": 1.2}, {"seed": 6, "days": 16}),
        (
            "compass_drift",
            [0, 2, 4],
            None,
            {"rate_deg_per_day": 0.0, "sine_rate_deg_per_day": 0.2, "cosine_rate_deg_per_day": 0.1},
            {"seed": 6, "days": 16},
        ),
        ("compass_offset", [2], None, {"offset_deg": 4.0}, {"days": 1}),
        ("compass_offset", range(6), None, {"offset_deg": 1.5}, {"seed": 9}),
    ],
    ids=[
        "a change in a long archive",
        "a drift of the last days",
        "a cycle that grows",
        "on a single day",
        "the whole fleet",
    ],
)
def test_one_effect_is_named_sized_and_dated(monkeypatch, name, aircraft, day, values, options):
    if name == "compass_step":  # sums of long archives are kept by stretches of days, here of three
        monkeypatch.setattr("airswing.gap.model.sums.STRETCHES", 6)
    frame = archive(effect(name, aircraft, day, **values), **options)
    catalogue = SMALL | ({name: CATALOGUE[name]} if name == "compass_drift" else {})
    (entry,) = diagnose(frame, catalogue=catalogue, dictionary=False).report.effects
    assert entry.name == name
    assert entry.tails == [frame.tails[k] for k in aircraft]
    assert (entry.scope == "fleet") == (len(aircraft) == 6)
    for parameter, value in values.items():
        error = entry.standard_errors[parameter]
        assert entry.parameters[parameter] == pytest.approx(value, abs=max(3 * error, 0.05))
        assert error < 0.3
    if name == "compass_step":
        assert abs(np.datetime64(entry.period[0]) - (START + day)) <= np.timedelta64(1, "D")


@pytest.mark.usefixtures("few_variables")
def test_every_name_competes_by_its_best_form():
    # by the screen the step has a cycle as well, which a drift of two coefficients exceeds
    frame = archive(effect("compass_step", [2], 6, offset_deg=1.5), seed=7, days=14)
    catalogue = SMALL | {"compass_drift": CATALOGUE["compass_drift"]}
    report = diagnose(frame, catalogue=catalogue).report
    (entry,) = report.effects
    assert (entry.name, entry.tails) == ("compass_step", [frame.tails[2]])
    assert entry.parameters["offset_deg"] == pytest.approx(1.5, abs=0.1)
    assert not report.unknown.where


def test_an_offset_of_the_references_time_hides_no_other_effect(quiet):
    offset = effect("compass_offset", [2], offset_deg=0.6)
    frame = archive(effect("reference_time_offset", offset_h=1.0), offset)
    names = ("reference_time_offset", "compass_offset", "reference_speed_bias")
    report = diagnose(frame, catalogue={n: CATALOGUE[n] for n in names}, dictionary=False).report
    claims = {entry.name: entry for entry in report.effects}
    assert set(claims) == {"reference_time_offset", "compass_offset"}
    assert claims["compass_offset"].tails == [frame.tails[2]]
    for name, parameter, true in (
        ("reference_time_offset", "offset_h", 1.0),
        ("compass_offset", "offset_deg", 0.6),
    ):
        stated = claims[name].parameters[parameter]
        error = claims[name].standard_errors[parameter]
        assert stated == pytest.approx(true, abs=3 * error) and error < 0.2
    true = disagreement(frame, quiet)
    assert report.closure.reduction == pytest.approx(true, rel=0.1)
    low, high = report.closure.reduction_ci
    assert low < true < high


def test_an_effect_of_one_reference_is_attributed_to_it_at_its_size():
    offsets = {"right": 0.0, "late": -2.0}

    def frame_against(reference, offset):
        return archive(effect("reference_time_offset", offset_h=offsets[reference] - offset))

    pool = [frame_against(reference, 0.0) for reference in offsets]
    names = [f"{c}_{when}" for c in "uv" for when in ("ref", "before", "after")]
    mean = {n: (getattr(pool[0], n) + getattr(pool[1], n)) / 2 for n in names}
    catalogue = {"reference_time_offset": CATALOGUE["reference_time_offset"]}
    report = diagnose(replace(pool[0], **mean), catalogue=catalogue, dictionary=False).report
    report = attributed(replace(report, reference="both"), list(offsets), frame_against)
    (entry,) = report.effects
    assert entry.reference == "late" and set(entry.by_reference) == {"both", "late"}
    error = entry.standard_errors["offset_h"]
    assert entry.parameters["offset_h"] == pytest.approx(-2.0, abs=3 * error)
    assert error < 0.2
    # the simulation of the pool has the offset of its mean
    (active,) = active_effects(report)
    assert -1.4 < active.parameters["offset_h"] < -0.6


@pytest.mark.usefixtures("few_variables")
def test_effect_outside_the_catalogue_is_located_and_closed():
    hinge = {"variable": "altitude", "shape": "hinge", "at": 0.4, "width": 0.1}
    outside = {"component": "along_heading", "parts": [hinge], "size_m_s": 2.0, "sign": 1.0}
    frame = archive(effect("outside", [3], **outside), seed=7, aircraft=5, days=14)
    report = diagnose(frame, catalogue=SMALL).report
    assert report.unknown.present
    place = report.unknown.where[0]
    assert place.component == "along_heading"
    assert place.tails == [frame.tails[3]]
    assert {"altitude", "airspeed"} & set(place.variables)
    assert place.closure.reduction > 0
    assert len(place.curve.values) == len(place.curve.edges[0]) - 1
    # closure is of everything stated, named or not
    total = sum(entry.reduction for entry in report.closure.by_effect)
    assert report.closure.reduction == pytest.approx(total, abs=1e-6)
    # the unknown is an effect that the simulation takes
    (active,) = [entry for entry in active_effects(report) if entry.name == "empirical"]
    assert active.tails == (frame.tails[3],)


@pytest.mark.usefixtures("few_variables")
def test_a_step_of_all_winds_has_the_level_that_the_reports_have():
    """Its direction is uncertain in weak winds, and its level like an error of the reference."""
    before = archive(seed=4, aircraft=8, days=16)
    at = {"heading": before.heading, "airspeed": before.airspeed}
    right = change_of("across_wind", u=before.u_ref, v=before.v_ref, **at)
    low = before.pressure > np.quantile(before.pressure, 0.7)
    u, v = (-1.6 * right * low[:, None]).T
    frame = replace(before, u_rep=before.u_rep + u, v_rep=before.v_rep + v)
    report = diagnose(frame, catalogue=SMALL).report
    (place,) = report.unknown.where
    assert (place.variables, place.component, place.tails) == (["altitude"], "across_wind", [])
    true, (least, most) = disagreement(frame, before), report.closure.reduction_ci
    assert least < true < most
    assert report.closure.reduction > 0.5 * true


@pytest.mark.usefixtures("few_variables")
def test_an_error_that_depends_on_the_reported_wind_is_located():
    sector = {"variable": "wind_direction", "shape": "sector", "at": 0.5, "width": 0.3}
    outside = {"component": "along_wind", "parts": [sector], "size_m_s": 1.6, "sign": 1.0}
    frame = archive(effect("outside", [0, 1, 2], **outside), seed=7, aircraft=5, days=14)
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert place.variables == ["wind_direction"]
    assert place.tails == list(frame.tails[:3])


@pytest.mark.usefixtures("few_variables")
@pytest.mark.parametrize(
    ("values", "aircraft", "noise"),
    [
        ({"kind": "jitter", "size_m_s": 2.0}, [0, 2], 0.3),
        # the noise of the frames would hide coarse directions
        ({"kind": "lattice", "limit_kt": 40.0, "direction_step_deg": 45.0}, None, 0.0),
    ],
)
def test_an_effect_that_changes_no_mean_is_sized_and_closed(values, aircraft, noise):
    upper = {"variable": "altitude", "shape": "step", "at": 0.6, "width": 0.1}
    parts = {"parts": [upper] if aircraft else []}
    outside = effect("outside", aircraft, **parts, **values)
    frame, before = (
        make_frame(seed=7, aircraft=5, days=28, effects=effects, noise=noise)
        for effects in ((outside,), ())
    )
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert place.component == ("scatter" if aircraft else "reported_direction")
    assert place.tails == ([frame.tails[a] for a in aircraft] if aircraft else [])
    true = disagreement(frame, before)
    low, high = place.closure.reduction_ci
    assert low < true < high and low > 0.4 * true
    if aircraft:
        sizes = [size for size in place.curve.m_s if size > 0]
        assert np.median(sizes) == pytest.approx(2.0 / np.sqrt(2.0), rel=0.1)
    else:
        assert (place.steps.step_deg, place.steps.up_to_kt) == (45.0, pytest.approx(40.0, abs=0.5))


@pytest.mark.usefixtures("few_variables")
@pytest.mark.parametrize(
    ("name", "values", "component"),
    [
        ("heading_coding", {"step_deg": 10.0}, "reported_heading"),
        ("outliers", {"fraction": 0.05, "size_m_s": 20.0}, "scatter"),
    ],
)
def test_coding_and_gross_errors_without_a_name_are_stated_and_closed(name, values, component):
    frame, before = (
        make_frame(seed=7, aircraft=5, days=14, effects=effects, noise=0.3)
        for effects in ((effect(name, [1, 3], **values),), ())
    )
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert (place.component, place.tails) == (component, [frame.tails[1], frame.tails[3]])
    low, high = place.closure.reduction_ci
    true = disagreement(frame, before)
    assert low < true < high and low > 0.4 * true


@pytest.mark.usefixtures("few_variables")
def test_errors_that_differ_between_flights_are_located_and_closed():
    before = archive(seed=7, aircraft=6, days=20)
    by_flight = np.random.default_rng(2).normal(0.0, 1.5, before.flight.max() + 1)
    frame = turned(before, by_flight[before.flight] * np.isin(before.aircraft, [1, 4]))
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert (place.component, place.variables) == ("heading_angle", ["flight"])
    assert place.tails == [frame.tails[1], frame.tails[4]]
    low, high = place.closure.reduction_ci
    assert low < disagreement(frame, before) < high


@pytest.mark.usefixtures("few_variables")
def test_fine_functions_are_stated_and_closed():
    """A declination that is constant in zones of a degree, and of two; both need another pass."""
    before = archive(seed=7, days=12)
    fine = 9.0 * (before.latitude % 1.0 - 0.5) * np.isin(before.aircraft, [1, 4])
    coarse = 4.5 * (before.latitude % 2.0 - 1.0) * (before.aircraft == 2)
    frame = turned(before, fine + coarse)
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    assert {place.variables[0] for place in report.unknown.where} == {"latitude"}
    tails = {tail for place in report.unknown.where for tail in place.tails}
    assert tails == {frame.tails[k] for k in (1, 2, 4)}
    true = disagreement(frame, before)
    assert 0.75 * true < report.closure.reduction < 1.1 * true


@pytest.mark.usefixtures("few_variables")
def test_a_sawtooth_is_one_statement_and_closed():
    """Its jumps are finer than knots: they are no second function of the altitude."""
    saw = {"variable": "altitude", "shape": "saw", "at": 0.55, "width": 0.33}
    outside = {"component": "along_heading", "parts": [saw], "size_m_s": 1.5, "sign": 1.0}
    frame = archive(effect("outside", **outside), seed=7, aircraft=5, days=14)
    before = archive(seed=7, aircraft=5, days=14)
    report = diagnose(frame, catalogue=SMALL).report
    assert [place.variables for place in report.unknown.where] == [["altitude"]]
    true = disagreement(frame, before)
    assert 0.6 * true < report.closure.reduction < 1.1 * true


@pytest.mark.usefixtures("few_variables")
@pytest.mark.parametrize(
    ("name", "day", "values", "variables"),
    [
        ("tas_offset", None, {"offset_m_s": 1.5}, ["magnetic_heading"]),
        pytest.param("compass_step", 9, {"offset_deg": 0.8}, ["date"], marks=pytest.mark.slow),
    ],
)
def test_a_simple_error_outside_the_catalogue_is_not_named_by_a_richer_effect(
    name, day, values, variables
):
    """A scale or a drift explains nearly as much as a constant, which is the simpler table."""
    frame = archive(effect(name, [2, 4], day, **values), seed=6, days=16)
    catalogue = {n: e for n, e in CATALOGUE.items() if n != name}
    report = diagnose(frame, catalogue=catalogue).report
    assert report.effects == []
    (place,) = report.unknown.where
    assert place.component == ("heading_angle" if day else "along_heading")
    assert place.variables == variables
    assert place.tails == [frame.tails[2], frame.tails[4]]
    size = 0.8 if day else -1.5
    assert place.curve.values == pytest.approx([size] * len(place.curve.values), rel=0.1)
    periods = {entry.period and entry.period[0] for entry in active_effects(report)}
    assert (periods == {None}) == (day is None)


def test_an_aircraft_without_reports_hides_no_effect():
    iron = effect("hard_iron", [2], amplitude_deg=1.5, phase_deg=40.0)
    frame = archive(effect("compass_offset", offset_deg=1.5), iron)
    fields = {name: np.append(getattr(frame, name), np.nan) for name in AIRCRAFT_FIELDS}
    frame = replace(frame, tails=(*frame.tails, "N999"), **fields)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    claims = {entry.name: entry.tails for entry in report.effects}
    assert set(claims) == {"compass_offset", "hard_iron"}
    assert claims["hard_iron"] == [frame.tails[2]]


def test_changes_have_their_own_dates():
    """One aircraft changes and changes back; another one changes on another day."""
    effects = (
        effect("compass_step", [1], 5, offset_deg=3.0),
        effect("compass_step", [1], 12, offset_deg=-3.0),
        effect("compass_step", [4], 9, offset_deg=3.0),
    )
    frame = archive(*effects, days=18)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    assert {entry.name for entry in report.effects} == {"compass_step"}
    (entry,) = report.effects
    days = [str((START + day).astype("M8[D]")) for day in (5, 11, 9)]
    assert entry.per_tail is not None
    periods = {tail: stated.period for tail, stated in entry.per_tail.items()}
    assert periods == {frame.tails[1]: days[:2], frame.tails[4]: [days[2], None]}


@pytest.mark.parametrize("stop", [13, pytest.param(10, marks=pytest.mark.slow)])
def test_a_change_that_is_reversed_is_one_effect_of_a_period(stop):
    effects = (
        effect("compass_step", [1, 4], 5, offset_deg=2.0),
        effect("compass_step", [1, 4], stop, offset_deg=-2.0),
    )
    frame = archive(*effects, days=18)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    (entry,) = report.effects
    assert (entry.name, entry.tails) == ("compass_step", [frame.tails[1], frame.tails[4]])
    assert entry.parameters["offset_deg"] == pytest.approx(2.0, abs=0.1)
    first, last = (np.datetime64(day) for day in entry.period)
    assert [first, last] == [START.astype("M8[D]") + day for day in (5, stop - 1)]
    true = disagreement(frame, archive(days=18))
    assert entry.closure.reduction == pytest.approx(true, rel=0.1)
    # the simulation takes the period
    assert all(active.period[1] is not None for active in active_effects(report))


def test_the_interval_of_a_change_of_two_days_contains_its_closure():
    effects = (effect("compass_step", [1, 4], 6, offset_deg=3.0),)
    effects += (effect("compass_step", [1, 4], 8, offset_deg=-3.0),)
    frame = archive(*effects, days=18)
    closure = diagnose(frame, catalogue=SMALL, dictionary=False).report.closure
    # a group of held-out days contains both, and no other day says how large the change is
    assert [entry.name for entry in closure.by_effect] == ["compass_step"]
    low, high = closure.reduction_ci
    assert low < disagreement(frame, archive(days=18)) < high


@pytest.mark.usefixtures("few_variables")
def test_exchanged_components_of_the_wind_are_closed_in_part(quiet):
    mine = quiet.aircraft == 2
    u, v = np.where(mine, [quiet.v_rep, quiet.u_rep], [quiet.u_rep, quiet.v_rep])
    air = quiet.ground_u - u, quiet.ground_v - v
    heading = np.arctan2(*air)
    frame = replace(quiet, u_rep=u, v_rep=v, heading=heading, airspeed=np.hypot(*air))
    frame = replace(frame, magnetic_heading=heading - frame.declination)
    report = diagnose(frame, catalogue=SMALL).report
    assert {tail for place in report.unknown.where for tail in place.tails} == {frame.tails[2]}
    true, (low, high) = disagreement(frame, quiet), report.closure.reduction_ci
    # tables of one variable hold a part; subtracted at the reported wind they would add to it
    assert report.closure.reduction > 0.3 * true and low < true < high


def test_exchanged_identifiers_are_detected_and_corrected():
    effects = (
        effect("hard_iron", [0], amplitude_deg=4.0, phase_deg=0.0),
        effect("compass_offset", [2], offset_deg=-3.0),
        effect("tail_swap", [0, 2], 10),
    )
    frame = archive(*effects, seed=8, aircraft=5, days=18)
    catalogue = SMALL | {"tail_swap": CATALOGUE["tail_swap"]}
    report = diagnose(frame, catalogue=catalogue, dictionary=False).report
    entries = {e.name: e for e in report.effects}
    assert set(entries) == {"tail_swap", "hard_iron", "compass_offset"}
    assert entries["tail_swap"].tails == [frame.tails[0], frame.tails[2]]
    start = np.datetime64(entries["tail_swap"].period[0])
    assert abs(start - (START + 10)) <= np.timedelta64(1, "D")
    assert entries["hard_iron"].tails == [frame.tails[0]]
    assert entries["compass_offset"].tails == [frame.tails[2]]


def test_missing_context_is_untestable_and_missing_derivatives_are_refused(quiet):
    blind = replace(quiet, icing=np.full(quiet.size, -1), temperature=np.full(quiet.size, np.nan))
    heater = {"heater_current": CATALOGUE["heater_current"]}
    diagnosis = diagnose(blind, catalogue=heater, dictionary=False)
    assert "icing" in diagnosis.report.untestable["heater_current"]
    with pytest.raises(InputError, match="too few reports"):
        diagnose(quiet.take(slice(0, 100)))
    ds = headings_dataset()
    ds = ds.drop_vars([name for name in ds if "tendency" in name or "derivative" in name])
    with pytest.raises(InputError, match="derivatives"):
        diagnose(ds, reference=str(ds["reference"].values[0]))
