"""The error of the reports alone, held against the truth of simulated archives.

    python -m benchmarks.observation_errors [--seeds 24] [--days 45] [--aircraft 14] [--perfect]

Every archive is simulated twice with the same numbers drawn: with compass errors (as reported) and
without (as corrected), and the error found from the reports and both references alone is held
against the one the simulation knows. Bars: the fleet's corrected error within 10 % (root mean
square over archives), its 95 % interval holding the truth in 90 to 98 % of them.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pandas as pd
import xarray as xr

from airswing.evaluation.error_profiles import profile_cells
from airswing.evaluation.report_errors.observation_errors import observation_errors
from airswing.flags import PHASE
from airswing.synthetic.aircraft.truth import fleet_deviations
from airswing.synthetic.sample.sample_archive import simulate_arrays

POOLS = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"], "ruc+rtfdaa": ["ruc", "rtfdaa"]}


def simulated(seed: int, *, days: int, aircraft: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """One archive with compass errors and without, the same otherwise."""
    size = {"days": days, "aircraft": aircraft, "seed": seed, "derivatives": False}
    tails = [f"N{401 + index}" for index in range(aircraft)]
    right = simulate_arrays(**size, effects=())
    return simulate_arrays(**size, effects=fleet_deviations(tails, seed)), right


def datasets(reported: pd.DataFrame, right: pd.DataFrame) -> tuple[xr.Dataset, xr.Dataset]:
    """Both as the products have them."""
    one = ("report",)
    sizes = reported.groupby("tail", sort=True).size()
    winds = {
        f"reference_{way}_wind": (
            ("reference", "report"),
            np.stack([reported[f"{letter}_{name}"] for name in ("ruc", "rtfdaa")]),
        )
        for way, letter in (("eastward", "u"), ("northward", "v"))
    }
    headings = xr.Dataset(
        {
            **{name: (one, reported[name].to_numpy()) for name in ("latitude", "longitude")},
            "pressure": (one, reported["pressure"].to_numpy()),
            "time": (one, reported["time"].to_numpy()),
            "phase": (one, reported["phase"].to_numpy().astype(np.int8)),
            "screening": (one, np.zeros(len(reported), dtype=np.int32)),
            "eastward_wind": (one, reported["u"].to_numpy()),
            "northward_wind": (one, reported["v"].to_numpy()),
            **winds,
            "row_size": ("aircraft", sizes.to_numpy()),
        },
        coords={"aircraft": sizes.index.to_numpy(), "reference": ["ruc", "rtfdaa"]},
    )
    corrected = xr.Dataset(
        {
            "corrected_eastward_wind": (one, right["u"].to_numpy()),
            "corrected_northward_wind": (one, right["v"].to_numpy()),
            "row_size": ("aircraft", sizes.to_numpy()),
        }
    )
    return headings, corrected


def truth(frame: pd.DataFrame, headings: xr.Dataset) -> tuple[float, np.ndarray]:
    """True error of a component: of the fleet, and by phase and layer."""
    square = 0.5 * ((frame["u"] - frame["true_u"]) ** 2 + (frame["v"] - frame["true_v"]) ** 2)
    cell, cells = profile_cells(headings)
    total = np.bincount(cell, weights=square, minlength=cells)
    table = np.sqrt(total / np.maximum(np.bincount(cell, minlength=cells), 1))
    rows = table.reshape(len(PHASE), -1)
    return float(np.sqrt(square.mean())), rows[[PHASE[n] for n in ("ascent", "cruise", "descent")]]


def scored(seed: int, *, days: int, aircraft: int) -> pd.DataFrame:
    """One archive: truth, estimate and interval of the fleet and of every cell, by state."""
    frames = dict(
        zip(("reported", "corrected"), simulated(seed, days=days, aircraft=aircraft), strict=True)
    )
    headings, corrected = datasets(*frames.values())
    began = time.process_time()
    found = observation_errors(headings, corrected, pools=POOLS, reference="ruc+rtfdaa")
    took, rows = time.process_time() - began, []
    for state, frame in frames.items():
        own = found.sel(state=state)
        fleet, cells = truth(frame, headings)
        bounds = own["fleet_observation_error_interval"].to_numpy()
        rows.append((state, "fleet", fleet, own["fleet_observation_error"].item(), *bounds, took))
        table = own["observation_error"].to_numpy()[1:]
        intervals = own["observation_error_interval"].to_numpy()[1:]
        for place in zip(*np.nonzero(np.isfinite(table)), strict=True):
            rows.append((state, "cell", cells[place], table[place], *intervals[place], took))
    columns = ["state", "what", "true", "found", "low", "high", "seconds"]
    return pd.DataFrame(rows, columns=columns).assign(seed=seed, believed=found.attrs["believed"])


def main() -> int:
    """Print every archive and the bars; 1 where one is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--first", type=int, default=500)
    parser.add_argument("--days", type=int, default=45)
    parser.add_argument("--aircraft", type=int, default=14)
    given = parser.parse_args()
    parts = []
    for seed in range(given.first, given.first + given.seeds):
        part = scored(seed, days=given.days, aircraft=given.aircraft)
        parts.append(part)
        for row in part[part["what"] == "fleet"].itertuples():
            print(
                f"{seed} {row.state}: true {row.true:.3f}, found {row.found:.3f} ({row.low:.3f} to "
                f"{row.high:.3f}) m/s by {row.believed}, {row.seconds:.1f} s",
                flush=True,
            )
    table = pd.concat(parts)
    table["relative"] = table["found"] / table["true"] - 1.0
    table["inside"] = (table["low"] <= table["true"]) & (table["true"] <= table["high"])
    missed = 0
    for (state, what), own in table.groupby(["state", "what"]):
        rms = float(np.sqrt((own["relative"] ** 2).mean()))
        print(
            f"{state}, {what}: {len(own)} cases, rms {100 * rms:.1f} %, mean "
            f"{100 * own['relative'].mean():+.1f} %, 95 % intervals hold {own['inside'].mean():.0%}"
        )
        if what == "fleet":
            missed += rms > 0.10
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
