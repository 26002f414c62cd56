"""Speed of the fit: ratios against loops of scipy.optimize.curve_fit over the same table.

    python benchmarks/fit.py

5 million reports of 100 aircraft, and two loops over the aircraft:

* the *plain loop* fits the seed's sinusoid (three parameters, least squares of the heading error);
* the *loop of the same model* fits what the full fit fits (A to E, airspeed scale and the
  reference's bias, eight parameters on both components of the air vector, with Huber's loss), but
  makes no clustered errors, takes the residual's size as known and chooses no number of cycles. It
  is slow, so it runs over a few aircraft and its time is scaled to all.

Bars: the full fit (robust, joint, clustered, one or two cycles) at least 5 times faster than a
loop, as it is by default, beside the reference's shared error, and without that. Which loop that
means is open to reading, so both ratios are printed and each is held against the bar; the exit
status is 1 where a bar is missed under either. Both sides take turns, and the medians of the turns
are compared. The bars are on elapsed time; the ratio of processor time, which a busy machine
disturbs less, is beside it.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: both sides on one thread

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from scipy.optimize import curve_fit
from tests.compass.flown import Setting, fleet_deviations, fly

from airswing.compass.fit.deviation import fit_deviation

PLAIN, SAME = "plain loop", "loop of the same model"
BARS = {"full fit, default": 5, "full fit, no shared error": 5}
LOSS_SCALE = 2.0
"""m/s: where Huber's loss turns from square to straight, about the residual's rms."""


def sinusoid(m, offset, amplitude, phase):
    """The seed's curve, degrees."""
    return offset + amplitude * np.sin(np.radians(m + phase))


def loop(headings) -> np.ndarray:
    """curve_fit, an aircraft at a time."""
    stop = np.cumsum(headings["row_size"].to_numpy())
    m = headings["magnetic_heading"].to_numpy()
    error = headings["heading_error"].to_numpy()[0]
    return np.array(
        [
            curve_fit(sinusoid, m[end - size : end], error[end - size : end], p0=[0.0, 1.0, 0.0])[0]
            for end, size in zip(stop, headings["row_size"].to_numpy(), strict=True)
        ]
    )


def air_vector(x, a, b, c, d, e, scale, eastward, northward):
    """Air vector the reference implies, m/s: components end to end; angles in radians."""
    heading, m, airspeed = x
    true = heading - (a + b * np.sin(m) + c * np.cos(m) + d * np.sin(2 * m) + e * np.cos(2 * m))
    speed = (1 - scale) * airspeed
    return np.concatenate([speed * np.sin(true) - eastward, speed * np.cos(true) - northward])


def same_model_loop(headings, aircraft: int) -> np.ndarray:
    """curve_fit of the full fit's model, the first aircraft one at a time; A to E in degrees."""
    names = ("heading", "magnetic_heading", "airspeed", "heading_error", "airspeed_error")
    columns = [headings[name].to_numpy() for name in names]
    found, begin = [], 0
    for size in headings["row_size"].to_numpy()[:aircraft]:
        row, begin = slice(begin, begin + size), begin + size
        heading, m = (np.radians(part[row]) for part in columns[:2])
        airspeed = columns[2][row]
        implied = airspeed - columns[4][0, row]
        toward = heading - np.radians(columns[3][0, row])
        vector = np.concatenate([implied * np.sin(toward), implied * np.cos(toward)])
        best, _ = curve_fit(
            air_vector,
            (heading, m, airspeed),
            vector,
            p0=np.zeros(8),
            method="trf",
            loss="huber",
            f_scale=LOSS_SCALE,
        )
        found.append(np.degrees(best[:5]))
    return np.array(found)


def taking_turns(calls: dict, repeats: int) -> tuple[dict, dict, dict]:
    """Processor and elapsed time of each call, the median of turns."""
    used, elapsed = ({name: [] for name in calls} for _ in range(2))
    results = {}
    for _ in range(repeats):
        for name, call in calls.items():
            begin, wall = time.process_time(), time.perf_counter()
            results[name] = call()
            used[name].append(time.process_time() - begin)
            elapsed[name].append(time.perf_counter() - wall)
    used, elapsed = (
        {name: statistics.median(times) for name, times in part.items()} for part in (used, elapsed)
    )
    return used, elapsed, results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--days", type=int, default=365)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--few", type=int, default=2, help="aircraft of the same model's loop")
    given = parser.parse_args()
    deviation = fleet_deviations(given.aircraft, np.random.default_rng(0))
    headings, _ = fly(
        deviation, Setting(aircraft=given.aircraft, days=given.days, reports_a_flight=34), 0
    )
    print(f"{headings.sizes['report'] / 1e6:.2f} million reports, {given.aircraft} aircraft")
    few = min(given.few, given.aircraft)
    used, elapsed, results = taking_turns(
        {
            PLAIN: lambda: loop(headings),
            SAME: lambda: same_model_loop(headings, few),
            "full fit, default": lambda: fit_deviation(headings),
            "full fit, no shared error": lambda: fit_deviation(headings, shared_error=False),
        },
        given.repeats,
    )
    for part in (used, elapsed):
        part[SAME] *= given.aircraft / few
    _, same, *fits = results.values()
    notes = ["", f"{few} of {given.aircraft} aircraft, scaled"]
    for one in fits:
        curve = one["deviation"].to_numpy()[0]
        notes.append(
            f"largest error of a coefficient {np.abs(curve - deviation).max():.3f}, difference"
            f" from the same model's loop {np.abs(curve[:few] - same).max():.3f}"
        )
    good = True
    for name, note in zip(used, notes, strict=True):
        print(f"{name:26s} {elapsed[name]:7.3f} s   {note}{' degree' if name in BARS else ''}")
        for loop_name in (PLAIN, SAME) if name.startswith("full") else (PLAIN,):
            if name not in BARS:
                continue
            ratio, processor = (part[loop_name] / part[name] for part in (elapsed, used))
            good &= ratio >= BARS[name]
            missed = "" if ratio >= BARS[name] else ", MISSED"
            print(
                f"    {loop_name + ' / this':30s} {ratio:6.1f} (bar {BARS[name]}{missed})"
                f"   of processor time {processor:6.1f}"
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
