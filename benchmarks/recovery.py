"""Are known deviations found again? Sample archives, the main job's stages, errors against truth.

    python -m benchmarks.recovery --archives 20

Every archive is written by ``airswing sample`` with a seed of its own into a temporary folder,
then ``airswing collocate`` and ``airswing fit`` run on it (the stages of ``airswing run`` that
lead to ``fits.nc``) and the fits are held against ``truth/truth.json``. Limits, for amplitudes
over 2 degrees and 3,000 reports that count: offset and amplitude within 0.3 degrees, phase within
5. Each such aircraft is a line for the pool, and one for each reference alone that misses a
limit; then, over all of them, how many are within the limits and how often +-1.96 stated standard
errors held the truth, for the pool (the last) and for each reference alone. An aircraft whose fit
says it is not to be trusted has no errors and is counted apart.

The exit status is 1 where the pool's fit misses a limit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from airswing.flags import STATUS

LIMITS = {"offset": 0.3, "amplitude": 0.3, "phase": 5.0}
"""Degrees."""
LEAST_AMPLITUDE, LEAST_REPORTS = 2.0, 3000
"""Degrees; reports that count in the fit."""
CLASSES = (2.0, 2.5, 4.0, 9.0)
"""Degrees: amplitudes are judged between these too."""


def make(folder: Path, seed: int, days: int, aircraft: int) -> None:
    """Write one archive and fit it."""
    sizes = ["--days", str(days), "--aircraft", str(aircraft), "--seed", str(seed)]
    config = str(folder / "config.yaml")
    settings = os.environ | {"AIRSWING_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    for words in (["sample", str(folder), *sizes], ["collocate", config], ["fit", config]):
        done = subprocess.run(
            [sys.executable, "-m", "airswing", *words], env=settings, capture_output=True, text=True
        )
        if done.returncode:
            raise SystemExit(f"airswing {words[0]} failed: {done.stderr[-2000:]}")


def compare(fits: xr.Dataset, truth: dict[str, Any], seed: int, least: int) -> list[dict[str, Any]]:
    """Errors and standard errors of every fit the limits are meant for, degrees."""
    found = []
    for reference in fits["reference"].to_numpy().tolist():
        for tail in fits["aircraft"].to_numpy().tolist():
            one = fits.sel(reference=reference, aircraft=tail)
            true = truth["aircraft"][tail]
            reports = int(one["report_count"])
            if true["amplitude"] <= LEAST_AMPLITUDE or reports < least:
                continue
            line = {"seed": seed, "aircraft": tail, "reference": reference, "reports": reports}
            line["status"] = {code: name for name, code in STATUS.items()}[int(one["status"])]
            line |= {"flights": int(one["flight_count"]), "true_amplitude": true["amplitude"]}
            for name in LIMITS:
                apart = float(one[name]) - true[name]
                line[name] = (apart + 180) % 360 - 180 if name == "phase" else apart
                line[f"{name}_error"] = float(one[f"{name}_standard_error"])
            found.append(line)
    return found


def over(line: dict[str, Any]) -> list[str]:
    """Limits that a published fit misses."""
    return [name for name, limit in LIMITS.items() if abs(line[name]) > limit]


def told(line: dict[str, Any]) -> str:
    """One aircraft's line."""
    if not np.isfinite(line["offset"]):
        return f"seed {line['seed']} {line['aircraft']}: {line['status']}, nothing published"
    parts = [f"{name} {line[name]:+6.2f} +- {line[f'{name}_error']:.2f}" for name in LIMITS]
    return (
        f"seed {line['seed']} {line['aircraft']} {line['reference']} {line['reports']:6d} reports,"
        f" {line['flights']:4d} flights, amplitude {line['true_amplitude']:4.1f}:"
        f"  {'  '.join(parts)}{'  OVER: ' + ', '.join(over(line)) if over(line) else ''}"
    )


def summary(lines: list[dict[str, Any]]) -> tuple[str, bool]:
    """Over all aircraft of one reference; and whether every trusted fit is within the limits."""
    trusted = [line for line in lines if np.isfinite(line["offset"])]
    words = [f"{len(trusted)} aircraft, {len(lines) - len(trusted)} not to be trusted by status"]
    good = bool(trusted)
    for name, limit in LIMITS.items():
        apart, error = (np.array([line[k] for line in trusted]) for k in (name, f"{name}_error"))
        within = np.abs(apart) <= limit
        good &= bool(within.all())
        words.append(
            f"  {name:9s} within {limit} degrees {within.sum()} of {within.size};"
            f" mean {apart.mean():+.3f}, rms {np.sqrt(np.mean(apart**2)):.3f}, largest"
            f" {np.abs(apart).max():.2f}; rms standard error {np.sqrt(np.mean(error**2)):.3f},"
            f" +-1.96 of it held {100 * np.mean(np.abs(apart) <= 1.96 * error):.1f} %"
        )
    words += [classed(trusted, low, high) for low, high in pairwise(CLASSES)]
    return "\n".join(words), good


def classed(lines: list[dict[str, Any]], low: float, high: float) -> str:
    """Errors of the amplitudes between two sizes: their mean, and how often they were held."""
    some = [line for line in lines if low < line["true_amplitude"] <= high]
    apart, error = (
        np.array([line[name] for line in some]) for name in ("amplitude", "amplitude_error")
    )
    if apart.size < 2:
        return f"  amplitudes of {low} to {high} degrees: {apart.size}"
    spread = apart.std(ddof=1) / np.sqrt(apart.size)
    return (
        f"  amplitudes of {low} to {high} degrees: {apart.size}, mean error {apart.mean():+.3f} +-"
        f" {spread:.3f}, held {100 * np.mean(np.abs(apart) <= 1.96 * error):.1f} %"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--archives", type=int, default=20)
    parser.add_argument("--first", type=int, default=1001, help="seed of the first")
    parser.add_argument("--days", type=int, default=45)
    parser.add_argument("--aircraft", type=int, default=14)
    parser.add_argument(
        "--reports", type=int, default=LEAST_REPORTS, help="fewest of an aircraft that is judged"
    )
    given = parser.parse_args()
    lines: list[dict[str, Any]] = []
    for seed in range(given.first, given.first + given.archives):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "sample"
            make(folder, seed, given.days, given.aircraft)
            truth = json.loads((folder / "truth" / "truth.json").read_text())
            with xr.open_dataset(folder / "results" / "fits.nc") as fits:
                new = compare(fits.load(), truth, seed, given.reports)
        for line in new:
            if line["reference"] == new[-1]["reference"] or over(line):
                print(told(line), flush=True)
        lines += new
    good = True
    for reference in dict.fromkeys(line["reference"] for line in lines):
        text, good = summary([line for line in lines if line["reference"] == reference])
        print(f"{reference}: {text}")
    return 0 if good and lines else 1


if __name__ == "__main__":
    sys.exit(main())
