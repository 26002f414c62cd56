"""Innovation statistics (observation minus reference): figures and a section of the page.

Takes ``innovation_statistics.nc`` (:mod:`airswing.evaluation.innovations`).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from airswing.evaluation.innovations import combined
from airswing.report import html
from airswing.report.html import STATES, Look, plural
from airswing.report.run.selection import names_of
from airswing.units import KNOT

_QUANTITIES = ("speed", "direction", "eastward", "northward")
_CELLS = ("aircraft", "flight_phase", "layer")
_MOST_AIRCRAFT = 20  # in the figure


def _unit(quantity: str) -> tuple[str, float]:
    return ("degree", 1.0) if quantity == "direction" else ("kt", 1.0 / KNOT)


def _cells_by(statistics: xr.Dataset, by: str) -> xr.Dataset:
    """Return the rows (state, row) with reports by aircraft, phase of flight or layer."""
    cells = combined(statistics, [dim for dim in _CELLS if dim != by])
    if by == "layer":
        edges = [statistics[f"layer_{end}_pressure"].to_numpy() / 100 for end in ("bottom", "top")]
        cells["layer"] = [f"{low:.0f}-{high:.0f} hPa" for low, high in zip(*edges, strict=True)]
    keep = np.flatnonzero(cells["innovation_speed_count"].isel(state=0))
    return cells.isel({by: keep}).rename({by: "row"})


def _innovation_figure(statistics: xr.Dataset) -> Figure:
    aircraft, phases, layers = (_cells_by(statistics, by) for by in _CELLS)
    reports = aircraft["innovation_speed_count"].isel(state=0).to_numpy()
    order = np.argsort(-reports, kind="stable")[:_MOST_AIRCRAFT]
    cells = [aircraft.isel(row=order), phases, layers]
    rows = [name for block in cells for name in names_of(block, "row")]
    figure, panels = html.panels(1.1 + 0.2 * len(rows), 1, len(_QUANTITIES), sharey=True)
    for axes, quantity in zip(panels, _QUANTITIES, strict=True):
        unit, factor = _unit(quantity)
        for index, (state, colour, marker) in enumerate(STATES):
            bias, spread = (
                factor
                * np.concatenate([block[f"innovation_{quantity}_{kind}"][index] for block in cells])
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
    look = Look(
        cmap=html.DENSITY, norm=LogNorm(1, max(int(counts.max()), 2)), origin="lower", zorder=1
    )
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


def innovations_section(
    statistics: xr.Dataset | None, reference: str, show: html.Figures
) -> html.Section | None:
    """Return the section on the innovations against a reference, or the first if not known."""
    title = "Innovations (observation minus reference)"
    if statistics is None:
        return None
    if not statistics["innovation_speed_count"].any():
        lead = "No report has a phase, a layer and a reference wind."
        return html.Section("innovations", title, lead)
    references = names_of(statistics, "reference")
    reference = reference if reference in references else references[0]
    statistics = statistics.sel(reference=reference)
    changes, fleet = [], combined(statistics, _CELLS)
    for quantity, sign in (("speed", " kt"), ("direction", "°")):
        rms = _unit(quantity)[1] * fleet[f"innovation_{quantity}_rms"]
        before, after = (float(rms.sel(state=state)) for state, *_ in STATES)
        if np.isfinite(before + after):
            changes.append(f"{quantity} from {before:.1f} to {after:.1f}{sign}")
    lead = ""
    if changes:
        lead = f"Rms innovation against {reference}, before and after the correction: "
        lead += f"{', '.join(changes)}."
    histogram = show("innovation_histogram", _innovation_histogram_figure(statistics))
    parts = [
        show("innovations", _innovation_figure(statistics), dpi=120),
        html.folded("Histogram", histogram),
    ]
    return html.Section("innovations", title, lead, parts)
