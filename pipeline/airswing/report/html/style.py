"""One look for every figure: sizes, type, colours and units of speed.

Figures are about 920 CSS pixels wide (9.6 inches) on a page or in a notebook. Everything uses
matplotlib's object-oriented interface; pyplot is not touched and no figure is kept alive. Colours
are those of Okabe and Ito (2008), "Color Universal Design", which colour-blind readers can
distinguish.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import io
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Literal, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from PIL import Image

from airswing.units import KNOT

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

P = ParamSpec("P")
R = TypeVar("R")
#: Unit of every speed that is shown; the configuration's ``units``.
Units = Literal["kt", "m/s"]

INK = "#1f2933"
SOFT = "#5f6b7a"
FAINT = "#c9d0d8"
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
SKY = "#56B4E9"
_PURPLE = "#CC79A7"
_SERIES = (BLUE, VERMILION, GREEN, _PURPLE, ORANGE, SKY, INK)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DENSITY = "viridis_r"
DIVERGING = "PuOr_r"

FULL_WIDTH = 9.6  # inches
MANY = 20_000  # Points beyond which a scatter plot becomes a density
PAGE_DPI = 144  # 1.5 image pixels a CSS pixel

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
    """A matplotlib figure with a caption that is displayed as an image in a notebook.

    Attributes
    ----------
    caption : str
        What the figure shows, with the number of reports or aircraft behind it.
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
def garbage_collection_rare() -> Iterator[None]:
    """Run Python's cyclic garbage collection rarely while the figures of a page are drawn.

    Each figure creates many objects, and each collection visits all there are: a fifth of the time.
    Thresholds are raised, because extension modules call the collector's switch themselves.
    """
    thresholds = gc.get_threshold()
    gc.set_threshold(1_000_000, 100, 100)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)


def styled(function: Callable[P, R]) -> Callable[P, R]:
    """Run a figure function with this style; matplotlib's settings are restored afterwards."""

    @functools.wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(RC):
            return function(*args, **kwargs)

    return inner


def new_figure(
    height: float, *, width: float = FULL_WIDTH, constrained: bool = True
) -> CaptionedFigure:
    """Return an empty figure, sizes in inches; without `constrained` the caller places panels."""
    return CaptionedFigure(
        figsize=(width, height), dpi=120, layout="constrained" if constrained else None
    )


def place_panels(
    figure: Figure,
    *,
    left: float,
    right: float = 0.1,
    top: float = 0.35,
    bottom: float = 0.5,
    wspace: float = 0.35,
    hspace: float = 0.2,
) -> None:
    """Set the margins and the spaces between the panels of a figure with many panels, in inches.

    It replaces the constrained layout where all labels are short: measuring them takes longer than
    drawing them.
    """
    width, height = (float(size) for size in figure.get_size_inches())
    grid = figure.axes[0].get_gridspec()
    rows, columns = (1, 1) if grid is None else grid.get_geometry()
    across = (width - left - right - (columns - 1) * wspace) / columns
    upwards = (height - top - bottom - (rows - 1) * hspace) / rows
    figure.subplots_adjust(
        left=left / width,
        right=1 - right / width,
        top=1 - top / height,
        bottom=bottom / height,
        wspace=wspace / across,
        hspace=hspace / upwards,
    )


def count_ticks(bar: Colorbar, most: float) -> None:
    """Label a logarithmic colour bar of counts at powers of ten up to `most`."""
    powers = [10**k for k in range(int(np.log10(max(most, 1.0))) + 1)]
    bar.minorticks_off()
    bar.set_ticks(powers, labels=[f"{one:,}" for one in powers])


def empty_figure(message: str) -> CaptionedFigure:
    """Return a small figure that says why there is nothing to draw."""
    figure = new_figure(1.2)
    blank(figure.add_subplot(), f"{message}.")
    return figure.say(f"{message} (n = 0).")


def blank(axes: Axes, message: str) -> None:
    """Say in an empty panel why it is empty."""
    axes.axis("off")
    axes.text(
        0.5, 0.5, message, ha="center", va="center", color=SOFT, transform=axes.transAxes, wrap=True
    )


def series_style(index: int) -> tuple[str, str]:
    """Return the colour and the marker of a series; either is enough to identify it."""
    return _SERIES[index % len(_SERIES)], _MARKERS[index % len(_MARKERS)]


def thousands(number: float) -> str:
    """Format a count with separators: ``12,345``."""
    return f"{int(number):,}"


def plural(number: int, noun: str, plural_noun: str | None = None) -> str:
    """Return ``1 flight`` or ``12,345 flights``."""
    word = noun if number == 1 else (plural_noun or f"{noun}s")
    return f"{thousands(number)} {word}"


def shown_per_m_s(units: Units) -> float:
    """Return the factor from m/s to the unit that is shown."""
    return 1.0 / KNOT if units == "kt" else 1.0


def shown_per_kt(units: Units) -> float:
    """Return the factor from knots to the unit that is shown."""
    return 1.0 if units == "kt" else KNOT
