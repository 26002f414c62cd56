"""Shares of energy by hand, and the reasons given."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from airswing.gap.design.candidates import Candidate
from airswing.gap.effects import CATALOGUE
from airswing.gap.search.testability import absorbed, surviving_share, too_short

EFFECTS = {"bias": SimpleNamespace(column_names=("all", "above_500"))}


def sums(whole, left):
    grams = np.zeros((2, 3, 2, 2))
    grams[:] = np.diag(whole) / 6
    stats = SimpleNamespace(week_gram=grams)
    return SimpleNamespace(stats=stats), SimpleNamespace(fleet_gram=np.diag(left))


def candidate(*columns):
    return Candidate(
        "bias",
        np.array(columns),
        "fleet",
        np.array([1.0, 2.0])[list(columns)],
        True,
        subset=columns,
    )


def test_share_is_the_energy_left_by_prior_scales():
    base, bare = sums([30.0, 10.0], [3.0, 6.0])
    assert surviving_share(base, bare, candidate(0)) == pytest.approx(0.1)
    assert surviving_share(base, bare, candidate(0, 1)) == pytest.approx((3 + 4 * 6) / (30 + 40))


def test_only_the_forms_that_are_absorbed_are_named():
    base, bare = sums([30.0, 10.0], [3.0, 6.0])
    reason = absorbed(base, bare, [candidate(0), candidate(1)], EFFECTS)["bias"]
    assert reason.startswith("in part (all): at least 90 %")
    reason = absorbed(*sums([30.0, 10.0], [30.0, 0.6]), [candidate(0), candidate(1)], EFFECTS)
    assert reason["bias"].startswith("in part (above 500 hPa): ")
    base, bare = sums([30.0, 10.0], [3.0, 1.0])
    assert absorbed(base, bare, [candidate(0), candidate(1)], EFFECTS)["bias"].startswith(
        "at least 90 %"
    )


def test_an_effect_that_acts_nowhere_or_survives_gives_no_reason():
    base, bare = sums([0.0, 10.0], [0.0, 9.0])
    assert np.isnan(surviving_share(base, bare, candidate(0)))
    assert absorbed(base, bare, [candidate(0), candidate(1)], EFFECTS) == {}


def test_one_day_tells_nothing_of_what_all_aircraft_share():
    days = SimpleNamespace(calendar_day=np.array([7]), day_count=np.array([[900.0], [600.0]]))
    base = SimpleNamespace(stats=days)
    assert set(too_short(base, EFFECTS)) == {"bias"}
    days.calendar_day, days.day_count = np.array([7, 7, 8]), np.array([[30.0, 800.0, 100.0]])
    assert set(too_short(base, EFFECTS)) == {"bias"}  # flights past midnight
    names = "tas_scale", "compass_step", "compass_drift"
    several = {name: CATALOGUE[name] for name in names}
    assert set(too_short(base, several)) == {"compass_step", "compass_drift"}
    days.calendar_day, days.day_count = np.array([7, 8]), np.array([[900.0, 0.0], [0.0, 600.0]])
    assert too_short(base, EFFECTS) == {}
