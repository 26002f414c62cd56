"""Swing cards: a PDF with a page for each aircraft that has a deviation fit.

A swing card is the deviation card of a compass swing: the 8-point table for the unit, the compass
heading to steer for each magnetic heading, the deviation's formula and the data behind them. The
file depends only on its input: the date on the card is that of the fits.
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
from numpy.typing import ArrayLike, NDArray

from airswing.errors import InputError
from airswing.flags import STATUS, published
from airswing.products.whole_files import atomic
from airswing.report.html.style import INK, SOFT, Look, drawing
from airswing.report.html.text import Units, plural
from airswing.report.run import selection
from airswing.report.run.heading_error import draw_heading_error
from airswing.report.run.selection import Run
from airswing.version import __version__

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

Floats = NDArray[np.float64]
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


def steer(error: ArrayLike, wanted: ArrayLike) -> Floats:
    """Return the compass heading m to steer, m - error(m) = wanted, in [0, 360), shape (n,).

    The heading error (8,) at indicated headings 0, 45, ... 315 degrees is linear between them;
    neighbours differ by less than 45 degrees, or there is no single answer. Degrees.
    """
    values = np.asarray(error, dtype=np.float64)
    nodes = np.arange(0.0, 360.0, 360.0 / values.size)
    # m - error(m) is piecewise linear and increases: invert it between the nodes of three turns.
    compass = np.concatenate([nodes + turn for turn in (-360.0, 0.0, 360.0)])
    magnetic = compass - np.tile(values, 3)
    aim = np.mod(np.asarray(wanted, dtype=np.float64), 360.0)
    return np.asarray(np.mod(np.interp(aim, magnetic, compass), 360.0))


@drawing()
def write_swing_cards(
    fits: xr.Dataset,
    headings: xr.Dataset,
    path: str | Path,
    *,
    reference: str | None = None,
    units: Units = "kt",
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
    units : {"kt", "m/s"}, optional
        Unit of speeds.

    Returns
    -------
    int
        Number of cards. Aircraft whose fit was refused have none; ``tables.csv`` states the reason.

    Raises
    ------
    InputError
        If the fits have no tables, or the file cannot be written.
    """
    if "table_correction" not in fits:
        raise InputError(
            "the fits contain no tables", field="table_correction", remedy="Call add_tables first"
        )
    run = Run.of(selection.drawn_columns(headings), fits, reference, units)
    usable = published(fits["status"].sel(reference=run.reference))
    chosen = selection.names_of(fits.isel(aircraft=usable))
    # Without dates, or the same cards would differ from run to run.
    metadata = {"Title": "airswing swing cards", "CreationDate": None}
    fonts = _PDF_FONTS if "".join([run.reference, *chosen]).isascii() else {}
    with (
        atomic(Path(path)) as temporary,
        matplotlib.rc_context(fonts),
        PdfPages(temporary, metadata=metadata) as pages,
    ):
        for name in chosen:
            pages.savefig(swing_card(run, name), dpi=150)
        if not chosen:
            empty = Figure(figsize=_A4)
            empty.text(0.1, 0.9, f"No aircraft has a fit against {run.reference}.")
            pages.savefig(empty)
    return len(chosen)


def swing_card(run: Run, aircraft: str) -> Figure:
    """Draw the swing card of one aircraft, an A4 page."""
    fit, figure = run.fit(aircraft), Figure(figsize=_A4)
    figure.text(0.08, 0.955, f"Compass deviation card  {aircraft}", fontsize=16, weight="bold")
    subtitle = "Magnetic compass, swung in flight. All angles in degrees."
    figure.text(0.08, 0.935, subtitle, color=SOFT)
    facts = _facts(run, aircraft, fit)
    _lines(figure, 0.08, 0.915, list(facts), SOFT)
    _lines(figure, 0.22, 0.915, list(facts.values()), INK)
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
    correction = fit["table_correction"].to_numpy().astype(float) + 0.0
    half = selection.curve_half_width(fit, nodes)
    what = "heading error, to subtract" if selection.adds_error(fit) else "to add"
    columns = [
        (0.10, "", list(_POINTS)),
        (0.32, "indicated", [f"{node:03.0f}" for node in nodes]),
        (0.66, what, [f"{value:+.1f}" for value in correction]),
        (0.94, "± 95 %", [f"{value:.1f}" for value in half]),
    ]
    _columns(figure.add_axes((0.08, 0.225, 0.40, 0.215)), "8-point table for the unit", columns)
    names = {0: "N", 90: "E", 180: "S", 270: "W"}
    aims = [names.get(int(aim), f"{aim:03.0f}") for aim in CARD_HEADINGS]
    steered = [f"{np.rint(one) % 360:03.0f}" for one in steer(error, CARD_HEADINGS)]
    columns = [
        (0.15, "FOR", aims[:6]),
        (0.38, "STEER", steered[:6]),
        (0.67, "FOR", aims[6:]),
        (0.90, "STEER", steered[6:]),
    ]
    title = "Deviation card (magnetic headings)"
    _columns(figure.add_axes((0.53, 0.225, 0.40, 0.215)), title, columns)
    coefficients = ",  ".join(f"{k} = {v}" for k, v in selection.coefficient_texts(fit).items())
    words = [
        selection.FORMULA[0],
        f"{coefficients}   (± 95 %)",
        f"{selection.fit_words(fit)}. {selection.FORMULA[1]}",
        selection.FORMULA[2],
        run.bias_words.strip(),
    ]
    _lines(figure, 0.08, 0.2, words, INK, fontsize=8)
    for x, right, label in (
        (0.08, 0.35, "Checked by"),
        (0.39, 0.58, "Date"),
        (0.62, 0.93, "Signature"),
    ):
        figure.text(x, 0.06, label, fontsize=8, color=SOFT)
        rule = matplotlib.lines.Line2D([x, right], [0.075, 0.075], color=INK, linewidth=0.8)
        figure.add_artist(rule)
    return figure


def _facts(run: Run, aircraft: str, fit: xr.Dataset) -> dict[str, str]:
    rows = selection.rows_of(run.headings, aircraft)
    reports = run.headings[["time", "screening"]].isel(report=rows).load()
    times = np.sort(reports["time"].to_numpy()[selection.used(reports)]).astype("M8[D]")
    made = str(fit.attrs.get("history", "")).split("T")[0] or "-"
    behind = [plural(int(fit[f"{name}_count"]), name) for name in ("report", "flight")]
    points = f"{int(fit['compass_points'])} of 8 compass points"
    return {
        "Reference": f"{run.reference} (model winds)",
        "Period": f"{' to '.join(map(str, times[[0, -1]])) if times.size else '-'} (UTC)",
        "Reports": f"{' of '.join(behind)}, {points}",
        "Units": "degrees; headings magnetic, as indicated",
        "Made": f"{made} with airswing {fit.attrs.get('airswing_version', __version__)}",
    }


def _lines(
    figure: Figure, x: float, top: float, lines: Sequence[str], color: str, *, fontsize: float = 9
) -> None:
    look = Look(color=color, fontsize=fontsize, va="top", linespacing=1.5)
    figure.text(x, top, "\n".join(lines), **look)


def _columns(axes: Axes, title: str, columns: list[tuple[float, str, list[str]]]) -> None:
    """Write columns of text (place, title, cells) with a rule below their titles."""
    axes.axis("off")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.text(0, 1.0, title, weight="bold", fontsize=10, va="bottom")
    axes.axhline(0.885, color=SOFT, linewidth=0.8)
    for x, label, cells in columns:
        look = Look(ha="right", fontsize=9)
        axes.text(x, 0.93, label, color=SOFT, va="center", **look)
        # one text a column: each text takes a millisecond
        axes.text(x, 0.85, "\n".join(cells), va="top", linespacing=19.5 / len(cells), **look)
