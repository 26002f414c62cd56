"""gap.json and files of effects are read as written; their faults are named."""

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter
from tests.report import gap_factories

from airswing.errors import InputError
from airswing.gap.effects import CATALOGUE, ActiveEffect
from airswing.gap.result.schema import (
    CurveEntry,
    EffectEntry,
    GapReport,
    PlaceEntry,
    TailEntry,
    UnknownEntry,
)
from airswing.gap.simulation.effects_file import (
    not_known,
    parse_effects,
    plain_effects,
    plain_period,
    read_effects,
    unknown_not_known,
    write_effects,
)
from airswing.products.whole_files import json_types


def stated(name, *tails, detailed=None):
    per_tail = {tail: TailEntry({"fraction": 0.02}) for tail in detailed or ()}
    entry = EffectEntry(name, 1.0, list(tails), {}, {}, None, "aircraft", 9.0)
    return replace(entry, per_tail=per_tail or None)


def test_scatter_that_was_known_is_not_named_again():
    outliers = stated("outliers", "N401", "N402", detailed=["N401", "N402"])
    entries = [outliers, stated("hard_iron", "N401")]
    effects = [
        ActiveEffect("outliers", {"fraction": 0.02}, ("N401",)),
        ActiveEffect("hard_iron", {"amplitude_deg": 1.0}, ("N401",)),
    ]
    remaining = not_known(entries, effects)
    expected = [("outliers", ["N402"]), ("hard_iron", ["N401"])]
    assert [(entry.name, entry.tails) for entry in remaining] == expected
    assert list(remaining[0].per_tail) == ["N402"]
    everyone = [ActiveEffect("outliers", {"fraction": 0.02})]
    assert [entry.name for entry in not_known(entries, everyone)] == ["hard_iron"]


def test_a_known_floor_of_the_speeds_is_not_reported_again():
    """The floor remains detectable, since the original speeds cannot be restored."""
    curve = CurveEntry(variables=["wind_speed"], labels=[], m_s=[])
    places = [
        PlaceEntry(component, "wind_speed", ["wind_speed"], "", [], "fleet", 30.0, 0.4, curve)
        for component in ("reported_speed", "along_wind")
    ]
    unknown = UnknownEntry(True, places)
    parameters = {"component": "reported_speed", "variables": ["wind_speed"]}
    effects = [ActiveEffect("empirical", parameters)]
    assert unknown_not_known(unknown, effects) == UnknownEntry(True, places[1:])
    assert unknown_not_known(UnknownEntry(True, places[:1]), effects) == UnknownEntry(False, [])
    along = [ActiveEffect("empirical", parameters | {"component": "along_wind"})]
    assert unknown_not_known(unknown, along) is unknown


def test_a_number_of_another_kind_is_named(tmp_path):
    content = json_types(gap_factories.content(stated("hard_iron", "N401")).content())
    parameters = {"range": [-15.0, 0.0], "pair": ["N401"], "word": "flag", "none": None}
    content["effects"][0]["parameters"] = parameters
    assert TypeAdapter(GapReport).validate_python(content).effects[0].parameters == parameters
    content["closure"]["before"] = "much"
    bad = tmp_path / "gap.json"
    bad.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"closure\.before"):
        GapReport.read(bad)
    bad.write_text("{")
    with pytest.raises(InputError, match="not the result of a diagnosis"):
        GapReport.read(bad)
    with pytest.raises(InputError, match="cannot be read"):
        GapReport.read(tmp_path / "none.json")


AUGUST = 1249084800.0  # 2009-08-01T00:00Z

values = st.floats(-1e4, 1e4, allow_nan=False).map(lambda x: round(x, 6))


@st.composite
def effects_of_files(draw):
    effect = CATALOGUE[draw(st.sampled_from(sorted(CATALOGUE)))]
    parameters = {p.name: draw(values) for p in effect.parameters if p.units}
    if effect.name == "tail_swap":
        parameters["pair"] = ["N401", "N402"]
    names = st.lists(st.sampled_from(["N401", "7", "N403"]), min_size=1)
    tails = draw(st.none() | names.map(tuple))
    start = draw(st.none() | st.integers(0, 2**31).map(float))
    end = None if start is None else start + draw(st.integers(1, 10**7))
    return ActiveEffect(effect.name, parameters, tails, draw(st.sampled_from([None, (start, end)])))


@given(st.lists(effects_of_files(), max_size=4))
def test_effects_are_written_and_read(tmp_path_factory, effects):
    path = tmp_path_factory.mktemp("effects") / "effects.yaml"
    assert read_effects(write_effects(effects, path)) == effects
    assert parse_effects(plain_effects(effects)) == effects


def test_file_with_units_and_dates(tmp_path):
    path = tmp_path / "effects.yaml"
    path.write_text(
        "effects:\n"
        "  - name: hard_iron\n"
        "    tails: [N412, 418]\n"
        "    parameters: {amplitude_deg: 3.9, phase_deg: 40}\n"
        "  - {name: tas_offset, tails: all, parameters: {offset_m_s: 2 kt}}\n"
        "  - name: compass_step\n"
        "    parameters: {offset_deg: 0.0349066 rad}\n"
        "    period: [2009-08-01, 2009-08-02T12:00:00Z]\n"
    )
    iron, offset, step = read_effects(path)
    parameters = {"amplitude_deg": 3.9, "phase_deg": 40.0}
    assert iron == ActiveEffect("hard_iron", parameters, ("N412", "418"), None)
    assert offset.tails is None
    assert offset.parameters["offset_m_s"] == pytest.approx(1.028889, abs=1e-6)
    assert step.parameters["offset_deg"] == pytest.approx(2.0, abs=1e-4)
    assert step.period == (AUGUST, AUGUST + 1.5 * 86400.0)
    assert plain_period(step.period) == ["2009-08-01T00:00:00Z", "2009-08-02T12:00:00Z"]


IRON = {"name": "hard_iron"}
OUTLIERS = {"name": "outliers", "parameters": {"fraction": 0.1}}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"name": "hard_irn", "parameters": {}}, "did you mean 'hard_iron'"),
        ({"parameters": {}}, "unknown effect"),
        (IRON | {"parameters": {"amplitude": 1}}, "did you mean 'amplitude_deg'"),
        (IRON | {"parameters": {"phase_deg": 1}}, "needs a value of amplitude_deg"),
        (IRON | {"parameters": {"amplitude_deg": "3 kt"}}, "in units of degree"),
        (IRON | {"parameters": {"amplitude_deg": "3 dg"}}, "in units of degree"),
        (IRON | {"parameters": {"amplitude_deg": [3]}}, "needs a number"),
        (IRON | {"parameters": {"amplitude_deg": True}}, "needs a number"),
        (IRON | {"parameters": {"amplitude_deg": float("nan")}}, "amplitude_deg.*nan"),
        (IRON | {"parameters": [3]}, "must be a mapping"),
        (OUTLIERS | {"tail": ["N1"]}, "did you mean 'tails'"),
        (OUTLIERS | {"tails": []}, "list of aircraft"),
        (OUTLIERS | {"period": "July"}, "start, end"),
        (OUTLIERS | {"period": ["2009-08", None]}, "no date"),
        (OUTLIERS | {"period": ["2009-08-02", "2009-08-01"]}, "ends before"),
        ("hard_iron", "must be a mapping"),
    ],
)
def test_errors_name_the_fault_and_the_file(entry, message):
    with pytest.raises(InputError, match=f"mine.yaml.*{message}"):
        parse_effects([entry], file="mine.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot read"),
        ("a: [1\n", "not a YAML file"),
        ("effect: []\n", "did you mean 'effects'"),
        ("3\n", "must be a list"),
    ],
)
def test_other_files_are_refused(tmp_path, text, message):
    path = tmp_path / "effects.yaml"
    if text:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_effects(path)
