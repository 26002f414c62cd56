"""How near an outside effect comes to what has a name, and which variables carry it.

Assumptions: the change an effect makes is known report by report (the archive against its twin).
What has a name is written down here once more, plainly and apart from the diagnosis: errors of
heading by one and two cycles, by icing, date, acceleration and bank, errors of airspeed, a wind too
strong or turned; least squares by aircraft gives the share of the change they take up. A
variable carries what the means over its bins take up of the change's signed size.

Validity: a few hundred reports an aircraft. Units: m/s, radians.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from airswing.synthetic.aircraft.outside_effects import CYCLIC, FLAGS

__all__ = ["carried_by", "named_share", "signed_size"]

Array = NDArray[np.float64]
# Of ten degrees where the variable is an angle, of equal numbers elsewhere.
BINS = 36


def _named_forms(variables: Mapping[str, Array], u: Array, v: Array) -> Array:
    """Return the wind errors (k, n, 2) of what has a name, at unit size."""
    heading, magnetic = variables["heading"], variables["magnetic_heading"]
    across = variables["airspeed"] * np.stack([np.cos(heading), -np.sin(heading)])
    along = np.stack([np.sin(heading), np.cos(heading)])
    sine, cosine = np.sin(magnetic), np.cos(magnetic)
    icing = np.asarray(variables["icing"] == 1, np.float64)
    turning = [
        np.ones_like(u),
        sine,
        cosine,
        np.sin(2 * magnetic),
        np.cos(2 * magnetic),
        icing,
        icing * sine,
        icing * cosine,
        variables["date"] / 30.0,
        variables["acceleration"] * sine,
        variables["bank"] * cosine,
    ]
    wind = np.stack([u, v])
    forms = [across * factor for factor in turning]
    forms += [along, along * variables["airspeed"] / 100.0, wind / 10.0, np.stack([v, -u]) / 10.0]
    return np.stack(forms).transpose(0, 2, 1)


def named_share(
    change: Array, variables: Mapping[str, Array], u: Array, v: Array, aircraft: NDArray[np.int64]
) -> float:
    """Return the share of a change's energy that what has a name takes up.

    Parameters
    ----------
    change : ndarray (n, 2)
        m/s.
    variables : mapping
        As `airswing.synthetic.aircraft.outside_effects` takes them.
    u, v : ndarray (n,)
        Wind as computed without the effect, m/s.
    aircraft : ndarray of int (n,)
        Whose report it is.

    Returns
    -------
    float
        In [0, 1]; 0 where nothing is changed.
    """
    total = float((change**2).sum())
    if total == 0.0:
        return 0.0
    explained = 0.0
    for one in np.unique(aircraft[np.any(change != 0.0, axis=1)]):
        rows = aircraft == one
        own = {name: values[rows] for name, values in variables.items()}
        forms = _named_forms(own, u[rows], v[rows])
        design = forms.reshape(len(forms), -1).T
        target = change[rows].ravel()
        # forms are alike where one flies few headings: what has no length counts for nothing
        solution = np.linalg.lstsq(design, target, rcond=1e-9)[0]
        explained += float((target**2).sum() - ((target - design @ solution) ** 2).sum())
    return explained / total


def signed_size(change: Array, u: Array, v: Array, heading: Array, component: str) -> Array:
    """Return a change along the component it was made in, (n,) m/s.

    Parameters
    ----------
    change : ndarray (n, 2)
        m/s.
    u, v, heading : ndarray (n,)
        Wind as computed (m/s) and heading (radians).
    component : str
        Of `airswing.synthetic.aircraft.outside_effects.COMPONENTS`, or ``scatter``: its length.
    """
    if component == "scatter":
        return np.asarray(np.hypot(*change.T))
    if component.endswith("heading"):
        east, north = np.sin(heading), np.cos(heading)
    else:
        speed = np.maximum(np.hypot(u, v), 1e-9)
        east, north = u / speed, v / speed
    if component in ("across_heading", "across_wind", "direction"):
        east, north = north, -east
    return np.asarray(change[:, 0] * east + change[:, 1] * north)


def carried_by(size: Array, variables: Mapping[str, Array]) -> dict[str, float]:
    """Return the share of a change that a function of each variable alone could make.

    Parameters
    ----------
    size : ndarray (n,)
        Signed size of the change on the aircraft that have it, m/s.
    variables : mapping
        Name to values (n,).

    Returns
    -------
    dict
        Name to share of the sum of squares, in [0, 1].
    """
    total = float((size**2).sum())
    out = {}
    for name, values in variables.items():
        bins = _bins(np.asarray(values, np.float64), name)
        count = np.maximum(np.bincount(bins), 1)
        # energy of the means of bins: what the best step function of the variable takes up
        own = np.bincount(bins, size) ** 2 / count
        out[name] = float(own.sum()) / total if total > 0.0 else 0.0
    return out


def _bins(values: Array, name: str) -> NDArray[np.int64]:
    if name in FLAGS:
        return np.asarray(values, np.int64) + 1
    if name in CYCLIC:
        turn = np.mod(values / CYCLIC[name], 1.0)
        return np.minimum((turn * BINS).astype(np.int64), BINS - 1)
    edges = np.quantile(values, np.linspace(0, 1, BINS + 1)[1:-1])
    return np.searchsorted(edges, values)
