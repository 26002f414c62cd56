"""What goes on board and into the workshop: tables as CSV, and a swing card an aircraft.

Assumes fits with tables (:func:`airswing.compass.table.add_tables`). A swing card is the
deviation card of the compass bench: for each heading to be flown, the heading to steer by the
compass, with the aircraft's identity, the data behind it and its uncertainty. Degrees.

"For" is the magnetic heading wanted, "steer" the compass heading that gives it: the m that solves
m - psi_err(m) = wanted, with the table's own interpolation.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from airswing.compass.clusters import Array
from airswing.compass.table import (
    FINE,
    NODES,
    deviation_curve,
    error_from_table,
    unit_interpolation,
)
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.products import atomic

CARDINALS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
CARD_HEADINGS = np.arange(0.0, 360.0, 30.0)
COLUMNS = (
    "aircraft",
    "reference",
    "status",
    "heading_deg",
    "table_correction_deg",
    "standard_error_deg",
    "sign",
)
Box = tuple[float, float, float, float]
"""Left, bottom, width and height, shares of the page."""
LEFT: Box = (0.015, 0.04, 0.475, 0.89)
UPPER: Box = (0.585, 0.525, 0.40, 0.405)
LOWER: Box = (0.585, 0.055, 0.40, 0.405)
_STATUS_TEXT = {code: name for name, code in STATUS.items()}


def steer(table_error: ArrayLike, wanted: ArrayLike) -> Array:
    """Compass heading to steer for a magnetic heading wanted.

    Parameters
    ----------
    table_error : array_like, shape (8,)
        Heading error at the nodes, degrees; every slope below 1 (no error of 45 degrees between
        neighbours), or there is no single answer.
    wanted : array_like, shape (n,)
        Magnetic heading, degrees.

    Returns
    -------
    array, shape (n,)
        Degrees, 0 to 360.
    """
    aim = np.asarray(wanted, dtype=np.float64)
    nodes = np.asarray(table_error, dtype=np.float64)
    # m - error(m) is piecewise linear and rising: invert it between the nodes of three turns
    compass = np.concatenate([NODES + turn for turn in (-360.0, 0.0, 360.0)])
    true = compass - np.tile(nodes, 3)
    return np.asarray(np.mod(np.interp(np.mod(aim, 360.0), true, compass), 360.0))


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write every aircraft's table, one row a node; a refused fit keeps its row and reason.

    Parameters
    ----------
    fits : Dataset
        With tables.
    path : path-like
        File to write.

    Returns
    -------
    Path
    """
    _need_tables(fits)
    target = Path(path)
    with (
        atomic(target) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        sign = str(fits.attrs.get("table_sign", "subtract_error"))
        for reference in range(fits.sizes["reference"]):
            for aircraft in range(fits.sizes["aircraft"]):
                one = fits.isel(reference=reference, aircraft=aircraft)
                writer.writerows(_table_rows(one, sign))
    return target


def _table_rows(one: xr.Dataset, sign: str) -> list[tuple[str, ...]]:
    names = (
        str(one["aircraft"].item()),
        str(one["reference"].item()),
        _STATUS_TEXT[int(one["status"])],
    )
    correction = one["table_correction"].to_numpy()
    error = _node_errors(one)
    return [
        (*names, f"{node:g}", _number(correction[k], 3), _number(error[k], 3), sign)
        for k, node in enumerate(NODES)
    ]


def _node_errors(one: xr.Dataset) -> Array:
    from airswing.compass.correction import curve_standard_error

    return np.asarray(curve_standard_error(one["deviation_covariance"].to_numpy(), NODES))


def _number(value: float, places: int) -> str:
    return "" if not np.isfinite(value) else f"{value + 0.0:.{places}f}"


def swing_card(fits: xr.Dataset, *, aircraft: str, reference: str | None = None) -> Any:
    """Draw the one-page swing card of an aircraft.

    Parameters
    ----------
    fits : Dataset
        With tables.
    aircraft : str
    reference : str, optional
        Whose fit; the first pool, else the first reference, when not given.

    Returns
    -------
    matplotlib.figure.Figure
        A5 landscape; save it as PDF, PNG or SVG.

    Raises
    ------
    InputError
        If the aircraft or reference is not there, or there are no tables.
    """
    from matplotlib.figure import Figure

    one = _select(fits, aircraft, reference)
    figure = Figure(figsize=(8.27, 5.83))
    _draw_card(figure, one)
    if int(one["status"]) == STATUS["ok"]:
        _draw_curve(figure, one)
    figure.text(
        0.5, 0.985, f"Compass swing in flight: {aircraft}", fontsize=12, fontweight="bold",
        ha="center", va="top",
    )  # fmt: skip
    return figure


def write_swing_cards(
    fits: xr.Dataset, folder: str | Path, *, reference: str | None = None, suffix: str = "pdf"
) -> list[Path]:
    """Write a swing card for every aircraft, and ``index.csv`` that lists them.

    Parameters
    ----------
    fits : Dataset
        With tables.
    folder : path-like
        Made where it is not there.
    reference : str, optional
        As for :func:`swing_card`.
    suffix : str
        pdf, png or svg.

    Returns
    -------
    list of Path
        The cards, in the order of the aircraft; the index stands beside them.
    """
    _need_tables(fits)
    place = Path(folder)
    cards, rows = [], []
    taken: set[str] = set()
    for name in (str(value) for value in fits["aircraft"].to_numpy()):
        card = place / f"{_safe(name, taken)}.{suffix}"
        with atomic(card) as temporary:
            figure = swing_card(fits, aircraft=name, reference=reference)
            figure.savefig(temporary, dpi=120, format=suffix)
        one = _select(fits, name, reference)
        rows.append(
            (
                name,
                card.name,
                _STATUS_TEXT[int(one["status"])],
                *(_number(float(one[key]), 2) for key in ("offset", "amplitude", "phase")),
            )
        )
        cards.append(card)
    with (
        atomic(place / "index.csv") as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(("aircraft", "card", "status", "offset_deg", "amplitude_deg", "phase_deg"))
        writer.writerows(rows)
    return cards


def _safe(name: str, taken: set[str]) -> str:
    """File name of an aircraft; no two alike, also where case does not tell files apart."""
    plain = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)
    plain = plain.lstrip(".")[:100] or "_"
    free, number = plain, 1
    while free.lower() in taken:
        number += 1
        free = f"{plain}_{number}"
    taken.add(free.lower())
    return free


def _need_tables(fits: xr.Dataset) -> None:
    if "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables", field="table_correction", remedy="Call add_tables first"
        )


def _select(fits: xr.Dataset, aircraft: str, reference: str | None) -> xr.Dataset:
    _need_tables(fits)
    tails = [str(value) for value in fits["aircraft"].to_numpy()]
    names = [str(value) for value in fits["reference"].to_numpy()]
    single = int(fits.attrs.get("reference_count", len(names)))
    wanted = names[single if single < len(names) else 0] if reference is None else reference
    for value, known, kind in ((aircraft, tails, "aircraft"), (wanted, names, "reference")):
        if value not in known:
            raise InputError(f"no fit for this {kind}", field=kind, found=value)
    found = fits.isel(aircraft=tails.index(aircraft), reference=names.index(wanted))
    return found.assign(table_error=error_from_table(found))


def card_rows(table_error: ArrayLike) -> list[tuple[str, str]]:
    """Rows of the deviation card: for a magnetic heading every 30 degrees, the one to steer.

    Parameters
    ----------
    table_error : array_like, shape (8,)
        Heading error at the nodes, degrees.

    Returns
    -------
    list of (str, str)
        Three-digit headings; N, E, S and W named.
    """
    names = {0: "N", 90: "E", 180: "S", 270: "W"}
    aims = steer(table_error, CARD_HEADINGS)
    return [
        (names.get(int(aim), f"{aim:03.0f}"), f"{np.rint(held) % 360:03.0f}")
        for aim, held in zip(CARD_HEADINGS, aims, strict=True)
    ]


def _draw_card(figure: Any, one: xr.Dataset) -> None:
    # Places are given: the page has one size, and finding them by measuring every word and
    # drawing twice takes several times what the drawing does.
    status = _STATUS_TEXT[int(one["status"])]
    if status != "ok":
        axes = figure.add_axes(LEFT)
        axes.axis("off")
        axes.text(0.5, 0.6, "NO CARD", ha="center", fontsize=20)
        axes.text(0.5, 0.5, f"fit refused: {status.replace('_', ' ')}", ha="center")
    else:
        rows = card_rows(one["table_error"].to_numpy())
        cells = [[*rows[k], *rows[k + 6]] for k in range(6)]
        _grid(figure, cells, ("FOR", "STEER", "FOR", "STEER"), (0.015, 0.545, 0.475, 0.385))
        _grid(figure, _node_cells(one), ("node", "", "correction", "±"), (0.015, 0.04, 0.475, 0.46))
    figure.text(
        0.2525, 0.012,
        f"against {one['reference'].item()}; {int(one['report_count'])} reports, "
        f"{int(one['flight_count'])} flights, {int(one['compass_points'])} of 8 compass points",
        fontsize=7, ha="center",
    )  # fmt: skip


def _node_cells(one: xr.Dataset) -> list[list[str]]:
    correction, error = one["table_correction"].to_numpy(), _node_errors(one)
    return [
        [CARDINALS[k], f"{node:03.0f}", f"{correction[k]:+.1f}", f"{1.96 * error[k]:.1f}"]
        for k, node in enumerate(NODES)
    ]


def _grid(figure: Any, cells: list[list[str]], head: Sequence[str], box: Box) -> None:
    axes = figure.add_axes(box)
    axes.axis("off")
    rows = [list(head), *cells]
    across, down = len(head), len(rows)
    axes.set(xlim=(0, across), ylim=(down, 0))
    line: dict[str, Any] = {"colors": "black", "linewidth": 1.0, "clip_on": False}
    axes.hlines(np.arange(down + 1), 0, across, **line)
    axes.vlines(np.arange(across + 1), 0, down, **line)
    for row, words in enumerate(rows):
        for column, word in enumerate(words):
            axes.text(column + 0.5, row + 0.5, word, fontsize=9, ha="center", va="center_baseline")


def _draw_curve(figure: Any, one: xr.Dataset) -> None:
    from airswing.compass.correction import curve_standard_error

    upper = figure.add_axes(UPPER)
    lower = figure.add_axes(LOWER, sharey=upper)
    curve = deviation_curve(one["deviation"].to_numpy(), FINE)
    wide = 1.96 * curve_standard_error(one["deviation_covariance"].to_numpy(), FINE)
    nodes = one["table_error"].to_numpy()
    for axes, first, names in ((upper, 270.0, "W N E"), (lower, 90.0, "E S W")):
        at = np.arange(first, first + 181.0)
        place = np.mod(at, 360.0)
        axes.fill_between(
            at,
            np.interp(place, FINE, curve - wide, period=360),
            np.interp(place, FINE, curve + wide, period=360),
            alpha=0.3,
        )
        axes.plot(at, np.interp(place, FINE, curve, period=360), label="fit, 95 %")
        axes.plot(at, unit_interpolation(nodes, at), lw=1, label="table")
        marks = np.arange(first, first + 181.0, 45.0)
        axes.plot(marks, unit_interpolation(nodes, marks), "o", ms=4, color="C1")
        axes.axhline(0, color="0.6", lw=0.6)
        axes.set_xticks(np.arange(first, first + 181.0, 90.0), names.split())
        axes.set_ylabel("heading error (°)")
    upper.legend(fontsize=7)
