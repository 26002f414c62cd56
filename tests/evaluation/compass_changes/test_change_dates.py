"""Changes found in made fleets whose curves and routes are not those the fit has in mind."""

from __future__ import annotations

import numpy as np
from tests.evaluation.daily_fleets import World, daily_sums

from airswing.evaluation.compass_changes.change_dates import changes_of
from airswing.evaluation.compass_changes.change_kernels import DaySums


def test_routes_that_turn_are_no_change_of_a_compass_with_higher_harmonics():
    """Other routes every 60 days; third to fifth harmonics; one compass steps 2 degrees."""
    aircraft, days = 12, 240
    change = np.zeros((aircraft, days, 5))
    change[4, 130:, 1] = 2.0 * np.sqrt(2.0)
    world = World(wrong_curve=0.6)
    rows = daily_sums(world, aircraft=aircraft, days=days, seed=6, change=change, by_flight=False)
    sums = [DaySums(*(part[rows[0] == k] for part in rows[1:5])) for k in range(aircraft)]
    found = changes_of([str(k) for k in range(aircraft)], sums, draws=199)
    assert [len(one["changes"]) for one in found] == [int(k == 4) for k in range(aircraft)]
    told = found[4]["changes"][0]
    first, last = np.array(told["date_ci"], dtype="M8[D]").astype(int)
    assert first <= 130 <= last and last - first <= 6
    assert abs(told["change_deg"]["B"] - 2.0 * np.sqrt(2.0)) < 0.5
