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
import pandas as pd
import xarray as xr
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from airswing.gap.result.schema import CurveEntry, GapReport, PlaceEntry, SliceEntry
from airswing.report import html
from airswing.report.gap import words
from airswing.report.gap.words import number, p_text, plain_name
from airswing.report.html import BLUE, FAINT, INK, ORANGE, SKY, SOFT, Look, Units, plural
from airswing.report.html.maps import draw_map, view_of
from airswing.report.run.heading_error import draw_heading_error, small_panels
from airswing.report.run.selection import names_of
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Cycles of the deviation of each compass effect.
_CYCLES = {"compass_offset": 0, "hard_iron": 1, "soft_iron": 2}
_CATEGORIES = {"phase": ("ascent", "cruise", "descent"), "icing": ("off", "on")}


def gap_figures(
    gap: GapReport, maps: xr.Dataset, *, units: Units = "kt"
) -> dict[str, Callable[[], Figure]]:
    """Return functions that draw the figures of a diagnosis that have data, by name."""
    effects, places = gap.effects, gap.unknown.where
    compass = "heading_map" in maps and _CYCLES.keys() & {one.name for one in effects}
    entries: list[tuple[Any, ...]] = [
        ("compass_effects", compass, _compass_effects_figure, maps, gap),
        *(
            (f"unknown_{place}", True, _unknown_curve_figure, entry, units)
            for place, entry in enumerate(places, 1)
        ),
        ("waterfall", effects or places, _waterfall_figure, gap, units),
        ("slices", True, _slices_figure, gap.where),
        ("aircraft_heading", "heading_map" in maps, _aircraft_figure, maps, gap, "heading_map"),
        ("phase_level", "level_map_cross" in maps, _phase_level_figure, maps, gap, units),
        ("map", "region_map_u" in maps, _gap_map_figure, maps, gap, units),
        ("aircraft_time", "time_line" in maps, _aircraft_figure, maps, gap, "time_line"),
        ("pit", "pit_count" in maps, _pit_figure, maps),
        ("evidence", gap.evidence, _evidence_figure, gap),
    ]
    return {name: partial(function, *given) for name, there, function, *given in entries if there}


def _reports(gap: GapReport) -> str:
    return f"n = {plural(gap.counts.reports, 'report')}"


def _waterfall_figure(gap: GapReport, units: Units) -> Figure:
    factor = html.per_kt(units)
    steps = [
        (step.label, step.kt, [before.kt - end for end in step.step_ci])
        for before, step in pairwise(gap.waterfall)
        if step.step_ci is not None
    ]
    levels = gap.closure.before, gap.closure.after, gap.gap.noise_floor_kt
    before, end, floor = (factor * value for value in levels)
    bars = [("simulation so far", before, SOFT)]
    bars += [(f"+ {plain_name(name)}", factor * step, "") for name, step, _ in steps]
    bars.append(("with all effects", end, html.GREEN))
    if np.isfinite(floor):
        bars.append(("noise floor", floor, FAINT))
    figure, axes = html.panels(1.5 + 0.42 * (len(steps) + 3))
    look = Look(va="center", fontsize=9)
    look["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    previous = before
    for row, (_, level, colour) in enumerate(bars):
        if colour:
            axes.barh(row, level, color=colour, height=0.62)
            place = (level, row)
            html.annotate(axes, f"{level:.2f} {units}", place, (5, 0), ha="left", **look)
            continue
        ends = [factor * bound for bound in steps[row - 1][2]]
        colour = BLUE if level <= previous else ORANGE
        axes.barh(row, level - previous, left=previous, color=colour, height=0.62)
        axes.plot([previous, previous], [row - 1.31, row + 0.31], color=SOFT, linewidth=0.8)
        axes.plot(ends, [row, row], color=INK, linewidth=1.2, zorder=4)
        place = (min([level, previous, *ends]), row)
        html.annotate(axes, f"{level - previous:+.2f}", place, (-5, 0), ha="right", **look)
        previous = level
    label = f"mean vector disagreement on held-out flights ({units})"
    html.rows_axis(axes, [name for name, *_ in bars], label)
    axes.set_xlim(0, 1.14 * max(before, end))
    return figure.say(
        f"Disagreement of reports and simulation ({_reports(gap)}), the step of each effect added "
        "in turn (black: 95 % interval), and the noise floor that no effect can pass."
    )


def _deviation_of(gap: GapReport, tail: str) -> tuple[Floats, Floats]:
    """Return coefficients A to E of the compass effects found on an aircraft, and their errors."""
    value, error = np.zeros(5), np.zeros(5)
    for effect in gap.effects:
        cycles = _CYCLES.get(effect.name)
        if cycles is None or (effect.tails and tail not in effect.tails):
            continue
        entry = (effect.per_tail or {}).get(tail) or effect
        parameters, errors = dict[str, Any](entry.parameters), entry.standard_errors or {}
        name, places, shape = "offset_deg", slice(0, 1), np.ones(1)
        if cycles:
            name, places = "amplitude_deg", slice(2 * cycles - 1, 2 * cycles + 1)
            phase = np.radians(parameters["phase_deg"])
            shape = np.array([np.cos(phase), np.sin(phase)])
        value[places] += number(parameters.get(name)) * shape
        error[places] = np.hypot(error[places], np.nan_to_num(number(errors.get(name))))
    return value, error


def _compass_effects_figure(maps: xr.Dataset, gap: GapReport) -> Figure:
    found = {tail: _deviation_of(gap, tail) for tail in names_of(maps)}
    tails = [tail for tail, (value, _) in found.items() if np.any(value)][:12]
    if not tails:
        return html.empty_figure("No constant compass effect was found")
    figure, panels = small_panels(len(tails))
    shown = maps.sel(aircraft=tails)
    value, error = (shown[f"heading_map{end}"].to_numpy() for end in ("", "_standard_error"))
    error = np.nan_to_num(error)
    limit = max(3.0, 1.1 * float(np.nanmax(np.abs(value) + error)))
    for place, (axes, tail) in enumerate(zip(panels, tails, strict=True)):
        coefficients, errors = found[tail]
        fit = xr.Dataset(
            {
                "deviation": ("coefficient", coefficients),
                "deviation_covariance": (("coefficient", "coefficient_2"), np.diag(errors**2)),
                "table_heading": ("node", np.zeros(8)),
                "table_correction": ("node", np.full(8, np.nan)),
                "status": 0,
            }
        )
        bins = np.array([maps["octant"].to_numpy(), value[place], NORMAL_95 * error[place]])
        bins, none = bins[:, np.isfinite(value[place])], np.empty(0)
        draw_heading_error(axes, none, none, fit, limit=limit, small=True, bins=bins)
        axes.set_title(tail, fontsize=9)
    return figure.say(
        "Heading error (degree) that the simulation leaves against magnetic heading (degree), and "
        "the sum of the compass effects found, with 95 % intervals (n = "
        f"{plural(len(tails), 'aircraft')})."
    )


def _unknown_curve_figure(place: PlaceEntry, units: Units) -> Figure:
    curve = place.curve
    edges = [np.asarray(bounds, float) for bounds in curve.edges or []]
    variables, unit, factor = curve.variables or place.variables, curve.unit or "m/s", 1.0
    if unit == "m/s":
        unit, factor = units, html.per_m_s(units)
    values = curve.values if curve.values is not None else curve.m_s
    value = factor * np.array(values, float)
    colours = [BLUE if one >= 0 else ORANGE for one in np.nan_to_num(value)]
    figure, axes = html.panels(2.9)
    what = f"fitted residual ({unit})"
    if place.component == "reported_speed" and edges:
        simulated = factor * edges[0]
        axes.plot(simulated, simulated, color=INK, linewidth=0.8, linestyle="--")
        axes.plot(simulated, value, color=BLUE)
        axes.set(xlabel=f"simulated wind speed ({units})", ylabel=f"reported wind speed ({units})")
    elif len(edges) == 1 and edges[0].size == value.size + 1:
        axes.bar(edges[0][:-1], value, np.diff(edges[0]), align="edge", color=colours)
        html.zero_line(axes, across=True)
        axes.set_ylabel(what)
        _label_variable(axes.xaxis, curve, variables, edges, 0)
    elif len(edges) == 2:
        shown = value.reshape(edges[0].size - 1, edges[1].size - 1)
        most = max(float(np.nanmax(np.abs(shown))), 1e-9)
        mesh = axes.pcolormesh(*edges, shown.T, cmap=html.DIVERGING, vmin=-most, vmax=most)
        for index, axis in enumerate((axes.xaxis, axes.yaxis)):
            _label_variable(axis, curve, variables, edges, index)
        figure.colorbar(mesh, ax=axes, label=what)
    else:
        names = curve.labels
        axes.bar(names, value, color=colours)
        html.zero_line(axes, across=True)
        axes.margins(x=max(0.05, 0.5 - 0.1 * value.size))
        axes.tick_params(axis="x", labelrotation=45 if len(names) > 8 else 0, labelsize=8.5)
        axes.set_ylabel(what)
    sentence = words.place_sentence(place, 0, units=units).rstrip(".")
    return figure.say(f"{sentence} (n = {plural(int(value.size), 'value')}).")


def _label_variable(
    axis: Axis, curve: CurveEntry, variables: Sequence[str], every: Sequence[Floats], index: int
) -> None:
    """Name a variable with its unit; label categories by name, and full circles at the quarters."""
    name, edges, known = variables[index], every[index], curve.variable_units or []
    unit = known[index].replace("m/s2", "m/s²") if index < len(known) else ""
    plain, names = name.replace("_", " "), _CATEGORIES.get(name, ())
    axis.set_label_text(f"{plain} ({unit})" if unit and not names else plain)
    if names and edges.size == len(names) + 1:
        axis.set_ticks(0.5 * (edges[1:] + edges[:-1]), names)
    elif edges[0] == 0.0 and edges[-1] == 360.0:
        axis.set_ticks(np.arange(0.0, 361.0, 90.0))


def _slices_figure(where: Sequence[SliceEntry]) -> Figure:
    rows = sorted(where, key=lambda entry: -entry.share_of_gap)[:15]
    rows = [entry for entry in rows if entry.share_of_gap >= 0.005] or rows[:3]
    if not rows:
        return html.empty_figure("No slice has a larger share of the gap than noise")
    figure, axes = html.panels(1.0 + 0.3 * len(rows))
    share = 100 * np.array([entry.share_of_gap for entry in rows])
    q_values = [entry.q_value for entry in rows]
    colours = [BLUE if value < 0.05 else FAINT for value in q_values]
    names, label = [words.slice_words(entry) for entry in rows], "share of the gap's variance (%)"
    texts = [f"{x:.0f} %   q {p_text(q)}" for x, q in zip(share, q_values, strict=True)]
    html.bars(axes, names, share, texts, label, color=colours)
    axes.axvline(0.0, color=SOFT, linewidth=0.8)
    axes.set_xlim(right=max(float(share.max()) * 1.4, 5.0))
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= 100.0])
    return figure.say(
        f"Cross-validated shares of the gap (n = {plural(len(rows), 'slice')}). Blue: q value "
        "below 5 %. Slices overlap, so shares need not add to 100 %."
    )


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
    affected = {one for effect in gap.effects for one in effect.tails}
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


def _phase_level_figure(maps: xr.Dataset, gap: GapReport, units: Units) -> Figure:
    level, bounds = maps["level"].to_numpy(), [0.0]
    for middle in level:  # the first layer begins at zero pressure
        bounds.append(2.0 * float(middle) - bounds[-1])
    names = [
        f"{top:.0f}-{bottom:.0f}" if top else f"above {bottom:.0f}"
        for top, bottom in pairwise(bounds)
    ]
    ways = {"along": "along the heading", "cross": "across the heading"}
    both = np.array([_cells(maps, f"level_map_{way}", "level", "phase") for way in ways])
    filled = np.flatnonzero(np.isfinite(both[1]).any(axis=0))
    both = html.per_m_s(units) * both[:, ::-1, filled]
    limit = _even_limit(both, least=0.2)
    figure, panels = html.panels(1.4 + 0.36 * level.size, 1, 2, sharey=True)
    look = Look(cmap=html.DIVERGING, vmin=-limit, vmax=limit, origin="lower", aspect="auto")
    phases = [names_of(maps, "phase")[place] for place in filled]
    for axes, title, value in zip(panels, ways.values(), both, strict=True):
        drawn = axes.imshow(value, **look)
        axes.set_title(title)
        axes.set_xticks(range(filled.size), phases)
        axes.set_yticks(range(level.size), names[::-1])
        axes.grid(visible=False)
        html.cell_texts(axes, value, "{:+z.2f}".format, 0.62 * limit)
    panels[0].set_ylabel("layer (hPa)")
    figure.colorbar(drawn, ax=list(panels), label=f"mean residual ({units})", pad=0.01)
    return figure.say(
        f"Mean residual ({units}) by phase and layer ({_reports(gap)}; white: too few flights)."
    )


def _gap_map_figure(maps: xr.Dataset, gap: GapReport, units: Units) -> Figure:
    lon, lat = (np.asarray(maps[name].to_numpy(), float) for name in ("longitude", "latitude"))
    cells = (_cells(maps, f"region_map_{way}", "latitude", "longitude") for way in "uv")
    u, v = (html.per_m_s(units) * part for part in cells)
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
    axes.quiverkey(arrows, 0.9, 1.025, round(length, 1), f"{length:.1f} {units}", labelpos="E")
    label = f"length of the mean residual ({units})"
    figure.colorbar(drawn, ax=axes, label=label, shrink=0.85, pad=0.01)
    return figure.say(
        "Mean residual wind (reported minus simulated) by place: its length by colour, its "
        f"direction by arrows ({_reports(gap)}; white: too few flights)."
    )


def _evidence_figure(gap: GapReport) -> Figure:
    rows = pd.DataFrame(gap.evidence)
    best = rows[rows["known"]].groupby("name", sort=False)["tempered_nats"].max()
    best = best.dropna().sort_values(ascending=False, kind="stable")[:20]
    if best.empty:
        return html.empty_figure("No effect of the catalogue could be tested")
    chosen = {effect.name for effect in gap.effects}
    ambiguous = {name for effect in gap.effects for name in effect.ambiguous_with}
    figure, axes = html.panels(1.0 + 0.27 * len(best))
    colours = [
        BLUE if name in chosen else SKY if name in ambiguous else FAINT for name in best.index
    ]
    positive, names = best.clip(lower=0.0), [plain_name(name) for name in best.index]
    label = "log Bayes factor against no effect (linear to 10, then logarithmic)"
    texts = [f"{round(value):,}" for value in best]
    html.bars(axes, names, positive, texts, label, color=colours, height=0.72)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(LogFormatter(linthresh=10.0))
    axes.set_xlim(0, max(float(positive.max()) * 2.5, 25.0))
    return figure.say(
        f"Log Bayes factor of each catalogue effect ({_reports(gap)}). Dark blue: found; light "
        "blue: ambiguous with one found; grey: neither. Effects with similar columns share "
        "evidence, so a long grey bar is no finding."
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
