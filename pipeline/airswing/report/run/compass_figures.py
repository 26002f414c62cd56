"""One aircraft's compass: which headings it flew, its heading error, fit and table.

Assumes the fits of docs/formats.md: psi_err = A + B sin m + C cos m + D sin 2m + E cos 2m with m
the indicated magnetic heading, degrees, and reports that passed the screening.  Binned medians
carry a 95 % interval of the median that takes reports as independent (a guide for the eye,
too narrow within flights); bands are 1.96 standard errors of
the clustered covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from numpy.typing import NDArray

from airswing.flags import published
from airswing.physics.robust_spread import robust_sd
from airswing.report.html.style import (
    BLUE,
    FAINT,
    INK,
    MANY,
    SKY,
    SOFT,
    VERMILION,
    compass_axis,
    new_figure,
    plural,
    styled,
    thousands,
)
from airswing.report.run.selection import (
    compass_points,
    curve_with_error,
    fitted_bias,
    headline_reference,
    one_fit,
    rows_of,
    status_words,
    table_error,
    tails,
    used,
)
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Degrees, of a turn: two cycles keep their shape, and each bin has reports of several flights.
BIN_WIDTH = 15.0
_SECTORS = 24


class Binned(NamedTuple):
    """Medians of a value in bins of heading, with the half width of a 95 % interval."""

    centre: Floats
    median: Floats
    half_width: Floats
    number: NDArray[np.int64]


def binned_medians(heading: Floats, value: Floats, *, width: float = BIN_WIDTH) -> Binned:
    """Median of a value in each bin of heading that holds at least five reports.

    Parameters
    ----------
    heading : array (n,)
        Degrees.
    value : array (n,)
        Any unit.
    width : float, optional
        Bin width, degrees; divides 360.

    Returns
    -------
    Binned
        One entry a bin; the interval is 1.96 x 1.2533 x 1.4826 MAD / sqrt(number).
    """
    bins = np.floor((heading % 360.0) / width).astype(int)
    rows = []
    for index in np.unique(bins):
        inside = value[bins == index]
        if inside.size >= 5:
            middle = float(np.median(inside))
            # a median errs sqrt(pi / 2) = 1.2533 times as much as a mean
            half = NORMAL_95 * 1.2533 * robust_sd(inside, middle) / np.sqrt(inside.size)
            rows.append(((index + 0.5) * width, middle, half, inside.size))
    table = np.array(rows, float).reshape(-1, 4)
    return Binned(table[:, 0], table[:, 1], table[:, 2], table[:, 3].astype(np.int64))


def error_limit(error: Floats, fitted: Floats) -> float:
    """Half height of a heading error panel, degrees: holds the curve and most reports."""
    # One report in forty may lie outside; beyond 60 degrees a panel would show no curve.
    spread = np.percentile(np.abs(error), 97.5) if error.size else 5.0
    least = float(np.max(np.abs(fitted))) * 1.15 if fitted.size else 0.0
    return float(np.clip(max(spread, least, 3.0), 3.0, 60.0))


def _draw_reports(axes: Axes, heading: Floats, error: Floats, limit: float) -> None:
    if heading.size > MANY:
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
    alpha = float(np.clip(900.0 / max(heading.size, 1), 0.08, 0.6))
    axes.scatter(
        heading, error, s=5.0, color=SOFT, alpha=alpha, linewidths=0, rasterized=True, zorder=1.6
    )


def _draw_heading_error(
    axes: Axes, headings: xr.Dataset, fits: xr.Dataset, aircraft: str | int, reference: str
) -> int:
    """Draw one aircraft's heading error, fit and table in a panel; return the reports shown."""
    heading, error = compass_points(headings, fits, aircraft, reference)
    fit = one_fit(fits, aircraft, reference)
    grid = np.linspace(0.0, 360.0, 181)
    fitted, half = curve_with_error(fit, grid)
    limit = error_limit(error, fitted)
    _draw_reports(axes, heading, error, limit)
    axes.axhline(0.0, color=INK, linewidth=0.8, zorder=1.7)
    trusted = bool(published(fit["status"]))
    if np.isfinite(fit["deviation"].to_numpy()).any():
        _draw_curve(axes, grid, fitted, NORMAL_95 * half, trusted=trusted)
    bins = binned_medians(heading, error)
    axes.errorbar(
        bins.centre,
        bins.median,
        bins.half_width,
        fmt="o",
        color=INK,
        zorder=4,
        markersize=4.5,
        linewidth=1.0,
        label="median, 95 % interval",
    )
    if trusted:
        _draw_table(axes, *table_error(fit))
    axes.set_ylim(-limit, limit)
    compass_axis(axes)
    return int(heading.size)


def _draw_curve(axes: Axes, grid: Floats, fitted: Floats, half: Floats, *, trusted: bool) -> None:
    """Draw the fitted curve over its interval of half width `half`."""
    axes.fill_between(
        grid,
        fitted - half,
        fitted + half,
        color=SKY,
        alpha=0.45,
        linewidth=0,
        zorder=2,
        label="95 % interval of the fit",
    )
    axes.plot(
        grid,
        fitted,
        color=BLUE,
        linestyle="-" if trusted else (0, (4, 2)),
        linewidth=2.2,
        zorder=3,
        label="fitted curve" if trusted else "fit, not to be trusted",
    )


def _draw_table(axes: Axes, nodes: Floats, error: Floats) -> None:
    """Draw the 8-point table and the straight lines between its points."""
    if not np.isfinite(error).all():
        return
    axes.plot(
        np.append(nodes, 360.0),
        np.append(error, error[0]),
        color=VERMILION,
        linewidth=1.1,
        linestyle=":",
        zorder=3.4,
    )
    axes.plot(
        nodes,
        error,
        "D",
        color=VERMILION,
        markersize=6.0,
        markeredgecolor="white",
        markeredgewidth=0.9,
        zorder=5,
        clip_on=False,
        label="8-point table",
    )


def fit_words(fit: xr.Dataset) -> str:
    """Return a fit in one short line: offset, amplitude and phase with 95 % intervals."""
    if not published(fit["status"]):
        return f"no fit: {status_words(fit['status'])}"
    if not np.isfinite(float(fit["amplitude"])):
        half_width = NORMAL_95 * float(fit["offset_standard_error"])
        return f"offset alone {float(fit['offset']):+.2f} ± {half_width:.2f}°"
    half = {
        name: NORMAL_95 * float(fit[f"{name}_standard_error"])
        for name in ("offset", "amplitude", "phase")
    }
    return (
        f"offset {float(fit['offset']):+.2f} ± {half['offset']:.2f}°, "
        f"amplitude {float(fit['amplitude']):.2f} ± {half['amplitude']:.2f}°, "
        f"phase {float(fit['phase']):.0f} ± {half['phase']:.0f}°"
    )


@styled
def heading_error_figure(
    headings: xr.Dataset, fits: xr.Dataset, aircraft: str | int, reference: str | None = None
) -> Figure:
    """Heading error against magnetic heading for one aircraft (the seed's Fig. 5).

    Parameters
    ----------
    headings : Dataset
        HEADINGS: ``heading_error`` (reference, report), ``magnetic_heading``, ``screening``.
    fits : Dataset
        FITS, see docs/formats.md.
    aircraft : str or int
        Identifier or position.
    reference : str, optional
        Reference or pool; by default the first pool, else the first reference.

    Raises
    ------
    InputError
        If the aircraft or the reference is not in the fits.
    """
    reference = reference or headline_reference(fits, headings)
    fit = one_fit(fits, aircraft, reference)
    name = str(fit["aircraft"].to_numpy())
    figure = new_figure(4.1)
    axes = figure.add_subplot()
    number = _draw_heading_error(axes, headings, fits, aircraft, reference)
    axes.set_ylabel("heading error (degree)")
    axes.set_title(f"{name} against {reference}:  {fit_words(fit)}")
    figure.legend(loc="outside lower center", ncols=5)
    flights = int(fit["flight_count"])
    state = status_words(fit["status"])
    trust = "" if published(fit["status"]) else f" The fit is not to be trusted: {state}."
    return figure.say(
        f"{name}: heading error (indicated minus the heading {reference} implies) against "
        f"indicated magnetic heading, n = {plural(number, 'report')} of "
        f"{plural(flights, 'flight')}; medians in bins of {BIN_WIDTH:.0f} degrees, fitted curve, "
        f"and what the 8-point table stands for.{bias_words(fits, reference)}{trust}"
    )


def bias_words(fits: xr.Dataset, reference: str) -> str:
    """What was taken out of the points, as a sentence after a blank; empty where nothing was."""
    eastward, northward = fitted_bias(fits, reference)
    if not (eastward or northward):
        return ""
    return (
        f" The reference's fitted bias ({eastward:+.2f} m/s eastward, {northward:+.2f} m/s "
        "northward) is taken out of the points."
    )


def sector_counts(heading: Floats, *, sectors: int = _SECTORS) -> NDArray[np.int64]:
    """Count reports in equal sectors, the first centred on north."""
    width = 360.0 / sectors
    index = np.floor(((heading + width / 2) % 360.0) / width).astype(int)
    return np.bincount(index % sectors, minlength=sectors)


def _rose(axes: Axes, middle: tuple[float, float], counts: NDArray[np.int64]) -> None:
    share = np.sqrt(counts / max(int(counts.max()), 1))
    width = 360.0 / counts.size
    wedges = [
        Wedge(middle, float(r), 90 - (i + 0.5) * width, 90 - (i - 0.5) * width)
        for i, r in enumerate(share)
        if r > 0
    ]
    axes.add_collection(
        PatchCollection([Circle(middle, 1.0)], facecolor="none", edgecolor=FAINT, linewidth=0.8)
    )
    axes.add_collection(
        PatchCollection(wedges, facecolor=BLUE, edgecolor="white", linewidth=0.4, alpha=0.9)
    )


@styled
def coverage_figure(headings: xr.Dataset, aircraft: list[str] | None = None) -> Figure:
    """Rose of the magnetic headings each aircraft flew, of reports that passed screening.

    Parameters
    ----------
    headings : Dataset
        With ``magnetic_heading``, ``screening`` (report) and ``row_size``.
    aircraft : list of str, optional
        Identifiers; all by default.
    """
    aircraft = aircraft or tails(headings)
    columns = min(8, max(len(aircraft), 3))
    rows = -(-len(aircraft) // columns)
    pitch_x, pitch_y = 2.45, 3.0
    figure = new_figure(min(9.6 / columns * pitch_y / pitch_x, 2.4) * rows + 0.1)
    axes = figure.add_axes((0, 0, 1, 1))
    total = 0
    for index, name in enumerate(aircraft):
        rows_slice = rows_of(headings, name)
        keep = used(headings, rows_slice)
        heading = headings["magnetic_heading"].isel(report=rows_slice).to_numpy()[keep]
        heading = np.asarray(heading[np.isfinite(heading)], float)
        counts = sector_counts(heading)
        x, y = pitch_x * (index % columns), -pitch_y * (index // columns)
        _rose(axes, (x, y), counts)
        total += heading.size
        points = int(np.count_nonzero(sector_counts(heading, sectors=8)))
        colour = INK if points == 8 else VERMILION
        axes.text(x, y + 1.14, "N", ha="center", va="center", fontsize=7, color=SOFT)
        axes.text(x, y - 1.2, f"{name}", ha="center", va="center", fontsize=9, weight="bold")
        axes.text(
            x,
            y - 1.48,
            f"{thousands(heading.size)}, {points} of 8",
            ha="center",
            va="center",
            fontsize=7.5,
            color=colour,
        )
    axes.set_xlim(-1.25, pitch_x * (columns - 1) + 1.25)
    axes.set_ylim(-pitch_y * (rows - 1) - 1.7, 1.3)
    axes.set_aspect("equal")
    axes.axis("off")
    figure.set_layout_engine("none")
    return figure.say(
        f"Headings flown: each rose shows the magnetic headings of one aircraft's reports that "
        f"passed the screening, in {_SECTORS} sectors, north up; area is proportional to number "
        f"(n = {plural(total, 'report')}, {plural(len(aircraft), 'aircraft', 'aircraft')}). Below "
        "each: reports, and how many of the eight compass points they touch (orange: fewer than "
        "eight)."
    )
