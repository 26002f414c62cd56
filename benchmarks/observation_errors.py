"""The error of the reports alone, held against the truth of simulated archives.

    python -m benchmarks.observation_errors [--seeds 60] [--days 45] [--aircraft 14]

Every archive's reports are written and read as files, model winds are what an exact reader finds,
and headings, screening, fits, tables and corrected winds are the package's own, with whatever error
the correction leaves. The error found from reports and both references alone is held against the
one the simulation knows, for winds as reported and as corrected, over the fleet and for every
phase and layer. Bars: within 10 % (root mean square over archives), and 95 % intervals that hold
the truth in 90 to 98 % of the cells; intervals of cells of one archive are not independent of each
other, so the share of every archive's is averaged with a standard error over archives.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

import airswing
from airswing.evaluation.error_profiles import STATES, profile_cells
from airswing.evaluation.observation_errors import (
    FLIGHT_PHASES,
    observation_errors,
)
from airswing.flags import CORRECTION, PHASE
from airswing.products.ragged import aircraft_of_report
from airswing.synthetic.archive import simulate_arrays, write_reports
from airswing.synthetic.truth import fleet_deviations

REFERENCES = ("ruc", "rtfdaa")
POOLS = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"], "ruc+rtfdaa": list(REFERENCES)}
Floats = NDArray[np.float64]


def archive(seed: int, *, days: int, aircraft: int) -> tuple[xr.Dataset, xr.Dataset, Floats]:
    """Screened headings and corrected winds of one archive, and the true wind (2, report)."""
    tails = [f"N{401 + index}" for index in range(aircraft)]
    effects = fleet_deviations(tails, seed)
    size = {"days": days, "aircraft": aircraft, "seed": seed, "derivatives": False}
    frame = simulate_arrays(**size, effects=effects)
    with tempfile.TemporaryDirectory() as folder:
        write_reports(Path(folder), frame)
        reports = airswing.read_reports(f"{folder}/*.csv").load()
    frame = frame.iloc[_rows(frame, reports)]
    winds = {
        f"reference_{way}_wind": (
            ("reference", "report"),
            np.stack([frame[f"{letter}_{name}"] for name in REFERENCES]),
        )
        for way, letter in (("eastward", "u"), ("northward", "v"))
    }
    models = xr.Dataset(winds, coords={"reference": list(REFERENCES)})
    headings = airswing.screen(airswing.derive_headings(reports, models))
    pools = {"ruc+rtfdaa": list(REFERENCES)}
    fits = airswing.add_tables(airswing.fit_deviation(headings, pools=pools), headings)
    return headings, airswing.correct(headings, fits), frame[["true_u", "true_v"]].to_numpy().T


def _rows(frame: pd.DataFrame, reports: xr.Dataset) -> NDArray[np.int64]:
    """Row of the simulated table of every report that was read."""
    keys = zip(frame["tail"], frame["time"], strict=True)
    place = {key: row for row, key in enumerate(keys)}
    tails = reports["aircraft"].to_numpy()[aircraft_of_report(reports)]
    return np.array([place[key] for key in zip(tails, reports["time"].to_numpy(), strict=True)])


def truth(
    headings: xr.Dataset, corrected: xr.Dataset, wind: Floats, state: str
) -> tuple[float, Floats]:
    """True error of a component of the reports that count: fleet, and by phase and layer."""
    prefix = "corrected_" if state == "corrected" else ""
    names = [f"{prefix}{way}_wind" for way in ("eastward", "northward")]
    off = np.stack([corrected[name].to_numpy() for name in names]) - wind
    square = 0.5 * (off**2).sum(axis=0)
    cell, cells = profile_cells(headings)
    model = headings["reference_eastward_wind"].to_numpy()
    good = (cell >= 0) & np.isfinite(square) & np.isfinite(model).all(axis=0)
    good &= corrected["correction_applied"].to_numpy() == CORRECTION["corrected"]
    total = np.bincount(cell[good], weights=square[good], minlength=cells)
    with np.errstate(invalid="ignore"):
        table = np.sqrt(total / np.bincount(cell[good], minlength=cells))
    rows = table.reshape(len(PHASE), -1)
    return float(np.sqrt(square[good].mean())), rows[[PHASE[n] for n in FLIGHT_PHASES[1:]]]


def scored(seed: int, *, days: int, aircraft: int) -> pd.DataFrame:
    """One archive: truth, estimate and interval of the fleet and of every cell, by state."""
    headings, corrected, wind = archive(seed, days=days, aircraft=aircraft)
    began = time.process_time()
    found = observation_errors(headings, corrected, pools=POOLS, reference="ruc+rtfdaa")
    took, rows = time.process_time() - began, []
    for state in STATES:
        own = found.sel(state=state)
        fleet, cells = truth(headings, corrected, wind, state)
        bounds = own["fleet_observation_error_interval"].to_numpy()
        rows.append((state, "fleet", fleet, own["fleet_observation_error"].item(), *bounds, took))
        table = own["observation_error"].to_numpy()[1:]
        intervals = own["observation_error_interval"].to_numpy()[1:]
        for place in zip(*np.nonzero(np.isfinite(table)), strict=True):
            rows.append((state, "cell", cells[place], table[place], *intervals[place], took))
    columns = ["state", "what", "true", "found", "low", "high", "seconds"]
    return pd.DataFrame(rows, columns=columns).assign(seed=seed, believed=found.attrs["method"])


def told(table: pd.DataFrame) -> tuple[str, bool]:
    """What came out, and whether the bars are met."""
    table = table.assign(
        relative=table["found"] / table["true"] - 1.0,
        inside=(table["low"] <= table["true"]) & (table["true"] <= table["high"]),
    )
    lines, good = [], True
    for (state, what), own in table.groupby(["state", "what"]):
        rms = float(np.sqrt((own["relative"] ** 2).mean()))
        shares = own.groupby("seed")["inside"].mean()
        held = float(own["inside"].mean())
        lines.append(
            f"{state}, {what}: {len(own)} cases of {shares.size} archives, true "
            f"{own['true'].mean():.2f} m/s, rms {100 * rms:.1f} %, mean "
            f"{100 * own['relative'].mean():+.1f} %, 95 % intervals hold {100 * held:.1f} % "
            f"(+- {100 * shares.std() / np.sqrt(shares.size):.1f})"
        )
        good &= rms <= 0.10 and (what == "fleet" or 0.90 <= held <= 0.98)
    return "\n".join(lines), good


def main() -> int:
    """Print every archive and the bars; 1 where one is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--first", type=int, default=700)
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
    text, good = told(pd.concat(parts))
    print(text)
    return int(not good)


if __name__ == "__main__":
    raise SystemExit(main())
