"""Whether a table takes the place of the names that the search found.

Assumptions: names that only stand in for an unknown explain less of weeks left out than its table
does alone, every report alike, and are unlike it; of right names a table is mostly these over
again, with a little of everything beside it, or has next to nothing in common with them.

Validity: of all names together; tables fitted without each fold of weeks.

Units: m/s; energies in m2 s-2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.held_out.share_held import share_held
from airswing.gap.witness.bench import Bench, Setting
from airswing.gap.witness.fitted_tables import Unknown, explained, field_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: What a table must explain more than all names, as a factor, to lead; the same of one that is
#: mostly these names over again (the square of their correlation from which it is): where every
#: aircraft has a little of all effects a table takes that up as well, 1.1 to 1.3 at 0.68 to 0.91.
#: Names that only stand in for what has none are unlike it (0.31 to 0.37, and it explains 4 times
#: as much). One that holds the names at a quarter more than their size says they are too small.
LEADS, LIKENESS, SAME_SIZE, LEADS_ITS_LIKE = 1.05, 0.6, 1.25, 1.5
#: The square of the correlation under which names and a table are two things: 0.04 of an offset of
#: four compasses and an error of all in turns.
TWO_THINGS = 0.1
#: The last two of a table that is nothing but the names: what changes along flights lets an effect
#: come out too small behind another of the same aircraft (an airspeed's offset behind a time lag
#: at 0.77 of its size), and its name is none the less its name.
NOTHING_BUT, NEAR_SIZE = 0.95, 1.6
#: The square of its correlation with names that leave nothing from which a table is these: 0.18 of
#: a step that stood in for an error by date and drift, 0.64 of a right hard iron of the fleet.
STANDS_IN = 0.5
#: What names may miss of their size in the residual as it is, error and all, to be left in peace.
OF_ANOTHER_SIZE = 0.25
#: Share of a table's largest value that is nothing, at an end of its variable: what an error that
#: grows from nothing has in its first cell of eight.
NOTHING = 0.15


def leads(
    bench: Bench, unknown: Unknown, ways: Sequence[Floats], fold: Integers, *, left: bool = True
) -> bool:
    """Whether a table alone explains more than all names together, either way these are taken.

    Not one that has nothing in common with them: it is told beside them. Half as much again where
    these leave nothing that is to be told, and it must be another thing: a table of the whole fleet
    holds a right name and what weather does by its variables.

    A factor of the wind is exact on the reference's own, whose small scales are in part wrong and
    cost it energy that a table, on the large-scale wind, does not pay.
    """
    table = field_of(bench, unknown, fold)
    names = max(ways, key=lambda errors: explained(bench, errors))
    both, square = float((table * names).sum()), float((names**2).sum())
    likeness = both**2 / max(float((table**2).sum()) * square, 1e-12)
    most = NEAR_SIZE if likeness >= NOTHING_BUT else SAME_SIZE
    like = likeness >= LIKENESS and both <= most * square
    if likeness < TWO_THINGS or (not left and likeness >= STANDS_IN):
        return False
    end = from_nothing(unknown)
    whole = end is not None and not _nothing_in(bench.cells(unknown.grid), end, names)
    least = LEADS_ITS_LIKE if not left or (like and not whole) else LEADS
    return explained(bench, table) > least * explained(bench, names)


def borne_out(setting: Setting, errors: Floats) -> bool:
    """Whether the residual holds what names make of it, (n, 2), about as large as they say.

    Names are fitted to what changes along flights. One that only stands in for an unknown may leave
    nothing of it to be told there, but is then of another size in the residual as it is.
    """
    told = share_held(setting.frame.residual, errors, setting.day)
    return abs(told.share - 1.0) + told.error < OF_ANOTHER_SIZE


def from_nothing(unknown: Unknown) -> int | None:
    """End cell at which a table of one variable is nothing and from which it grows; or None.

    Then it is the whole effect, and a steady name beside it only its mean: an offset with something
    small beside it, told by one table, is nowhere near nothing. A name that is nothing there as
    well (winds too weak below a level) is no such mean.
    """
    if len(unknown.grid.axes) > 1 or unknown.grid.axes[0].kind != "linear":
        return None
    values = np.abs(unknown.values[list(unknown.tails)]).mean(axis=0)
    end = 0 if values[0] < values[-1] else values.size - 1
    return end if values[end] < NOTHING * values.max() else None


def _nothing_in(cells: Integers, end: int, errors: Floats) -> bool:
    """Whether errors (n, 2) are nothing in a cell beside those in others."""
    square = np.bincount(cells[cells >= 0], (errors**2).sum(axis=1)[cells >= 0])
    count = np.bincount(cells[cells >= 0])
    size = np.sqrt(square / np.maximum(count, 1))
    return end < size.size and bool(size[end] < NOTHING * size.max())
