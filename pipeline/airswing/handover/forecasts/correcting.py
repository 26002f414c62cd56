"""Forecasts at stations corrected by what they got wrong on the days before.

Assumes pairs of forecast and observation by variable, station, start and lead, and that a forecast
may be corrected by nothing that was observed after it started: one with a lead of 30 h by errors of
starts two days before and earlier. Each hour of start, lead, station and variable has a filter of
its own (:mod:`airswing.handover.forecasts.kalman`), run over whole days; days without a pair are
bridged.

The filter's ratio is one number a variable: the one with the least mean square error over the first
part of the days, the training part; the rest of the days, held out, judge it. Where no ratio gives
less error than the forecast has as it is, the variable is left so: ratio 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.handover.forecasts.kalman import kalman_bias, known_before, running_mean

METHODS = ("raw", "kalman", "running_mean")
# Of the variances of model and observation; the best on past days is taken, or none at all.
RATIOS = (0.005, 0.01, 0.02, 0.04, 0.06, 0.1, 0.2, 0.4)
# Optimum of Delle Monache et al. 2008 (J. Geophys. Res. 113, D16310), where none can be chosen.
USUAL_RATIO = 0.06
FEWEST_DAYS = 14
"""Training days below which a ratio cannot be chosen."""
LEAST = {"wind_speed": 0.0}
"""Bound of variables that have one."""
TIME = "forecast_reference_time"
DIMS = ("variable", "station", TIME, "lead")
Floats = NDArray[np.float64]


def correct_forecasts(
    pairs: xr.Dataset,
    *,
    ratio: float | Literal["auto"] = "auto",
    training: float = 0.5,
    window: int = 7,
) -> xr.Dataset:
    """Correct every forecast by the errors known when it started.

    Parameters
    ----------
    pairs : Dataset
        ``forecast`` and ``observation`` (variable, station, forecast_reference_time, lead), NaN
        where missing; ``lead`` in hours. May be dask-backed along variable, station and lead.
    ratio : float or "auto", default "auto"
        Of the filter; chosen by variable on the training days when "auto", 0 where it does not
        help.
    training : float, default 0.5
        Share of the days that choose.
    window : int, default 7
        Days of the running mean.

    Returns
    -------
    Dataset
        The pairs with ``corrected_forecast``, ``running_mean_forecast``, ``valid_time``,
        ``held_out`` (forecast_reference_time), ``ratio`` and ``ratio_chosen`` (variable).
    """
    pairs = pairs.sortby(TIME).transpose(*DIMS)
    errors = pairs["forecast"] - pairs["observation"]
    errors = errors.where(np.isfinite(errors)).transpose(..., TIME)
    held_out = _held_out(pairs[TIME].to_numpy(), training)
    chosen, by_data = _ratios(errors, held_out, ratio)
    bias = _known_bias(errors, kalman_bias, chosen).where(chosen > 0.0, 0.0).transpose(*DIMS)
    mean = _known_bias(errors, running_mean, window).transpose(*DIMS)
    starts = pairs[TIME]
    # ns in an hour; rounded, for 1/3 h to be a time that others have as well
    hours = (pairs["lead"] * 3.6e12).round().astype("timedelta64[ns]")
    found = pairs.assign(
        corrected_forecast=_bounded(pairs["forecast"] - bias),
        running_mean_forecast=_bounded(pairs["forecast"] - mean),
        held_out=(TIME, held_out.astype(np.int8)),
        ratio=chosen,
        ratio_chosen=("variable", by_data.astype(np.int8)),
    )
    return found.assign_coords(valid_time=(starts + hours).astype("datetime64[ns]"))


def _held_out(starts: NDArray[np.datetime64], training: float) -> NDArray[np.bool_]:
    """Whether a start is of the days that judge, which come after those that choose."""
    day = starts.astype("datetime64[D]")
    days = np.unique(day)
    return np.asarray(day >= days[min(round(training * days.size), days.size - 1)])


def _ratios(
    errors: xr.DataArray, held_out: NDArray[np.bool_], ratio: float | Literal["auto"]
) -> tuple[xr.DataArray, NDArray[np.bool_]]:
    """Ratio of each variable, and whether the training days chose it."""
    like = xr.DataArray(np.ones(errors.sizes["variable"]), dims="variable")
    if ratio != "auto":
        return like * float(ratio), np.zeros(like.size, dtype=bool)
    part = errors.isel({TIME: ~held_out})
    days = np.unique(part[TIME].to_numpy().astype("datetime64[D]"))
    if days.size < FEWEST_DAYS:
        return like * USUAL_RATIO, np.zeros(like.size, dtype=bool)
    rest = [name for name in part.dims if name != "variable"]
    table = np.array(
        [((part - _known_bias(part, kalman_bias, one)) ** 2).mean(rest) for one in RATIOS]
    )
    # First the forecast as it is: of equal errors argmin takes it.
    table = np.vstack([(part**2).mean(rest).to_numpy()[None], table])
    told = np.isfinite(table).all(axis=0)
    best = np.array((0.0, *RATIOS))[np.where(told[None], table, 0.0).argmin(axis=0)]
    return like * np.where(told, best, USUAL_RATIO), told


def _along_time(
    kernel: Callable[..., Floats], errors: xr.DataArray, setting: xr.DataArray | float
) -> xr.DataArray:
    found: xr.DataArray = xr.apply_ufunc(
        kernel,
        errors,
        setting,
        input_core_dims=[[TIME], []],
        output_core_dims=[[TIME]],
        dask="parallelized",
        output_dtypes=[np.float64],
    )
    return found


def _known_bias(
    errors: xr.DataArray, kernel: Callable[..., Floats], setting: xr.DataArray | float
) -> xr.DataArray:
    """Bias of each forecast as it was known when it started, 0 where nothing was."""
    starts = errors[TIME].to_numpy()
    # A lead of 24 h is one day: a hair less, so that rounding makes it no second one.
    days_ahead = np.maximum(np.ceil(errors["lead"].to_numpy() / 24.0 - 1e-9), 1.0)
    ahead = xr.DataArray(days_ahead.astype(np.int64), dims="lead")
    parts: list[xr.DataArray] = []
    for chosen, place in _daily(starts):
        # Errors on every day from the first to the last: none on those without a start.
        source = np.full(int(place[-1]) + 1, -1)
        source[place] = chosen
        there = xr.DataArray(source >= 0, dims=TIME)
        whole = errors.isel({TIME: source}).drop_vars(TIME).where(there)
        known = _along_time(known_before, _along_time(kernel, whole, setting), ahead)
        parts.append(known.isel({TIME: place}).assign_coords({TIME: starts[chosen]}))
    return parts[0] if len(parts) == 1 else xr.concat(parts, TIME).sortby(TIME)


def _daily(
    starts: NDArray[np.datetime64],
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Starts of one hour of the day, and the day of each from the first."""
    day = starts.astype("datetime64[D]")
    hour = (starts - day).astype(np.int64)
    for one in np.unique(hour):
        chosen = np.flatnonzero(hour == one)
        yield chosen, (day[chosen] - day[chosen[0]]).astype(np.int64)


def _bounded(forecast: xr.DataArray) -> xr.DataArray:
    """No speed below none."""
    least = [LEAST.get(str(name), -np.inf) for name in forecast["variable"].to_numpy()]
    bound = xr.DataArray(least, dims="variable")
    return forecast.where((forecast >= bound) | forecast.isnull(), bound)
