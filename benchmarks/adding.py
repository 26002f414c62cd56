"""A month added to a year: its cost by stage, beside the month alone and all from scratch.

    python -m benchmarks.adding [--share 0.1] [--main]

Takes the archive of `benchmarks.year` at a share of its hours and reports. Eleven twelfths of it
are run; then the last twelfth's reports and model files are put beside them and the same run goes
on with ``--resume``. The last twelfth alone and the whole from scratch are run too. Every stage
with its processor time in each. Below it what is inherent: ``headings.nc`` and ``corrected.nc`` of
the addition read and written again, nothing computed, for their rows stand by aircraft and what is
added moves them all. The products of the addition must equal those from scratch bit for bit, and no
report file or message of the eleven twelfths may be read again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks import year
from benchmarks.fault_drill import product_differences

PRODUCTS = ("headings.nc", "fits.nc", "corrected.nc")


def set_aside(folder: Path, aside: Path, *, hours: int, last: bool) -> None:
    """Move the last twelfth's files, or all others, out of an archive or back into it."""
    for kind in ("reports", "model"):
        (aside / kind).mkdir(parents=True, exist_ok=True)
        files = sorted((folder / kind).iterdir())
        # The last file of reports, and the model's hours from the last of the month before on.
        at = 11 if kind == "reports" else hours * 11 // 12
        for path in files[at:] if last else files[: at if kind == "reports" else at - 1]:
            path.rename(aside / kind / path.name)


def put_back(folder: Path, aside: Path) -> None:
    """Undo :func:`set_aside`."""
    for kind in ("reports", "model"):
        for path in (aside / kind).iterdir():
            path.rename(folder / kind / path.name)


def four_runs(folder: Path, *, hours: int, reports: int, main: bool) -> dict[str, dict[str, Any]]:
    """The eleven twelfths, the addition, what copying it takes, the last twelfth, and the whole."""
    aside = folder / "aside"
    folder.mkdir()
    year.write_fields(folder / "model", hours)
    year.write_reports(folder / "reports", reports, hours, year.AIRCRAFT)
    runs = {}
    set_aside(folder, aside, hours=hours, last=True)
    runs["eleven twelfths"] = year.run_on(folder, main=main)
    put_back(folder, aside)
    runs["added"] = year.run_on(folder, main=main, resume=True)
    results = folder / "results"
    runs["copied"] = {name: copying(results / name) for name in ("headings.nc", "corrected.nc")}
    runs["scratch"] = year.run_on(folder, output="scratch", main=main)
    set_aside(folder, aside, hours=hours, last=False)
    runs["alone"] = year.run_on(folder, output="alone", main=main)
    return runs


def copying(product: Path) -> float:
    """Processor time of reading a product and writing it again block by block, s."""
    from airswing.products.netcdf import read_product
    from airswing.products.ragged import blocks
    from airswing.products.ragged_product import ragged_writer

    began = time.process_time()
    with read_product(product, lazy=True) as found:
        sizes = {"reports": found.sizes["report"], "aircraft": found.sizes["aircraft"]}
        with ragged_writer(product.with_name("copied.nc"), **sizes) as writer:
            for block in blocks(found):
                writer.append(block)
            writer.finish(found.attrs)
    return time.process_time() - began


def stages(run: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Accounts by stage."""
    return {stage["name"]: stage for stage in run["accounts"]["stages"]}


def shown(runs: dict[str, dict[str, Any]]) -> None:
    """Print what each stage took."""
    names = ("added", "alone", "scratch")
    print(f"\n{'stage':<20}" + "".join(f"{name:>10}" for name in names) + "   processor time, s")
    found = {name: stages(runs[name]) for name in names}
    for stage in found["scratch"]:
        figures = "".join(f"{found[name][stage]['processor']:10.1f}" for name in names)
        print(f"{stage:<20}{figures}")
    together = {name: sum(stage["processor"] for stage in found[name].values()) for name in names}
    print(f"{'together':<20}" + "".join(f"{together[name]:10.1f}" for name in names))
    peaks = {name: max(stage["peak"] for stage in found[name].values()) for name in names}
    print(f"{'peak memory, GB':<20}" + "".join(f"{peaks[name] / 1e9:10.2f}" for name in names))
    for product, seconds in runs["copied"].items():
        print(f"{product + ', copied':<20}{seconds:10.1f}")
    for what, stage, key in (
        ("report files, octets read", "reports", "octets"),
        ("messages decoded", "collocate", "messages"),
    ):
        print(f"{what}: " + ", ".join(f"{name} {found[name][stage][key]:,}" for name in names))


def main() -> None:
    """Run, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=0.1, help="share of hours and of reports")
    parser.add_argument("--main", action="store_true", help="no evaluation, no page")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    given = parser.parse_args()
    hours, reports = round(year.HOURS * given.share), round(year.REPORTS * given.share)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "archive"
        runs = four_runs(folder, hours=hours, reports=reports, main=given.main)
        shown(runs)
        differ = [
            f"{product}: {what}"
            for product in PRODUCTS
            for what in product_differences(
                folder / "results" / product, folder / "scratch" / product
            )
            if what != "attribute airswing_config"  # names the output folder
        ]
    if given.json:
        given.json.write_text(json.dumps(runs, indent=1))
    print(f"against scratch: {differ or 'equal bit for bit'}")
    added, alone = stages(runs["added"]), stages(runs["alone"])
    again = added["reports"]["octets"] > alone["reports"]["octets"] or (
        added["collocate"]["messages"] > 1.02 * alone["collocate"]["messages"] + 30
    )
    if differ or again:
        raise SystemExit(
            "missed: differs from scratch" if differ else "missed: old data read again"
        )


if __name__ == "__main__":
    main()
