"""Cost of the fit by number of aircraft: processor time, memory and the exponent of its growth.

    python -m benchmarks.fleet --aircraft 600 1200 2400

Each size runs in a separate process, whose peak memory is printed; the generation of the reports is
not counted. Exit status 1 where the exponent of the processor time is above `EXPONENT`.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import xarray as xr
from tests.compass.flown import Setting, fleet_deviations, fly
from tests.evaluation.archives import with_reference_error

from airswing.compass.fit.deviation import fit_sums, sum_aircraft

EXPONENT = 1.1
TOGETHER = 100
CONTINENT = (27.0, 48.0, -122.0, -70.0)
"""Degrees: south, north, west, east."""
FLIGHTS_A_DAY = 4
FIRST_SEGMENT = np.datetime64("2008-07-01", "h").astype(np.int64) // 6


def field(latitude, longitude, time, seed):
    """Error of the reference, m/s, (2, n): waves of some 1,500 km that last and that pass."""
    wind = np.zeros((2, latitude.size))
    segment = time.astype("datetime64[h]").astype(np.int64) // 6 - FIRST_SEGMENT
    east = longitude % 360.0 * np.cos(np.radians(40.0))
    for wave in range(4):
        rng = np.random.default_rng([seed, wave])
        for size, phase in (
            (0.4, rng.uniform(0, 2 * np.pi, (2, 1))),
            (0.8, rng.uniform(0, 2 * np.pi, (2, 4 * 366))[:, segment]),
        ):
            per_degree = rng.normal(0, 2 * np.pi / 14.0, 2)
            angle = per_degree[0] * latitude + per_degree[1] * east
            wind += size / np.sqrt(2.0) * np.sin(angle + phase)
    return wind


def straight(flights, headings, reports, rng):
    """Latitude, longitude and pressure of flights from anywhere in a region, (3, n)."""
    south, north, west, east = CONTINENT
    coordinates = []
    for name, low, high, middle in (
        ("latitude", south, north, 43.0),
        ("longitude", west, east, -87.0),
    ):
        start = np.repeat(rng.uniform(low, high, flights), reports)
        coordinates.append(np.clip(start + headings[name].to_numpy() - middle, low, high))
    coordinates[1] = (coordinates[1] + 180.0) % 360.0 - 180.0
    return np.stack([*coordinates, np.repeat(rng.uniform(25e3, 85e3, flights), reports)])


def fleet(aircraft, number, days, reports):
    rng = np.random.default_rng([number, 5])
    deviation = fleet_deviations(aircraft, rng)
    setting = Setting(
        aircraft=aircraft,
        days=days,
        flights_a_day=FLIGHTS_A_DAY,
        reports_a_flight=reports,
        day_error=0.0,
        airspeed=200.0,
    )
    headings, _ = fly(deviation, setting, number + 1000)
    flights = aircraft * days * FLIGHTS_A_DAY
    place = straight(flights, headings, reports, rng)
    for name, values in zip(("latitude", "longitude", "pressure"), place, strict=True):
        headings[name] = ("report", values.astype(headings[name].dtype))
    names = [f"N{number + k:05d}" for k in range(aircraft)]
    return with_field(headings).assign_coords(aircraft=np.array(names, object)), deviation


def with_field(headings):
    places = [headings[name].to_numpy() for name in ("latitude", "longitude", "time")]
    return with_reference_error(headings, "ruc", *field(*places, seed=0))


def one_size(aircraft, days, reports):
    per_flight = max(reports // (aircraft * days * FLIGHTS_A_DAY), 1)
    parts = []
    truth, summed = [], 0.0
    for number in range(0, aircraft, TOGETHER):
        headings, deviation = fleet(min(TOGETHER, aircraft - number), number, days, per_flight)
        truth.append(deviation)
        began = time.process_time()
        parts.append(sum_aircraft(headings))
        summed += time.process_time() - began
        del headings
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    fits = fit_sums(xr.concat(parts, "aircraft")).isel(reference=0)
    solved = time.process_time() - began
    error = fits["deviation"].to_numpy() - np.concatenate(truth)
    spread = np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=1, axis2=2))
    inside = np.abs(error) <= 1.96 * spread
    good = np.isfinite(error[:, 0])
    return {
        "reports": per_flight * aircraft * days * FLIGHTS_A_DAY,
        "fitted": int(good.sum()),
        "summed": summed,
        "solved": solved,
        "before": before / 1e6,
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        "covered": [float(share) for share in 100 * inside[good].mean(axis=0)],
        "regions": int(fits["shared_error_regions"]),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--aircraft", type=int, nargs="+", default=[150, 300, 600, 1200])
    parser.add_argument("--days", type=int, default=10)
    parser.add_argument("--reports", type=int, help="of all aircraft; 480 an aircraft if not given")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        aircraft = options.aircraft[0]
        reports = options.reports or 480 * aircraft
        print(json.dumps(one_size(aircraft, options.days, reports)))
        return 0
    print(
        "aircraft   reports  fitted   sums s  fleet s  peak GB  regions   A to E covered, %",
        flush=True,
    )
    used = []
    for aircraft in options.aircraft:
        command = [sys.executable, "-m", "benchmarks.fleet", "--one", "--days", str(options.days)]
        command += ["--aircraft", str(aircraft)]
        command += ["--reports", str(options.reports)] if options.reports else []
        result = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        used.append(result["summed"] + result["solved"])
        covered = " ".join(f"{share:5.1f}" for share in result["covered"])
        print(
            f"{aircraft:8d} {result['reports']:9d} {result['fitted']:7d} {result['summed']:8.1f}"
            f" {result['solved']:8.1f} {result['peak']:8.2f} {result['regions']:8d}   {covered}",
            flush=True,
        )
    if len(used) < 2:
        return 0
    exponent = float(np.polyfit(np.log(options.aircraft), np.log(used), 1)[0])
    missed = "" if exponent <= EXPONENT else ", MISSED"
    print(f"processor time grows with the power {exponent:.2f} (bar {EXPONENT}{missed})")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
