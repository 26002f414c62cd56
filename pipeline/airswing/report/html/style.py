"""Common style of all figures: sizes, fonts, colours, rows and intervals.

Figures are 9.6 inches wide, about 920 CSS pixels. pyplot is not used and no figure is kept alive.
Colours: Okabe and Ito (2008), "Color Universal Design", which colour-blind readers can distinguish.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

INK = "#1f2933"
SOFT = "#5f6b7a"
FAINT = "#c9d0d8"
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
SKY = "#56B4E9"
_SERIES = (BLUE, VERMILION, GREEN, "#CC79A7", ORANGE, SKY, INK)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
#: Colour and marker of winds as reported and as corrected.
STATES = (("reported", ORANGE, "o"), ("corrected", BLUE, "D"))
DENSITY = "viridis_r"
DIVERGING = "PuOr_r"

FULL_WIDTH = 9.6  # inches
MANY = 20_000  # Points beyond which a scatter plot becomes a density
PAGE_DPI = 144  # 1.5 image pixels a CSS pixel

#: Keyword arguments of a matplotlib artist.
Look = dict[str, Any]

RC: dict[RcKeyType, str | float | bool] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    # A fixed place: matplotlib otherwise measures every tick label to find one.
    "axes.titley": 1.0,
    "axes.labelsize": 9.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e7ec",
    "grid.linewidth": 0.7,
    "text.color": INK,
    # Names of aircraft and references may hold a dollar sign.
    "text.parse_math": False,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "savefig.facecolor": "white",
}


class CaptionedFigure(Figure):
    """A matplotlib figure with a caption, displayed as an image in a notebook.

    ``caption`` describes it, with the number of reports or aircraft used.
    """

    caption: str = ""

    def say(self, caption: str) -> CaptionedFigure:
        """Set the caption and return the figure."""
        self.caption = caption
        return self

    def _repr_png_(self) -> bytes:
        return png_bytes(self)


def png_bytes(figure: Figure, *, dpi: float = 110, colours: int | None = None) -> bytes:
    """Return a figure as a PNG file; a palette of `colours` takes a quarter of the bytes."""
    stream = io.BytesIO()
    with matplotlib.rc_context(RC):
        figure.set_dpi(dpi)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        image = Image.fromarray(pixels).convert("RGB")
    if colours is not None:
        image = image.quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    image.save(stream, "png", dpi=(dpi, dpi))
    return stream.getvalue()


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Use this style while figures are drawn; also a decorator."""
    with matplotlib.rc_context(RC):
        yield


def panels(height: float, *grid: int, **options: Any) -> tuple[CaptionedFigure, Any]:
    """Return a figure (height in inches) and its panels as of :meth:`Figure.subplots`."""
    figure = CaptionedFigure(figsize=(FULL_WIDTH, height), dpi=120, layout="constrained")
    return figure, figure.subplots(*grid, **options)


def rows_axis(axes: Axes, names: Sequence[str], label: str = "") -> None:
    """Give a panel one named row an item, from top to bottom, and its x axis a label."""
    axes.set_yticks(range(len(names)), names, fontsize=8.5 if len(names) <= 30 else 7.5)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(label)


def zero_line(axes: Axes, *, across: bool = False) -> None:
    """Draw a vertical line at zero; `across`: a horizontal one."""
    draw = axes.axhline if across else axes.axvline
    draw(0.0, color=INK, linewidth=0.8)


def intervals(axes: Axes, value: ArrayLike, ends: ArrayLike, rows: ArrayLike, **look: Any) -> None:
    """Draw values (n,) in rows (n,) with their intervals (2, n); `look` is of the markers."""
    axes.hlines(rows, *np.asarray(ends, float), color=look["color"], linewidth=1.3)
    axes.plot(value, rows, **{"marker": "o", "markersize": 5, "linestyle": "", **look})


def interval_rows(
    axes: Axes, names: Sequence[str], value: ArrayLike, ends: ArrayLike, label: str, **look: Any
) -> None:
    """Draw values (n,) with intervals (2, n) in named rows, and a line at zero."""
    intervals(axes, value, ends, np.arange(len(names)), **look)
    zero_line(axes)
    rows_axis(axes, names, label)


def annotate(
    axes: Axes, text: str, place: Sequence[float], points: tuple[int, int], **look: Any
) -> None:
    """Write a text at an offset in points from a place."""
    axes.annotate(text, (place[0], place[1]), xytext=points, textcoords="offset points", **look)


def count_ticks(bar: Colorbar, most: float) -> None:
    """Label a logarithmic colour bar of counts at powers of ten up to `most`."""
    powers = [10**k for k in range(int(np.log10(max(most, 1.0))) + 1)]
    bar.minorticks_off()
    bar.set_ticks(powers, labels=[f"{one:,}" for one in powers])


def empty_figure(message: str) -> CaptionedFigure:
    """Return a small figure that states why there is nothing to draw."""
    figure, axes = panels(1.2)
    blank(axes, f"{message}.")
    return figure.say(f"{message} (n = 0).")


def blank(axes: Axes, message: str) -> None:
    """State the reason in an empty panel."""
    axes.axis("off")
    look: dict[str, Any] = {"ha": "center", "va": "center", "color": SOFT, "wrap": True}
    axes.text(0.5, 0.5, message, transform=axes.transAxes, **look)


def series_style(index: int) -> tuple[str, str]:
    """Return the colour and the marker of a series; either is enough to identify it."""
    return _SERIES[index % len(_SERIES)], _MARKERS[index % len(_MARKERS)]
