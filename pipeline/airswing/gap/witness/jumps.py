"""Jumps: values of a variable at which the residual changes between one report and the next.

Assumptions: weather and the model's error are smooth along a flight; an effect that begins at a
value (a step, the sides of a sector) is not. With q = V^-1 r of the residual (days and what lasts
taken out), a jump pulls the reports just beyond the value one way and those just before it the
other way, on every flight that crosses it. So the sum of q over a few narrow cells above a value
less that below it stands out there and nowhere else, though a table in coarse cells shows nothing:
an edge that is known to half the distance between reports gives a hundred times the evidence of one
known to two.

Validity: variables that are smooth along a flight (:data:`NOT_SMOOTH` are not: what differs between
climb and cruise would jump in them), and not the reported wind, which holds the residual's own
noise. Aircraft-days scatter independently.

Units: standard errors; nats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import OF_THE_REPORT
from airswing.gap.archive.value_tables import COMPONENTS, Axis, Grid
from airswing.gap.noise.beside_neighbours import even_interpolation_errors, evened
from airswing.gap.witness.bench import Bench

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Variables in which what is smooth along a flight may jump.
NOT_SMOOTH = ("acceleration", "bank", "turn", "last_turn", *OF_THE_REPORT)
#: Values of a variable at which it may jump, and cells on either side that are summed.
CELLS, REACH = 400, (1, 2, 4)
#: Bound on single errors, in standard deviations.
BOUND = 5.0
#: Standard errors from which a jump is an edge of a table whose evidence stands on another.
EDGE = 4.5
#: Cells apart that edges are, and edges of a table at most.
APART, MOST = 8, 6
#: Aircraft-days that must cross a value.
CROSSED = 30


@dataclass(frozen=True)
class Jumps:
    """Values at which a component of the residual jumps."""

    component: str
    variable: str
    at: tuple[float, ...]  # increasing, in the variable's unit
    # evidence of the strongest: half its squared standard errors, less the log of the number of
    # values, variables and components looked at
    nats: float

    def grid(self, bench: Bench) -> Grid:
        """Cells between the jumps."""
        variable = bench.variables[self.variable]
        outer = variable.edges(1)
        inner = [value for value in self.at if outer[0] < value < outer[-1]]
        return Grid((Axis(self.variable, variable.kind, np.array([outer[0], *inner, outer[-1]])),))


def jumps(bench: Bench) -> list[Jumps]:
    """Jumps of the real residual, strongest first.

    Returns
    -------
    list of Jumps
        One a variable: of the component in which it jumps most.
    """
    pulled = _pulled(bench)
    places = {
        name: _places(variable.values)
        for name, variable in bench.variables.items()
        if variable.kind != "category" and name not in NOT_SMOOTH
    }
    looked = len(COMPONENTS) * sum(values.size for values in places.values())
    found = []
    for name, values in places.items():
        cell = np.searchsorted(values, bench.variables[name].values, "right")
        cell[np.isnan(bench.variables[name].values)] = -1
        each = [(c, deviations(bench, pulled, c, cell, values.size + 1)) for c in COMPONENTS]
        component, strength = max(each, key=lambda one: float(np.abs(one[1]).max(initial=0.0)))
        peaks = _peaks(np.abs(strength))
        if peaks:
            nats = 0.5 * float(strength[peaks[0]] ** 2) - np.log(looked)
            found.append(Jumps(component, name, tuple(sorted(values[peaks])), float(nats)))
    return sorted(found, key=lambda one: -one.nats)


def deviations(bench: Bench, pulled: Floats, component: str, cell: Integers, size: int) -> Floats:
    """Jump between each cell and the next, in standard errors, (size - 1,).

    Parameters
    ----------
    pulled : (n, 2) float
        V^-1 r.
    cell : (n,) int
        Narrow cell of every report, -1 for none.
    size : int
        Number of cells.
    """
    setting, known = bench.setting, cell >= 0
    pull = np.einsum("nc,nc->n", pulled, bench.direction(component))[known]
    owner = setting.frame.aircraft * (int(setting.day.max()) + 1) + setting.day
    shape = int(owner.max()) + 1, size
    key = (owner * size + cell)[known]
    by_cell = np.bincount(key, pull, shape[0] * size).reshape(shape)
    below = np.concatenate([np.zeros((shape[0], 1)), by_cell.cumsum(axis=1)], axis=1)
    edge, best = np.arange(1, size), np.zeros(size - 1)
    for reach in REACH:
        jump = below[:, np.minimum(edge + reach, size)] - 2 * below[:, edge]
        jump += below[:, np.maximum(edge - reach, 0)]
        spread = np.sqrt((jump**2).sum(axis=0))
        told = np.divide(jump.sum(axis=0), spread, out=np.zeros_like(spread), where=spread > 0)
        told[(jump != 0).sum(axis=0) < CROSSED] = 0.0
        best = np.where(np.abs(told) > np.abs(best), told, best)
    return best


def _pulled(bench: Bench) -> Floats:
    """V^-1 r of the real residual, day fields and what lasts taken out, (n, 2)."""
    setting = bench.setting
    cleared = setting.ground.cleared(
        setting.quiet,
        bench.residuals[:1],
        plan=setting.plan,
        day=setting.day,
        rows=np.arange(setting.frame.size),
    )[0]
    gains = setting.noise.gains
    errors, precision = even_interpolation_errors(cleared, setting.noise.order, gains)
    root = np.sqrt(precision)[:, None]
    return evened(np.clip(errors * root, -BOUND, BOUND) * root, gains)


def _places(values: Floats) -> Floats:
    """Values between which about as many reports lie."""
    known = values[np.isfinite(values)]
    return np.unique(np.quantile(known, np.arange(1, CELLS) / CELLS))


def _peaks(strength: Floats) -> list[int]:
    """Places of the strongest jumps, strongest first."""
    left = strength.copy()
    out: list[int] = []
    while len(out) < MOST and left.max(initial=0.0) >= EDGE:
        out.append(int(np.argmax(left)))
        left[max(0, out[-1] - APART) : out[-1] + APART + 1] = 0.0
    return out
