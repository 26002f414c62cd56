"""One look for every figure: sizes, type, colours told apart by colour-blind readers.

Assumes figures are seen about 920 CSS pixels wide (9.6 inches) on a light page or in a
notebook, or printed on A4.  Everything uses matplotlib's object-oriented interface on the
Agg-safe :class:`~matplotlib.figure.Figure`; nothing here touches pyplot or keeps a figure
alive.  Colours are those of Okabe and Ito (2008), "Color Universal Design".
"""

from __future__ import annotations

import contextlib
import functools
import gc
import io
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

P = ParamSpec("P")
R = TypeVar("R")

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

FULL_WIDTH = 9.6  # Width of a page-wide figure, inches

MANY = 20_000  # Points beyond which a scatter becomes a density

# Marks of a panel beyond which they are an image in it: of 6,000 aircraft with both intervals the
# marks alone would be twice as large as a page may be.
HEAVY = 200

RASTER_DPI = 150  # Of what is drawn as an image inside a page

RC: dict[RcKeyType, str | float | bool] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    # Set, not found above ticks at the top (no panel has them) by measuring every label.
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
    # Names of aircraft and references may hold any letter; a dollar sign begins no formula.
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
    # The same figure gives the same octets, names inside it included: pages can be compared.
    "svg.hashsalt": "airswing",
    # As outlines: a reader need not have the font for words to end where they were measured.
    "svg.fonttype": "path",
}


class CaptionedFigure(Figure):
    """A matplotlib Figure that carries its caption and shows itself in a notebook."""

    # what the figure shows in words, with the number of reports or aircraft behind it
    caption: str = ""
    alternative: str = ""  # one line for those who cannot see the figure

    def say(self, caption: str, *, alternative: str | None = None) -> CaptionedFigure:
        """Set the caption (and the alternative text, by default its first sentence)."""
        self.caption = caption
        self.alternative = alternative or caption.split(". ")[0].rstrip(".")
        return self

    def _repr_png_(self) -> bytes:
        return png_bytes(self)


def png_bytes(figure: Figure, *, dpi: float = 110) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    return _saved(figure, "png", dpi=dpi)


def svg_bytes(figure: Figure, *, dpi: float = RASTER_DPI) -> bytes:
    """Return a figure as the bytes of an SVG file; heavy artists in it are images at `dpi`."""
    return _saved(figure, "svg", dpi=dpi)


def _saved(figure: Figure, kind: str, *, dpi: float) -> bytes:
    stream = io.BytesIO()
    # No date, for the same reason as the salt.
    metadata = {"Date": None} if kind == "svg" else None
    engine = figure.get_layout_engine()
    with matplotlib.rc_context(RC):
        if engine is not None:
            # Laid out here, once: savefig would draw the whole figure a first time for it.
            # A frame ends where its panel does, and asks for every tick to say so.
            for axes in figure.axes:
                for spine in axes.spines.values():
                    spine.set_in_layout(False)
            with contextlib.ExitStack() as measured:
                for axes in figure.axes:
                    measured.enter_context(_measured_once(axes))
                engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(stream, format=kind, dpi=dpi, metadata=metadata)
    figure.set_layout_engine(engine)
    return stream.getvalue()


@contextlib.contextmanager
def drawing_a_page() -> Iterator[None]:
    """Leave Python's cyclic garbage alone while a page's figures are drawn.

    They leave some 20 MB of it; looking for it time and again through all that the stages before
    hold took a sixth of the page's time.
    """
    wanted = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if wanted:
            gc.enable()


@contextlib.contextmanager
def _measured_once(axes: Axes) -> Iterator[None]:
    """Let a panel be measured in the layout's first pass alone.

    The second pass asks for the same words again round a frame that has moved: what stands out
    beyond the frame is carried along.
    """
    vars(axes)["get_tightbbox"] = _once(axes, axes.get_tightbbox)
    try:
        yield
    finally:
        del vars(axes)["get_tightbbox"]


def _once(axes: Axes, measure: Callable[P, Bbox | None]) -> Callable[P, Bbox | None]:
    beyond: list[NDArray[np.float64] | None] = []

    def known(*args: P.args, **options: P.kwargs) -> Bbox | None:
        if not beyond:
            found = measure(*args, **options)
            edges = None if found is None else np.subtract(found.extents, axes.bbox.extents)
            beyond.append(edges)
        axes.apply_aspect()
        edges = beyond[0]
        return None if edges is None else Bbox.from_extents(*(axes.bbox.extents + edges))

    return known


def styled(function: Callable[P, R]) -> Callable[P, R]:
    """Run a figure function under the style, leaving matplotlib's settings as they were."""

    @functools.wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(RC):
            return function(*args, **kwargs)

    return inner


def new_figure(height: float, *, width: float = FULL_WIDTH) -> CaptionedFigure:
    """Return an empty captioned figure.

    Parameters
    ----------
    height, width : float
        Inches.
    """
    return CaptionedFigure(figsize=(width, height), dpi=120, layout="constrained")


def empty_figure(message: str) -> CaptionedFigure:
    """Return a small figure that says why there is nothing to draw."""
    figure = new_figure(1.2)
    blank(figure.add_subplot(), f"{message}.")
    return figure.say(f"{message} (n = 0).")


def series_style(index: int) -> tuple[str, str]:
    """Return the colour and the marker of a series, so that neither is needed alone."""
    return _SERIES[index % len(_SERIES)], _MARKERS[index % len(_MARKERS)]


def compass_axis(axes: Axes) -> None:
    """Make the x axis of a panel an indicated magnetic heading from 0 to 360 degrees."""
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 45))
    axes.set_xlabel("indicated magnetic heading (degree)")


def thousands(number: float) -> str:
    """Format a count with thin grouping: ``12,345``."""
    return f"{int(number):,}"


def plural(number: int, noun: str, plural_noun: str | None = None) -> str:
    """Return ``1 flight`` or ``12,345 flights``."""
    word = noun if number == 1 else (plural_noun or f"{noun}s")
    return f"{thousands(number)} {word}"


def blank(axes: Axes, message: str) -> None:
    """Say in an empty panel why it is empty."""
    axes.axis("off")
    axes.text(
        0.5, 0.5, message, ha="center", va="center", color=SOFT, transform=axes.transAxes, wrap=True
    )
