"""Parts of a page: words, figures in a common style, tables, sections, and the whole document.

A page is one HTML text with styles and images inside; nothing is downloaded, and it is readable
without scripts. Jinja2 and markupsafe escape every text. Figures are 9.6 inches wide, about 920 CSS
pixels; pyplot is not used and no figure is kept alive. Colours: Okabe and Ito (2008), "Color
Universal Design", which colour-blind readers can distinguish. Intervals in words are 95 %.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat

import matplotlib
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

from airswing.products.whole_files import atomic, write_text
from airswing.version import __version__

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

#: Ends of an interval; null in JSON where they are not known.
Ends = Sequence[float | None] | np.ndarray
#: Keyword arguments of a matplotlib artist.
Look = dict[str, Any]

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
_COLOURS = 256  # Colours of the palette: a drawing has few, and their mixtures along edges
# Width in CSS pixels below which a figure is scrolled instead of made smaller: text of 9 points is
# then 7 pixels high.
_LEAST_WIDTH = 560
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
#: Context and decorator: figures drawn in it have this style.
drawing = partial(matplotlib.rc_context, RC)
_TEMPLATES = Environment(
    loader=PackageLoader("airswing.report.html", "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


# --- words -------------------------------------------------------------------------------------


def plural(number: int, noun: str) -> str:
    """Return ``1 flight``, ``12,345 flights`` or ``2 aircraft``."""
    return f"{int(number):,} {noun}{'' if number == 1 or noun == 'aircraft' else 's'}"


def joined(words: Sequence[object], *, most: int = 6) -> str:
    """Return ``a, b and c``, cut after `most` with the number of the rest."""
    shown = [str(word) for word in words[:most]]
    if len(words) > most:
        shown.append(f"{len(words) - most} more")
    return " and ".join([", ".join(shown[:-1]), *shown[-1:]] if len(shown) > 1 else shown)


def number_text(value: SupportsFloat | None, *, digits: int = 2) -> str:
    """Return a number with fixed digits, or a dash where there is none."""
    number = float("nan") if value is None else float(value)
    return f"{number:z.{digits}f}" if np.isfinite(number) else "-"


def interval_text(value: float, half: float, *, digits: int = 2, sign: bool = False) -> str:
    """Return ``value ± half width``, only the number without an interval, or a dash."""
    if not np.isfinite(value):
        return "-"
    number = f"{value:{'+' * sign}z.{digits}f}"
    return number + (f" ± {half:.{digits}f}" if np.isfinite(half) else "")


def range_text(interval: Ends | None, *, digits: int = 2) -> str:
    """Return an interval, `` (low to high)``; empty where it is not known."""
    low, high = np.array((None, None) if interval is None else interval, float)
    return f" ({low:.{digits}f} to {high:.{digits}f})" if np.isfinite(low + high) else ""


def amount(value: SupportsFloat | None, ends: Ends | None = None, *, unit: str = "") -> str:
    """Return a value with unit and interval: ``1.20 kt (1.05 to 1.34)``."""
    text = number_text(value)
    return text + (f" {unit}" if unit and text != "-" else "") + range_text(ends)


# --- figures -----------------------------------------------------------------------------------


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
    with drawing():
        figure.set_dpi(dpi)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    image = Image.fromarray(pixels).convert("RGB")
    if colours is not None:
        image = image.quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    image.save(stream, "png", dpi=(dpi, dpi))
    return stream.getvalue()


def panels(height: float, *grid: int, **options: Any) -> tuple[CaptionedFigure, Any]:
    """Return a figure (height in inches) and its panels as of :meth:`Figure.subplots`."""
    figure = CaptionedFigure(figsize=(FULL_WIDTH, height), dpi=120, layout="constrained")
    return figure, figure.subplots(*grid, **options)


def empty_figure(message: str) -> CaptionedFigure:
    """Return a small figure that states why there is nothing to draw."""
    figure, axes = panels(1.2)
    blank(axes, f"{message}.")
    return figure.say(f"{message} (n = 0).")


def blank(axes: Axes, message: str) -> None:
    """State the reason in an empty panel."""
    axes.axis("off")
    look = Look(ha="center", va="center", color=SOFT, wrap=True)
    axes.text(0.5, 0.5, message, transform=axes.transAxes, **look)


def series(index: int, **look: Any) -> Look:
    """Return the look of a series; its colour and its marker each identify it."""
    return {"color": _SERIES[index % 7], "marker": _MARKERS[index % 7], **look}


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
    axes: Axes, names: Sequence[str], value: ArrayLike, ends: ArrayLike, label: str, /, **look: Any
) -> None:
    """Draw values (n,) with intervals (2, n) in named rows, and a line at zero."""
    intervals(axes, value, ends, np.arange(len(names)), **look)
    zero_line(axes)
    rows_axis(axes, names, label)


def cell_texts(
    axes: Axes, cells: np.ndarray, text: Callable[[float], str], dark: float, x: ArrayLike = ()
) -> None:
    """Print the finite cells (row, column) of a map at `x`, white on those larger than `dark`."""
    look, places = Look(ha="center", va="center", fontsize=7.5), np.asarray(x)
    for row, column in np.argwhere(np.isfinite(cells)):
        value, place = float(cells[row, column]), places[column] if places.size else column
        axes.text(place, row, text(value), color="white" if abs(value) > dark else INK, **look)


def count_ticks(bar: Colorbar, most: float) -> None:
    """Label a logarithmic colour bar of counts at powers of ten up to `most`."""
    powers = [10**k for k in range(int(np.log10(max(most, 1.0))) + 1)]
    bar.minorticks_off()
    bar.set_ticks(powers, labels=[f"{power:,}" for power in powers])


class Figures:
    """Figures of a page, each also a PNG file in a folder, if there is one.

    Files of an earlier page are removed.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        for file in folder.glob("*.png") if folder else ():
            file.unlink()

    def __call__(self, name: str, figure: Figure, *, dpi: float = PAGE_DPI) -> Markup:
        """Return an HTML figure; `name`, in plain letters, is the name of its file."""
        content = png_bytes(figure, dpi=dpi, colours=_COLOURS)
        width = round(float(figure.get_figwidth()) * 96)
        caption = str(getattr(figure, "caption", ""))
        image = Markup('<img src="{}" alt="{}" style="width:{}px;min-width:{}px">').format(
            f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}",
            caption.split(". ")[0].rstrip("."),
            width,
            min(width, _LEAST_WIDTH),
        )
        if self.folder is not None:
            stem = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.")
            with atomic(self.folder / f"{stem}.png") as temporary:
                temporary.write_bytes(content)
            image = Markup('<a href="{}">{}</a>').format(f"{self.folder.name}/{stem}.png", image)
        return Markup(
            '<figure><div class="scroll">{}</div><figcaption>{}</figcaption></figure>'
        ).format(image, caption)


# --- text, tables and sections -----------------------------------------------------------------


@dataclass(frozen=True)
class Section:
    """A section of a page: title, first sentence and parts (figures, tables, text)."""

    anchor: str
    title: str
    lead: str = ""
    parts: Iterable[str] = ()

    @property
    def body(self) -> Markup:
        """The parts as HTML; plain text is a paragraph."""
        return _together(self.parts)


def _together(parts: Iterable[str]) -> Markup:
    shown = (part if isinstance(part, Markup) else paragraph(part) for part in parts if part)
    return Markup("\n").join(shown)


def table(
    content: Mapping[str, Iterable[object]] | Sequence[Mapping[str, object]],
    *,
    words: Collection[str] = (),
    long: Collection[str] = (),
    caption: str = "",
    doubt: Iterable[bool] | None = None,
    sortable: bool = False,
) -> Markup:
    """Return a table of columns by title, or of rows with cells by title; a caption below it.

    Columns of text are `words`, or `long` where lines wrap. Numbers get two decimals or, if whole,
    commas; None and NaN are dashes. Rows in `doubt` are printed in grey italics. Nothing is
    returned where there is no row.
    """
    if isinstance(content, Mapping):
        titles, rows = list(content), list(zip(*content.values(), strict=True))
    else:
        titles = list(content[0]) if content else []
        rows = [tuple(row.values()) for row in content]
    if not rows:
        return Markup()
    cells = [[_cell(value) for value in row] for row in rows]
    text = _TEMPLATES.get_template("table.html").render(
        titles=titles,
        kinds=["words" if name in words else "long" if name in long else "" for name in titles],
        rows=list(zip(repeat(False) if doubt is None else doubt, cells, strict=False)),
        caption=caption,
        sortable=sortable,
    )
    return Markup(text)


def _cell(value: object) -> object:
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    return number_text(value) if value is None or isinstance(value, float | np.floating) else value


def bar(share: float, text: str) -> Markup:
    """Return a cell of a column of text: a bar of a share (0 to 1) of full length, and the text."""
    return Markup('<span class="bar" style="width:{:.1f}em"></span>{}').format(12 * share, text)


def paragraph(text: str, *, note: bool = False) -> Markup:
    """Return a paragraph; a note is highlighted."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def heading(text: str) -> Markup:
    """Return a heading inside a section."""
    return Markup("<h3>{}</h3>").format(text)


def listing(items: Iterable[object]) -> Markup:
    """Return a bulleted list, or nothing without an item."""
    inside = Markup("").join(Markup("<li>{}</li>").format(item) for item in items)
    return Markup('<ul class="plain">{}</ul>').format(inside) if inside else inside


def link(address: str, text: str) -> Markup:
    """Return a link to a relative address."""
    return Markup('<a href="{}">{}</a>').format(address, text)


def folded(summary: str, *parts: str, unfolded: bool = False) -> Markup:
    """Return parts below a title that opens on a click; nothing without a part."""
    opened, body = Markup(" open") if unfolded else "", _together(parts)
    text = Markup("<details{}><summary>{}</summary>{}</details>").format(opened, summary, body)
    return text if body else body


def write_document(path: Path, *, sections: Iterable[Any], footer: str, **content: object) -> Path:
    """Write a whole page as HTML and return its path; sections without parts are omitted.

    `content` is title, kicker and headline, and, optionally, facts (number, words) and warnings.
    The footer begins with the version.
    """
    shown = [section for section in sections if section and section.body]
    values = {"facts": (), "warnings": (), "footer": f"airswing {__version__}. {footer}", **content}
    return write_text(path, _TEMPLATES.get_template("page.html").render(sections=shown, **values))
