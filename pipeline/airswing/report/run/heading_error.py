"""Heading error of an aircraft against its magnetic heading: the common drawing.

:func:`draw_heading_error` draws the reports, binned medians, the fitted curve with its 95 %
interval and the 8-point table in a panel. The interval of a median takes reports as independent;
those of one flight are not, so it is too narrow and only a visual guide. The interval of the curve
is 1.96 standard errors of the covariance clustered by flight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from numpy.typing import NDArray

from airswing.compass.correction import deviation_curve
from airswing.flags import published
from airswing.physics.robust_spread import robust_sd
from airswing.report.html import style
from airswing.report.html.style import BLUE, INK, SKY, SOFT, VERMILION, Look
from airswing.report.html.text import Units, plural
from airswing.report.run import selection
from airswing.report.run.selection import Run, curve_half_width
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


def binned_medians(heading: Floats, value: Floats, *, width: float = BIN_WIDTH) -> Floats:
    """Return centre, median and half its 95 % interval (3, n) of bins with at least five reports.

    The half width is 1.96 x 1.2533 x 1.4826 MAD / sqrt(number): the standard error of a median is
    sqrt(pi / 2) = 1.2533 times that of a mean. Headings and `width`, a divisor of 360, in degrees.
    """
    bins = np.floor((heading % 360.0) / width)
    rows = []
    for index in np.unique(bins):
        inside = value[bins == index]
        if inside.size >= 5:
            middle = float(np.median(inside))
            half = NORMAL_95 * 1.2533 * robust_sd(inside, middle) / np.sqrt(inside.size)
            rows.append(((index + 0.5) * width, middle, half))
    return np.array(rows, float).reshape(-1, 3).T


def _curve(fit: xr.Dataset) -> Floats:
    return deviation_curve(np.nan_to_num(fit["deviation"].to_numpy()), _GRID)


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
    bins: Floats | None = None,
) -> None:
    """Draw the heading error (n,) of one aircraft against magnetic heading, degrees, in a panel.

    `fit` is the fit of this aircraft against one reference. `limit` is half the height of the
    panel, degrees, by default from the data; `bins` replaces the medians of the reports. A small
    panel, one of many, has fewer points, thinner lines and no axis titles.
    """
    usable, curve = bool(published(fit["status"])), _curve(fit)
    limit = _error_limit(error, curve) if limit is None else limit
    scale = 0.6 if small else 1.0
    if heading.size > style.MANY and not small:
        grid = Look(gridsize=(72, 36), extent=(0, 360, -limit, limit), mincnt=1, cmap="Greys")
        axes.hexbin(heading, error, bins="log", linewidths=0.0, alpha=0.75, rasterized=True, **grid)
    else:
        every = max(-(-heading.size // _SMALL_DRAWN), 1) if small else 1
        alpha = float(np.clip(900.0 / max(heading.size / every, 1), 0.08, 0.6))
        dots = Look(color=SOFT, alpha=alpha, markeredgewidth=0, zorder=1.6)
        dots |= Look(markersize=1.6 if small else 2.4, rasterized=True)  # in the PDF of the cards
        axes.plot(heading[::every], error[::every], "o", **dots)
    axes.axhline(0.0, color=INK, linewidth=0.8, zorder=1.7)
    if np.isfinite(fit["deviation"].to_numpy()).any():
        half = curve_half_width(fit, _GRID)
        band = Look(color=SKY, alpha=0.45, linewidth=0.0, zorder=2.0)
        band["label"] = "95 % interval of the fit"
        axes.fill_between(_GRID, curve - half, curve + half, **band)
        line = Look(color=BLUE, linewidth=2.2 * scale, zorder=3)
        line["linestyle"], line["label"] = "-", "fitted curve"
        if not usable:
            line["linestyle"], line["label"] = (0, (4, 2)), "fit, not usable"
        axes.plot(_GRID, curve, **line)
    if bins is None:
        bins = binned_medians(heading, error, width=SMALL_BIN_WIDTH if small else BIN_WIDTH)
    centre, median, reach = bins
    axes.vlines(centre, median - reach, median + reach, color=INK, linewidth=1.0, zorder=4)
    dots = Look(color=INK, markersize=4.5 * scale, zorder=4)
    axes.plot(centre, median, "o", label="median of the reports, 95 % interval", **dots)
    nodes, table = selection.table_error(fit)
    if usable and np.isfinite(table).all():
        turn, closed = np.append(nodes, 360.0), np.append(table, table[0])
        axes.plot(turn, closed, color=VERMILION, linewidth=1.1, linestyle=":", zorder=3.4)
        dots = Look(color=VERMILION, markersize=6.0 * scale, zorder=5, clip_on=False)
        dots |= Look(markeredgecolor="white", markeredgewidth=0.9 * scale)
        axes.plot(nodes, table, "D", label="removed by the 8-point table", **dots)
    axes.set(xlim=(0, 360), xticks=range(0, 361, 90 if small else 45), ylim=(-limit, limit))
    if not small:
        axes.set(xlabel="indicated magnetic heading (degree)", ylabel="heading error (degree)")


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
    run = Run.of(headings, fits, reference, units)
    fit = run.fit(aircraft)
    name, (heading, error) = str(fit["aircraft"].to_numpy()), run.points(aircraft)
    figure, axes = style.panels(4.1)
    draw_heading_error(axes, heading, error, fit)
    axes.set_title(f"{name} against {run.reference}:  {selection.fit_words(fit)}")
    figure.legend(loc="outside lower center", ncols=5)
    flights = plural(int(fit["flight_count"]), "flight")
    refused = f" The fit is not usable: {selection.status_words(fit['status'])}."
    return figure.say(
        f"{name}: indicated heading minus that implied by {run.reference}, n = "
        f"{plural(heading.size, 'report')} of {flights}; medians in bins of {BIN_WIDTH:.0f} "
        f"degrees. Diamonds: removed by the 8-point table ({_table_words(fit)})."
        f"{run.bias_words}{'' if published(fit['status']) else refused}"
    )


def heading_errors_figure(run: Run, names: Sequence[str]) -> Figure:
    """Draw small panels of the heading error of several aircraft on one scale."""
    shown = [(name, *run.points(name), run.fit(name)) for name in names]
    limits = [_error_limit(error, _curve(fit)) for *_, error, fit in shown]
    limit = min(_WIDEST, max(limits))
    figure, panels = small_panels(len(names))
    for axes, (name, heading, error, fit) in zip(panels, shown, strict=True):
        draw_heading_error(axes, heading, error, fit, limit=limit, small=True)
        axes.set_title(name, fontsize=9)
        axes.set_title(f"n = {heading.size:,}", fontsize=8, loc="right", weight="normal")
        axes.tick_params(labelsize=8, labelbottom=True)
    reports = sum(heading.size for _, heading, *_ in shown)
    return figure.say(
        f"Heading error (degree) against {run.reference} by indicated magnetic heading (degree), "
        f"n = {plural(reports, 'report')} of {len(names)} aircraft. Grey: at most {_SMALL_DRAWN} "
        f"reports of each; black: medians in bins of {SMALL_BIN_WIDTH:.0f} degrees; blue: fitted "
        "curve (dashed: not usable), both with 95 % intervals; orange: removed by the table "
        f"({_table_words(run.fits)}).{run.bias_words}"
    )


def small_panels(number: int) -> tuple[style.CaptionedFigure, list[Axes]]:
    """Return a figure with a number of panels of one scale, four in a row."""
    rows = -(-number // _COLUMNS)
    options = {"sharex": True, "sharey": True, "squeeze": False}
    figure, grid = style.panels(0.45 + 1.85 * rows, rows, _COLUMNS, **options)
    for axes in grid.flat[number:]:
        axes.axis("off")
    return figure, list(grid.flat[:number])


def _table_words(fits: xr.Dataset) -> str:
    return "the table" if selection.adds_error(fits) else "minus the table"


def sector_counts(heading: Floats, *, sectors: int = _SECTORS) -> NDArray[np.int64]:
    """Count reports in equal sectors of heading, the first centred on north."""
    width = 360.0 / sectors
    index = np.floor(((heading + width / 2) % 360.0) / width).astype(int)
    return np.bincount(index % sectors, minlength=sectors)


def coverage_figure(headings: xr.Dataset, names: Sequence[str]) -> Figure:
    """Draw a rose of the magnetic headings of each aircraft's screened reports."""
    columns = min(8, max(len(names), 3))
    rows = -(-len(names) // columns)
    pitch_x, pitch_y, turn = 2.45, 3.0, 360.0 / _SECTORS
    figure, axes = style.panels(min(9.6 / columns * pitch_y / pitch_x, 2.4) * rows + 0.1)
    total, circles, wedges, middle = 0, [], [], {"ha": "center", "va": "center"}
    for index, name in enumerate(names):
        reports = headings[["magnetic_heading", "screening"]]
        reports = reports.isel(report=selection.rows_of(headings, name))
        heading = reports["magnetic_heading"].to_numpy()[selection.used(reports)].astype(float)
        heading = heading[np.isfinite(heading)]
        x, y = pitch_x * (index % columns), -pitch_y * (index // columns)
        counts = sector_counts(heading)
        circles.append(Circle((x, y), 1.0))
        for place, radius in enumerate(np.sqrt(counts / max(int(counts.max()), 1))):
            east = 90.0 - turn * place  # anticlockwise from east
            wedges.append(Wedge((x, y), float(radius), east - turn / 2, east + turn / 2))
        total += heading.size
        points = int(np.count_nonzero(sector_counts(heading, sectors=8)))
        axes.text(x, y + 1.14, "N", fontsize=7, color=SOFT, **middle)
        axes.text(x, y - 1.2, name, fontsize=9, weight="bold", **middle)
        below, colour = f"{heading.size:,}, {points} of 8", INK if points == 8 else VERMILION
        axes.text(x, y - 1.48, below, fontsize=7.5, color=colour, **middle)
    axes.add_collection(PatchCollection(circles, facecolor="none", edgecolor=style.FAINT))
    look = Look(facecolor=BLUE, edgecolor="white", linewidth=0.4)
    axes.add_collection(PatchCollection(wedges, alpha=0.9, **look))
    axes.set(xlim=(-1.25, pitch_x * (columns - 1) + 1.25), aspect="equal")
    axes.set_ylim(-pitch_y * (rows - 1) - 1.7, 1.3)
    axes.axis("off")
    return figure.say(
        f"Magnetic headings of each aircraft's screened reports in {_SECTORS} sectors, north up; "
        f"areas are numbers (n = {plural(total, 'report')}, {plural(len(names), 'aircraft')}). "
        "Below: reports and compass points flown (orange: fewer than eight)."
    )
