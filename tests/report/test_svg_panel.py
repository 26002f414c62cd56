"""Panels as SVG text: places by hand, gaps and names as they come."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from airswing.report.html.svg_panel import Panel
from airswing.report.run.compass_panels import DRAWN, large_panel, shown_of, small_panels
from airswing.report.run.evaluation_figures import profile_panels
from tests.report import factories

NONE = float("nan")


def panel() -> Panel:
    """A frame of 200 by 100 pixels: 0 to 10 across, -1 to 1 upward."""
    return Panel((250, 140), (40, 10, 15, 25), x=(0.0, 10.0), y=(-1.0, 1.0))


def paths(drawn: Panel) -> list[str]:
    return re.findall(r'<path d="([^"]*)"', str(drawn.svg("x")))


def test_values_stand_where_the_scales_say() -> None:
    one = panel()
    assert one.across([0.0, 5.0, 10.0]) == pytest.approx([0.0, 100.0, 200.0])
    assert one.down([-1.0, 0.5, 1.0]) == pytest.approx([100.0, 25.0, 0.0])
    one.line([0, 5, 10], [0, 0.5, -1], "red", width=1)
    one.bars([5], [-0.5], [0.5], "red")
    one.bars_across([0.5], [2], [3], "red")
    one.marks([5], [0], "red", size=3, diamond=True)
    assert paths(one) == [
        "M0.0 50.0L100.0 25.0L200.0 100.0",
        "M100.0 75.0V25.0",
        "M40.0 25.0H60.0",
        "M100.0 47.0L103.0 50.0L100.0 53.0L97.0 50.0z",
    ]


def test_what_is_missing_or_outside_is_not_drawn() -> None:
    one = panel()
    one.line([0, 1, 2, 3, 4], [0, 0, NONE, 0, 0], "red", width=1)
    one.dots([1, 2, 3], [0.0, 5.0, NONE], size=1, opacity=0.5)
    one.marks([1, 2], [NONE, 0], "red", size=1, diamond=False)
    assert paths(one) == ["M0.0 50.0L20.0 50.0M60.0 50.0L80.0 50.0", "M20 50.0h0", "M40.0 50.0h0"]


def test_numbers_stand_beside_the_frame() -> None:
    one = panel().scales([(0, "0"), (10, "10")], [(-1, "\N{MINUS SIGN}1"), (1, "1")])
    words = {
        (text.text, float(text.get("x")), float(text.get("y")))
        for text in ET.fromstring(str(one.svg("x"))).iter("text")
    }
    assert words == {
        ("0", 40.0, 130.0),
        ("10", 240.0, 130.0),
        ("\N{MINUS SIGN}1", 35.0, 119.2),
        ("1", 35.0, 19.2),
    }
    found = re.findall(r">([^<]+)</text>", str(panel().scales([]).svg("x")))
    assert found == ["\N{MINUS SIGN}1", "0", "1"]


def test_a_name_is_escaped() -> None:
    one = panel()
    one.words(0, 0, "<script>&")
    drawn = str(one.svg('"<b>'))
    assert "<script>" not in drawn and "<b>" not in drawn
    root = ET.fromstring(drawn)
    assert root.get("aria-label") == '"<b>' and next(root.iter("text")).text == "<script>&"


def test_an_aircraft_is_drawn_as_it_was_fitted() -> None:
    headings, fits = factories.headings(reports=2000), factories.fits()
    both = [shown_of(headings, fits, name, "ruc") for name in ("N402", "N406")]
    small, refused = (ET.fromstring(str(p)) for p in small_panels(both, "ruc"))
    assert "N402: heading error" in small.get("aria-label")
    assert 'stroke-dasharray="6 4"' in ET.tostring(refused, "unicode")  # not to be trusted
    shown = str(large_panel(both[0], fits, "ruc"))
    one = ET.fromstring(re.search(r"<svg viewBox.*</svg>", shown).group())
    dots, curve = (
        next(p.get("d") for p in one.iter("path") if p.get(key) == value)
        for key, value in (("stroke-linecap", "round"), ("stroke-width", "2.8"))
    )
    assert 100 < dots.count("h0") <= DRAWN
    places = np.array(re.findall(r"([\d.]+) ([\d.-]+)", curve), float)
    assert places.shape == (91, 2)
    fit = fits.sel(aircraft="N402", reference="ruc")["deviation"].to_numpy()
    level = next(p.get("d") for p in one.iter("path") if p.get("stroke-width") == "0.9")
    zero = float(level.split()[1].split("L")[0])
    errors = factories.curve(fit, np.linspace(0, 360, 91))
    scale = np.polyfit(errors, places[:, 1], 1)
    assert scale[1] == pytest.approx(zero, abs=0.1)
    assert np.abs(np.polyval(scale, errors) - places[:, 1]).max() < 0.1


def test_profiles_of_one_row_share_a_scale_that_holds_every_phase() -> None:
    profiles = factories.profiles()
    cruise = {"reference": 0, "flight_phase": 2, "state": 0}
    profiles["northward_rms"][cruise] += 9.0
    shown = str(profile_panels(profiles, "ruc"))
    panels = [ET.fromstring(part) for part in re.findall(r"<svg viewBox.*?</svg>.*?</svg>", shown)]
    assert len(panels) == 3 * 3  # nothing was reported in the first of four phases
    for panel in panels[3:6]:
        frame = panel.find("svg")
        lines = [p.get("d") for p in frame.iter("path") if p.get("stroke-width") == "1.5"]
        for line, state in zip(lines, ("reported", "corrected"), strict=True):
            x, y = np.array(re.findall(r"([\d.]+) ([\d.]+)", line), float).T
            phase = panel.get("aria-label").split(" in ")[1].split(",")[0]
            one = profiles["northward_rms"].sel(reference="ruc", flight_phase=phase, state=state)
            assert x.size == 8 and (np.diff(y) < 0).all() and x.max() < float(frame.get("width"))
            assert x / x[0] == pytest.approx(one.to_numpy() / float(one[0]), abs=0.01)
    assert "orange discs" in shown
