"""Maps: the outline passes where the earth has coasts, every point lies in its view, thinning."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from airswing.products import ragged
from airswing.report.html import maps
from tests.report.pages import Drawn


@pytest.mark.parametrize(
    ("layer", "longitude", "latitude"),
    [
        ("coast", -0.1, 5.6),  # Accra, on the Gulf of Guinea
        ("coast", 18.4, -34.3),  # Cape of Good Hope
        ("lake", -87.6, 41.9),  # Chicago, on Lake Michigan
        ("state", -90.6, 41.5),  # the Mississippi between Iowa and Illinois
        ("border", -122.8, 49.0),  # the 49th parallel on the Pacific
    ],
)
def test_lines_pass_where_the_earth_has_them(layer, longitude, latitude):
    points = np.concatenate(maps.lines()[layer])
    assert np.hypot(*(points - [longitude, latitude]).T).min() < 0.4


def test_views_across_the_antimeridian_are_narrow_and_lines_split_at_the_seam():
    view = maps.view_of([175.0, 179.0, -178.0, -175.0], [50.0, 52.0, 53.0, 51.0])
    assert view.east - view.west < 20
    assert np.diff(view.unwrapped([179.0, -179.0])) == pytest.approx(2.0)
    for part in maps.lines_in(maps.View(100.0, 260.0, -60.0, 60.0), "coast"):
        assert np.abs(np.diff(part[:, 0])).max() < 180
    world = maps.view_of([np.nan], [np.nan])
    assert (world.west, world.east, world.south, world.north) == (-180, 180, -90, 90)


@given(
    st.lists(st.floats(-180, 179.9), min_size=1, max_size=8), st.floats(-80, 80), st.floats(0, 8)
)
def test_every_point_lies_in_its_view(longitude, south, height):
    latitude = np.linspace(south, min(south + height, 90), len(longitude))
    view = maps.view_of(longitude, latitude)
    x = view.unwrapped(longitude)
    assert np.all((x >= view.west - 0.1) & (x <= view.east + 0.1))
    assert np.all((latitude >= view.south - 1e-9) & (latitude <= view.north + 1e-9))
    assert view.east - view.west <= 360.0


def test_large_archives_are_thinned_evenly_and_counted_in_full(monkeypatch):
    monkeypatch.setattr(ragged, "BLOCK_REPORTS", 70)
    monkeypatch.setattr(maps, "MOST_DRAWN", 100)
    number = np.arange(600)
    archive = xr.Dataset(
        {
            "row_size": ("aircraft", np.full(12, 50)),
            "longitude": ("report", number % 30 - 90.0),
            "latitude": ("report", number % 10 + 40.0),
            "phase": ("report", number % 4),
            "pressure": ("report", 50_000.0 + number),
        }
    )
    show = Drawn()
    maps.places_section(archive, show)
    figure = show.made["map"]
    assert "n = 600 reports of 12 aircraft" in figure.caption
    assert "One report in 6 is drawn." in figure.caption
    drawn = figure.axes[0].collections[0].get_offsets()
    assert np.allclose(np.asarray(drawn)[:, 0], number[::6] % 30 - 90.0)
