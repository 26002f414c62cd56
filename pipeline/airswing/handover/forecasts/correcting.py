"""Forecasts corrected by their errors on earlier days, and scores of the correction.

The correction of a forecast uses no observation after its start. Each hour of start, lead time,
station and variable has a filter over whole days. Its error y = forecast - observation is taken as
a slowly wandering bias and white noise (Delle Monache et al. 2006, J. Geophys. Res. 111, D05308)::

    y(t) = x(t) + eps(t),    x(t) = x(t-1) + eta(t),    var(eta) = ratio * var(eps)

The variance of the noise is found by a second filter on z(t) = (y(t) - y(t-m))^2 / (2 + m ratio),
with m the days since the last known error (m = 1 in the paper) and the paper's variances, 0.0005
and 1. A day without an error leaves the bias unchanged and adds to its uncertainty. The filter
starts from a bias of 0 with a variance of `FIRST_VARIANCE` times that of the noise. A change of
regime is followed in about 1/sqrt(ratio) days.

The ratio is one number a variable: the one of least mean square error over the first part of the
days; the other days are held out for its evaluation. Where no ratio has a smaller error than the
raw forecast, the variable is left unchanged (ratio 0). Scores compare all methods on the same
pairs; skill is one minus the mean square error over that of the raw forecast (Murphy 1988, Mon.
Wea. Rev. 116, 2417-2424). Intervals (95 %) are a bootstrap over blocks of start days.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.resampling import day_weights

FORECASTS = {
    "raw": "forecast",
    "kalman": "corrected_forecast",
    "running_mean": "running_mean_forecast",
}
"""Variable of each method."""
METHODS = tuple(FORECASTS)
RATIOS = (0.005, 0.01, 0.02, 0.04, 0.06, 0.1, 0.2, 0.4)  # to choose from
# Optimum of Delle Monache et al. (2008), J. Geophys. Res. 113, D16310; used without a choice.
USUAL_RATIO = 0.06
FEWEST_TRAINING_DAYS = 14  # fewest days for the choice of a ratio
LEAST = {"wind_speed": 0.0}  # bound of variables that have one
SCORES = ("forecast_error_mean", "forecast_error_centred_rms", "forecast_error_rms", "skill")
PERIODS = ("held_out", "all")
FEWEST_DAYS = 5  # fewest days for an interval
TIME = "forecast_reference_time"
DIMS = ("variable", "station", TIME, "lead")
_DRAWS = 1000  # bootstrap draws of days; 25 lie beyond either end of an interval
_STATIONS_AT_ONCE = 500
Floats = NDArray[np.float64]
# Second filter: variance of the daily change of the noise variance, and of one sample of it.
VARIANCE_OF_NOISE_CHANGE, VARIANCE_OF_NOISE_SAMPLE = 0.0005, 1.0
# Of the bias before the first error, in units of that of the noise: on simulated series with a bias
# of up to one standard deviation better by 2 % in 10 days than no prior, and equal for three.
FIRST_VARIANCE = 4.0
_SERIES_AT_ONCE = 2048  # the values of a day fit into the processor's cache


def correct_forecasts(
    pairs: xr.Dataset,
    *,
    ratio: float | Literal["auto"] = "auto",
    training: float = 0.5,
    window: int = 7,
) -> xr.Dataset:
    """Correct every forecast by the errors known at its start.

    Parameters
    ----------
    pairs : Dataset
        ``forecast`` and ``observation`` (variable, station, forecast_reference_time, lead), NaN
        where missing; ``lead`` in hours. May be dask-backed along variable, station and lead.
    ratio : float or "auto", default "auto"
        Ratio of the filter; "auto" chooses it by variable on the training days, 0 without an
        improvement.
    training : float, default 0.5
        Share of the days used for the choice.
    window : int, default 7
        Days of the running mean.

    Returns
    -------
    Dataset
        The pairs with ``corrected_forecast``, ``running_mean_forecast``, ``valid_time``,
        ``held_out`` (forecast_reference_time), ``ratio`` and ``ratio_chosen`` (variable).

    References
    ----------
    Delle Monache, L., et al., 2006: J. Geophys. Res. 111, D05308; 2008: 113, D16310.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> dims = ("variable", "station", "forecast_reference_time", "lead")
    >>> observation = rng.normal(10.0, 5.0, (1, 1, 60, 1))
    >>> pairs = xr.Dataset(
    ...     {
    ...         "forecast": (dims, observation + 2.0 + rng.normal(size=observation.shape)),
    ...         "observation": (dims, observation),
    ...     },
    ...     coords={
    ...         "variable": ["air_temperature"],
    ...         "station": ["A"],
    ...         "forecast_reference_time": np.datetime64("2009-01-01", "ns")
    ...         + np.arange(60) * np.timedelta64(1, "D"),
    ...         "lead": [12.0],
    ...     },
    ... )
    >>> late = airswing.correct_forecasts(pairs).isel(forecast_reference_time=slice(30, None))
    >>> bool(abs((late["corrected_forecast"] - late["observation"]).mean()) < 0.5)
    True
    """
    pairs = pairs.sortby(TIME).transpose(*DIMS)
    errors = pairs["forecast"] - pairs["observation"]
    errors = errors.where(np.isfinite(errors)).transpose(..., TIME)
    day = pairs[TIME].to_numpy().astype("datetime64[D]")
    days = np.unique(day)
    held_out = np.asarray(day >= days[min(round(training * days.size), days.size - 1)])
    ratios, by_data = _ratios(errors, held_out, ratio)
    biases = {
        "kalman": _known_bias(errors, kalman_bias, ratios).where(ratios > 0.0, 0.0),
        "running_mean": _known_bias(errors, running_mean, window),
    }
    bound = xr.DataArray(
        [LEAST.get(str(name), -np.inf) for name in pairs["variable"].to_numpy()], dims="variable"
    )
    for method, bias in biases.items():
        forecast = pairs["forecast"] - bias.transpose(*DIMS)
        pairs[FORECASTS[method]] = forecast.where((forecast >= bound) | forecast.isnull(), bound)
    # Rounded to ns, so that lead times such as 1/3 h give equal valid times.
    hours = (pairs["lead"] * 3.6e12).round().astype("timedelta64[ns]")
    return pairs.assign(
        held_out=(TIME, held_out.astype(np.int8)),
        ratio=ratios,
        ratio_chosen=("variable", by_data.astype(np.int8)),
    ).assign_coords(valid_time=(pairs[TIME] + hours).astype("datetime64[ns]"))


def _ratios(
    errors: xr.DataArray, held_out: NDArray[np.bool_], ratio: float | Literal["auto"]
) -> tuple[xr.DataArray, NDArray[np.bool_]]:
    ones = xr.DataArray(np.ones(errors.sizes["variable"]), dims="variable")
    if ratio != "auto":
        return ones * float(ratio), np.zeros(ones.size, dtype=bool)
    errors = errors.isel({TIME: ~held_out})
    days = np.unique(errors[TIME].to_numpy().astype("datetime64[D]"))
    if days.size < FEWEST_TRAINING_DAYS:
        return ones * USUAL_RATIO, np.zeros(ones.size, dtype=bool)
    rest = [name for name in errors.dims if name != "variable"]
    # The raw forecast comes first, because argmin selects the first of equal errors.
    squares = [errors**2] + [(errors - _known_bias(errors, kalman_bias, r)) ** 2 for r in RATIOS]
    table = np.array([square.mean(rest).to_numpy() for square in squares])
    usable = np.isfinite(table).all(axis=0)
    best = np.array((0.0, *RATIOS))[np.where(usable[None], table, 0.0).argmin(axis=0)]
    return ones * np.where(usable, best, USUAL_RATIO), usable


def _known_bias(
    errors: xr.DataArray, kernel: Callable[..., Floats], setting: xr.DataArray | float
) -> xr.DataArray:
    """Bias of each forecast known at its start, 0 without earlier errors.

    The error of a forecast is known at the first start after its valid time, on the next day for
    lead times up to a day.
    """
    starts = errors[TIME].to_numpy()
    # A lead time of 24 h is one day; the margin prevents that rounding makes it two.
    ahead = np.ceil(errors["lead"] / 24.0 - 1e-9).clip(min=1.0).astype(np.int64)
    parts: list[xr.DataArray] = []
    day = starts.astype("datetime64[D]")
    hour = (starts - day).astype(np.int64)
    for start_hour in np.unique(hour):
        rows = np.flatnonzero(hour == start_hour)
        # Errors on every day from the first to the last, NaN on those without a start.
        every_day = pd.date_range(starts[rows[0]], starts[rows[-1]], freq="D", unit="ns")
        daily = errors.isel({TIME: rows}).reindex({TIME: every_day.to_numpy()})
        bias = xr.apply_ufunc(
            kernel,
            daily,
            setting,
            input_core_dims=[[TIME], []],
            output_core_dims=[[TIME]],
            dask="parallelized",
            output_dtypes=[np.float64],
        )
        bias_at_start = bias
        for days in np.unique(ahead):
            bias_at_start = bias_at_start.where(ahead != days, bias.shift({TIME: int(days)}))
        parts.append(bias_at_start.fillna(0.0).sel({TIME: starts[rows]}))
    return parts[0] if len(parts) == 1 else xr.concat(parts, TIME).sortby(TIME)


def score_forecasts(corrected: xr.Dataset) -> xr.Dataset:
    """Score each method of :func:`correct_forecasts` by variable: all pairs, by lead, by station.

    Returns each of `SCORES` (variable, period, correction); with ``_by_lead``, (variable, period,
    correction, lead); with ``_by_station`` on the days held out, (variable, correction, station);
    each with ``*_interval`` (..., bound); ``pair_count`` (variable, period).
    """
    judged = corrected["held_out"].to_numpy().astype(bool)
    by_lead = _moments(corrected, "station").load()
    parts = []
    for sums in (by_lead.isel({TIME: judged}), by_lead):
        number = sums.isel(correction=0).sel(moment="number").sum((TIME, "lead")).astype(np.int64)
        scores = _with_intervals(sums.sum("lead"), "") | _with_intervals(sums, "_by_lead")
        parts.append(xr.Dataset(scores | {"pair_count": number}).drop_vars("moment"))
    held_out, stations = corrected.isel({TIME: judged}), []
    for first in range(0, held_out.sizes["station"], _STATIONS_AT_ONCE):
        subset = held_out.isel(station=slice(first, first + _STATIONS_AT_ONCE))
        scores = _with_intervals(_moments(subset, "lead").load(), "_by_station")
        stations.append(xr.Dataset(scores))
    result = xr.concat(parts, "period").merge(xr.concat(stations, "station"))
    result = result.assign_coords(period=list(PERIODS), bound=["low", "high"])
    order = ("variable", "period", "correction", "lead", "station", "bound")
    return result.transpose(*(name for name in order if name in result.dims))


def _moments(corrected: xr.Dataset, over: str) -> xr.DataArray:
    """Number of pairs, sums of errors and of squares, summed over one dimension."""
    parts = []
    for name in FORECASTS.values():
        error = corrected[name] - corrected["observation"]
        is_pair = error.notnull()
        error = error.where(is_pair, 0.0)
        moments = [term.sum(over) for term in (is_pair.astype(float), error, error**2)]
        parts.append(xr.concat(moments, "moment", coords="minimal", compat="override"))
    joined: xr.DataArray = xr.concat(parts, "correction", coords="minimal", compat="override")
    return joined.drop_vars("valid_time", errors="ignore").assign_coords(
        correction=list(METHODS), moment=["number", "sum", "squares"]
    )


def _with_intervals(moments: xr.DataArray, suffix: str) -> dict[str, xr.DataArray]:
    # Several starts of a day are drawn together.
    day = moments[TIME].astype("datetime64[D]").astype(np.int64).rename("day")
    by_day = moments.groupby(day).sum().transpose("day", ...)
    days = by_day.sizes["day"]
    scores = _scores(by_day.sum("day"))
    result = {f"{name}{suffix}": score for name, score in scores.items()}
    if days < FEWEST_DAYS:
        nan = xr.DataArray([np.nan, np.nan], dims="bound")
        return result | {f"{name}{suffix}_interval": score + nan for name, score in scores.items()}
    weights = xr.DataArray(day_weights(days, draws=_DRAWS, seed=0), dims=("draw", "day"))
    bounds: dict[str, list[xr.DataArray]] = {name: [] for name in SCORES}
    # One variable at a time, so that the draws fit into memory.
    for variable in by_day["variable"].to_numpy():
        for name, values in _scores(xr.dot(weights, by_day.sel(variable=[variable]))).items():
            ends = values.quantile([0.025, 0.975], "draw", skipna=False)
            bounds[name].append(ends.rename(quantile="bound").drop_vars("bound"))
    return result | {
        f"{name}{suffix}_interval": xr.concat(parts, "variable").transpose(..., "bound")
        for name, parts in bounds.items()
    }


def _scores(moments: xr.DataArray) -> dict[str, xr.DataArray]:
    number, total, squares = (
        moments.sel(moment=name, drop=True) for name in ("number", "sum", "squares")
    )
    number = number.where(number != 0.0)
    mean, square = total / number, squares / number
    skill = 1.0 - square / square.sel(correction="raw", drop=True)
    # Drawn weights of few days are widened and may sum to less than zero.
    variances = (square - mean**2).clip(min=0.0), square.clip(min=0.0)
    centred, rms = (variance**0.5 for variance in variances)
    return dict(zip(SCORES, (mean, centred, rms, skill), strict=True))


def station_distribution(scored: xr.Dataset, variable: str, method: str) -> dict[str, object]:
    """Distribution over stations of the rms error of a method relative to the raw forecast.

    From :func:`score_forecasts`: ``stations`` judged; ``rms_ratio_quantiles`` (0, 10, 50, 90 and
    100 %); shares of stations ``better``, ``surely_better`` and ``surely_worse`` (95 % interval of
    the skill on one side of zero); ``worst_station``. Empty without a station.
    """
    selected = scored.sel(variable=variable, correction=method)
    skill = selected["skill_by_station"].to_numpy()
    finite = np.isfinite(skill)
    if not finite.any():
        return {}
    ratio = np.sqrt(np.maximum(1.0 - skill[finite], 0.0))
    low, high = selected["skill_by_station_interval"].to_numpy()[finite].T
    return {
        "stations": int(finite.sum()),
        "rms_ratio_quantiles": np.quantile(ratio, [0.0, 0.1, 0.5, 0.9, 1.0]).tolist(),
        "better": float((ratio < 1.0).mean()),
        "surely_better": float((low > 0.0).mean()),
        "surely_worse": float((high < 0.0).mean()),
        "worst_station": str(selected["station"].to_numpy()[finite][ratio.argmax()]),
    }


# --- kernels: errors (..., day) of any unit, the day last ----------------------------------------


def kalman_bias(errors: Floats, ratio: Floats | float) -> Floats:
    """Bias (..., day) of the forecast as known with the error of each day, 0 before the first.

    ``errors`` (..., day) are forecast minus observation, NaN where either is missing, ``ratio``
    (...) the variance of the daily change of the bias over that of the noise.
    """
    series = errors.reshape(-1, errors.shape[-1])
    ratios = np.broadcast_to(np.asarray(ratio, dtype=np.float64), errors.shape[:-1]).ravel()
    biases = np.empty(series.shape)
    for first in range(0, series.shape[0], _SERIES_AT_ONCE):
        block = slice(first, first + _SERIES_AT_ONCE)
        # One row a day, contiguous in memory.
        biases[block] = _filtered(np.ascontiguousarray(series[block].T), ratios[block]).T
    return biases.reshape(errors.shape)


def _filtered(errors: Floats, ratio: Floats) -> Floats:
    """Bias after each day, (day, series) from (day, series)."""
    filtered, size = np.empty(errors.shape), errors.shape[1]
    bias, spread, waited = np.zeros((3, size))
    noise, last = np.full((2, size), np.nan)
    noise_spread = np.ones(size)
    # Gain of the first error, and variance left after it in units of that of the noise.
    first = (FIRST_VARIANCE + ratio) / (FIRST_VARIANCE + ratio + 1.0)
    for day, error in enumerate(errors):
        waited += 1.0
        has_error = np.isfinite(error)
        again = has_error & np.isfinite(last)
        second = again & np.isnan(noise)
        later = again & ~second
        sample = (error - last) ** 2 / (2.0 + waited * ratio)
        prior = noise_spread + VARIANCE_OF_NOISE_CHANGE
        gain = prior / (prior + VARIANCE_OF_NOISE_SAMPLE)
        spread = np.where(second, sample * (first + ratio * (waited - 1.0)), spread)
        noise = np.where(second, sample, np.where(later, noise + gain * (sample - noise), noise))
        noise_spread = np.where(later, prior * (1.0 - gain), noise_spread)
        spread = spread + ratio * noise
        total = spread + noise
        # 1 where all errors so far are equal.
        gain = np.divide(spread, total, out=np.ones(size), where=total != 0.0)
        bias = np.where(has_error, bias + np.where(again, gain, first) * (error - bias), bias)
        spread = np.where(again, spread * (1.0 - gain), spread)
        last, waited = np.where(has_error, error, last), np.where(has_error, 0.0, waited)
        filtered[day] = bias
    return filtered


def running_mean(errors: Floats, days: int) -> Floats:
    """Mean of the errors (..., day) on the last days, including the day; NaN without any."""
    by_day = pd.DataFrame(errors.reshape(-1, errors.shape[-1]).T)
    return np.asarray(by_day.rolling(days, min_periods=1).mean().to_numpy().T.reshape(errors.shape))
