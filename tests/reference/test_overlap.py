"""A reference that serves no report is refused, and the message says what would mend it."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.reference.collocate import overlap, require_overlap
from tests.reference.test_collocate import hourly, reports


@pytest.mark.parametrize(
    ("ds", "said"),
    [
        (reports([50.0]), r"no overlap in time.*2009-08-03T02:00Z.*2009-08-01T00:00Z"),
        (reports([1.0], latitude=-20.0), r"no overlap in space.*-20.*latitude 40 to 60"),
        (reports([1.0], pressure=101000.0), "no report lies between the model's levels"),
    ],
)
def test_no_overlap_is_told_with_both_spans(ds: xr.Dataset, said: str, tmp_path: Path) -> None:
    catalogue = hourly(tmp_path)
    with pytest.raises(InputError, match=said):
        require_overlap(overlap(ds, {"m": catalogue}))


@pytest.mark.parametrize(
    ("hours", "levels", "said"),
    [
        ((1,), (300, 700), "single valid time"),
        ((0, 6), (300, 700), "no report lies between two model times.*max_time_gap"),
        ((0, 3), (500,), r"between the model's levels.*\(500 hPa\).*two are needed"),
        ((0, 3), (300, 400), r"between the model's levels.*\(300 to 400 hPa\).*unit"),
    ],
)
def test_what_is_too_little_is_said(hours: tuple, levels: tuple, said: str, tmp_path: Path) -> None:
    catalogue = hourly(tmp_path, hours, levels=levels)
    with pytest.raises(InputError, match=said):
        require_overlap(overlap(reports([0.5, 2.5], pressure=45000.0), {"m": catalogue}))
