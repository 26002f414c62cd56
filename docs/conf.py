"""Configuration of the documentation site (``make docs``)."""

from __future__ import annotations

import shutil
from pathlib import Path

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
    "sphinx.ext.mathjax",
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
