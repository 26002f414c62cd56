"""By how much the error variance of reported winds is larger than that of corrected ones.

Assumes that a report's error of the reference is independent of what the correction changed, c
(reported minus corrected). With d the corrected wind's disagreement the difference of the mean
squares is that of c, which is known exactly, and twice the mean of c d. The mean of c d holds what
c has in common with the corrected wind's own error, which belongs to it, and what it happens to
have in common with the reference's error, which does not: the estimate's error. Part of that error
lasts for months and is shared by all, and a few aircraft with large deviations make most of c; so
neither days nor aircraft are independent of each other, and the variance is that of both clusters,
less that of their intersection, which both count (Cameron, Gelbach & Miller 2011, J. Bus. Econ.
Stat. 29, 238-249). The reports and their c are taken as they are: the error is that of this fleet
in this archive. m2/s2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.report_errors.disagreements import Disagreements

Floats = NDArray[np.float64]


def added_variance(found: Disagreements, weights: Floats, *, seed: int) -> Floats:
    """Difference of the error variances, as found and with days and aircraft drawn again.

    Parameters
    ----------
    weights : array, shape (1 + draw, day)
        How often each day counts; the first row is ones.
    seed : int
        Of the draws of aircraft.

    Returns
    -------
    array, shape (1 + draw, 1 + cell)
        Of all reports, then of each cell; NaN without reports.
    """
    number, crossed = _with_total(found.number), _with_total(found.crossed)
    size = number.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = crossed.sum(axis=1) / size
        by_day = (crossed - mean[:, None] * number) / size[:, None]
        own = _with_total(found.aircraft_crossed.T) - mean[:, None] * _with_total(
            found.aircraft_number.T
        )
        by_aircraft = own / size[:, None]
        squares, product, counts = found.crossed_alone
        alone = (squares - 2.0 * mean * product + mean**2 * counts) / size**2
        known = _with_total(found.change_squares[:, None])[:, 0] / size
    flown = (_with_total(found.aircraft_number.T) > 0).sum(axis=1)
    by_aircraft *= np.sqrt(flown / np.maximum(flown - 1.0, 1.0))[:, None]
    drawn = np.random.default_rng([seed, 1]).normal(size=(weights.shape[0], by_aircraft.shape[1]))
    drawn[0] = 0.0
    days, aircraft = (weights - 1.0) @ by_day.T, drawn @ by_aircraft.T
    share = (
        _share(days[1:].var(axis=0), (by_aircraft**2).sum(axis=1), alone) if days[1:].size else 1
    )
    return np.asarray(known + mean + share * (days + aircraft))


def _with_total(table: Floats) -> Floats:
    """Rows of cells, before them that of all."""
    return np.vstack([table.sum(axis=0), table])


def _share(days: Floats, aircraft: Floats, alone: Floats) -> Floats:
    """What is left of a standard error when the intersection is counted once."""
    both = days + aircraft
    least = np.maximum(days, aircraft)
    left = np.maximum(both - alone, least)
    return np.sqrt(np.divide(left, both, out=np.ones_like(both), where=both > 0.0))
