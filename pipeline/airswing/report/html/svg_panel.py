"""Small panels written as SVG text: a frame with scales, and points, curves and marks in it.

A page shows hundreds of such panels, and the drawing library takes a hundred times as long over
one of them. They stand in the page as they are: no image inside an image, type as the page's.

Assumptions and validity
------------------------
* Scales are linear; what lies outside a scale is not shown. NaN ends a line and leaves out a mark.
* Places are CSS pixels to a tenth of one, the y axis upward.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup, escape
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from airswing.report.html.style import INK, SOFT

Floats = NDArray[np.float64]
Range = tuple[float, float]

GRID = "#e3e7ec"
_DIAMOND = "M{x:.1f} {up:.1f}L{right:.1f} {y:.1f}L{x:.1f} {down:.1f}L{left:.1f} {y:.1f}z"


class Panel:
    """One panel.

    Parameters
    ----------
    size : (float, float)
        Width and height in all, CSS pixels.
    margins : (float, float, float, float)
        Left, right, top, bottom of the frame.
    x, y : (float, float)
        Ends of both scales.
    """

    def __init__(
        self,
        size: tuple[float, float],
        margins: tuple[float, float, float, float],
        *,
        x: Range,
        y: Range,
    ) -> None:
        left, right, top, bottom = margins
        self.size, self.left, self.top = size, left, top
        self.width, self.height = size[0] - left - right, size[1] - top - bottom
        self.x, self.y = x, y
        self._inside: list[str] = []
        self._outside: list[str] = []

    def across(self, values: ArrayLike) -> Floats:
        """Places of values on the x scale, pixels from the frame's left."""
        return np.asarray(self.width * (_floats(values) - self.x[0]) / (self.x[1] - self.x[0]))

    def down(self, values: ArrayLike) -> Floats:
        """Places of values on the y scale, pixels from the frame's top."""
        return np.asarray(self.height * (self.y[1] - _floats(values)) / (self.y[1] - self.y[0]))

    def scales(
        self,
        x_ticks: Sequence[tuple[float, str]],
        y_ticks: Sequence[tuple[float, str]] | None = None,
        *,
        points: float = 12.0,
    ) -> Panel:
        """Draw the frame, a grid and the numbers beside it; y ticks are found where not given."""
        if y_ticks is None:
            wanted = max(int(self.height // 35), 3)
            found = MaxNLocator(wanted, steps=[1, 2, 2.5, 5, 10]).tick_values(*self.y)
            y_ticks = [(v, _number(v)) for v in found if self.y[0] <= v <= self.y[1]]
        width, height = self.width, self.height
        places = [(float(self.across(value)), word) for value, word in x_ticks]
        levels = [(float(self.down(value)), word) for value, word in y_ticks]
        grid = "".join(f"M{x:.1f} 0V{height:.1f}" for x, _ in places)
        grid += "".join(f"M0 {y:.1f}H{width:.1f}" for y, _ in levels)
        self._inside.append(f'<path d="{grid}" stroke="{GRID}" fill="none"/>')
        left, foot = self.left, self.top + height
        frame = f"M{left:.1f} {self.top:.1f}V{foot:.1f}H{left + width:.1f}"
        self._outside.append(f'<path d="{frame}" stroke="{SOFT}" fill="none"/>')
        for x, word in places:
            self.words(left + x, foot + points + 3.0, word, points=points)
        for y, word in levels:
            self.words(left - 5.0, self.top + y + 0.35 * points, word, points=points, at="end")
        return self

    def words(
        self,
        x: float,
        y: float,
        text: str,
        *,
        points: float = 12.0,
        at: str = "middle",
        color: str = INK,
        more: str = "",
    ) -> None:
        """Write words at a place of the whole panel; `more` are further attributes of the text."""
        if text:
            self._outside.append(
                f'<text x="{x:.1f}" y="{y:.1f}" font-size="{points:g}" text-anchor="{at}" '
                f'fill="{color}"{more}>{escape(text)}</text>'
            )

    def dots(self, x: ArrayLike, y: ArrayLike, *, size: float, opacity: float) -> None:
        """Reports: many round points of one look."""
        places = zip(self.across(x).tolist(), self.down(y).tolist(), strict=True)
        path = "".join(f"M{a:.0f} {b:.1f}h0" for a, b in places if 0 <= b <= self.height)
        self._inside.append(
            f'<path d="{path}" stroke="{SOFT}" stroke-width="{size:g}" stroke-linecap="round" '
            f'stroke-opacity="{opacity:.2f}" fill="none"/>'
        )

    def line(
        self, x: ArrayLike, y: ArrayLike, color: str, *, width: float, dashes: str = ""
    ) -> None:
        """Draw a line through points."""
        points = zip(self.across(x).tolist(), self.down(y).tolist(), strict=True)
        path, pen = [], "M"
        for a, b in points:
            if np.isfinite(a + b):
                path.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L" if np.isfinite(a + b) else "M"
        broken = f' stroke-dasharray="{dashes}"' if dashes else ""
        self._inside.append(
            f'<path d="{"".join(path)}" stroke="{color}" stroke-width="{width:g}" '
            f'fill="none"{broken}/>'
        )

    def band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str, *, opacity: float
    ) -> None:
        """Fill between two lines."""
        along = self.across(x)
        turn = np.concatenate([along, along[::-1]])
        edge = np.concatenate([self.down(low), self.down(high)[::-1]])
        places = zip(turn.tolist(), edge.tolist(), strict=True)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in places if np.isfinite(a + b))
        self._inside.append(f'<polygon points="{points}" fill="{color}" fill-opacity="{opacity}"/>')

    def bars(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str) -> None:
        """Upright intervals."""
        places = zip(self.across(x), self.down(low), self.down(high), strict=True)
        path = "".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in places if np.isfinite(a + b + c))
        self._inside.append(f'<path d="{path}" stroke="{color}" stroke-width="1.3"/>')

    def bars_across(self, y: ArrayLike, low: ArrayLike, high: ArrayLike, color: str) -> None:
        """Level intervals."""
        places = zip(self.down(y), self.across(low), self.across(high), strict=True)
        path = "".join(f"M{b:.1f} {a:.1f}H{c:.1f}" for a, b, c in places if np.isfinite(a + b + c))
        self._inside.append(f'<path d="{path}" stroke="{color}" stroke-width="1.3"/>')

    def marks(self, x: ArrayLike, y: ArrayLike, color: str, *, size: float, diamond: bool) -> None:
        """Discs, or diamonds with a white edge, at points."""
        path = []
        for a, b in zip(self.across(x).tolist(), self.down(y).tolist(), strict=True):
            if not np.isfinite(a + b):
                continue
            edges = {"x": a, "y": b, "left": a - size, "right": a + size}
            disc = f"M{a:.1f} {b:.1f}h0"
            path.append(_DIAMOND.format(**edges, up=b - size, down=b + size) if diamond else disc)
        look = (
            f'fill="{color}" stroke="white"'
            if diamond
            else f'stroke="{color}" stroke-width="{2 * size:g}" stroke-linecap="round"'
        )
        self._inside.append(f'<path d="{"".join(path)}" {look}/>')

    def level(self, value: float) -> None:
        """A thin line all across at a value of the y scale."""
        self.line(self.x, (value, value), INK, width=0.9)

    def svg(self, said: str) -> Markup:
        """The panel, with what it shows in words for those who do not see it."""
        width, height = self.size
        inner = (
            f'<svg x="{self.left:.1f}" y="{self.top:.1f}" width="{self.width:.1f}" '
            f'height="{self.height:.1f}">{"".join(self._inside)}</svg>'
        )
        return Markup(
            f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(said)}">'
            f"{inner}{''.join(self._outside)}</svg>"
        )


def _floats(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=np.float64)


def _number(value: float) -> str:
    return f"{value + 0.0:g}".replace("-", "\N{MINUS SIGN}")
