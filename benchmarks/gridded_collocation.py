"""What collocation of Datasets costs against `xarray.interp` and against reading all of them.

    python -m benchmarks.gridded_collocation [--hours 2] [--wall] [--json]

Makes hours of the size of ERA5 (721 x 1440 points, 37 levels, u and v, compressed in chunks) as
NetCDF, as Zarr and as public stores have them (Zarr 2, Blosc, an hour a chunk), and hours of a
wrfout (300 x 300 points, 50 levels) in a temporary folder, and runs each way of getting winds at
2,000 reports an hour in a process of its own: processor time of one thread (`--wall`: the clock on
the wall, dask's default threads, a machine that does nothing else) and peak memory beyond what the
libraries take (Linux). The winds of both ways are compared.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

REPORTS = 2000
START = np.datetime64("2022-11-11T00:00", "ns")
LEVELS = np.array(
    [
        1,
        2,
        3,
        5,
        7,
        10,
        20,
        30,
        50,
        70,
        *range(100, 250, 25),
        *range(250, 750, 50),
        *range(750, 1001, 25),
    ]
)
CHUNK = (1, 10, 181, 360)
REGIONS = {
    "globe": (-60.0, 75.0, -180.0, 180.0),
    "United States": (25.0, 49.0, -124.0, -67.0),
}
"""South, north, west, east of the reports: of no fleet, and of a fleet of one country."""
WRF = (50, 300, 300)
KINDS = {"NetCDF": "era5.nc", "Zarr": "era5.zarr", "Zarr 2, Blosc, whole hours": "hours.zarr"}


def some_reports(hours: int, box: tuple[float, float, float, float]) -> xr.Dataset:
    """2,000 reports an hour in a box, from the ground to cruising altitude."""
    rng = np.random.default_rng(7)
    count = REPORTS * max(hours - 1, 1)
    seconds = rng.uniform(0, (hours - 1) * 3600.0, count)
    return xr.Dataset(
        {
            "time": ("report", START + (seconds * 1e9).astype("m8[ns]")),
            "latitude": ("report", rng.uniform(*box[:2], count)),
            "longitude": ("report", rng.uniform(*box[2:], count)),
            "pressure": ("report", np.exp(rng.uniform(np.log(20000.0), np.log(98000.0), count))),
        }
    )


def smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """A component with long waves and the noise of packing, so that it compresses as winds do."""
    y, x = np.meshgrid(*(np.linspace(0, 2 * np.pi, n) for n in shape[-2:]), indexing="ij")
    plane = 15 * np.sin(5 * x) * np.cos(3 * y) + 4 * np.sin(40 * x + 20 * y)
    level = np.linspace(0.5, 2.0, shape[-3])[:, None, None]
    noise = rng.normal(0, 0.3, shape[-2:])
    return np.round(level * plane + noise, 2).astype("f4")


def write_era5(folder: Path, hours: int) -> None:
    """The same hours as NetCDF and as Zarr, twice."""
    import numcodecs

    rng = np.random.default_rng(1)
    shape = (LEVELS.size, 721, 1440)
    dims = ("valid_time", "pressure_level", "latitude", "longitude")
    standard = {"u": "eastward_wind", "v": "northward_wind"}
    ds = xr.Dataset(
        {
            n: (
                dims,
                np.stack([smooth(rng, shape)] * hours),
                {"units": "m s**-1", "standard_name": standard[n]},
            )
            for n in "uv"
        },
        coords={
            "valid_time": (
                "valid_time",
                START + np.arange(hours) * np.timedelta64(1, "h"),
                {"standard_name": "time"},
            ),
            "pressure_level": ("pressure_level", LEVELS.astype(float), {"units": "hPa"}),
            "latitude": ("latitude", np.linspace(90, -90, 721), {"units": "degrees_north"}),
            "longitude": ("longitude", np.arange(1440) * 0.25, {"units": "degrees_east"}),
        },
    )
    ds.to_netcdf(
        folder / "era5.nc",
        encoding={n: {"zlib": True, "complevel": 1, "chunksizes": CHUNK} for n in "uv"},
    )
    ds.chunk(dict(zip(dims, CHUNK, strict=True))).to_zarr(folder / "era5.zarr")
    how = {n: {"compressors": numcodecs.Blosc()} for n in "uv"}
    ds.chunk(valid_time=1).to_zarr(folder / "hours.zarr", zarr_format=2, encoding=how)


def write_wrfout(folder: Path, hours: int) -> None:
    """A wrfout on a Lambert grid of 9 km, as WRF writes it."""
    from pyproj import Proj

    rng = np.random.default_rng(2)
    nk, nj, ni = WRF
    proj = Proj("+proj=lcc +lat_1=38.5 +lat_2=38.5 +lat_0=38.5 +lon_0=-97.5 +R=6370000")
    x, y = np.meshgrid((np.arange(ni) - ni / 2) * 9000.0, (np.arange(nj) - nj / 2) * 9000.0)
    lon, lat = proj(x, y, inverse=True)
    base = np.linspace(99000.0, 10000.0, nk)[:, None, None] * np.ones((1, nj, ni))
    mass = ("Time", "bottom_top", "south_north", "west_east")
    stag = {
        "U": ((*mass[:3], "west_east_stag"), (nk, nj, ni + 1)),
        "V": ((*mass[:2], "south_north_stag", "west_east"), (nk, nj + 1, ni)),
    }
    times = START + np.arange(hours) * np.timedelta64(1, "h")
    stamps = [str(t.astype("M8[s]")).replace("T", "_").encode() for t in times]
    ds = xr.Dataset(
        {n: (dims, np.stack([smooth(rng, shape)] * hours)) for n, (dims, shape) in stag.items()}
        | {
            "P": (mass, np.zeros((hours, nk, nj, ni), "f4")),
            "PB": (mass, np.stack([base.astype("f4")] * hours)),
            "XLAT": ((mass[0], *mass[2:]), np.stack([lat.astype("f4")] * hours)),
            "XLONG": ((mass[0], *mass[2:]), np.stack([lon.astype("f4")] * hours)),
            "Times": ("Time", np.array(stamps)),
        },
        attrs={
            "MAP_PROJ": 1,
            "TRUELAT1": 38.5,
            "TRUELAT2": 38.5,
            "STAND_LON": -97.5,
            "DX": 9000.0,
            "DY": 9000.0,
            "START_DATE": stamps[0].decode(),
        },
    )
    names = ("U", "V", "P", "PB")
    ds.to_netcdf(
        folder / "wrfout.nc",
        encoding={
            n: {"zlib": True, "complevel": 1, "chunksizes": (1, nk, *ds[n].shape[2:])}
            for n in names
        },
    )


def by_airswing(path: str, reports: xr.Dataset, scheduler: str) -> np.ndarray:
    """From files never seen before to winds at the reports."""
    import airswing

    found = airswing.collocate(reports, {"m": airswing.build_catalogue(path, name="m")})
    done = found.compute(scheduler=scheduler)
    return np.stack(
        [done.reference_eastward_wind.values[0], done.reference_northward_wind.values[0]]
    )


def by_interp(path: str, reports: xr.Dataset, scheduler: str) -> np.ndarray:
    """xarray's interp on the same Dataset, linear in ln p; it reads the box of the reports."""
    ds = xr.open_zarr(path) if path.endswith(".zarr") else xr.open_dataset(path, chunks={})
    ds = ds[["u", "v"]].assign_coords(pressure_level=np.log(ds.pressure_level * 100))
    at = {
        "valid_time": reports.time,
        "pressure_level": np.log(reports.pressure),
        "latitude": reports.latitude,
        "longitude": np.mod(reports.longitude, 360),
    }
    done = ds.interp(at).compute(scheduler=scheduler)
    return np.stack([done.u.values, done.v.values])


def box_of(ds: xr.Dataset, reports: xr.Dataset) -> dict[str, slice]:
    """Levels, rows and columns that hold the reports and one more on every side."""
    box = {}
    for dim, wanted in (
        ("pressure_level", reports.pressure / 100.0),
        ("latitude", reports.latitude),
        ("longitude", np.mod(reports.longitude, 360)),
    ):
        there = (ds[dim] >= float(wanted.min())) & (ds[dim] <= float(wanted.max()))
        first, last = np.flatnonzero(there.values)[[0, -1]]
        box[dim] = slice(max(first - 1, 0), last + 2)
    return box


def by_expanding(path: str, reports: xr.Dataset, scheduler: str) -> np.ndarray:
    """The chunks the reports need expanded, nothing taken out of them: what no way can be under."""
    from airswing.reference.gridded.raw_chunks import raw_variable

    with xr.open_dataset(path, engine="zarr" if path.endswith(".zarr") else "netcdf4") as ds:
        for name in "uv":
            stored = ds[name].encoding
            chunk = tuple(stored["chunks" if "chunks" in stored else "chunksizes"])
            raw = raw_variable(ds, name, chunk)
            if raw is None:
                raise SystemExit("the benchmark's own file is not read as it is stored")
            needed = [slice(None), *box_of(ds, reports).values()]
            steps = [
                sorted({int(at) // c * c for at in np.arange(n)[part]})
                for n, c, part in zip(ds[name].shape, chunk, needed, strict=True)
            ]
            for place in itertools.product(*steps):
                raw.fetch(place, np.arange(0, np.prod(chunk), 1000))
    return np.empty((2, 0))


def by_reading(path: str, reports: xr.Dataset, scheduler: str) -> np.ndarray:
    """All of U, V, P and PB of a wrfout read, and nothing else."""
    with xr.open_dataset(path, decode_times=False) as ds:
        for name in ("U", "V", "P", "PB"):
            ds[name].values  # noqa: B018
    return np.empty((2, 0))


WAYS = {
    "airswing": by_airswing,
    "expanding": by_expanding,
    "interp": by_interp,
    "reading": by_reading,
}


def _measured(way: str, path: str, reports: xr.Dataset, wall: bool, channel: Any) -> None:
    import dask.array  # noqa: F401
    import deflate  # noqa: F401
    import distributed  # noqa: F401  (what any `compute` imports)
    import h5py  # noqa: F401
    import isal.igzip  # noqa: F401
    import matplotlib.pyplot  # noqa: F401
    import metpy.calc
    import metpy.plots.mapping  # noqa: F401  (what parse_cf imports)
    import netCDF4  # noqa: F401
    import numcodecs  # noqa: F401
    import scipy.interpolate  # noqa: F401
    import zarr  # noqa: F401

    import airswing.reference.collocate  # noqa: F401

    before = peak_memory()
    clock = time.perf_counter if wall else time.process_time
    began = clock()
    found = WAYS[way](path, reports, "threads" if wall else "synchronous")
    seconds = clock() - began
    channel.send((found, seconds, peak_memory() - before))


def peak_memory() -> int:
    """Peak resident memory of this process alone, bytes; `getrusage` counts its parent's, too."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    raise SystemExit("peak memory cannot be told on this system")


def measured(
    way: str, path: Path, reports: xr.Dataset, *, wall: bool
) -> tuple[np.ndarray, float, float]:
    """Winds, seconds and bytes of one way, in a process of its own."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_measured, args=(way, str(path), reports, wall, theirs))
    process.start()
    theirs.close()
    found = ours.recv()
    process.join()
    return found  # type: ignore[no-any-return]


def rows_of(folder: Path, hours: int, *, wall: bool) -> list[dict[str, Any]]:
    """The table."""
    rows = []
    write_era5(folder, hours)
    for (kind, file), (region, box) in itertools.product(KINDS.items(), REGIONS.items()):
        label = f"{kind}, {region}: "
        rows += era5_rows(label, folder / file, some_reports(hours, box), wall=wall)
    write_wrfout(folder, hours)
    wrf = some_reports(hours, (30.0, 46.0, -108.0, -88.0))
    _, seconds, octets = measured("airswing", folder / "wrfout.nc", wrf, wall=wall)
    _, plain, plain_octets = measured("reading", folder / "wrfout.nc", wrf, wall=wall)
    label = f"wrfout {hours} hours: airswing / reading all, "
    rows.append(row(label + "time", seconds / plain, "", seconds))
    rows.append(row(label + "memory", octets / plain_octets, "", seconds))
    return rows


def era5_rows(label: str, path: Path, reports: xr.Dataset, *, wall: bool) -> list[dict[str, Any]]:
    """One kind of file, reports of one region."""
    mine, seconds, octets = measured("airswing", path, reports, wall=wall)
    theirs, theirs_seconds, theirs_octets = measured("interp", path, reports, wall=wall)
    if not np.nanmax(np.abs(mine - theirs)) < 1e-3:
        raise SystemExit(f"winds differ by {np.nanmax(np.abs(mine - theirs))} m/s")
    _, floor, _ = measured("expanding", path, reports, wall=wall)
    return [
        row(label + "interp / airswing", theirs_seconds / seconds, ">= 5", seconds),
        row(label + "interp / expanding its chunks", theirs_seconds / floor, "", floor),
        row(label + "memory, airswing / interp", octets / theirs_octets, "<= 0.1", seconds),
    ]


def row(what: str, value: float, bar: str, seconds: float) -> dict[str, Any]:
    """One line of the table."""
    return {"what": what, "value": round(float(value), 3), "bar": bar, "seconds": round(seconds, 3)}


def main() -> None:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=int, default=2)
    parser.add_argument("--wall", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        rows = rows_of(Path(name), options.hours, wall=options.wall)
    if options.json:
        json.dump(rows, sys.stdout, indent=1)
        return
    for line in rows:
        print(f"{line['what']:70} {line['value']:9.3f}  {line['bar']:8} {line['seconds']:8.3f}")


if __name__ == "__main__":
    main()
