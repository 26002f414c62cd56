"""How sure it is what a table closes.

Assumptions: beside the fit's own error a table misses what its cells do not resolve and what its
variables, some known roughly, blur; the reference's error may follow its cells in every week.

Validity: that of the table's roots; 200 draws.

Units: m/s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import OF_THE_REPORT
from airswing.gap.archive.value_tables import change_of
from airswing.gap.held_out.reduction import take_off
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.fitted_tables import Unknown, explained, field_of, halved

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: What a table misses of its effect on average, as a share of what it closes, beside what its cells
#: do not resolve: measured against twins (docs/gap_check.md), 0 to 0.3 in nine archives.
MISSED = 0.1
#: The same where a variable is known roughly: 0.55 and 0.8 of acceleration, 0.85 of ground speed,
#: of bank and drift as little is known; reports that an effect moved into a cell of the reported
#: wind stand there among others that it left alone (0.4 and 1.3). Airspeed is that of a wind
#: without its small scales: of a saw by it a table closed 0.32 of 0.69 kt, of a sector half.
ROUGH = ("acceleration", "bank", "turn", "ground_speed", "drift")
KNOWN_ROUGHLY = dict.fromkeys(ROUGH, 0.7) | dict.fromkeys(OF_THE_REPORT, 0.8) | {"airspeed": 1.0}
#: Relative standard error of what a table closes from the reference's error that follows its cells
#: in every week: of simulated fleets, tables are up to 4 % above the truth (docs/gap_check.md).
LASTS = 0.04
#: Draws of what an unknown closes.
DRAWS = 200


def missed(bench: Bench, unknown: Unknown, fold: Integers) -> float:
    """Share of what a table closes that it misses: by its cells, and by its variables.

    Where the effect has an edge in a cell, halves of cells miss half as much as cells do; where it
    has a slope, a quarter: so cells miss at most twice what their halves explain more.
    """
    own = explained(bench, field_of(bench, unknown, fold))
    finer = [explained(bench, field_of(bench, one, fold)) for one in halved(bench, unknown, fold)]
    more = sum(max(one - own, 0.0) for one in finer)
    cells = float(np.clip(2 * more / own, 0.0, 1.0)) if own > 0 else 1.0
    return cells + max(KNOWN_ROUGHLY.get(name, MISSED) for name in unknown.grid.variables)


def drawn(bench: Bench, unknown: Unknown, sensor: bool, missed_share: float) -> Floats:
    """What an unknown closes, drawn from what is open about its table, (draws,), m/s.

    As for what has a name (:mod:`airswing.gap.closure.interval`): the fit's own error, error of the
    reference that lasts, and the part of the effect that cells do not hold.
    """
    frame, rng = bench.setting.frame, np.random.default_rng(0)
    error = field_of(bench, unknown)
    zero = np.zeros_like(error)
    left = take_off(frame, error if sensor else zero, zero if sensor else error)
    cells = bench.cells(unknown.grid)
    rows = np.flatnonzero(np.isin(frame.aircraft, unknown.tails) & (cells >= 0))
    owner, cell, near = frame.aircraft[rows], cells[rows], left[rows]
    direction = bench.direction_for(unknown.grid, unknown.component)[rows]
    gained = float(np.hypot(*frame.residual[rows].T).sum() - np.hypot(*near.T).sum())
    # as in the scan: the prior's root needs every direction
    lasting = np.linalg.cholesky(unknown.grid.prior() + 1e-9 * np.eye(unknown.grid.size))
    lasting *= bench.persistent(unknown.grid, unknown.tails) / bench.scale(unknown.component)
    start, out = np.hypot(*near.T).sum(), np.empty(DRAWS)
    steps = np.zeros_like(unknown.values)
    for d in range(DRAWS):
        shared = lasting @ rng.standard_normal(unknown.grid.size)
        for root, group in zip(unknown.roots, unknown.groups, strict=True):
            steps[group] = root @ rng.standard_normal(unknown.grid.size) + shared
        now = near - steps[owner, cell][:, None] * direction
        out[d] = gained + start - np.hypot(*now.T).sum()
    out += gained * missed_share * rng.uniform(0.0, 2.0, DRAWS)
    out += gained * LASTS * rng.standard_normal(DRAWS)
    if "wind" in unknown.component and len(unknown.tails) == len(frame.tails):
        # the table does not tell which of the two winds errs
        out += (_of_reference(bench, unknown) - gained) * rng.integers(0, 2, DRAWS)
    return out / frame.size


def _of_reference(bench: Bench, unknown: Unknown) -> float:
    """What a table of the wind closes where the reference is what errs, summed over reports, m/s.

    Its small scales are then too weak or turned as well; they are in part wrong, so that setting
    the reference right closes less than the same table on the large-scale wind.
    """
    frame, cells = bench.setting.frame, bench.cells(unknown.grid)
    size = np.where(cells >= 0, unknown.values[frame.aircraft, np.maximum(cells, 0)], 0.0)
    winds = {"u": frame.u_ref, "v": frame.v_ref}
    direction = change_of(
        unknown.component, heading=frame.heading, airspeed=frame.airspeed, **winds
    )
    left = frame.residual - size[:, None] * direction
    return float(np.hypot(*frame.residual.T).sum() - np.hypot(*left.T).sum())
