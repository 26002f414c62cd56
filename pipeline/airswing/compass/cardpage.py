"""The page of a swing card: two grids of words and the curve, drawn over again for each aircraft.

Assumes a page of one size (A5 landscape) and curves in degrees that are finite. The page is laid
out once and takes the next aircraft's words and curves: making a page takes as long as drawing it,
and most of that went into measuring a hundred words one by one, axes' ticks among them. So words
are written where they belong (:class:`Words`), and axes hold the curves alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from airswing.compass.fit.sandwich import Array

SIZE = (8.27, 5.83)  # Inches
Box = tuple[float, float, float, float]  # Left, bottom, width and height, shares of the page
# Card above the nodes on the left, two panels beside them; the page is A5, half a sheet.
CARD_BOX: Box = (0.015, 0.545, 0.475, 0.385)
NODE_BOX: Box = (0.015, 0.04, 0.475, 0.46)
PANELS: tuple[Box, Box] = ((0.585, 0.525, 0.40, 0.405), (0.585, 0.055, 0.40, 0.405))
FIRST = (270.0, 90.0)
"""Heading at the left of each panel, half a turn on each, degrees."""


class Curves(NamedTuple):
    """What the panels show against the turn from their first heading: two arrays (181,) each."""

    low: list[Array]  # degrees, a degree apart
    high: list[Array]
    fit: list[Array]
    table: list[Array]


class Words(Artist):
    """Words at places of the page, of one size (points), their baselines level.

    ``places`` (n, 2) are shares of the page: each word's middle, or its right or left end by
    ``ha``; ``rotation`` is in degrees.
    """

    def __init__(
        self, size: float, places: Array, *, ha: str = "center", rotation: float = 0.0
    ) -> None:
        super().__init__()
        self.words: list[str] = []
        self.places = places
        self._size, self._rotation = size, rotation
        self._font = FontProperties(size=size)
        self._before = {"left": 0.0, "center": 0.5, "right": 1.0}[ha]

    def draw(self, renderer: RendererBase) -> None:
        """Write them."""
        figure = self.get_figure(root=True)
        if figure is None or not self.words:
            return
        context = renderer.new_gc()
        context.set_foreground("black")
        # Places as complex numbers: turning a word is one product.
        turned = np.exp(1j * np.radians(self._rotation))
        # as high as figures are: words with descenders stand on the same line as those without
        _, above, below = self._measured(renderer, "0")
        _, top = renderer.get_canvas_width_height()
        middle = figure.transSubfigure.transform(self.places) @ [1.0, 1j]
        for place, word in zip(middle, self.words, strict=True):
            wide = self._measured(renderer, word)[0]
            start = place - turned * (self._before * wide + 0.5j * (above - below))
            up = top - start.imag if renderer.flipy() else start.imag
            renderer.draw_text(context, start.real, up, word, self._font, self._rotation)
        context.restore()

    def _measured(self, renderer: RendererBase, word: str) -> tuple[float, float, float]:
        """Width, height and descent of a word, measured once: most stand on many cards."""
        key = type(renderer), float(np.asarray(renderer.points_to_pixels(self._size))), word
        if key not in _SIZES:
            _SIZES[key] = renderer.get_text_width_height_descent(word, self._font, False)
        return _SIZES[key]


_SIZES: dict[tuple[type[RendererBase], float, str], tuple[float, float, float]] = {}


class CardPage:
    """A page that shows one aircraft after the other.

    ``heads`` are those of the columns of the card and of the table at its nodes, ``rows`` how many
    rows each has below its head.
    """

    def __init__(self, heads: tuple[Sequence[str], Sequence[str]], rows: tuple[int, int]) -> None:
        self.figure = Figure(figsize=SIZE)
        self._heads = heads
        boxes = zip((CARD_BOX, NODE_BOX), heads, rows, strict=True)
        places = [_grid(self.figure, box, down + 1, len(head)) for box, head, down in boxes]
        self._cells = Words(9, np.concatenate(places))
        self.figure.add_artist(self._cells)
        self._panels = [
            _Panel(self.figure, box, first) for box, first in zip(PANELS, FIRST, strict=True)
        ]
        _key(self.figure)
        self._title, self._foot = _title_and_foot(self.figure)

    def show(
        self, title: str, foot: str, rows: tuple[Sequence[Sequence[str]], ...], curves: Curves
    ) -> Figure:
        """Put an aircraft on the page in place of the one before; rows as they were announced."""
        self._title.set_text(title)
        self._foot.set_text(foot)
        self._cells.words = [
            word
            for head, below in zip(self._heads, rows, strict=True)
            for row in (head, *below)
            for word in row
        ]
        parts = np.concatenate([*curves.low, *curves.high, *curves.table, [0.0]])
        room = 0.05 * max(float(np.ptp(parts)), 0.1)  # a flat curve has a scale, too
        for number, panel in enumerate(self._panels):
            panel.show(*(one[number] for one in curves))
            panel.span(float(parts.min()) - room, float(parts.max()) + room)
        return self.figure


class _Panel:
    """A panel of half a turn with its band, curve and table, without values yet."""

    def __init__(self, figure: Figure, box: Box, first: float) -> None:
        left, bottom, width, height = self._box = box
        self.axes: Axes = figure.add_axes(box)
        self.axes.axis("off")
        # Half a turn with a twentieth of room on each side, as matplotlib leaves it.
        self.axes.set_xlim(-9.0, 189.0)
        self.axes.axhline(0.0, color="0.6", lw=0.6)
        self._band = self.axes.fill_between([], [], [], color="C0", alpha=0.3, lw=0)
        (self._fit,) = self.axes.plot([], [], color="C0", lw=1.5)
        (self._table,) = self.axes.plot([], [], color="C1", lw=1, marker="o", ms=4, markevery=45)
        corners = [(left + a * width, bottom + b * height) for a, b in (*_ROUND, _ROUND[0])]
        x = left + width * (np.array([0.0, 90.0, 180.0]) + 9.0) / 198.0
        frame = [corners, *([(one, bottom), (one, bottom - 0.008)] for one in x)]
        self._ticks = LineCollection([], colors="black", linewidths=0.8)
        for lines in (LineCollection(frame, colors="black", linewidths=0.8), self._ticks):
            lines.set_transform(figure.transSubfigure)
            figure.add_artist(lines)
        below = Words(10, np.column_stack([x, np.full(3, bottom - 0.028)]))
        below.words = ["NESW"[int(first + turn) % 360 // 90] for turn in (0, 90, 180)]
        beside = np.array([[left - 0.068, bottom + 0.5 * height]])
        title = Words(10, beside, rotation=90.0)
        title.words = ["heading error (°)"]
        self._values = Words(10, np.empty((0, 2)), ha="right")
        for words in (below, title, self._values):
            figure.add_artist(words)

    def show(self, low: Array, high: Array, fit: Array, table: Array) -> None:
        """Take an aircraft's curves."""
        turn = np.arange(fit.size)
        self._band.set_data(turn, low, high)
        self._fit.set_data(turn, fit)
        self._table.set_data(turn, table)

    def span(self, low: float, high: float) -> None:
        """Set the scale, degrees."""
        self.axes.set_ylim(low, high)
        ticks: Array = np.asarray(MaxNLocator(9, steps=[1, 2, 5, 10]).tick_values(low, high))
        values = ticks[(ticks >= low) & (ticks <= high)]
        left, bottom, _, height = self._box
        level = bottom + height * (values - low) / (high - low)
        self._ticks.set_segments([[(left, y), (left - 0.006, y)] for y in level])
        self._values.places = np.column_stack([np.full(level.size, left - 0.011), level])
        # as many places as the step between two of them has
        places = max(0, -int(np.floor(np.log10(ticks[1] - ticks[0]) + 1e-9)))
        told = [f"{value + 0.0:.{places}f}" for value in values.round(places)]
        self._values.words = [one.replace("-", "\N{MINUS SIGN}") for one in told]


_ROUND = ((0, 0), (1, 0), (1, 1), (0, 1))


def _key(figure: Figure) -> None:
    """What the lines are, above the upper panel."""
    left, bottom, wide, high = PANELS[0]
    level, right = bottom + high + 0.016, left + wide
    styles = ((right - 0.156, "", "C0", 1.5), (right - 0.062, "o", "C1", 1))
    for x, marker, color, width in styles:
        line = Line2D(
            [x, x + 0.012, x + 0.024], [level] * 3, marker=marker, ms=4, color=color, lw=width
        )
        line.set_markevery([1])
        line.set_transform(figure.transSubfigure)
        figure.add_artist(line)
    words = Words(7, np.array([[right - 0.126, level], [right - 0.032, level]]), ha="left")
    words.words = ["fit, 95 %", "table"]
    figure.add_artist(words)


def _title_and_foot(figure: Figure) -> tuple[Text, Text]:
    title = figure.text(
        0.5,
        0.985,
        "",
        ha="center",
        va="top",
        fontsize=12,
        fontweight="bold",
        parse_math=False,  # a name may hold any letter
    )
    return (
        title,
        figure.text(0.2525, 0.012, "", ha="center", parse_math=False, fontsize=7),
    )


def _grid(figure: Figure, box: Box, down: int, across: int) -> Array:
    """Rules of a grid; middles of its cells row by row from the top, shape (cells, 2)."""
    left, bottom, width, height = box
    level = bottom + height * np.arange(down + 1) / down
    upright = left + width * np.arange(across + 1) / across
    rules = [[(left, y), (left + width, y)] for y in level]
    rules += [[(x, bottom), (x, bottom + height)] for x in upright]
    lines = LineCollection(rules, colors="black", linewidths=1, transform=figure.transSubfigure)
    figure.add_artist(lines)
    x, y = upright[:-1] + 0.5 * width / across, level[:-1][::-1] + 0.5 * height / down
    return np.column_stack([np.tile(x, down), np.repeat(y, across)])
