"""Speed of the fit: ratios against a loop of scipy.optimize.curve_fit over the same table.

    python benchmarks/fit.py

5 million reports of 100 aircraft. Bars: the plain sinusoid (offset, amplitude, phase; no weights)
at least 20 times faster, with the same answers; the full fit (robust, joint, clustered, one or two
cycles) at least 5 times. Exit status 1 where a bar is missed.
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


def shortest(calls: dict, repeats: int) -> tuple[dict, dict]:
    """Shortest time of each call, the calls taking turns so that a busy machine hits all alike."""
    times, results = dict.fromkeys(calls, float("inf")), {}
    for _ in range(repeats):
        for name, call in calls.items():
            begin = time.perf_counter()
            results[name] = call()
            times[name] = min(times[name], time.perf_counter() - begin)
    return times, results


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
    times, results = shortest(
        {
            "loop": lambda: loop(headings),
            "plain": lambda: fit_sinusoid(headings),
            "full": lambda: fit_deviation(headings, shared_error=False),
        },
        given.repeats,
    )
    begin = time.perf_counter()
    fit_deviation(headings)
    shared = time.perf_counter() - begin
    slow, plain, full = times.values()
    expected, found, fits = results.values()
    vector = expected[:, 1] * np.exp(1j * np.radians(expected[:, 2]))
    apart = np.abs(
        found["amplitude"].to_numpy()[0] * np.exp(1j * np.radians(found["phase"].to_numpy()[0]))
        - vector
    )
    apart = max(apart.max(), np.abs(found["offset"].to_numpy()[0] - expected[:, 0]).max())
    worst = np.abs(fits["deviation"].to_numpy()[0] - deviation).max()
    print(f"curve_fit loop   {slow:7.3f} s")
    print(
        f"plain sinusoid   {plain:7.3f} s   ratio {slow / plain:6.1f} (bar 20)   "
        f"largest difference {apart:.1e} degree"
    )
    print(
        f"full fit         {full:7.3f} s   ratio {slow / full:6.1f} (bar 5)   "
        f"largest error of a coefficient {worst:.3f} degree"
    )
    print(f"and the reference's shared error {shared:7.3f} s   ratio {slow / shared:6.1f} (no bar)")
    return 0 if slow >= 20 * plain and slow >= 5 * full and apart < 1e-3 else 1


if __name__ == "__main__":
    sys.exit(main())
