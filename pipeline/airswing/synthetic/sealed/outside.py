"""Truth of an outside effect on its archive: size, variables, and how near a named effect comes.

Named effects are written here once more, apart from the diagnosis; least squares by aircraft gives
the share of the change they explain. A variable carries the share of the signed size of the change
that the means over its bins explain. An effect is fit for a case when it changes reports by
`LEAST_SIZE` and more, its sum of squares exceeds `LEAST_ENERGY` (a single known curve is then four
standard errors, with errors of the winds of 2.4 m/s and four reports to one independent value), and
named effects explain less than `MOST_NAMED` of it. Units: m/s, radians, kt for a closure.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.synthetic.atmosphere import Array
from airswing.synthetic.outside_effects import (
    CYCLIC,
    FLAGS,
    component_axes,
    effect_change,
    report_variables,
)
from airswing.synthetic.sealed.labels import Injected, OutsideTruth
from airswing.units import KNOT

LEAST_ENERGY = 400.0
"""(m/s)^2, the least sum of squares of the change."""
LEAST_SIZE = 0.3
"""m/s, root mean square where the effect acts."""
WORTH_KT = 0.1
"""A closure that must not be missed, kt."""
MOST_NAMED = 0.35
"""Largest share of the energy that named effects may explain."""
BINS = 36
"""Of ten degrees where the variable is an angle, of equal numbers elsewhere."""


def outside_truth(
    frame: pd.DataFrame, innovation: Array, effect: Injected, *, seed: int
) -> OutsideTruth:
    """Measure an outside effect on an archive without it and its innovation (n, 2)."""
    u, v = frame["computed_u"].to_numpy(float), frame["computed_v"].to_numpy(float)
    variables = report_variables(frame, u, v, frame["hours"].to_numpy(float))
    parameters, tails, period = effect["parameters"], effect["tails"], effect["period"]
    chosen = np.ones(len(frame), bool)
    if tails is not None:
        chosen &= np.isin(frame["tail"].to_numpy(str), np.array(tails))
    if period is not None:
        chosen &= frame["time"].to_numpy() >= np.datetime64(period[0])
    change = effect_change(parameters, u, v, variables, chosen, np.random.default_rng(seed))
    moved = np.hypot(*change.T)
    acts = moved > 0.05 * moved.max(initial=0.0)
    size = float(np.sqrt((moved[acts] ** 2).mean())) if acts.any() else 0.0
    affected = {name: values[chosen] for name, values in variables.items()}
    component = str(parameters["component"])
    signed = signed_size(change, u, v, variables["heading"], component)
    named = 0.0
    if component != "scatter":
        named = named_share(change, variables, u, v, frame["aircraft"].to_numpy(int))
    longer = np.hypot(*(innovation + change).T) - np.hypot(*innovation.T)
    acting = [str(part["variable"]) for part in parameters["parts"]]
    if parameters.get("kind") == "lattice":
        acting += ["wind_direction", "wind_speed"]
    elif parameters.get("kind") in ("floor", "ceiling", "hole"):
        acting.append("wind_speed")
    carried = carried_by(signed[chosen], affected)
    return {
        "component": component,
        "shape": str(parameters.get("kind", parameters["shape"])),
        "variables": list(dict.fromkeys(acting)),
        "scope": "all" if tails is None else "one" if len(tails) == 1 else "some",
        "reports": int(acts.sum()),
        "size_m_s": round(size, 3),
        "named_share": round(named, 3),
        "closes_kt": round(float(np.nanmean(longer)) / KNOT, 3),
        "carried": {name: round(share, 3) for name, share in carried.items()},
    }


def is_fit(truth: OutsideTruth) -> bool:
    """Whether an outside effect is fit for a case."""
    return bool(
        truth["reports"] * truth["size_m_s"] ** 2 >= LEAST_ENERGY
        and truth["size_m_s"] >= LEAST_SIZE
        and truth["named_share"] < MOST_NAMED
    )


def _named_forms(variables: Mapping[str, Array], u: Array, v: Array) -> Array:
    """Wind errors (k, n, 2) of named effects at unit size."""
    heading, magnetic = variables["heading"], variables["magnetic_heading"]
    across = variables["airspeed"] * np.stack([np.cos(heading), -np.sin(heading)])
    along = np.stack([np.sin(heading), np.cos(heading)])
    sine, cosine = np.sin(magnetic), np.cos(magnetic)
    icing = np.asarray(variables["icing"] == 1, np.float64)
    turning = [np.ones_like(u), sine, cosine, np.sin(2 * magnetic), np.cos(2 * magnetic)]
    turning += [icing, icing * sine, icing * cosine, variables["date"] / 30.0]
    turning += [variables["acceleration"] * sine, variables["bank"] * cosine]
    wind = np.stack([u, v])
    forms = [across * factor for factor in turning]
    forms += [along, along * variables["airspeed"] / 100.0, wind / 10.0, np.stack([v, -u]) / 10.0]
    return np.stack(forms).transpose(0, 2, 1)


def named_share(
    change: Array, variables: Mapping[str, Array], u: Array, v: Array, aircraft: NDArray[np.int64]
) -> float:
    """Share, in [0, 1], of the energy of a change (n, 2) that named effects explain."""
    total = float((change**2).sum())
    if total == 0.0:
        return 0.0
    explained = 0.0
    for one in np.unique(aircraft[np.any(change != 0.0, axis=1)]):
        rows = aircraft == one
        forms = _named_forms({k: values[rows] for k, values in variables.items()}, u[rows], v[rows])
        design = forms.reshape(len(forms), -1).T
        target = change[rows].ravel()
        # Forms are alike where few headings are flown: singular values near zero do not count.
        solution = np.linalg.lstsq(design, target, rcond=1e-9)[0]
        explained += float((target**2).sum() - ((target - design @ solution) ** 2).sum())
    return explained / total


def signed_size(change: Array, u: Array, v: Array, heading: Array, component: str) -> Array:
    """A change (n, 2) along the component it was made in, (n,) m/s; of ``scatter`` its length."""
    if component == "scatter":
        return np.asarray(np.hypot(*change.T))
    across = ("across_heading", "across_wind", "direction")
    east, north = component_axes(component, u, v, heading, across=across)
    return np.asarray(change[:, 0] * east + change[:, 1] * north)


def carried_by(size: Array, variables: Mapping[str, Array]) -> dict[str, float]:
    """Share of the sum of squares of a signed size that a function of each variable could make."""
    total = float((size**2).sum())
    found = {}
    for name, values in variables.items():
        if name in FLAGS:
            bins = values.astype(np.int64) + 1
        elif name in CYCLIC:
            turn = np.mod(values / CYCLIC[name], 1.0)
            bins = np.minimum((turn * BINS).astype(np.int64), BINS - 1)
        else:
            bins = np.searchsorted(np.quantile(values, np.linspace(0, 1, BINS + 1)[1:-1]), values)
        # Energy of the means of bins: that of the best step function of the variable.
        energy = np.bincount(bins, size) ** 2 / np.maximum(np.bincount(bins), 1)
        found[name] = float(energy.sum()) / total if total > 0.0 else 0.0
    return found
