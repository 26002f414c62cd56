"""Curves of the dictionary as tables, so that a simulation can hold them.

Assumptions: a group of the heading's frame acts on one component by one variable, or by one and
the magnetic heading; the table's value in a cell is the mean of the fitted curve there.

Validity: groups across and along the heading. Those of the reference wind's own frame (tendency,
advection, shear ...) are no table of what a report records, and have none.

Units: m/s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import UNITS, record
from airswing.gap.archive.value_tables import Grid, axis_of, change_of
from airswing.gap.design.basis import variables
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.linearised import FoundFirst
from airswing.gap.result.schema import CurveEntry
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]

#: Components of the dictionary as an empirical effect calls them.
COMPONENT = {"cross": "across_heading", "along": "along_heading"}
#: Cells of a table of one variable and of two, by kind: a sixth of the highest cycle of the
#: dictionary (six) is ten degrees.
CELLS = {"circular": (36, 24), "linear": (20, 10), "category": (3, 3)}


def table_of_term(problem: Problem, term: Term, values: Floats) -> CurveEntry | None:
    """Mean of a fitted curve in the cells of its variables.

    Parameters
    ----------
    term : Term
        A dictionary group.
    values : (t, k) float
        Its coefficients, of each aircraft or of the fleet.

    Returns
    -------
    CurveEntry or None
        None for a group that is no table.
    """
    names = variables(term.candidate.name)
    component = COMPONENT.get(term.candidate.component)
    known = record(problem.archive, problem.context)
    if component is None or term.period is not None or not set(names) <= set(known):
        return None
    grid = Grid(tuple(axis_of(known[n], CELLS[known[n].kind][len(names) - 1]) for n in names))
    cells = grid.cells(tuple(known[n].values for n in names))
    context, own = problem.context, np.array(term.tails)
    error = FoundFirst.of(problem, [term], [values]).errors(context, context).linear
    direction = change_of(
        component, heading=context.heading, airspeed=context.airspeed, u=error[:, 0], v=error[:, 1]
    )
    amount, tails = (error * direction).sum(axis=1), problem.archive.tails

    def means(aircraft: NDArray[np.int64]) -> list[float]:
        rows = np.flatnonzero(np.isin(context.aircraft, aircraft) & (cells >= 0))
        count = np.bincount(cells[rows], minlength=grid.size)
        total = np.bincount(cells[rows], amount[rows], minlength=grid.size)
        return [float(x) for x in total / np.maximum(count, 1)]

    whole = means(own)
    each = None
    if term.candidate.scope == "aircraft" and own.size > 1:
        each = {tails[a]: means(np.array([a])) for a in own}
    return CurveEntry(
        labels=grid.labels,
        m_s=whole,
        unit="m/s",
        variables=names,
        variable_units=[UNITS[name] for name in names],
        edges=[[float(x) for x in axis.edges] for axis in grid.axes],
        values=whole,
        per_tail=each,
    )
