"""Configuration of the documentation site (``make docs``)."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path

import matplotlib
from docutils import nodes
from matplotlib.mathtext import math_to_image
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

import airswing

HERE = Path(__file__).parent
TUTORIALS = HERE / "tutorials"

project = "airswing"
author = "airswing developers"
copyright = "airswing developers"
version = release = airswing.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_nb",
]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

# The notebooks are the tutorials: they are copied next to the pages and executed at each build.
TUTORIALS.mkdir(exist_ok=True)
for notebook in sorted((HERE.parent / "notebooks").glob("*.ipynb")):
    shutil.copy(notebook, TUTORIALS / notebook.name)
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True

autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

html_theme = "pydata_sphinx_theme"
html_title = "airswing"
html_theme_options = {
    "navigation_depth": 2,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "navbar_end": ["theme-switcher"],
}
html_sidebars = {"**": []}  # the header and the page's contents suffice
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["airswing.css"]


def svg(latex: str, size: float) -> str:
    """Equation as an SVG element on the baseline of the text; it needs no network to be read."""
    style = {"mathtext.fontset": "stix", "svg.fonttype": "path", "font.size": size}
    with matplotlib.rc_context(style):
        out = io.StringIO()
        depth = math_to_image(f"${' '.join(latex.split())}$", out, format="svg", dpi=72)
    element = out.getvalue()[out.getvalue().index("<svg") :].strip()
    element = element.replace("<svg", f'<svg role="img" style="vertical-align: -{depth}pt"', 1)
    return re.sub(r"(fill|stroke): #000000", r"\1: currentColor", element)


def setup(app: Sphinx) -> None:
    """Draw equations with the package's drawing library."""

    def inline(translator: HTML5Translator, node: nodes.math) -> None:
        translator.body.append(svg(node.astext(), 13.0))
        raise nodes.SkipNode

    def block(translator: HTML5Translator, node: nodes.math_block) -> None:
        lines = [svg(line, 15.0) for line in node.astext().splitlines() if line.strip()]
        translator.body.append(f'<div class="equation">{"<br>".join(lines)}</div>')
        raise nodes.SkipNode

    app.add_html_math_renderer("svg", (inline, None), (block, None))


html_math_renderer = "svg"
