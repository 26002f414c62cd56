"""Aircraft order to time order and back: every value comes back to its report."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from airswing.reference.places import Places, stretches


def fleet(hours: list[int]) -> xr.Dataset:
    time = np.array(hours, dtype="M8[h]").astype("M8[ns]") + np.timedelta64(90, "s")
    number = np.arange(time.size, dtype=float)
    return xr.Dataset(
        {
            "time": ("report", time),
            "latitude": ("report", number),
            "longitude": ("report", -number),
            "pressure": ("report", (1e4 + number).astype("f4")),
        }
    )


def test_stretches_end_with_months_and_hold_so_many_reports():
    first = int(np.datetime64("2009-01-31T20", "h").astype(int))
    counts = {first + k: 3 for k in range(6)}
    assert stretches(counts, 7).tolist() == [first, first + 2, first + 4]
    assert stretches(counts, 100).tolist() == [first, first + 4]
    assert stretches(counts, 1).tolist() == [first + k for k in range(6)]
    # what is added later moves no earlier stretch
    more = counts | {first + 6 + k: 50 for k in range(5)}
    assert stretches(more, 7).tolist()[:3] == [first, first + 2, first + 4]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    hours=st.lists(st.integers(342000, 342800), min_size=1, max_size=40),
    cuts=st.lists(st.integers(0, 40), max_size=3),
    limit=st.integers(1, 50),
)
def test_winds_come_back_to_their_reports(tmp_path_factory, hours, cuts, limit):
    reports = fleet(hours)
    bounds = [0, *sorted(min(cut, len(hours)) for cut in cuts), len(hours)]
    parts = [reports.isel(report=slice(start, stop)) for start, stop in itertools.pairwise(bounds)]
    known, count = np.unique(hours, return_counts=True)
    starts = stretches(dict(zip(known.tolist(), count.tolist(), strict=True)), limit)
    places = Places(tmp_path_factory.mktemp("places"), starts)
    for part in parts:
        places.add(part)
    seen = 0
    for number in range(len(places)):
        some = places.reports(number)
        seen += some.sizes["report"]
        place = some["latitude"].to_numpy()
        winds = xr.Dataset(
            {
                "reference_eastward_wind": (("reference", "report"), [place, place + 0.5]),
                "lead_time": (("reference", "report"), [-place, place * 2]),
            },
            coords={"reference": np.array(["a", "b"], dtype=object)},
        )
        places.put(number, winds)
    assert seen == len(hours)
    for number, part in enumerate(parts):
        found = places.winds(number, part)
        wanted = part["latitude"].to_numpy()
        np.testing.assert_array_equal(found["reference_eastward_wind"][1], wanted + 0.5)
        np.testing.assert_array_equal(found["lead_time"][0], -wanted)
        assert found["reference"].to_numpy().tolist() == ["a", "b"]


def test_needs_of_parts_add_up_to_the_plan_of_the_whole(tmp_path, root):
    from airswing.reference import planning
    from airswing.reference.grib.catalogue import build_catalogue
    from airswing.reports import read_reports

    reports = read_reports(str(root / "data_samples/reports/*.csv"))
    model = build_catalogue([str(root / "data_samples/ruc/*.grb")], name="ruc")
    whole = planning.plan(reports, {"ruc": model})["ruc"]
    cut = np.arange(reports.sizes["report"]) % 3
    needs = [
        planning.Need.of(
            planning.points_of(reports.isel(report=np.flatnonzero(cut == k))),
            model,
            max_time_gap=10800.0,
            derivatives=False,
        )
        for k in range(3)
    ]
    assert (needs[0] + needs[1] + needs[2]).plan("ruc", model, sparse=True) == whole


def test_an_empty_block_is_no_harm(tmp_path):
    places = Places(tmp_path, np.array([342000]))
    places.add(fleet([]))
    places.add(fleet([342001]))
    assert places.reports(0).sizes["report"] == 1
    with pytest.raises(IndexError):
        places.winds(5, fleet([]))
