"""Parts of a page: sections, tables, folded details, and the whole HTML document.

The result is one HTML text with its styles and images inside. Nothing is fetched, and all of it can
be read without scripts (the script opens folded parts for printing, and sorts and searches
tables). Jinja2 and markupsafe escape every text.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


@dataclass(frozen=True)
class Section:
    """A section of a page: title, first sentence and parts (figures, tables, paragraphs)."""

    anchor: str
    title: str
    lead: str = ""
    parts: list[Markup] = field(default_factory=list)


@dataclass(frozen=True)
class Column:
    """A column of a table; kind is "" for numbers, "words" or "long" for text."""

    title: str
    kind: str = ""


@dataclass(frozen=True)
class Row:
    """A row of a table; a row in doubt is printed in grey italics."""

    cells: Sequence[object]
    doubt: bool = False


@lru_cache(maxsize=1)
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader("airswing.report.html", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.globals["zip"] = zip
    return found


def table(
    columns: Sequence[Column], rows: Iterable[Row], *, caption: str = "", sortable: bool = False
) -> Markup:
    """Return a table with a text below it; a sortable one can be searched if it is long."""
    text = (
        _environment()
        .get_template("table.html")
        .render(columns=columns, rows=list(rows), caption=caption, sortable=sortable)
    )
    return Markup(text)


def paragraph(text: str, *, note: bool = False) -> Markup:
    """Return a paragraph; a note is highlighted."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def heading(text: str) -> Markup:
    """Return a heading inside a section."""
    return Markup("<h3>{}</h3>").format(text)


def listing(items: Iterable[object]) -> Markup:
    """Return a bulleted list."""
    inside = Markup("").join(Markup("<li>{}</li>").format(item) for item in items)
    return Markup('<ul class="plain">{}</ul>').format(inside)


def described(title: str, text: str, smaller: Iterable[str]) -> Markup:
    """Return a bold title, a text, and smaller lines below it (empty ones are omitted)."""
    lines = (Markup('<span class="small">{}</span>').format(line) for line in smaller if line)
    return Markup("<b>{}</b> {}{}").format(title, text, Markup("").join(lines))


def link(address: str, text: str) -> Markup:
    """Return a link to a relative address; any other address is shown as text without a link."""
    if ":" in address.split("/")[0] or address.startswith("//"):
        return Markup("{}").format(text)
    return Markup('<a href="{}">{}</a>').format(address, text)


def folded(summary: str, parts: Iterable[Markup], *, unfolded: bool = False) -> Markup:
    """Return parts below a title that opens on a click (and when the page is printed)."""
    inside = Markup("").join(parts)
    state = Markup(" open") if unfolded else Markup("")
    return Markup("<details{}><summary>{}</summary>{}</details>").format(state, summary, inside)


def document(
    *,
    title: str,
    kicker: str,
    headline: str,
    sections: Sequence[Section],
    facts: Sequence[tuple[str, str]] = (),
    warnings: Sequence[str] = (),
    footer: Sequence[str] = (),
) -> str:
    """Return a whole page as HTML; sections without parts are omitted."""
    return (
        _environment()
        .get_template("page.html")
        .render(
            title=title,
            kicker=kicker,
            headline=headline,
            sections=[section for section in sections if section.parts],
            facts=facts,
            warnings=warnings,
            footer=footer,
        )
    )
