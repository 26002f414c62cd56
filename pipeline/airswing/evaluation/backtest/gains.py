"""What corrections gained on the reports they are judged by, and what was expected of them.

Assumes the gain is paired (the same report before and after its correction), so that the model's
own error hardly enters. Its interval is a bootstrap over days. Knots of wind vector disagreement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import correct
from airswing.evaluation.day_sums import day_weights, interval_95
from airswing.evaluation.disagreement import reference_mean, vector_difference
from airswing.evaluation.results import Content
from airswing.flags import mended as was_mended
from airswing.products.ragged import row_bounds
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]


class Apart(NamedTuple):
    """Disagreement of reports with the reference, as reported and as corrected."""

    # before, after: (report,): knots
    before: Floats
    after: Floats
    done: NDArray[np.bool_]  # (report,): whether the report could be corrected

    @classmethod
    def of(cls, reports: xr.Dataset, fits: xr.Dataset, members: list[str], reference: str) -> Apart:
        """Correct some reports by the tables of a reference, and measure them against some."""
        mended = correct(reports, fits, reference=reference)
        winds = reference_mean(reports, members)
        model = (
            winds["reference_eastward_wind"].to_numpy(),
            winds["reference_northward_wind"].to_numpy(),
        )
        pairs = (
            (reports["eastward_wind"], reports["northward_wind"]),
            (mended["corrected_eastward_wind"], mended["corrected_northward_wind"]),
        )
        before, after = (
            np.asarray(vector_difference(u.to_numpy(), v.to_numpy(), *model) / KNOT, dtype=float)
            for u, v in pairs
        )
        done = was_mended(mended["correction_applied"].to_numpy())
        return cls(before, after, done)


class Gain(NamedTuple):
    """What one aircraft's judged reports gained, by day."""

    day: NDArray[np.int64]  # (day,): increasing
    total: Floats  # (day,): summed gain, knots
    counts: Floats  # (day,): reports

    @property
    def reports(self) -> int:
        """All of them."""
        return int(self.counts.sum())


def gains_of(block: xr.Dataset, gain: Floats, judged: NDArray[np.bool_]) -> list[Gain]:
    """Sum the gains of each aircraft of a block by day.

    Parameters
    ----------
    gain : array, shape (report,)
        Knots.
    judged : array of bool, shape (report,)
        Reports that count.
    """
    day = block["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    found = []
    for start, stop in zip(*row_bounds(block["row_size"].to_numpy()), strict=True):
        chosen = np.flatnonzero(judged[start:stop]) + start
        days, index = np.unique(day[chosen], return_inverse=True)
        total = np.bincount(index, weights=gain[chosen], minlength=days.size)
        number = np.bincount(index, minlength=days.size)
        found.append(Gain(days, total.astype(np.float64), number.astype(np.float64)))
    return found


def compared(
    headings: xr.Dataset,
    gains: list[Gain],
    ranking: Sequence[Content],
    *,
    draws: int,
    seed: int,
) -> Content:
    """Hold the predicted against the realised gain, each aircraft and together.

    Parameters
    ----------
    headings : Dataset
        Names the aircraft.
    gains : list of Gain
        One an aircraft.
    ranking : sequence of Content
        Of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`.

    Returns
    -------
    Compared
        ``predicted_gain_kt``, ``realised_gain_kt``, their difference with intervals, ``agree``
        (None where one day leaves the intervals unknown), ``reports``, and the same
        ``by_aircraft``; None where nothing could be judged.
    """
    predicted = {entry["aircraft"]: entry for entry in ranking}
    entries: list[Content] = []
    judged = []
    for name, gain in zip(headings["aircraft"].to_numpy().astype(str), gains, strict=True):
        known = predicted[name]
        if not gain.reports or known["expected_gain_kt"] is None:
            continue
        mean, drawn = _bootstrapped(gain, draws=draws, seed=seed)
        entries.append(
            {
                "aircraft": name,
                "reports": gain.reports,
                **_side_by_side(
                    known["expected_gain_kt"],
                    known["expected_gain_standard_error_kt"],
                    mean,
                    drawn,
                ),
            }
        )
        judged.append(gain)
    if not entries:
        return {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}
    weights = np.array([gain.reports for gain in judged], dtype=float)
    share = weights / weights.sum()
    together = float(share @ [entry["predicted_gain_kt"] for entry in entries])
    spread = share @ np.diag([entry["predicted_standard_error_kt"] ** 2 for entry in entries])
    mean, drawn = _bootstrapped(_together(judged), draws=draws, seed=seed)
    return {
        **_side_by_side(together, float(np.sqrt(spread @ share)), mean, drawn),
        "reports": int(weights.sum()),
        "by_aircraft": entries,
    }


def _side_by_side(predicted: float, error: float, realised: float, drawn: Floats) -> Content:
    """Both gains with their intervals; no verdict where an interval cannot be told."""
    own = float(drawn.std())
    difference, wide = realised - predicted, float(np.hypot(error, own))
    return {
        "predicted_gain_kt": predicted,
        "predicted_standard_error_kt": error,
        "predicted_gain_ci_kt": [predicted - NORMAL_95 * error, predicted + NORMAL_95 * error],
        "realised_gain_kt": realised,
        "realised_gain_ci_kt": interval_95(drawn),
        "difference_kt": difference,
        "difference_ci_kt": [difference - NORMAL_95 * wide, difference + NORMAL_95 * wide],
        "agree": bool(abs(difference) <= NORMAL_95 * wide) if np.isfinite(wide) else None,
    }


def _bootstrapped(gain: Gain, *, draws: int, seed: int) -> tuple[float, Floats]:
    """Mean gain and its draws, days drawn again with replacement; of one day none can be drawn."""
    mean = float(gain.total.sum() / gain.counts.sum())
    if gain.day.size < 2:
        return mean, np.full(draws, np.nan)
    weights = day_weights(np.random.default_rng(seed), draws, gain.day.size)
    drawn = (weights @ gain.total) / np.maximum(weights @ gain.counts, 1.0)
    return mean, np.asarray(drawn)


def _together(gains: list[Gain]) -> Gain:
    """Gains of a fleet by day."""
    days, index = np.unique(np.concatenate([gain.day for gain in gains]), return_inverse=True)

    def summed(parts: list[Floats]) -> Floats:
        return np.bincount(index, weights=np.concatenate(parts)).astype(np.float64)

    return Gain(
        days, summed([gain.total for gain in gains]), summed([gain.counts for gain in gains])
    )
