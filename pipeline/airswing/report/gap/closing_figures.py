"""How far the gap closes, and the checks of the method: waterfall, noise model, calibration.

Assumes the numbers of ``gap.json`` and the histograms of ``gap.nc``: disagreement is in knots on
held-out flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.gap.result.schema import GapReport
from airswing.report.gap.words import plain_name
from airswing.report.html.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    SKY,
    SOFT,
    new_figure,
    plural,
    styled,
)


@styled
def waterfall_figure(gap: GapReport) -> Figure:
    """Waterfall of the disagreement: the real gap, after each effect, the noise floor."""
    before, floor = gap.closure.before, gap.gap.noise_floor_kt
    end, end_interval = gap.closure.after, gap.closure.ci
    names, levels = ["as simulated\nso far"], [before]
    intervals: list[Sequence[float] | None] = [None]
    for name, level, interval in closure_steps(gap):
        names.append("+ " + name.replace("_", " "))
        levels.append(level)
        intervals.append(interval)
    figure = new_figure(1.5 + 0.42 * (len(names) + 2))
    axes = figure.add_subplot()
    axes.barh(0, before, color=SOFT, height=0.62)
    for row in range(1, len(names)):
        previous, level = levels[row - 1], levels[row]
        colour = BLUE if level <= previous else ORANGE
        axes.barh(row, level - previous, left=previous, color=colour, height=0.62)
        axes.plot([previous, previous], [row - 1.31, row + 0.31], color=SOFT, linewidth=0.8)
        interval = intervals[row]
        # Left of the bar and of its interval, so that the figure covers neither.
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
    # Room for the level that stands behind the longest bar.
    axes.set_xlim(0, right * 1.14)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("mean vector disagreement on held-out flights (kt)")
    return figure.say(
        f"How far the gap closes (n = {plural(gap.counts.reports, 'held-out report')}): "
        "disagreement of reports and simulation before, the step each effect makes when it is "
        "added in turn (black: 95 % interval), what is left, and the noise floor that no effect "
        "can pass."
    )


def closure_steps(gap: GapReport) -> list[tuple[str, float, Sequence[float] | None]]:
    """Return (name, disagreement after it in kt, 95 % interval) of each step of the waterfall.

    The diagnosis gives the interval of the step's reduction; what is left after it lies the
    reduction below the level before it.
    """
    steps: list[tuple[str, float, Sequence[float] | None]] = []
    for before, entry in pairwise(gap.waterfall):
        if entry.step_ci is not None:
            interval = sorted(before.kt - bound for bound in entry.step_ci)
            steps.append((entry.label, entry.kt, interval))
    if steps:
        return steps
    names = " + ".join(plain_name(effect.name) for effect in gap.effects[:2])
    more = " + ..." if len(gap.effects) > 2 else ""
    return [(names + more, gap.closure.after, gap.closure.ci)]


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
def autocorrelation_figure(gap: GapReport) -> Figure:
    """Autocovariance of residuals along flights against distance, and the fitted noise."""
    noise = gap.noise
    figure = new_figure(3.2)
    axes = figure.add_subplot()
    axes.plot(
        noise.distance_km,
        noise.autocovariance,
        "o",
        color=INK,
        markersize=4,
        label="measured",
        clip_on=False,  # the first lies on the axis
    )
    axes.plot(noise.distance_km, noise.autocovariance_model, color=BLUE, label="noise model")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_xlim(left=0)
    axes.set_xlabel("distance along the flight (km)")
    axes.set_ylabel("autocovariance of residuals (m²/s²)")
    axes.legend(loc="upper right")
    return figure.say(
        f"The noise along a flight (n = {plural(gap.counts.reports, 'report')}): autocovariance "
        "of residuals of two reports against the distance between them, and the model that "
        "whitens them. If the line misses the points, the intervals on this page are too wide or "
        "too narrow."
    )


@styled
def pit_figure(maps: xr.Dataset) -> Figure:
    """Histogram of where held-out reports fall in their predicted distribution (PIT).

    Parameters
    ----------
    maps : Dataset
        ``gap.nc``: ``pit_count`` and ``pit_count_before`` (pit_bin), held-out wind components in
        equal bins of predicted probability, with the effects and without.
    """
    after, before = (maps[name].to_numpy() for name in ("pit_count", "pit_count_before"))
    edges = np.linspace(0.0, 1.0, after.size + 1)
    figure = new_figure(3.0)
    axes = figure.add_subplot()
    share, early = (count / max(count.sum(), 1) * count.size for count in (after, before))
    axes.stairs(share, edges, fill=True, color=SKY, label="with the effects")
    axes.stairs(early, edges, color=ORANGE, linewidth=1.8, label="without")
    axes.axhline(1.0, color=INK, linewidth=0.9, label="perfect")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("predicted probability of a value below the one reported")
    axes.set_ylabel("reports over expected")
    figure.legend(loc="outside upper left", ncols=3)
    return figure.say(
        f"Calibration of the improved simulation on held-out reports (n = "
        f"{plural(int(after.sum()), 'wind component')}): flat is right, a hump means noise "
        "taken too large, a trough too small, a slope a bias left."
    )
