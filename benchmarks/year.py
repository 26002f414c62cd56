"""Year of a fleet end to end: processor time and peak memory by stage, and one further night.

    python -m benchmarks.year [--share 1.0] [--workers 1]

Makes 8,760 hourly GRIB1 files (24 x 18 points, six levels, u and v) and 10 million reports of 60
aircraft, a Parquet file a day, or a share of both. The job runs in a separate process, first
without the last day, then again with it, which remakes the last month and everything after it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from tests.reference.builders import build, grid_keys

from airswing.physics.geomagnetism import geomagnetic_field
from airswing.units import FOOT

START = np.datetime64("2009-01-01T00:00:00", "s")
HOURS, REPORTS, AIRCRAFT = 8760, 10_000_000, 60
NI, NJ, LEVELS = 24, 18, (500, 450, 400, 350, 300, 250)
SOUTH, WEST, STEP = 36.0, -96.0, 0.75
LEG = 38
"""Reports a leg, a minute apart."""


def wind(latitude, longitude, hour):
    """True wind, m/s: linear in space and slow in time, so that interpolation adds 0.02 at most."""
    x, y = (longitude - WEST) / (NI * STEP), (latitude - SOUTH) / (NJ * STEP)
    trough, jet = np.sin(hour * 2 * np.pi / 97.0), np.cos(hour * 2 * np.pi / 229.0)
    east = 12.0 + 8.0 * jet + (10.0 + 6.0 * trough) * y + 4.0 * x
    return east, -4.0 + 11.0 * trough + 9.0 * jet * x - 3.0 * y


def write_fields(folder, hours, *, step=1):
    """One file every hour, or every few hours."""
    lat, lon = np.meshgrid(SOUTH + STEP * np.arange(NJ), WEST + STEP * np.arange(NI), indexing="ij")
    last = WEST + STEP * (NI - 1), SOUTH + STEP * (NJ - 1)
    grid = grid_keys("regular_ll", (NI, NJ), (WEST, SOUTH), last)
    folder.mkdir()
    for hour in range(0, hours, step):
        when = pd.Timestamp(START) + pd.Timedelta(hours=hour)
        stamp = int(f"{when:%Y%m%d}"), int(f"{when:%H}00")
        messages = [
            build(grid, values.ravel(), edition=1, parameter=name, level=level, when=stamp)
            for level in LEVELS
            for name, values in zip("uv", wind(lat, lon, hour), strict=True)
        ]
        (folder / f"{when:%Y%m%d%H}.grb").write_bytes(b"".join(messages))


def write_reports(folder, reports, hours, aircraft):
    """Straight legs of one speed, winds with each aircraft's deviation, a file a day."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    legs = max(reports // (aircraft * LEG), 1)
    pieces = []
    for number in range(aircraft):
        slot = (hours - 2) * 3600.0 / legs
        begin = 3600.0 + slot * np.arange(legs)
        since = np.arange(LEG) * min(60.0, 0.8 * slot / LEG)
        seconds = begin[:, None] + since
        track, speed = rng.uniform(0, 2 * np.pi, legs), rng.uniform(110.0, 150.0, legs)
        lat0, lon0 = rng.uniform(40.5, 44.5, legs), rng.uniform(-91.0, -84.0, legs)
        along = speed[:, None] * since / 111_195.0
        lat = lat0[:, None] + along * np.cos(track)[:, None]
        middle = np.radians(lat0[:, None] + 0.5 * along * np.cos(track)[:, None])
        lon = lon0[:, None] + along * np.sin(track)[:, None] / np.cos(middle)
        height = np.broadcast_to(rng.integers(220, 300, legs)[:, None] * 100, lat.shape)
        u, v = wind(lat, lon, seconds / 3600.0)
        ground = np.broadcast_to((speed * np.exp(1j * (np.pi / 2 - track)))[:, None], lat.shape)
        error = 1.2 * (rng.normal(size=(2, legs, 1)) + rng.normal(size=(2, legs, LEG)))
        air = ground - (u + error[0]) - 1j * (v + error[1])
        epoch = START.astype(np.float64) + seconds
        field = geomagnetic_field(lat, lon, height * FOOT, epoch)
        magnetic = np.pi / 2 - np.angle(air) - field.declination
        offset, size, phase = rng.uniform(-1, 1), rng.uniform(0.5, 6), rng.uniform(-np.pi, np.pi)
        iron = size * 19_000.0 / field.horizontal  # nT
        wrong = np.zeros_like(lat)
        for _ in range(5):  # a function of the indicated heading
            wrong = np.radians(offset + iron * np.sin(magnetic + wrong + phase))
        sent = ground - air * np.exp(-1j * wrong)
        stamp = START + seconds.round().astype("timedelta64[s]")
        direction = np.degrees(np.arctan2(-sent.real, -sent.imag)) % 360
        pieces.append(
            pd.DataFrame(
                {
                    "tail": f"N{100 + number}",
                    "time": stamp.ravel(),
                    "latitude": lat.round(4).ravel(),
                    "longitude": lon.round(4).ravel(),
                    "pressure_altitude_ft": height.ravel().astype(np.float32),
                    "wind_direction_deg": direction.round().ravel().astype(np.float32),
                    "wind_speed_kt": (np.abs(sent) / 0.514444).round().ravel().astype(np.float32),
                    "phase": "cruise",
                    "roll_flag": "G",
                    "temperature_qc": "pass",
                }
            )
        )
    table = pd.concat(pieces, ignore_index=True)
    for day, piece in table.groupby(table["time"].dt.date):
        piece.to_parquet(folder / f"{day}.parquet", index=False)


def measured(config):
    """Run the job in this process; print its accounts, with memory by stage, as JSON."""
    import contextlib

    from airswing import workflow
    from airswing.config_file import load_config
    from airswing.workflow.job import resources
    from airswing.workflow.progress import Progress

    class Watched(Progress):
        @contextlib.contextmanager
        def stage(self, name):
            Path("/proc/self/clear_refs").write_text("5")
            began = time.process_time()
            with super().stage(name) as record:
                yield record
            used = time.process_time() - began
            stages.append({"name": name, "processor": used, "peak": memory("VmHWM")})

    stages = []
    job = workflow.Job(load_config(config), Watched())
    with resources(job.config.compute, job.progress):
        summary = workflow.run_job(job).summary
    account = {name: summary[name] for name in ("reports", "months")}
    print(json.dumps(account | {"stages": stages, "processor": time.process_time()}))


def memory(key):
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024
    return 0


def run_on(folder, *, workers=1):
    """Run the job on an archive in a separate process; its accounts."""
    content = {
        "reports": {"files": str(folder / "reports/*.parquet")},
        "references": {"small": {"files": str(folder / "model/*.grb")}},
        "output": str(folder / "results"),
        "compute": {"workers": workers},
    }
    config = folder / "config.json"
    config.write_text(json.dumps(content))
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.year", "--measured", str(config)],
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout) | {"wall": time.perf_counter() - began}


def shown(account, title):
    reports, months = account["reports"]["usable"], account["months"]
    print(f"\n{title}: {reports:,} reports; {len(months['made'])} months made")
    print(f"{'stage':<22}{'processor s':>12}{'peak MB':>9}")
    total = {}
    for stage in account["stages"]:
        name = stage["name"].rstrip("-0123456789 ")  # months of a stage together
        before = total.get(name, [0.0, 0.0])
        total[name] = [before[0] + stage["processor"], max(before[1], stage["peak"])]
    for name, (seconds, peak) in total.items():
        print(f"{name:<22}{seconds:12.1f}{peak / 1e6:9.0f}")
    most = max(peak for _, peak in total.values())
    used = f"{account['processor']:12.1f}{most / 1e6:9.0f}"
    print(f"{'together':<22}{used}   wall {account['wall']:.0f} s")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of hours and of reports")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--measured", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measured:
        measured(options.measured)
        return
    hours, reports = round(HOURS * options.share), round(REPORTS * options.share)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_fields(folder / "model", hours)
        write_reports(folder / "reports", reports, hours, AIRCRAFT)
        last = max((folder / "reports").iterdir())
        aside = last.rename(folder / last.name)
        shown(run_on(folder, workers=options.workers), f"{hours:,} hours, all made")
        aside.rename(last)
        shown(run_on(folder, workers=options.workers), "one further night")


if __name__ == "__main__":
    main()
