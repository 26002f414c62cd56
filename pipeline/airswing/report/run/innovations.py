"""Innovation statistics (observation minus reference): figures and a section of the page.

Takes ``innovation_statistics.nc`` (:mod:`airswing.evaluation.innovations`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from airswing.evaluation.innovations import combined
from airswing.report import html
from airswing.report.html import STATES, Look, plural
from airswing.report.run.changes import date_axis, days_since_1970
from airswing.report.run.selection import Run, names_of
from airswing.units import KNOT

_QUANTITIES = ("speed", "direction", "eastward", "northward")
_CELLS = ("aircraft", "flight_phase", "layer")
# Aircraft in the figures.
_MOST_SERIES, _MOST_AIRCRAFT = 7, 20


def _unit(quantity: str) -> tuple[str, float]:
    """Return the unit of a quantity as shown, and the factor to it."""
    return ("degree", 1.0) if quantity == "direction" else ("kt", 1.0 / KNOT)


def _cells_by(statistics: xr.Dataset, by: str) -> xr.Dataset:
    """Return the rows (state, row) with reports by aircraft, phase of flight or layer."""
    found = combined(statistics, [dim for dim in _CELLS if dim != by])
    if by == "layer":
        edges = [statistics[f"layer_{end}_pressure"].to_numpy() / 100 for end in ("bottom", "top")]
        found["layer"] = [f"{low:.0f}-{high:.0f} hPa" for low, high in zip(*edges, strict=True)]
    keep = np.flatnonzero(found["innovation_speed_count"].isel(state=0))
    return found.isel({by: keep}).rename({by: "row"})


def _innovation_figure(statistics: xr.Dataset) -> Figure:
    aircraft, *others = (_cells_by(statistics, by) for by in _CELLS)
    reports = aircraft["innovation_speed_count"].isel(state=0).to_numpy()
    order = np.argsort(-reports, kind="stable")[:_MOST_AIRCRAFT]
    cells = [aircraft.isel(row=order), *others]
    rows = [name for part in cells for name in names_of(part, "row")]
    figure, panels = html.panels(1.1 + 0.2 * len(rows), 1, len(_QUANTITIES), sharey=True)
    for axes, quantity in zip(panels, _QUANTITIES, strict=True):
        unit, factor = _unit(quantity)
        for index, (state, colour, marker) in enumerate(STATES):
            bias, spread = (
                factor
                * np.concatenate([part[f"innovation_{quantity}_{kind}"][index] for part in cells])
                for kind in ("bias", "standard_deviation")
            )
            y, ends = np.arange(len(rows)) + 0.3 * (index - 0.5), (bias - spread, bias + spread)
            look = Look(color=colour, marker=marker, markersize=4.5, label=state)
            html.intervals(axes, bias, ends, y, **look)
        html.zero_line(axes)
        axes.set_xlabel(f"{quantity} ({unit})")
    html.rows_axis(panels[0], rows, panels[0].get_xlabel())
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure.say(
        f"Observation minus {statistics['reference'].item()} (n = "
        f"{plural(reports.sum(), 'report')}): bias and one standard deviation to either side. "
        "Direction is positive where veered."
    )


def _innovation_histogram_figure(statistics: xr.Dataset) -> Figure:
    counts, reference = statistics["innovation_histogram"], statistics["reference"].item()
    number = int(counts.sel(state="reported").sum())
    lower = statistics["eastward_class"].to_numpy().astype(float)
    ends = np.array([lower[0], 2 * lower[-1] - lower[-2]]) / KNOT
    figure, panels = html.panels(4.6, 1, 2, sharex=True, sharey=True)
    look = Look(cmap=html.DENSITY, norm=LogNorm(1, max(int(counts.max()), 2)), origin="lower")
    for axes, (state, *_) in zip(panels, STATES, strict=True):
        grid = counts.sel(state=state).transpose("northward_class", "eastward_class")
        drawn = axes.imshow(
            grid.where(grid > 0), extent=(*ends, *ends), interpolation="nearest", **look
        )
        html.zero_line(axes)
        html.zero_line(axes, across=True)
        axes.set(title=state, xlabel="eastward innovation (kt)")
    panels[0].set_ylabel("northward innovation (kt)")
    bar = figure.colorbar(drawn, ax=list(panels), label="reports in a class", shrink=0.8)
    html.count_ticks(bar, float(counts.max()))
    return figure.say(
        f"Wind vector innovation (observation minus {reference}) in classes of 1 m/s; the "
        f"outermost include all beyond (n = {plural(number, 'report')})."
    )


def _innovation_series_figure(statistics: xr.Dataset, names: Sequence[str]) -> Figure:
    chosen, reference = statistics.sel(aircraft=list(names)), statistics["reference"].item()
    day = days_since_1970(statistics["day"].to_numpy())
    number = int(chosen["daily_innovation_count"].sel(state="reported").sum())
    figure, grid = html.panels(4.6, 2, 2, sharex=True, sharey="row")
    for panels, quantity in zip(grid, ("speed", "direction"), strict=True):
        unit, factor = _unit(quantity)
        for axes, (state, *_) in zip(panels, STATES, strict=True):
            for index, name in enumerate(names):
                value = chosen[f"daily_innovation_{quantity}"].sel(aircraft=name, state=state)
                look = html.series(index, markersize=3, linewidth=1.0, label=name)
                axes.plot(day, factor * value.to_numpy(), **look)
            html.zero_line(axes, across=True)
            axes.set_title(f"{quantity}, {state}")
        panels[0].set_ylabel(f"innovation ({unit})")
    date_axis(grid[-1, 0])
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7)
    return figure.say(
        f"Daily mean of observation minus {reference} (n = {plural(number, 'report')} of "
        f"{len(names)} aircraft)."
    )


def innovations_section(
    statistics: xr.Dataset | None, run: Run, show: html.Figures
) -> html.Section:
    """Return the section on the innovations."""
    parts, lead = [], ""
    if statistics is not None and not statistics["innovation_speed_count"].any():
        lead = "No report has a phase, a layer and a reference wind."
    elif statistics is not None:
        known = names_of(statistics, "reference")
        chosen = run.reference if run.reference in known else known[0]
        statistics = statistics.sel(reference=chosen)
        changes, whole = [], combined(statistics, _CELLS)
        for quantity, sign in (("speed", " kt"), ("direction", "°")):
            rms = _unit(quantity)[1] * whole[f"innovation_{quantity}_rms"]
            before, after = (float(rms.sel(state=state)) for state, *_ in STATES)
            if np.isfinite(before + after):
                changes.append(f"{quantity} from {before:.1f} to {after:.1f}{sign}")
        if changes:
            lead = f"Rms innovation against {chosen}, before and after the correction: "
            lead += f"{', '.join(changes)}."
        names = [name for name in run.order if name in names_of(statistics)][:_MOST_SERIES]
        parts.append(show("innovations", _innovation_figure(statistics), dpi=120))
        figure = _innovation_histogram_figure(statistics)
        parts.append(html.folded("Histogram", show("innovation_histogram", figure)))
        series = _innovation_series_figure(statistics, names)
        shown = show("innovation_series", series, dpi=120)
        parts.append(html.folded("Daily means by aircraft", shown))
    return html.Section("innovations", "Innovations (observation minus reference)", lead, parts)
