"""The page of a swing card: two grids of words and the curve, drawn over again for each aircraft.

Assumes a page of one size (A5 landscape) and curves in degrees that are finite. The page is laid
out once and takes the next aircraft's words and curves: making a page takes as long as drawing it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from airswing.compass.fit.sandwich import Array

SIZE = (8.27, 5.83)
"""Inches."""
Box = tuple[float, float, float, float]
"""Left, bottom, width and height, shares of the page."""
CARD_BOX: Box = (0.015, 0.545, 0.475, 0.385)
NODE_BOX: Box = (0.015, 0.04, 0.475, 0.46)
PANELS: tuple[Box, Box] = ((0.585, 0.525, 0.40, 0.405), (0.585, 0.055, 0.40, 0.405))
FIRST = (270.0, 90.0)
"""Heading at the left of each panel, half a turn on each, degrees."""


class Curves(NamedTuple):
    """What the panels show against the turn from their first heading; degrees.

    Parameters
    ----------
    low, high, fit, table : lists of two arrays, shape (181,)
        Band, curve and table in each panel, a degree apart.
    """

    low: list[Array]
    high: list[Array]
    fit: list[Array]
    table: list[Array]


class CardPage:
    """A page that shows one aircraft after the other.

    Parameters
    ----------
    heads : two sequences of str
        Heads of the columns of the card and of the table at its nodes.
    rows : (int, int)
        Rows of each below its head.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
    """

    def __init__(self, heads: tuple[Sequence[str], Sequence[str]], rows: tuple[int, int]) -> None:
        self.figure = Figure(figsize=SIZE)
        self._heads = heads
        self._cells = [
            cell
            for box, head, down in zip((CARD_BOX, NODE_BOX), heads, rows, strict=True)
            for cell in _grid(self.figure, box, down + 1, len(head))
        ]
        self._panels = [
            _panel(self.figure.add_axes(box), first)
            for box, first in zip(PANELS, FIRST, strict=True)
        ]
        self._title, self._foot = _title_and_foot(self.figure, "", "")

    def show(
        self, title: str, foot: str, rows: tuple[Sequence[Sequence[str]], ...], curves: Curves
    ) -> Figure:
        """Put an aircraft on the page in place of the one before.

        Parameters
        ----------
        title, foot : str
        rows : two sequences of rows of str
            Of the card and of the table at its nodes.
        curves : Curves

        Returns
        -------
        matplotlib.figure.Figure
        """
        self._title.set_text(title)
        self._foot.set_text(foot)
        words = [
            word
            for head, below in zip(self._heads, rows, strict=True)
            for row in (head, *below)
            for word in row
        ]
        for cell, word in zip(self._cells, words, strict=True):
            cell.set_text(word)
        parts = np.concatenate([*curves.low, *curves.high, *curves.table, [0.0]])
        room = 0.05 * max(float(np.ptp(parts)), 0.1)
        for number, (axes, band, fit, table) in enumerate(self._panels):
            turn = np.arange(curves.fit[number].size)
            band.set_data(turn, curves.low[number], curves.high[number])
            fit.set_data(turn, curves.fit[number])
            table.set_data(turn, curves.table[number])
            axes.set_ylim(parts.min() - room, parts.max() + room)
        return self.figure


def _panel(axes: Axes, first: float) -> tuple[Axes, Any, Any, Any]:
    """A panel of half a turn with its band, curve and table, without values yet."""
    axes.axhline(0.0, color="0.6", lw=0.6)
    band = axes.fill_between([], [], [], color="C0", alpha=0.3, lw=0)
    (fit,) = axes.plot([], [], color="C0", lw=1.5, label="fit, 95 %")
    (table,) = axes.plot([], [], color="C1", lw=1, marker="o", ms=4, markevery=45, label="table")
    axes.set_xlim(-9.0, 189.0)
    axes.set_xticks([0, 90, 180], ["NESW"[int(first + turn) % 360 // 90] for turn in (0, 90, 180)])
    axes.set_ylabel("heading error (°)", labelpad=2)
    if first == FIRST[0]:
        axes.legend(
            fontsize=7,
            ncols=2,
            frameon=False,
            loc="lower right",
            bbox_to_anchor=(1, 0.98),
            borderpad=0.2,
        )
    return axes, band, fit, table


def refused_page(title: str, foot: str, why: str) -> Figure:
    """A page that says why there is no card.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=SIZE)
    axes = figure.add_axes((*NODE_BOX[:2], NODE_BOX[2], CARD_BOX[1] + CARD_BOX[3] - NODE_BOX[1]))
    axes.axis("off")
    axes.text(0.5, 0.6, "NO CARD", ha="center", fontsize=20)
    axes.text(0.5, 0.5, why, ha="center")
    _title_and_foot(figure, title, foot)
    return figure


def _title_and_foot(figure: Figure, title: str, foot: str) -> tuple[Any, Any]:
    plain: dict[str, Any] = {"ha": "center", "parse_math": False}  # a name may hold any letter
    return (
        figure.text(0.5, 0.985, title, fontsize=12, fontweight="bold", va="top", **plain),
        figure.text(0.2525, 0.012, foot, fontsize=7, **plain),
    )


def _grid(figure: Figure, box: Box, down: int, across: int) -> list[Any]:
    """Rules of a grid, and its cells' words row by row from the top, empty yet."""
    left, bottom, width, height = box
    level = bottom + height * np.arange(down + 1) / down
    upright = left + width * np.arange(across + 1) / across
    rules = [[(left, y), (left + width, y)] for y in level]
    rules += [[(x, bottom), (x, bottom + height)] for x in upright]
    lines = LineCollection(rules, colors="black", linewidths=1, transform=figure.transSubfigure)
    figure.add_artist(lines)
    x, y = upright[:-1] + 0.5 * width / across, level[:-1][::-1] + 0.5 * height / down
    style: dict[str, Any] = {"fontsize": 9, "ha": "center", "va": "center_baseline"}
    return [figure.text(across_, up, "", **style) for up in y for across_ in x]
