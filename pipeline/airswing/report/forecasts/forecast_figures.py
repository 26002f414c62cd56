"""Forecasts before and after correction, as pictures.

Assumes the Datasets of :mod:`airswing.handover.forecasts`. Bars and bands are 95 % intervals over
blocks of days; the scores are of the days held out.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.handover.forecasts.correcting import METHODS, TIME
from airswing.report.html.style import INK, SOFT, blank, new_figure, plural, series_style, styled

NAMES = {"raw": "raw forecast", "kalman": "Kalman filter", "running_mean": "running mean"}
_FORECAST = {
    "raw": "forecast",
    "kalman": "corrected_forecast",
    "running_mean": "running_mean_forecast",
}
# Days shown in a time line.
_LONGEST = 120


def _with_unit(text: str, ds: xr.Dataset, variable: str) -> str:
    """Return a label with the variable's unit, where it has one."""
    unit = str(ds["variable_units"].sel(variable=variable).item())
    return f"{text} ({unit})" if unit else text


@styled
def by_lead_figure(scored: xr.Dataset, variable: str) -> Figure:
    """Draw bias, centred rms and skill against lead for every method.

    Parameters
    ----------
    scored : Dataset
        Of :func:`airswing.handover.forecasts.forecast_scores.score_forecasts`, with
        ``variable_units``.
    """
    own = scored.sel(variable=variable, period="held_out")
    figure = new_figure(3.4)
    panels = figure.subplots(1, 3, sharex=True)
    shown = (
        ("forecast_error_mean", _with_unit("bias", scored, variable)),
        ("forecast_error_centred_rms", _with_unit("centred rms", scored, variable)),
        ("skill", "skill against raw"),
    )
    for axes, (name, label) in zip(panels, shown, strict=True):
        for index, method in enumerate(METHODS):
            if name != "skill" or method != "raw":
                _line(axes, own.sel(correction=method), name, index)
        axes.set_title(label)
        axes.set_xlabel("lead (h)")
        axes.axhline(0.0, color=INK, linewidth=0.8)
    panels[0].legend(loc="best")
    number = int(scored["pair_count"].sel(variable=variable, period="held_out"))
    return figure.say(
        f"{variable.replace('_', ' ')}: bias, centred rms and skill by lead on the days held out, "
        f"95 % intervals by days (n = {plural(number, 'pair')} of forecast and observation)."
    )


def _line(axes: Axes, own: xr.Dataset, name: str, index: int) -> None:
    colour, marker = series_style(index)
    lead, values = own["lead"].to_numpy(), own[f"{name}_by_lead"].to_numpy()
    low, high = own[f"{name}_by_lead_interval"].to_numpy().T
    axes.fill_between(lead, low, high, color=colour, alpha=0.15, linewidth=0)
    label = NAMES[str(own["correction"].item())]
    axes.plot(lead, values, color=colour, marker=marker, markersize=3.5, label=label)


@styled
def time_line_figure(corrected: xr.Dataset, variable: str, station: str) -> Figure:
    """Draw the daily error of one station before and after, the mean over leads.

    Parameters
    ----------
    corrected : Dataset
        Of :func:`airswing.handover.forecasts.correcting.correct_forecasts`.
    """
    own = corrected.sel(variable=variable, station=station).isel({TIME: slice(-_LONGEST, None)})
    figure = new_figure(2.8)
    axes = figure.subplots()
    starts = own[TIME].to_numpy()
    known = 0
    for index, method in enumerate(METHODS):
        error = (own[_FORECAST[method]] - own["observation"]).transpose(TIME, "lead").to_numpy()
        number = np.isfinite(error).sum(axis=1)
        mean = np.where(number > 0, np.nansum(error, axis=1) / np.maximum(number, 1), np.nan)
        known = int(number.sum())
        colour, marker = series_style(index)
        axes.plot(
            starts,
            mean,
            color=colour,
            marker=marker,
            markersize=3,
            linewidth=1.2,
            label=NAMES[method],
        )
    judged = own["held_out"].to_numpy().astype(bool)
    if judged.any() and not judged.all():
        axes.axvline(starts[judged][0], color=SOFT, linewidth=1.0, linestyle="--")
        axes.annotate(
            " held out",
            (starts[judged][0], 1.0),
            xycoords=("data", "axes fraction"),
            va="top",
            color=SOFT,
            fontsize=8.5,
        )
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_ylabel(_with_unit("mean error of a start", corrected, variable))
    axes.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.autofmt_xdate(rotation=0, ha="center")
    return figure.say(
        f"{variable.replace('_', ' ')} at station {station}: error of each start, mean over leads "
        f"(n = {plural(known, 'pair')}). The ratio was chosen on the days left of the dashed line."
    )


@styled
def stations_figure(scored: xr.Dataset, variable: str) -> Figure:
    """Draw the rms error of every station, before against after."""
    own = scored["forecast_error_rms_by_station"].sel(variable=variable)
    raw = own.sel(correction="raw").to_numpy()
    figure = new_figure(3.6, width=4.8)
    axes = figure.subplots()
    told = np.isfinite(raw)
    if not told.any():
        blank(axes, "No pair on the days held out.")
        return figure.say("No pair on the days held out (n = 0).")
    top = 1.05 * float(raw[told].max())
    for index, method in enumerate(METHODS[1:], start=1):
        colour, marker = series_style(index)
        after = own.sel(correction=method).to_numpy()
        axes.plot(raw, after, marker, color=colour, markersize=4, alpha=0.6, label=NAMES[method])
        top = max(top, 1.05 * float(np.nanmax(after)))
    axes.plot([0, top], [0, top], color=SOFT, linewidth=0.9)
    axes.set(xlim=(0, top), ylim=(0, top))
    axes.set_xlabel(_with_unit("rms error, raw", scored, variable))
    axes.set_ylabel(_with_unit("rms error, corrected", scored, variable))
    axes.legend()
    return figure.say(
        f"{variable.replace('_', ' ')}: rms error of each station on the days held out; below the "
        f"line the correction helps (n = {plural(int(told.sum()), 'station')})."
    )
