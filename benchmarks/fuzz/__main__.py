"""Damage small inputs of every kind, and count the outcomes that must not occur.

    python -m benchmarks.fuzz --cases 10000 --seed 7
    python -m benchmarks.fuzz --replay results/fuzz/case-7-1234.json

Cases run in a process with limits of memory and time (`airswing.guarded`), whole commands among
them. The table counts by kind tracebacks, processes that ended or hang, half-written files,
messages that are too long, impossible winds, and values that differ though a checksum covers them.
Such cases are kept for replay; the exit status is then 1.
"""

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

from benchmarks.fuzz.seeds import GRIBS, make_seeds
from benchmarks.fuzz.targets import answer

from airswing.guarded import WorkerEndedError, guarded

COLUMNS = (*("traceback", "ended", "half-written", "long message", "absurd winds", "silent"),)
"""Outcomes that must not occur."""
SHARES = {
    **dict.fromkeys(GRIBS, 40),
    **{"csv": 80, "csv.gz": 15, "yaml": 90, "effects": 40, "parquet": 35, "netcdf3": 40},
    **{"netcdf4": 35, "bufr": 45, "headings.nc": 6, "fits.nc": 6, "kept notes": 3},
    **{"header cache": 12, "gridded NetCDF-4": 12, "gridded NetCDF-3": 10, "wrfout": 14},
    **{"zarr": 16, "GRIB2 model levels": 10, "GRIB2 Gaussian": 8, "station pairs": 6},
    **{"station observations": 6, "station GRIB": 8, "corrected.nc": 4, "reject list": 4},
    **{"error table": 8, "whole command": 4},
}
"""How often each kind is drawn."""
LONG = {
    *("headings.nc", "fits.nc", "corrected.nc", "kept notes", "reject list", "station pairs"),
    *("station observations", "station GRIB", "GRIB2 model levels", "GRIB2 Gaussian"),
    "whole command",
}
"""Kinds of which a case runs a command or more: a few tenths of a second to some seconds."""


def drawn(cases, seed, shares=SHARES):
    pick = random.Random(seed)
    kinds = pick.choices(list(shares), list(shares.values()), k=cases)
    return [(kind, seed * 1_000_000 + number) for number, kind in enumerate(kinds)]


def campaign(cases, results):
    """Number of each outcome by kind; cases with a forbidden one are kept in a folder."""
    table = defaultdict(Counter)
    with tempfile.TemporaryDirectory(prefix="airswing-fuzz-") as name:
        folder = Path(name)
        os.environ["AIRSWING_CACHE"] = str(folder / "seeds" / "run" / "cache")
        seeds = make_seeds(folder / "seeds")
        # workers inherit these
        os.environ |= {"AIRSWING_CACHE": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
        for number, (kind, seed) in enumerate(cases):
            if number and number % 1000 == 0:
                print(f"  {number:,} cases", file=sys.stderr, flush=True)
            place = folder / "case"
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            try:
                outcome = guarded(answer, kind, seed, seeds, place)
            except WorkerEndedError as error:
                outcome = {"end": "ended", "what": str(error)}
            table[kind][outcome["end"]] += 1
            if outcome["end"] in COLUMNS:
                print(f"  {kind} {seed}: {outcome}", file=sys.stderr, flush=True)
                if results is not None:
                    shutil.copytree(place, results / f"case-{seed}", dirs_exist_ok=True)
                    content = json.dumps({"kind": kind, "seed": seed, **outcome})
                    (results / f"case-{seed}.json").write_text(content)
    return table


def as_text(table):
    ends = ("result", "refused", *COLUMNS)
    rows = {kind: table[kind] for kind in SHARES if kind in table}
    rows["together"] = sum(rows.values(), Counter())
    lines = [f"{'':28}{'cases':>7}" + "".join(f"{end:>14}" for end in ends)]
    for kind, counts in rows.items():
        numbers = "".join(f"{counts[end]:14,}" for end in ends)
        lines.append(f"{kind:28}{counts.total():7,}{numbers}")
    return "\n".join(lines)


def main():
    """Run the campaign, print the table; 1 where a forbidden outcome occurred."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", help="only this kind")
    parser.add_argument("--kept", type=Path, default=Path("results/fuzz"), metavar="DIR")
    parser.add_argument("--replay", type=Path, help="a kept case", metavar="FILE")
    options = parser.parse_args()
    if options.replay is not None:
        replayed = json.loads(options.replay.read_text())
        cases = [(replayed["kind"], replayed["seed"])]
    else:
        cases = drawn(options.cases, options.seed)
        if options.kind:
            cases = [(options.kind, seed) for _, seed in cases]
    options.kept.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    table = campaign(cases, options.kept)
    print(as_text(table))
    print(f"{sum(map(Counter.total, table.values())):,} cases in {time.monotonic() - began:.0f} s")
    return int(any(counts[end] for counts in table.values() for end in COLUMNS))


if __name__ == "__main__":
    raise SystemExit(main())
