"""A day added to a year by ``airswing update``: its cost by stage, beside the day alone.

    python -m benchmarks.update [--share 0.1] [--hours 8760] [--nights 3] [--no-scratch]

The archive of `benchmarks.year` with a file of reports a day. All but the last nights are taken up;
then each night's reports and model files are put beside them and taken up. With ``--hours 1464``
the last three nights are of the last day of a month, of the first of the next, when a month is
complete, and of the day after. The last day alone is run too, and the whole from scratch without
evaluation and page. Printed: what each stage took, the processor time of every night against the
bar (1.5 times the day alone and 10 s; wall times tell little on a shared machine), how far fits,
tables and corrected winds are from those from scratch, in standard errors, and what was written.
Fits further than a tenth of their standard errors, an older month written without need, or a night
over the bar end with status 1.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from benchmarks import year

FACTOR, ADDED = 1.5, 10.0
"""What a night may take: so many times the day alone, and so many seconds."""
NEAR = 0.1
"""Standard errors from a run from scratch."""


def write_archive(folder: Path, hours: int, reports: int) -> list[str]:
    """The archive with a file of reports a day; its days."""
    folder.mkdir()
    year.write_fields(folder / "model", hours)
    year.write_reports(folder / "twelfths", reports, hours, year.AIRCRAFT)
    (folder / "reports").mkdir()
    for path in sorted((folder / "twelfths").iterdir()):
        table = pd.read_parquet(path)
        for day, part in table.groupby(table["time"].dt.date):
            # a day in which one twelfth ends and the next begins has two files
            part.to_parquet(folder / f"reports/{day}_{path.stem}.parquet", index=False)
        path.unlink()
    return sorted({path.name[:10] for path in (folder / "reports").iterdir()})


def move(folder: Path, aside: Path, days: list[str], *, back: bool = False) -> None:
    """Move the files of some days out of the archive, or back into it."""
    for kind in ("reports", "model"):
        here, there = folder / kind, aside / kind
        there.mkdir(parents=True, exist_ok=True)
        for path in (there if back else here).iterdir():
            name = path.name[:10] if kind == "reports" else str(pd.Timestamp(path.name[:8]).date())
            if name in days:
                path.rename((here if back else there) / path.name)


def apart(folder: Path) -> dict[str, float]:
    """Largest differences of the update's products from those from scratch."""
    from airswing.products.netcdf import read_product

    one, other = (read_product(folder / name / "fits.nc") for name in ("results", "scratch"))
    error = np.sqrt(np.einsum("rkii->rki", other["deviation_covariance"].to_numpy()))
    moved = np.abs(one["deviation"] - other["deviation"]).to_numpy() / np.where(error, error, 1.0)
    winds = [
        read_product(path, lazy=True)
        for path in (folder / "results/corrected", folder / "scratch/corrected.nc")
    ]
    size = winds[1].sizes["report"]
    step = max(size // 200_000, 1)
    some = [
        np.hypot(
            *(ds[f"corrected_{way}ward_wind"].isel(report=slice(0, size, step)) for way in WAYS)
        )
        for ds in winds
    ]
    return {
        "fits, standard errors": float(np.nanmax(moved)),
        "standard errors, share": float(
            np.nanmax(np.abs(one["offset_standard_error"] / other["offset_standard_error"] - 1.0))
        ),
        "statuses that differ": float((one["status"] != other["status"]).sum()),
        "tables, degrees": float(
            np.nanmax(np.abs(one["table_correction"] - other["table_correction"]))
        ),
        "corrected wind speed, m/s": float(np.nanmax(np.abs(some[0] - some[1]))),
        "reports": float(size - winds[0].sizes["report"]),
    }


WAYS = ("east", "north")


def stamps(folder: Path) -> dict[str, int]:
    """Times of change of every month's products."""
    paths = [*(folder / "results").glob("headings/*"), *(folder / "results").glob("corrected/*")]
    return {f"{path.parent.name}/{path.name}": path.stat().st_mtime_ns for path in paths}


def shown(runs: dict[str, dict[str, Any]]) -> None:
    """Print what each stage took."""
    found: dict[str, dict[str, float]] = {}
    for name, run in runs.items():
        for stage in run["accounts"]["stages"]:
            own = found.setdefault(stage["name"].split(" 20")[0], {})
            own[name] = own.get(name, 0.0) + stage["processor"]
    print(f"{'stage':<20}" + "".join(f"{name:>12}" for name in runs) + "   processor time, s")
    for stage, own in found.items():
        print(f"{stage:<20}" + "".join(f"{own.get(name, 0.0):12.1f}" for name in runs))
    together = [sum(own.get(name, 0.0) for own in found.values()) for name in runs]
    print(f"{'together':<20}" + "".join(f"{one:12.1f}" for one in together))
    print(f"{'wall time':<20}" + "".join(f"{run['wall']:12.1f}" for run in runs.values()))
    peaks = [max(stage["peak"] for stage in run["accounts"]["stages"]) for run in runs.values()]
    print(f"{'peak memory, GB':<20}" + "".join(f"{peak / 1e9:12.2f}" for peak in peaks))


def main() -> None:
    """Take up, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=0.1, help="share of the year's reports")
    parser.add_argument("--hours", type=int, default=year.HOURS, help="of the model")
    parser.add_argument("--nights", type=int, default=2, help="days taken up one by one")
    parser.add_argument("--no-scratch", action="store_true", help="do not run the whole anew")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    given = parser.parse_args()
    runs: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder, aside = Path(name) / "archive", Path(name) / "aside"
        days = write_archive(folder, given.hours, round(year.REPORTS * given.share))
        last = days[-given.nights :]
        move(folder, aside, last)
        runs["before"] = year.run_on(folder, update=True)
        for day in last:
            before = stamps(folder)
            move(folder, aside, [day], back=True)
            runs[day] = year.run_on(folder, update=True)
        now = stamps(folder)
        touched = sorted(one for one, when in now.items() if before.get(one) != when)
        far: dict[str, float] = {}
        if not given.no_scratch:
            runs["scratch"] = year.run_on(folder, output="scratch", main=True)
            far = apart(folder)
        move(folder, aside, days[:-1])
        runs["alone"] = year.run_on(folder, output="alone")
    shown(runs)
    if given.json:
        given.json.write_text(json.dumps(runs, indent=1))
    alone, *nights = (
        sum(stage["processor"] for stage in runs[one]["accounts"]["stages"])
        for one in ("alone", *last)
    )
    bar = FACTOR * alone + ADDED
    for day, night in zip(last, nights, strict=True):
        told = " (a month is complete)" if day.endswith("-01") else ""
        print(
            f"{day}: {night:.1f} s of processor, the day alone {alone:.1f} s, bar {bar:.1f} s{told}"
        )
    print("written in the last night: " + ", ".join(touched))
    print("from scratch at most: " + ", ".join(f"{k} {value:.3g}" for k, value in far.items()))
    newest = max(now).rsplit("/", 1)[1]
    older = [one for one in touched if one.startswith("headings") and not one.endswith(newest)]
    if far.get("fits, standard errors", 0.0) > NEAR or far.get("reports") or older:
        raise SystemExit("missed: differs from scratch, or an older month was written")
    if max(nights) > bar:
        raise SystemExit(f"missed: a night takes {max(nights) / bar:.2f} of what it may")


if __name__ == "__main__":
    main()
