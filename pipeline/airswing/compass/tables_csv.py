"""What goes on board and into the workshop: tables as CSV, and a swing card for each.

Assumes fits with tables (:func:`airswing.compass.table.add_tables`). A swing card is the
deviation card of the compass bench: for each heading to be flown, the heading to steer by the
compass, with the aircraft's identity, the data behind it and its uncertainty. Degrees.

"For" is the magnetic heading wanted, "steer" the compass heading that gives it: the m that solves
m - psi_err(m) = wanted, with the table's own interpolation.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from airswing.compass.cardpage import FIRST, CardPage, Curves
from airswing.compass.correction import chosen_reference, curve_standard_error
from airswing.compass.fit.sandwich import Array
from airswing.compass.table import (
    FINE,
    NODES,
    deviation_curve,
    error_from_table,
    unit_interpolation,
)
from airswing.errors import InputError
from airswing.flags import STATUS, published
from airswing.products.whole_files import atomic
from airswing.units import NORMAL_95

CARDINALS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
# A swing card of a cockpit has twelve rows: every 30 degrees.
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
_STATUS_TEXT = {code: name for name, code in STATUS.items()}


def steer(table_error: ArrayLike, wanted: ArrayLike) -> Array:
    """Compass heading to steer (degrees) for magnetic headings wanted (degrees).

    Every slope of the table error (8,) is below 1 (no error of 45 degrees between neighbours), or
    there is no single answer.
    """
    aim = np.asarray(wanted, dtype=np.float64)
    nodes = np.asarray(table_error, dtype=np.float64)
    # m - error(m) is piecewise linear and rising: invert it between the nodes of three turns
    compass = np.concatenate([NODES + turn for turn in (-360.0, 0.0, 360.0)])
    true = compass - np.tile(nodes, 3)
    return np.asarray(np.mod(np.interp(np.mod(aim, 360.0), true, compass), 360.0))


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write every aircraft's table, one row a node; a refused fit keeps its row and reason."""
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
    return np.asarray(curve_standard_error(one["deviation_covariance"].to_numpy(), NODES))


def _number(value: float, places: int) -> str:
    return "" if not np.isfinite(value) else f"{value + 0.0:.{places}f}"


def write_swing_cards(
    fits: xr.Dataset,
    folder: str | Path,
    *,
    reference: str | None = None,
    suffix: str = "pdf",
    stand: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write a swing card for every aircraft that has a table, and ``index.csv`` that lists all.

    Parameters
    ----------
    reference : str, optional
        Whose fit; the first pool, else the first reference, when not given.
    suffix : str
        pdf, png or svg.
    stand : mapping of str to str, optional
        Aircraft whose card stands under that name and is not drawn again.

    Returns
    -------
    list of Path
        The cards, in the order of the aircraft; the index stands beside them and says of aircraft
        without one why.
    """
    _need_tables(fits)
    place, drawing = Path(folder), _Drawing()
    chosen = fits.isel(reference=chosen_reference(fits, reference))
    status = chosen["status"].to_numpy()
    shape = [chosen[key].to_numpy() for key in ("offset", "amplitude", "phase")]
    cards, rows, known = [], [], stand or {}
    taken: set[str] = set()
    for number, name in enumerate(str(value) for value in fits["aircraft"].to_numpy()):
        card = place / f"{_safe(name, taken)}.{suffix}"
        if drawn := bool(published(status[number])):
            cards.append(card)
        if drawn and known.get(name) != card.name:
            with atomic(card) as temporary:
                one = _with_error(chosen.isel(aircraft=number))
                drawing.of(one).savefig(temporary, dpi=120, format=suffix)
        rows.append(
            (
                name,
                card.name if drawn else "",
                _STATUS_TEXT[int(status[number])],
                *(_number(float(values[number]), 2) for values in shape),
            )
        )
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


def _with_error(one: xr.Dataset) -> xr.Dataset:
    return one.assign(table_error=error_from_table(one))


def _card_rows(table_error: ArrayLike) -> list[tuple[str, str]]:
    """Rows of the deviation card: for a magnetic heading every 30 degrees, the one to steer."""
    names = {0: "N", 90: "E", 180: "S", 270: "W"}
    aims = steer(table_error, CARD_HEADINGS)
    return [
        (names.get(int(aim), f"{aim:03.0f}"), f"{np.rint(held) % 360:03.0f}")
        for aim, held in zip(CARD_HEADINGS, aims, strict=True)
    ]


class _Drawing:
    """Cards of one aircraft after the other, those with a table on one page drawn over again."""

    def __init__(self) -> None:
        heads = ("FOR", "STEER", "FOR", "STEER"), ("node", "", "correction", "±")
        self._page = CardPage(heads, (6, NODES.size))

    def of(self, one: xr.Dataset) -> Figure:
        """Figure of a card, until the next is drawn."""
        title = f"Compass swing in flight: {one['aircraft'].item()}"
        foot = (
            f"against {one['reference'].item()}; {int(one['report_count'])} reports, "
            f"{int(one['flight_count'])} flights, {int(one['compass_points'])} of 8 compass points"
        )
        if int(one["status"]) == STATUS["offset_only"]:
            foot += "; offset alone"
        rows = _card_rows(one["table_error"].to_numpy())
        cells = [[*rows[k], *rows[k + 6]] for k in range(6)]
        return self._page.show(title, foot, (cells, _node_cells(one)), _curves(one))


def _node_cells(one: xr.Dataset) -> list[list[str]]:
    correction, error = one["table_correction"].to_numpy(), _node_errors(one)
    return [
        [CARDINALS[k], f"{node:03.0f}", f"{correction[k]:+.1f}", f"{NORMAL_95 * error[k]:.1f}"]
        for k, node in enumerate(NODES)
    ]


def _curves(one: xr.Dataset) -> Curves:
    curve = deviation_curve(one["deviation"].to_numpy(), FINE)
    wide = NORMAL_95 * curve_standard_error(one["deviation_covariance"].to_numpy(), FINE)
    nodes = one["table_error"].to_numpy()
    # half a turn a panel, both ends drawn
    at = [np.arange(first, first + 181.0) for first in FIRST]
    low, high, fit = (
        [np.interp(np.mod(place, 360.0), FINE, values, period=360) for place in at]
        for values in (curve - wide, curve + wide, curve)
    )
    return Curves(low, high, fit, [unit_interpolation(nodes, place) for place in at])
