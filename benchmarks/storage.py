"""Bytes a report of headings.nc, and the time to read one aircraft's records from it.

    python -m benchmarks.storage [--reports 10000000]

Winds, headings and errors of a synthetic fleet (``benchmarks.year``) are derived and written as the
main job writes them, the reports repeated until there are enough. Bars: under 60 bytes a report a
reference; one aircraft's records in under a second.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import xarray as xr
from benchmarks.year import AIRCRAFT, run

import airswing  # noqa: F401  (imports pyproj before eccodes can be)
from airswing.products.chunks import _deflated, _shuffled
from airswing.products.netcdf import as_stored, provenance
from airswing.products.ragged import blocks
from airswing.products.ragged_product import ragged_writer

SHOWN = 12
"""Largest variables to print."""


def repeated(headings: xr.Dataset, reports: int) -> xr.Dataset:
    """Every report again and again, aircraft by aircraft; winds and errors differ a little."""
    times = -(-reports // headings.sizes["report"])
    size = headings["row_size"].to_numpy()
    stop = np.cumsum(size)
    order = np.concatenate(
        [np.tile(np.arange(end - count, end), times) for end, count in zip(stop, size, strict=True)]
    )
    grown = headings.isel(report=order)
    grown["row_size"] = headings["row_size"] * times
    rng = np.random.default_rng(2)
    for name, variable in grown.data_vars.items():
        if variable.dtype.kind == "f" and "report" in variable.dims:
            spread = float(np.nan_to_num(variable.std()))
            noise = rng.normal(size=variable.shape) * 1e-2 * spread
            exact = np.array_equal(variable, np.round(variable, 4), equal_nan=True)
            if name in ("latitude", "longitude"):
                grown[name] = (variable + noise).round(4)
            elif not exact:
                grown[name] = (variable + noise).astype(variable.dtype)
    return as_stored(grown)


def variable_bytes(path: Path) -> dict[str, float]:
    """Bytes a report that each variable takes in the file."""
    with h5py.File(path) as file:
        columns = {name: one for name, one in file.items() if one.chunks is not None}
        return {
            name: one.id.get_storage_size() / one.shape[-1]
            for name, one in columns.items()
            if one.shape[-1] == file["report"].shape[0]
        }


def compressing(path: Path) -> tuple[float, float]:
    """Processor time and octets of the product's streams over those of zlib's level 1."""
    ways = {"ours": _deflated, "zlib": lambda octets: zlib.compress(octets, 1)}
    seconds, size = dict.fromkeys(ways, 0.0), dict.fromkeys(ways, 0)
    with h5py.File(path) as file:
        for one in file.values():
            if one.chunks is None or one.shape[-1] < one.chunks[-1] or "S" in one.dtype.str:
                continue
            octets = _shuffled(one[(*(0 for _ in one.shape[:-1]), slice(one.chunks[-1]))])
            for name, way in ways.items():
                began = time.process_time()
                size[name] += len(way(octets))
                seconds[name] += time.process_time() - began
    return seconds["ours"] / seconds["zlib"], size["ours"] / size["zlib"]


def one_aircraft(path: Path, number: int) -> float:
    """Seconds to open the product and read every variable of one aircraft."""
    began = time.perf_counter()
    with xr.open_dataset(path, engine="netcdf4", decode_timedelta=False) as ds:
        stop = np.cumsum(ds["row_size"].to_numpy())
        start = stop - ds["row_size"].to_numpy()
        ds.isel(report=slice(int(start[number]), int(stop[number]))).load()
    return time.perf_counter() - began


def main() -> None:
    """Write, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reports", type=int, default=10_000_000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = min(given.reports, 500_000)
        run(folder / "run", reports=made, hours=438, aircraft=AIRCRAFT, workers=1, main=True)
        with xr.open_dataset(
            folder / "run/results/headings.nc", engine="netcdf4", decode_timedelta=False
        ) as ds:
            headings = ds.load()
        path = folder / "headings.nc"
        grown = repeated(headings, given.reports)
        sizes = {"reports": grown.sizes["report"], "aircraft": grown.sizes["aircraft"]}
        with ragged_writer(path, **sizes) as writer:
            for block in blocks(grown):
                writer.append(block)
            writer.finish(provenance("Storage benchmark"))
        count, size = grown.sizes["report"], path.stat().st_size
        del grown
        print(
            f"{count:,} reports, one reference: {size / 1e6:,.0f} MB, "
            f"{size / count:.1f} bytes a report a reference (bar: 60)"
        )
        seconds = [one_aircraft(path, number) for number in (0, AIRCRAFT // 2, AIRCRAFT - 1)]
        print(f"one aircraft of {AIRCRAFT}: {max(seconds):.2f} s to read (bar: 1)")
        took, longer = compressing(path)
        print(f"compressing: {took:.2f} of the time of zlib's level 1, {longer:.2f} of its octets")
        found = variable_bytes(path)
        for variable, share in sorted(found.items(), key=lambda item: -item[1])[:SHOWN]:
            print(f"  {variable:<32}{share:6.2f} bytes a report")


if __name__ == "__main__":
    main()
