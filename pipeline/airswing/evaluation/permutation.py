"""Was it the correction, or luck and the choice of aircraft: tests over whole aircraft.

Assumes aircraft are exchangeable given their level before the test (the permutation test), or
without that condition (the plain one, right only where the choice ignored the level).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.results import Content

# Values of a batch of permutations: half a megabyte stays in a core's own cache, where all draws of
# a large fleet at once would go to memory and back at every step.
_TOGETHER = 65_536


def permutation_test(
    before: NDArray[np.float64],
    during: NDArray[np.float64],
    corrected: NDArray[np.bool_],
    *,
    draws: int = 2000,
    seed: int = 0,
) -> tuple[float, float, NDArray[np.float64]]:
    """Test for an effect on the corrected aircraft, given each aircraft's level before.

    The level during is regressed on the level before and on the group; the residuals of the
    regression without the group are permuted over aircraft (Freedman & Lane 1983, J. Bus. Econ.
    Stat. 1, 292-298) and the group's t value recomputed. Conditioning on the level before keeps
    the test's size when the aircraft were chosen by it.

    Parameters
    ----------
    before, during : arrays of float, shape (aircraft,)
    corrected : array of bool, shape (aircraft,)

    Returns
    -------
    effect : float
        Reduction owed to the correction (positive: better), in the unit of the input.
    p_value : float
        Two-sided; NaN with fewer than five aircraft or an empty group.
    null_effects : array of float, shape (draws,)
        Effects under permutation.
    """
    number = before.size
    # of four aircraft there are six ways at most to choose two: no p value below 0.16
    if number < 5 or corrected.all() or not corrected.any():
        return float("nan"), float("nan"), np.empty(0)
    rng = np.random.default_rng(seed)
    plain = np.column_stack([np.ones(number), before])
    # two directions stand for the hat matrix, which has the square of the aircraft
    directions, sizes, _ = np.linalg.svd(plain, full_matrices=False)
    span = directions[:, sizes > 1e-12 * sizes[0]]
    fitted = span @ (span.T @ during)
    residual = during - fitted
    group = corrected.astype(float)
    group = group - span @ (span.T @ group)
    information = float(group @ group)
    # The level before tells the group: nothing is left to test it by.
    if information < 1e-9 * number:
        return float("nan"), float("nan"), np.empty(0)

    def judged(shuffled: NDArray[np.float64]) -> NDArray[np.float64]:
        left = shuffled - (shuffled @ span) @ span.T
        effects = -(left @ group) / information
        rest = left + effects[:, np.newaxis] * group
        error = np.sqrt((rest**2).sum(1) / max(number - 3, 1) / information)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([effects, np.abs(effects / error)])

    drawn = [judged(fitted + part) for part in _shuffled(rng, residual, draws)]
    effects, t = np.concatenate([judged(during[np.newaxis]), *drawn], axis=1)
    # Draws that change nothing count as large; rounding must not make them smaller.
    p_value = (1.0 + (t[1:] >= t[0] * (1 - 1e-12)).sum()) / (draws + 1.0)
    return float(effects[0]), float(p_value), effects[1:]


def unconditional_p_value(
    change: NDArray[np.float64], corrected: NDArray[np.bool_], *, draws: int, seed: int
) -> float:
    """Two-sided p value of the groups' difference in change when labels are permuted.

    Parameters
    ----------
    change : array of float, shape (aircraft,)
    corrected : array of bool, shape (aircraft,)
    """
    if corrected.all() or not corrected.any():
        return float("nan")
    rng = np.random.default_rng(seed)
    weight = np.where(corrected, 1.0 / corrected.sum(), -1.0 / (~corrected).sum())
    found = abs(float(weight @ change))
    drawn = np.abs(np.concatenate([part @ weight for part in _shuffled(rng, change, draws)]))
    # a draw that is the very choice made must count as well, whatever the order of the sum
    return float((1.0 + (drawn >= found * (1 - 1e-12)).sum()) / (draws + 1.0))


def _shuffled(
    rng: np.random.Generator, values: NDArray[np.float64], draws: int
) -> Iterator[NDArray[np.float64]]:
    """Values of the aircraft in random orders, (some draws, aircraft), all draws batch by batch."""
    step = max(_TOGETHER // values.size, 1)
    for first in range(0, draws, step):
        # each row shuffled in place: sorting random keys takes four times as long at 600 aircraft
        # and grows faster than the aircraft
        yield rng.permuted(np.tile(values, (min(step, draws - first), 1)), axis=1)


def matched_controls(
    before: NDArray[np.float64], during: NDArray[np.float64], corrected: NDArray[np.bool_]
) -> Content:
    """Each corrected aircraft against the control nearest to it before the test.

    Parameters
    ----------
    before, during : arrays of float, shape (aircraft,)
    corrected : array of bool, shape (aircraft,)

    Returns
    -------
    Matched
        ``adjusted_reduction_kt`` and ``mean_distance_kt`` between the matched.
    """
    if corrected.all() or not corrected.any():
        return {"adjusted_reduction_kt": None}
    nearest = _nearest(before[corrected], before[~corrected])
    distance = np.abs(before[corrected] - before[~corrected][nearest])
    change = before - during
    return {
        "adjusted_reduction_kt": float((change[corrected] - change[~corrected][nearest]).mean()),
        "mean_distance_kt": float(distance.mean()),
    }


def _nearest(values: NDArray[np.float64], among: NDArray[np.float64]) -> NDArray[np.int64]:
    """Place of the nearest to each value, of equally near ones the first; no table of all pairs."""
    known, first = np.unique(among, return_index=True)
    above = np.searchsorted(known, values)
    sides = np.clip(np.stack([above - 1, above]), 0, known.size - 1)
    apart = np.abs(known[sides] - values)
    lower = (apart[0] < apart[1]) | ((apart[0] == apart[1]) & (first[sides[0]] < first[sides[1]]))
    return np.asarray(first[np.where(lower, sides[0], sides[1])])
