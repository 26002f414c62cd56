"""Which effect: the evidence for each, the aircraft that carry it, the curve of an unknown.

Assumes the numbers of ``gap.json``: log evidence is natural, probabilities lie in 0 to 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import CATEGORIES
from airswing.gap.result.schema import EvidenceEntry, GapReport, PlaceEntry
from airswing.report.gap.words import slice_words
from airswing.report.html.style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    SKY,
    empty_figure,
    new_figure,
    plural,
    styled,
)

Floats = NDArray[np.float64]
# Letters of names below a figure that still stand side by side.
_SIDE_BY_SIDE = 80


@styled
def evidence_figure(gap: GapReport) -> Figure:
    """Bars of the best evidence for each effect of the catalogue against none, the 20 largest."""
    best = best_evidence(gap.evidence)
    if not best:
        return empty_figure("No effect of the catalogue could be tried")
    chosen = {effect.name for effect in gap.effects}
    ambiguous = {name for effect in gap.effects for name in effect.ambiguous_with}
    figure = new_figure(1.0 + 0.27 * len(best))
    axes = figure.add_subplot()
    colours = [BLUE if name in chosen else SKY if name in ambiguous else FAINT for name in best]
    positive = np.clip(list(best.values()), 0.0, None)
    axes.barh(range(len(best)), positive, color=colours, height=0.72)
    # Evidence spans four decades: what is doubtful (to 10 nats) keeps a scale of its own.
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(LogFormatter(linthresh=10.0))
    for row, value in enumerate(best.values()):
        axes.annotate(
            f"{round(value):,}",
            (positive[row], row),
            xytext=(4, 0),
            va="center",
            textcoords="offset points",
            fontsize=8.5,
        )
    axes.set_yticks(range(len(best)), [name.replace("_", " ") for name in best])
    axes.set_ylim(len(best) - 0.4, -0.6)
    axes.set_xlim(0, max(float(positive.max(initial=10.0)) * 2.5, 20.0))
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("log evidence against no effect (linear to 10, then logarithmic)")
    return figure.say(
        f"Best evidence for each effect of the catalogue, each of those found taken out in turn "
        f"(n = {plural(gap.counts.reports, 'report')}). Dark blue: in the verdict; light blue: "
        "could not be told from it; grey: neither. One effect lends evidence to those that look "
        "like it, so a long grey bar alone is no finding."
    )


def best_evidence(rows: Sequence[EvidenceEntry]) -> dict[str, float]:
    """Return the best tempered evidence (nats) of effects of the catalogue, the 20 largest."""
    best: dict[str, float] = {}
    for row in rows:
        if row.known and np.isfinite(row.tempered_nats):
            best[row.name] = max(row.tempered_nats, best.get(row.name, -np.inf))
    return dict(sorted(best.items(), key=lambda item: -item[1])[:20])


def posteriors(rows: Sequence[EvidenceEntry]) -> dict[str, Sequence[float]]:
    """Return the probability of each aircraft for the effects found on single aircraft."""
    found: dict[str, Sequence[float]] = {}
    for row in rows:
        if row.instead_of == row.name and row.scope == "aircraft":
            found.setdefault(row.name, row.posterior)
    return found


@styled
def posterior_figure(tails: Sequence[str], probability: Mapping[str, Sequence[float]]) -> Figure:
    """Heat map of the probability that each aircraft carries each effect.

    Parameters
    ----------
    tails : sequence of str (aircraft,)
    probability : mapping of str to sequence of float (aircraft,)
        By effect.
    """
    value = np.array(list(probability.values()), float)
    # at least as high as the words beside the scale are long
    figure = new_figure(max(1.3 + 0.36 * len(value), 2.1))
    axes = figure.add_subplot()
    drawn = axes.imshow(value, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    size = 8.5 if len(tails) <= 30 else 6.0
    # letters that stand side by side at this size
    turned = 90 if len(tails) * max(map(len, tails)) > _SIDE_BY_SIDE else 0
    axes.set_xticks(range(len(tails)), tails, rotation=turned, fontsize=size)
    axes.set_yticks(range(len(value)), [_row_name(name) for name in probability])
    axes.grid(visible=False)
    if len(tails) <= 30:
        for (row, column), cell in np.ndenumerate(value):
            if cell >= 0.05:
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


def _set_ticks(axis: Axis, variable: str, edges: Floats) -> None:
    """Put names of categories, or quarters of a whole turn, in the place of round numbers."""
    names = CATEGORIES.get(variable, ())
    if names:
        axis.set_ticks(range(len(names)), names)
    elif edges[0] == 0.0 and edges[-1] == 360.0:
        axis.set_ticks(np.arange(0.0, 361.0, 90.0))


def _row_name(name: str) -> str:
    """A row of the map of probabilities: an effect, or a curve of the dictionary in words."""
    component, _, variables = name.rpartition(":")
    words = variables.replace("*", " by ").replace("_", " ")
    side = {"cross": ", across", "along": ", along"}.get(component, f", {component}")
    return words + (side if component else "")


@styled
def _table_figure(place: PlaceEntry) -> Figure:
    """Steps of an unknown's table over one variable, or a map of it over two."""
    curve = place.curve
    edges = [np.asarray(own, float) for own in curve.edges or ()]
    value = np.reshape(np.asarray(curve.values, float), [own.size - 1 for own in edges])
    names = [
        f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}".replace("s2", "s²")
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
    sides = zip((axes.xaxis, axes.yaxis), curve.variables or (), edges, strict=False)
    for axis, name, own in sides:
        _set_ticks(axis, name, own)
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
    if place.component == "reported_speed" and place.curve.edges is not None:
        return _speed_map_figure(place)
    if place.curve.edges is not None:
        return _table_figure(place)
    labels, value = place.curve.labels, np.asarray(place.curve.m_s, float)
    figure = new_figure(2.6)
    axes = figure.add_subplot()
    axes.bar(range(value.size), value, color=[BLUE if v >= 0 else ORANGE for v in value], width=0.7)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    # of one or two a bar would be as wide as the page
    least = max(0.0, 4.0 - value.size) / 2.0
    axes.set_xlim(-0.6 - least, value.size - 0.4 + least)
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
    if place.variable == "unchanged":
        axes.set_xlabel("time for which it has been so")
        axes.set_ylabel("error (m/s rms)")
        return figure.say(
            f"Errors of what is sent again and again: {slice_words(place)} (n = {value.size})."
        )
    if place.component == "wind_map":
        axes.set_ylabel("sent of what was measured")
        return figure.say(f"The map: {slice_words(place)} (n = {value.size}).")
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
