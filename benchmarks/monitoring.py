"""How often does the watch alarm for nothing, and how soon does it notice a compass that changed?

    python -m benchmarks.monitoring [--years 300] [--fleets 6]

Made fleets as sums of days (tests/evaluation/daily_fleets.py), with the default seed none of them
one that the test was chosen on (33000 to 54002 and 70000 to 75002; changes of 20000, 31000, 50000
and 80000 to 97201).
Printed: false alarms of every kind in 100 aircraft-years, with the 95 % Poisson interval of all
together; the share of changes noticed by the 1st, 2nd, 3rd and 5th day with reports after it, by
rms size over all headings and reports a day.
Exit status 1 where a quiet world has more than one alarm in 100 aircraft-years beyond chance, or
fewer than 90 % of the changes of 2 degrees of a shape are noticed within 3 days of 40 reports.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.evaluation.daily_fleets import World, daily_sums

from airswing.evaluation.monitoring.fleet_watch import (
    COMPASS,
    COMPASS_COMMON,
    COMPASS_NOISE,
    WIND,
    WIND_COMMON,
    WIND_NOISE,
    watch_fleet,
)
from airswing.evaluation.monitoring.presence import first_and_silent_days

USUAL = World()
QUIET = {
    "usual": USUAL,
    "heavy tails, errors that last": replace(
        USUAL, tails=3, persistence=0.7, region_error=1.0, flight_error=1.8
    ),
    "normal errors": replace(USUAL, tails=0, fleet_error=1.0),
    "jets, 10 reports a day": replace(USUAL, reports=10, flights=2, airspeed=230.0, tails=4),
    "half of the days": replace(USUAL, days_off=0.5, reports=20, wrong_curve=0.6, season=0.3),
}
AIRCRAFT, DAYS = 100, 365
SHAPES = ("offset", "one cycle", "A to E")
NOTICED = (1, 2, 3, 5)


def wind_rows(rows):
    """Rows of the disagreement."""
    return rows[0], rows[1], rows[4][:, np.newaxis, np.newaxis], rows[5][:, np.newaxis]


def turned(rows, number):
    """Alarms of the compasses."""
    return watch_fleet(rows[:4], COMPASS, usual=COMPASS_NOISE, common=COMPASS_COMMON, number=number)


def false_alarms(world: World, years: int, seed: int) -> np.ndarray:
    """Alarms of compasses, of all at once, of disagreements and of silences."""
    found = np.zeros(4)
    for fleet in range(max(round(years * 365 / (AIRCRAFT * DAYS)), 1)):
        rows = daily_sums(world, aircraft=AIRCRAFT, days=DAYS, seed=seed + fleet)
        wind = watch_fleet(
            wind_rows(rows), WIND, usual=WIND_NOISE, common=WIND_COMMON, number=AIRCRAFT
        )
        alarms = turned(rows, AIRCRAFT)
        order = np.lexsort((rows[1], rows[0]))
        silent = first_and_silent_days(rows[0][order], rows[1][order], AIRCRAFT, DAYS - 1)[1]
        all_at_once = [one for one in [*alarms, *wind] if one.step.number < 0]
        rose = [one for one in wind if one.step.number >= 0 and one.step.size[0] > 0]
        own = [one for one in alarms if one.step.number >= 0]
        found += [len(own), len(all_at_once), len(rose), len(silent)]
    return found


def noticed(world: World, size: float, shape: str, *, fleets: int, seed: int) -> np.ndarray:
    """Days with reports until each change was noticed, 99 for never; every fifth aircraft's."""
    number, days, found = 50, 75, []
    for fleet in range(fleets):
        rng = np.random.default_rng([seed, fleet])
        change, when = np.zeros((number, days, 5)), {}
        for k in range(0, number, 5):
            when[k] = int(rng.integers(35, 60))
            change[k, when[k] :] = size * unit_change(shape, rng)
        rows = daily_sums(world, aircraft=number, days=days, seed=seed + fleet, change=change)
        first: dict[int, int] = {}
        for one in turned(rows, number):
            if one.night >= when.get(one.step.number, days):
                first.setdefault(one.step.number, one.night)
        found += [first.get(k, day + 98) - day + 1 for k, day in when.items()]
    return np.array(found)


def unit_change(shape: str, rng: np.random.Generator) -> np.ndarray:
    """A change of A to E of 1 degree rms over all headings."""
    found = rng.normal(size=5) * [1.0, 1.0, 1.0, 0.5, 0.5]
    if shape == "offset":
        found[1:] = 0.0
    elif shape == "one cycle":
        found[[0, 3, 4]] = 0.0
    return found / np.sqrt(found[0] ** 2 + (found[1:] ** 2).sum() / 2.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--years", type=int, default=300, help="aircraft-years of every world")
    parser.add_argument("--fleets", type=int, default=6, help="of ten changes each, a cell")
    parser.add_argument("--seed", type=int, default=60000)
    given = parser.parse_args()
    missed = False
    print(f"false alarms in 100 aircraft-years ({given.years} aircraft-years of each world)")
    print(f"{'world':32}  compass  all at once  wind  silent   all (95 % interval)")
    for k, (name, world) in enumerate(QUIET.items()):
        counts = false_alarms(world, given.years, given.seed + 1000 * k)
        years = max(round(given.years * 365 / (AIRCRAFT * DAYS)), 1) * AIRCRAFT * DAYS / 365.0
        total, each = counts.sum(), 100.0 * counts / years
        low, high = chi2.ppf([0.025, 0.975], [2 * total, 2 * total + 2]) / 2 * 100.0 / years
        low = np.nan_to_num(low)
        print(
            f"{name:32}  {each[0]:7.2f}  {each[1]:11.2f}  {each[2]:4.2f}  {each[3]:6.2f}   "
            f"{each.sum():.2f} ({low:.2f} to {high:.2f})",
            flush=True,
        )
        missed |= bool(low > 1.0)
    print(f"\nshare noticed within so many days with reports ({10 * given.fleets} changes a cell)")
    print("degrees rms  reports a day  shape       " + "".join(f"{k:>6}" for k in NOTICED))
    for reports in (10, 40):
        world = replace(USUAL, days_off=0.0, reports=reports, flights=2 if reports < 20 else 4)
        for size in (1.0, 2.0, 4.0):
            shares = []
            for k, shape in enumerate(SHAPES):
                late = noticed(world, size, shape, fleets=given.fleets, seed=given.seed + 77 * k)
                shares.append([(late <= limit).mean() for limit in NOTICED])
                told = "".join(f"{100 * share:5.0f}%" for share in shares[-1])
                print(f"{size:11.0f}  {reports:13}  {shape:10}  {told}", flush=True)
            missed |= bool(size == 2.0 and reports == 40 and np.min(shares, axis=0)[2] < 0.9)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
