"""What is true of an outside effect on its archive: size, variables, and how near a name comes.

Assumptions: as `airswing.synthetic.sealed.nearness`. An effect is fit for a case when it changes
reports by `LEAST_SIZE` and more, its sum of squares exceeds `LEAST_ENERGY`, and less than
`MOST_NAMED` of it is what has a name: else whoever names that would be right. The least energy is
what a single known curve needs to stand four standard errors out of winds that err by 2.4 m/s along
correlated flights (four reports to one independent value): below it nothing could be seen.

Units: m/s, kt for a closure.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.synthetic.aircraft.outside_effects import (
    KNOT,
    outside_change,
    parts_of,
    report_variables,
    scatter_change,
)
from airswing.synthetic.sealed.labels import Injected, OutsideTruth
from airswing.synthetic.sealed.nearness import carried_by, named_share, signed_size

__all__ = [
    "LEAST_ENERGY",
    "LEAST_SIZE",
    "MOST_NAMED",
    "WORTH_KT",
    "is_fit",
    "outside_truth",
]

Array = NDArray[np.float64]

LEAST_ENERGY = 400.0  # (m/s)^2, the least sum of squares of the change
LEAST_SIZE = 0.3  # m/s, root mean square where the effect acts
WORTH_KT = 0.1  # A closure that must not be missed, kt
MOST_NAMED = 0.35  # Largest share of the energy that what has a name may take up


def _chosen(frame: pd.DataFrame, effect: Injected) -> NDArray[np.bool_]:
    """Return the reports (n,) of an effect's aircraft and period."""
    here = np.ones(len(frame), bool)
    if effect["tails"] is not None:
        here &= np.isin(frame["tail"].to_numpy(str), np.array(effect["tails"]))
    if effect["period"] is not None:
        here &= frame["time"].to_numpy() >= np.datetime64(effect["period"][0])
    return here


def outside_truth(
    frame: pd.DataFrame, innovation: Array, effect: Injected, *, seed: int
) -> OutsideTruth:
    """Measure an outside effect on an archive without it.

    Parameters
    ----------
    frame : pandas.DataFrame
        Reports of the archive without the effect, with the exact state.
    innovation : ndarray (n, 2)
        Its reported minus reference wind, m/s.
    effect : mapping
        ``tails, parameters, period``.
    seed : int
        Of effects that draw; another draw than the archive's own tells the same.

    Returns
    -------
    dict
        ``component, shape, variables, scope, reports, size_m_s, named_share, closes_kt`` (near
        enough: before the winds are coded), ``carried``.
    """
    u, v = frame["computed_u"].to_numpy(float), frame["computed_v"].to_numpy(float)
    variables = report_variables(frame, u, v, frame["hours"].to_numpy(float))
    parameters, chosen = effect["parameters"], _chosen(frame, effect)
    if "kind" in parameters:
        rng = np.random.default_rng(seed)
        change = scatter_change(parameters, u, v, variables, chosen, rng)
    else:
        change = outside_change(parameters, u, v, variables, chosen)
    moved = np.hypot(*change.T)
    acts = moved > 0.05 * moved.max(initial=0.0)
    size = float(np.sqrt((moved[acts] ** 2).mean())) if acts.any() else 0.0
    own = {name: values[chosen] for name, values in variables.items()}
    component = str(parameters["component"])
    signed = signed_size(change, u, v, variables["heading"], component)
    named = 0.0
    if component != "scatter":
        named = named_share(change, variables, u, v, frame["aircraft"].to_numpy(int))
    longer = np.hypot(*(innovation + change).T) - np.hypot(*innovation.T)
    tails = effect["tails"]
    return {
        "component": component,
        "shape": str(parameters.get("kind", parameters["shape"])),
        "variables": _true_variables(parameters),
        "scope": "all" if tails is None else "one" if len(tails) == 1 else "some",
        "reports": int(acts.sum()),
        "size_m_s": round(size, 3),
        "named_share": round(named, 3),
        "closes_kt": round(float(np.nanmean(longer)) / KNOT, 3),
        "carried": {k: round(share, 3) for k, share in carried_by(signed[chosen], own).items()},
    }


def _true_variables(parameters: Mapping[str, object]) -> list[str]:
    """Return the variables an effect acts by; for one of scatter those of the wind it changes."""
    own = [str(part["variable"]) for part in parts_of(parameters)]
    kind = parameters.get("kind")
    if kind == "lattice":
        own += ["wind_direction", "wind_speed"]
    elif kind in ("floor", "ceiling", "hole"):
        own.append("wind_speed")
    return list(dict.fromkeys(own))


def is_fit(told: OutsideTruth) -> bool:
    """Return whether an outside effect is fit for a case.

    Parameters
    ----------
    told : mapping
        From `outside_truth`.
    """
    return bool(
        told["reports"] * told["size_m_s"] ** 2 >= LEAST_ENERGY
        and told["size_m_s"] >= LEAST_SIZE
        and told["named_share"] < MOST_NAMED
    )
