"""Reports of a simulation made elsewhere are matched by aircraft, time and place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap import frames

from airswing.errors import InputError
from airswing.gap.simulation.other_simulation import (
    match_reports,
    same_paths,
    with_simulated_wind,
)


def simulation(**changes):
    """The archive's own paths as reports, every wind one m/s stronger to the east."""
    ds = frames.headings_dataset()
    return ds.assign(eastward_wind=ds.eastward_wind + 1.0, **changes)


def test_the_same_paths_match_report_by_report():
    frame = frames.frame()
    matched = match_reports(frame, simulation())
    assert matched.found.all() and same_paths(matched)
    assert matched.u == pytest.approx(frame.u_rep + 1.0)
    against = with_simulated_wind(frame, matched)
    assert against.residual[:, 0] == pytest.approx(np.full(frame.size, -1.0))


def test_times_cut_to_the_minute_still_match_and_the_report_is_the_right_one():
    ds = simulation()
    minutes = ds.time.values.astype("datetime64[m]").astype("datetime64[ns]")
    frame = frames.frame()
    matched = match_reports(frame, ds.assign(time=("report", minutes)))
    assert matched.found.all()
    assert matched.u == pytest.approx(frame.u_rep + 1.0)


def test_other_places_times_and_aircraft_do_not_match():
    frame = frames.frame()
    ds = simulation()
    moved = match_reports(frame, ds.assign(latitude=ds.latitude + 0.1))
    later = match_reports(frame, ds.assign(time=ds.time + np.timedelta64(61, "s")))
    renamed = match_reports(frame, ds.assign_coords(aircraft=["N901", "N402", "N403"]))
    assert not moved.found.any() and not later.found.any()
    assert (renamed.found == (frame.aircraft != 0)).all()
    with pytest.raises(InputError, match="no simulated report is of an aircraft and time"):
        with_simulated_wind(frame, moved)


def test_few_matches_are_not_the_same_paths_and_the_rest_is_left_out():
    frame = frames.frame()
    ds = simulation()
    u = ds.eastward_wind.values.copy()
    u[: int(0.6 * u.size)] = np.nan
    matched = match_reports(frame, ds.assign(eastward_wind=("report", u)))
    assert not same_paths(matched)
    assert with_simulated_wind(frame, matched).size == matched.found.sum()
    few = replace(frame.take(np.arange(150)))
    assert not same_paths(match_reports(few, ds))  # all match, but of 150 nothing can be said
