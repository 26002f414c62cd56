"""Forecasts corrected by the Kalman filter: time for a year, and errors of it and its rivals.

    python -m benchmarks.postprocessing [--stations 1000] [--leads 24] [--pairs RAW KALMAN]

A year of synthetic pairs, a wandering bias in white noise, is corrected with the ratio chosen by
hold-out. Bar: under 10 s of processor time for 1,000 stations and 24 lead times. With ``--pairs``,
tables of forecasts before and after another filter (text format of Verif): the package's is
compared with it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import xarray as xr

from airswing.handover.forecasts.correcting import DIMS, TIME, correct_forecasts
from airswing.handover.forecasts.forecast_pairs import pairs_from_tables

BAR = 10.0


def synthetic(stations: int, leads: int, days: int = 365) -> xr.Dataset:
    """Pairs whose bias is a random walk of ratio 0.06 in noise of 1 K."""
    rng = np.random.default_rng(1)
    shape = (1, stations, days, leads)
    bias = np.cumsum(rng.normal(0.0, np.sqrt(0.06), shape), axis=2)
    starts = np.datetime64("2009-01-01", "ns") + np.arange(days) * np.timedelta64(1, "D")
    return xr.Dataset(
        {
            "forecast": (DIMS, 280.0 + bias + rng.normal(size=shape)),
            "observation": (DIMS, np.full(shape, 280.0)),
        },
        coords={
            "variable": ["air_temperature"],
            "station": [f"S{number}" for number in range(stations)],
            TIME: starts,
            "lead": np.arange(1.0, leads + 1.0),
        },
    )


def spread(ds: xr.Dataset, name: str) -> float:
    """Standard deviation of the error of every pair."""
    return float((ds[name] - ds["observation"]).std())


def main() -> int:
    """Print the time and the comparison; 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stations", type=int, default=1000)
    parser.add_argument("--leads", type=int, default=24)
    parser.add_argument("--pairs", nargs=2, type=Path, metavar="FILE")
    given = parser.parse_args()
    pairs = synthetic(given.stations, given.leads)
    began = time.process_time()
    made = correct_forecasts(pairs).load()
    took = time.process_time() - began
    print(
        f"a year of {given.stations} stations x {given.leads} leads: {took:.1f} s of one "
        f"processor (bar {BAR:.0f}); "
        f"error's standard deviation {spread(made, 'forecast'):.2f} raw, "
        f"{spread(made, 'running_mean_forecast'):.3f} running mean, "
        f"{spread(made, 'mean_of_pairs_forecast'):.3f} mean of pairs, "
        f"{spread(made, 'corrected_forecast'):.3f} filter, ratio {made['ratio'].item():g}"
    )
    if given.pairs:
        raw, other = (pairs_from_tables([file]) for file in given.pairs)
        ours = correct_forecasts(raw)
        print(
            f"{given.pairs[0].name}: {spread(ours, 'forecast'):.3f} raw, "
            f"{spread(other, 'forecast'):.3f} theirs, {spread(ours, 'corrected_forecast'):.3f} "
            f"ours, {spread(ours, 'running_mean_forecast'):.3f} running mean "
            f"(ratio {ours['ratio'].item():g})"
        )
    return int(took > BAR)


if __name__ == "__main__":
    raise SystemExit(main())
