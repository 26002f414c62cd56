"""The gap page of a real product: the verdict in words, every section, every way to be empty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from markupsafe import escape
from matplotlib.figure import Figure
from tests.report import gap_factories
from tests.report.gap_factories import effect
from tests.report.test_figures import check_figure
from tests.report.test_page import Balance, parsed

from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import (
    ClosesEntry,
    GapReport,
    MeanEntry,
    PlaceEntry,
    RivalEntry,
    StepEntry,
    StepsEntry,
    TailEntry,
    UnconfirmedEntry,
    UnknownClosureEntry,
    UnknownEntry,
)
from airswing.products.netcdf import read_product
from airswing.report import write_gap_page
from airswing.report.gap import closing_figures, where_figures, which_figures
from airswing.report.gap.verdict import verdict
from airswing.report.gap.words import (
    digits_for,
    effect_sentence,
    joined,
    nature_of,
    parameter_text,
    parameters_text,
    period_text,
    slice_words,
    small_text,
    value_words,
    who_text,
)


@pytest.fixture(scope="module")
def gap(gap_product: Path) -> GapReport:
    """A diagnosis as the command wrote it: iron on N401, airspeed of N403."""
    return GapReport.read(gap_product / "gap.json")


@pytest.fixture(scope="module")
def maps(gap_product: Path) -> xr.Dataset:
    """Its gap.nc."""
    return read_product(gap_product / "gap.nc")


def unknown(*places: PlaceEntry) -> UnknownEntry:
    closure = UnknownClosureEntry(7.4, 7.2, 0.2, [0.1, 0.3])
    return UnknownEntry(bool(places), list(places), closure)


def test_verdict_of_a_real_diagnosis(gap: GapReport) -> None:
    text = verdict(gap)
    assert "N401: heading error of one cycle, amplitude 6." in text
    assert "N403: airspeed wrong by a factor, scale 3." in text
    before, after = gap.closure.before, gap.closure.after
    assert f"adding them takes the disagreement from {before:.1f} to {after:.1f} kt" in text
    assert text.endswith(f"on held-out flights, noise floor {gap.gap.noise_floor_kt:.1f}.")


def test_verdict_in_the_words_of_the_example(gap: GapReport) -> None:
    one = effect(
        "hard_iron",
        "N412",
        "N418",
        parameters={"amplitude_deg": 3.912},
        standard_errors={"amplitude_deg": 0.2},
        share_of_gap=0.61,
    )
    closure = replace(gap.closure, before=7.4, after=6.5)
    example = replace(gap, effects=[one], closure=closure, gap=replace(gap.gap, noise_floor_kt=6.3))
    assert verdict(example) == (
        "N412 and N418: heading error of one cycle, amplitude 3.9 ± 0.2°; explains 61 % of the "
        "gap; adding it takes the disagreement from 7.4 to 6.5 kt on held-out flights, noise "
        "floor 6.3."
    )


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (7.42, 6.49, "7.4 to 6.5"),
        (5.014, 4.997, "5.01 to 5.00"),
        (5.0141, 5.0122, "5.014 to 5.012"),
    ],
)
def test_what_is_closed_is_told_in_digits_that_show_it(
    gap: GapReport, before: float, after: float, told: str
) -> None:
    closure = replace(gap.closure, before=before, after=after)
    assert f"takes the disagreement from {told} kt" in verdict(replace(gap, closure=closure))


def test_verdict_when_nothing_is_missing_claims_nothing(gap: GapReport) -> None:
    numbers = replace(gap.gap, mean_vector_disagreement_kt=7.4, noise_floor_kt=6.3)
    none = replace(gap, effects=[], gap=numbers)
    assert verdict(none).startswith("Nothing is missing")
    assert "7.4 kt and the noise floor 6.3 kt" in verdict(none)
    hides = replace(none, closure=replace(gap.closure, could_hide_kt=0.0512))
    assert "could close up to 0.051 kt and not be seen; what the model's winds" in verdict(hides)
    near = [
        UnconfirmedEntry("reference_speed_bias", [], None, chance, 8.0, [], "")
        for chance in (0.895, 0.45)
    ]
    assert verdict(replace(none, unconfirmed=near)).endswith(
        "Likelier than not, but not counted as found: "
        f"{CATALOGUE['reference_speed_bias'].title} (probability 0.89)."
    )
    one_day = replace(none, counts=replace(gap.counts, days=1))
    assert verdict(one_day).startswith("One day of reports is too short")


def test_verdict_says_unknown_and_where(gap: GapReport) -> None:
    place, table = gap_factories.unknown_place(), gap_factories.unknown_table()
    alone = replace(gap, effects=[], unknown=unknown(place))
    assert "hold (icing by magnetic heading, across the heading: N403)" in verdict(alone)
    near = replace(place, nearest_effect="compass_drift", nearest_effect_share=0.92)
    text = verdict(replace(alone, unknown=unknown(near)))
    assert "no known effect" not in text and "does not hold" not in text
    assert "comes nearest, which explains 92 % of it, though days left out do not" in text
    far = verdict(replace(alone, unknown=unknown(replace(near, nearest_effect_share=0.3))))
    assert "no known effect explains it (" in far and "explains 30 % of it)" in far
    sent = replace(
        place,
        component="reported_direction",
        variables=["wind_direction"],
        steps=StepsEntry(45.0, 25.2, 1.0),
        closure=ClosesEntry(0.36, [0.31, 0.41]),
    )
    assert verdict(replace(alone, unknown=unknown(sent))).endswith(
        "; directions come in steps of 45° up to 25 kt, which lengthens the disagreement by "
        "0.36 kt (0.31 to 0.41), though no report can be turned back."
    )
    both = replace(gap, unknown=unknown(table))
    assert verdict(both).endswith(
        "Something unknown remains (altitude by temperature, across the heading: N403); a table "
        "by altitude and temperature closes 0.20 kt (0.10 to 0.30) of 7.40."
    )


@pytest.mark.parametrize(
    ("name", "value", "error", "text"),
    [
        ("amplitude_deg", 3.912, 0.2, "amplitude 3.9 ± 0.2°"),
        ("rate_deg_per_day", 0.0312, 0.004, "rate 0.031 ± 0.004°/day"),
        ("scale_percent", 1.5, 0.31, "scale 1.5 ± 0.3 %"),
        ("offset_m_s", -0.5, 0.05, "offset -0.50 ± 0.05 m/s"),
        ("offset_s", 61.0, 6.6, "offset 61 ± 7 s"),
        ("above_hPa", 400, None, "above 400 hPa"),
        ("fraction", 0.01234, None, "fraction 0.01234"),
        ("pair", "N1/N2", None, "pair N1/N2"),
    ],
)
def test_parameters_carry_their_unit(
    name: str, value: float | str, error: float | None, text: str
) -> None:
    assert parameter_text(name, value, error) == text


def test_words() -> None:
    assert joined(["a"]) == "a"
    assert joined(["a", "b", "c"]) == "a, b and c"
    assert joined(list("abcdefgh"), most=2) == "a, b and 6 more"
    assert digits_for(0.2) == 1
    assert small_text(0.0213) == "= 0.021"
    assert small_text(4e-25) == "< 1e-06"
    assert digits_for(6.6) == 0
    assert digits_for(float("nan")) == 2
    assert period_text(effect("x", period=["2009-07-20T00:00", None])) == "from 2009-07-20"
    both = effect("x", period=["2009-07-01", "2009-07-09"])
    assert period_text(both) == "from 2009-07-01 to 2009-07-09"
    assert period_text(effect("x", period=[None, "2009-08-01"])) == "until 2009-08-01"
    assert period_text(effect("x")) == ""
    assert effect_sentence(effect("reference_time_offset")).startswith("The reference: ")
    assert effect_sentence(effect("declination_error")).startswith("The whole fleet")


def test_places_in_words() -> None:
    place = gap_factories.unknown_place()
    one = replace(place, component="scatter", variables=["scatter"], tails=["N1"])
    assert slice_words(one) == "scatter, of single reports: N1"
    wind = ["stretched_above_700_hPa", "wind_speed"]
    one = replace(place, component="wind", variables=wind, tails=[])
    assert slice_words(one) == "the reference's wind, stretched above 700 hPa"
    piece = gap_factories.slice_entry("level", ["above 400 hPa"], 0.1, 0.1)
    assert slice_words(piece) == "level: above 400 hPa"


def test_whom_an_effect_concerns(gap: GapReport) -> None:
    everybody = ("N1", "N2", "N3")
    assert who_text(effect("declination_error", *everybody, scope="fleet")) == "the whole fleet"
    shared = effect("reference_speed_bias", *everybody, scope="fleet")
    assert who_text(shared) == "the reference"
    each = effect("hard_iron", *(f"n{k}" for k in range(8)))
    assert who_text(each, 9) == "n0, n1, n2, n3, n4, n5 and 2 more"
    assert who_text(each, 8) == "each of the 8 aircraft"
    three, four = (effect("hard_iron", *(f"n{k}" for k in range(size))) for size in (3, 4))
    assert who_text(four, 4) == "each of the 4 aircraft" and who_text(three, 3) == "n0, n1 and n2"
    assert effect_sentence(each, 8).startswith("Each of the 8 aircraft: heading error of one")
    single = effect("tas_scale", "n1x")
    assert who_text(single) == "n1x"
    assert verdict(replace(gap, effects=[single, shared])).startswith("n1x: ")
    assert "; the reference: " in verdict(replace(gap, effects=[single, shared]))
    assert verdict(replace(gap, effects=[shared, single])).startswith("The reference: ")


def test_page_of_a_real_diagnosis(gap: GapReport, gap_product: Path) -> None:
    text, found = parsed(gap_product / "gap" / "index.html")
    assert found.open == []
    assert all(a.startswith(("data:image/", "#")) for a in found.addresses)
    where, which, far, method = 1 + 4, 2, 1, 2
    assert found.images == where + which + far + method
    names = ("where", "which", "far", "open", "claims", "method")
    order = [text.index(f'<section id="{name}"') for name in names]
    assert order == sorted(order)
    assert text.index("<h1>") < order[0]
    for name, reason in gap.untestable.items():
        assert str(escape(reason)) in text, name
    held = sum(one.ok for one in gap.assumptions)
    assert f"{held} of {len(gap.assumptions)} hold" in " ".join(text.split())
    assert "heading error of one cycle (hard_iron)" in text


def test_every_effect_found_says_what_it_is_and_what_is_like_it(
    gap: GapReport, maps: xr.Dataset, tmp_path: Path
) -> None:
    twice = effect("tas_scale", "N1"), effect("tas_scale", "N2"), effect("compass_step", "N3")
    text, _ = parsed(write_gap_page(tmp_path, gap=replace(gap, effects=list(twice)), maps=maps))
    for name in ("tas_scale", "compass_step"):
        for part in nature_of(name):
            assert text.count(str(escape(part))) == 1
    assert text.count("Easily confused with") == 2
    assert "<li><b>Compass deviation that changes at a date.</b> Maintenance, " in text
    told = nature_of("compass_step")
    assert told.source.startswith("Source: EASA AMC 25.1327 and FAA AC 43.13-1B (when a compass ")
    assert (
        "; constant heading error or heading error of one cycle (where the date lies near an end "
        "of the record); two aircraft exchanged identifiers (where "
    ) in told.alike


@pytest.mark.parametrize("name", CATALOGUE)
def test_what_is_said_of_an_effect_is_whole_sentences_without_code_names(name: str) -> None:
    told = nature_of(name)
    for part in (told.physics, told.source, told.alike or "."):
        assert part.endswith(".") and "_" not in part and ".." not in part
        assert "seed" not in part and " k x " not in part
    assert told.physics == CATALOGUE[name].physics and CATALOGUE[name].source in told.source


def test_an_effect_that_is_no_longer_in_the_catalogue_is_told_without_its_nature() -> None:
    assert nature_of("of_another_version") is None


def test_the_page_the_command_wrote_is_the_page_of_its_products(
    gap: GapReport, maps: xr.Dataset, gap_product: Path, tmp_path: Path
) -> None:
    again = write_gap_page(tmp_path / "gap", gap=gap, maps=maps)
    assert again == tmp_path / "gap" / "index.html"
    assert again.read_text() == (gap_product / "gap" / "index.html").read_text()


def test_figures_of_a_real_diagnosis(gap: GapReport, maps: xr.Dataset) -> None:
    tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
    posteriors = which_figures.posteriors(gap.evidence)
    figures: list[Figure] = [
        where_figures.aircraft_heading_figure(maps, gap),
        where_figures.aircraft_time_figure(maps, gap),
        where_figures.phase_level_figure(maps, gap),
        where_figures.gap_map_figure(maps, gap),
        which_figures.evidence_figure(gap),
        which_figures.posterior_figure(tails, posteriors),
        closing_figures.waterfall_figure(gap),
        closing_figures.autocorrelation_figure(gap),
        closing_figures.pit_figure(maps),
    ]
    assert all(len(shares) == len(tails) for shares in posteriors.values())
    for figure in figures:
        check_figure(figure)


def test_the_heading_map_shows_its_cells_and_sets_a_named_aircraft_bold(
    gap: GapReport, maps: xr.Dataset
) -> None:
    axes = where_figures.aircraft_heading_figure(maps, gap).axes[0]
    drawn = np.ma.filled(axes.collections[0].get_array().astype(float), np.nan)
    shown = maps["heading_map"].transpose("aircraft", "octant").to_numpy()
    assert np.array_equal(drawn.ravel(), shown.ravel(), equal_nan=True)
    bold = {one.get_text() for one in axes.get_yticklabels() if one.get_fontweight() == "bold"}
    assert bold == {tail for one in gap.effects for tail in one.tails} & set(
        maps["aircraft"].to_numpy().tolist()
    )


@pytest.fixture(scope="module")
def bare(
    gap: GapReport, maps: xr.Dataset, tmp_path_factory: pytest.TempPathFactory
) -> tuple[GapReport, str, Balance]:
    """The diagnosis without its effects, and its page."""
    none = replace(gap, effects=[])
    text, found = parsed(write_gap_page(tmp_path_factory.mktemp("bare"), gap=none, maps=maps))
    return none, text, found


def test_page_without_effects(bare: tuple[GapReport, str, Balance]) -> None:
    _, text, found = bare
    assert found.open == []
    assert "<h1>Nothing is missing" in text
    assert "No effect of the catalogue is needed" in text


def test_what_could_not_be_told_apart(gap: GapReport, maps: xr.Dataset, tmp_path: Path) -> None:
    like = effect("hard_iron", "N404", ambiguity=[gap_factories.rival()])
    alike = RivalEntry("heater_current", None, "the icing flag", 0.9)
    bare = replace(gap, effects=[like, effect("compass_offset", "N4", ambiguity=[alike])])
    text, _ = parsed(write_gap_page(tmp_path, gap=bare, maps=maps))
    assert "What would tell: headings in more compass points." in text
    assert "What would tell: the icing flag." in text


def test_unknown_effects_are_placed_and_drawn(
    bare: tuple[GapReport, str, Balance], maps: xr.Dataset, tmp_path: Path
) -> None:
    mean = MeanEntry("tas_scale", ["N403"], {"scale_percent": 1.0}, {})
    place, table = gap_factories.unknown_place(), gap_factories.unknown_table()
    places = unknown(replace(place, mean=mean), table)
    none, _, without = bare
    text, found = parsed(write_gap_page(tmp_path, gap=replace(none, unknown=places), maps=maps))
    first, second = slice_words(place), slice_words(table)
    assert f"found in {first} and {second}." in text
    assert found.images == without.images + 2


def test_categories_stand_by_name_beside_a_table_of_an_unknown() -> None:
    table = gap_factories.unknown_table()
    edges = [[-0.5, 0.5, 1.5, 2.5], [-0.5, 0.5, 1.5]]
    curve = replace(table.curve, variables=["phase", "icing"], edges=edges, values=[0.5] * 6)
    axes = which_figures.unknown_curve_figure(replace(table, curve=curve)).axes[0]
    assert [one.get_text() for one in axes.get_xticklabels()] == ["ascent", "cruise", "descent"]
    assert [one.get_text() for one in axes.get_yticklabels()] == ["off", "on"]
    edges = [[0.0, 180.0, 360.0], [-0.1, 0.0, 0.3]]
    names, units = ["magnetic_heading", "acceleration"], ["degree", "m/s2"]
    turn = replace(curve, variables=names, variable_units=units, edges=edges, values=[0.5] * 4)
    axes = which_figures.unknown_curve_figure(replace(table, curve=turn)).axes[0]
    assert axes.get_xticks().tolist() == [0.0, 90.0, 180.0, 270.0, 360.0]
    assert axes.get_ylabel() == "acceleration (m/s²)"


def test_layers_stand_by_their_bounds(gap: GapReport, maps: xr.Dataset) -> None:
    axes = where_figures.phase_level_figure(maps, gap).axes[0]
    told = [one.get_text() for one in axes.get_yticklabels()]
    assert told == ["850-1100", "700-850", "600-700", "500-600", "400-500", "above 400"]


def test_names_below_the_probabilities_turn_where_they_would_overlap() -> None:
    for number, turned in ((14, 0.0), (30, 90.0)):
        tails = [f"N{401 + k}" for k in range(number)]
        axes = which_figures.posterior_figure(tails, {"tas_scale": [0.5] * number}).axes[0]
        assert {one.get_rotation() for one in axes.get_xticklabels()} == {turned}
    rows = {"tas_scale": [0.5], "cross:airspeed*heading": [0.5], "wind:turned": [0.5]}
    axes = which_figures.posterior_figure(["N1"], rows).axes[0]
    told = [one.get_text() for one in axes.get_yticklabels()]
    assert told == ["tas scale", "airspeed by heading, across", "turned, wind"]


def test_steps_of_the_waterfall_carry_the_level_they_leave(gap: GapReport) -> None:
    waterfall = [
        StepEntry("reports as they are", 7.4, None),
        StepEntry("hard_iron", 6.7, [0.6, 0.8]),
        StepEntry("compass_step", 6.5, [0.15, 0.25]),
        StepEntry("noise floor", 6.3, None),
    ]
    steps = closing_figures.closure_steps(replace(gap, waterfall=waterfall))
    assert [(name, level) for name, level, _ in steps] == [
        ("hard_iron", 6.7),
        ("compass_step", 6.5),
    ]
    assert steps[0][2] == pytest.approx([6.6, 6.8])
    assert steps[1][2] == pytest.approx([6.45, 6.55])
    real = closing_figures.closure_steps(gap)
    assert [name for name, *_ in real] == [one.name for one in gap.effects]


def test_bars_of_the_waterfall_lead_from_before_to_after(gap: GapReport) -> None:
    waterfall = [
        StepEntry("reports as they are", 7.4, None),
        StepEntry("hard_iron", 6.9, [0.4, 0.6]),
        StepEntry("tas_scale", 6.5, [0.3, 0.5]),
        StepEntry("noise floor", 6.3, None),
    ]
    numbers = replace(gap.gap, noise_floor_kt=6.3)
    closure = replace(gap.closure, before=7.4, after=6.5)
    own = replace(gap, gap=numbers, closure=closure, waterfall=waterfall)
    patches = closing_figures.waterfall_figure(own).axes[0].patches
    bars = [(p.get_x(), p.get_x() + p.get_width()) for p in patches]  # type: ignore[attr-defined]
    assert np.allclose(bars, [(0, 7.4), (7.4, 6.9), (6.9, 6.5), (0, 6.5), (0, 6.3)])


def test_best_evidence_is_of_the_catalogue_alone() -> None:
    best = which_figures.best_evidence(gap_factories.evidence())
    assert list(best.items()) == [
        ("hard_iron", 5230.0),
        ("compass_step", 400.0),
        ("soft_iron", 320.0),
        ("tas_scale", -2.0),
    ]


def test_posterior_is_taken_from_the_effect_s_own_row() -> None:
    found = which_figures.posteriors(gap_factories.evidence())
    assert list(found) == ["hard_iron", "compass_step"]
    assert found["hard_iron"][-1] == 0.99


def test_weeks_are_dated_from_the_first_day(maps: xr.Dataset) -> None:
    starts = where_figures.week_starts(maps).astype("datetime64[D]")
    assert starts.size == maps.sizes["week"]
    assert starts[0] == maps["day"].to_numpy().min().astype("datetime64[D]")
    assert (np.diff(starts) == np.timedelta64(7, "D")).all()


def test_parameters_of_several_aircraft_are_a_range_where_they_differ() -> None:
    parameters = {"amplitude_deg": 2.6, "phase_deg": 31.0, "at_horizontal_field_nT": 18820.0}
    errors = {"amplitude_deg": 0.1, "phase_deg": 3.0}

    def pair(one: dict[str, float], two: dict[str, float], **other: float) -> object:
        return effect(
            "hard_iron",
            "N1",
            "N2",
            parameters=parameters | other,
            standard_errors=errors,
            per_tail={"N1": TailEntry(one), "N2": TailEntry(two)},
        )

    second = {"amplitude_deg": 5.92, "phase_deg": -50.0}
    apart = pair({"amplitude_deg": 1.14, "phase_deg": 170.0}, second)
    assert parameters_text(apart) == "amplitude 1.1 to 5.9°, at 18,820 nT"
    assert effect_sentence(apart) == (
        "N1 and N2: heading error of one cycle, amplitude 1.1 to 5.9°"
    )
    near = pair({"amplitude_deg": 5.8, "phase_deg": -51.0}, second)
    assert parameters_text(near, brief=True) == "amplitude 2.6 ± 0.1°, phase 31 ± 3°"
    round_the_back = pair(
        {"amplitude_deg": 5.8, "phase_deg": 178.0},
        {"amplitude_deg": 5.9, "phase_deg": -179.0},
        phase_deg=179.5,
    )
    assert parameters_text(round_the_back, brief=True) == "amplitude 2.6 ± 0.1°, phase 180 ± 3°"


def test_a_range_of_small_values_keeps_its_digits() -> None:
    each = {"N1": 0.021, "N2": 0.048}
    drift = effect(
        "compass_drift",
        parameters={"rate_deg_per_day": 0.03},
        standard_errors={"rate_deg_per_day": 0.001},
        per_tail={tail: TailEntry({"rate_deg_per_day": rate}) for tail, rate in each.items()},
    )
    assert parameters_text(drift) == "rate 0.021 to 0.048°/day"


def test_the_aircraft_of_a_swap_are_told_once_and_not_as_a_list() -> None:
    pair = ["N402", "N406"]
    swap = effect("tail_swap", *pair, parameters={"pair": pair}, period=["2009-03-10", None])
    assert effect_sentence(swap) == (
        "N402 and N406: two aircraft exchanged identifiers, from 2009-03-10"
    )


def test_values_of_slices_are_said_with_their_units():
    assert value_words("temperature", "283.1") == "10 °C"
    assert value_words("altitude", "0.6931") == "500 hPa"
    assert value_words("longitude", "-87.47") == "87.5°W"
    assert value_words("magnetic_heading", "cos2") == "cos 2 × heading"
    assert value_words("phase", "ascent sin1") == "ascent sin heading"
    assert value_words("phase", "descent") == "descent"
    assert value_words("turned", "across wind") == "across wind"
