"""Time and memory of ``airswing gap`` on an archive whose headings the main job has made.

    python -m benchmarks.gap_statistics --reports 10000000 --aircraft 60 [--days 365] [--month]

The headings of the main job are written first, by month, to a folder that is removed at the end:
toy flights under new days and in new weather, as collocation leaves them. Every aircraft has a hard
iron of a degree or so, and nothing else is amiss: that is what the diagnosis should say. Then the
command itself is run, with two threads, and its own table of stages printed. The bars are those of
ten million reports of sixty aircraft: 240 s of processor time in proportion to the reports, 600 s
more for the witness of what has no name and its simulated archives (on the reports held in memory,
so the same for any archive), 4 GiB. Exit status 1 where a bar is missed, or anything else is told.

With `--month` a month of the same fleet is run as well: memory should hardly grow from it to a
year. Only of archives whose month is over 400,000 reports: all of fewer are held in memory.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray

from airswing.config import Config
from airswing.config_file import load_config
from airswing.gap.archive import headings_columns as columns
from airswing.gap.archive.frame import Frame
from airswing.gap.result.schema import GapReport
from airswing.physics.triangle import wrap_signed
from airswing.products.monthly import FLIGHTS
from airswing.products.netcdf import as_stored, open_product, write_product
from airswing.products.ragged import joined, some_reports
from airswing.reference.collocate import DERIVATIVES
from airswing.workflow.job import HEADINGS

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.gap.toy import Waves, make_frame

SECONDS, MEMORY, REPORTS = 240.0, 4.0, 10_000_000
FIXED = 20.0
"""Seconds that an archive of any size may take: imports, fits, figures."""
WITNESS = 600.0
"""Seconds the phases of the witness may take beside, whatever the archive's size."""
FORTNIGHT = 14 * 86400.0
"""Seconds that the toy flights cover, and for which one weather holds that the model misses."""
DEVIATION = 1.0
"""Standard deviation of the coefficients of the aircraft's hard iron, degrees."""
MONTH, FLAT = 30, 1.2
"""Days of the archive that memory is held against (`--month`), and how much more it may be."""
OF_THE_WITNESS = ("witness", "sent winds")


def toy_flights(number: int) -> Frame:
    """Toy flights of one aircraft over a fortnight."""
    return make_frame(seed=number, aircraft=1, days=14)


def copies_of(flights: Frame, reports: int) -> int:
    """How often the flights are repeated for about so many reports."""
    return max(1, round(reports / flights.size))


def toy_aircraft(number: int, fortnight: Frame, copies: int, days: int) -> xr.Dataset:
    """Headings of one aircraft: its flights repeated until the days are through, in new weather."""
    flights = np.unique(fortnight.flight)
    start = np.arange(copies) * max(days - 14, 0) * 86400.0 / max(copies - 1, 1)
    which = np.repeat(np.arange(copies), fortnight.size)
    moved = np.tile(fortnight.time, copies) + np.floor(start[which] / 60.0) * 60.0
    flight = np.tile(np.searchsorted(flights, fortnight.flight), copies) + which * flights.size
    first = np.full(flight.max() + 1, np.inf)
    np.minimum.at(first, flight, moved)
    place = np.argsort(np.argsort(first, kind="stable"))[flight]
    order = np.lexsort((moved, place))
    repeated = fortnight.take(np.tile(np.arange(fortnight.size), copies)[order])
    weather = (first[flight[order]] // FORTNIGHT).astype(int)
    made = in_new_weather(replace(repeated, time=moved[order]), weather, number)
    data: dict[str, Any] = {}
    for field, (name, angle) in (columns._PER_REPORT | columns._PER_REFERENCE).items():
        values = getattr(made, field)
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
    implied = made.ground_u - made.u_ref, made.ground_v - made.v_ref
    errors = {  # what a refit of the deviation asks for, where effects beside it were found
        "heading_error": np.degrees(wrap_signed(made.heading - np.arctan2(*implied))),
        "heading_error_standard_error": np.ones(made.size),
        "airspeed_error": made.airspeed - np.hypot(*implied),
    }
    for name, values in errors.items():
        data[name] = (("reference", "report"), values[None])
    data["time"] = ("report", (made.time * 1e3).astype("M8[ms]").astype("M8[ns]"))
    data["flight"] = ("report", place[order])
    for name in ("phase", "icing"):
        data[name] = ("report", getattr(made, name))
    data["screening"] = ("report", np.zeros(order.size, np.int32))
    data["row_size"] = ("aircraft", [order.size])
    return xr.Dataset(data, coords={"reference": ["toy"], "aircraft": [f"N{number + 1:03d}"]})


def in_new_weather(flights: Frame, weather: NDArray[np.int64], number: int) -> Frame:
    """Give flights the winds of their fortnight, what the model misses of them, and a deviation.

    The fleet flies through one weather. Errors that came back with the flights would last, and an
    effect that lasts be found in them. What there is to be found is a hard iron of every aircraft.
    """
    points = np.stack(
        [
            (flights.longitude + 90) * 85,
            (flights.latitude - 40) * 111,
            np.log(flights.pressure / 5e4),
            flights.time / 3600,
        ],
        -1,
    )
    height = 1 - np.log(flights.pressure / 9e4)[:, None]
    wind = np.array([9.0, 0.0]) * height
    lasting = Waves(np.random.default_rng(0), sd=0.4, length=1500, hours=1e5, count=20)
    missed = lasting(points)
    for one in np.unique(weather):
        own, rng = weather == one, np.random.default_rng([1, one])
        wind[own] += Waves(rng, sd=6.0, length=2500, hours=60, count=20)(points[own]) * height[own]
        missed[own] += Waves(rng, sd=2.0, length=700, hours=18, count=20)(points[own])
    true = wind + missed
    course = np.arctan2(flights.ground_u, flights.ground_v)  # held, whatever the wind
    across = true[:, 0] * np.cos(course) - true[:, 1] * np.sin(course)
    heading = course - np.arcsin(np.clip(across / flights.airspeed, -0.7, 0.7))
    pointer = np.stack([np.sin(heading), np.cos(heading)], -1)
    ground = flights.airspeed[:, None] * pointer + true
    rng = np.random.default_rng([2, number])
    magnetic, iron = heading - flights.declination, np.radians(rng.normal(0, DEVIATION, 2))
    heading = heading + iron[0] * np.sin(magnetic) + iron[1] * np.cos(magnetic)
    pointer = np.stack([np.sin(heading), np.cos(heading)], -1)
    reported = ground - flights.airspeed[:, None] * pointer + rng.normal(size=true.shape)
    air = (ground - reported).T
    indicated = np.arctan2(*air)
    return replace(
        flights,
        u_rep=reported[:, 0],
        v_rep=reported[:, 1],
        u_ref=wind[:, 0],
        v_ref=wind[:, 1],
        dudlnp=-wind[:, 0],
        dvdlnp=-wind[:, 1],
        ground_u=ground[:, 0],
        ground_v=ground[:, 1],
        heading=indicated,
        magnetic_heading=indicated - flights.declination,
        airspeed=np.hypot(*air),
    )


def write_products(config: Config, reports: int, aircraft: int, days: int) -> int:
    """Write what the main job would have; say how many reports."""
    months: dict[str, list[xr.Dataset]] = {}
    total = 0
    for number in range(aircraft):
        own = toy_flights(number)
        toy = as_stored(toy_aircraft(number, own, copies_of(own, reports // aircraft), days))
        total += toy.sizes["report"]
        month = toy["time"].to_numpy().astype("M8[M]")
        for one in np.unique(month):
            months.setdefault(str(one), []).append(some_reports(toy, month == one))
    for name, parts in months.items():
        flights = 0
        for part in parts:
            _, flight = np.unique(part["flight"], return_inverse=True)
            part["flight"] = ("report", (flight + flights).astype(np.int32))
            flights = int(part["flight"].max()) + 1
        month = joined(parts).assign_attrs({FLIGHTS: flights})
        write_product(month, config.output / HEADINGS / f"{name}.nc", title="toy flights")
    return total


def measured(config: Path) -> None:
    """Run the command on the months that were written, as if their inputs were unchanged."""
    from airswing import cli
    from airswing.workflow import gap_stage

    gap_stage.make_headings = lambda job: open_product(job.output / HEADINGS)  # type: ignore[attr-defined]
    sys.argv = ["airswing", "gap", str(config)]
    cli.main()


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
    parser.add_argument("--month", action="store_true", help="a month of the same fleet beside it")
    parser.add_argument("--folder", type=Path, help="of the temporary input")
    parser.add_argument("--measured", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measured:
        measured(options.measured)
        return 0
    size = options.reports, options.aircraft, options.days
    met, memory = diagnosed(*size, folder=options.folder)
    if options.month:
        share = MONTH / options.days
        month = round(share * options.reports), options.aircraft, MONTH
        _, less = diagnosed(*month, folder=options.folder)
        print(f"{'peak memory over a month':28} {memory / less:8.2f}      bar {FLAT}")
        met &= memory <= FLAT * less
    return int(not met)


def diagnosed(reports: int, aircraft: int, days: int, *, folder: Path | None) -> tuple[bool, float]:
    """Run the command on an archive and print its table; whether its bars are met, peak GiB."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        path = configuration(Path(name))
        config = load_config(path)
        reports = write_products(config, reports, aircraft, days)
        began = time.perf_counter()
        command = [sys.executable, "-m", "benchmarks.gap_statistics", "--measured", str(path)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as done:
            assert done.stderr is not None
            said = done.stderr.read()
            _, status, used = os.wait4(done.pid, 0)  # of this command alone
            done.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - began
        print(said)
        if done.returncode:
            sys.exit(done.returncode)
        told = GapReport.read(config.output / "gap.json")
    right = [one.name for one in told.effects] == ["hard_iron"] and not told.unknown.present
    seconds, memory = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024**2
    bar = min(SECONDS, FIXED + (SECONDS - FIXED) * reports / REPORTS)
    phases = dict(re.findall(r"([a-z][a-z ]*) ([0-9.]+) s", _phases(said)))
    witness = sum(float(phases.get(name, 0.0)) for name in OF_THE_WITNESS)
    names = seconds - witness
    print(
        f"{reports:,} reports of {aircraft} aircraft, {days} days, two threads\n"
        f"{'wall clock':28} {wall:8.1f} s\n"
        f"{'processor, without witness':28} {names:8.1f} s    bar {bar:.0f} "
        f"({1e6 * names / reports:.1f} us a report)\n"
        f"{'processor, witness':28} {witness:8.1f} s    bar {WITNESS:.0f}\n"
        f"{'peak memory':28} {memory:8.2f} GiB  bar {MEMORY:.0f}\n"
        f"{'told':28} {'what is there' if right else 'SOMETHING ELSE'}",
        flush=True,
    )
    return right and names <= bar and witness <= WITNESS and memory <= MEMORY, memory


def _phases(said: str) -> str:
    """What the command said of its phases' processor time."""
    return " ".join(line for line in said.splitlines() if "processor time:" in line)


if __name__ == "__main__":
    sys.exit(main())
