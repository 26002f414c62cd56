"""Which effect, and how far: evidence, aircraft, the waterfall, and the checks of the method.

Assumes the numbers of ``gap.json`` and plain arrays beside it: log evidence is natural,
probabilities lie in 0 to 1, disagreement is in knots on held-out flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import ArrayLike

from airswing.gap.result.schema import PlaceEntry
from airswing.report.gap.words import slice_words
from airswing.report.html.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    SKY,
    SOFT,
    VERMILION,
    empty_figure,
    new_figure,
    plural,
    styled,
)


@styled
def evidence_figure(
    names: Sequence[str],
    log_evidence: ArrayLike,
    *,
    chosen: Sequence[str] = (),
    ambiguous: Sequence[str] = (),
    threshold: float | None = None,
    number: int = 0,
) -> Figure:
    """Bars of the evidence for each candidate effect against none.

    Parameters
    ----------
    names : sequence of str (effect,)
    log_evidence : array (effect,)
        Natural log of the evidence ratio against no effect.
    chosen, ambiguous : sequence of str, optional
        Effects of the verdict, and those that could not be told from them.
    threshold : float, optional
        Log evidence an effect needs.
    number : int, optional
        Reports behind the evidence.
    """
    value = np.nan_to_num(np.asarray(log_evidence, float), nan=0.0)
    order = np.argsort(-value)
    figure = new_figure(1.0 + 0.27 * max(len(names), 1))
    axes = figure.add_subplot()
    colours = [
        BLUE if names[i] in chosen else SKY if names[i] in ambiguous else FAINT for i in order
    ]
    positive = np.clip(value[order], 0.0, None)
    y = np.arange(len(order))
    axes.barh(y, positive, color=colours, height=0.72)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(LogFormatter(linthresh=10.0))
    for row, index in enumerate(order):
        axes.annotate(
            f"{value[index]:,.0f}",
            (positive[row], row),
            xytext=(4, 0),
            va="center",
            textcoords="offset points",
            fontsize=8.5,
        )
    axes.set_yticks(y, [str(names[i]).replace("_", " ") for i in order])
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlim(0, max(float(positive.max(initial=10.0)) * 2.5, 20.0))
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("log evidence against no effect (linear to 10, then logarithmic)")
    if threshold is not None:
        axes.axvline(threshold, color=VERMILION, linewidth=1.2, linestyle=(0, (4, 2)))
        axes.annotate(
            "needed",
            (threshold, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8.5,
            color=VERMILION,
        )
    counted = f" (n = {plural(number, 'report')})" if number else f" (n = {len(names)} effects)"
    return figure.say(
        f"Best evidence for each effect of the catalogue, each of those found taken out in turn"
        f"{counted}. Dark blue: in the verdict; light blue: could not be told from it; grey: "
        "neither. One effect lends evidence to those that look like it, so a long grey bar alone "
        "is no finding."
    )


@styled
def posterior_figure(tails: Sequence[str], names: Sequence[str], probability: ArrayLike) -> Figure:
    """Heat map of the probability that each aircraft carries each effect.

    Parameters
    ----------
    tails : sequence of str (aircraft,)
    names : sequence of str (effect,)
    probability : array (effect, aircraft)
    """
    value = np.asarray(probability, float)
    if value.size == 0:
        return empty_figure("No effect of single aircraft was found")
    figure = new_figure(1.3 + 0.36 * len(names))
    axes = figure.add_subplot()
    drawn = axes.imshow(value, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    size = 8.5 if len(tails) <= 30 else 6.0
    axes.set_xticks(range(len(tails)), tails, rotation=90, fontsize=size)
    axes.set_yticks(range(len(names)), [str(name).replace("_", " ") for name in names])
    axes.grid(visible=False)
    if len(tails) <= 30:
        for (row, column), cell in np.ndenumerate(value):
            if np.isfinite(cell) and cell >= 0.05:
                axes.text(
                    column,
                    row,
                    f"{cell:.2f}".lstrip("0") if cell < 0.995 else "1",
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color="white" if cell > 0.55 else INK,
                )
    figure.colorbar(drawn, ax=axes, label="probability", pad=0.01)
    return figure.say(
        f"Probability that each aircraft carries the effect (n = "
        f"{plural(len(tails), 'aircraft', 'aircraft')})."
    )


@styled
def waterfall_figure(
    steps: Sequence[tuple[str, float, Sequence[float] | None]],
    *,
    before: float,
    floor: float,
    number: int = 0,
    after_all: tuple[float, Sequence[float] | None] | None = None,
) -> Figure:
    """Waterfall of the disagreement: the real gap, after each effect, the noise floor.

    Parameters
    ----------
    steps : sequence of (name, disagreement after it in kt, 95 % interval or None)
        In the order the effects were added.
    before : float
        Disagreement with no effect, kt.
    floor : float
        Noise floor, kt; NaN where none was estimated.
    number : int, optional
        Held-out reports.
    after_all : (disagreement in kt, 95 % interval or None), optional
        What is left in the end, where it differs from the last step.
    """
    names, levels = ["as simulated\nso far"], [before]
    intervals: list[Sequence[float] | None] = [None]
    for name, level, interval in steps:
        names.append("+ " + name.replace("_", " "))
        levels.append(level)
        intervals.append(interval)
    end, end_interval = after_all or (levels[-1], intervals[-1])
    figure = new_figure(1.5 + 0.42 * (len(names) + 2))
    axes = figure.add_subplot()
    axes.barh(0, before, color=SOFT, height=0.62)
    for row in range(1, len(names)):
        previous, level = levels[row - 1], levels[row]
        colour = BLUE if level <= previous else ORANGE
        axes.barh(row, level - previous, left=previous, color=colour, height=0.62)
        axes.plot([previous, previous], [row - 1.31, row + 0.31], color=SOFT, linewidth=0.8)
        interval = intervals[row]
        axes.annotate(
            f"{level - previous:+.2f}",
            (min([level, previous, *(interval or [])]), row),
            xytext=(-5, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
        )
        if interval is not None:
            axes.plot(interval, [row, row], color=INK, linewidth=1.2, zorder=4)
    last = len(names)
    axes.barh(last, end, color=GREEN, height=0.62)
    if end_interval:
        axes.plot(end_interval, [last, last], color=INK, linewidth=1.4, zorder=4)
    labels = [*names, "with all effects"]
    if np.isfinite(floor):
        axes.barh(last + 1, floor, color=FAINT, height=0.62)
        axes.axvline(floor, color=SOFT, linewidth=1.0, linestyle=(0, (4, 2)))
        labels.append("noise floor")
    right = max([before, *levels, *(end_interval or [])])
    _level(axes, 0, before, before)
    _level(axes, last, end, max([end, *(end_interval or [])]))
    _level(axes, last + 1, floor, floor)
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_xlim(0, right * 1.14)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("mean vector disagreement on held-out flights (kt)")
    counted = f" (n = {plural(number, 'held-out report')})" if number else ""
    return figure.say(
        f"How far the gap closes{counted}: disagreement of reports and simulation before, the "
        "step each effect makes when it is added in turn (black: 95 % interval), what is left, "
        "and the noise floor that no effect can pass."
    )


def _level(axes: Axes, row: int, value: float, edge: float) -> None:
    """Write a disagreement beside the end of its bar; nothing where it is not known."""
    if np.isfinite(value):
        axes.annotate(
            f"{value:.2f} kt",
            (edge, row),
            xytext=(5, 0),
            fontweight="bold",
            textcoords="offset points",
            va="center",
            fontsize=9,
        )


@styled
def autocorrelation_figure(
    distance: ArrayLike,
    measured: ArrayLike,
    half_width: ArrayLike,
    fitted: Mapping[str, Any] | Any,
    *,
    quantity: str = "correlation of residuals",
    number: int = 0,
) -> Figure:
    """Autocorrelation of residuals along flights against distance, and the fitted noise.

    Parameters
    ----------
    distance : array (lag,)
        Kilometres.
    measured, half_width : array (lag,)
        Correlation, or autocovariance, and half width of its 95 % interval (NaN: not known).
    fitted : array (lag,) or mapping of str to array (lag,)
        The noise model's correlation, or several by name.
    quantity : str, optional
        The y axis in words.
    number : int, optional
        Reports behind the points.
    """
    x = np.asarray(distance, float)
    figure = new_figure(3.2)
    axes = figure.add_subplot()
    half = np.nan_to_num(np.asarray(half_width, float))
    axes.errorbar(
        x,
        np.asarray(measured, float),
        half,
        fmt="o",
        color=INK,
        markersize=4,
        linewidth=1.0,
        label="measured, 95 % interval" if half.any() else "measured",
    )
    curves = fitted if isinstance(fitted, Mapping) else {"noise model": fitted}
    for colour, (name, values) in zip((BLUE, VERMILION, GREEN), curves.items(), strict=False):
        axes.plot(x, np.asarray(values, float), color=colour, label=name)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_xlim(left=0)
    axes.set_xlabel("distance along the flight (km)")
    axes.set_ylabel(quantity)
    axes.legend(loc="upper right")
    counted = f" (n = {plural(number, 'report')})" if number else ""
    return figure.say(
        f"The noise along a flight{counted}: {quantity.split(' (')[0]} of two reports against "
        "the distance between them, and the model that whitens them. If the line misses the "
        "points, the intervals on this page are too wide or too narrow."
    )


@styled
def pit_figure(counts: ArrayLike, *, before: ArrayLike | None = None) -> Figure:
    """Histogram of where held-out reports fall in their predicted distribution (PIT).

    Parameters
    ----------
    counts : array of int (bin,)
        Held-out reports in equal bins of predicted probability, after closure.
    before : array of int (bin,), optional
        The same with no effect in the simulation.
    """
    number = np.asarray(counts, float)
    share = number / max(number.sum(), 1.0) * number.size
    edges = np.linspace(0.0, 1.0, number.size + 1)
    figure = new_figure(3.0)
    axes = figure.add_subplot()
    axes.stairs(share, edges, fill=True, color=SKY, label="with the effects")
    if before is not None:
        early = np.asarray(before, float)
        axes.stairs(
            early / max(early.sum(), 1.0) * early.size,
            edges,
            color=ORANGE,
            linewidth=1.8,
            label="without",
        )
    axes.axhline(1.0, color=INK, linewidth=0.9, label="perfect")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("predicted probability of a value below the one reported")
    axes.set_ylabel("reports over expected")
    figure.legend(loc="outside upper left", ncols=3)
    return figure.say(
        f"Calibration of the improved simulation on held-out reports (n = "
        f"{plural(int(number.sum()), 'wind component')}): flat is right, a hump means noise "
        "taken too large, a trough too small, a slope a bias left."
    )


@styled
def _table_figure(place: PlaceEntry) -> Figure:
    """Steps of an unknown's table over one variable, or a map of it over two."""
    curve = place.curve
    edges = [np.asarray(own, float) for own in curve.edges or ()]
    value = np.reshape(np.asarray(curve.values, float), [own.size - 1 for own in edges])
    names = [
        f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}"
        for name, unit in zip(curve.variables or (), curve.variable_units or (), strict=True)
    ]
    what = f"{place.component.replace('_', ' ')} ({curve.unit})"
    figure = new_figure(2.6 if len(edges) == 1 else 3.4)
    axes = figure.add_subplot()
    axes.set_xlabel(names[0])
    if len(edges) == 1:
        axes.stairs(value, edges[0], color=BLUE, linewidth=1.6, baseline=None)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_ylabel(what)
    else:
        most = float(np.abs(value).max()) or 1.0
        mesh = axes.pcolormesh(
            edges[0], edges[1], value.T, cmap="RdBu_r", vmin=-most, vmax=most, shading="flat"
        )
        axes.set_ylabel(names[1])
        figure.colorbar(mesh, ax=axes, label=what)
    closes = f"; it closes {place.closure.reduction:.2f} kt" if place.closure else ""
    return figure.say(
        f"The unknown effect, fitted without physics on weeks left out: {slice_words(place)} "
        f"(n = {plural(int(value.size), 'cell')}){closes}."
    )


@styled
def _speed_map_figure(place: PlaceEntry) -> Figure:
    """Speeds sent in the place of others."""
    speeds = np.asarray((place.curve.edges or [[]])[0], float)
    sent = np.asarray(place.curve.values, float)
    figure = new_figure(2.8)
    axes = figure.add_subplot()
    axes.plot(speeds, speeds, color=INK, linewidth=0.8, linestyle="--")
    axes.plot(speeds, sent, color=BLUE, linewidth=1.6)
    axes.set_xlabel("simulated wind speed (m/s)")
    axes.set_ylabel("speed sent (m/s)")
    closes = f"; it closes {place.closure.reduction:.2f} kt" if place.closure else ""
    return figure.say(
        f"Speeds as sent against simulated ones, dashed where they are the same: "
        f"{slice_words(place)} (n = {plural(int(sent.size), 'quantile')}){closes}."
    )


@styled
def unknown_curve_figure(place: PlaceEntry) -> Figure:
    """Bars of the curve fitted to an effect that the catalogue does not hold."""
    if place.component == "reported_speed":
        return _speed_map_figure(place)
    if place.curve.edges is not None:
        return _table_figure(place)
    labels, value = place.curve.labels, np.asarray(place.curve.m_s, float)
    figure = new_figure(2.6)
    axes = figure.add_subplot()
    axes.bar(range(value.size), value, color=[BLUE if v >= 0 else ORANGE for v in value], width=0.7)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    turned = 45 if len(labels) > 8 else 0
    axes.set_xticks(
        range(len(labels)),
        [str(label) for label in labels],
        rotation=turned,
        ha="right" if turned else "center",
        fontsize=8.5,
    )
    axes.grid(axis="x", visible=False)
    if place.component == "scatter":
        axes.set_ylabel("beyond the fleet's (m/s)")
        return figure.say(
            f"What aircraft scatter more than the fleet: {slice_words(place)} (n = {value.size})."
        )
    if place.component == "reported_direction":
        axes.set_xlabel("reported wind direction (degrees)")
        axes.set_ylabel("beside simulated (%)")
        return figure.say(
            f"Reports beside simulated ones in each ten degrees: {slice_words(place)} "
            f"(n = {value.size})."
        )
    axes.set_ylabel("fitted residual (m/s)")
    return figure.say(
        f"The unknown effect, as fitted without physics: {slice_words(place)} (n = "
        f"{plural(int(value.size), 'coefficient')})."
    )
