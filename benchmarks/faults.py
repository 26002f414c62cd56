"""What a run does when the machine fails it, or when an archive is of an odd shape.

    python -m benchmarks.faults [--long] [NAME ...]

Each fault is put to a command of the package in a process of its own, or to the function the
command calls. A line says what came of it: a result, or one message with exit status 2; a
traceback, a signal or a half-written product is a failure, and the exit status is then 1.
``--long`` takes the largest sizes: 100,000 files, 10,000 aircraft, ten million reports of one.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 3600
Outcome = tuple[bool, str]


def environment(folder: Path) -> dict[str, str]:
    """Of the commands: this package, a header cache of their own."""
    paths = os.pathsep.join([str(ROOT / "pipeline"), str(ROOT)])
    return os.environ | {
        "PYTHONPATH": paths,
        "AIRSWING_CACHE": str(folder / "cache"),
        "OMP_NUM_THREADS": "1",
    }


def started(
    folder: Path,
    *words: str,
    limit: tuple[int, int] | None = None,
    more: Mapping[str, str] | None = None,
) -> subprocess.Popen[str]:
    """Start a command, under a limit of the system where one is given."""

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(limit[0], (limit[1], limit[1]))

    return subprocess.Popen(
        [sys.executable, "-m", "airswing", *words],
        cwd=folder,
        text=True,
        preexec_fn=limited,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(folder) | dict(more or {}),
    )


def judged(process: subprocess.Popen[str], folder: Path) -> Outcome:
    """How a command ended: with a result, or refused in one message."""
    began = time.perf_counter()
    _, message = process.communicate(timeout=PATIENCE)
    seconds = time.perf_counter() - began
    lines = [line for line in message.splitlines() if line.startswith("airswing: ")]
    half = [path.name for path in folder.rglob("*.part")]
    if process.returncode == 0 and not half:
        return True, f"a result after {seconds:.1f} s"
    if process.returncode == 2 and len(lines) == 1 and "Traceback" not in message:
        return True, f"refused: {lines[0].removeprefix('airswing: ')[:150]}"
    last = message.strip().splitlines()[-1:] or [""]
    return False, f"status {process.returncode}, left {half}: {last[0][:200]}"


def archive(folder: Path, **changes: Any) -> Path:
    """A day of two aircraft and two models; its configuration."""
    from airswing.synthetic.archive import write_archive

    write_archive(folder, days=1, aircraft=2, seed=1)
    config = folder / "config.yaml"
    content = yaml.safe_load(config.read_text()) | {"compute": {"workers": 1, "threads": 1}}
    config.write_text(yaml.safe_dump(content | changes))
    return config


def disk_full(folder: Path, long: bool) -> Outcome:
    """No file may grow beyond 24 kB: the system refuses as a full disk does."""
    config = archive(folder)
    limit = (resource.RLIMIT_FSIZE, 24_000)
    return judged(started(folder, "collocate", str(config), limit=limit), folder)


def worker_lost(folder: Path, long: bool) -> Outcome:
    """One of two worker processes is killed while it works."""
    config = archive(folder, compute={"workers": 2, "threads": 1})
    process = started(folder, "collocate", str(config))
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        found = [int(child) for child in children.read_text().split()]
        if len(found) >= 2:
            time.sleep(1.5)
            os.kill(found[-1], signal.SIGKILL)
            break
        time.sleep(0.1)
    return judged(process, folder)


def file_changes(folder: Path, long: bool) -> Outcome:
    """A model file is replaced between the catalogue and the reading."""
    from airswing.reference.catalogue import build_catalogue
    from airswing.reference.collocate import collocate
    from airswing.reports import read_reports

    archive(folder)
    reports = read_reports(str(folder / "reports" / "*.csv"))
    files = sorted((folder / "ruc").iterdir())
    victim, said = files[len(files) // 2], []
    for keep_time in (False, True):
        catalogue = build_catalogue([str(f) for f in files], name="ruc", cache_dir=folder / "c")
        before = victim.read_bytes()
        status = victim.stat()
        victim.write_bytes(bytes(len(before)))
        if keep_time:
            os.utime(victim, ns=(status.st_atime_ns, status.st_mtime_ns))
        winds = collocate(reports, {"ruc": catalogue}, account=True).compute()
        speed = np.hypot(winds["reference_eastward_wind"], winds["reference_northward_wind"])
        if not bool((speed.fillna(0.0) <= 150.0).all()):
            return False, "absurd winds from a replaced file"
        said.append(f"{int(winds['unread_messages'].sum())} problems named")
        victim.write_bytes(before)
    return True, ", ".join(said) + " (with a new time, with the old one)"


def clock_changes(folder: Path, long: bool) -> Outcome:
    """Files from before 1970 and from the next century."""
    config = archive(folder)
    for number, path in enumerate(sorted((folder / "ruc").iterdir())):
        os.utime(path, (-86_400, -86_400) if number % 2 else (4e9, 4e9))
    return judged(started(folder, "collocate", str(config)), folder)


def small_files(folder: Path, long: bool) -> Outcome:
    """Very many small model files."""
    from airswing.reference.catalogue import build_catalogue

    archive(folder)
    sound = sorted((folder / "ruc").iterdir())[0].read_bytes()
    count = 100_000 if long else 4_000
    many = folder / "many"
    many.mkdir()
    for number in range(count):
        (many / f"{number:06d}.grb").write_bytes(sound)
    began = time.perf_counter()
    catalogue = build_catalogue(str(many / "*"), name="ruc", cache_dir=folder / "c")
    first = time.perf_counter() - began
    began = time.perf_counter()
    build_catalogue(str(many / "*"), name="ruc", cache_dir=folder / "c")
    again = time.perf_counter() - began
    return len(
        catalogue
    ) > 0, f"{count:,} files catalogued in {first:.1f} s, again in {again:.1f} s"


def large_file(folder: Path, long: bool) -> Outcome:
    """A file of 20 GB, nearly all of it a hole, with whole messages at both ends."""
    archive(folder)
    sound = sorted((folder / "ruc").iterdir())[0].read_bytes()
    path = folder / "large.grb"
    with path.open("wb") as file:
        file.write(sound)
        file.seek(20_000_000_000)
        file.write(sound)
    return judged(started(folder, "inspect", str(path)), folder)


def little_memory(folder: Path, long: bool) -> Outcome:
    """No more than 1.2 GB of address space (``ulimit -v``)."""
    config = archive(folder)
    limit = (resource.RLIMIT_AS, 1_200_000_000)
    return judged(started(folder, "collocate", str(config), limit=limit), folder)


def two_runs(folder: Path, long: bool) -> Outcome:
    """A second run into the folder of one that is under way."""
    config = archive(folder)
    first = started(folder, "run", str(config))
    while not (folder / "results" / ".running").exists() and first.poll() is None:
        time.sleep(0.05)
    second = judged(started(folder, "collocate", str(config)), folder / "reports")
    first.kill()
    first.communicate()
    return second[0] and "another run" in second[1], second[1]


def fleet(folder: Path, aircraft: int, reports: int) -> Path:
    """Aircraft on straight legs over a small model, deviations of their own; the configuration."""
    from benchmarks.year import LEG, write_fields, write_reports

    hours = 24 * max(reports // aircraft // 20_000, 2)
    legs = max(reports // (aircraft * LEG), 1)
    write_fields(folder / "model", hours)
    write_reports(folder / "reports", aircraft * LEG * legs, hours, aircraft)
    if reports < aircraft * LEG:  # fewer than a leg: the first of it
        each = reports // aircraft
        for path in sorted((folder / "reports").iterdir()):
            table = pd.read_parquet(path)
            table[table.groupby("tail").cumcount() < each].to_parquet(path, index=False)
    content = {
        "reports": {"files": str(folder / "reports" / "*.parquet")},
        "references": {"model": {"files": str(folder / "model" / "*.grb")}},
        "output": str(folder / "out"),
        "compute": {"workers": 1, "threads": 2},
    }
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(content))
    return config


def many_aircraft(folder: Path, long: bool) -> Outcome:
    """10,000 aircraft of ten reports each, to the corrected winds (1,000 where not long)."""
    count = 10_000 if long else 1_000
    return staged(folder, fleet(folder, count, 10 * count))


def one_aircraft(folder: Path, long: bool) -> Outcome:
    """One aircraft of ten million reports (200,000 where not long), to the corrected winds."""
    return staged(folder, fleet(folder, 1, 10_000_000 if long else 200_000))


def staged(folder: Path, config: Path) -> Outcome:
    """Every stage of the main job but its evaluation and page; none may refuse."""
    said = []
    for stage in ("collocate", "fit", "correct"):
        good, what = judged(started(folder, stage, str(config), "--quiet"), folder)
        said.append(f"{stage}: {what}")
        if not good or "refused" in what:
            return False, ", ".join(said)
    return True, ", ".join(said)


def slow_disk(folder: Path, long: bool) -> Outcome:
    """Every read of a model file takes 20 ms longer, as over a bad network."""
    config = archive(folder)
    hook = folder / "slow"
    hook.mkdir()
    (hook / "sitecustomize.py").write_text(SLOW.format(folder=str(folder)))
    paths = {"PYTHONPATH": os.pathsep.join([str(hook), environment(folder)["PYTHONPATH"]])}
    process = started(folder, "collocate", str(config), more=paths)
    good, what = judged(process, folder)
    message = folder / "slow.txt"
    return good and message.exists(), f"{what}, {len(message.read_text())} reads slowed"


SLOW = """
import os, time
true, folder = os.pread, {folder!r}

def pread(descriptor, length, offset):
    name = os.readlink(f"/proc/self/fd/{{descriptor}}")
    if name.startswith(folder) and not name.endswith((".sqlite", ".npy")):
        time.sleep(0.02)
        with open(os.path.join(folder, "slow.txt"), "a") as file:
            file.write(".")
    return true(descriptor, length, offset)

os.pread = pread
"""
"""Read at the start of the process that is to find its disk slow."""


FAULTS: dict[str, Callable[[Path, bool], Outcome]] = {
    one.__name__: one
    for one in (
        disk_full,
        worker_lost,
        file_changes,
        clock_changes,
        small_files,
        large_file,
        little_memory,
        two_runs,
        slow_disk,
        many_aircraft,
        one_aircraft,
    )
}


def main() -> int:
    """Put every fault, or those named, and print what came of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FAULTS)}")
    parser.add_argument("--long", action="store_true", help="at the sizes that are asked for")
    options = parser.parse_args()
    failed = False
    for name in options.names or FAULTS:
        with tempfile.TemporaryDirectory(prefix="airswing-faults-") as folder:
            began = time.perf_counter()
            good, what = FAULTS[name](Path(folder), options.long)
        failed |= not good
        seconds = time.perf_counter() - began
        print(f"{'held ' if good else 'FAILED'} {name:14} {seconds:6.0f} s  {what}", flush=True)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
