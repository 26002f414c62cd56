"""Page of forecasts corrected by their past errors: scores, figures, method.

Assumes the Dataset of ``postprocessed.nc``. One self-contained HTML file. Bars and bands are 95 %
intervals over blocks of days; scores are those of the days held out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.handover.forecasts.correcting import FORECASTS, METHODS, SCORES, TIME
from airswing.products.whole_files import write_text
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    document,
    heading,
    link,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded
from airswing.report.html.style import INK, SOFT, blank, new_figure, plural, series_style, styled
from airswing.report.run.reading_warnings import tally
from airswing.report.run.selection import number_text, range_text
from airswing.version import __version__

NAMES = {
    "raw": "raw forecast",
    "kalman": "Kalman filter",
    "running_mean": "running mean",
    "mean_of_pairs": "mean of the last pairs",
}
LONGEST = 120
"""Starts shown in a time series."""
_PERIODS = {"held_out": "held out", "all": "all days"}


def write_forecast_page(directory: Path, corrected: xr.Dataset) -> Path:
    """Write ``index.html`` of corrected forecasts; return its path."""
    sections = [_scores_section(corrected), _figures_section(corrected), _notes_section(corrected)]
    first, last = corrected[TIME].to_numpy()[[0, -1]]
    text = document(
        title="airswing: forecasts corrected by their past errors",
        kicker="Kalman-filter post-processing  ·  "
        f"{np.datetime_as_string(first, 'D')} to {np.datetime_as_string(last, 'D')}",
        headline=forecast_headline(corrected),
        facts=_facts(corrected),
        sections=[section for section in sections if section.parts],
        footer=[f"airswing {__version__}. Intervals are 95 %, by blocks of start days."],
    )
    return write_text(Path(directory) / "index.html", text)


def forecast_headline(corrected: xr.Dataset) -> str:
    """State the rms error before and after the filter, by variable, in one sentence."""
    chosen = corrected.sel(period="held_out")
    parts = []
    for name in chosen["variable"].to_numpy():
        rms = chosen["forecast_error_rms"].sel(variable=name)
        before, after = (float(rms.sel(correction=method)) for method in ("raw", "kalman"))
        unit = str(chosen["variable_units"].sel(variable=name).item())
        if np.isfinite(before):
            words = str(name).replace("_", " ")
            parts.append(f"of {words} from {before:.2f} to {after:.2f} {unit}".rstrip())
    if not parts:
        return "No held-out day has a pair to judge the corrected forecasts by."
    return f"On held-out days the filter changed the rms error {', '.join(parts)}."


def _facts(corrected: xr.Dataset) -> list[tuple[str, str]]:
    sizes = corrected.sizes
    return [
        (f"{sizes['station']:,}", "stations"),
        (f"{sizes['lead']:,}", "leads"),
        (f"{sizes[TIME]:,}", "starts"),
        (f"{int(corrected['pair_count'].sel(period='all').sum()):,}", "pairs"),
    ]


def _scores_section(corrected: xr.Dataset) -> Section:
    """Return the table of scores."""
    rows = []
    for variable in corrected["variable"].to_numpy():
        for period, words in _PERIODS.items():
            number = int(corrected["pair_count"].sel(variable=variable, period=period))
            for method in METHODS:
                chosen = corrected.sel(variable=variable, period=period, correction=method)
                cells = [
                    number_text(chosen[name])
                    + range_text(chosen[f"{name}_interval"].to_numpy().tolist())
                    for name in SCORES
                ]
                shown = [str(variable).replace("_", " "), words, NAMES[method], *cells]
                rows.append(Row([*shown, f"{number:,}"], doubt=period == "all"))
    columns = [
        Column("variable", "words"),
        Column("days", "words"),
        Column("forecast", "words"),
        Column("bias"),
        Column("centred rms"),
        Column("rms"),
        Column("skill"),
        Column("pairs"),
    ]
    caption = (
        "Scores over all stations and leads, in the variable's unit, with 95 % intervals by blocks "
        "of days. Skill: one minus the mean square error over the raw forecast's. Grey italics: "
        "with the days that chose the filter's ratio."
    )
    lead = "Every method is judged on the same pairs; nothing observed after a start corrects it."
    return Section("scores", "Scores", lead, [table(columns, rows, caption=caption)])


def _figures_section(corrected: xr.Dataset) -> Section:
    parts: list[Markup] = []
    several = corrected.sizes["station"] > 1
    for variable in map(str, corrected["variable"].to_numpy()):
        parts.append(heading(variable.replace("_", " ")))
        if corrected.sizes["lead"] > 1:
            parts.append(embedded(by_lead_figure(corrected, variable)))
        station = _most_improved(corrected, variable)
        parts.append(embedded(time_line_figure(corrected, variable, station)))
        if several:
            parts.append(embedded(stations_figure(corrected, variable)))
    return Section("figures", "Before and after", "", parts)


def _most_improved(corrected: xr.Dataset, variable: str) -> str:
    """Return the station with the highest skill of the filter, the first where none is known."""
    gain = corrected["skill_by_station"].sel(variable=variable, correction="kalman").to_numpy()
    place = int(np.argmax(np.where(np.isfinite(gain), gain, -np.inf)))
    return str(corrected["station"].to_numpy()[place])


def _notes_section(corrected: xr.Dataset) -> Section:
    lines = []
    for name in corrected["variable"].to_numpy():
        chosen = corrected.sel(variable=name)
        how = (
            "least mean square error on the training days"
            if int(chosen["ratio_chosen"])
            else "given, or the usual one because the days are too few"
        )
        ratio = float(chosen["ratio"])
        what = (
            f"ratio {ratio:g} ({how})"
            if ratio
            else f"left unchanged ({how}: no ratio has a smaller one)"
        )
        lines.append(f"{str(name).replace('_', ' ')}: {what}")
    judged = int(corrected["held_out"].sum())
    lines.append(f"{plural(judged, 'start')} of {corrected.sizes[TIME]:,} held out")
    for reason, number in tally(corrected, "lines_left_out").items():
        lines.append(f"left out: {reason} ({number:,})")
    text = paragraph(
        "The filter follows a bias that wanders (Delle Monache et al. 2006, J. Geophys. Res. 111, "
        "D05308); it cannot follow a change of regime within a day or two."
    )
    product = listing([link("../postprocessed.nc", "postprocessed.nc: forecasts and scores")])
    return Section("notes", "Method", "", [text, listing(lines), product])


def _with_unit(text: str, ds: xr.Dataset, variable: str) -> str:
    """Return a label with the variable's unit, where it has one."""
    unit = str(ds["variable_units"].sel(variable=variable).item())
    return f"{text} ({unit})" if unit else text


@styled
def by_lead_figure(scored: xr.Dataset, variable: str) -> Figure:
    """Draw bias, centred rms and skill against lead for every method."""
    chosen = scored.sel(variable=variable, period="held_out")
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
                _line(axes, chosen.sel(correction=method), name, index)
        axes.set_title(label)
        axes.set_xlabel("lead (h)")
        axes.axhline(0.0, color=INK, linewidth=0.8)
    panels[0].legend(loc="best")
    number = int(scored["pair_count"].sel(variable=variable, period="held_out"))
    return figure.say(
        f"{variable.replace('_', ' ')}: bias, centred rms and skill by lead on the days held out, "
        f"95 % intervals by days (n = {plural(number, 'pair')} of forecast and observation)."
    )


def _line(axes: Axes, chosen: xr.Dataset, name: str, index: int) -> None:
    colour, marker = series_style(index)
    lead, values = chosen["lead"].to_numpy(), chosen[f"{name}_by_lead"].to_numpy()
    low, high = chosen[f"{name}_by_lead_interval"].to_numpy().T
    axes.fill_between(lead, low, high, color=colour, alpha=0.15, linewidth=0)
    label = NAMES[str(chosen["correction"].item())]
    axes.plot(lead, values, color=colour, marker=marker, markersize=3.5, label=label)


@styled
def time_line_figure(corrected: xr.Dataset, variable: str, station: str) -> Figure:
    """Draw the daily error of one station before and after, the mean over lead times.

    The axis reaches 3 times the 90th percentile of the errors: single gross errors are cut.
    """
    chosen = corrected.sel(variable=variable, station=station).isel({TIME: slice(-LONGEST, None)})
    figure = new_figure(2.8)
    axes = figure.subplots()
    starts = chosen[TIME].to_numpy()
    known, sizes = 0, [0.0]
    for index, method in enumerate(METHODS):
        error = (
            (chosen[FORECASTS[method]] - chosen["observation"]).transpose(TIME, "lead").to_numpy()
        )
        number = np.isfinite(error).sum(axis=1)
        mean = np.where(number > 0, np.nansum(error, axis=1) / np.maximum(number, 1), np.nan)
        known = int(number.sum())
        sizes += np.abs(mean[number > 0]).tolist()
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
    judged = chosen["held_out"].to_numpy().astype(bool)
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
    top = 3.0 * float(np.percentile(sizes, 90.0))
    if 0.0 < top < max(sizes):
        axes.set_ylim(-top, top)
    axes.set_ylabel(_with_unit("mean error of a start", corrected, variable))
    axes.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    figure.autofmt_xdate(rotation=0, ha="center")
    return figure.say(
        f"{variable.replace('_', ' ')} at station {station}: error of each start, mean over leads "
        f"(n = {plural(known, 'pair')}). The ratio was chosen on the days left of the dashed line."
    )


@styled
def stations_figure(scored: xr.Dataset, variable: str) -> Figure:
    """Draw the distribution of scores over stations.

    On the left the rms error of each station with the filter and its rivals against the raw
    forecast's; on the right the skill of the filter, stations in order of skill, with intervals.
    Axes are limited to 1.5 times the 95th percentile (errors) and to skills above -1: a single
    station with a gross error is drawn at the edge.
    """
    rms = scored["forecast_error_rms_by_station"].sel(variable=variable)
    skill = scored["skill_by_station"].sel(variable=variable, correction="kalman").to_numpy()
    raw = rms.sel(correction="raw").to_numpy()
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    known = np.isfinite(raw)
    if not known.any():
        blank(left, "No pair on the days held out.")
        blank(right, "")
        return figure.say("No pair on the days held out (n = 0).")
    values = rms.isel(station=np.flatnonzero(known)).to_numpy()
    top = max(1.5 * float(np.nanpercentile(values, 95.0)), 1e-9)
    for index, method in enumerate(METHODS[1:], start=1):
        colour, marker = series_style(index)
        after = np.minimum(rms.sel(correction=method).to_numpy(), top)
        left.plot(
            np.minimum(raw, top),
            after,
            marker,
            color=colour,
            markersize=4,
            alpha=0.6,
            label=NAMES[method],
        )
    left.plot([0, top], [0, top], color=SOFT, linewidth=0.9)
    left.set(xlim=(0, 1.02 * top), ylim=(0, 1.02 * top))
    left.set_xlabel(_with_unit("rms error, raw", scored, variable))
    left.set_ylabel(_with_unit("rms error, corrected", scored, variable))
    left.legend()
    order = np.flatnonzero(np.isfinite(skill))[np.argsort(skill[np.isfinite(skill)])]
    chosen = scored["skill_by_station_interval"].sel(variable=variable, correction="kalman")
    low, high = np.maximum(chosen.transpose("station", "bound").to_numpy()[order].T, -1.0)
    colour, marker = series_style(METHODS.index("kalman"))
    place = np.arange(1, order.size + 1)
    right.vlines(place, low, high, color=colour, alpha=0.35, linewidth=1.0)
    right.plot(place, np.maximum(skill[order], -1.0), marker, color=colour, markersize=3)
    right.axhline(0.0, color=INK, linewidth=0.8)
    right.set_ylim(-1.05, 1.05)
    right.set_xlabel("station, by skill")
    right.set_ylabel("skill of the filter")
    outside = int((rms > top).any("correction").sum())
    beyond = f"; {plural(outside, 'station')} beyond the axes at the edge" if outside else ""
    return figure.say(
        f"{variable.replace('_', ' ')} on the days held out. Left: rms error of each station, "
        f"below the line smaller than raw{beyond}. Right: skill of the filter against the raw "
        f"forecast with 95 % intervals by days (n = {plural(int(known.sum()), 'station')})."
    )
