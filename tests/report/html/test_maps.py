"""Reports drawn on the maps: how many of how many, and how much memory that takes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import xarray as xr

from airswing.products import ragged
from airswing.report.html import maps

AIRCRAFT, EACH = 60, 5_000


@pytest.fixture
def archive(monkeypatch: pytest.MonkeyPatch) -> xr.Dataset:
    """Reports numbered by their longitude, in blocks of one aircraft, one in 100 drawn."""
    monkeypatch.setattr(maps, "MOST_DRAWN", AIRCRAFT * EACH // 100)
    monkeypatch.setattr(ragged, "BLOCK_REPORTS", EACH)
    number = np.arange(AIRCRAFT * EACH, dtype=np.float64)
    return xr.Dataset(
        {
            "row_size": ("aircraft", np.full(AIRCRAFT, EACH)),
            "longitude": ("report", number),
            "latitude": ("report", -number),
        }
    )


def _group(block: xr.Dataset) -> np.ndarray:
    """Three in four reports belong to group 0 or 1, the others to none."""
    return np.array([0, 1, 0, -1])[block["longitude"].to_numpy().astype(int) % 4]


def test_one_in_so_many_is_drawn_and_all_are_counted(
    archive: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the blocks' sizes are no multiple of the step."""
    monkeypatch.setattr(maps, "MOST_DRAWN", AIRCRAFT * EACH // 97 + 1)
    found = maps._places(archive, [], _group, 2)
    assert found.every == 97
    np.testing.assert_array_equal(found.longitude, np.arange(0, AIRCRAFT * EACH, 97))
    np.testing.assert_array_equal(found.latitude, -found.longitude)
    np.testing.assert_array_equal(
        found.group, np.array([0, 1, 0, -1])[found.longitude.astype(int) % 4]
    )
    np.testing.assert_array_equal(found.counts, [AIRCRAFT * EACH // 2, AIRCRAFT * EACH // 4])


def test_what_is_not_drawn_is_not_kept(archive: xr.Dataset) -> None:
    """The groups of all reports would be 2.4 MB, of a block 0.04 MB, the drawn 0.07 MB."""
    maps._places(archive, [], _group, 2)
    tracemalloc.start()
    try:
        maps._places(archive, [], _group, 2)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.6e6
