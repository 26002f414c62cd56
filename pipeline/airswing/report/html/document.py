"""Parts of a page: sections, tables, figures, folded details, and the whole HTML document.

The page is one HTML text with styles and images inside; nothing is downloaded, and it is readable
without scripts. Jinja2 and markupsafe escape every text.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.products.whole_files import atomic
from airswing.report.html.style import PAGE_DPI, png_bytes
from airswing.report.html.text import Units

#: Colours of the palette: a drawing has few, and their mixtures along edges.
_COLOURS = 256
#: Width in CSS pixels below which a figure is scrolled instead of made smaller: text of 9 points
#: is then 7 pixels high.
_LEAST_WIDTH = 560
_TEMPLATES = Environment(
    loader=PackageLoader("airswing.report.html", "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


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
    shown = (one if isinstance(one, Markup) else paragraph(one) for one in parts if one)
    return Markup("\n").join(shown)


class Figures:
    """Figures of a page, each also a PNG file in a folder, if there is one.

    Files of an earlier page are removed.
    """

    def __init__(self, folder: Path | None = None, units: Units = "kt") -> None:
        self.folder, self.units = folder, units
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
            plain = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.")
            with atomic(self.folder / f"{plain}.png") as temporary:
                temporary.write_bytes(content)
            image = Markup('<a href="{}">{}</a>').format(f"{self.folder.name}/{plain}.png", image)
        return Markup(
            '<figure><div class="scroll">{}</div><figcaption>{}</figcaption></figure>'
        ).format(image, caption)


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

    Columns of text are `words`, or `long` where lines wrap. Rows in `doubt` are printed in grey
    italics. A long sortable table can be searched. Nothing is returned where there is no row.
    """
    if isinstance(content, Mapping):
        titles, rows = list(content), list(zip(*content.values(), strict=True))
    else:
        titles = list(content[0]) if content else []
        rows = [tuple(row.values()) for row in content]
    if not rows:
        return Markup()
    text = _TEMPLATES.get_template("table.html").render(
        titles=titles,
        kinds=["words" if one in words else "long" if one in long else "" for one in titles],
        rows=list(zip(repeat(False) if doubt is None else doubt, rows, strict=False)),
        caption=caption,
        sortable=sortable,
    )
    return Markup(text)


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


def described(title: str, text: str, smaller: Iterable[str]) -> Markup:
    """Return a bold title, a text, and smaller lines below it (empty ones are omitted)."""
    lines = (Markup('<span class="small">{}</span>').format(line) for line in smaller if line)
    return Markup("<b>{}</b> {}{}").format(title, text, Markup("").join(lines))


def link(address: str, text: str) -> Markup:
    """Return a link to a relative address; any other address is shown as text without a link."""
    if ":" in address.split("/")[0] or address.startswith("//"):
        return Markup("{}").format(text)
    return Markup('<a href="{}">{}</a>').format(address, text)


def folded(summary: str, *parts: str, unfolded: bool = False) -> Markup:
    """Return parts below a title that opens on a click; nothing without a part."""
    opened, body = Markup(" open") if unfolded else "", _together(parts)
    text = Markup("<details{}><summary>{}</summary>{}</details>").format(opened, summary, body)
    return text if body else body


def document(
    *,
    title: str,
    kicker: str,
    headline: str,
    sections: Iterable[Any],
    facts: Sequence[tuple[str, str]] = (),
    warnings: Sequence[str] = (),
    footer: str = "",
) -> str:
    """Return a whole page as HTML; sections without parts, or false, are omitted."""
    return _TEMPLATES.get_template("page.html").render(
        title=title,
        kicker=kicker,
        headline=headline,
        sections=[section for section in sections if section and section.body],
        facts=facts,
        warnings=warnings,
        footer=footer,
    )
