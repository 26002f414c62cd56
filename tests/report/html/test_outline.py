"""The shipped outline and the view: known coasts where they are, the antimeridian whole."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.report.html import outline, outline_build


def distance_to(layer: str, longitude: float, latitude: float) -> float:
    """Degrees from a place to the nearest stored point of a layer."""
    points = np.concatenate(outline.lines()[layer])
    return float(np.hypot(*(points - [longitude, latitude]).T).min())


@pytest.mark.parametrize(
    ("layer", "longitude", "latitude"),
    [
        ("coast", -0.1, 5.6),  # Accra, on the Gulf of Guinea
        ("coast", 18.4, -34.3),  # Cape of Good Hope
        ("coast", -80.1, 25.8),  # Miami
        ("lake", -87.6, 41.9),  # Chicago, on Lake Michigan
        ("state", -90.6, 41.5),  # the Mississippi between Iowa and Illinois
        ("border", -122.8, 49.0),  # the 49th parallel on the Pacific
    ],
)
def test_lines_pass_where_the_earth_has_them(layer: str, longitude: float, latitude: float) -> None:
    assert distance_to(layer, longitude, latitude) < 0.4


def test_no_coast_in_the_middle_of_a_continent() -> None:
    assert distance_to("coast", -98.0, 40.0) > 5.0


def test_the_shipped_file_is_small() -> None:
    stored = files("airswing.report.html").joinpath("data/outline.npz")
    assert len(stored.read_bytes()) < 400_000


def test_view_across_the_antimeridian_is_narrow() -> None:
    view = outline.view_of([175.0, 179.0, -178.0, -175.0], [50.0, 52.0, 53.0, 51.0])
    assert view.east - view.west < 20
    shifted = view.unwrapped([179.0, -179.0])
    assert shifted[1] - shifted[0] == pytest.approx(2.0)


def test_lines_are_split_at_the_seam_of_the_view() -> None:
    view = outline.View(100.0, 260.0, -60.0, 60.0)
    for part in outline.lines_in(view, "coast"):
        assert np.abs(np.diff(part[:, 0])).max() < 180


@given(
    st.lists(st.floats(-180, 179.9), min_size=1, max_size=8),
    st.floats(-80, 80),
    st.floats(0, 8),
)
def test_every_point_lies_in_its_view(longitude: list[float], south: float, height: float) -> None:
    latitude = np.linspace(south, min(south + height, 90), len(longitude))
    view = outline.view_of(longitude, latitude)
    x = view.unwrapped(longitude)
    assert np.all((x >= view.west - 0.1) & (x <= view.east + 0.1))
    assert np.all((latitude >= view.south - 1e-9) & (latitude <= view.north + 1e-9))
    assert view.east - view.west <= 360.0


@pytest.mark.parametrize(
    ("longitude", "middle"), [([10.0, 20.0], 15.0), ([170.0, -170.0], -180.0), ([], 0.0)]
)
def test_middle_longitude(longitude: list[float], middle: float) -> None:
    assert outline.middle_longitude(longitude) == pytest.approx(middle)


def test_no_place_at_all_gives_the_world() -> None:
    view = outline.view_of([np.nan], [np.nan])
    assert (view.west, view.east, view.south, view.north) == (-180, 180, -90, 90)


def test_thinning_keeps_ends_and_stays_within_tolerance() -> None:
    x = np.linspace(0, 6, 200)
    line = np.column_stack([x, np.sin(x)])
    kept = outline_build.thinned(line, 0.05)
    assert 5 < len(kept) < 60
    assert np.array_equal(kept[[0, -1]], line[[0, -1]])
    assert np.abs(np.interp(x, kept[:, 0], kept[:, 1]) - line[:, 1]).max() < 0.06


def test_a_border_is_what_two_countries_share(tmp_path: Path) -> None:
    transform = {"scale": [0.5, 0.5], "translate": [-88.0, 44.0]}
    arcs = [[[0, 0], [0, 4]], [[0, 4], [4, 0], [0, -4], [-4, 0]], [[0, 0], [-4, 0], [0, 4], [4, 0]]]
    shapes = {"geometries": [{"arcs": [[0, 1]]}, {"arcs": [[-1, 2]]}]}
    for name, kind in (("world", "countries"), ("states", "states")):
        topology = {"transform": transform, "arcs": arcs, "objects": {kind: shapes}}
        (tmp_path / name).write_text(json.dumps(topology))
    outline_build.build(tmp_path / "world", tmp_path / "states", tmp_path / "made.npz")
    with np.load(tmp_path / "made.npz") as made:
        shared = [[-8800, 4400], [-8800, 4600]]
        assert made["border_points"].tolist() == shared
        assert made["state_points"].tolist() == shared
        assert made["coast_lengths"].tolist() == [4, 4]
        # The states' outer arcs lie at 44 to 46 N, 86 to 90 W: shores of the Great Lakes.
        assert made["lake_lengths"].tolist() == [4, 4]
