"""A fleet's year end to end: time and peak memory by stage, growth, and the full grid's cost.

    python -m benchmarks.year [--share 1.0] [--workers 1] [--month] [--growth] [--main]

Makes a year that is scaled down in grid alone: 8,760 hourly GRIB1 files (24 x 18 points, six
levels, u and v), 10 million reports of 60 aircraft in twelve Parquet files. ``--share 0.05`` takes
that share of the hours and of the reports; ``--main`` leaves out the evaluation and the page. The
job runs in a process of its own, every stage with its wall time, processor time and peak memory.
``--month`` repeats it with a twelfth of the archive and gives the ratio of the peaks and the
exponents of the growth. ``--growth`` repeats it with a tenth of the reports, with a tenth of the
hours, with a quarter of the aircraft (each reporting four times as much) and with four times the
grid points, and gives the exponents. With ``--workers 2`` the peak of the busiest worker process is
told beside that of the process that was started. The full grid is extrapolated from a RUC-size day
(451 x 337 points, 37 levels) measured in the same run: its cost an hour in place of the small
grid's, the rest as measured.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import airswing  # noqa: F401  (imports pyproj before eccodes can be)

START = np.datetime64("2009-01-01T00:00:00", "s")
HOURS, REPORTS, AIRCRAFT = 8760, 10_000_000, 60
NI, NJ, LEVELS = 24, 18, (500, 450, 400, 350, 300, 250)
SOUTH, WEST, STEP = 36.0, -96.0, 0.75
LEG = 38
"""Reports a leg, a minute apart."""


def wind(latitude: Any, longitude: Any) -> tuple[Any, Any]:
    """True wind, m/s: linear, so that interpolation adds nothing."""
    x, y = (longitude - WEST) / (NI * STEP), (latitude - SOUTH) / (NJ * STEP)
    return 12.0 + 10.0 * y + 4.0 * x, -4.0 + 9.0 * x - 3.0 * y


def write_fields(folder: Path, hours: int, finer: int = 1) -> None:
    """One file an hour: the date octets of one hour's messages are changed."""
    import eccodes

    ni, nj, step = finer * NI, finer * NJ, STEP / finer
    lat, lon = np.meshgrid(SOUTH + step * np.arange(nj), WEST + step * np.arange(ni), indexing="ij")
    grid = {
        "Ni": ni,
        "Nj": nj,
        "latitudeOfFirstGridPointInDegrees": SOUTH,
        "longitudeOfFirstGridPointInDegrees": WEST,
        "latitudeOfLastGridPointInDegrees": SOUTH + step * (nj - 1),
        "longitudeOfLastGridPointInDegrees": WEST + step * (ni - 1),
        "iDirectionIncrementInDegrees": step,
        "jDirectionIncrementInDegrees": step,
        "jScansPositively": 1,
    }
    messages, starts = b"", []
    for level in LEVELS:
        for number, values in enumerate(wind(lat, lon)):
            handle = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib1")
            keys = {
                "centre": 59,
                "table2Version": 2,
                "indicatorOfParameter": 33 + number,
                "indicatorOfTypeOfLevel": 100,
                "dataDate": 20090101,
                "level": level,
                **grid,
                "bitsPerValue": 16,
            }
            for key, value in keys.items():
                eccodes.codes_set(handle, key, value)
            eccodes.codes_set_values(handle, values.ravel())
            starts.append(len(messages))
            messages += eccodes.codes_get_message(handle)
            eccodes.codes_release(handle)
    folder.mkdir()
    copy = bytearray(messages)
    for hour in range(hours):
        when = pd.Timestamp(START) + pd.Timedelta(hours=hour)
        for start in starts:
            copy[start + 20 : start + 24] = bytes(
                (when.year - 2000, when.month, when.day, when.hour)
            )
        (folder / f"{when:%Y%m%d%H}.grb").write_bytes(copy)


def write_reports(folder: Path, reports: int, hours: int, aircraft: int) -> None:
    """Straight legs of one speed, winds with each aircraft's deviation, a file a twelfth."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    legs = max(reports // (aircraft * LEG), 1)
    pieces = []
    for number in range(aircraft):
        slot = (hours - 2) * 3600.0 / legs
        begin = 3600.0 + slot * np.arange(legs)
        minutes = np.arange(LEG) * min(60.0, 0.8 * slot / LEG)
        track, speed = rng.uniform(0, 2 * np.pi, legs), rng.uniform(110.0, 150.0, legs)
        lat0, lon0 = rng.uniform(40.5, 44.5, legs), rng.uniform(-91.0, -84.0, legs)
        along = speed[:, None] * minutes / 111_195.0
        lat = lat0[:, None] + along * np.cos(track)[:, None]
        middle = np.radians(lat0[:, None] + 0.5 * along * np.cos(track)[:, None])
        lon = lon0[:, None] + along * np.sin(track)[:, None] / np.cos(middle)
        u, v = wind(lat, lon)
        ground = np.broadcast_to((speed * np.exp(1j * (np.pi / 2 - track)))[:, None], lat.shape)
        error = 1.2 * (rng.normal(size=(2, legs, 1)) + rng.normal(size=(2, legs, LEG)))
        air = ground - (u + error[0]) - 1j * (v + error[1])
        heading = np.pi / 2 - np.angle(air)
        offset, size, phase = rng.uniform(-1, 1), rng.uniform(0.5, 6), rng.uniform(-np.pi, np.pi)
        wrong = np.radians(offset + size * np.sin(heading + phase))
        told = ground - air * np.exp(-1j * wrong)
        stamp = START + (begin[:, None] + minutes).round().astype("timedelta64[s]")
        height = np.broadcast_to(rng.integers(220, 300, legs)[:, None] * 100, lat.shape)
        pieces.append(
            pd.DataFrame(
                {
                    "tail": f"N{100 + number}",
                    "time": stamp.ravel(),
                    "latitude": lat.round(4).ravel(),
                    "longitude": lon.round(4).ravel(),
                    "pressure_altitude_ft": height.ravel().astype(np.float32),
                    "wind_direction_deg": (np.degrees(np.arctan2(-told.real, -told.imag)) % 360)
                    .round()
                    .ravel()
                    .astype(np.float32),
                    "wind_speed_kt": (np.abs(told) / 0.514444).round().ravel().astype(np.float32),
                    "phase": "cruise",
                    "roll_flag": "G",
                    "temperature_qc": "pass",
                }
            )
        )
    table = pd.concat(pieces, ignore_index=True)
    part = ((table["time"] - pd.Timestamp(START)) // pd.Timedelta(hours=hours / 12)).clip(0, 11)
    for number, piece in table.groupby(part):
        piece.to_parquet(folder / f"part{number:02d}.parquet", index=False)


def main_stages(job: Any) -> dict[str, Any]:
    """Headings, fits and corrected winds alone."""
    from airswing import workflow
    from airswing.workflow.closing_summary import summarise

    headings = workflow.make_headings(job)
    fits = workflow.make_fits(job, headings)
    corrected = workflow.make_corrected(job, headings, fits)
    return summarise(job.config, headings, fits, corrected) | {"accounts": job.progress.accounts()}


def measured(config: str, *, what: str, resume: bool) -> None:
    """Run the job in this process; its accounts, with memory by stage, as JSON."""
    import contextlib

    from airswing import workflow
    from airswing.config_file import load_config
    from airswing.workflow.compute import scheduler
    from airswing.workflow.progress import Progress
    from airswing.workflow.update import update

    peaks: list[dict[str, Any]] = []

    class Watched(Progress):
        @contextlib.contextmanager
        def stage(self, name: str) -> Any:
            Path("/proc/self/clear_refs").write_text("5")
            began = time.process_time()
            with super().stage(name) as record:
                yield record
            used = time.process_time() - began
            peaks.append({"name": name, "processor": used, "peak": memory("VmHWM")})

    job = workflow.Job(load_config(config), Watched(), resume)
    with scheduler(job.config.compute, job.progress):
        result = {"main": main_stages, "run": workflow.run, "update": update}[what](job)
        accounts = result["accounts"]
        for stage, peak in zip(accounts["stages"], peaks, strict=True):
            stage |= peak
        accounts["workers"] = worker_peaks() if job.config.compute.workers != 1 else []
    kept = ("reports", "status", "accounts", "months")
    print(json.dumps({key: result[key] for key in kept if key in result}))


def worker_peaks() -> list[int]:
    """Peak memory of every worker process, bytes."""
    from benchmarks.collocation import peak_memory
    from distributed import default_client

    return list(default_client().run(peak_memory).values())


def memory(key: str) -> int:
    """A line of /proc/self/status, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024
    return 0


def run(
    folder: Path,
    *,
    reports: int,
    hours: int,
    aircraft: int,
    finer: int = 1,
    workers: int,
    main: bool,
) -> dict[str, Any]:
    """Make an archive, run the job on it, and return its accounts."""
    folder.mkdir()
    write_fields(folder / "model", hours, finer)
    write_reports(folder / "reports", reports, hours, aircraft)
    found = run_on(folder, workers=workers, main=main)
    found["bytes_per_report"] = (folder / "results/headings.nc").stat().st_size / reports
    found["decoding"] = plain_decoding(folder / "model")
    return found


def run_on(
    folder: Path,
    *,
    output: str = "results",
    workers: int = 1,
    main: bool = False,
    resume: bool = False,
    update: bool = False,
) -> dict[str, Any]:
    """Run the job on an archive in a process of its own, and return its accounts."""
    config = folder / f"{output}.json"
    content = {
        "reports": {"files": str(folder / "reports/*.parquet")},
        "references": {"small": {"files": str(folder / "model/*.grb")}},
        "output": str(folder / output),
        "compute": {"workers": workers},
    }
    config.write_text(json.dumps(content))
    command = [sys.executable, "-m", "benchmarks.year", "--measured", str(config)]
    command += ["--main"] if main else ["--update"] if update else []
    command += ["--resume"] if resume else []
    environment = os.environ | {"AIRSWING_CACHE": str(folder / "cache")}
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    found["wall"] = time.perf_counter() - began
    return found


def plain_decoding(folder: Path) -> float:
    """Plain eccodes decoding of every message in one thread, s of processor time."""
    from benchmarks.collocation import decode_all

    began = time.process_time()
    for path in sorted(folder.iterdir()):
        decode_all(str(path))
    return time.process_time() - began


def ruc_hour(folder: Path, hours: int = 24) -> dict[str, float]:
    """Processor time of a RUC-size hour: plain decoding, and collocation from a cold scan."""
    from benchmarks import collocation as one

    rng = np.random.default_rng(1)
    simple = "GRIB1 simple"
    one.write_hour(folder, simple, [one.smooth_field(rng) for _ in range(2 * one.LEVELS.size)])
    paths = one.copy_hours(one.file_of(folder, simple), hours)
    reports, caches = one.some_reports(hours, exact=False), one.new_folders(folder / "caches")
    work = {
        "plain": lambda: [one.decode_all(path) for path in paths],
        "sparse": partial(one.collocate_hour, paths, reports, caches, sparse=True),
    }
    times = one.interleaved(work, 2)
    return {name: seconds / hours for name, seconds in zip(work, times, strict=True)}


def shown(found: dict[str, Any], what: str) -> None:
    """Print one run's table."""
    accounts = found["accounts"]
    print(f"\n{what}: {found['reports']['usable']:,} reports, {found['wall']:.0f} s in all")
    print(f"{'stage':<20}{'wall s':>9}{'cpu s':>9}{'peak MB':>9}")
    for stage in accounts["stages"]:
        print(
            f"{stage['name']:<20}{stage['seconds']:9.1f}{stage['processor']:9.1f}"
            f"{stage['peak'] / 1e6:9.0f}"
        )
    peak = max(stage["peak"] for stage in accounts["stages"])
    print(
        f"peak {peak / 1e9:.2f} GB, {peak / found['reports']['usable']:.0f} bytes a report; "
        f"headings.nc {found['bytes_per_report']:.1f} bytes a report; plain decoding "
        f"{found['decoding']:.1f} s"
    )
    if accounts["workers"]:
        print(f"peak of a worker process {max(accounts['workers']) / 1e9:.2f} GB")


def exponents(whole: dict[str, Any], less: dict[str, Any], ratio: float) -> dict[str, float]:
    """How the processor time of each stage of some size grows between two runs."""
    small = {stage["name"]: stage["processor"] for stage in less["accounts"]["stages"]}
    return {
        stage["name"]: math.log(stage["processor"] / small[stage["name"]]) / math.log(ratio)
        for stage in whole["accounts"]["stages"]
        if stage["processor"] > 1.0 and small.get(stage["name"], 0.0) > 0.05
    }


def flatness(whole: dict[str, Any], less: dict[str, Any]) -> dict[str, float]:
    """Peak memory of each stage over that of a smaller archive's; ``together`` of the whole job."""
    small = {stage["name"]: stage["peak"] for stage in less["accounts"]["stages"]}
    found = {
        stage["name"]: stage["peak"] / small[stage["name"]] for stage in whole["accounts"]["stages"]
    }
    top = max(stage["peak"] for stage in whole["accounts"]["stages"])
    found["together"] = top / max(small.values())
    workers = [run["accounts"]["workers"] for run in (whole, less)]
    return found | ({"worker": max(workers[0]) / max(workers[1])} if all(workers) else {})


def draw(found: dict[str, Any], path: Path) -> None:
    """Processor time and peak memory of every stage, side by side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    stages = found["accounts"]["stages"]
    names = [stage["name"] for stage in stages]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 0.32 * len(names) + 1.2), sharey=True)
    left.barh(names, [stage["processor"] for stage in stages], color="#33638d")
    left.set_xlabel("processor time (s)")
    right.barh(names, [stage["peak"] / 1e9 for stage in stages], color="#33638d")
    right.set_xlabel("peak memory of the process (GB)")
    left.invert_yaxis()
    figure.suptitle(f"{found['reports']['usable']:,} reports, by stage")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run the year and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of hours and of reports")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--month", action="store_true", help="also a twelfth of the archive")
    parser.add_argument("--growth", action="store_true", help="also a tenth of each")
    parser.add_argument("--main", action="store_true", help="no evaluation, no page")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    parser.add_argument("--figure", type=Path, help="draw time and memory by stage here (PNG)")
    parser.add_argument("--measured", help=argparse.SUPPRESS)
    parser.add_argument("--resume", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--update", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measured:
        what = "main" if given.main else "update" if given.update else "run"
        measured(given.measured, what=what, resume=given.resume)
        return
    hours, reports = round(HOURS * given.share), round(REPORTS * given.share)
    sizes = {"aircraft": AIRCRAFT, "workers": given.workers, "main": given.main}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = {"whole": run(folder / "whole", reports=reports, hours=hours, **sizes)}
        shown(runs["whole"], f"{hours:,} hours")
        if given.month:
            less = {"reports": reports // 12, "hours": hours // 12}
            runs["month"] = run(folder / "month", **less, **sizes)
            shown(runs["month"], "a twelfth of the archive")
            for words, figures in (
                ("peak memory over the twelfth's", flatness(runs["whole"], runs["month"])),
                ("exponent of processor time", exponents(runs["whole"], runs["month"], 12.0)),
            ):
                print(f"{words}: " + ", ".join(f"{k} {value:.2f}" for k, value in figures.items()))
        if given.growth:
            runs["reports"] = run(folder / "few", reports=reports // 10, hours=hours, **sizes)
            runs["hours"] = run(folder / "short", reports=reports, hours=hours // 10, **sizes)
            sizes["aircraft"] = AIRCRAFT // 4
            runs["aircraft"] = run(folder / "fewer", reports=reports, hours=hours, **sizes)
            sizes |= {"aircraft": AIRCRAFT, "finer": 2}
            runs["grid"] = run(folder / "finer", reports=reports, hours=hours, **sizes)
            for what, words, ratio in (
                ("reports", "a tenth of the reports", 10.0),
                ("hours", "a tenth of the hours", 10.0),
                ("aircraft", "a quarter of the aircraft, as many reports", 4.0),
                ("grid", "four times the grid points", 0.25),
            ):
                shown(runs[what], words)
                grown = exponents(runs["whole"], runs[what], ratio)
                told = ", ".join(f"{stage} {value:.2f}" for stage, value in grown.items())
                print(f"exponent of processor time: {told}")
        ruc = ruc_hour(folder)
    stages = {stage["name"]: stage for stage in runs["whole"]["accounts"]["stages"]}
    small = sum(stages[stage]["processor"] for stage in ("catalogue", "collocate"))
    rest = sum(stage["processor"] for stage in stages.values()) - small
    full = ruc["sparse"] * HOURS
    print(
        f"\nRUC-size hour: {ruc['sparse'] * 1e3:.1f} ms of processor time from a cold scan, "
        f"{ruc['sparse'] / ruc['plain']:.2f} of plain decoding ({ruc['plain'] * 1e3:.1f} ms)"
    )
    print(
        f"a year on the full grid, one reference: {full:.0f} s for the model and "
        f"{rest / given.share:.0f} s for the rest, processor time of one thread"
    )
    if given.figure:
        draw(runs["whole"], given.figure)
    if given.json:
        given.json.write_text(json.dumps({"runs": runs, "ruc_hour": ruc}, indent=1))


if __name__ == "__main__":
    main()
