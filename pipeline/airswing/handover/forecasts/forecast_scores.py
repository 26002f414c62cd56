"""What correcting forecasts was worth: bias, centred rms and skill, on days that chose nothing.

Assumes forecasts corrected by :mod:`airswing.handover.forecasts.correcting`. Every method is judged
on the same pairs, and skill is one minus its mean square error over the raw forecast's (Murphy
1988, Mon. Wea. Rev. 116, 2417-2424). Intervals are a bootstrap over blocks of start days: stations
and leads of one day share the day's weather and are drawn together.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.day_blocks import block_weights, interval
from airswing.handover.forecasts.correcting import METHODS, TIME

Floats = NDArray[np.float64]
SCORES = ("forecast_error_mean", "forecast_error_centred_rms", "forecast_error_rms", "skill")
PERIODS = ("held_out", "all")
_FORECASTS = ("forecast", "corrected_forecast", "running_mean_forecast")
# Of days: either end of a 95 % interval rests on 25 of them.
_DRAWS = 1000
FEWEST_DAYS = 5
"""Days below which there is no interval."""


def score_forecasts(corrected: xr.Dataset) -> xr.Dataset:
    """Score each method by variable, over all leads and for each.

    Returns
    -------
    Dataset
        Each of `SCORES` (variable, period, correction) and, with ``_by_lead``, (variable, period,
        correction, lead), with ``*_interval`` (..., bound); ``*_by_station`` (variable, correction,
        station) over the days held out; ``pair_count`` (variable, period).
    """
    sums = _day_sums(corrected)
    judged = corrected["held_out"].to_numpy().astype(bool)
    found: dict[str, tuple[tuple[str, ...], Floats]] = {}
    dims = ("variable", "period", "correction")
    for suffix, table, more in (
        ("", sums.sum("lead"), ()),
        ("_by_lead", sums, ("lead",)),
    ):
        parts = [
            _with_intervals(table.isel({TIME: chosen})) for chosen in (judged, np.ones_like(judged))
        ]
        for name in SCORES:
            values, bounds = (np.stack([part[name][k] for part in parts], axis=1) for k in (0, 1))
            found[name + suffix] = ((*dims, *more), values)
            found[f"{name}{suffix}_interval"] = ((*dims, *more, "bound"), bounds)
    number = [
        sums.isel({TIME: chosen, "correction": 0, "moment": 0}) for chosen in (judged, slice(None))
    ]
    counted = np.stack([part.sum((TIME, "lead")).to_numpy() for part in number], axis=1)
    found["pair_count"] = (("variable", "period"), counted.astype(np.int64))
    by_station = _scores(_moments(corrected.isel({TIME: judged}), (TIME, "lead")).to_numpy())
    for name in SCORES:
        found[f"{name}_by_station"] = (("variable", "correction", "station"), by_station[name])
    coords: Mapping[str, object] = {
        "variable": corrected["variable"],
        "period": list(PERIODS),
        "correction": list(METHODS),
        "lead": corrected["lead"],
        "station": corrected["station"],
        "bound": ["low", "high"],
    }
    return xr.Dataset(found, coords=coords)


def _moments(corrected: xr.Dataset, over: tuple[str, ...]) -> xr.DataArray:
    """Pairs, summed errors and summed squares: (variable, correction, ..., moment)."""
    parts = []
    for name in _FORECASTS:
        error = corrected[name] - corrected["observation"]
        known = error.notnull()
        error = error.where(known, 0.0)
        moments = [part.sum(over) for part in (known.astype(float), error, error**2)]
        parts.append(xr.concat(moments, "moment", coords="minimal", compat="override"))
    joined: xr.DataArray = xr.concat(parts, "correction", coords="minimal", compat="override")
    return joined.transpose("variable", "correction", ..., "moment")


def _day_sums(corrected: xr.Dataset) -> xr.DataArray:
    """Moments by start day: (variable, correction, day as start, lead, moment)."""
    sums = _moments(corrected, ("station",))
    return sums.transpose("variable", "correction", TIME, "lead", "moment").load()


def _with_intervals(sums: xr.DataArray) -> dict[str, tuple[Floats, Floats]]:
    """Scores of (variable, correction, [lead]) and their intervals, bound last."""
    day = sums[TIME].to_numpy().astype("datetime64[D]")
    days, index = np.unique(day, return_inverse=True)
    table = sums.transpose(TIME, ...).to_numpy()
    by_day = np.zeros((days.size, *table.shape[1:]))
    # Several starts of a day are one day: they are drawn together.
    np.add.at(by_day, index, table)
    whole = _scores(by_day.sum(axis=0))
    weights = block_weights(days.size, draws=_DRAWS, seed=0)
    drawn = np.tensordot(weights, by_day, axes=1)
    # The methods' axis is second from the front in both.
    spread = _scores(np.moveaxis(drawn, 0, -2))
    return {
        name: (
            whole[name],
            np.moveaxis(interval(np.moveaxis(spread[name], -1, 0)), 0, -1)
            if days.size >= FEWEST_DAYS
            else np.full((*whole[name].shape, 2), np.nan),
        )
        for name in SCORES
    }


def _scores(moments: Floats) -> dict[str, Floats]:
    """Scores from (variable, correction, ..., moment)."""
    number, total, squares = np.moveaxis(moments, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / number
        square = squares / number
        skill = 1.0 - square / square[:, :1]
    # Stretched weights of few days may sum to less than nothing.
    centred = np.sqrt(np.maximum(square - mean**2, 0.0))
    return dict(zip(SCORES, (mean, centred, np.sqrt(np.maximum(square, 0.0)), skill), strict=True))
