"""Innovation statistics (observation minus reference): figures and a section of the page.

Takes ``innovation_statistics.nc`` (:mod:`airswing.evaluation.innovations`). A sounding shows one
ascent or descent as reported, as corrected and in the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.evaluation.innovations import combined
from airswing.flags import PHASE
from airswing.report.html import style
from airswing.report.html.document import Column, Figures, Section, folded, table
from airswing.report.html.style import STATES
from airswing.report.html.text import Units, number_text, plural, shown_per_m_s
from airswing.report.run.changes import date_axis, days_since_1970
from airswing.report.run.selection import members, pooled, rows_of, tails

Floats = NDArray[np.float64]
_QUANTITIES = ("speed", "direction", "eastward", "northward")
_CELLS = ("aircraft", "flight_phase", "layer")
# Names of rows, and by (quantity, kind) arrays (state, row).
_Cells = tuple[list[str], dict[tuple[str, str], Floats]]
# Aircraft in the figures.
_MOST_SERIES, _MOST_AIRCRAFT = 7, 20
# Reports that a sounding needs at least.
_SOUNDING_REPORTS = 4
_NONE = "No report with a phase, a layer and a reference wind"


def _unit(quantity: str, units: Units) -> tuple[str, float]:
    """Return the unit of a quantity as shown, and the factor to it."""
    return ("degree", 1.0) if quantity == "direction" else (units, shown_per_m_s(units))


def _cells_by(statistics: xr.Dataset, reference: str, by: str) -> _Cells:
    """Return the rows with reports by aircraft, phase of flight or layer."""
    found = combined(statistics.sel(reference=reference), [dim for dim in _CELLS if dim != by])
    names = [str(name) for name in found[by].to_numpy()] if by in found.coords else []
    if by == "layer":
        edges = [statistics[f"layer_{end}_pressure"].to_numpy() / 100 for end in ("bottom", "top")]
        names = [f"{low:.0f}-{high:.0f} hPa" for low, high in zip(*edges, strict=True)]
    values = {
        (quantity, kind): found[f"innovation_{quantity}_{kind}"].transpose("state", by).to_numpy()
        for quantity in _QUANTITIES
        for kind in ("bias", "standard_deviation", "rms", "count")
    }
    keep = np.flatnonzero(values["speed", "count"][0])
    return [names[k] for k in keep], {key: one[:, keep] for key, one in values.items()}


def innovation_figure(statistics: xr.Dataset, reference: str, units: Units) -> Figure:
    """Draw bias and standard deviation of the innovations by aircraft, phase of flight and layer.

    Markers are biases, lines reach one standard deviation to either side. At most 20 aircraft,
    those with most reports.
    """
    (aircraft, values), *others = (_cells_by(statistics, reference, by) for by in _CELLS)
    reports = values["speed", "count"][0]
    number = int(reports.sum())
    if not number:
        return style.empty_figure(_NONE)
    order = np.argsort(-reports, kind="stable")[:_MOST_AIRCRAFT]
    rows = [aircraft[k] for k in order] + [name for names, _ in others for name in names]
    figure = style.new_figure(1.1 + 0.2 * len(rows))
    panels = figure.subplots(1, len(_QUANTITIES), sharey=True)
    for axes, quantity in zip(panels, _QUANTITIES, strict=True):
        unit, factor = _unit(quantity, units)
        for index, (state, colour, marker) in enumerate(STATES):
            bias, spread = (
                factor
                * np.concatenate(
                    [
                        values[quantity, kind][index][order],
                        *(other[quantity, kind][index] for _, other in others),
                    ]
                )
                for kind in ("bias", "standard_deviation")
            )
            y, ends = np.arange(len(rows)) + 0.3 * (index - 0.5), (bias - spread, bias + spread)
            look = {"color": colour, "marker": marker, "markersize": 4.5, "label": state}
            style.intervals(axes, bias, ends, y, **look)
        style.zero_line(axes)
        axes.set_xlabel(f"{quantity} ({unit})")
    style.rows_axis(panels[0], rows)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure.say(
        f"Innovations (observation minus {reference}) of wind speed, direction and components by "
        "aircraft, phase of flight and layer: bias (marker) and one standard deviation to either "
        f"side (line), as reported and corrected (n = {plural(number, 'report')}). "
        "Direction is positive where veered."
    )


def innovation_histogram_figure(statistics: xr.Dataset, reference: str, units: Units) -> Figure:
    """Draw the histogram of the wind vector innovation, as reported and corrected."""
    counts = statistics["innovation_histogram"].sel(reference=reference)
    number = int(counts.sel(state="reported").sum())
    if not number:
        return style.empty_figure(_NONE)
    lower = statistics["eastward_class"].to_numpy().astype(float)
    ends = shown_per_m_s(units) * np.array([lower[0], 2 * lower[-1] - lower[-2]])
    figure = style.new_figure(4.6)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    look: dict[str, Any] = {"cmap": style.DENSITY, "norm": LogNorm(1, max(int(counts.max()), 2))}
    look |= {"extent": (*ends, *ends), "origin": "lower", "interpolation": "nearest"}
    for axes, (state, *_) in zip(panels, STATES, strict=True):
        grid = counts.sel(state=state).transpose("northward_class", "eastward_class").to_numpy()
        drawn = axes.imshow(np.ma.masked_less(grid.astype(float), 1.0), **look)
        style.zero_line(axes)
        style.zero_line(axes, across=True)
        axes.set(title=state, xlabel=f"eastward innovation ({units})")
    panels[0].set_ylabel(f"northward innovation ({units})")
    bar = figure.colorbar(drawn, ax=list(panels), label="reports in a class", shrink=0.8)
    style.count_ticks(bar, float(counts.max()))
    return figure.say(
        f"Histogram of the wind vector innovation (observation minus {reference}) in classes of "
        f"1 m/s; the outermost classes include all beyond (n = {plural(number, 'report')})."
    )


def innovation_series_figure(
    statistics: xr.Dataset, reference: str, names: Sequence[str], units: Units
) -> Figure:
    """Draw the daily mean innovation of wind speed and direction, a line an aircraft."""
    chosen = statistics.sel(reference=reference, aircraft=list(names))
    day = days_since_1970(statistics["day"].to_numpy())
    number = int(chosen["daily_innovation_count"].sel(state="reported").sum())
    if not number:
        return style.empty_figure(_NONE)
    figure = style.new_figure(4.6)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for panels, quantity in zip(grid, ("speed", "direction"), strict=True):
        unit, factor = _unit(quantity, units)
        for axes, (state, *_) in zip(panels, STATES, strict=True):
            for index, name in enumerate(names):
                colour, marker = style.series_style(index)
                value = chosen[f"daily_innovation_{quantity}"].sel(aircraft=name, state=state)
                look: dict[str, Any] = {"color": colour, "markersize": 3, "linewidth": 1.0}
                axes.plot(day, factor * value.to_numpy(), marker + "-", label=name, **look)
            style.zero_line(axes, across=True)
            axes.set_title(f"{quantity}, {state}")
        panels[0].set_ylabel(f"innovation ({unit})")
    date_axis(grid[-1, 0])
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7)
    return figure.say(
        f"Daily mean innovation (observation minus {reference}) of wind speed and direction, as "
        f"reported and corrected, of {plural(len(names), 'aircraft')} (n = "
        f"{plural(number, 'report')})."
    )


def _innovation_table(statistics: xr.Dataset, by: str, reference: str, units: Units) -> Markup:
    names, values = _cells_by(statistics, reference, by)
    states = [state for state, *_ in STATES]
    columns = [
        Column(by.replace("_", " "), np.repeat(names, len(states)), "words"),
        Column("", states * len(names), "words"),
    ]
    for quantity in _QUANTITIES:
        digits, (unit, factor) = (1 if quantity == "direction" else 2), _unit(quantity, units)
        for words, kind in (("bias", "bias"), ("SD", "standard_deviation"), ("rms", "rms")):
            cells = factor * values[quantity, kind].T.ravel()  # the states of a row together
            title = f"{quantity} {words} ({unit.replace('degree', '°')})"
            columns.append(Column(title, [number_text(x, digits=digits) for x in cells]))
    reports = values["speed", "count"].T.ravel()
    columns.append(Column("reports", [f"{int(number):,}" for number in reports]))
    return table(columns, caption=f"Observation minus {reference}, screened reports.")


def sounding_figure(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    aircraft: Sequence[str],
    reference: str,
    units: Units,
) -> Figure:
    """Draw winds as reported, corrected and of the reference on an ascent or descent.

    It is the one with the most reports of the first of `aircraft` that has one.
    """
    picked, name = _sounding_reports(headings, corrected, aircraft)
    if picked is None:
        return style.empty_figure("No ascent or descent has enough reports for a sounding")
    ways = ("eastward", "northward")
    names = [f"{of}{way}_wind" for of in ("", "reference_") for way in ways]
    picked = picked[np.argsort(-headings["pressure"].isel(report=picked).to_numpy())]
    reports = headings[["time", "pressure", *names]].isel(report=picked).load()
    better = corrected[[f"corrected_{way}_wind" for way in ways]].isel(report=picked).load()
    chosen = members(headings, reference)
    winds = {
        "reported": [reports[f"{way}_wind"].to_numpy() for way in ways],
        "corrected": [better[f"corrected_{way}_wind"].to_numpy() for way in ways],
        reference: [pooled(reports, chosen, f"reference_{way}_wind") for way in ways],
    }
    figure = _wind_profiles(reports["pressure"].to_numpy() / 100.0, winds, units)
    first = np.datetime_as_string(reports["time"].to_numpy().min(), "m").replace("T", " ")
    return figure.say(
        f"Sounding of {name} on {first} UTC: wind as reported, corrected, and of {reference} "
        f"(n = {plural(picked.size, 'report')})."
    )


def _sounding_reports(
    headings: xr.Dataset, corrected: xr.Dataset, aircraft: Sequence[str]
) -> tuple[NDArray[np.int64] | None, str]:
    """Return the places of the reports of an ascent or descent, and the aircraft."""
    phases = headings["phase"].to_numpy()
    climbing = (phases == PHASE["ascent"]) | (phases == PHASE["descent"])
    for name in aircraft:
        rows = rows_of(headings, name)
        if not climbing[rows].any():
            continue
        number, phase = headings["flight"].isel(report=rows).to_numpy(), phases[rows]
        wind = corrected["corrected_eastward_wind"].isel(report=rows).to_numpy()
        usable = climbing[rows] & np.isfinite(wind)
        both = np.stack([number[usable], phase[usable]])
        labels, counts = np.unique(both, axis=1, return_counts=True)
        if counts.size and counts.max() >= _SOUNDING_REPORTS:
            best = labels[:, int(np.argmax(counts))]
            inside = usable & (number == best[0]) & (phase == best[1])
            return rows.start + np.flatnonzero(inside), name
    return None, ""


def _wind_profiles(
    pressure: Floats, winds: dict[str, list[Floats]], units: Units
) -> style.CaptionedFigure:
    figure = style.new_figure(4.6)
    panels = figure.subplots(1, 3, sharey=True, width_ratios=(1, 1, 0.45))
    factor = shown_per_m_s(units)
    # At most 20 barbs in a column, or they cover each other.
    few = slice(None, None, max(1, -(-pressure.size // 20)))
    colours = (style.ORANGE, style.BLUE, style.INK)
    for place, (colour, (label, (u, v))) in enumerate(zip(colours, winds.items(), strict=True)):
        _, marker = style.series_style(place)
        look: dict[str, Any] = {"color": colour, "markersize": 3.5, "linewidth": 1.3}
        panels[0].plot(factor * np.hypot(u, v), pressure, marker + "-", label=label, **look)
        direction = np.degrees(np.arctan2(-u, -v)) % 360.0
        # without a line, which would cross the panel where directions pass north
        panels[1].plot(direction, pressure, marker, color=colour, markersize=3.5)
        x, look = np.full(pressure[few].size, float(place)), {"color": colour, "linewidth": 0.7}
        panels[2].barbs(x, pressure[few], factor * u[few], factor * v[few], length=5.5, **look)
    panels[0].set_xlim(left=0.0)
    panels[0].set(xlabel=f"wind speed ({units})", ylabel="pressure (hPa)")
    panels[0].set_ylim(float(pressure.max()) + 40.0, float(pressure.min()) - 25.0)
    panels[1].set(xlabel="wind direction (degree)", xlim=(0, 360), xticks=range(0, 361, 90))
    panels[2].set(xlabel=f"barbs (10 {units})", xlim=(-0.7, 2.7), xticks=[])
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def innovations_section(
    statistics: xr.Dataset | None,
    sounding: Figure | None,
    reference: str,
    aircraft: Sequence[str],
    show: Figures,
) -> Section:
    """Return the section on the innovations."""
    parts, lead, units = [], "", show.units
    if statistics is not None:
        known = [str(name) for name in statistics["reference"].to_numpy()]
        chosen = reference if reference in known else known[0]
        lead = _lead(combined(statistics.sel(reference=chosen), _CELLS), chosen, units)
        names = [name for name in aircraft if name in tails(statistics)][:_MOST_SERIES]
        figure = innovation_figure(statistics, chosen, units)
        parts.append(show("innovations", figure, dpi=120))
        tables = [_innovation_table(statistics, by, chosen, units) for by in _CELLS]
        parts.append(folded("Tables by aircraft, phase of flight and layer", tables))
        histogram = innovation_histogram_figure(statistics, chosen, units)
        parts.append(folded("Histogram", [show("innovation_histogram", histogram)]))
        series = innovation_series_figure(statistics, chosen, names, units)
        shown = show("innovation_series", series, dpi=120)
        parts.append(folded("Daily means by aircraft", [shown]))
    if sounding is not None:
        parts.append(folded("A sounding", [show("sounding", sounding)]))
    return Section("innovations", "Innovations (observation minus reference)", lead, parts)


def _lead(whole: xr.Dataset, reference: str, units: Units) -> str:
    parts = []
    for quantity, scale, unit in (
        ("speed", shown_per_m_s(units), f" {units}"),
        ("direction", 1.0, "°"),
    ):
        rms = scale * whole[f"innovation_{quantity}_rms"]
        before, after = (float(rms.sel(state=state)) for state, *_ in STATES)
        if np.isfinite(before + after):
            parts.append(f"{quantity} from {before:.1f} to {after:.1f}{unit}")
    if not parts:
        return ""
    return (
        f"Rms innovation against {reference}, before and after the correction: {', '.join(parts)}."
    )
