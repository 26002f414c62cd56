"""The page of a gap diagnosis: headline, words, every section, and what a file may lack."""

import re

import numpy as np
import pytest
from markupsafe import escape

import airswing
from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import GapReport
from airswing.products.netcdf import read_product
from airswing.report import html, write_gap_page
from airswing.report.gap import words
from airswing.report.gap.figures import gap_figures
from airswing.report.gap.gap_page import ShownDiagnosis
from airswing.report.gap.words import headline, parameters_text, verdict
from airswing.workflow import Job, gap_stage
from tests.report import gap_factories
from tests.report.gap_factories import TAILS, content, effect, iron, place
from tests.report.pages import Drawn, check_figure, check_page, labels

MAPS = gap_factories.maps()
FLEET = effect("reference_time_offset", scope="fleet")
SCATTER = place(component="scatter", variables=["scatter"], tails=["N403"])
HEADLINES = {
    "Hard iron on 6 of 14 aircraft explains the gap": content(iron(*TAILS[:6])),
    "Hard iron on N401 and declination error on all aircraft explain 87 % of the gap": content(
        iron("N401"), effect("declination_error"), closure={"fraction_of_excess": 0.87}
    ),
    "Hard iron on N401 and 2 more effects explain the gap": content(
        iron("N401"), effect("reference_speed_bias"), effect("tas_scale", "N403")
    ),
    "Reference time offset and an unexplained error by temperature account for the gap": content(
        FLEET, places=[place()]
    ),
    "An unexplained error by temperature on 3 of 14 aircraft accounts for the gap": content(
        places=[place()]
    ),
    "Unexplained scatter on N403 accounts for the gap": content(places=[SCATTER]),
    "An unexplained error by temperature on 3 of 14 aircraft does not reduce the gap: "
    "8.31 → 8.36 kt.": content(places=[place()], closure={"after": 8.36}),
    "No missing effect found: noise of reports and reference explains the gap of 8.3 kt.": (
        content()
    ),
    "One day of reports is too short to decide what explains the gap of 8.3 kt.": content(
        counts=gap_factories.counts(1, 2)
    ),
}


@pytest.mark.parametrize("expected", HEADLINES)
def test_headlines(expected):
    text = headline(HEADLINES[expected])
    assert text == (expected if expected.endswith(".") else f"{expected}: 8.3 → 6.3 kt.")
    assert len(text.split()) <= 25
    assert verdict(HEADLINES[expected]).startswith(text)


def test_the_verdict_has_a_line_for_every_finding():
    closure = {"reduction": 1.2, "reduction_ci": [1.0, 1.4]}
    gap = content(iron("N401", "N402", closure=closure), places=[place()])
    first, second, third = verdict(gap).splitlines()
    assert first.startswith("Hard iron on N401 and N402 and an unexplained error by temperature")
    assert "amplitude 3.9 ± 0.4°" in second and "closes 1.20 kt (1.00 to 1.40)" in second
    parts = ("N403, N404 and N405", "closes 3.30 kt (3.00 to 3.60)", "TAS scale (22 % of")
    assert all(text in third for text in parts)
    for end, text in ((None, "from 2009-07-18, "), ("2009-07-28", "from 2009-07-18 to 2009-07-28")):
        assert text in verdict(content(iron("N401", period=["2009-07-18", end])))
    swap = effect("tail_swap", "N1", "N2", parameters={"pair": ["N1", "N2"]})
    assert verdict(content(swap)).endswith("Tail swap on N1 and N2: probability 0.99.")


def test_the_verdict_states_the_detection_limit():
    gap = content(closure={"could_hide_kt": 0.0512})
    assert "could close up to 0.051 kt without being detected" in verdict(gap)


@pytest.mark.parametrize(
    ("name", "value", "error", "text"),
    [
        ("amplitude_deg", 3.912, 0.2, "amplitude 3.9 ± 0.4°"),
        ("rate_deg_per_day", 0.0312, 0.004, "rate 0.031 ± 0.008°/day"),
        ("scale_percent", 1.5, 0.31, "scale 1.5 ± 0.6 %"),
        ("offset_m_s", -0.5, 0.05, "offset -1.0 ± 0.2 kt"),
        ("offset_s", 61.0, 6.6, "offset 61 ± 13 s"),
        ("above_hPa", 400, None, "above 400 hPa"),
        ("fraction", 0.01234, None, "fraction 0.01234"),
        ("between_degC", "-10 to 0", None, "between -10 to 0"),
        ("at_horizontal_field_nT", 18820.0, None, "at 18,820 nT"),
    ],
)
def test_parameters_carry_their_unit_and_95_percent_interval(name, value, error, text):
    entry = effect("x", parameters={name: value}, standard_errors={name: error})
    assert parameters_text(content(entry).effects[0]) == text


@pytest.mark.parametrize("name", CATALOGUE)
def test_descriptions_of_effects_are_sentences_without_code_names(name):
    text = words.nature_of(name)
    assert text.count("<span") == 2 and not words.nature_of("of_another_version")
    for sentence in filter(str.strip, re.split("<[^>]*>", text)):
        assert sentence.rstrip().endswith(".") and "_" not in sentence and ".." not in sentence


def full():
    """Return a diagnosis with every section."""
    calibration = {"spread": 0.95, "crps_m_s": 0.64, "crps_expected_m_s": 0.68, "lag_one": 0.05}
    calibration |= dict.fromkeys(("auc", "auc_standard_error", "lag_one_standard_error"))
    placebo = {"reduction_kt": 0.01, "reduction_ci_kt": [-0.02, 0.04], "draws": 8}
    fit = {"aircraft": "N404", "stays": False}
    for name, values in {"offset": (0.31, 0.32, 0.05), "amplitude": (3.9, 4.3, 0.1)}.items():
        for ending, value in zip(("", "_after", "_standard_error"), values, strict=True):
            fit[f"{name}_deg{ending}"] = value
    rival = {"name": "soft_iron", "separated_by": "headings in more compass points"}
    rival["difference_nats"] = None
    alias = {"effect": "tas_scale", "other": "tas_offset", "alias_share": 0.913}
    tested = {"reduction_kt": 1.5, "reduction_ci_kt": [1.0, 2.0], "reduction_kt_after": 1.7}
    return content(
        iron(*TAILS[:6], ambiguous_with=["soft_iron"], ambiguity=[rival]),
        effect("tas_scale", "N403", parameters={"scale_percent": 1.5}),
        places=[place()],
        aliases=[alias | {"separated_by": "a wider range of airspeeds"}],
        assumptions=[
            {"assumption": "luck", "check": "placebo", "result": "closes nothing", "ok": True},
            {"assumption": "noise", "check": "distance", "result": "20 % off", "ok": False},
        ],
        calibration={"before": calibration, "after": calibration},
        placebo=placebo | {"reduction_where_fitted_kt": 0.0, "closes_nothing": True},
        claims={
            "taken_off": ["tas_scale"],
            "stay": 0,
            "of": 1,
            "aircraft": [fit, fit | {"aircraft": "N499", "amplitude_deg": None, "stays": None}],
            "field_test": tested | {"stays": True},
        },
    )


def test_the_page_has_every_section_and_folds_the_statistics(tmp_path, monkeypatch):
    monkeypatch.setattr(html, "Figures", Drawn)
    text, page = check_page(write_gap_page(tmp_path, gap=full(), maps=MAPS))
    names = ("what", "closure", "where", "ambiguous", "claims", "statistics")
    order = [text.index(f'<section id="{name}"') for name in names]
    assert order == sorted(order)
    assert page.images == len(gap_figures(full(), MAPS))
    for expected in (
        f"Hard iron ({CATALOGUE['hard_iron'].title}).",
        "Data that would decide: headings in more compass points.",
        "shared variance 91 %",
        str(escape("too few climbs <and> descents")),
        "1 of 2 tested assumptions hold",
        "Placebo:",
        "1.50 kt (1.00 to 2.00) becomes 1.70 kt, within its interval",
        "3.90 ± 0.20",
        "p value of the gap",
        "<details><summary>Assumptions",
        "<details><summary>Noise model",
        "<details><summary>Calibration on held-out days",
    ):
        assert expected in text, expected


@pytest.mark.parametrize(
    ("effects", "places", "reason"),
    [
        ([iron("N401")], [], "Only compass effects were found"),
        ([iron("N401")], [place()], "An unexplained error is not subtracted"),
        ([], [], "No effect was found"),
    ],
)
def test_deviations_remain_where_no_effect_is_subtracted(effects, places, reason, tmp_path):
    gap = content(*effects, places=places, claims={"taken_off": []}, evidence=[])
    text, _ = check_page(write_gap_page(tmp_path, gap=gap, maps=MAPS[["aircraft"]].copy()))
    assert reason in text and "No effect found is ambiguous" not in text
    assert effects or "No effect of the catalogue is needed" in text


SPEEDS = {"edges": [[1.0, 2.0]], "values": [1.0, 2.2], "labels": [], "m_s": []}
TABLE = {
    "unit": "degree",
    "variable_units": ["degree", ""],
    "edges": [[0.0, 180.0, 360.0], [-0.5, 0.5, 1.5, 2.5]],
    "values": [0.1, 1.4, -0.3, 0.2, None, 0.4],
    "labels": [],
    "m_s": [],
}


BY_AIRCRAFT = {"labels": ["N403"], "m_s": [0.4]}
BY_TEMPERATURE = place()["curve"]
BY_WIND = {"labels": [str(10 * k) for k in range(36)], "m_s": [5.0] * 36, "unit": "percent"}


@pytest.mark.parametrize(
    ("changes", "label"),
    [
        ({}, "fitted residual (kt)"),
        ({"component": "scatter", "curve": BY_TEMPERATURE}, "root mean square (kt)"),
        ({"component": "scatter", "curve": BY_AIRCRAFT}, "root mean square (kt)"),
        ({"component": "reported_time", "curve": BY_AIRCRAFT}, "mean reduction (kt)"),
        ({"component": "reported_direction", "curve": BY_WIND}, "reports above expected (percent)"),
        ({"component": "reported_speed", "curve": SPEEDS}, "reported wind speed (kt)"),
        ({"variables": ["magnetic_heading", "phase"], "curve": TABLE}, "phase"),
    ],
)
def test_curves_of_unexplained_errors(changes, label):
    figure = gap_figures(content(places=[place(**changes)]), MAPS)["unknown_1"]()
    check_figure(figure)
    assert figure.axes[0].get_ylabel() == label
    if "variables" in changes:
        axes = figure.axes[0]
        assert labels(axes) == ["ascent", "cruise", "descent"]
        assert axes.get_xticks().tolist() == [0.0, 90.0, 180.0, 270.0, 360.0]


def test_the_heading_map_shows_its_cells_and_affected_aircraft_are_bold():
    axes = gap_figures(content(iron("N402")), MAPS)["aircraft_heading"]().axes[0]
    drawn = np.ma.filled(axes.collections[0].get_array().astype(float), np.nan)
    assert np.array_equal(drawn.ravel(), MAPS["heading_map"].to_numpy().ravel(), equal_nan=True)
    bold = {tick.get_text() for tick in axes.get_yticklabels() if tick.get_fontweight() == "bold"}
    assert bold == {"N402"}
    layers = labels(gap_figures(content(), MAPS)["phase_level"]().axes[0])
    assert layers == ["850-1100", "700-850", "600-700", "500-600", "400-500", "above 400"]


def test_maps_without_a_filled_cell_are_replaced_by_the_reason():
    names = ("level_map_cross", "level_map_along")
    maps = MAPS.assign({name: np.nan * MAPS[name] for name in names})
    figure = gap_figures(content(), maps)["phase_level"]()
    assert "No phase and layer has enough flights" in figure.caption


def test_the_waterfall_falls_from_before_to_after():
    steps = [("start", 7.4, None), ("hard_iron", 6.9, [0.4, 0.6]), ("tas_scale", 6.5, [0.3, 0.5])]
    gap = content(
        iron("N401"),
        gap={"mean_vector_disagreement_kt": 7.4, "noise_floor_kt": 6.3, "significance": 0.001},
        waterfall=[{"label": name, "kt": kt, "step_ci": ends} for name, kt, ends in steps],
        closure={"before": 7.4, "after": 6.5},
    )
    axes = gap_figures(gap, MAPS)["waterfall"]().axes[0]
    bars = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
    expected = [(0, 7.4), (7.4, 6.9), (6.9, 6.5), (0, 6.5), (0, 6.3)]
    assert np.allclose(sorted(bars), sorted(expected))
    intervals = [line.get_xdata() for line in axes.lines if line.get_zorder() == 4]
    assert np.allclose(np.sort(intervals), [(6.8, 7.0), (6.4, 6.6)])


@pytest.mark.slow
def test_the_page_of_a_real_diagnosis_and_the_same_in_a_notebook(gap_archive, collocated, tmp_path):
    """A diagnosis as the command wrote it: iron on N401, airspeed of N403."""
    output = collocated(tmp_path / "out")
    gap_stage.diagnosis(Job.of(gap_archive, output=output, quiet=True))
    gap, maps = GapReport.read(output / "gap.json"), read_product(output / "gap.nc")
    written = output / "gap" / "index.html"
    check_page(written)
    assert write_gap_page(tmp_path / "gap", gap=gap, maps=maps).read_text() == written.read_text()
    assert "ard iron on N401" in verdict(gap) and "TAS scale on N403" in verdict(gap)
    shown = object.__new__(ShownDiagnosis)
    for name, value in (("report", gap), ("dataset", maps)):
        object.__setattr__(shown, name, value)
    text = shown._repr_html_()
    assert text.count("<li>") >= len(gap.effects) + len(gap.unknown.where) + 1
    assert set(shown.figures) == set(gap_figures(gap, maps))
    assert airswing.diagnose.__doc__
