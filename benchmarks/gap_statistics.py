"""Time and memory of the one pass over an archive's reports, from collocated headings to sums.

    python -m benchmarks.gap_statistics --reports 10000000 --aircraft 60

The input is written first, to a folder that is removed at the end: a headings file of toy flights
repeated under new days, as collocation leaves it, one aircraft after the other. Measured, in a
process of its own: reading it in pieces, the winds and noise of the whole, whitening and summing
all columns, taking the days' fields out. The bars are those of ten million reports (120 s on two
workers, 4 GiB), in proportion for fewer; seconds are the wall clock's or, where a busy machine has
fewer cores to give, the processor's over the workers, whichever is less. Beside it stands what
numpy alone takes for X'X of blocks of the same size. Exit status 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from airswing.gap.archive import headings_columns as columns
from airswing.gap.diagnose import usable_effects
from airswing.gap.effects import CATALOGUE
from airswing.gap.sums.elimination import eliminate_days
from airswing.gap.sums.pieces import pieces_of_headings, prepare, statistics_of_pieces

SECONDS, MEMORY, REPORTS = 120.0, 4.0, 10_000_000
WEEK = 7
"""Days of the toy flights that are repeated; two toy aircraft make one: 445 reports a day."""


def write_headings(path: Path, reports: int, aircraft: int) -> int:
    """Write about this many reports of so many aircraft; say how many."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests.gap.toy import make_frame

    names = columns._PER_REPORT | columns._PER_REFERENCE
    rows = []
    with netCDF4.Dataset(path, "w") as file:
        for name, size in (("report", None), ("aircraft", aircraft), ("reference", 1)):
            file.createDimension(name, size)
        for name, _ in names.values():
            _variable(file, name, "f4")
        for name, kind in (("time", "f8"), ("flight", "i8"), ("phase", "i1"), ("icing", "i1")):
            _variable(file, name, kind)
        file["time"].units = "seconds since 2005-01-01"
        flights, start = 0, 0
        for k in range(aircraft):
            week = make_frame(seed=k, aircraft=2, days=WEEK)
            copies = max(1, round(reports / aircraft / week.size))
            which = np.repeat(np.arange(copies), week.size)
            moved = np.tile(week.time, copies) + which * WEEK * 86400.0
            flight = flights + np.tile(week.flight, copies) + which * int(week.flight.max() + 1)
            order = np.lexsort((moved, flight))
            own = slice(start, start + order.size)
            start, flights = own.stop, int(flight.max())
            for field, (name, angle) in names.items():
                values = np.tile(getattr(week, field), copies)[order]
                file[name][own] = np.degrees(values) if angle else values
            file["time"][own], file["flight"][own] = moved[order], flight[order]
            for name in ("phase", "icing"):
                file[name][own] = np.tile(getattr(week, name), copies)[order]
            rows.append(order.size)
        file.createVariable("row_size", "i8", ("aircraft",))[:] = rows
        tails = np.array([f"N{k + 1:03d}" for k in range(aircraft)], dtype=object)
        file.createVariable("aircraft", str, ("aircraft",))[:] = tails
        file.createVariable("reference", str, ("reference",))[:] = np.array(["toy"], dtype=object)
    return start


def _variable(file: Any, name: str, kind: str) -> None:
    file.createVariable(
        name, kind, ("report",), zlib=True, complevel=1, shuffle=True, chunksizes=(65536,)
    )


def measure(path: Path, workers: int) -> dict[str, Any]:
    """Go from the headings to the sums and say what each step took."""
    laps: dict[str, Any] = {}
    begin = mark = (time.perf_counter(), time.process_time())

    def lap(name: str) -> None:
        nonlocal mark
        now = time.perf_counter(), time.process_time()
        laps[name] = [round(b - a, 2) for a, b in zip(mark, now, strict=True)]
        mark = now

    netCDF4.set_chunk_cache(1 << 20)  # a chunk or two; by default 16 MiB of every variable
    with xr.open_dataset(path, engine="netcdf4") as ds:
        pieces = pieces_of_headings(ds, reference="toy")
        ready = prepare(pieces, workers=workers)
        lap("winds, noise, plan")
        effects, _ = usable_effects(ready.sample, CATALOGUE)
        stats = statistics_of_pieces(pieces, ready, effects=effects, workers=workers)
        lap("columns, whitening, sums")
    eliminate_days(stats)
    lap("days' fields out")
    whole = [round(b - a, 2) for a, b in zip(begin, mark, strict=True)]
    size = stats.layout.size
    return {
        "reports": int(stats.day_count.sum() + stats.gross.sum()), "aircraft": len(stats.tails),
        "days": int(stats.days.size), "columns": size, "core": stats.layout.core, "laps": laps,
        "wall": whole[0], "processor": whole[1],
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
        "numpy": products_alone(size, pieces.size // (len(stats.tails) * stats.weeks.size)),
    }  # fmt: skip


def products_alone(columns: int, reports: int) -> float:
    """Processor time of numpy's X'X of a block, seconds a report."""
    block = np.random.default_rng(0).normal(size=(2 * reports, columns)).astype(np.float32)
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        for _ in range(5):
            block.T @ block
        best = min(best, (time.process_time() - start) / 5 / reports)
    return best


def main() -> int:
    """Write the input, measure in a process of its own, print the table; 1 where a bar is missed.

    Returns
    -------
    int
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=int, default=500_000)
    parser.add_argument("--aircraft", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="of the temporary input")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure is not None:
        print(json.dumps(measure(options.measure, options.workers)))
        return 0
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        path = Path(folder) / "headings.nc"
        write_headings(path, options.reports, options.aircraft)
        command = [sys.executable, __file__, "--measure", str(path)]
        command += ["--workers", str(options.workers)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return told(found, options.workers)


def told(found: dict[str, Any], workers: int) -> int:
    """Print what was measured against the bars; 1 where one is missed."""
    print(
        f"{found['reports']:,} reports, {found['aircraft']} aircraft, {found['days']} days, "
        f"{found['columns']} columns ({found['core']} core), {workers} workers\n"
    )
    for name, (wall, processor) in found["laps"].items():
        print(f"{name:28} {wall:8.1f} s  {processor:8.1f} s of processor")
    share = min(1.0, found["reports"] / REPORTS) if found["reports"] < 0.95 * REPORTS else 1.0
    seconds = min(found["wall"], found["processor"] / workers)
    print(
        f"{'in all':28} {found['wall']:8.1f} s  {found['processor']:8.1f} s of processor, "
        f"{1e6 * found['processor'] / found['reports']:.1f} us a report\n"
        f"{'of numpy alone for X-prime-X':28} {1e6 * found['numpy']:8.2f} us a report: the pass "
        f"takes {found['processor'] / found['reports'] / found['numpy']:.1f} times that\n"
        f"{'seconds':28} {seconds:8.1f}    bar {SECONDS * share:.0f}\n"
        f"{'peak memory':28} {found['peak']:8.2f}    bar {MEMORY:.0f} GiB"
    )
    return int(seconds > SECONDS * share or found["peak"] > MEMORY)


if __name__ == "__main__":
    sys.exit(main())
