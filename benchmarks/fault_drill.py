"""Runs killed at random moments and continued: equal products to those of an undisturbed run.

    python -m benchmarks.fault_drill --kills 20 [--days 63] [--aircraft 4] [--workers 1]

A sample archive is run once undisturbed. Then runs of the same configuration are killed (SIGKILL)
at random moments and started again. Every completed run is compared bit for bit, apart from
identifiers and history. With ``--workers`` the process to be killed is drawn among all processes.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr
import yaml

PER_RUN = 4
"""Kills after which a run is completed."""
IDENTIFIERS = {"uuid", "source_uuids", "history", "date_created"}
SKIPPED = {".html", ".svg", ".png", ".pdf"}
"""The page is drawn from the products compared here, and carries their identifiers."""
NOTES = (".airswing", "events.json")
"""Notes that name products by their identifier; which events are new depends on earlier runs."""


def start(config):
    return subprocess.Popen(
        [sys.executable, "-m", "airswing", "run", str(config), "--quiet"],
        cwd=config.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"AIRSWING_CACHE": str(config.parent / "cache")},
    )


def finish(config):
    """Run to the end; its duration, s."""
    began = time.perf_counter()
    process = start(config)
    _, message = process.communicate()
    if process.returncode:
        raise SystemExit(f"the run failed: {message.decode()[-2000:]}")
    return time.perf_counter() - began


def family(parent):
    """A process and the worker processes below it (Linux)."""
    processes = [parent]
    for number in processes:
        for task in Path(f"/proc/{number}/task").glob("*/children"):
            processes += [int(child) for child in task.read_text().split()]
    return processes


def kill_at(config, moment, pick):
    """Start a run and kill it, or one of its workers, at a moment; describe the outcome."""
    process = start(config)
    try:
        process.communicate(timeout=moment)
    except subprocess.TimeoutExpired:
        victim = pick.choice(family(process.pid))
        os.kill(victim, signal.SIGKILL)
        _, message = process.communicate()
        if victim != process.pid and process.returncode not in (0, 2):
            raise SystemExit(f"a lost worker is no clear end: {message.decode()[-2000:]}") from None
        return "killed" if victim == process.pid else "worker killed"
    return "ended before"


def files_of(folder):
    files = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    return {str(name) for name in files if name.parts[0] not in NOTES}


def differences(before, after):
    lines = [f"only in one: {name}" for name in sorted(files_of(before) ^ files_of(after))]
    for name in sorted(files_of(before) & files_of(after)):
        first, second = before / name, after / name
        if first.suffix == ".nc":
            lines += [f"{name}: {difference}" for difference in product_differences(first, second)]
        elif first.suffix not in SKIPPED and first.read_bytes() != second.read_bytes():
            lines.append(name)
    return lines


def product_differences(before, after):
    options = {"engine": "netcdf4", "decode_cf": False}
    with xr.open_dataset(before, **options) as a, xr.open_dataset(after, **options) as b:
        if set(a.variables) != set(b.variables):
            return ["other variables"]
        names = [
            str(name)
            for name in a.variables
            if a[name].dtype != b[name].dtype
            or not np.array_equal(
                a[name].to_numpy(), b[name].to_numpy(), equal_nan=a[name].dtype.kind == "f"
            )
            or not xr.Dataset(attrs=a[name].attrs).identical(xr.Dataset(attrs=b[name].attrs))
        ]
        keys = (set(a.attrs) | set(b.attrs)) - IDENTIFIERS
        return names + [f"attribute {key}" for key in keys if a.attrs.get(key) != b.attrs.get(key)]


def drill(config, *, kills, seed=1):
    """Kill and continue runs of a configuration; seconds of the undisturbed one, differences."""
    output, pick = Path(yaml.safe_load(config.read_text())["output"]), random.Random(seed)
    undisturbed = finish(config)
    truth = output.with_name("undisturbed")
    output.rename(truth)
    done = compared = 0
    wrong = []
    while done < kills:
        shutil.rmtree(output, ignore_errors=True)
        shutil.rmtree(config.parent / "cache", ignore_errors=True)
        for _ in range(min(PER_RUN, kills - done)):
            moment = pick.uniform(0.0, undisturbed)
            outcome = kill_at(config, moment, pick)
            done += outcome != "ended before"
            print(f"kill {done:3d}: {outcome} at {moment:6.1f} s of {undisturbed:.1f}", flush=True)
        seconds = finish(config)
        lines = differences(truth, output)
        wrong += lines
        compared += 1
        print(f"continued to its end in {seconds:.1f} s: {lines or 'equal'}", flush=True)
    return {"seconds": undisturbed, "kills": done, "runs": compared, "differences": wrong}


def main():
    """Write the archive, drill, and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--days", type=int, default=63)
    parser.add_argument("--aircraft", type=int, default=4)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    from airswing.synthetic.archive import write_archive

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_archive(folder, days=options.days, aircraft=options.aircraft, seed=options.seed)
        config = folder / "config.yaml"
        content = yaml.safe_load(config.read_text()) | {"compute": {"workers": options.workers}}
        config.write_text(yaml.safe_dump(content))
        result = drill(config, kills=options.kills, seed=options.seed)
    print(
        f"fault drill: {result['kills']} kills over {result['runs']} runs of {options.days} days "
        f"({result['seconds']:.0f} s undisturbed): {len(result['differences'])} differences"
    )
    if result["differences"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
