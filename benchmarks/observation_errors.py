"""Error of the reports alone, compared with the truth of simulated archives.

    python -m benchmarks.observation_errors [--seeds 60] [--days 45] [--aircraft 14]

Bars: the estimated error within 10 % (root mean square over archives) of the simulated one, over
the fleet and for every phase and layer, as reported and as corrected; 95 % intervals that contain
the truth in 90 to 98 % of the cells. Exit status 1 where a bar is missed.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import airswing
from airswing.evaluation.innovations import CELLS, STATES, profile_cells
from airswing.evaluation.observation_errors import FLIGHT_PHASES, observation_errors
from airswing.flags import CORRECTION, PHASE
from airswing.products.ragged import aircraft_of_report
from airswing.synthetic.archive import simulate_arrays, write_reports
from airswing.synthetic.truth import fleet_deviations

REFERENCES = ("ruc", "rtfdaa")
POOLS = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"], "ruc+rtfdaa": list(REFERENCES)}


def archive(seed, *, days, aircraft, effects=None):
    """Screened headings, corrected winds and the simulated table (row a report) of one archive."""
    if effects is None:
        effects = fleet_deviations([f"N{401 + index}" for index in range(aircraft)], seed)
    options = {"days": days, "aircraft": aircraft, "seed": seed}
    frame = simulate_arrays(**options, effects=effects)
    with tempfile.TemporaryDirectory() as folder:
        write_reports(Path(folder), frame)
        reports = airswing.read_reports(f"{folder}/*.csv").load()
    # the rows of the simulated table in the order of the reports
    tails = reports["aircraft"].to_numpy()[aircraft_of_report(reports)]
    frame = frame.set_index(["tail", "time"]).loc[
        list(zip(tails, reports["time"].to_numpy(), strict=True))
    ]
    models = xr.Dataset(
        {
            f"reference_{way}_wind": (
                ("reference", "report"),
                np.stack([frame[f"{letter}_{name}"] for name in REFERENCES]),
            )
            for way, letter in (("eastward", "u"), ("northward", "v"))
        },
        coords={"reference": list(REFERENCES)},
    )
    headings = airswing.screen(airswing.derive_headings(reports, models))
    pools = {"ruc+rtfdaa": list(REFERENCES)}
    fits = airswing.add_tables(airswing.fit_deviation(headings, pools=pools), headings)
    return headings, airswing.correct(headings, fits), frame


def truth(headings, corrected, frame, state):
    """True error of a component of the reports that count: fleet, and by phase and layer."""
    wind = frame[["true_u", "true_v"]].to_numpy().T
    prefix = "corrected_" if state == "corrected" else ""
    names = [f"{prefix}{way}_wind" for way in ("eastward", "northward")]
    square = 0.5 * ((np.stack([corrected[name] for name in names]) - wind) ** 2).sum(axis=0)
    cell, cells = profile_cells(headings), CELLS
    good = (cell >= 0) & np.isfinite(square)
    good &= np.isfinite(headings["reference_eastward_wind"].to_numpy()).all(axis=0)
    applied = [CORRECTION[name] for name in ("corrected", "no_correction_needed")]
    good &= np.isin(corrected["correction_applied"], applied)
    total = np.bincount(cell[good], weights=square[good], minlength=cells)
    with np.errstate(invalid="ignore"):
        table = np.sqrt(total / np.bincount(cell[good], minlength=cells))
    rows = table.reshape(len(PHASE), -1)
    return float(np.sqrt(square[good].mean())), rows[[PHASE[n] for n in FLIGHT_PHASES[1:]]]


def scored(seed, *, days, aircraft):
    """Truth, estimate and interval of the fleet and of every cell of one archive, by state."""
    headings, corrected, frame = archive(seed, days=days, aircraft=aircraft)
    errors = observation_errors(headings, corrected, pools=POOLS, reference="ruc+rtfdaa")
    rows = []
    for state in STATES:
        of_state = errors.sel(state=state)
        fleet, cells = truth(headings, corrected, frame, state)
        bounds = of_state["fleet_observation_error_interval"].to_numpy()
        rows.append((state, "fleet", fleet, of_state["fleet_observation_error"].item(), *bounds))
        table = of_state["observation_error"].to_numpy()[1:]
        intervals = of_state["observation_error_interval"].to_numpy()[1:]
        for place in zip(*np.nonzero(np.isfinite(table)), strict=True):
            rows.append((state, "cell", cells[place], table[place], *intervals[place]))
    columns = ["state", "what", "true", "found", "low", "high"]
    return pd.DataFrame(rows, columns=columns).assign(seed=seed)


def main():
    """Print every archive and the bars; 1 where one is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--first", type=int, default=700)
    parser.add_argument("--days", type=int, default=45)
    parser.add_argument("--aircraft", type=int, default=14)
    options = parser.parse_args()
    parts, good = [], True
    for seed in range(options.first, options.first + options.seeds):
        parts.append(scored(seed, days=options.days, aircraft=options.aircraft))
        print(parts[-1].query("what == 'fleet'").round(3).to_string(header=False), flush=True)
    table = pd.concat(parts)
    table["relative"] = table["found"] / table["true"] - 1.0
    table["inside"] = (table["low"] <= table["true"]) & (table["true"] <= table["high"])
    for (state, scope), cases in table.groupby(["state", "what"]):
        rms, inside = float(np.sqrt((cases["relative"] ** 2).mean())), float(cases["inside"].mean())
        error = cases.groupby("seed")["inside"].mean().std() / np.sqrt(options.seeds)
        print(
            f"{state}, {scope}: {len(cases)} cases, true {cases['true'].mean():.2f} m/s, rms "
            f"{100 * rms:.1f} %, mean {100 * cases['relative'].mean():+.1f} %; 95 % intervals "
            f"contain the truth in {100 * inside:.1f} +- {100 * error:.1f} %"
        )
        good &= rms <= 0.10 and (scope == "fleet" or 0.90 <= inside <= 0.98)
    return int(not good)


if __name__ == "__main__":
    raise SystemExit(main())
