"""Rung 0: the generator's own numerical error, against the smallest effect it is used to judge.

Assumptions: an archive written as GRIB and read back by the package's own collocation must give
the reference winds the generator states (an exact reader of the same grids), and an effect
switched on must change nothing but what it acts on.

Validity: differences are of the numerics alone: both sides see the packed grids.

Units: m/s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from airswing.blind_check.baselines import collocated
from airswing.synthetic.sample.sample_archive import simulate_arrays
from airswing.synthetic.sealed.cases import Case, World
from airswing.synthetic.sealed.sealed_archives import Archivist, generator_options

__all__ = ["SMALLEST", "prove_generator"]

SMALLEST = 0.2  # Smallest effect drawn, m/s; the generator's error must stay under 5 % of it


def prove_generator(folder: Path, *, seed: int) -> dict[str, float]:
    """Measure the generator's numerical errors.

    Parameters
    ----------
    seed : int
        Of the archive, eight days of four aircraft.

    Returns
    -------
    dict
        Root mean square differences, m/s: ``reference wind, files against generator``,
        ``reported wind, files against generator``, ``aircraft without the effect, with against
        without``.
    """
    world = World(seed, "default", days=8, aircraft=4)
    archivist = Archivist(folder)
    archivist.write(Case("proof", 0, "null", world))
    frame = collocated(folder / "cases" / "proof" / "config.yaml", folder / "proof")
    own = simulate_arrays(effects=[], derivatives=False, **generator_options(world))
    tails = np.array(frame.tails)[frame.aircraft]
    read = pd.DataFrame(
        {
            "tail": tails,
            "time": frame.time.astype("int64"),
            "latitude": np.round(frame.latitude, 3),
            "u_rep": frame.u_rep,
            "v_rep": frame.v_rep,
            "u_ref": frame.u_ref,
            "v_ref": frame.v_ref,
        }
    )
    own["time"] = own["time"].to_numpy("datetime64[s]").astype("int64")
    own["latitude"] = own["latitude"].round(3)
    both = read.merge(own, on=["tail", "time", "latitude"])
    reference = [both[f"{c}_ref"] - (both[f"{c}_ruc"] + both[f"{c}_rtfdaa"]) / 2 for c in "uv"]
    reported = [both[f"{c}_rep"] - both[c] for c in "uv"]
    return {
        "reference wind, files against generator": _rms(reference),
        "reported wind, files against generator": _rms(reported),
        "aircraft without the effect, with against without": _untouched(world, own),
    }


def _rms(parts: list[pd.Series]) -> float:
    stacked = np.stack([part.to_numpy(float) for part in parts])
    return float(np.sqrt((stacked**2).sum(axis=0).mean()))


def _untouched(world: World, own: pd.DataFrame) -> float:
    """Return by how much an effect on one aircraft changes the reports of the others."""
    effect = {"name": "hard_iron", "tails": ["N401"], "parameters": {"amplitude_deg": 3.0}}
    changed = simulate_arrays(effects=[effect], derivatives=False, **generator_options(world))
    others = (own["tail"] != "N401").to_numpy()
    return _rms([changed[name][others] - own[name][others] for name in ("u", "v")])
