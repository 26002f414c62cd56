"""Outcome of a command on a failing machine.

    python -m benchmarks.faults [NAME ...]

Each fault is applied to a command of the package in a separate process, or to the function the
command calls. Allowed are a result, or one message with exit status 2; a traceback, a signal or a
half-written product is a failure, and the exit status is then 1.
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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 3600
Outcome = tuple[bool, str]


def started(
    folder: Path, *words: str, limit: tuple[int, int] | None = None
) -> subprocess.Popen[str]:
    settings = {
        "PYTHONPATH": os.pathsep.join([str(ROOT / "pipeline"), str(ROOT)]),
        "AIRSWING_CACHE": str(folder / "cache"),
        "OMP_NUM_THREADS": "1",
    }

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
        env=os.environ | settings,
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


def disk_full(folder: Path) -> Outcome:
    """No file may grow beyond 24 kB: the system refuses as a full disk does."""
    config = archive(folder)
    limit = (resource.RLIMIT_FSIZE, 24_000)
    return judged(started(folder, "collocate", str(config), limit=limit), folder)


def worker_lost(folder: Path) -> Outcome:
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


def file_changes(folder: Path) -> Outcome:
    from airswing.reference.catalogue import build_catalogue
    from airswing.reference.collocate import collocate
    from airswing.reports import read_reports

    archive(folder)
    reports = read_reports(str(folder / "reports" / "*.csv"))
    files = sorted((folder / "ruc").iterdir())
    victim, counts = files[len(files) // 2], []
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
        counts.append(f"{int(winds['unread_messages'].sum())} problems named")
        victim.write_bytes(before)
    return True, ", ".join(counts) + " (with a new time, with the old one)"


def large_file(folder: Path) -> Outcome:
    """A file of 20 GB, nearly all of it a hole, with whole messages at both ends."""
    archive(folder)
    sound = sorted((folder / "ruc").iterdir())[0].read_bytes()
    path = folder / "large.grb"
    with path.open("wb") as file:
        file.write(sound)
        file.seek(20_000_000_000)
        file.write(sound)
    return judged(started(folder, "inspect", str(path)), folder)


def little_memory(folder: Path) -> Outcome:
    """No more than 1.2 GB of address space (``ulimit -v``)."""
    config = archive(folder)
    limit = (resource.RLIMIT_AS, 1_200_000_000)
    return judged(started(folder, "collocate", str(config), limit=limit), folder)


def two_runs(folder: Path) -> Outcome:
    config = archive(folder)
    first = started(folder, "run", str(config))
    while not (folder / "results" / ".running").exists() and first.poll() is None:
        time.sleep(0.05)
    second = judged(started(folder, "collocate", str(config)), folder / "reports")
    first.kill()
    first.communicate()
    return second[0] and "another run" in second[1], second[1]


FAULTS: dict[str, Callable[[Path], Outcome]] = {
    one.__name__: one
    for one in (
        disk_full,
        worker_lost,
        file_changes,
        large_file,
        little_memory,
        two_runs,
    )
}


def main() -> int:
    """Apply every fault, or those named, and print the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FAULTS)}")
    options = parser.parse_args()
    failed = False
    for name in options.names or FAULTS:
        with tempfile.TemporaryDirectory(prefix="airswing-faults-") as folder:
            began = time.perf_counter()
            good, what = FAULTS[name](Path(folder))
        failed |= not good
        seconds = time.perf_counter() - began
        print(f"{'held ' if good else 'FAILED'} {name:14} {seconds:6.0f} s  {what}", flush=True)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
