"""A month's run killed at random moments and continued: the products equal the undisturbed run's.

A sample archive is written to a temporary folder and run once undisturbed. Then runs of the same
configuration are started anew, killed (SIGKILL) at moments drawn evenly over the undisturbed
run's time, and continued with ``--resume``, until the asked number of kills is reached; every
run that comes to its end is compared: each variable of each product bit for bit, their
attributes apart from identifiers and history, and every other file octet for octet. With
``--workers`` the work runs in processes, and the victim is drawn among them and the main process.
With ``--update`` the job is ``airswing update`` in place of ``airswing run`` and ``--resume``.
With ``--adding`` every run begins from a finished one of the first two thirds of the reports, to
which the last third is added, and is compared with the run of all of them from scratch (an update:
with an undisturbed update from there). The archive begins on 1 March: of 34 days the last third
holds a month's end, of 63 the second one, after which an update tries tables out (the virtual
field test).

    python -m benchmarks.fault_drill --kills 20
    python -m benchmarks.fault_drill --update --adding --kills 20 --days 63 --aircraft 2
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
import yaml

COMMAND, UPDATE = ([sys.executable, "-m", "airswing", job] for job in ("run", "update"))
PER_RUN = 4
"""Kills after which a run is let come to its end."""
IDENTIFIERS = {"uuid", "source_uuids", "history", "fingerprint", "unscreened_fingerprint"}
SKIPPED = {".html", ".svg", ".png", ".pdf"}
"""The page is drawn from the products compared here, and carries their identifiers."""

DRAWN = re.compile(r"\.collocated/(reports/|(\d{4}-\d\d/)?headings\.json)|\.update/|events\.json")
"""Where kept reports lie, under names of no meaning, and notes that name products by their
identifier; what is made of them is compared. Which events are new depends on who asked before."""


def start(config: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start the main job in a process of its own; an update where that is the word."""
    updates = words == ("update",)
    command = [*(UPDATE if updates else COMMAND), str(config), "--quiet", *words[updates:]]
    return subprocess.Popen(
        command,
        cwd=config.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"AIRSWING_CACHE": str(config.parent / "cache")},
    )


def finish(config: Path, *words: str) -> float:
    """Run to the end; the time it took, s."""
    began = time.perf_counter()
    process = start(config, *words)
    _, message = process.communicate()
    if process.returncode:
        raise SystemExit(f"the run failed: {message.decode()[-2000:]}")
    return time.perf_counter() - began


def family(parent: int) -> list[int]:
    """A process and the worker processes below it (Linux)."""
    found = [parent]
    for number in found:
        for task in Path(f"/proc/{number}/task").glob("*/children"):
            found += [int(child) for child in task.read_text().split()]
    return found


def kill_at(config: Path, moment: float, pick: random.Random, *words: str) -> str:
    """Start a run and kill it, or one of its workers, at a moment; say what happened."""
    process = start(config, *words)
    try:
        process.communicate(timeout=moment)
    except subprocess.TimeoutExpired:
        victim = pick.choice(family(process.pid))
        os.kill(victim, signal.SIGKILL)
        if victim == process.pid:
            process.communicate()
            return "killed"
        _, message = process.communicate()
        if process.returncode not in (0, 2):
            raise SystemExit(f"a lost worker is no clear end: {message.decode()[-2000:]}") from None
        return "worker killed"
    return "ended before"


def files_of(folder: Path) -> set[str]:
    """Names of everything a run left, hidden files included, but for those drawn by lot."""
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    return {name for name in found if not DRAWN.match(name) or name.endswith(".part")}


def differences(one: Path, other: Path) -> list[str]:
    """What differs between the products of two runs."""
    found = [f"only in one: {name}" for name in sorted(files_of(one) ^ files_of(other))]
    for name in sorted(files_of(one) & files_of(other)):
        first, second = one / name, other / name
        if first.suffix == ".nc":
            found += [f"{name}: {what}" for what in product_differences(first, second)]
        elif first.suffix not in SKIPPED and first.read_bytes() != second.read_bytes():
            found.append(name)
    return found


def product_differences(one: Path, other: Path) -> list[str]:
    """Variables and attributes that differ between two products."""
    options = {"engine": "netcdf4", "decode_cf": False}
    with xr.open_dataset(one, **options) as a, xr.open_dataset(other, **options) as b:
        if set(a.variables) != set(b.variables):
            return ["other variables"]
        found = [
            str(name)
            for name in a.variables
            if a[name].dtype != b[name].dtype
            or not np.array_equal(
                a[name].to_numpy(), b[name].to_numpy(), equal_nan=a[name].dtype.kind == "f"
            )
            or not xr.Dataset(attrs=a[name].attrs).identical(xr.Dataset(attrs=b[name].attrs))
        ]
        keys = (set(a.attrs) | set(b.attrs)) - IDENTIFIERS
        return found + [f"attribute {key}" for key in keys if a.attrs.get(key) != b.attrs.get(key)]


def run_of_the_first(config: Path, output: Path, *words: str) -> Path:
    """Run the first two thirds of the reports; where its results are, the others put beside."""
    later = {}
    for table in sorted((config.parent / "reports").glob("*.csv")):
        frame = pd.read_csv(table, dtype=str, keep_default_na=False)
        last = frame["time"].sort_values().iloc[2 * len(frame) // 3]
        later[table.with_stem(f"{table.stem}_later")] = frame[frame["time"] >= last]
        frame[frame["time"] < last].to_csv(table, index=False)
    finish(config, *words)
    for path, rows in later.items():
        rows.to_csv(path, index=False)
    return output.rename(output.with_name("first"))


def drill(
    config: Path,
    *,
    kills: int,
    seed: int,
    longest: float | None = None,
    adding: bool = False,
    update: bool = False,
) -> dict[str, float]:
    """Kill, continue and compare until enough kills are done.

    Returns the undisturbed run's time, the number of kills, of compared runs and of differences.
    """
    output, pick = Path(yaml.safe_load(config.read_text())["output"]), random.Random(seed)
    anew: tuple[str, ...] = ("update",) if update else ()
    resumed = anew or ("--resume",)
    first = run_of_the_first(config, output, *anew) if adding else None
    if first is not None and update:  # what an update gives hangs on where the last one stood
        shutil.copytree(first, output)
    undisturbed = finish(config, *anew)
    truth = output.with_name("undisturbed")
    output.rename(truth)
    if first is not None and update:
        before, after = (
            " and ".join(sorted(path.stem for path in (folder / "headings").glob("*.nc")))
            for folder in (first, truth)
        )
        print(f"months before the kills: {before}; after: {after}", flush=True)
    done = compared = 0
    wrong: list[str] = []
    longest = undisturbed if longest is None else longest
    while done < kills:
        shutil.rmtree(output, ignore_errors=True)
        shutil.rmtree(config.parent / "cache", ignore_errors=True)
        words = anew
        if first is not None:
            shutil.copytree(first, output)
            words = resumed
        for _ in range(min(PER_RUN, kills - done)):
            moment = pick.uniform(0.0, longest)
            what = kill_at(config, moment, pick, *words)
            done += what != "ended before"
            print(f"kill {done:3d}: {what} at {moment:6.1f} s of {longest:.1f}", flush=True)
            words = resumed
        seconds = finish(config, *resumed)
        found = differences(truth, output)
        wrong += found
        compared += 1
        print(f"continued to its end in {seconds:.1f} s: {found or 'equal'}", flush=True)
    return {"seconds": undisturbed, "kills": done, "runs": compared, "differences": len(wrong)}


def main() -> None:
    """Write the archive, drill, and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--aircraft", type=int, default=6)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--adding", action="store_true", help="kill additions to a finished run")
    parser.add_argument("--update", action="store_true", help="kill updates, not runs")
    options = parser.parse_args()
    from airswing.synthetic.sample.sample_archive import write_archive

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_archive(folder, days=options.days, aircraft=options.aircraft, seed=options.seed)
        config = folder / "config.yaml"
        content = yaml.safe_load(config.read_text()) | {"compute": {"workers": options.workers}}
        config.write_text(yaml.safe_dump(content))
        asked = {"adding": options.adding, "update": options.update}
        found = drill(config, kills=options.kills, seed=options.seed, **asked)
    print(
        f"fault drill: {found['kills']} kills over {found['runs']} runs of {options.days} days "
        f"({found['seconds']:.0f} s undisturbed): {found['differences']} differences"
    )
    if found["differences"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
