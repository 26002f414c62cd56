"""Figures of a gap diagnosis: closure, effects, location and statistics of the gap.

Each takes the content of ``gap.json`` (or a part of it) or ``gap.nc`` with its maps: means of the
residual (reported minus simulated) in cells, NaN (white) with fewer than two flights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import CATEGORIES
from airswing.gap.result.schema import CurveEntry, GapReport, PlaceEntry
from airswing.report import html
from airswing.report.gap.words import plain_name
from airswing.report.html import BLUE, FAINT, INK, ORANGE, SKY, SOFT, Look, plural
from airswing.report.html.maps import draw_map, view_of
from airswing.report.run.selection import names_of
from airswing.units import KNOT

Floats = NDArray[np.float64]


def gap_figures(gap: GapReport, maps: xr.Dataset) -> dict[str, Callable[[], Figure]]:
    """Return functions that draw the figures of a diagnosis that have data, by name."""
    effects, places = gap.effects, gap.unknown.where
    entries: list[tuple[Any, ...]] = [
        *(
            (f"unknown_{place}", True, _unknown_curve_figure, entry)
            for place, entry in enumerate(places, 1)
        ),
        ("waterfall", effects or places, _waterfall_figure, gap),
        ("aircraft_heading", "heading_map" in maps, _aircraft_figure, maps, gap, "heading_map"),
        ("phase_level", "level_map_cross" in maps, _phase_level_figure, maps, gap),
        ("map", "region_map_u" in maps, _gap_map_figure, maps, gap),
        ("aircraft_time", "time_line" in maps, _aircraft_figure, maps, gap, "time_line"),
        ("pit", "pit_count" in maps, _pit_figure, maps),
    ]
    return {name: partial(function, *args) for name, shown, function, *args in entries if shown}


def _reports(gap: GapReport) -> str:
    return f"n = {plural(gap.counts.reports, 'report')}"


def _waterfall_figure(gap: GapReport) -> Figure:
    steps = [
        (step.label, step.kt, [before.kt - end for end in step.step_ci])
        for before, step in pairwise(gap.waterfall)
        if step.step_ci is not None
    ]
    before, end, floor = gap.closure.before, gap.closure.after, gap.gap.noise_floor_kt
    bars = [("simulation so far", before, SOFT)]
    bars += [(f"+ {plain_name(name)}", step, "") for name, step, _ in steps]
    bars += [("with all effects", end, html.GREEN), ("noise floor", floor, FAINT)]
    figure, axes = html.panels(1.5 + 0.42 * (len(steps) + 3))
    look = Look(va="center", fontsize=9, textcoords="offset points")
    look["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    previous = before
    for row, (_, level, colour) in enumerate(bars):
        if colour:
            axes.barh(row, level, color=colour, height=0.62)
            axes.annotate(f"{level:.2f} kt", (level, row), xytext=(5, 0), ha="left", **look)
            continue
        ends = steps[row - 1][2]
        colour = BLUE if level <= previous else ORANGE
        axes.barh(row, level - previous, left=previous, color=colour, height=0.62)
        axes.plot([previous, previous], [row - 1.31, row + 0.31], color=SOFT, linewidth=0.8)
        axes.plot(ends, [row, row], color=INK, linewidth=1.2, zorder=4)
        place = (min([level, previous, *ends]), row)
        axes.annotate(f"{level - previous:+.2f}", place, xytext=(-5, 0), ha="right", **look)
        previous = level
    label = "mean vector disagreement on held-out days (kt)"
    html.rows_axis(axes, [name for name, *_ in bars], label)
    axes.set_xlim(0, 1.14 * max(before, end))
    return figure.say(
        f"Disagreement of reports and simulation ({_reports(gap)}), the step of each effect added "
        "in turn (black: 95 % interval), and the noise floor that no effect can pass."
    )


def _unknown_curve_figure(place: PlaceEntry) -> Figure:
    curve = place.curve
    edges = [np.asarray(bounds, float) for bounds in curve.edges or []]
    variables, unit, factor = curve.variables or place.variables, curve.unit or "m/s", 1.0
    if unit == "m/s":
        unit, factor = "kt", 1.0 / KNOT
    values = curve.values if curve.values is not None else curve.m_s
    value = factor * np.array(values, float)
    colours = [BLUE if level >= 0 else ORANGE for level in np.nan_to_num(value)]
    figure, axes = html.panels(2.9)
    label = "root mean square" if place.component == "scatter" or not edges else "fitted residual"
    if place.component.startswith("reported_"):
        label = "reports above expected" if unit == "percent" else "mean reduction"
    label = f"{label} ({unit})"
    if place.component == "reported_speed" and edges:
        simulated = factor * edges[0]
        axes.plot(simulated, simulated, color=INK, linewidth=0.8, linestyle="--")
        axes.plot(simulated, value, color=BLUE)
        axes.set(xlabel="simulated wind speed (kt)", ylabel="reported wind speed (kt)")
    elif len(edges) == 1 and edges[0].size == value.size + 1:
        axes.bar(edges[0][:-1], value, np.diff(edges[0]), align="edge", color=colours)
        html.zero_line(axes, across=True)
        axes.set_ylabel(label)
        _label_variable(axes.xaxis, curve, variables, edges, 0)
    elif len(edges) == 2:
        shown = value.reshape(edges[0].size - 1, edges[1].size - 1)
        most = max(float(np.nanmax(np.abs(shown))), 1e-9)
        mesh = axes.pcolormesh(*edges, shown.T, cmap=html.DIVERGING, vmin=-most, vmax=most)
        for index, axis in enumerate((axes.xaxis, axes.yaxis)):
            _label_variable(axis, curve, variables, edges, index)
        figure.colorbar(mesh, ax=axes, label=label)
    else:
        names = curve.labels
        axes.bar(names, value, color=colours)
        html.zero_line(axes, across=True)
        axes.margins(x=max(0.05, 0.5 - 0.1 * value.size))
        axes.tick_params(axis="x", labelrotation=45 if len(names) > 8 else 0, labelsize=8.5)
        axes.set_ylabel(label)
        if unit == "percent":
            axes.set_xlabel("wind direction (degree)")
    return figure.say(f"Fit of the unexplained error (n = {plural(int(value.size), 'value')}).")


def _label_variable(
    axis: Axis, curve: CurveEntry, variables: Sequence[str], every: Sequence[Floats], index: int
) -> None:
    """Name a variable with its unit; label categories by name, and full circles at the quarters."""
    name, edges, units = variables[index], every[index], curve.variable_units or []
    unit = units[index].replace("m/s2", "m/s²") if index < len(units) else ""
    label, names = name.replace("_", " "), CATEGORIES.get(name, ())
    axis.set_label_text(f"{label} ({unit})" if unit and not names else label)
    if names and edges.size == len(names) + 1:
        axis.set_ticks(0.5 * (edges[1:] + edges[:-1]), names)
    elif edges[0] == 0.0 and edges[-1] == 360.0:
        axis.set_ticks(np.arange(0.0, 361.0, 90.0))


def _cells(maps: xr.Dataset, name: str, *dims: str) -> Floats:
    return np.asarray(maps[name].transpose(*dims).to_numpy(), float)


def _even_limit(values: Floats, *, least: float = 0.5) -> float:
    """Return half the width of a diverging colour scale that holds 98 % of the cells."""
    finite = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(finite, 98)), least) if finite.size else least


def _edges(centres: Floats) -> Floats:
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middle[0], *middle, 2 * centres[-1] - middle[-1]])


def _aircraft_figure(maps: xr.Dataset, gap: GapReport, name: str) -> Figure:
    tails, dim = names_of(maps), "octant" if name == "heading_map" else "week"
    shown, centres = _cells(maps, name, "aircraft", dim), maps[dim].to_numpy().astype(float)
    limit = _even_limit(shown)
    affected = {tail for effect in gap.effects for tail in effect.tails}
    figure, axes = html.panels(1.25 + max(0.19 * len(tails), 1.4))
    look = Look(cmap=html.DIVERGING, vmin=-limit, vmax=limit)
    x = centres if dim == "octant" else np.arange(centres.size, dtype=float)
    drawn = axes.pcolormesh(_edges(x), np.arange(len(tails) + 1) - 0.5, shown, **look)
    html.rows_axis(axes, tails)
    axes.set_ylim(len(tails) - 0.5, -0.5)
    for label in axes.get_yticklabels():
        if label.get_text() in affected:
            label.set(fontweight="bold", color=html.VERMILION)
    axes.grid(visible=False)
    figure.colorbar(drawn, ax=axes, label="mean heading error (degree)", pad=0.01, extend="both")
    if dim == "week":
        weeks = maps["day"].to_numpy().min() + centres.astype("timedelta64[W]")
        ticks = np.arange(0, weeks.size, max(1, -(-weeks.size // 10)))
        axes.set_xticks(ticks, np.datetime_as_string(weeks[ticks], "D"))
        axes.set_xlabel("week from (date)")
        return figure.say(
            f"Mean heading error (degree) by aircraft and week ({_reports(gap)}; white: too few "
            "flights). An error that begins at a date changes the colour of a row."
        )
    if len(tails) <= 60:
        error = _cells(maps, f"{name}_standard_error", "aircraft", dim)
        strong = np.where(np.abs(shown) > 2 * error, shown, np.nan)
        html.cell_texts(axes, strong, "{:+z.1f}".format, 0.62 * limit, x)
    axes.set(xticks=range(0, 361, 45), xlabel="indicated magnetic heading (degree)")
    first = min(float(_edges(x)[0]), 0.0)
    axes.set_xlim(first, 360.0 + first)
    return figure.say(
        f"Mean heading error (degree) by aircraft and magnetic heading ({_reports(gap)}; white: "
        "too few flights). An error of a compass gives a row with a wave or of one colour, an "
        "error of the reference gives stripes across the fleet. Bold: aircraft with effects."
    )


def _phase_level_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    level, bounds = maps["level"].to_numpy(), [0.0]
    for middle in level:  # the first layer begins at zero pressure
        bounds.append(2.0 * float(middle) - bounds[-1])
    names = [
        f"{top:.0f}-{bottom:.0f}" if top else f"above {bottom:.0f}"
        for top, bottom in pairwise(bounds)
    ]
    ways = {"along": "along the heading", "cross": "across the heading"}
    residual = np.array([_cells(maps, f"level_map_{way}", "level", "phase") for way in ways])
    filled = np.flatnonzero(np.isfinite(residual[1]).any(axis=0))
    if not filled.size:
        return html.empty_figure("No phase and layer has enough flights for a mean")
    residual = residual[:, ::-1, filled] / KNOT
    limit = _even_limit(residual, least=0.2)
    figure, panels = html.panels(1.4 + 0.36 * level.size, 1, 2, sharey=True)
    look = Look(cmap=html.DIVERGING, vmin=-limit, vmax=limit, origin="lower", aspect="auto")
    phases = [names_of(maps, "phase")[place] for place in filled]
    for axes, title, value in zip(panels, ways.values(), residual, strict=True):
        drawn = axes.imshow(value, **look)
        axes.set_title(title)
        axes.set_xticks(range(filled.size), phases)
        axes.set_yticks(range(level.size), names[::-1])
        axes.grid(visible=False)
        html.cell_texts(axes, value, "{:+z.2f}".format, 0.62 * limit)
    panels[0].set_ylabel("layer (hPa)")
    figure.colorbar(drawn, ax=list(panels), label="mean residual (kt)", pad=0.01)
    return figure.say(
        f"Mean residual (kt) by phase and layer ({_reports(gap)}; white: too few flights)."
    )


def _gap_map_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    lon, lat = (np.asarray(maps[name].to_numpy(), float) for name in ("longitude", "latitude"))
    cells = (_cells(maps, f"region_map_{way}", "latitude", "longitude") for way in "uv")
    u, v = (component / KNOT for component in cells)
    speed = np.hypot(u, v)
    filled = np.isfinite(speed)
    if not filled.any():
        return html.empty_figure("No cell has enough reports for a map")
    rows, columns = np.nonzero(filled)
    view = view_of(lon[columns], lat[rows], margin=0.1)
    figure, axes = html.panels(min(8.2 * view.height_over_width, 6.5) + 0.7)
    length, x = _even_limit(speed), view.unwrapped(lon)
    order = np.argsort(x)
    look = Look(cmap="YlOrBr", vmin=0, vmax=length, alpha=0.85)
    drawn = axes.pcolormesh(_edges(x[order]), _edges(lat), speed[:, order], **look)
    look = Look(color=INK, width=0.0022, pivot="mid", zorder=3, scale=length * 22)
    arrows = axes.quiver(x[columns], lat[rows], u[filled], v[filled], **look)
    draw_map(axes, view)
    axes.quiverkey(arrows, 0.9, 1.025, round(length, 1), f"{length:.1f} kt", labelpos="E")
    label = "length of the mean residual (kt)"
    figure.colorbar(drawn, ax=axes, label=label, shrink=0.85, pad=0.01)
    return figure.say(
        "Mean residual wind (reported minus simulated) by place: its length by colour, its "
        f"direction by arrows ({_reports(gap)}; white: too few flights)."
    )


def _pit_figure(maps: xr.Dataset) -> Figure:
    after, before = (maps[name].to_numpy() for name in ("pit_count", "pit_count_before"))
    edges = np.linspace(0.0, 1.0, after.size + 1)
    figure, axes = html.panels(3.0)
    share, early = (count / max(count.sum(), 1) * count.size for count in (after, before))
    axes.stairs(share, edges, fill=True, color=SKY, label="with the effects")
    axes.stairs(early, edges, color=ORANGE, linewidth=1.8, label="without")
    axes.axhline(1.0, color=INK, linewidth=0.9, label="perfect")
    label = "predicted probability of a value below the one reported"
    axes.set(xlim=(0, 1), ylim=(0, None), xlabel=label, ylabel="reports over expected")
    figure.legend(loc="outside upper left", ncols=3)
    return figure.say(
        f"Calibration on held-out reports (n = {plural(after.sum(), 'wind component')}): flat if "
        "right; a hump means noise assumed too large, a trough too small, a slope a bias."
    )
