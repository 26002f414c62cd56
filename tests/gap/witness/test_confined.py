"""On whom a table is: not on aircraft whose weeks left out show its opposite."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from airswing.gap.archive.value_tables import Axis, Grid
from airswing.gap.witness import fitted_tables
from airswing.gap.witness.fitted_tables import Unknown, confined

GRID = Grid((Axis("longitude", "linear", np.arange(3.0)),))
DAY = np.repeat(np.arange(30), 4)
AIRCRAFT = np.tile(np.arange(4), 30)


def of(component):
    empty = np.zeros((4, 2))
    everyone = (0, 1, 2, 3)
    return Unknown(component, GRID, everyone, True, 50.0, empty, empty[None], (), 1, 1, 1, 0)


@pytest.fixture
def refitted(monkeypatch):
    """What each aircraft's reports say of a table, by place; the groups it is fitted to anew."""
    groups = []

    def values(bench, grid, component, own, fold):
        groups.extend(own)
        return np.ones((4, 2)), np.ones((1, 4, 2)), [np.eye(2)], np.zeros(1)

    monkeypatch.setattr(fitted_tables, "_values", values)
    monkeypatch.setattr(fitted_tables, "field_of", lambda *_: None)
    monkeypatch.setattr(fitted_tables, "sizes", lambda *_: (0.7, 0.9))
    told = np.array([1.0, 0.02, -0.02, -1.0])  # two of them as good as nothing
    noise = 0.3 * (-1.0) ** (DAY // 3)  # blocks of days differ
    monkeypatch.setattr(fitted_tables, "_energy", lambda *_: told[AIRCRAFT] + noise)
    return groups


def bench():
    frame = SimpleNamespace(aircraft=AIRCRAFT, tails=("A", "B", "C", "D"))
    setting = SimpleNamespace(frame=frame, day=DAY)
    return SimpleNamespace(setting=setting, beside_others=lambda *_: False)


def test_an_aircraft_that_shows_the_opposite_has_no_table(refitted):
    found = confined(bench(), of("heading_angle"), np.arange(30) // 7)
    assert found.tails == (0, 1, 2)
    assert refitted == [[0, 1, 2]]
    assert (found.size, found.peak, found.evidence) == (0.7, 0.9, 50.0)


def test_in_the_frame_of_the_wind_it_is_the_weather(refitted):
    whole = of("along_wind")
    assert confined(bench(), whole, np.arange(30) // 7) is whole
    assert not refitted


def test_tables_of_their_own_are_of_aircraft_that_they_explain_something_of(refitted):
    """Also in the frame of the wind: the others were drawn in."""
    for component in ("along_wind", "heading_angle"):
        refitted.clear()
        own = replace(of(component), shared=False)
        assert confined(bench(), own, np.arange(30) // 7).tails == (0, 1)
        assert refitted == [[0], [1]]
