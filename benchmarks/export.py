"""Processor time and memory of exporting an archive, compared with pandas writing CSV.

    python -m benchmarks.export [--reports 1000000]

A product of corrected reports of 60 aircraft is generated, then exported in each format, with
single reports and with joined soundings, and written by ``pandas.DataFrame.to_csv``: the same
columns, read from the same product. Each runs in a separate process. Bars: 10 s of processor time
a million reports, and 1 GiB for a million reports (2 GiB for ten million).
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr

import airswing
from airswing.flags import PHASE
from airswing.products.netcdf import read_product, write_product

AIRCRAFT = 60
SECONDS_BAR = 10.0  # of processor time, a million reports
BYTES_BAR = 2**30
COLUMNS = (
    "time",
    "latitude",
    "longitude",
    "pressure",
    "air_temperature",
    "corrected_eastward_wind",
    "corrected_northward_wind",
    "corrected_wind_standard_error",
    "phase",
    "flight",
)


def archive(reports: int) -> xr.Dataset:
    """Corrected reports: flights of ascent, cruise and descent in sequence."""
    rng = np.random.default_rng(4)
    size = np.full(AIRCRAFT, reports // AIRCRAFT, dtype=np.int32)
    size[: reports % AIRCRAFT] += 1
    number = np.concatenate([np.arange(count) for count in size])
    leg = number % 50
    phase = np.select([leg < 10, leg < 40], [PHASE["ascent"], PHASE["cruise"]], PHASE["descent"])
    pressure = np.interp(leg, [0, 10, 40, 49], [95000.0, 45000.0, 45000.0, 94000.0])
    start = np.datetime64("2009-01-01", "ns")
    columns = {
        "time": start + (number * 120 + rng.integers(0, 60, reports)) * np.timedelta64(1, "s"),
        "latitude": rng.uniform(30.0, 50.0, reports),
        "longitude": rng.uniform(-110.0, -70.0, reports),
        "pressure": pressure.astype(np.float32),
        "air_temperature": rng.normal(260.0, 15.0, reports).astype(np.float32),
        "correction_applied": np.zeros(reports, dtype=np.int8),
        "screening": np.zeros(reports, dtype=np.int32),
        "phase": phase.astype(np.int8),
        "flight": (number // 50 + np.repeat(np.arange(AIRCRAFT) * 10**6, size)).astype(np.int32),
        "corrected_wind_standard_error": rng.uniform(0.1, 1.0, reports).astype(np.float32),
    }
    for name in ("eastward_wind", "northward_wind"):
        wind = rng.normal(10.0, 15.0, reports).astype(np.float32)
        columns |= {name: wind, f"corrected_{name}": wind + np.float32(1.0)}
    return xr.Dataset(
        {name: ("report", values) for name, values in columns.items()}
        | {"row_size": ("aircraft", size)},
        coords={"aircraft": np.array([f"N{k:03d}" for k in range(AIRCRAFT)], dtype=object)},
    )


def as_csv(product: Path, path: Path) -> None:
    """Columns of the reports and their aircraft, written by pandas."""
    ds = read_product(product)
    frame = ds[list(COLUMNS)].to_dataframe()
    frame["aircraft"] = np.repeat(ds["aircraft"].to_numpy(), ds["row_size"].to_numpy())
    frame.sort_values("time").to_csv(path, index=False)


def alone(work) -> tuple[float, float, int]:
    """Seconds, processor seconds and peak bytes of some work in a separate process."""
    began = time.perf_counter()
    child = os.fork()
    if not child:
        try:
            work()
        except BaseException:
            os._exit(1)
        os._exit(0)
    _, status, usage = os.wait4(child, 0)
    if status:
        raise RuntimeError("the work failed")
    processor = usage.ru_utime + usage.ru_stime
    return time.perf_counter() - began, processor, usage.ru_maxrss * 1024


def _line(text: str, took: float, processor: float, held: int, size: int) -> str:
    return (
        f"{text:<22}{took:6.1f} s, processor {processor:5.1f} s, {held / 2**20:5.0f} MiB, "
        f"{size / 1e6:6.0f} MB written"
    )


def main() -> int:
    """Make, export, compare; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reports", type=int, default=1_000_000)
    given = parser.parse_args()
    missed = False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        product = folder / "corrected.nc"
        alone(lambda: write_product(archive(given.reports), product, title="Export benchmark"))
        took, rival, held = alone(lambda: as_csv(product, folder / "csv"))
        size = (folder / "csv").stat().st_size
        begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        print(
            f"{given.reports:,} reports; before it begins each process holds {begun:.0f} MiB; "
            "at the end of a line its processor time over pandas's"
        )
        print(_line("pandas to_csv", took, rival, held, size))
        for to in ("obs_domain", "little_r", "ob_ascii"):
            for soundings in (False, True):
                target = folder / "file"

                def work(to: str = to, soundings: bool = soundings, target: Path = target) -> None:
                    airswing.export(product, to=to, path=target, soundings=soundings)

                took, processor, held = alone(work)
                size = target.stat().st_size
                target.unlink()
                text = f"{to}{', soundings' if soundings else ''}"
                print(f"{_line(text, took, processor, held, size)}  {processor / rival:.2f}")
                scale = max(given.reports / 1e6, 1.0)
                bytes_bar = BYTES_BAR * (2 if scale > 1.0 else 1)
                missed |= processor > SECONDS_BAR * scale or held > bytes_bar
    print(
        "bars: 10 s of processor time a million reports, 1 GiB (2 above a million): "
        + ("missed" if missed else "held")
    )
    return int(missed)


if __name__ == "__main__":
    raise SystemExit(main())
