"""What collocation costs against plainly decoding the same messages.

    python benchmarks/collocation.py [--hours 48] [--repeats 5] [--json]

Makes its own hours of a RUC-size model (451 x 337 points, 37 levels, u and v)
in a temporary folder, as GRIB1 simple packing and GRIB2 complex packing, JPEG2000
and CCSDS, and prints ratios measured in the same run:

* collocating 2,000 reports with one hour, from a cold header scan, against
  decoding the hour's messages with eccodes and doing nothing else;
  (here and below processor time of one thread, so that other work on the
  machine does not matter);
* against `xarray.open_dataset(engine="cfgrib")` and `interp`;
* two worker processes against one, on 48 hours, in turns: wall clock, which
  means something on an idle machine of two cores or more, and how evenly the
  processor time is shared, which always does.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from airswing.reference.packing.decoder import processor_seconds

import airswing  # noqa: F401  (imports pyproj before eccodes can be)
from airswing.reference.catalogues import build_catalogue
from airswing.reference.collocate import collocate

NI, NJ = 451, 337
LEVELS = np.arange(100, 1001, 25)
REPORTS = 2000
START = np.datetime64("2009-08-01T00:00", "ns")
LAMBERT = {
    "gridType": "lambert",
    "Nx": NI,
    "Ny": NJ,
    "latitudeOfFirstGridPointInDegrees": 16.281,
    "longitudeOfFirstGridPointInDegrees": 233.862,
    "LoVInDegrees": 265.0,
    "Latin1InDegrees": 25.0,
    "Latin2InDegrees": 25.0,
    "DxInMetres": 13545,
    "DyInMetres": 13545,
    "iScansNegatively": 0,
    "jScansPositively": 1,
    "uvRelativeToGrid": 1,
}


PACKINGS = {
    "GRIB1 simple": "grid_simple",
    "GRIB2 complex": "grid_complex_spatial_differencing",
    "GRIB2 JPEG2000": "grid_jpeg",
    "GRIB2 CCSDS": "grid_ccsds",
}


def file_of(folder: Path, label: str) -> Path:
    """File of one hour in a packing; the edition stands in its suffix."""
    return folder / f"{PACKINGS[label]}.grb{label[4]}"


def smooth_field(rng: np.random.Generator) -> np.ndarray:
    """A wind component with waves of many lengths, to 0.1 m/s."""
    y, x = np.mgrid[0:NJ, 0:NI]
    field = np.full((NJ, NI), 15.0)
    for wavelength in (400.0, 200.0, 90.0, 40.0, 20.0):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        along = (x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / wavelength
        field += 0.03 * wavelength * np.sin(along + phase)
    return np.round(field + rng.normal(0, 0.3, field.shape), 1).ravel()


def write_hour(folder: Path, label: str, fields: list[np.ndarray]) -> None:
    """One hour of u and v on every level."""
    import eccodes

    edition = int(label[4])
    with file_of(folder, label).open("wb") as file:
        for number, values in enumerate(fields):
            handle = eccodes.codes_grib_new_from_samples(
                "GRIB2" if edition == 2 else "regular_ll_pl_grib1"
            )
            level, v = int(LEVELS[number // 2]), number % 2
            if edition == 1:
                keys: dict[str, Any] = {"centre": 59, "table2Version": 2}
                keys |= {"indicatorOfParameter": 33 + v, "indicatorOfTypeOfLevel": 100}
            else:
                keys = {"discipline": 0, "parameterCategory": 2, "parameterNumber": 2 + v}
                keys |= {"typeOfLevel": "isobaricInhPa"}
            keys |= {"dataDate": 20090801, "dataTime": 0, "level": level, **LAMBERT}
            for key, value in keys.items():
                eccodes.codes_set(handle, key, value)
            if edition == 2:
                eccodes.codes_set(handle, "packingType", PACKINGS[label])
            eccodes.codes_set(handle, "bitsPerValue", 12)
            eccodes.codes_set_values(handle, values)
            file.write(eccodes.codes_get_message(handle))
            eccodes.codes_release(handle)


def copy_hours(path: Path, hours: int) -> list[str]:
    """The same GRIB1 hour under later valid times: only the date octets change."""
    data = path.read_bytes()
    starts = [0]
    while starts[-1] < len(data):
        starts.append(starts[-1] + int.from_bytes(data[starts[-1] + 4 : starts[-1] + 7], "big"))
    paths = []
    for hour in range(hours):
        copy = bytearray(data)
        for start in starts[:-1]:
            copy[start + 8 + 14] = 1 + hour // 24
            copy[start + 8 + 15] = hour % 24
        paths.append(path.with_name(f"hour{hour:03d}.grb1"))
        paths[-1].write_bytes(copy)
    return [str(p) for p in paths]


def some_reports(hours: int, *, exact: bool) -> xr.Dataset:
    """2,000 reports an hour inside the grid and its levels."""
    rng = np.random.default_rng(7)
    count = REPORTS * max(hours, 1)
    seconds = np.zeros(count) if exact else rng.uniform(0, (hours - 1) * 3600.0, count)
    times = START + (seconds * 1e9).astype("timedelta64[ns]")
    return xr.Dataset(
        {
            "time": ("report", times),
            "latitude": ("report", rng.uniform(26.0, 48.0, count)),
            "longitude": ("report", rng.uniform(-115.0, -75.0, count)),
            "pressure": ("report", rng.uniform(15000.0, 99000.0, count)),
        }
    )


def decode_all(path: str) -> None:
    """Plain eccodes decoding of every message, and nothing else."""
    import eccodes

    with open(path, "rb") as file:
        while (handle := eccodes.codes_grib_new_from_file(file)) is not None:
            eccodes.codes_get_values(handle)
            eccodes.codes_release(handle)


def collocate_hour(
    path: str | list[str], reports: xr.Dataset, caches: Iterator[str], *, sparse: bool
) -> None:
    """From a file never seen before (a new cache folder every time) to winds at the reports."""
    catalogue = build_catalogue(path, name="ruc", cache_dir=next(caches))
    collocate(reports, {"ruc": catalogue}, sparse=sparse).compute(scheduler="synchronous")


def new_folders(folder: Path) -> Iterator[str]:
    """Folders nobody used yet."""
    for number in itertools.count():
        yield str(folder / f"cache{number}")


def cfgrib_hour(path: str, reports: xr.Dataset) -> xr.Dataset:
    """The same through cfgrib and xarray's interp, grid-relative, in index space."""
    from airswing.reference.grib.grid_sections import read_grid
    from airswing.reference.grib.headers import scan_file

    grid = read_grid(*scan_file(path).grids[0])
    keys = {"indexpath": "", "filter_by_keys": {"typeOfLevel": "isobaricInhPa"}}
    data = xr.open_dataset(path, engine="cfgrib", backend_kwargs=keys)[["u", "v"]]
    data = data.assign_coords(
        x=np.arange(grid.ni), y=np.arange(grid.nj), isobaricInhPa=np.log(data.isobaricInhPa * 100)
    ).drop_vars(("latitude", "longitude"))
    fi, fj = grid.fractional_index(reports.latitude.values, reports.longitude.values)
    at = {
        "x": xr.DataArray(fi, dims="report"),
        "y": xr.DataArray(fj, dims="report"),
        "isobaricInhPa": np.log(reports.pressure),
    }
    return data.interp(at).compute()


def interleaved(work: dict[str, Callable[[], Any]], repeats: int) -> list[float]:
    """Least processor time of several runs of each, s, taken in turn, that of decoders included.

    Every one of these runs in one thread and reads from the page cache, so that
    processor time is what it takes on an idle machine, whatever else is running.
    """
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(repeats):
        for name, run in work.items():
            start = time.process_time() + processor_seconds()
            run()
            times[name].append(time.process_time() + processor_seconds() - start)
    return [min(of) for of in times.values()]


def one_hour(folder: Path, repeats: int) -> list[dict[str, Any]]:
    """Ratios for one hour in every packing."""
    rows = []
    reports, caches = some_reports(1, exact=True), new_folders(folder)
    for label in ("GRIB2 JPEG2000", "GRIB2 CCSDS"):
        path = str(file_of(folder, label))
        plain, whole = interleaved(
            {
                "plain": partial(decode_all, path),
                "whole": partial(collocate_hour, path, reports, caches, sparse=False),
            },
            min(repeats, 3),
        )
        rows.append(row(f"{label}: sparse off / plain decoding", whole / plain, "<= 1.5", whole))
    for edition, label in ((1, "GRIB1 simple"), (2, "GRIB2 complex")):
        path = str(file_of(folder, label))
        work = {
            "plain": partial(decode_all, path),
            "whole": partial(collocate_hour, path, reports, caches, sparse=False),
            "sparse": partial(collocate_hour, path, reports, caches, sparse=True),
            "cfgrib": partial(cfgrib_hour, path, reports),
        }
        plain, whole, sparse, other = interleaved(work, repeats)
        rows += [
            row(f"{label}: sparse off / plain decoding", whole / plain, "<= 1.3", whole),
            row(f"{label}: cfgrib + interp / sparse off", other / whole, ">= 3", other),
        ]
        if edition == 1:
            rows.append(
                row(f"{label}: sparse on / plain decoding", sparse / plain, "<= 0.3", sparse)
            )
            rows.append(row(f"{label}: cfgrib + interp / sparse on", other / sparse, ">= 3", other))
    return rows


def many_hours(folder: Path, paths: list[str]) -> list[dict[str, Any]]:
    """End to end in one process, headers never seen before, against decoding everything."""
    reports, caches = some_reports(len(paths), exact=False), new_folders(folder / "many")

    def decode_every() -> None:
        for path in paths:
            decode_all(path)

    work = {
        "plain": decode_every,
        "whole": lambda: collocate_hour(paths, reports, caches, sparse=False),
        "sparse": lambda: collocate_hour(paths, reports, caches, sparse=True),
    }
    plain, whole, sparse = interleaved(work, 2)
    label = f"{len(paths)} hours end to end"
    return [
        row(f"{label}: sparse off / plain decoding", whole / plain, "<= 1.3", whole),
        row(f"{label}: sparse on / plain decoding", sparse / plain, "<= 0.3", sparse),
    ]


def two_workers(folder: Path, paths: list[str], turns: int) -> list[dict[str, Any]]:
    """One worker's time over two workers', turn by turn: the median and the middle half.

    Both clusters stand for the whole of it, opened as a run opens them, the one that waits costing
    nothing. The ratio is of the same turn, so that what the machine does beside falls on both.
    """
    from distributed import Client, LocalCluster

    reports = some_reports(len(paths), exact=False)
    catalogue = build_catalogue(paths, name="ruc", cache_dir=folder / "cache")
    cost: dict[tuple[int, bool], list[tuple[float, float]]] = {}
    results = []
    with contextlib.ExitStack() as open_clusters:
        clients = {}
        for workers in (1, 2):
            cluster = open_clusters.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=None,
                    memory_limit="1GiB",
                )
            )
            clients[workers] = open_clusters.enter_context(Client(cluster, set_as_default=False))
            clients[workers].run(import_heavy)
        for turn, sparse in itertools.product(range(turns), (False, True)):
            for workers in (1, 2) if turn % 2 else (2, 1):
                client = clients[workers]
                used, start = client.run(time.process_time), time.perf_counter()
                with client.as_current():
                    winds = collocate(reports, {"ruc": catalogue}, sparse=sparse)
                    results.append(winds.compute(scheduler=client))
                wall, after = time.perf_counter() - start, client.run(time.process_time)
                busiest = max(after[name] - used[name] for name in after)
                cost.setdefault((workers, sparse), []).append((wall, busiest))
        peaks = {
            name: peak for one in clients.values() for name, peak in one.run(peak_memory).items()
        }
    if not all(result.identical(results[0]) for result in results):
        raise SystemExit("results differ between schedulers or paths")
    rows = []
    for sparse in (False, True):
        one, two = (np.array(cost[workers, sparse]).T for workers in (1, 2))
        label = f"{len(paths)} hours, sparse {'on' if sparse else 'off'}: 1 worker / "
        for what, bar, row_of in (
            ("2, wall clock", "" if sparse else ">= 1.8", 0),
            ("busiest of 2, processor", "" if sparse else ">= 1.8", 1),
        ):
            least, middle, most = np.quantile(one[row_of] / two[row_of], (0.25, 0.5, 0.75))
            rows.append(row(label + what, middle, bar, np.median(two[row_of])))
            rows.append(row(f"    middle half of {turns} turns, from", least, "", 0.0))
            rows.append(row("    to", most, "", 0.0))
        rows.append(
            row(
                "    2 workers: wall clock / busiest, processor",
                np.median(two[0] / two[1]),
                "",
                0.0,
            )
        )
    rows.append(row("peak memory of a worker, MiB", max(peaks.values()) / 2**20, "< 1024", 0.0))
    return rows


def import_heavy() -> None:
    """Warm a worker up."""
    import eccodes  # noqa: F401

    import airswing.reference.collocate  # noqa: F401


def peak_memory() -> int:
    """Peak resident memory of this process, bytes."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def row(what: str, value: float, bar: str, seconds: float) -> dict[str, Any]:
    """One line of the table."""
    return {
        "what": what,
        "value": round(float(value), 3),
        "bar": bar,
        "seconds": round(float(seconds), 4),
    }


def main() -> None:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=int, default=48, help="hours for the worker comparison")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fields = [smooth_field(rng) for _ in range(2 * LEVELS.size)]
        for label in PACKINGS:
            write_hour(folder, label, fields)
        rows = one_hour(folder, options.repeats)
        if options.hours:
            paths = copy_hours(file_of(folder, "GRIB1 simple"), options.hours)
            rows += many_hours(folder, paths)
            rows += two_workers(folder, paths, max(7, options.repeats))
    if options.json:
        json.dump(rows, sys.stdout, indent=1)
        return
    print(f"{'':50} {'value':>9}  {'bar':8} {'seconds':>8}")
    for line in rows:
        print(f"{line['what']:50} {line['value']:9.3f}  {line['bar']:8} {line['seconds']:8.3f}")


if __name__ == "__main__":
    main()
