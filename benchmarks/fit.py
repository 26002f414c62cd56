"""Speed of the fit: ratios against a loop of scipy.optimize.curve_fit over the same table.

    python benchmarks/fit.py

5 million reports of 100 aircraft. Bars: the plain sinusoid (offset, amplitude, phase; no weights)
at least 20 times faster, with the same answers; the full fit (robust, joint, clustered, one or two
cycles) at least 5 times, both as it is by default, beside the reference's shared error, and without
that. The bars are on elapsed time; the ratio of processor time, which a busy machine disturbs
less, is beside it. Exit status 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from scipy.optimize import curve_fit
from tests.compass.flown import Setting, fleet_deviations, fly

from airswing.compass.deviation import fit_deviation, fit_sinusoid

BARS = {"plain sinusoid": 20, "full fit, default": 5, "full fit, no shared error": 5}


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


def shortest(calls: dict, repeats: int) -> tuple[dict, dict, dict]:
    """Shortest processor and elapsed time of each call, the calls taking turns."""
    used, elapsed = (dict.fromkeys(calls, float("inf")) for _ in range(2))
    results = {}
    for _ in range(repeats):
        for name, call in calls.items():
            begin, wall = time.process_time(), time.perf_counter()
            results[name] = call()
            used[name] = min(used[name], time.process_time() - begin)
            elapsed[name] = min(elapsed[name], time.perf_counter() - wall)
    return used, elapsed, results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--days", type=int, default=365)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    deviation = fleet_deviations(given.aircraft, np.random.default_rng(0))
    headings, _ = fly(
        deviation, Setting(aircraft=given.aircraft, days=given.days, reports_a_flight=34), 0
    )
    print(f"{headings.sizes['report'] / 1e6:.2f} million reports, {given.aircraft} aircraft")
    used, elapsed, results = shortest(
        {
            "curve_fit loop": lambda: loop(headings),
            "plain sinusoid": lambda: fit_sinusoid(headings),
            "full fit, default": lambda: fit_deviation(headings),
            "full fit, no shared error": lambda: fit_deviation(headings, shared_error=False),
        },
        given.repeats,
    )
    expected, found, *fits = results.values()
    vector = expected[:, 1] * np.exp(1j * np.radians(expected[:, 2]))
    amplitude, phase = (found[name].to_numpy()[0] for name in ("amplitude", "phase"))
    apart = np.abs(amplitude * np.exp(1j * np.radians(phase)) - vector).max()
    apart = max(apart, np.abs(found["offset"].to_numpy()[0] - expected[:, 0]).max())
    notes = [f"largest difference {apart:.1e} degree"]
    for one in fits:
        worst = np.abs(one["deviation"].to_numpy()[0] - deviation).max()
        notes.append(f"largest error of a coefficient {worst:.3f} degree")
    good = apart < 1e-3
    for name, note in zip(used, ["", *notes], strict=True):
        ratio, processor = (part["curve_fit loop"] / part[name] for part in (elapsed, used))
        line = f"{name:26s} {elapsed[name]:7.3f} s"
        if name in BARS:
            good &= ratio >= BARS[name]
            missed = "" if ratio >= BARS[name] else ", MISSED"
            line += f"   ratio {ratio:5.1f} (bar {BARS[name]}{missed})   "
            line += f"of processor time {processor:5.1f}   {note}"
        print(line)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
