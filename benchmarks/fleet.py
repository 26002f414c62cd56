"""Cost of the fit by number of aircraft: processor time, memory and the exponent of its growth.

    python -m benchmarks.fleet --aircraft 600 1200 2400
    python -m benchmarks.fleet --aircraft 6000 --days 10 --reports 20000000
    python -m benchmarks.fleet --aircraft 600 --reports 2000000 --tracks FILE.csv
    python -m benchmarks.fleet --aircraft 300 600 --days 4 --over hemisphere
    python -m benchmarks.fleet --stages --aircraft 600 1200 2400

Fleets over a continent (or, with ``--over``, half the globe or all of it) against one reference
whose error is a bias, a lasting and a passing field,
every size in a process of its own (memory is the peak of it). With ``--tracks`` flights are where
aircraft of a table (columns icao, lat, lon, alt in feet) were. Aircraft are summed
`TOGETHER` at a time (`sum_aircraft`), as a lazily opened archive is, and the fleet is solved on the
sums (`fit_sums`); together that is `fit_deviation`. The making of the reports is not counted.
With ``--stages`` it is what comes after the fit: aircraft have `FEW` reports, two references.
Of swing cards one in ten is drawn, the others stand; the page has every section, and its size is
printed. A stage's time is the least of some turns. Exit status 1 where the exponent of the
processor time, of a stage that takes a second or more, is above `EXPONENT`, or a page is larger
than `PAGE`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import pandas as pd
import xarray as xr
from tests.compass.flown import Setting, fleet_deviations, fly, wrap
from tests.evaluation import archives

from airswing.compass.fit.deviation import FleetSums, fit_sums, sum_aircraft

EXPONENT = 1.1
PAGE = 5e6  # bytes, of 6,000 aircraft
TURNS, LONG = 3, 5.0
"""Turns of a stage, the least time of which counts, and seconds after which there is no other."""
TOGETHER = 100
PLACES = {
    "continent": (27.0, 48.0, -122.0, -70.0),
    "hemisphere": (0.0, 80.0, 90.0, 270.0),
    "globe": (-60.0, 80.0, 0.0, 360.0),
}
"""Degrees: south, north, west, east."""
FLIGHTS_A_DAY = 4
FEW = Setting(days=20, flights_a_day=3, reports_a_flight=4, references=2)
FIRST_SEGMENT = np.datetime64("2008-07-01", "h").astype(np.int64) // 6


def field(latitude, longitude, time, seed: int) -> np.ndarray:
    """Error of the reference, m/s, (2, n): waves of some 1,500 km that last and that pass."""
    found = np.zeros((2, latitude.size))
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
            found += size / np.sqrt(2.0) * np.sin(angle + phase)
    return found


def straight(flights: int, headings: xr.Dataset, each: int, rng, over: str) -> np.ndarray:
    """Latitude, longitude and pressure of flights from anywhere in a region, (3, n)."""
    south, north, west, east = PLACES[over]
    found = []
    for name, low, high, middle in (
        ("latitude", south, north, 43.0),
        ("longitude", west, east, -87.0),
    ):
        start = np.repeat(rng.uniform(low, high, flights), each)
        found.append(np.clip(start + headings[name].to_numpy() - middle, low, high))
    found[1] = (found[1] + 180.0) % 360.0 - 180.0
    return np.stack([*found, np.repeat(rng.uniform(25e3, 85e3, flights), each)])


def flown(flights: int, each: int, rng, tracks: Path) -> np.ndarray:
    """As of :func:`straight`, each along what one aircraft of a table flew."""
    table = pd.read_csv(tracks).dropna(subset=["lat", "lon", "alt"])
    table = table[table["alt"].between(1000, 45000)]
    known = [one for _, one in table.groupby("icao") if len(one) > 20]
    found = np.empty((3, flights, each))
    for k, which in enumerate(rng.integers(0, len(known), flights)):
        one = known[which]
        at = np.linspace(0, len(one) - 1, each).astype(int)
        found[:2, k] = one["lat"].to_numpy()[at], one["lon"].to_numpy()[at]
        found[2, k] = 101325.0 * (1.0 - 0.3048 * one["alt"].to_numpy()[at] / 44330.8) ** 5.2559
    return found.reshape(3, -1)


def fleet(
    aircraft: int, number: int, days: int, each: int, flies: Path | str
) -> tuple[xr.Dataset, np.ndarray]:
    """Some aircraft of a fleet that shares its reference's error, and their deviations."""
    rng = np.random.default_rng([number, 5])
    deviation = fleet_deviations(aircraft, rng)
    setting = Setting(
        aircraft=aircraft,
        days=days,
        flights_a_day=FLIGHTS_A_DAY,
        reports_a_flight=each,
        day_error=0.0,
        airspeed=200.0,
    )
    headings, _ = fly(deviation, setting, number + 1000)
    flights = aircraft * days * FLIGHTS_A_DAY
    if isinstance(flies, str):
        place = straight(flights, headings, each, rng, flies)
    else:
        place = flown(flights, each, rng, flies)
    for name, values in zip(("latitude", "longitude", "pressure"), place, strict=True):
        headings[name] = ("report", values.astype(headings[name].dtype))
    names = [f"N{number + k:05d}" for k in range(aircraft)]
    return with_field(headings).assign_coords(aircraft=np.array(names, object)), deviation


def with_field(headings: xr.Dataset) -> xr.Dataset:
    """Headings and airspeeds as they would have come out with the field in the reference."""
    heading, airspeed = headings["heading"].to_numpy(), headings["airspeed"].to_numpy()
    toward = np.radians(heading - headings["heading_error"].to_numpy()[0])
    speed = airspeed - headings["airspeed_error"].to_numpy()[0]
    places = [headings[name].to_numpy() for name in ("latitude", "longitude", "time")]
    error = field(*places, seed=0)
    eastward = speed * np.sin(toward) - error[0]
    northward = speed * np.cos(toward) - error[1]
    apart = wrap(heading - np.degrees(np.arctan2(eastward, northward)))
    return headings.assign(
        heading_error=(("reference", "report"), apart[np.newaxis]),
        airspeed_error=(
            ("reference", "report"),
            (airspeed - np.hypot(eastward, northward))[np.newaxis],
        ),
    )


def one_size(aircraft: int, days: int, reports: int, flies: Path | str) -> dict[str, float]:
    """Time, memory and quality of one fleet's fit."""
    each = max(reports // (aircraft * days * FLIGHTS_A_DAY), 1)
    parts: list[FleetSums] = []
    truth, summed = [], 0.0
    for number in range(0, aircraft, TOGETHER):
        made = fleet(min(TOGETHER, aircraft - number), number, days, each, flies)
        truth.append(made[1])
        began = time.process_time()
        parts.append(sum_aircraft(made[0]))
        summed += time.process_time() - began
        del made
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    fits = fit_sums(parts).isel(reference=0)
    solved = time.process_time() - began
    error = fits["deviation"].to_numpy() - np.concatenate(truth)
    spread = np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=1, axis2=2))
    inside = np.abs(error) <= 1.96 * spread
    good = np.isfinite(error[:, 0])
    return {
        "reports": each * aircraft * days * FLIGHTS_A_DAY,
        "fitted": int(good.sum()),
        "summed": summed,
        "solved": solved,
        "before": before / 1e6,
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        "covered": [float(one) for one in 100 * inside[good].mean(axis=0)],
        "regions": int(fits["shared_error_regions"]),
    }


def after_the_fit(aircraft: int, folder: Path) -> dict[str, Callable[[], Any]]:
    """Every stage after the fit, of a fleet with few reports each; the page shows the others."""
    from airswing.compass.correction import correct
    from airswing.compass.fit.deviation import fit_deviation
    from airswing.compass.table import add_tables, write_tables_csv
    from airswing.evaluation.comparison import compare
    from airswing.evaluation.field_test import field_test
    from airswing.evaluation.held_out import virtual_field_test
    from airswing.evaluation.innovations import error_profiles
    from airswing.evaluation.monitoring import find_events, fit_by_window, watch_compasses
    from airswing.evaluation.observation_errors import observation_errors
    from airswing.evaluation.ranking import rank_aircraft
    from airswing.evaluation.results import Evaluation
    from airswing.report import write_page
    from airswing.report.run.swing_cards import write_swing_cards

    headings, _ = archives.fleet(1, replace(FEW, aircraft=aircraft), amplitude=4.0)
    missing = ("report", np.zeros(headings.sizes["report"], np.int8))
    headings = headings.assign(roll_flag=missing, temperature_qc=missing)
    pools = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}
    against: dict[str, Any] = {"pools": pools, "reference": "ruc"}
    fits = add_tables(fit_deviation(headings, pools=pools), headings)
    corrected = correct(headings, fits, reference="ruc")
    names = headings["aircraft"].to_numpy().astype(str).tolist()
    half, start = aircraft // 2, date(2008, 7, 13)
    groups: dict[str, Any] = {"corrected": names[:half], "controls": names[half:]}

    def cards() -> None:
        write_tables_csv(fits, folder / "tables.csv")
        tenth = fits.isel(aircraft=slice(None, aircraft // 10))
        write_swing_cards(tenth, headings, folder / "swing_cards.pdf", reference="ruc")

    def page() -> Path:
        changes, windows = found["changes"], found["months"]
        evaluation = Evaluation(
            profiles=found["profiles"],
            observation_errors=found["report errors"],
            stability={
                "reference": "ruc",
                "window": "month",
                "changes": changes,
                "windows": windows,
            },
            ranking=found["ranking"],
            virtual={"later": found["virtual test"], "held_out": {"why": "not tried"}},
            field_test=found["field test"],
            sensitivity=found["comparison"],
            monitoring=found["watch"],
        )
        result = {"headings": headings, "fits": fits, "corrected": corrected}
        return write_page(folder / "report", **result, evaluation=evaluation)

    found: dict[str, Any] = {}

    def kept(name: str, work: Callable[[], Any]) -> Callable[[], Any]:
        def do() -> Any:
            found[name] = work()
            return found[name]

        return do

    works: dict[str, Callable[[], Any]] = {
        "ranking": lambda: rank_aircraft(headings, fits, **against),
        "comparison": lambda: compare(headings, pools=pools),
        "changes": lambda: watch_compasses(headings, members=["ruc"]).changes,
        "months": lambda: fit_by_window(headings, **against),
        "field test": lambda: field_test(
            headings, start=start, before_start=date(2008, 7, 1), **groups, **against
        ),
        "virtual test": lambda: virtual_field_test(headings, learned_until=start, **against),
        "watch": lambda: find_events(headings, fits, corrected=corrected, reference="ruc"),
        "profiles": lambda: error_profiles(headings, corrected, pools=pools),
        "report errors": lambda: observation_errors(headings, corrected, **against),
        "cards": cards,
        "page": page,
    }
    return {name: kept(name, work) for name, work in works.items()}


def least_time(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time, s, the least of some turns, and what was made."""
    times: list[float] = []
    made = None
    while len(times) < TURNS and sum(times) < LONG:
        began = time.process_time()
        made = work()
        times.append(time.process_time() - began)
    return min(times), made


def stages(sizes: list[int]) -> int:
    """Print the processor time of every stage after the fit, and its exponent."""
    used: dict[str, list[float]] = {}
    large = 0
    for aircraft in sizes:
        with tempfile.TemporaryDirectory() as folder:
            for name, work in after_the_fit(aircraft, Path(folder)).items():
                seconds, made = least_time(work)
                used.setdefault(name, []).append(seconds)
                print(f"{aircraft:8d} aircraft  {name:<14}{seconds:8.1f} s", flush=True)
                if name == "page":
                    size = made.stat().st_size
                    large += size > PAGE
                    print(f"{aircraft:8d} aircraft  a page of {size / 1e6:.2f} MB", flush=True)
    missed = []
    for name, times in used.items():
        found = float(np.polyfit(np.log(sizes), np.log(times), 1)[0]) if len(sizes) > 1 else 0.0
        if found > EXPONENT and times[-1] >= 1.0:
            missed.append(name)
        print(f"{name:<14}" + "".join(f"{one:9.1f}" for one in times) + f"   power {found:.2f}")
    print(f"above {EXPONENT}: {', '.join(missed) or 'none'}")
    return int(bool(missed) or large > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--aircraft", type=int, nargs="+", default=[150, 300, 600, 1200])
    parser.add_argument("--days", type=int, default=10)
    parser.add_argument("--reports", type=int, help="of all aircraft; 480 an aircraft if not given")
    parser.add_argument("--tracks", type=Path, help="fly where the aircraft of this table were")
    parser.add_argument("--over", choices=PLACES, default="continent", help="where they fly")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--stages", action="store_true", help="what comes after the fit")
    given = parser.parse_args()
    if given.stages:
        return stages(given.aircraft)
    if given.one:
        aircraft = given.aircraft[0]
        reports = given.reports or 480 * aircraft
        print(json.dumps(one_size(aircraft, given.days, reports, given.tracks or given.over)))
        return 0
    print(
        "aircraft   reports  fitted   sums s  fleet s  peak GB  regions   A to E covered, %",
        flush=True,
    )
    used = []
    for aircraft in given.aircraft:
        command = [sys.executable, "-m", "benchmarks.fleet", "--one", "--days", str(given.days)]
        command += ["--aircraft", str(aircraft), "--over", given.over]
        command += ["--reports", str(given.reports)] if given.reports else []
        command += ["--tracks", str(given.tracks)] if given.tracks else []
        result = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        used.append(result["summed"] + result["solved"])
        covered = " ".join(f"{one:5.1f}" for one in result["covered"])
        print(
            f"{aircraft:8d} {result['reports']:9d} {result['fitted']:7d} {result['summed']:8.1f}"
            f" {result['solved']:8.1f} {result['peak']:8.2f} {result['regions']:8d}   {covered}",
            flush=True,
        )
    if len(used) < 2:
        return 0
    found = float(np.polyfit(np.log(given.aircraft), np.log(used), 1)[0])
    missed = "" if found <= EXPONENT else ", MISSED"
    print(f"processor time grows with the power {found:.2f} (bar {EXPONENT}{missed})")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
