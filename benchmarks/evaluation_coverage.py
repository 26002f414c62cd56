"""Do the evaluation's intervals and tests keep their promises? Over many simulated archives.

    python benchmarks/evaluation_coverage.py --seeds 200
    python benchmarks/evaluation_coverage.py --seeds 40 --part poolable --part changes

Printed, a table each: how often intervals of the adjusted reduction held the truth; how often the
permutation test rejected where nothing was corrected, the group drawn by lot and chosen as the
worst; how often references of equal truth were called poolable, and one with a regional bias of
1 m/s; how far off the dates of a change of 2 degrees were at about 100 reports a day, and how often
a fleet without a change raised an alarm, also one whose curves have higher harmonics while routes
turn; predicted against realised gains. Exit status 1 where a
promise was broken beyond what that many seeds let chance do (three standard deviations).
"""

from __future__ import annotations

import argparse
import sys
from datetime import date
from pathlib import Path

import numpy as np

import airswing  # noqa: F401

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.compass.flown import Setting
from tests.evaluation.archives import (
    LASTING_ERRORS,
    ORIGIN,
    day_number,
    fleet,
    moved,
    persistent_error,
    references,
    with_change,
)
from tests.evaluation.daily_fleets import World, daily_sums
from tests.evaluation.fleets import START, simulate_fleet

from airswing.evaluation.backtest.virtual_field_test import virtual_field_test
from airswing.evaluation.compass_changes.change_dates import changes_of, find_changes
from airswing.evaluation.compass_changes.change_kernels import DaySums
from airswing.evaluation.field_test import field_test
from airswing.evaluation.permutation import permutation_test
from airswing.evaluation.reference_comparison.sensitivity import compare


def told(name: str, hits: int, tries: int, low: float, high: float) -> bool:
    """Print one rate; False where it lies outside its bounds by more than chance."""
    rate = hits / tries
    slack = 3 * np.sqrt(max(low * (1 - low), high * (1 - high), 1e-4) / tries)
    good = low - slack <= rate <= high + slack
    print(
        f"  {name:58s} {100 * rate:6.1f} % of {tries:5d}   promised {100 * low:.0f}-"
        f"{100 * high:.0f} %   {'' if good else 'BROKEN'}"
    )
    return good


def reduction(seeds: int) -> bool:
    print("intervals of the adjusted reduction (11 aircraft, 50 days)")
    linear = square = 0
    for seed in range(seeds):
        made = simulate_fleet(seed, days=(25, 25), corrected=6, controls=5, flights=2, reports=4)
        found = field_test(
            made.headings,
            start=START,
            before_start=date(2009, 7, 20),
            corrected=made.corrected,
            controls=made.controls,
            pools={"rr": ["rr"]},
            reference="rr",
            draws=600,
            seed=seed,
        )
        low, high = found["adjusted_reduction_ci_kt"]
        linear += low <= made.true_adjusted <= high
        before, during = made.true_before, made.true_during
        untreated = np.sqrt(
            before["corrected"] ** 2 + during["controls"] ** 2 - before["controls"] ** 2
        )
        low, high = found["adjusted_reduction_quadrature_ci_kt"]
        square += low <= untreated - during["corrected"] <= high
    return told("linear", linear, seeds, 0.93, 0.97) & told(
        "in quadrature", square, seeds, 0.93, 0.97
    )


def permutation(seeds: int) -> bool:
    print("permutation test at 5 % where nothing was corrected (36 aircraft)")
    good, repeats = True, 10 * seeds
    for name in ("drawn by lot", "chosen as the worst"):
        rng, rejected = np.random.default_rng(5), 0
        for seed in range(repeats):
            level = 7 + rng.normal(0, 0.8, 36)
            before, during = level + rng.normal(0, 0.6, 36), level + 1.2 + rng.normal(0, 0.6, 36)
            corrected = np.zeros(36, dtype=bool)
            order = rng.permutation(36) if name == "drawn by lot" else np.argsort(-before)
            corrected[order[:19]] = True
            rejected += permutation_test(before, during, corrected, draws=399, seed=seed)[1] <= 0.05
        good &= told(name, rejected, repeats, 0.03, 0.07)
    return good


def poolable(seeds: int) -> bool:
    print("references called poolable (8 aircraft, 90 days, errors that last for days)")
    two, good = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}, True
    for name, bias, low, high in (
        ("equal truth", 0.0, 0.95, 1.0),
        ("regional bias of 1 m/s", 1.0, 0.0, 0.05),
    ):
        found = [
            compare(
                references(seed, LASTING_ERRORS, regional={"rtfdaa": bias}), pools=two, joint=False
            )
            for seed in range(seeds)
        ]
        hits = sum(bool(one["pairs"][0]["poolable"]) for one in found)
        good &= told(name, hits, seeds, low, high)
        if bias == 0.0:
            for c in "ABCDE":
                inside = [
                    entry["ci"][c][0] <= 0 <= entry["ci"][c][1]
                    for one in found
                    for entry in one["pairs"][0]["aircraft"]
                ]
                print(
                    f"  interval of the difference of {c} holds nothing: "
                    f"{100 * np.mean(inside):.1f} % of {len(inside)}"
                )
    return good


def changes(seeds: int) -> bool:
    print("a change of 2 degrees of the offset, about 100 reports a day, 60 days")
    setting = Setting(aircraft=3, days=60, flights_a_day=8, day_error=1.2, outliers=0.005)
    step = np.zeros((3, 5))
    step[1, 0] = 2.0
    errors, inside, missed = [], 0, 0
    for seed in range(seeds):
        at = int(np.random.default_rng(seed).integers(10, 50))
        ds = with_change(seed, setting, day=at, change=step)
        found = find_changes(ds, members=["ruc"], draws=199)[1]["changes"]
        if len(found) != 1:
            missed += 1
            continue
        first, low, high = (
            int((np.datetime64(day) - ORIGIN).astype(int))
            for day in (found[0]["date"], *found[0]["date_ci"])
        )
        errors.append(abs(first - at))
        inside += low <= at <= high
    late = np.array(errors)
    print(
        f"  error of the date: median {np.median(late):.0f}, largest {late.max()} days; "
        f"missed or doubled {missed}"
    )
    good = told("dated within 7 days", int((late <= 7).sum()), seeds, 0.95, 1.0)
    good &= told("date inside its interval", inside, late.size, 0.95, 1.0)
    quiet = Setting(aircraft=5, days=60, day_error=0.0, outliers=0.005)
    for persistence in (0.0, 0.5, 0.8):
        alarms = 0
        for seed in range(seeds):
            ds = fleet(seed, quiet, amplitude=4.0)[0]
            own = persistent_error(seed, 60, size=1.5, persistence=persistence)[day_number(ds)]
            ds = moved(ds, "ruc", own[:, 0], own[:, 1])
            entries = find_changes(ds, members=["ruc"], draws=399)
            alarms += any(entry["changes"] for entry in entries)
        name = f"fleets with a false alarm, daily correlation {persistence}"
        good &= told(name, alarms, seeds, 0.0, 0.03)
    return good


def turning(seeds: int) -> bool:
    print(
        "changes in fleets of 20 aircraft and a year, routes that turn every 60 days (sums of days)"
    )
    good, aircraft, days = True, 20, 365
    for wrong in (0.3, 0.6):
        world, alarms, tries, hits = World(wrong_curve=wrong), 0, 0, 0
        for seed in range(seeds):
            rng, change = np.random.default_rng([7, seed]), np.zeros((aircraft, days, 5))
            quiet = _stated(world, change, seed=5000 + seed)
            alarms += any(quiet)
            when = {k: int(rng.integers(60, days - 60)) for k in range(0, aircraft, 5)}
            for k, day in when.items():
                shape = rng.normal(size=3)
                change[k, day:, :3] = (
                    2.0 * shape / np.hypot(shape[0], np.hypot(*shape[1:]) * 0.5**0.5)
                )
            found = _stated(world, change, seed=9000 + seed)
            hits += sum(any(abs(one - day) <= 5 for one in found[k]) for k, day in when.items())
            tries += len(when)
        what = f"a third harmonic of {wrong} degrees, half of a fourth, a quarter of a fifth"
        print(f"  {what}")
        good &= told("fleets with a false change", alarms, seeds, 0.0, 0.03)
        good &= told("changes of 2 degrees found within 5 days", hits, tries, 0.9, 1.0)
    return good


def _stated(world: World, change: np.ndarray, *, seed: int) -> list[list[int]]:
    """Days of the changes that are stated, by aircraft."""
    number, days = change.shape[:2]
    rows = daily_sums(world, aircraft=number, days=days, seed=seed, change=change, by_flight=False)
    sums = [DaySums(*(part[rows[0] == k] for part in rows[1:5])) for k in range(number)]
    found = changes_of([str(k) for k in range(number)], sums, draws=499)
    return [
        [int(np.datetime64(told["date"]).astype("M8[D]").astype(int)) for told in one["changes"]]
        for one in found
    ]


def gains(seeds: int) -> bool:
    print("predicted and realised gain (5 aircraft, learned 31 days, judged 19)")
    setting = Setting(aircraft=5, days=50, outliers=0.005)
    hits = tries = 0
    for seed in range(seeds):
        ds = fleet(seed, setting, amplitude=5.0)[0]
        found = virtual_field_test(
            ds,
            learned_until=date(2008, 8, 1),
            pools={"ruc": ["ruc"]},
            reference="ruc",
            draws=300,
            joint=False,
        )
        hits += sum(entry["agree"] for entry in found["by_aircraft"])
        tries += len(found["by_aircraft"])
    return told("agree within the 95 % interval of their difference", hits, tries, 0.93, 0.98)


PARTS = {
    "reduction": reduction,
    "permutation": permutation,
    "poolable": poolable,
    "changes": changes,
    "turning": turning,
    "gains": gains,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--part", action="append", choices=list(PARTS))
    given = parser.parse_args()
    kept = [PARTS[name](given.seeds) for name in given.part or PARTS]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
