"""Heading error of an aircraft against its magnetic heading: the one drawing used everywhere.

:func:`draw_heading_error` draws the reports, binned medians, the fitted curve with its 95 %
interval and the 8-point table in a panel. The interval of a median takes reports as independent;
those of one flight are not, so it is too narrow and serves the eye alone. The interval of the curve
is 1.96 standard errors of the covariance clustered by flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from numpy.typing import NDArray

from airswing.flags import published
from airswing.physics.robust_spread import robust_sd
from airswing.report.html import style
from airswing.report.html.text import Units, plural, shown_per_m_s
from airswing.report.run import selection
from airswing.report.run.selection import compass_points, curve_half_width, curve_of, one_fit
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Degrees that divide 360: two cycles keep their shape, and each bin has reports of several flights.
BIN_WIDTH, SMALL_BIN_WIDTH = 15.0, 30.0
# Reports drawn in a small panel, where more would cover each other.
_SMALL_DRAWN = 400
# Widest common scale of small panels, degrees, so that one aircraft does not flatten the others.
_WIDEST = 25.0
_COLUMNS = 4
_SECTORS = 24
_GRID = np.linspace(0.0, 360.0, 121)


class Binned(NamedTuple):
    """Medians in bins of heading, with half the width of a 95 % interval."""

    centre: Floats
    median: Floats
    half_width: Floats


def binned_medians(heading: Floats, value: Floats, *, width: float = BIN_WIDTH) -> Binned:
    """Return the median of a value in each bin of heading with at least five reports.

    The half width is 1.96 x 1.2533 x 1.4826 MAD / sqrt(number): the standard error of a median is
    sqrt(pi / 2) = 1.2533 times that of a mean. Headings and `width`, a divisor of 360, in degrees.
    """
    bins = np.floor((heading % 360.0) / width).astype(int)
    order = np.argsort(bins, kind="stable")
    rows = []
    groups = np.split(value[order], np.cumsum(np.bincount(bins, minlength=1))[:-1])
    for index, inside in enumerate(groups):
        if inside.size >= 5:
            middle = float(np.median(inside))
            half = NORMAL_95 * 1.2533 * robust_sd(inside, middle) / np.sqrt(inside.size)
            rows.append(((index + 0.5) * width, middle, half))
    return Binned(*np.array(rows, float).reshape(-1, 3).T)


def _error_limit(error: Floats, fitted: Floats) -> float:
    """Return half the height of a panel (degrees) that contains the curve and most reports."""
    # One report in forty may lie outside; beyond 60 degrees the curve would look flat.
    spread = float(np.percentile(np.abs(error), 97.5)) if error.size else 0.0
    return float(np.clip(max(spread, float(np.max(np.abs(fitted))) * 1.15), 3.0, 60.0))


def draw_heading_error(
    axes: Axes,
    heading: Floats,
    error: Floats,
    fit: xr.Dataset,
    *,
    limit: float | None = None,
    small: bool = False,
    bins: Binned | None = None,
) -> None:
    """Draw the heading error (n,) of one aircraft against magnetic heading, degrees, in a panel.

    `fit` is the fit of this aircraft against one reference. `limit` is half the height of the
    panel, degrees, by default from the data; `bins` replaces the medians of the reports. A small
    panel, one of many, has fewer points, thinner lines and no axis titles.
    """
    usable = bool(published(fit["status"]))
    curve = curve_of(fit, _GRID)
    limit = _error_limit(error, curve) if limit is None else limit
    scale = 0.6 if small else 1.0
    _draw_reports(axes, heading, error, limit, small=small)
    axes.axhline(0.0, color=style.INK, linewidth=0.8, zorder=1.7)
    if np.isfinite(fit["deviation"].to_numpy()).any():
        half = curve_half_width(fit, _GRID)
        look: dict[str, Any] = {"color": style.SKY, "alpha": 0.45, "linewidth": 0.0, "zorder": 2.0}
        look["label"] = "95 % interval of the fit"
        axes.fill_between(_GRID, curve - half, curve + half, **look)
        look = {"color": style.BLUE, "linewidth": 2.2 * scale, "zorder": 3}
        look["linestyle"] = "-" if usable else (0, (4, 2))
        axes.plot(_GRID, curve, label="fitted curve" if usable else "fit, not usable", **look)
    if bins is None:
        bins = binned_medians(heading, error, width=SMALL_BIN_WIDTH if small else BIN_WIDTH)
    low, high = bins.median - bins.half_width, bins.median + bins.half_width
    axes.vlines(bins.centre, low, high, color=style.INK, linewidth=1.0, zorder=4)
    look = {"color": style.INK, "markersize": 4.5 * scale, "zorder": 4}
    label = "median of the reports, 95 % interval"
    axes.plot(bins.centre, bins.median, "o", label=label, **look)
    nodes, table = selection.table_error(fit)
    if usable and np.isfinite(table).all():
        turn, closed = np.append(nodes, 360.0), np.append(table, table[0])
        axes.plot(turn, closed, color=style.VERMILION, linewidth=1.1, linestyle=":", zorder=3.4)
        look = {"color": style.VERMILION, "markersize": 6.0 * scale, "zorder": 5, "clip_on": False}
        look |= {"markeredgecolor": "white", "markeredgewidth": 0.9 * scale}
        axes.plot(nodes, table, "D", label="removed by the 8-point table", **look)
    axes.set(xlim=(0, 360), xticks=range(0, 361, 90 if small else 45), ylim=(-limit, limit))
    if not small:
        axes.set_xlabel("indicated magnetic heading (degree)")
        axes.set_ylabel("heading error (degree)")


def _draw_reports(axes: Axes, heading: Floats, error: Floats, limit: float, *, small: bool) -> None:
    if heading.size > style.MANY and not small:
        axes.hexbin(
            heading,
            error,
            gridsize=(72, 36),
            extent=(0, 360, -limit, limit),
            mincnt=1,
            cmap="Greys",
            bins="log",
            linewidths=0.0,
            alpha=0.75,
            rasterized=True,
        )
        return
    every = max(-(-heading.size // _SMALL_DRAWN), 1) if small else 1
    alpha = float(np.clip(900.0 / max(heading.size / every, 1), 0.08, 0.6))
    look: dict[str, Any] = {"color": style.SOFT, "alpha": alpha, "markeredgewidth": 0}
    look |= {"markersize": 1.6 if small else 2.4, "zorder": 1.6}
    # rasterized in the PDF of the swing cards
    axes.plot(heading[::every], error[::every], "o", rasterized=True, **look)


@style.drawing()
def heading_error_figure(
    headings: xr.Dataset,
    fits: xr.Dataset,
    aircraft: str | int,
    reference: str | None = None,
    *,
    units: Units = "kt",
) -> Figure:
    """Draw heading error against magnetic heading for one aircraft.

    Parameters
    ----------
    headings : Dataset
        ``heading_error`` (reference, report), ``magnetic_heading``, ``screening``, ``row_size``.
    fits : Dataset
        ``fits.nc`` of docs/formats.md.
    aircraft : str or int
        Identifier or position.
    reference : str, optional
        Reference or pool; by default the first pool, else the first reference.
    units : {"kt", "m/s"}, optional
        Unit of the speeds in the caption.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the aircraft or the reference is not in the fits.
    """
    reference = reference or selection.headline_reference(fits, headings)
    fit = one_fit(fits, aircraft, reference)
    name = str(fit["aircraft"].to_numpy())
    heading, error = compass_points(headings, fits, aircraft, reference)
    figure = style.new_figure(4.1)
    axes = figure.add_subplot()
    draw_heading_error(axes, heading, error, fit)
    axes.set_title(f"{name} against {reference}:  {selection.fit_words(fit)}")
    figure.legend(loc="outside lower center", ncols=5)
    refused = f" The fit is not usable: {selection.status_words(fit['status'])}."
    return figure.say(
        f"{name}: heading error (indicated minus the heading that {reference} implies) against "
        f"indicated magnetic heading, n = {plural(heading.size, 'report')} of "
        f"{plural(int(fit['flight_count']), 'flight')}; medians in bins of {BIN_WIDTH:.0f} "
        f"degrees. Diamonds: heading error removed by the 8-point table ({_table_words(fit)})."
        f"{bias_words(fits, reference, units)}{'' if published(fit['status']) else refused}"
    )


def heading_errors_figure(
    headings: xr.Dataset, fits: xr.Dataset, names: Sequence[str], reference: str, units: Units
) -> Figure:
    """Draw small panels of the heading error of several aircraft on one scale."""
    points = [compass_points(headings, fits, name, reference) for name in names]
    found = [one_fit(fits, name, reference) for name in names]
    both = zip(points, found, strict=True)
    limit = min(_WIDEST, max(_error_limit(one[1], curve_of(fit, _GRID)) for one, fit in both))
    figure, panels = small_panels(len(names))
    for axes, name, (heading, error), fit in zip(panels, names, points, found, strict=True):
        draw_heading_error(axes, heading, error, fit, limit=limit, small=True)
        axes.set_title(name, fontsize=9)
        axes.set_title(f"n = {heading.size:,}", fontsize=8, loc="right", weight="normal")
        axes.tick_params(labelsize=8, labelbottom=True)
    return figure.say(
        f"Heading error (degree) against indicated magnetic heading (degree) of "
        f"{plural(len(names), 'aircraft')} against {reference}, on one scale (n = "
        f"{plural(sum(p[0].size for p in points), 'report')}). Grey: reports, at most "
        f"{_SMALL_DRAWN} of each aircraft; black: medians in bins of {SMALL_BIN_WIDTH:.0f} degrees "
        "with 95 % intervals; blue: fitted curve and its 95 % interval (dashed: not usable); "
        f"orange diamonds: heading error removed by the 8-point table ({_table_words(fits)})."
        f"{bias_words(fits, reference, units)}"
    )


def small_panels(number: int) -> tuple[style.CaptionedFigure, list[Axes]]:
    """Return a figure with so many panels of one scale, four in a row."""
    rows = -(-number // _COLUMNS)
    figure = style.new_figure(0.45 + 1.85 * rows)
    grid = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in grid[number:]:
        axes.axis("off")
    return figure, list(grid[:number])


def _table_words(fits: xr.Dataset) -> str:
    return "the table" if selection.adds_error(fits) else "minus the table"


def bias_words(fits: xr.Dataset, reference: str, units: Units) -> str:
    """Return a sentence on the bias subtracted from the points; empty where there is none."""
    bias = selection.fitted_bias(fits, reference)
    eastward, northward = (shown_per_m_s(units) * part for part in bias)
    if not (eastward or northward):
        return ""
    return (
        f" The fitted bias of the reference ({eastward:+.2f} {units} eastward, {northward:+.2f} "
        f"{units} northward) is subtracted from the points."
    )


def sector_counts(heading: Floats, *, sectors: int = _SECTORS) -> NDArray[np.int64]:
    """Count reports in equal sectors of heading, the first centred on north."""
    width = 360.0 / sectors
    index = np.floor(((heading + width / 2) % 360.0) / width).astype(int)
    return np.bincount(index % sectors, minlength=sectors)


def _rose(axes: Axes, middle: tuple[float, float], counts: NDArray[np.int64]) -> None:
    radius = np.sqrt(counts / max(int(counts.max()), 1))
    width = 360.0 / counts.size
    wedges = [
        Wedge(middle, float(r), 90 - (i + 0.5) * width, 90 - (i - 0.5) * width)
        for i, r in enumerate(radius)
        if r > 0
    ]
    circle = [Circle(middle, 1.0)]
    axes.add_collection(PatchCollection(circle, facecolor="none", edgecolor=style.FAINT))
    look: dict[str, Any] = {"facecolor": style.BLUE, "edgecolor": "white", "linewidth": 0.4}
    axes.add_collection(PatchCollection(wedges, alpha=0.9, **look))


def coverage_figure(headings: xr.Dataset, names: Sequence[str]) -> Figure:
    """Draw a rose of the magnetic headings of each aircraft's screened reports."""
    columns = min(8, max(len(names), 3))
    rows = -(-len(names) // columns)
    pitch_x, pitch_y = 2.45, 3.0
    height = min(9.6 / columns * pitch_y / pitch_x, 2.4) * rows + 0.1
    figure = style.new_figure(height)
    axes = figure.add_subplot()
    total = 0
    for index, name in enumerate(names):
        reports = headings[["magnetic_heading", "screening"]]
        reports = reports.isel(report=selection.rows_of(headings, name))
        heading = reports["magnetic_heading"].to_numpy()[selection.used(reports)].astype(float)
        heading = heading[np.isfinite(heading)]
        x, y = pitch_x * (index % columns), -pitch_y * (index // columns)
        _rose(axes, (x, y), sector_counts(heading))
        total += heading.size
        points = int(np.count_nonzero(sector_counts(heading, sectors=8)))
        below = f"{heading.size:,}, {points} of 8"
        look: dict[str, Any] = {"ha": "center", "va": "center"}
        axes.text(x, y + 1.14, "N", fontsize=7, color=style.SOFT, **look)
        axes.text(x, y - 1.2, name, fontsize=9, weight="bold", **look)
        colour = style.INK if points == 8 else style.VERMILION
        axes.text(x, y - 1.48, below, fontsize=7.5, color=colour, **look)
    axes.set_xlim(-1.25, pitch_x * (columns - 1) + 1.25)
    axes.set_ylim(-pitch_y * (rows - 1) - 1.7, 1.3)
    axes.set_aspect("equal")
    axes.axis("off")
    return figure.say(
        f"Headings flown: each rose shows the magnetic headings of one aircraft's screened "
        f"reports in {_SECTORS} sectors, north up; the area is proportional to the number "
        f"(n = {plural(total, 'report')}, {plural(len(names), 'aircraft')}). Below each: the "
        "number of reports and of the eight compass points flown (orange: fewer than eight)."
    )
