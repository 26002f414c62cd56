"""The page of a swing card: two grids of words and the curve, drawn over again for each aircraft.

Assumes a page of one size (A5 landscape) on which every place is known beforehand, and curves in
degrees that are finite. The page is laid out once and takes the next aircraft's words and curves:
making the artists anew, and letting axes look for their ticks, margins and the legend's place,
takes most of the time. Places are shares of the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from airswing.compass.fit.sandwich import Array

SIZE = (8.27, 5.83)
"""Inches."""
Box = tuple[float, float, float, float]
"""Left, bottom, width and height."""
CARD_BOX: Box = (0.015, 0.545, 0.475, 0.385)
NODE_BOX: Box = (0.015, 0.04, 0.475, 0.46)
PANELS: tuple[Box, Box] = ((0.585, 0.525, 0.40, 0.405), (0.585, 0.055, 0.40, 0.405))
FIRST = (270.0, 90.0)
"""Heading at the left of each panel, half a turn on each, degrees."""
MARGIN = 0.05
"""Of a panel, left empty around the curves."""
TICK = np.array([3.5 / 72 / SIZE[0], 3.5 / 72 / SIZE[1]])


class Curves(NamedTuple):
    """What the panels show; degrees.

    Parameters
    ----------
    low, high, fit, table : lists of two arrays, shape (n,)
        Band, curve and table in each panel, at headings that share its half turn evenly.
    marks : lists of two arrays, shape (m,)
        Table at its nodes there.
    """

    low: list[Array]
    high: list[Array]
    fit: list[Array]
    table: list[Array]
    marks: list[Array]


class _Words(Artist):
    """Words of one size at places of the page, measured once each.

    ``share`` of a word's width lies left of its place: 0.5 centres it, 1 ends it there.
    """

    def __init__(self, size: float, share: float = 0.5) -> None:
        super().__init__()
        self._font, self._share = FontProperties(size=size), share
        self._measured: dict[tuple[str, float], tuple[float, float, float]] = {}
        self.places, self.words = np.empty((0, 2)), list[str]()

    def show(self, places: Any, words: Sequence[str]) -> None:
        self.places, self.words = np.asarray(places, dtype=np.float64), list(words)

    def _measure(self, renderer: Any, word: str) -> tuple[float, float, float]:
        key = word, renderer.points_to_pixels(1.0)
        if key not in self._measured:
            self._measured[key] = renderer.get_text_width_height_descent(word, self._font, False)
        return self._measured[key]

    def draw(self, renderer: Any) -> None:
        """Draw every word with its small letters' middle at its place."""
        context = renderer.new_gc()
        height = renderer.get_canvas_width_height()[1]
        _, tall, deep = self._measure(renderer, "lp")
        page: Any = self.get_figure()
        for (x, y), word in zip(
            page.transSubfigure.transform(self.places), self.words, strict=True
        ):
            if word:
                left = x - self._share * self._measure(renderer, word)[0]
                base = y - 0.5 * (tall - deep)
                base = height - base if renderer.flipy() else base
                renderer.draw_text(context, left, base, word, self._font, 0.0, False)
        context.restore()


class CardPage:
    """A page that shows one aircraft after the other.

    Parameters
    ----------
    card_head, node_head : sequence of str
        Heads of the columns of the card and of the table at its nodes.
    card_rows, node_rows : int
        Rows of each below its head.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
    """

    def __init__(
        self, card_head: Sequence[str], card_rows: int, node_head: Sequence[str], node_rows: int
    ) -> None:
        self.figure = Figure(figsize=SIZE)
        self._heads = (list(card_head), list(node_head))
        shapes = ((card_rows + 1, len(card_head)), (node_rows + 1, len(node_head)))
        self._cells = np.concatenate(
            [_middles(box, *shape) for box, shape in zip((CARD_BOX, NODE_BOX), shapes, strict=True)]
        )
        rules = [
            line
            for box, shape in zip((CARD_BOX, NODE_BOX), shapes, strict=True)
            for line in _rules(box, *shape)
        ]
        self._lines(rules, "black", 1.0)
        self._lines([line for box in PANELS for line in _rules(box, 1, 1)], "black", 0.8)
        self._words = self._added(_Words(9))
        self._ticks = self._lines([], "black", 0.8)
        self._numbers = self._added(_Words(10, share=1.0))
        self._headings()
        self._zero = self._lines([], "0.6", 0.6)
        style: dict[str, Any] = {"transform": self.figure.transSubfigure}
        self._band = self._added(PolyCollection([], facecolor="C0", alpha=0.3, lw=0, **style))
        self._fit = self._added(Line2D([], [], color="C0", lw=1.5, **style))
        self._table = self._added(Line2D([], [], color="C1", lw=1.0, **style))
        self._marks = self._added(Line2D([], [], color="C1", ls="", marker="o", ms=4, **style))
        self._legend()
        self._title, self._foot = _title_and_foot(self.figure, "", "")

    def show(
        self,
        title: str,
        foot: str,
        card: Sequence[Sequence[str]],
        nodes: Sequence[Sequence[str]],
        curves: Curves,
    ) -> Figure:
        """Put an aircraft on the page in place of the one before.

        Parameters
        ----------
        title, foot : str
        card, nodes : sequence of rows of str
        curves : Curves

        Returns
        -------
        matplotlib.figure.Figure
        """
        self._title.set_text(title)
        self._foot.set_text(foot)
        rows = [self._heads[0], *card, self._heads[1], *nodes]
        self._words.show(self._cells, [word for row in rows for word in row])
        parts = np.concatenate([*curves.low, *curves.high, *curves.table, [0.0]])
        limits = _widened(float(parts.min()), float(parts.max()))
        self._scale(limits)
        lower, upper, fit, table, marks = (
            [_placed(box, values, limits) for box, values in zip(PANELS, both, strict=True)]
            for both in curves
        )
        self._band.set_verts(
            [np.concatenate([low, high[::-1]]) for low, high in zip(lower, upper, strict=True)]
        )
        for line, both in ((self._fit, fit), (self._table, table), (self._marks, marks)):
            line.set_data(*_apart(both).T)
        return self.figure

    def _added(self, artist: Any) -> Any:
        return self.figure.add_artist(artist)

    def _lines(self, segments: Any, color: str, width: float) -> Any:
        style: dict[str, Any] = {"colors": color, "linewidths": width}
        return self._added(LineCollection(segments, transform=self.figure.transSubfigure, **style))

    def _headings(self) -> None:
        """Ticks and names of the headings below the panels, and what is drawn over them."""
        ticks, places, words = [], [], []
        for (left, bottom, width, height), first in zip(PANELS, FIRST, strict=True):
            for turn in (0.0, 90.0, 180.0):
                x = left + width * _across(turn)
                ticks.append([(x, bottom), (x, bottom - TICK[1])])
                places.append((x, bottom - 0.027))
                words.append("NESW"[int((first + turn) % 360) // 90])
            self.figure.text(
                left - 0.06,
                bottom + 0.5 * height,
                "heading error (°)",
                fontsize=10,
                rotation=90,
                ha="center",
                va="center",
            )
        self._lines(ticks, "black", 0.8)
        self._added(_Words(10)).show(places, words)

    def _scale(self, limits: tuple[float, float]) -> None:
        """Ticks and numbers of the errors, alike in both panels, and the line of none."""
        values = np.asarray(MaxNLocator(7, steps=[1, 2, 2.5, 5, 10]).tick_values(*limits))
        values = values[(values >= limits[0]) & (values <= limits[1])]
        ticks, places, zero = [], [], []
        for left, bottom, width, height in PANELS:
            for y in bottom + height * _up(values, limits):
                ticks.append([(left, y), (left - TICK[0], y)])
                places.append((left - 2.0 * TICK[0], y))
            y = float(bottom + height * _up(np.zeros(1), limits)[0])
            zero.append([(left, y), (left + width, y)])
        words = [f"{value + 0.0:g}".replace("-", "\N{MINUS SIGN}") for value in values]
        self._ticks.set_segments(ticks)
        self._numbers.show(places, words * len(PANELS))
        self._zero.set_segments(zero)

    def _legend(self) -> None:
        y = PANELS[0][1] + PANELS[0][3] + 0.016
        self._lines([[(0.80, y), (0.83, y)]], "C0", 1.5)
        self._lines([[(0.91, y), (0.94, y)]], "C1", 1.0)
        self._added(_Words(7, share=0.0)).show([(0.835, y), (0.945, y)], ["fit, 95 %", "table"])


def refused_page(title: str, foot: str, why: str) -> Figure:
    """A page that says why there is no card.

    Parameters
    ----------
    title, foot, why : str

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


def _middles(box: Box, down: int, across: int) -> Array:
    """Middles of a grid's cells, row by row from the top; (cell, 2)."""
    left, bottom, width, height = box
    x = left + width * (np.arange(across) + 0.5) / across
    y = bottom + height * (down - np.arange(down) - 0.5) / down
    return np.stack([np.tile(x, down), np.repeat(y, across)], axis=-1)


def _rules(box: Box, down: int, across: int) -> list[list[tuple[float, float]]]:
    left, bottom, width, height = box
    level = bottom + height * np.arange(down + 1) / down
    upright = left + width * np.arange(across + 1) / across
    return [[(left, y), (left + width, y)] for y in level] + [
        [(x, bottom), (x, bottom + height)] for x in upright
    ]


def _widened(low: float, high: float) -> tuple[float, float]:
    margin = MARGIN * max(high - low, 0.1)
    return low - margin, high + margin


def _across(turn: Any) -> Any:
    """Share of a panel's width at which a turn from its first heading lies, degrees."""
    return (MARGIN + np.asarray(turn) / 180.0) / (1.0 + 2.0 * MARGIN)


def _up(values: Array, limits: tuple[float, float]) -> Array:
    return np.asarray((values - limits[0]) / (limits[1] - limits[0]))


def _placed(box: Box, values: Array, limits: tuple[float, float]) -> Array:
    """Points of the page of values that share a panel's half turn evenly; (n, 2)."""
    left, bottom, width, height = box
    x = left + width * _across(np.linspace(0.0, 180.0, values.size))
    return np.stack([x, bottom + height * _up(values, limits)], axis=-1)


def _apart(both: list[Array]) -> Array:
    """Points of both panels with a gap between."""
    return np.concatenate([both[0], np.full((1, 2), np.nan), both[1]])
