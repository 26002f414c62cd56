"""Do the evaluation's intervals and tests keep their promises? Over many simulated archives.

    python benchmarks/evaluation_coverage.py --seeds 200
    python benchmarks/evaluation_coverage.py --seeds 40 --part poolable --part gains

Printed, a table each: how often intervals of the adjusted reduction held the truth; how often the
permutation test rejected where nothing was corrected, the group drawn by lot and chosen as the
worst; how often references of equal truth were called poolable, and one with a regional bias of
1 m/s; predicted against realised gains. Changes of compasses: benchmarks.monitoring. Exit status 1
where a promise was broken beyond what that many seeds let chance do (three standard deviations).
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
    fleet,
    references,
)
from tests.evaluation.fleets import START, simulate_fleet

from airswing.evaluation.comparison import compare
from airswing.evaluation.field_test import field_test
from airswing.evaluation.held_out import virtual_field_test
from airswing.evaluation.resampling import permutation_test


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
