"""Page of forecasts corrected by their past errors: scores, figures, method.

Takes the Dataset of ``postprocessed.nc``. Bars and bands are 95 % intervals over blocks of days;
scores are those of the days held out.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from airswing.handover.forecasts.correcting import METHODS, SCORES, TIME
from airswing.report import html
from airswing.report.html import Look, amount, plural
from airswing.report.run.reading_warnings import tally

NAMES = {
    "raw": "raw forecast",
    "kalman": "Kalman filter",
    "running_mean": "running mean",
}
_PERIODS = {"held_out": "held out", "all": "all days"}


@html.drawing()
def write_forecast_page(directory: Path, corrected: xr.Dataset) -> Path:
    """Write ``index.html`` of corrected forecasts; return its path."""
    first, last = np.datetime_as_string(corrected[TIME].to_numpy()[[0, -1]], "D")
    pairs = int(corrected["pair_count"].sel(period="all").sum())
    sizes = {"stations": "station", "leads": "lead", "starts": TIME}
    facts = [(f"{corrected.sizes[name]:,}", words) for words, name in sizes.items()]
    drawings = {"lead": _by_lead_figure, "station": _stations_figure}
    drawings = {name: draw for name, draw in drawings.items() if corrected.sizes[name] > 1}
    parts: list[Markup] = []
    show = html.Figures()
    for variable in map(str, corrected["variable"].to_numpy()):
        figures = [show(f"{name}s", draw(corrected, variable)) for name, draw in drawings.items()]
        parts += [html.heading(_words(variable)), *figures] if figures else []
    return html.write_document(
        Path(directory) / "index.html",
        title="airswing: forecasts corrected by their past errors",
        kicker=f"Kalman-filter post-processing  ·  {first} to {last}",
        headline=forecast_headline(corrected),
        facts=[*facts, (f"{pairs:,}", "pairs")],
        sections=[
            _scores_section(corrected),
            html.Section("figures", f"By {' and '.join(drawings)}", "", parts),
            _notes_section(corrected),
        ],
        footer="Intervals are 95 %, by blocks of start days.",
    )


def forecast_headline(corrected: xr.Dataset) -> str:
    """State the rms error before and after the filter, by variable, in one sentence."""
    parts = []
    for name in corrected["variable"].to_numpy():
        rms = corrected["forecast_error_rms"].sel(variable=name, period="held_out")
        before, after = (float(rms.sel(correction=method)) for method in ("raw", "kalman"))
        unit = str(corrected["variable_units"].sel(variable=name).item())
        if np.isfinite(before):
            parts.append(f"of {_words(name)} from {before:.2f} to {after:.2f} {unit}".rstrip())
    if not parts:
        return "No held-out day has a pair to score the corrected forecasts."
    return f"On held-out days the filter changed the rms error {', '.join(parts)}."


def _words(variable: object) -> str:
    return str(variable).replace("_", " ")


def _scores_section(corrected: xr.Dataset) -> html.Section:
    titles = dict(zip(SCORES, ("bias", "centred rms", "rms", "skill"), strict=True))
    rows = []
    for variable, period, method in product(corrected["variable"].values, _PERIODS, METHODS):
        selected = corrected.sel(variable=variable, period=period, correction=method)
        row = {"variable": _words(variable), "days": _PERIODS[period], "forecast": NAMES[method]}
        for name, title in titles.items():
            row[title] = amount(selected[name], selected[f"{name}_interval"].to_numpy())
        rows.append(row | {"pairs": int(selected["pair_count"])})
    caption = (
        "Scores over all stations and leads, in the variable's unit, with 95 % intervals by blocks "
        "of days. Skill: one minus the mean square error over the raw forecast's. Grey italics: "
        "with the days that chose the filter's ratio."
    )
    lead = "Every method is judged on the same pairs; nothing observed after a start corrects it."
    doubt, words = [row["days"] == "all days" for row in rows], ("variable", "days", "forecast")
    scores = html.table(rows, words=words, caption=caption, doubt=doubt)
    return html.Section("scores", "Scores", lead, [scores])


def _notes_section(corrected: xr.Dataset) -> html.Section:
    lines = []
    for name in corrected["variable"].to_numpy():
        selected = corrected.sel(variable=name)
        basis = "given, or the default with too few days"
        if int(selected["ratio_chosen"]):
            basis = "least mean square error on the training days"
        setting = f"left unchanged ({basis}: no ratio has a smaller one)"
        if ratio := float(selected["ratio"]):
            setting = f"ratio {ratio:g} ({basis})"
        lines.append(f"{_words(name)}: {setting}")
    judged = plural(int(corrected["held_out"].sum()), "start")
    lines.append(f"{judged} of {corrected.sizes[TIME]:,} held out")
    for reason, number in tally(corrected, "lines_left_out").items():
        lines.append(f"left out: {reason} ({number:,})")
    text = (
        "The filter follows a bias that wanders (Delle Monache et al. 2006, J. Geophys. Res. 111, "
        "D05308); it cannot follow a change of regime within a day or two."
    )
    link = html.link("../postprocessed.nc", "postprocessed.nc: forecasts and scores")
    return html.Section("notes", "Method", text, [html.listing(lines), html.listing([link])])


def _by_lead_figure(scored: xr.Dataset, variable: str) -> Figure:
    selected = scored.sel(variable=variable, period="held_out")
    figure, panels = html.panels(3.4, 1, 3, sharex=True)
    unit = str(selected["variable_units"].item())
    ending = f" ({unit})" if unit else ""
    shown = {
        "forecast_error_mean": f"bias{ending}",
        "forecast_error_centred_rms": f"centred rms{ending}",
        "skill": "skill against raw",
    }
    for axes, (name, label) in zip(panels, shown.items(), strict=True):
        for index, method in enumerate(METHODS):
            if name == "skill" and method == "raw":
                continue
            look = html.series(index, markersize=3.5, label=NAMES[method])
            scores, band = selected.sel(correction=method), Look(color=look["color"], alpha=0.15)
            ends = scores[f"{name}_by_lead_interval"].to_numpy().T
            axes.fill_between(scores["lead"], *ends, linewidth=0, **band)
            axes.plot(scores["lead"], scores[f"{name}_by_lead"], **look)
        axes.set(title=label, xlabel="lead (h)")
        html.zero_line(axes, across=True)
    panels[0].legend(loc="best")
    return figure.say(
        f"{_words(variable)}: scores by lead on the days held out, 95 % intervals by days "
        f"(n = {plural(int(selected['pair_count']), 'pair')} of forecast and observation)."
    )


def _stations_figure(scored: xr.Dataset, variable: str) -> Figure:
    selected = scored.sel(variable=variable, correction="kalman")
    skill = selected["skill_by_station"].to_numpy()
    order = np.argsort(skill)[: np.isfinite(skill).sum()]  # NaN is last
    if not order.size:
        return html.empty_figure("No pair on the days held out")
    figure, axes = html.panels(3.2)
    ends = selected["skill_by_station_interval"].transpose("bound", "station")[:, order]
    look, place = html.series(METHODS.index("kalman")), np.arange(1, order.size + 1)
    axes.vlines(place, *np.maximum(ends, -1.0), color=look["color"], alpha=0.35, linewidth=1.0)
    axes.plot(place, np.maximum(skill[order], -1.0), linestyle="", markersize=3, **look)
    html.zero_line(axes, across=True)
    axes.set(ylim=(-1.05, 1.05), xlabel="station, by skill", ylabel="skill of the filter")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure.say(
        f"{_words(variable)} on the days held out: skill of the filter against the raw forecast "
        f"at each station, 95 % intervals by days (n = {plural(order.size, 'station')})."
    )
