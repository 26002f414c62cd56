"""The parts a page is made of: sections, tables, folded details, and the whole document.

Assumes figures and tables made elsewhere.  The result is one HTML text with its styles and
images inside: nothing is fetched, and all of it reads without scripts (the script unfolds details
for printing, and sorts and searches tables).  Every text is escaped by the templates.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


@dataclass(frozen=True)
class Section:
    """A titled stretch of a page: a lead sentence and parts (figures, tables, paragraphs)."""

    anchor: str
    title: str
    lead: str = ""
    parts: list[Markup] = field(default_factory=list)


@dataclass(frozen=True)
class Column:
    """A table's column; kind is "" for numbers, "words" or "long" for text."""

    title: str
    kind: str = ""


@dataclass(frozen=True)
class Row:
    """A table's row; a row in doubt is set in grey italics."""

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
    """Return a table as HTML.

    Parameters
    ----------
    caption : str, optional
        What the table holds, in words.
    sortable : bool, optional
        With scripts, a click on a head sorts the rows, and a long table can be searched by
        its columns of words.
    """
    text = (
        _environment()
        .get_template("table.html")
        .render(columns=columns, rows=list(rows), caption=caption, sortable=sortable)
    )
    return Markup(text)


def paragraph(text: str, *, note: bool = False) -> Markup:
    """Return a paragraph; a note stands out."""
    return Markup('<p class="note">{}</p>' if note else "<p>{}</p>").format(text)


def heading(text: str) -> Markup:
    """Return a heading inside a section."""
    return Markup("<h3>{}</h3>").format(text)


def drawing(panels: Iterable[Markup], caption: str, *, columns: int = 0) -> Markup:
    """Return panels side by side, as many as there is room for where not said, with words below."""
    inside = Markup("").join(panels)
    words = Markup("<figcaption>{}</figcaption>").format(caption) if caption else ""
    shape = f' style="grid-template-columns:repeat({columns}, 1fr)"' if columns else ""
    return Markup('<figure class="panels"{}>{}{}</figure>').format(Markup(shape), inside, words)


def listing(items: Iterable[object]) -> Markup:
    """Return a bulleted list."""
    inside = Markup("").join(Markup("<li>{}</li>").format(item) for item in items)
    return Markup('<ul class="plain">{}</ul>').format(inside)


def described(title: str, text: str, beside: Iterable[str]) -> Markup:
    """Return what stands under a title in bold, and smaller lines below it; empty ones left out."""
    lines = (Markup('<span class="beside">{}</span>').format(line) for line in beside if line)
    return Markup("<b>{}</b> {}{}").format(title, text, Markup("").join(lines))


def link(address: str, text: str) -> Markup:
    """Return a link to a file beside the page; anything but a plain address is shown as text."""
    if ":" in address.split("/")[0] or address.startswith("//"):
        return Markup("{}").format(text)
    return Markup('<a href="{}">{}</a>').format(address, text)


def folded(summary: str, parts: Iterable[Markup], *, unfolded: bool = False) -> Markup:
    """Return parts behind a line that opens on a click (and when the page is printed)."""
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
    """Return a whole page as HTML.

    Parameters
    ----------
    kicker : str
        The line above the headline: what this is a page about.
    headline : str
        The result, in a sentence.
    facts : sequence of (number, words), optional
        The few numbers that matter most.
    warnings : sequence of str, optional
        What a reader must know before trusting the headline.
    footer : sequence of str, optional
        Version, time, inputs.
    """
    return (
        _environment()
        .get_template("page.html")
        .render(
            title=title,
            kicker=kicker,
            headline=headline,
            sections=sections,
            facts=facts,
            warnings=warnings,
            footer=footer,
        )
    )
