"""Checks of pages and figures, and figures kept by name as a page shows them."""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser

import matplotlib

from airswing.report import html

UNIT = re.compile(
    r"\((degree|kt|m/s|m²/s²|km|hPa|K|%|date|number)\)|degree|reports|probability|correlation|"
    r"log Bayes factor|draws|expected|barbs|°C|phase"
)


class Balance(HTMLParser):
    """Collect tags left open, and every address the page asks for."""

    void = frozenset({"meta", "img", "br", "link", "input", "hr"})

    def __init__(self):
        super().__init__()
        self.open = []
        self.addresses = []
        self.images = 0

    def handle_starttag(self, tag, attrs):
        if tag not in self.void:
            self.open.append(tag)
        self.images += tag == "img"
        self.addresses += [str(v) for k, v in attrs if k in {"src", "href"}]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_page(written):
    """No tag stays open, nothing is fetched, and every figure is a file as well."""
    text, balance = written.read_text("utf-8"), Balance()
    balance.feed(text)
    assert balance.open == []
    outside = [a for a in balance.addresses if not a.startswith(("data:image/", "#"))]
    files = sorted(a for a in outside if a.startswith("figures/"))
    drawn = (written.parent / "figures").glob("*.png")
    assert files == sorted(f"figures/{file.name}" for file in drawn)
    assert len(files) == balance.images
    assert not re.search(r"https?://", re.sub(r'src="data:[^"]*"', "", text))
    headline = re.search(r"<h1>(.*?)</h1>", text)
    assert headline and len(headline.group(1).split()) <= 25
    return text, balance


def check_figure(figure):
    """A figure counts what it shows and names its axes with units."""
    assert re.search(r"n = [\d,]+", figure.caption), figure.caption
    assert "nan" not in figure.caption
    for axes in figure.axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            assert not label or re.match(r"N\d", label) or UNIT.search(label), label
    assert "matplotlib.pyplot" not in sys.modules or not matplotlib.pyplot.get_fignums()


class Drawn(html.Figures):
    """Figures of a page, checked, and kept by name in ``made``; ``last`` is the latest page."""

    last: Drawn

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.made = {}
        Drawn.last = self

    def __call__(self, name, figure, **options):
        check_figure(figure)
        self.made[name] = figure
        return super().__call__(name, figure, **options)


def labels(axes):
    return [label.get_text() for label in axes.get_yticklabels()]
