"""Whether a field test's reduction is the correction's, or the choice of aircraft and luck.

Assumes aircraft were usually chosen for bad winds, so that some of what they gain is regression to
the mean: the permutation test regresses the level during the test on the level before it, and the
same choice is tried within the window before, where nothing was corrected. Knots.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.day_sums import DaySums
from airswing.evaluation.permutation import (
    matched_controls,
    permutation_test,
    unconditional_p_value,
)
from airswing.evaluation.results import Content


def scrutinise(sums: DaySums, names: NDArray[np.generic], *, draws: int, seed: int) -> Content:
    """Permutation test, check for regression to the mean, and matched controls.

    Parameters
    ----------
    names : array of str, shape (aircraft,)

    Returns
    -------
    Scrutiny
        ``permutation``, ``regression_to_the_mean``, ``matched_controls`` and ``by_aircraft`` of
        ``field_test.json``.
    """
    before, during = sums.levels()
    good = np.isfinite(before) & np.isfinite(during)
    effect, p_value, spread = permutation_test(
        before[good], during[good], sums.corrected[good], draws=draws, seed=seed
    )
    return {
        "permutation": {
            "effect_kt": effect,
            "p_value": p_value,
            "p_value_unconditional": unconditional_p_value(
                (before - during)[good], sums.corrected[good], draws=draws, seed=seed
            ),
            "draws": draws,
            # enough for the histogram of the page
            "null_effects_kt": spread[:500],
        },
        "regression_to_the_mean": _regression_to_the_mean(sums),
        "matched_controls": matched_controls(before[good], during[good], sums.corrected[good]),
        "by_aircraft": [
            {
                "aircraft": str(name),
                "group": "corrected" if treated else "controls",
                "before_kt": first,
                "during_kt": second,
            }
            for name, treated, first, second in zip(
                names, sums.corrected, before, during, strict=True
            )
        ],
    }


def _regression_to_the_mean(sums: DaySums) -> Content:
    """Choose the worst aircraft in the first half of the window before, watch the second half."""
    days = np.flatnonzero(~sums.during)
    first, second = days[: days.size // 2], days[days.size // 2 :]
    chosen = int(sums.corrected.sum())
    with np.errstate(invalid="ignore", divide="ignore"):
        early = sums.total[:, first].sum(1) / sums.count[:, first].sum(1)
        late = sums.total[:, second].sum(1) / sums.count[:, second].sum(1)
    good = np.isfinite(early) & np.isfinite(late)
    if good.sum() <= chosen or chosen == 0:
        return {"spurious_reduction_kt": None, "why": "too few days or aircraft before the test"}
    worst = np.zeros(good.size, dtype=bool)
    worst[np.flatnonzero(good)[np.argsort(-early[good])[:chosen]]] = True
    others = good & ~worst
    change = (early - late)[worst].mean() - (early - late)[others].mean()
    return {
        "spurious_reduction_kt": float(change),
        "rule": f"the {chosen} aircraft with the largest disagreement in the first half of the "
        "window before, followed through its second half, minus the others' change",
    }
