"""Whether the compasses stayed as they were, and whom to correct, as pictures.

Assumes ``stability.json``, the ranking and ``virtual_field_test.json`` as
:mod:`airswing.evaluation` makes them. Angles in degrees, gains in knots of mean wind vector
disagreement; intervals are 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from airswing.evaluation.results import Content
from airswing.report.html.style import (
    BLUE,
    FAINT,
    HEAVY,
    INK,
    ORANGE,
    SOFT,
    VERMILION,
    blank,
    empty_figure,
    new_figure,
    plural,
    styled,
)
from airswing.units import NORMAL_95

# What a screen holds.
MOST_ROWS = 10
_MOST_BARS = 40


@styled
def stability_figure(stability: Content, aircraft: Sequence[str] | None = None) -> Figure:
    """Draw each aircraft's offset and amplitude window by window, with the dates of changes.

    Parameters
    ----------
    stability : Content
        Content of ``stability.json``.
    aircraft : sequence of str, optional
        Which to draw; by default those that changed first, ten at most.
    """
    changes = {entry["aircraft"]: entry["changes"] for entry in stability["changes"]}
    windows = [entry for entry in stability["windows"] if entry["status"] == "ok"]
    fitted = {entry["aircraft"] for entry in windows}
    if aircraft is None:
        order = sorted(changes, key=lambda name: (not changes[name], name not in fitted, name))
        aircraft = [name for name in order if changes[name] or name in fitted][:MOST_ROWS]
    if not aircraft:
        return empty_figure("No window has enough reports for a fit")
    figure = new_figure(0.9 + 1.05 * len(aircraft))
    grid = figure.subplots(len(aircraft), 2, squeeze=False, sharex=True, sharey="col")
    step = np.timedelta64(1 if stability["window"] == "month" else 3, "M")
    for row, name in enumerate(aircraft):
        own = [entry for entry in windows if entry["aircraft"] == name]
        offset, amplitude = grid[row]
        values = [(entry["offset"], entry["offset_standard_error"]) for entry in own]
        _windows(offset, own, values, BLUE, step)
        values = [(entry["amplitude"], entry["amplitude_standard_error"]) for entry in own]
        _windows(amplitude, own, values, ORANGE, step)
        for axes in (offset, amplitude):
            _dates(axes, changes.get(name, []))
        grid[row, 0].set_ylabel(name)
    grid[0, 0].set_title("offset (degree)")
    grid[0, 1].set_title("amplitude (degree)")
    _date_ticks(grid[-1, 0])
    number = sum(len(changes.get(name, [])) for name in aircraft)
    return figure.say(
        f"Fits by {stability['window']} with 95 % intervals, each from its own reports only, of "
        f"{plural(len(aircraft), 'aircraft', 'aircraft')}; orange: dates at which a compass "
        f"changed ({number} found), the band their 95 % interval."
    )


def _date_ticks(axes: Axes) -> None:
    """Dates of an axis that others share, found once: they are asked for again by every panel."""
    axes.xaxis_date()
    locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
    locator.set_axis(axes.xaxis)
    low, high = axes.get_xlim()
    places = [place for place in locator() if low <= place <= high]
    form = ConciseDateFormatter(locator)  # type: ignore[no-untyped-call]
    axes.set_xticks(places, form.format_ticks(places))  # type: ignore[no-untyped-call]
    axes.set_xlim(low, high)


def _windows(
    axes: Axes,
    own: Sequence[Content],
    values: Sequence[tuple[float, float]],
    colour: str,
    step: np.timedelta64,
) -> None:
    """Values with their standard errors, one a window."""
    first = np.array([entry["window"] for entry in own], dtype="datetime64[M]")
    begin, end = _place(first), _place(first + step)
    value = [one for one, _ in values]
    half = [NORMAL_95 * error for _, error in values]
    axes.hlines(value, begin, end, color=colour, linewidth=1.4)
    axes.errorbar((begin + end) // 2, value, yerr=half, fmt="o", color=colour, markersize=4)


def _dates(axes: Axes, changes: Sequence[Content]) -> None:
    for change in changes:
        low, high = (np.datetime64(day, "D") for day in change["date_ci"])
        end = high + np.timedelta64(1, "D")
        first, last, found = _place([low, end, np.datetime64(change["date"], "D")]).tolist()
        axes.axvspan(first, last, color=VERMILION, alpha=0.18, linewidth=0)
        axes.axvline(found, color=VERMILION, linewidth=1.4)


def _place(days: ArrayLike) -> NDArray[np.float64]:
    """Places of days on an axis of dates: days since 1970."""
    return np.asarray(days).astype("datetime64[D]").astype(np.float64)


@styled
def ranking_figure(ranking: Sequence[Content]) -> Figure:
    """Draw what correcting each aircraft is expected to gain.

    Parameters
    ----------
    ranking : sequence of mapping
        Of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`.
    """
    known = [(gain, entry) for entry in ranking if (gain := entry["expected_gain_kt"]) is not None]
    shown = known[:_MOST_BARS]
    figure = new_figure(1.1 + 0.26 * max(len(shown), 2))
    axes = figure.add_subplot()
    if not shown:
        blank(axes, "No aircraft has a fit to be trusted.")
        return figure.say("No aircraft has a fit to be trusted (n = 0).")
    for row, (gain, entry) in enumerate(shown):
        low, high = entry["expected_gain_ci_kt"]
        axes.plot([low, high], [row, row], color=BLUE, linewidth=1.6, solid_capstyle="butt")
        axes.plot(gain, row, "o", color=BLUE, markersize=5.5)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(shown)), [entry["aircraft"] for _, entry in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlabel("expected gain of a correction (kt of mean vector disagreement)")
    left_out = len(ranking) - len(known)
    return figure.say(
        "What correcting each aircraft is expected to gain, from the fit alone, with 95 % "
        f"intervals (n = {plural(len(shown), 'aircraft', 'aircraft')}"
        + (f"; {left_out} without a fit to be trusted" if left_out else "")
        + ")."
    )


@styled
def prediction_figure(virtual: Content) -> Figure:
    """Draw predicted against realised gain of each aircraft: later reports, held-out flights.

    Parameters
    ----------
    virtual : mapping
        Content of ``virtual_field_test.json``: ``later`` and ``held_out``.
    """
    figure = new_figure(3.8)
    parts = {
        "Learned before, applied after": virtual.get("later"),
        "Flights held out of the fit": virtual.get("held_out"),
    }
    total = 0
    for axes, (title, part) in zip(figure.subplots(1, 2), parts.items(), strict=True):
        axes.set_title(title)
        rows = part["by_aircraft"] if part and "why" not in part else []
        total += len(rows)
        if rows:
            _against(axes, rows)
        else:
            blank(axes, "Too few reports.")
    return figure.say(
        "Gain expected from the fit alone and gain realised on reports the fit never saw, each "
        "aircraft, with 95 % intervals; on the line they are equal, orange: they differ by more "
        f"than the interval of their difference (n = {plural(total, 'point')})."
    )


def _against(axes: Axes, rows: Sequence[Content]) -> None:
    x, y = (
        np.array([row["predicted_gain_kt"] for row in rows], float),
        np.array([row["realised_gain_kt"] for row in rows], float),
    )
    across = np.array([row["predicted_gain_ci_kt"] for row in rows], float)
    along = np.array([row["realised_gain_ci_kt"] for row in rows], float)
    many = len(rows) > HEAVY
    axes.hlines(y, *across.T, color=FAINT, linewidth=1.4, rasterized=many)
    axes.vlines(x, *along.T, color=FAINT, linewidth=1.4, rasterized=many)
    apart = np.array([row["agree"] is False for row in rows])
    for own, color in ((~apart, BLUE), (apart, VERMILION)):
        size = 2.5 if many else 5.5
        axes.plot(x[own], y[own], "o", color=color, markersize=size, rasterized=many)
    if len(rows) <= 12:
        for row, place in zip(rows, zip(x, y, strict=True), strict=True):
            axes.annotate(
                row["aircraft"],
                place,
                xytext=(5, -9),
                textcoords="offset points",
                fontsize=8,
                color=SOFT,
            )
    values = [gain for row in rows for gain in (row["predicted_gain_kt"], row["realised_gain_kt"])]
    low, high = min(0.0, *values), max(values)
    # bars may be cut, points and their names not
    low, high = low - 0.05 * (high - low) - 0.2, high + 0.1 * (high - low) + 0.2
    axes.plot([low, high], [low, high], color=SOFT, linewidth=1.0, zorder=1)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.set_xlabel("predicted gain (kt)")
    axes.set_ylabel("realised gain (kt)")
