"""Time and memory of the one pass over the reports, and of the search on its sums.

    OMP_NUM_THREADS=2 python benchmarks/gap_statistics.py --reports 1000000 --aircraft 20

Reports are the toy archive of the tests repeated week after week under new days and aircraft, so
that any number can be made in memory. Prints seconds per stage, reports per second, peak memory.
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import airswing  # noqa: F401
from airswing.gap.context import exogenous
from airswing.gap.diagnose import usable_effects
from airswing.gap.dictionary import plan_dictionary
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence import candidates
from airswing.gap.frame import REPORT_FIELDS, Frame
from airswing.gap.layout import make_layout
from airswing.gap.measure import eliminate_days
from airswing.gap.noise import fit_noise
from airswing.gap.statistics import accumulate


def repeated(reports: int, aircraft: int) -> Frame:
    """About this many reports of so many aircraft, by repeating a toy archive."""
    import sys

    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests.gap.toy import make_frame

    one = make_frame(seed=0, aircraft=aircraft, days=7)
    copies = max(1, round(reports / one.size))
    number = int(one.flight.max()) + 1
    stack = {name: np.tile(getattr(one, name), copies) for name in REPORT_FIELDS}
    which = np.repeat(np.arange(copies), one.size)
    stack["time"] = stack["time"] + which * 7 * 86400.0
    stack["flight"] = stack["flight"] + which * number
    order = np.lexsort((stack["time"], stack["aircraft"]))
    return replace(one, **{name: values[order] for name, values in stack.items()})


def main() -> None:
    """Run the stages and print what they cost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=int, default=500_000)
    parser.add_argument("--aircraft", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    frame = repeated(options.reports, options.aircraft)
    clock = [time.perf_counter()]

    def lap(stage: str) -> None:
        clock.append(time.perf_counter())
        print(f"{stage:12s} {clock[-1] - clock[-2]:8.1f} s")

    effects, _ = usable_effects(frame, CATALOGUE)
    columns = exogenous(frame)
    lap("context")
    noise = fit_noise(
        frame.residual, aircraft=frame.aircraft, flight=frame.flight, time=frame.time,
        latitude=frame.latitude, longitude=frame.longitude, pressure=frame.pressure,
        heading=columns.heading, airspeed=columns.airspeed,
    )  # fmt: skip
    lap("noise")
    plan = plan_dictionary(columns)
    layout = make_layout(effects, plan, columns)
    stats = accumulate(
        columns,
        frame.residual,
        noise=noise,
        layout=layout,
        effects=effects,
        plan=plan,
        workers=options.workers,
    )
    lap("sums")
    base = eliminate_days(stats)
    lap("elimination")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(
        f"{frame.size} reports, {len(frame.tails)} aircraft, {layout.size} columns "
        f"({layout.core} core), {len(candidates(layout, effects))} candidates, "
        f"{base.stats.days.size} days: {clock[-1] - clock[0]:.1f} s "
        f"({time.process_time():.1f} s of processor, set-up included), peak {peak:.2f} GiB"
    )


if __name__ == "__main__":
    main()
