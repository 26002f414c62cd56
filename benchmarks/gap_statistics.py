"""Time and memory of ``airswing gap`` on an archive whose headings the main job has made.

    python -m benchmarks.gap_statistics --reports 10000000 --aircraft 60 [--days 365]

The products of the main job are written first, to a folder that is removed at the end: headings
of toy flights under new days as collocation leaves them, one aircraft after the other, and the
derivatives of the model wind beside them. Then the command itself is run, with two threads, and its
own table of stages printed. The bars are those of ten million reports of sixty aircraft: 240 s of
processor time in proportion to the reports, 600 s more for the witness of what has no name and its
simulated archives (on the reports held in memory, so the same for any archive), 4 GiB. Exit status
1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from airswing.config import Config, load_config
from airswing.gap.archive import headings_columns as columns
from airswing.physics.triangle import wrap_signed
from airswing.products.fingerprint import fingerprint
from airswing.products.netcdf import as_stored, provenance
from airswing.products.ragged_product import ragged_writer
from airswing.reference.collocate import DERIVATIVES
from airswing.workflow.gap_inputs import MARK
from airswing.workflow.headings_stage import depends_on
from airswing.workflow.job import GAP_INPUTS, HEADINGS

SECONDS, MEMORY, REPORTS = 240.0, 4.0, 10_000_000
FIXED = 20.0
"""Seconds that an archive of any size may take: imports, fits, figures."""
WITNESS = 600.0
"""Seconds the phases of the witness may take beside, whatever the archive's size."""
OF_THE_WITNESS = ("witness", "sent winds")


def toy_aircraft(number: int, reports: int, days: int) -> xr.Dataset:
    """Headings of one aircraft: a fortnight of toy flights repeated until the days are through."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests.gap.toy import make_frame

    fortnight = make_frame(seed=number, aircraft=1, days=14)
    flights = np.unique(fortnight.flight)
    copies = max(1, round(reports / fortnight.size))
    start = np.arange(copies) * max(days - 14, 0) * 86400.0 / max(copies - 1, 1)
    which = np.repeat(np.arange(copies), fortnight.size)
    moved = np.tile(fortnight.time, copies) + np.floor(start[which] / 60.0) * 60.0
    flight = np.tile(np.searchsorted(flights, fortnight.flight), copies) + which * flights.size
    first = np.full(flight.max() + 1, np.inf)
    np.minimum.at(first, flight, moved)
    place = np.argsort(np.argsort(first, kind="stable"))[flight]
    order = np.lexsort((moved, place))
    data: dict[str, Any] = {}
    for field, (name, angle) in (columns._PER_REPORT | columns._PER_REFERENCE).items():
        values = np.tile(getattr(fortnight, field), copies)[order]
        values = np.degrees(values) if angle else values
        if name in (
            "reference_eastward_wind",
            "reference_northward_wind",
            *DERIVATIVES,
            "lead_time",
        ):
            data[name] = (("reference", "report"), values[None])
        else:
            data[name] = ("report", values)
    air, implied = (
        (fortnight.ground_u - u, fortnight.ground_v - v)
        for u, v in ((fortnight.u_rep, fortnight.v_rep), (fortnight.u_ref, fortnight.v_ref))
    )
    errors = {  # what a refit of the deviation asks for, where effects beside it were found
        "heading_error": np.degrees(wrap_signed(np.arctan2(*air) - np.arctan2(*implied))),
        "heading_error_standard_error": np.ones(fortnight.size),
        "airspeed_error": np.hypot(*air) - np.hypot(*implied),
    }
    for name, values in errors.items():
        data[name] = (("reference", "report"), np.tile(values, copies)[order][None])
    data["time"] = ("report", (moved[order] * 1e3).astype("M8[ms]").astype("M8[ns]"))
    data["flight"] = ("report", place[order])
    for name in ("phase", "icing"):
        data[name] = ("report", np.tile(getattr(fortnight, name), copies)[order])
    data["screening"] = ("report", np.zeros(order.size, np.int32))
    data["row_size"] = ("aircraft", [order.size])
    return xr.Dataset(data, coords={"reference": ["toy"], "aircraft": [f"N{number + 1:03d}"]})


def blocks(reports: int, aircraft: int, days: int) -> Iterator[xr.Dataset]:
    """Give every aircraft, flights numbered over the archive."""
    flights = 0
    for number in range(aircraft):
        made = toy_aircraft(number, reports // aircraft, days)
        made["flight"] = made["flight"] + flights
        flights = int(made["flight"].max()) + 1
        yield as_stored(made)


def write_products(config: Config, reports: int, aircraft: int, days: int) -> int:
    """Write what the main job would have; say how many reports."""
    unscreened, *screened = depends_on(config)
    sizes = [made.sizes["report"] for made in blocks(reports, aircraft, days)]
    paths = [config.output / HEADINGS, config.output / GAP_INPUTS]
    with (
        ragged_writer(paths[0], reports=sum(sizes), aircraft=aircraft) as headings,
        ragged_writer(paths[1], reports=sum(sizes), aircraft=aircraft) as inputs,
    ):
        for made in blocks(reports, aircraft, days):
            headings.append(made.drop_vars(DERIVATIVES))
            inputs.append(made[[*DERIVATIVES, "row_size"]])
        told = provenance("toy flights")
        mark = fingerprint(HEADINGS, unscreened, *screened)
        headings.finish({MARK: unscreened, "fingerprint": mark, **told})
        inputs.finish({MARK: unscreened, **provenance("toy flights")})
    return sum(sizes)


def configuration(folder: Path) -> Path:
    """Write a configuration whose files are there, though nothing is read of them."""
    for name in ("reports.csv", "model.grb"):
        (folder / name).write_text("")
    content = {
        "reports": {"files": str(folder / "reports.csv")},
        "references": {"toy": {"files": str(folder / "model.grb")}},
        "output": str(folder / "results"),
        "compute": {"threads": 2},
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def main() -> int:
    """Write the input, run the command, print the table; 1 where a bar is missed.

    Returns
    -------
    int
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=int, default=500_000)
    parser.add_argument("--aircraft", type=int, default=20)
    parser.add_argument("--days", type=int, default=365)
    parser.add_argument("--folder", type=Path, help="of the temporary input")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        path = configuration(Path(name))
        config = load_config(path)
        reports = write_products(config, options.reports, options.aircraft, options.days)
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        command = [sys.executable, "-m", "airswing", "gap", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
        wall = time.perf_counter() - began
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(done.stderr)
    if done.returncode:
        return done.returncode
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    memory = after.ru_maxrss / 1024**2
    bar = min(SECONDS, FIXED + (SECONDS - FIXED) * reports / REPORTS)
    phases = dict(re.findall(r"([a-z][a-z ]*) ([0-9.]+) s", _phases(done.stderr)))
    witness = sum(float(phases.get(name, 0.0)) for name in OF_THE_WITNESS)
    names = seconds - witness
    print(
        f"{reports:,} reports of {options.aircraft} aircraft, {options.days} days, two threads\n"
        f"{'wall clock':28} {wall:8.1f} s\n"
        f"{'processor, without witness':28} {names:8.1f} s    bar {bar:.0f} "
        f"({1e6 * names / reports:.1f} us a report)\n"
        f"{'processor, witness':28} {witness:8.1f} s    bar {WITNESS:.0f}\n"
        f"{'peak memory':28} {memory:8.2f} GiB  bar {MEMORY:.0f}"
    )
    return int(names > bar or witness > WITNESS or memory > MEMORY)


def _phases(said: str) -> str:
    """What the command said of its phases' processor time."""
    return " ".join(line for line in said.splitlines() if "processor time:" in line)


if __name__ == "__main__":
    sys.exit(main())
