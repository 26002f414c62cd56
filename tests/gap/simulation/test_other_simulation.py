"""Reports of another simulation are matched by aircraft, time and position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap import frames

from airswing.errors import InputError
from airswing.gap.simulation.report_table import match_reports, with_simulated_wind


def simulation(**changes):
    """Reports on the paths of the archive, with eastward winds 1 m/s stronger."""
    ds = frames.headings_dataset()
    return ds.assign(eastward_wind=ds.eastward_wind + 1.0, **changes)


def test_the_same_paths_match_report_by_report():
    frame = frames.frame()
    matched = match_reports(frame, simulation())
    assert matched.found.all() and matched.same_paths
    assert matched.u == pytest.approx(frame.u_rep + 1.0)
    against = with_simulated_wind(frame, matched)
    assert against.residual[:, 0] == pytest.approx(np.full(frame.size, -1.0))


def test_times_truncated_to_the_minute_match_the_right_report():
    ds = simulation()
    minutes = ds.time.values.astype("datetime64[m]").astype("datetime64[ns]")
    frame = frames.frame()
    matched = match_reports(frame, ds.assign(time=("report", minutes)))
    assert matched.found.all()
    assert matched.u == pytest.approx(frame.u_rep + 1.0)


def test_other_places_times_and_aircraft_do_not_match():
    frame = frames.frame()
    ds = simulation()
    displaced = match_reports(frame, ds.assign(latitude=ds.latitude + 0.1))
    later = match_reports(frame, ds.assign(time=ds.time + np.timedelta64(61, "s")))
    renamed = match_reports(frame, ds.assign_coords(aircraft=["N901", "N402", "N403"]))
    assert not displaced.found.any() and not later.found.any()
    assert (renamed.found == (frame.aircraft != 0)).all()
    with pytest.raises(InputError, match="no simulated report is of an aircraft and time"):
        with_simulated_wind(frame, displaced)


def test_reports_without_a_match_are_left_out():
    frame = frames.frame()
    ds = simulation()
    u = ds.eastward_wind.values.copy()
    u[: int(0.6 * u.size)] = np.nan
    matched = match_reports(frame, ds.assign(eastward_wind=("report", u)))
    assert not matched.same_paths
    assert with_simulated_wind(frame, matched).size == matched.found.sum()
    few = replace(frame.take(np.arange(150)))
    assert not match_reports(few, ds).same_paths  # all match, but 150 are too few
