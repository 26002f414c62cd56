"""Innovation statistics (observation minus reference): figures and a section of the page.

Takes ``innovation_statistics.nc`` (:mod:`airswing.evaluation.innovations`): bias, standard
deviation and rms of speed, direction and wind components by aircraft, phase of flight and layer,
daily means, and a histogram of the wind vector innovation. A sounding shows one ascent or descent
as reported, as corrected and in the reference.
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
from airswing.report.html.document import Column, Row, Section, folded, table
from airswing.report.html.embed import Figures
from airswing.report.html.style import (
    BLUE,
    DENSITY,
    INK,
    ORANGE,
    CaptionedFigure,
    Units,
    count_ticks,
    empty_figure,
    new_figure,
    place_panels,
    plural,
    series_style,
    shown_per_m_s,
    styled,
)
from airswing.report.run.changes import date_axis, days_since_1970
from airswing.report.run.fleet import rows_axis
from airswing.report.run.selection import by_amplitude, members, number_text, pooled, rows_of, tails

Floats = NDArray[np.float64]
_QUANTITIES = ("speed", "direction", "eastward", "northward")
_CELLS = ("aircraft", "flight_phase", "layer")
# Names of rows, and by (quantity, kind) arrays (state, row).
_Cells = tuple[list[str], dict[tuple[str, str], Floats]]
_STATES = (("reported", ORANGE, "o"), ("corrected", BLUE, "D"))
# Aircraft in the figures.
_MOST_SERIES, _MOST_AIRCRAFT = 7, 20
# Reports that a sounding needs at least.
_SOUNDING_REPORTS = 4


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


@styled
def innovation_figure(statistics: xr.Dataset, reference: str, *, units: Units = "kt") -> Figure:
    """Draw bias and standard deviation of the innovations by aircraft, phase of flight and layer.

    Markers are biases, lines reach one standard deviation to either side. At most 20 aircraft,
    those with most reports.
    """
    (aircraft, values), *others = (_cells_by(statistics, reference, by) for by in _CELLS)
    reports = values["speed", "count"][0]
    number = int(reports.sum())
    if not number:
        return empty_figure("No report with a phase, a layer and a reference wind")
    order = np.argsort(-reports, kind="stable")[:_MOST_AIRCRAFT]
    rows = [aircraft[k] for k in order] + [name for names, _ in others for name in names]
    figure = new_figure(1.1 + 0.2 * len(rows), constrained=False)
    panels = figure.subplots(1, len(_QUANTITIES), sharey=True)
    for axes, quantity in zip(panels, _QUANTITIES, strict=True):
        unit, factor = _unit(quantity, units)
        for index, (state, colour, marker) in enumerate(_STATES):
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
            y = np.arange(len(rows)) + 0.3 * (index - 0.5)
            axes.hlines(y, bias - spread, bias + spread, color=colour, linewidth=1.1)
            axes.plot(bias, y, marker, color=colour, markersize=4.5, label=state)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.set_xlabel(f"{quantity} ({unit})")
    rows_axis(panels[0], rows)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="upper right", ncols=2)
    place_panels(figure, left=0.2 + 0.085 * max(map(len, rows)), top=0.35, wspace=0.12)
    return figure.say(
        f"Innovations (observation minus {reference}) of wind speed, direction and components by "
        "aircraft, phase of flight and layer: bias (marker) and one standard deviation to either "
        f"side (line), as reported and corrected (n = {plural(number, 'report')}). "
        "Direction is positive where veered."
    )


@styled
def innovation_histogram_figure(
    statistics: xr.Dataset, reference: str, *, units: Units = "kt"
) -> Figure:
    """Draw the histogram of the wind vector innovation, as reported and corrected."""
    counts = statistics["innovation_histogram"].sel(reference=reference)
    number = int(counts.sel(state="reported").sum())
    if not number:
        return empty_figure("No report with a phase, a layer and a reference wind")
    factor = shown_per_m_s(units)
    lower = statistics["eastward_class"].to_numpy().astype(float)
    edges = factor * np.append(lower, lower[-1] + (lower[1] - lower[0]))
    figure = new_figure(4.6, constrained=False)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    norm = LogNorm(1, max(int(counts.max()), 2))
    for axes, (state, *_) in zip(panels, _STATES, strict=True):
        grid = counts.sel(state=state).transpose("northward_class", "eastward_class").to_numpy()
        shown = np.ma.masked_less(grid.astype(float), 1.0)
        extent = (edges[0], edges[-1], edges[0], edges[-1])
        drawn = axes.imshow(
            shown, cmap=DENSITY, norm=norm, extent=extent, origin="lower", interpolation="nearest"
        )
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.set_title(state)
        axes.set_xlabel(f"eastward innovation ({units})")
    panels[0].set_ylabel(f"northward innovation ({units})")
    place_panels(figure, left=0.6, right=0.9, wspace=0.2)
    bar = figure.colorbar(drawn, cax=figure.add_axes((0.93, 0.15, 0.015, 0.7)))
    bar.set_label("reports in a class")
    count_ticks(bar, float(counts.max()))
    return figure.say(
        f"Histogram of the wind vector innovation (observation minus {reference}) in classes of "
        f"1 m/s; the outermost classes include all beyond (n = {plural(number, 'report')})."
    )


@styled
def innovation_series_figure(
    statistics: xr.Dataset, reference: str, names: Sequence[str], *, units: Units = "kt"
) -> Figure:
    """Draw the daily mean innovation of wind speed and direction, a line an aircraft."""
    chosen = statistics.sel(reference=reference, aircraft=list(names))
    day = days_since_1970(statistics["day"].to_numpy())
    number = int(chosen["daily_innovation_count"].sel(state="reported").sum())
    if not number:
        return empty_figure("No report with a phase, a layer and a reference wind")
    figure = new_figure(4.6, constrained=False)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for panels, quantity in zip(grid, ("speed", "direction"), strict=True):
        unit, factor = _unit(quantity, units)
        for axes, (state, *_) in zip(panels, _STATES, strict=True):
            for index, name in enumerate(names):
                colour, marker = series_style(index)
                value = chosen[f"daily_innovation_{quantity}"].sel(aircraft=name, state=state)
                look: dict[str, Any] = {"color": colour, "markersize": 3, "linewidth": 1.0}
                axes.plot(day, factor * value.to_numpy(), marker + "-", label=name, **look)
            axes.axhline(0.0, color=INK, linewidth=0.8)
            axes.set_title(f"{quantity}, {state}")
        panels[0].set_ylabel(f"innovation ({unit})")
    date_axis(grid[-1, 0])
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="lower center", ncols=7)
    place_panels(figure, left=0.65, bottom=0.75, wspace=0.2, hspace=0.4)
    return figure.say(
        f"Daily mean innovation (observation minus {reference}) of wind speed and direction, as "
        f"reported and corrected, of {plural(len(names), 'aircraft', 'aircraft')} (n = "
        f"{plural(number, 'report')})."
    )


def _innovation_table(statistics: xr.Dataset, by: str, reference: str, units: Units) -> Markup:
    cells = _cells_by(statistics, reference, by)
    columns = [Column(by.replace("_", " "), "words"), Column("", "words")]
    for quantity in _QUANTITIES:
        unit = _unit(quantity, units)[0].replace("degree", "°")
        columns += [Column(f"{quantity} {kind} ({unit})") for kind in ("bias", "SD", "rms")]
    columns.append(Column("reports"))
    rows = []
    for k, name in enumerate(cells[0]):
        for index, (state, *_) in enumerate(_STATES):
            row = [name, state]
            for quantity in _QUANTITIES:
                digits, factor = (1 if quantity == "direction" else 2), _unit(quantity, units)[1]
                row += [
                    number_text(factor * cells[1][quantity, kind][index, k], digits=digits)
                    for kind in ("bias", "standard_deviation", "rms")
                ]
            rows.append(Row([*row, f"{int(cells[1]['speed', 'count'][index, k]):,}"]))
    return table(columns, rows, caption=f"Observation minus {reference}, screened reports.")


@styled
def sounding_figure(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    fits: xr.Dataset,
    reference: str,
    *,
    units: Units = "kt",
) -> Figure:
    """Draw winds as reported, corrected and of the reference on an ascent or descent.

    It is the one with the most reports of the aircraft with the largest deviation.
    """
    found = _sounding_reports(headings, corrected, fits, reference)
    if found is None:
        return empty_figure("No ascent or descent has enough reports for a sounding")
    reports, corrections, name = found
    chosen = members(headings, fits, reference)
    pressure = reports["pressure"].to_numpy() / 100.0
    winds = {
        "reported": [reports[f"{way}_wind"].to_numpy() for way in ("eastward", "northward")],
        "corrected": [
            corrections[f"corrected_{way}_wind"].to_numpy() for way in ("eastward", "northward")
        ],
        reference: [
            pooled(reports, chosen, f"reference_{way}_wind") for way in ("eastward", "northward")
        ],
    }
    colours = dict(zip(winds, (ORANGE, BLUE, INK), strict=True))
    figure = _wind_profiles(pressure, winds, colours, units)
    first = np.datetime_as_string(reports["time"].to_numpy().min(), "m").replace("T", " ")
    return figure.say(
        f"Sounding of {name} on {first} UTC: wind as reported, corrected, and of {reference} "
        f"(n = {plural(pressure.size, 'report')})."
    )


def _sounding_reports(
    headings: xr.Dataset, corrected: xr.Dataset, fits: xr.Dataset, reference: str
) -> tuple[xr.Dataset, xr.Dataset, str] | None:
    """Return the reports of one ascent or descent, by pressure, their corrections and aircraft."""
    phases = headings["phase"].to_numpy()
    climbing = (phases == PHASE["ascent"]) | (phases == PHASE["descent"])
    for name in by_amplitude(fits, reference):
        rows = rows_of(headings, name)
        if not climbing[rows].any():
            continue
        number, phase = headings["flight"].isel(report=rows).to_numpy(), phases[rows]
        wind = corrected["corrected_eastward_wind"].isel(report=rows).to_numpy()
        usable = climbing[rows] & np.isfinite(wind)
        labels, counts = np.unique(
            np.stack([number[usable], phase[usable]]), axis=1, return_counts=True
        )
        if counts.size and counts.max() >= _SOUNDING_REPORTS:
            best = labels[:, int(np.argmax(counts))]
            picked = np.flatnonzero(usable & (number == best[0]) & (phase == best[1]))
            names = ["time", "pressure", "eastward_wind", "northward_wind"]
            names += ["reference_eastward_wind", "reference_northward_wind"]
            reports = headings[names].isel(report=rows.start + picked).load()
            corrections = corrected[["corrected_eastward_wind", "corrected_northward_wind"]]
            corrections = corrections.isel(report=rows.start + picked).load()
            order = np.argsort(-reports["pressure"].to_numpy())
            return reports.isel(report=order), corrections.isel(report=order), name
    return None


def _wind_profiles(
    pressure: Floats, winds: dict[str, list[Floats]], colours: dict[str, str], units: Units
) -> CaptionedFigure:
    figure = new_figure(4.6)
    panels = figure.subplots(1, 3, sharey=True, width_ratios=(1, 1, 0.45))
    factor = shown_per_m_s(units)
    # At most 20 barbs in a column, or they cover each other.
    every = max(1, -(-pressure.size // 20))
    for place, (label, (u, v)) in enumerate(winds.items()):
        _, marker = series_style(place)
        look: dict[str, Any] = {
            "color": colours[label],
            "markersize": 3.5,
            "linewidth": 1.3,
            "label": label,
        }
        panels[0].plot(factor * np.hypot(u, v), pressure, marker + "-", **look)
        direction = np.degrees(np.arctan2(-u, -v)) % 360.0
        look["linewidth"] = 0.0  # a line would cross the panel where directions pass north
        panels[1].plot(direction, pressure, marker, **look)
        panels[2].barbs(
            np.full(pressure[::every].size, float(place)),
            pressure[::every],
            factor * u[::every],
            factor * v[::every],
            color=colours[label],
            length=5.5,
            linewidth=0.7,
        )
    panels[0].set_xlabel(f"wind speed ({units})")
    panels[0].set_xlim(left=0.0)
    panels[1].set_xlabel("wind direction (degree)")
    panels[1].set_xlim(0, 360)
    panels[1].set_xticks(range(0, 361, 90))
    panels[2].set_xlim(-0.7, 2.7)
    panels[2].set_xticks([])
    panels[2].set_xlabel(f"barbs (10 {units})")
    panels[0].set_ylim(float(pressure.max()) + 40.0, float(pressure.min()) - 25.0)
    panels[0].set_ylabel("pressure (hPa)")
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
    title, parts, lead = "Innovations (observation minus reference)", [], ""
    units = show.units
    if statistics is not None:
        known = [str(name) for name in statistics["reference"].to_numpy()]
        chosen = reference if reference in known else known[0]
        whole = combined(statistics.sel(reference=chosen), _CELLS)
        lead = _lead(whole, chosen, units)
        names = [name for name in aircraft if name in tails(statistics)][:_MOST_SERIES]
        figure = innovation_figure(statistics, chosen, units=units)
        parts.append(show("innovations", figure, dpi=120))
        tables = [_innovation_table(statistics, by, chosen, units) for by in _CELLS]
        parts.append(folded("Tables by aircraft, phase of flight and layer", tables))
        histogram = innovation_histogram_figure(statistics, chosen, units=units)
        parts.append(folded("Histogram", [show("innovation_histogram", histogram)]))
        series = innovation_series_figure(statistics, chosen, names, units=units)
        shown = show("innovation_series", series, dpi=120)
        parts.append(folded("Daily means by aircraft", [shown]))
    if sounding is not None:
        parts.append(folded("A sounding", [show("sounding", sounding)]))
    return Section("innovations", title, lead, parts)


def _lead(whole: xr.Dataset, reference: str, units: Units) -> str:
    factor, parts = shown_per_m_s(units), []
    for quantity, scale, unit in (("speed", factor, f" {units}"), ("direction", 1.0, "°")):
        before, after = (
            scale * float(whole[f"innovation_{quantity}_rms"].sel(state=state))
            for state, *_ in _STATES
        )
        if np.isfinite(before) and np.isfinite(after):
            parts.append(f"{quantity} from {before:.1f} to {after:.1f}{unit}")
    if not parts:
        return ""
    return (
        f"Rms innovation against {reference}, before and after the correction: {', '.join(parts)}."
    )
