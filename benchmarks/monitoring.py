"""False alarms and false changes of compasses that did not change, and the power to detect changes.

    python -m benchmarks.monitoring [--part alarms|noticed|changes] [--years 300] [--fleets 100]

Simulated fleets as sums of days. Exit status 1 where a quiet world has more than one alarm in 100
aircraft-years, or more than one fleet in 50 a false change, beyond chance; where fewer than 90 % of
the changes of 2 degrees are noticed within 3 days of 40 reports; or where an interval contains the
truth in less than 90 %.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np
from scipy.stats import binom, chi2
from tests.evaluation.daily_fleets import World, daily_sums, watched

from airswing.evaluation.monitoring.events import first_days_and_silences
from airswing.evaluation.monitoring.fleet_watch import WIND, watch_fleet

USUAL = World()
WORLDS = {
    "usual": USUAL,
    "heavy tails, errors that last": replace(
        USUAL, tails=3, persistence=0.7, region_error=1.0, flight_error=1.8
    ),
    "normal errors": replace(USUAL, tails=0, fleet_error=1.0),
    "jets, 10 reports a day": replace(USUAL, reports=10, flights=2, airspeed=230.0, tails=4),
    "half of the days": replace(USUAL, days_off=0.5, reports=20, wrong_curve=0.6, season=0.3),
    "routes turn with the weather": replace(
        USUAL, weather_routes=0.8, region_error=1.0, persistence=0.8, wrong_curve=0.6
    ),
}
SHAPES = ("offset", "one cycle", "A to E")
NOTICED = (1, 2, 3, 5)


def alarms(options):
    aircraft, days = 100, 365
    fleets = max(round(options.years * 365 / (aircraft * days)), 1)
    years, good = fleets * aircraft * days / 365.0, True
    print(f"false alarms in 100 aircraft-years ({years:.0f} aircraft-years of each world)")
    print(f"{'world':32}  compass  fleet  wind  silent   all (95 % interval)")
    for k, (name, world) in enumerate(WORLDS.items()):
        counts = np.zeros(4)
        for fleet in range(fleets):
            of_fleet = {"aircraft": aircraft, "days": days, "seed": options.seed + 1000 * k + fleet}
            compass = watched(world, **of_fleet).tested
            of, day, *_, number, logarithm = daily_sums(world, **of_fleet)
            wind = watch_fleet(of, day, number[:, None, None], logarithm[:, None], WIND, aircraft)
            order = np.lexsort((day, of))
            silent = first_days_and_silences(of[order], day[order], aircraft, days - 1)[1]
            counts += [
                sum(alarm.number >= 0 for alarm in compass.alarms),
                sum(alarm.number < 0 for alarm in [*compass.alarms, *wind.alarms]),
                sum(alarm.number >= 0 and alarm.change[0] > 0 for alarm in wind.alarms),
                len(silent),
            ]
        total, rate = counts.sum(), 100.0 * counts / years
        low, high = chi2.ppf([0.025, 0.975], [2 * total, 2 * total + 2]) / 2 * 100.0 / years
        low = np.nan_to_num(low)
        print(
            f"{name:32}  {rate[0]:7.2f}  {rate[1]:5.2f}  {rate[2]:4.2f}  {rate[3]:6.2f}   "
            f"{rate.sum():.2f} ({low:.2f} to {high:.2f})",
            flush=True,
        )
        good &= bool(low <= 1.0)
    return good


def unit_change(shape, rng):
    """A change of A to E of 1 degree rms over all headings."""
    change = rng.normal(size=5) * [1.0, 1.0, 1.0, 0.5, 0.5]
    if shape == "offset":
        change[1:] = 0.0
    elif shape == "one cycle":
        change[[0, 3, 4]] = 0.0
    return change / np.sqrt(change[0] ** 2 + (change[1:] ** 2).sum() / 2.0)


def changed(aircraft, days, size, shape, rng, margin):
    """Changes (aircraft, day, 5) of every fifth aircraft, degrees, and their days."""
    change, when = np.zeros((aircraft, days, 5)), {}
    for k in range(0, aircraft, 5):
        when[k] = int(rng.integers(35, days - margin))
        change[k, when[k] :] = size * unit_change(shape, rng)
    return change, when


def noticed(options):
    number, days, fleets, good = 50, 75, max(options.fleets // 16, 1), True
    print(f"share noticed within so many days with reports ({10 * fleets} changes a line)")
    print("degrees rms  reports a day  shape       " + "".join(f"{k:>6}" for k in NOTICED))
    for reports in (10, 40):
        world = replace(USUAL, days_off=0.0, reports=reports, flights=2 if reports < 20 else 4)
        for size in (1.0, 2.0, 4.0):
            for k, shape in enumerate(SHAPES):
                late = []
                for fleet in range(options.seed + 77 * k, options.seed + 77 * k + fleets):
                    rng = np.random.default_rng([fleet])
                    change, when = changed(number, days, size, shape, rng, margin=15)
                    first = {}
                    watch = watched(world, aircraft=number, days=days, seed=fleet, change=change)
                    for alarm in watch.tested.alarms:
                        if alarm.night >= when.get(alarm.number, days):
                            first.setdefault(alarm.number, alarm.night)
                    late += [first.get(k, day + 98) - day + 1 for k, day in when.items()]
                shares = [(np.array(late) <= limit).mean() for limit in NOTICED]
                line = "".join(f"{100 * share:5.0f}%" for share in shares)
                print(f"{size:11.0f}  {reports:13}  {shape:10}  {line}", flush=True)
                good &= size != 2.0 or reports != 40 or shares[2] >= 0.9
    return good


def changes(options):
    good = True
    print("fleets of 20 aircraft without a change that get one")
    for days, fleets in ((45, options.fleets), (180, max(options.fleets // 5, 1))):
        for k, (name, world) in enumerate(WORLDS.items()):
            false = 0
            for fleet in range(fleets):
                seed = options.seed + 5000 + 1000 * k + fleet
                watch = watched(world, aircraft=20, days=days, seed=seed)
                false += any(entry["changes"] for entry in watch.changes)
            print(f"  {days:3} days, {name:32} {false} of {fleets}", flush=True)
            good &= bool(false <= binom.ppf(0.99, fleets, 0.02))
    fleets = max(options.fleets // 20, 1)
    print(f"changes stated within 5 days, and intervals that contain the truth ({4 * fleets} each)")
    for name in ("usual", "routes turn with the weather"):
        for size in (1.0, 2.0):
            for shape in SHAPES:
                stated, dated, sized, tried, false = 0, 0, [], 0, 0
                for fleet in range(fleets):
                    rng = np.random.default_rng([options.seed, fleet])
                    change, when = changed(20, 180, size, shape, rng, margin=35)
                    of_fleet = {"aircraft": 20, "days": 180, "seed": options.seed + fleet}
                    watch = watched(WORLDS[name], **of_fleet, change=change)
                    for k, entry in enumerate(watch.changes):
                        tried += k in when
                        for stated_change in entry["changes"]:
                            low, high = stated_change["date_ci"]
                            dates = np.array([low, stated_change["date"], high], "M8[D]")
                            low, day, high = dates.astype(int)
                            if abs(day - when.get(k, -99)) > 5:
                                false += 1
                                continue
                            stated += 1
                            dated += low <= when[k] <= high
                            sized += [
                                abs(stated_change["change_deg"][c] - value) < 1.96 * error
                                for c, value, error in zip(
                                    "ABCDE",
                                    change[k, -1],
                                    stated_change["standard_error_deg"].values(),
                                    strict=True,
                                )
                            ]
                inside = [dated / max(stated, 1), np.mean(sized or [1.0])]
                print(
                    f"  {size:.0f} degree {shape:10} {name:32} {100 * stated / tried:4.0f} %, "
                    f"dates "
                    f"{100 * inside[0]:3.0f} %, sizes {100 * inside[1]:3.0f} %; elsewhere {false}",
                    flush=True,
                )
                good &= stated < 20 or min(inside) >= 0.9
                good &= size < 2.0 or stated >= 0.9 * tried
    return good


PARTS = {"alarms": alarms, "noticed": noticed, "changes": changes}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--part", action="append", choices=list(PARTS))
    parser.add_argument("--years", type=int, default=300, help="aircraft-years of every world")
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=60000)
    options = parser.parse_args()
    return 0 if all([PARTS[name](options) for name in options.part or PARTS]) else 1


if __name__ == "__main__":
    sys.exit(main())
