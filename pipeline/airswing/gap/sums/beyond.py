"""Sums beyond some columns of each unit's own: what those cannot explain of anything else.

Assumptions: those of :mod:`airswing.gap.sums.elimination`; an aircraft's columns are projected out
of its own sums, the fleet's out of the fleet's.

Validity: sums over the archive; those by day follow (:mod:`airswing.gap.sums.day_scores`).

Source: Frisch-Waugh-Lovell elimination.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.elimination import Beside, Conditional

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def beyond(given: Conditional, columns: Integers) -> Conditional:
    """Sums with some columns of each unit's own projected out: what they cannot explain.

    Parameters
    ----------
    columns : (k,) int

    Returns
    -------
    Conditional
        Per-aircraft sums beyond the aircraft's own columns, fleet sums beyond the fleet's.
    """
    own = np.stack([_share(each, columns) for each in given.gram])
    beside = Beside(columns, own, _share(given.fleet_gram, columns))
    return replace(
        given,
        gram=given.gram - given.gram[:, :, columns] @ own,
        score=given.score - np.einsum("ak,akp->ap", given.score[:, columns], own),
        fleet_gram=given.fleet_gram - given.fleet_gram[:, columns] @ beside.fleet,
        fleet_score=given.fleet_score - given.fleet_score[columns] @ beside.fleet,
        beside=beside,
    )


def _share(gram: Floats, columns: Integers) -> Floats:
    """Coefficients (k, p) of some columns in each of all."""
    own = gram[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(np.diagonal(own), 1e-12))
    # daily sums are kept in single precision: what is left of a direction below this is rounding
    ridge = np.diag(1e-4 * scale**2 + 1e-9)
    return np.asarray(np.linalg.solve(own + ridge, gram[columns]))
