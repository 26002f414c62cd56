"""Every figure has a caption with its number, units on its axes, and the right content."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import airswing.report as report
from airswing.evaluation.innovations import innovation_statistics
from airswing.report.gap import figures
from airswing.report.html import maps, style
from airswing.report.html.document import Figures
from airswing.report.html.text import Units
from airswing.report.run import evaluation, fleet, heading_error, innovations
from airswing.report.run.selection import disagreement, screening_audit
from tests.report import factories

HEADINGS = factories.headings()
FITS = factories.fits()
CORRECTED = factories.corrected(HEADINGS)
TAILS = factories.names(6)
STATISTICS = innovation_statistics(HEADINGS, CORRECTED, pools={"ruc": ["ruc"]})


def disagreement_figure(units: Units) -> Figure:
    found = disagreement(HEADINGS, CORRECTED, "ruc")
    return fleet.before_after_figure(found, TAILS, TAILS, "ruc", units)


def audit_figure(headings: xr.Dataset) -> Figure:
    return fleet.audit_figure(headings, screening_audit(headings))


def mapped(headings: xr.Dataset) -> Figure:
    return maps.reports_figure(headings, maps.places_of(headings))


FIGURES: dict[str, Callable[[], Figure]] = {
    "reports": lambda: mapped(HEADINGS),
    "dense": lambda: mapped(factories.headings(aircraft=11, reports=2000)),
    "phases": lambda: maps.phase_maps_figure(maps.places_of(HEADINGS)),
    "levels": lambda: maps.level_maps_figure(maps.places_of(factories.headings(shift=-92))),
    "heading errors": lambda: heading_error.heading_errors_figure(
        HEADINGS, FITS, TAILS, "ruc", "kt"
    ),
    "innovations": lambda: innovations.innovation_figure(STATISTICS, "ruc", "kt"),
    "innovation histogram": lambda: innovations.innovation_histogram_figure(
        STATISTICS, "ruc", "kt"
    ),
    "innovation series": lambda: innovations.innovation_series_figure(
        STATISTICS, "ruc", TAILS, "kt"
    ),
    "sounding": lambda: innovations.sounding_figure(HEADINGS, CORRECTED, TAILS, "ruc", "kt"),
    "heading error": lambda: report.heading_error_figure(HEADINGS, FITS, "N402"),
    "coverage": lambda: heading_error.coverage_figure(HEADINGS, TAILS),
    "fleet": lambda: fleet.fleet_figure(FITS, TAILS),
    "disagreement": lambda: disagreement_figure("kt"),
    "audit": lambda: audit_figure(HEADINGS),
    "field test": lambda: report.field_test_figure(factories.field_test()),
    "full field test": lambda: report.field_test_figure(factories.full_field_test()),
    "scrutiny": lambda: evaluation.scrutiny_figure(factories.full_field_test(), "kt"),
    "pairs": lambda: report.pair_differences_figure(factories.sensitivity()["pairs"]),
    "pair": lambda: evaluation.aircraft_differences_figure(factories.sensitivity()["pairs"][0]),
    "no slices": lambda: figures.slices_figure([]),
}
UNIT = re.compile(
    r"\((degree|kt|m/s|m²/s²|km|hPa|K|%|date|number)\)|degree|reports|probability|correlation|"
    r"log Bayes factor|draws|expected|barbs|°C|phase"
)


@pytest.mark.parametrize("name", FIGURES)
def test_figure_says_what_it_shows_and_of_how_many(name: str) -> None:
    check_figure(FIGURES[name]())


def check_figure(figure: Figure) -> None:
    """A figure counts what it shows, names its axes with units and can be drawn."""
    caption = figure.caption  # type: ignore[attr-defined]
    assert re.search(r"n = [\d,]+", caption), caption
    assert "nan" not in caption
    for axes in figure.axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert not label or label.startswith("N4") or UNIT.search(label), label
    picture = style.png_bytes(figure, dpi=40)
    assert picture.startswith(b"\x89PNG")
    assert "matplotlib.pyplot" not in sys.modules or not matplotlib.pyplot.get_fignums()


def test_the_style_does_not_leak() -> None:
    before = dict(matplotlib.rcParams)
    FIGURES["heading error"]()
    assert dict(matplotlib.rcParams) == before


def test_the_same_figure_gives_the_same_bytes() -> None:
    first, second = (fleet.fleet_figure(FITS, TAILS) for _ in range(2))
    assert style.png_bytes(first, colours=256) == style.png_bytes(second, colours=256)


def test_speeds_are_shown_in_the_unit_that_is_asked_for() -> None:
    knots, metric = (disagreement_figure(units).axes[0] for units in ("kt", "m/s"))
    assert knots.get_xlabel().endswith("(kt)") and metric.get_xlabel().endswith("(m/s)")
    one, other = (np.asarray(axes.lines[0].get_xdata()) for axes in (knots, metric))
    assert np.allclose(other, one * 1852 / 3600)


def test_innovation_figures_show_the_statistics_of_the_product() -> None:
    axes = innovations.innovation_figure(STATISTICS, "ruc", "m/s").axes[0]
    names = [one.get_text() for one in axes.get_yticklabels()]
    shown = dict(zip(names, axes.lines[0].get_xdata(), strict=True))
    cells = STATISTICS.sel(reference="ruc", state="reported")
    for name, one in (
        ("cruise", cells.sel(flight_phase="cruise")),
        ("N402", cells.sel(aircraft="N402")),
    ):
        count = one["innovation_speed_count"]
        bias = (one["innovation_speed_bias"] * count).sum() / count.sum()
        assert shown[name] == pytest.approx(float(bias))
    drawn = innovations.innovation_histogram_figure(STATISTICS, "ruc", "kt").axes[0].images[0]
    counts = STATISTICS["innovation_histogram"].sel(state="reported")
    assert drawn.get_array().sum() == counts.sum()


def test_a_sounding_shows_one_ascent_or_descent_by_pressure() -> None:
    figure = innovations.sounding_figure(HEADINGS, CORRECTED, TAILS, "ruc", "m/s")
    lines = figure.axes[0].lines
    assert [line.get_label() for line in lines] == ["reported", "corrected", "ruc"]
    pressure = np.asarray(lines[0].get_ydata())
    assert np.all(np.diff(pressure) <= 0) and pressure.size >= 4
    short = HEADINGS.assign(phase=HEADINGS["phase"] * 0 + 2)
    assert "n = 0" in innovations.sounding_figure(short, CORRECTED, TAILS, "ruc", "kt").caption


def test_captions_are_escaped_in_the_page() -> None:
    figure = figures.slices_figure([])
    figure.say("a < b & c (n = 0)")  # type: ignore[attr-defined]
    html = Figures()("x", figure)
    assert "a &lt; b &amp; c" in html
    assert 'alt="a &lt; b' in html


def test_heading_error_figure_draws_the_fit_and_the_table() -> None:
    axes = report.heading_error_figure(HEADINGS, FITS, "N402", "ruc").axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    fit = FITS.sel(reference="ruc", aircraft="N402")
    x, y = lines["fitted curve"].get_data()
    assert np.allclose(y, factories.curve(fit["deviation"].to_numpy(), x))
    _, nodes = lines["removed by the 8-point table"].get_data()
    assert nodes.tolist() == (-fit["table_correction"].to_numpy()).tolist()


def test_an_untrusted_fit_is_dashed_and_has_no_table() -> None:
    figure = report.heading_error_figure(HEADINGS, FITS, "N406", "ruc")
    labels = {line.get_label() for line in figure.axes[0].get_lines()}
    assert "fit, not usable" in labels
    assert "removed by the 8-point table" not in labels
    assert "poor heading coverage" in figure.caption  # type: ignore[attr-defined]


def test_what_screening_and_reading_left_out() -> None:
    headings = factories.headings(aircraft=1, reports=40)
    headings["screening"][:] = 0
    headings.attrs["reading_audit"] = "not json"
    assert "40 (100.0 %) entered" in audit_figure(headings).caption
    bars = audit_figure(HEADINGS).axes[1]
    assert [one.get_text() for one in bars.get_yticklabels()] == [
        "duplicate",
        "impossible position",
        "repaired: longitude wrapped",
    ]


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'pie_chart'"):
        _ = report.pie_chart


def test_differences_are_drawn_from_a_file_read_back_too() -> None:
    """JSON has no NaN: an interval that could not be had is null there."""
    pair = factories.sensitivity()["pairs"][0]
    pair["aircraft"][0]["offset"] = {"difference": None, "ci": [None, None]}
    assert "95 % intervals" in evaluation.aircraft_differences_figure(pair).caption
