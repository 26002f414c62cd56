"""Coverage of the evaluation's intervals and size of its tests, over many simulated archives.

    python -m benchmarks.evaluation_coverage [--seeds 100] [--part poolable]

Parts: how often intervals of the adjusted reduction contain the truth; how often the permutation
test rejects where nothing was corrected, the group drawn at random and chosen as the worst; how
often references of equal truth are called poolable, and one with a regional bias of 1 m/s; how
often predicted and realised gains agree. Changes of compasses: benchmarks.monitoring. Exit status 1
where a rate is outside its bounds by more than three standard deviations.
"""

from __future__ import annotations

import argparse
import sys
from datetime import date
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.compass.flown import Setting
from tests.evaluation.archives import LASTING_ERRORS, fleet, references
from tests.evaluation.fleets import START, simulate_fleet

from airswing.evaluation.comparison import compare
from airswing.evaluation.field_test import field_test
from airswing.evaluation.held_out import virtual_field_test
from airswing.evaluation.resampling import permutation_test


def checked(name: str, hits: int, tries: int, low: float, high: float) -> bool:
    """Print one rate; False where it is outside its bounds by more than chance."""
    rate = hits / tries
    slack = 3 * np.sqrt(max(low * (1 - low), high * (1 - high), 1e-4) / tries)
    good = low - slack <= rate <= high + slack
    bounds = f"{100 * low:.0f}-{100 * high:.0f} %"
    print(f"  {name:58} {100 * rate:6.1f} % of {tries:5}, {bounds} {'' if good else 'MISSED'}")
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
    return checked("linear", linear, seeds, 0.93, 0.97) & checked(
        "in quadrature", square, seeds, 0.93, 0.97
    )


def permutation(seeds: int) -> bool:
    print("permutation test at 5 % where nothing was corrected (36 aircraft)")
    good, repeats = True, 10 * seeds
    for name in ("drawn at random", "chosen as the worst"):
        rng, rejected = np.random.default_rng(5), 0
        for seed in range(repeats):
            level = 7 + rng.normal(0, 0.8, 36)
            before, during = level + rng.normal(0, 0.6, 36), level + 1.2 + rng.normal(0, 0.6, 36)
            corrected = np.zeros(36, dtype=bool)
            order = rng.permutation(36) if name == "drawn at random" else np.argsort(-before)
            corrected[order[:19]] = True
            found = permutation_test(-during, corrected, covariate=before, draws=399, seed=seed)
            rejected += found[1] <= 0.05
        good &= checked(name, rejected, repeats, 0.03, 0.07)
    return good


def poolable(seeds: int) -> bool:
    print("references called poolable (8 aircraft, 90 days, errors that last for days)")
    two, good = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}, True
    for name, bias, low, high in (
        ("equal truth", 0.0, 0.95, 1.0),
        ("regional bias of 1 m/s", 1.0, 0.0, 0.05),
    ):
        archives = (references(k, LASTING_ERRORS, regional={"rtfdaa": bias}) for k in range(seeds))
        found = [compare(one, pools=two, joint=False)["pairs"][0] for one in archives]
        good &= checked(name, sum(bool(one["poolable"]) for one in found), seeds, low, high)
        if bias == 0.0:
            inside = [
                entry["ci"][c][0] <= 0 <= entry["ci"][c][1]
                for one in found
                for entry in one["aircraft"]
                for c in "ABCDE"
            ]
            good &= checked("intervals of differences contain 0", sum(inside), len(inside), 0.9, 1)
    return good


def gains(seeds: int) -> bool:
    print("predicted and realised gain (5 aircraft, learned 31 days, compared 19)")
    agree = []
    for seed in range(seeds):
        found = virtual_field_test(
            fleet(seed, Setting(aircraft=5, days=50, outliers=0.005), amplitude=5.0)[0],
            learned_until=date(2008, 8, 1),
            pools={"ruc": ["ruc"]},
            reference="ruc",
            draws=300,
            joint=False,
        )
        agree += [entry["agree"] for entry in found["by_aircraft"]]
    return checked("within the 95 % interval of their difference", sum(agree), len(agree), 0.93, 1)


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
    return 0 if all([PARTS[part](given.seeds) for part in given.part or PARTS]) else 1


if __name__ == "__main__":
    sys.exit(main())
