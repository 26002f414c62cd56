"""Heading error of an aircraft against its indicated heading: the common drawing, and swing cards.

The interval of a median takes reports as independent; those of one flight are not, so it is only a
visual guide. A swing card is the deviation card of a compass swing. The file depends only on its
input: the date on a card is that of the fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from airswing.compass.correction import deviation_curve, main_reference, require_tables
from airswing.flags import STATUS, published
from airswing.physics.robust_spread import robust_sd
from airswing.products.ragged import aircraft_reports
from airswing.products.whole_files import atomic
from airswing.report import html
from airswing.report.html import BLUE, INK, SKY, SOFT, VERMILION, Look, plural
from airswing.report.run import selection
from airswing.report.run.selection import Run, curve_half_width
from airswing.units import NORMAL_95
from airswing.version import __version__

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

Floats = NDArray[np.float64]
# Degrees that divide 360: two cycles keep their shape, and each bin has reports of several flights.
BIN_WIDTH, SMALL_BIN_WIDTH = 15.0, 30.0
# Reports drawn in a small panel, where more would cover each other.
_SMALL_DRAWN = 400
# Widest common scale of small panels, degrees, so that one aircraft does not flatten the others.
_WIDEST = 25.0
_COLUMNS = 4
_GRID = np.linspace(0.0, 360.0, 121)
#: A deviation card in a cockpit has twelve rows: every 30 degrees.
CARD_HEADINGS = np.arange(0.0, 360.0, 30.0)
_POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
_A4 = (8.27, 11.69)
# The fonts that every viewer has take half the time of embedded ones; they have Latin letters only.
_PDF_FONTS: dict[RcKeyType, str | float | bool] = {
    "pdf.use14corefonts": True,
    "font.family": "Helvetica",
    "font.weight": "medium",
    "axes.labelweight": "medium",
    "axes.unicode_minus": False,
    "axes.formatter.use_mathtext": True,  # otherwise matplotlib searches for another font
}


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
    """Return half the height of a panel (degrees) that contains the curve and the reports."""
    # Beyond 60 degrees the curve would look flat.
    reach = np.max(np.abs(error), initial=0.0), np.max(np.abs(fitted)) * 1.15
    return float(np.clip(max(reach), 3.0, 60.0))


def draw_heading_error(
    axes: Axes,
    heading: Floats,
    error: Floats,
    fit: xr.Dataset,
    *,
    limit: float | None = None,
    small: bool = False,
) -> None:
    """Draw the heading error (n,) of one aircraft against its heading, degrees, in a panel.

    The heading is that of `Run.points`. `fit` is the fit of this aircraft against one reference.
    `limit` is half the height of the panel, degrees, by default from the data. A small panel, one
    of many, has fewer points, thinner lines and no axis titles.
    """
    usable, curve = bool(published(fit["status"])), _curve(fit)
    limit = _error_limit(error, curve) if limit is None else limit
    scale, every = 1.0, 1
    if small:
        scale, every = 0.6, max(-(-heading.size // _SMALL_DRAWN), 1)
    if heading.size > html.MANY and not small:
        grid = Look(gridsize=(72, 36), extent=(0, 360, -limit, limit), mincnt=1, cmap="Greys")
        axes.hexbin(heading, error, bins="log", linewidths=0.0, alpha=0.75, rasterized=True, **grid)
    else:
        alpha = float(np.clip(900.0 / max(heading.size / every, 1), 0.08, 0.6))
        dots = Look(color=SOFT, alpha=alpha, markeredgewidth=0, zorder=1.6)
        dots |= Look(markersize=1.6 if small else 2.4, rasterized=True)  # in the PDF of the cards
        axes.plot(heading[::every], error[::every], "o", **dots)
    axes.axhline(0.0, color=INK, linewidth=0.8, zorder=1.7)
    if np.isfinite(fit["deviation"].to_numpy()).any():
        half, label = curve_half_width(fit, _GRID), "95 % interval of the fit"
        band = Look(color=SKY, alpha=0.45, linewidth=0.0, zorder=2.0, label=label)
        axes.fill_between(_GRID, curve - half, curve + half, **band)
        line = Look(linestyle=(0, (4, 2)), label="fit, not usable")
        if usable:
            line = Look(linestyle="-", label="fitted curve")
        axes.plot(_GRID, curve, color=BLUE, linewidth=2.2 * scale, zorder=3, **line)
    width = SMALL_BIN_WIDTH if small else BIN_WIDTH
    centre, median, reach = binned_medians(heading, error, width=width)
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
        label = f"indicated {selection.abscissa(fit)} heading (degree)"
        axes.set(xlabel=label, ylabel="heading error (degree)")


@html.drawing()
def heading_error_figure(
    headings: xr.Dataset, fits: xr.Dataset, aircraft: str | int, reference: str | None = None
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

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the aircraft or the reference is not in the fits.
    """
    run = Run(headings, fits, reference or main_reference(fits))
    fit = run.fit(aircraft)
    name = str(fit["aircraft"].to_numpy())
    heading, error = run.points(name)
    figure, axes = html.panels(4.1)
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
    limit = min(_WIDEST, max(_error_limit(error, _curve(fit)) for *_, error, fit in shown))
    rows = -(-len(names) // _COLUMNS)
    shared = Look(sharex=True, sharey=True, squeeze=False)
    figure, panels = html.panels(0.45 + 1.85 * rows, rows, _COLUMNS, **shared)
    for axes in panels.flat[len(names) :]:
        axes.axis("off")
    for axes, (name, heading, error, fit) in zip(panels.flat, shown, strict=False):
        draw_heading_error(axes, heading, error, fit, limit=limit, small=True)
        axes.set_title(name, fontsize=9)
        axes.set_title(f"n = {heading.size:,}", fontsize=8, loc="right", weight="normal")
        axes.tick_params(labelsize=8, labelbottom=True)
    reports = sum(heading.size for _, heading, *_ in shown)
    return figure.say(
        f"Heading error (degree) against {run.reference} by indicated "
        f"{selection.abscissa(run.fits)} heading (degree), n = {plural(reports, 'report')} of "
        f"{len(names)} aircraft. Grey: at most {_SMALL_DRAWN} reports of each; black: medians in "
        f"bins of {SMALL_BIN_WIDTH:.0f} degrees; blue: fitted curve (dashed: not usable), both "
        "with 95 % intervals; orange: removed by the table "
        f"({_table_words(run.fits)}).{run.bias_words}"
    )


def _table_words(fits: xr.Dataset) -> str:
    return "the table" if selection.adds_error(fits) else "minus the table"


def steer(error: ArrayLike, wanted: ArrayLike) -> Floats:
    """Return the compass heading m to steer, m - error(m) = wanted, in [0, 360), shape (n,).

    The heading error (8,) at indicated headings 0, 45, ... 315 degrees is linear between them;
    neighbours differ by less than 45 degrees, or there is no single answer. Degrees.
    """
    values, aim = np.asarray(error, float), np.asarray(wanted, float)
    magnetic = np.arange(0.0, 360.0, 45.0) - values
    return np.asarray((aim + np.interp(aim, magnetic, values, period=360.0)) % 360.0)


@html.drawing()
def write_swing_cards(
    fits: xr.Dataset,
    headings: xr.Dataset,
    path: str | Path,
    *,
    reference: str | None = None,
) -> int:
    """Write the swing cards of all aircraft with a fit into one PDF.

    Parameters
    ----------
    fits : Dataset
        ``fits.nc`` with its 8-point tables.
    headings : Dataset
        ``headings`` of the same aircraft, in memory or lazy; read aircraft by aircraft.
    path : str or Path
        The PDF file.
    reference : str, optional
        Reference or pool; by default the first pool, else the first reference.

    Returns
    -------
    int
        Number of cards. Aircraft whose fit was refused have none; ``tables.csv`` states the reason.

    Raises
    ------
    InputError
        If the fits have no tables, or the file cannot be written.
    """
    require_tables(fits)
    run = Run(selection.drawn_columns(headings), fits, reference or main_reference(fits))
    usable = published(fits["status"].sel(reference=run.reference))
    names = selection.names_of(fits.isel(aircraft=usable))
    # Without dates, or the same cards would differ from run to run.
    metadata = {"Title": "airswing swing cards", "CreationDate": None}
    fonts = _PDF_FONTS if "".join([run.reference, *names]).isascii() else {}
    with (
        atomic(Path(path)) as temporary,
        matplotlib.rc_context(fonts),
        PdfPages(temporary, metadata=metadata) as pages,
    ):
        for name in names:
            pages.savefig(swing_card(run, name), dpi=150)
        if not names:
            empty = Figure(figsize=_A4)
            empty.text(0.1, 0.9, f"No aircraft has a fit against {run.reference}.")
            pages.savefig(empty)
    return len(names)


def swing_card(run: Run, aircraft: str) -> Figure:
    """Draw the swing card of one aircraft, an A4 page."""
    fit, figure = run.fit(aircraft), Figure(figsize=_A4)
    figure.text(0.08, 0.955, f"Compass deviation card  {aircraft}", fontsize=16, weight="bold")
    subtitle = "Magnetic compass, swung in flight. All angles in degrees."
    figure.text(0.08, 0.935, subtitle, color=SOFT)
    reports = aircraft_reports(run.headings, aircraft)
    times = np.sort(reports["time"].to_numpy()[selection.used(reports)]).astype("M8[D]")
    date = str(fit.attrs.get("history", "")).split("T")[0] or "-"
    argument, decimals = selection.abscissa(fit), selection.table_digits(fit)
    behind = [plural(int(fit[f"{name}_count"]), name) for name in ("report", "flight")]
    facts = {
        "Reference": f"{run.reference} (model winds)",
        "Period": f"{' to '.join(map(str, times[[0, -1]])) if times.size else '-'} (UTC)",
        "Reports": f"{' of '.join(behind)}, {int(fit['compass_points'])} of 8 compass points",
        "Units": f"degrees; headings {argument}, as indicated",
        "Made": f"{date} with airswing {fit.attrs.get('airswing_version', __version__)}",
    }
    lines = Look(va="top", linespacing=1.5)
    figure.text(0.08, 0.915, "\n".join(facts), color=SOFT, fontsize=9, **lines)
    figure.text(0.22, 0.915, "\n".join(facts.values()), color=INK, fontsize=9, **lines)
    advice = "Load the table below."
    if selection.needs_no_correction(fit):
        advice = "No correction needed: the deviation is zero within its 95 % interval."
    elif int(fit["status"]) == STATUS["offset_only"]:
        advice = "Constant correction only: too few headings or flights for a curve."
    figure.text(0.08, 0.795, advice, fontsize=12, weight="bold", va="top")
    axes = figure.add_axes((0.11, 0.53, 0.82, 0.235))
    draw_heading_error(axes, *run.points(aircraft), fit)
    axes.legend(loc="upper center", bbox_to_anchor=(0.47, -0.16), ncols=4, fontsize=8)
    nodes, error = selection.table_error(fit)
    aims = [_POINTS[aim // 45] if aim % 90 == 0 else f"{aim:03d}" for aim in range(0, 360, 30)]
    steered = [f"{np.rint(angle) % 360:03.0f}" for angle in steer(error, CARD_HEADINGS)]
    meaning = "heading error, to subtract" if selection.adds_error(fit) else "to add"
    # left end, title, and columns: right end, title, cells
    tables = (
        (
            0.08,
            "8-point table for the unit",
            (0.10, "", _POINTS),
            (0.32, "indicated", [f"{node:03.0f}" for node in nodes]),
            (0.66, meaning, [f"{x + 0.0:+.{decimals}f}" for x in fit["table_correction"].values]),
            (0.94, "± 95 %", [f"{half:.1f}" for half in curve_half_width(fit, nodes)]),
        ),
        (
            0.53,
            f"Deviation card ({argument} headings)",
            (0.15, "FOR", aims[:6]),
            (0.38, "STEER", steered[:6]),
            (0.67, "FOR", aims[6:]),
            (0.90, "STEER", steered[6:]),
        ),
    )
    for left, title, *columns in tables:
        axes = figure.add_axes((left, 0.225, 0.40, 0.215))
        axes.axis("off")
        axes.set(xlim=(0, 1), ylim=(0, 1))
        axes.text(0, 1.0, title, weight="bold", fontsize=10, va="bottom")
        axes.axhline(0.885, color=SOFT, linewidth=0.8)
        look = Look(ha="right", fontsize=9)
        for x, label, cells in columns:
            axes.text(x, 0.93, label, color=SOFT, va="center", **look)
            # one text a column: each text takes a millisecond
            axes.text(x, 0.85, "\n".join(cells), va="top", linespacing=19.5 / len(cells), **look)
    coefficients = ",  ".join(f"{k} = {v}" for k, v in selection.coefficient_texts(fit).items())
    deviation, sizes, largest = selection.formula(fit)
    words = [
        deviation,
        f"{coefficients}   (± 95 %)",
        f"{selection.fit_words(fit)}. {sizes}",
        largest,
        run.bias_words.strip(),
    ]
    figure.text(0.08, 0.2, "\n".join(words), color=INK, fontsize=8, **lines)
    blanks = {"Checked by": (0.08, 0.35), "Date": (0.39, 0.58), "Signature": (0.62, 0.93)}
    for label, ends in blanks.items():
        figure.text(ends[0], 0.06, label, fontsize=8, color=SOFT)
        figure.add_artist(Line2D(ends, [0.075, 0.075], color=INK, linewidth=0.8))
    return figure
