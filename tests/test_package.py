"""The package's front: stages found by name, quick to start."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import airswing


@pytest.mark.parametrize("name", airswing.__all__)
def test_every_stage_is_found_by_name(name):
    assert name in dir(airswing)
    assert callable(getattr(airswing, name))
    assert getattr(airswing, name).__doc__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="colour"):
        _ = airswing.colour


def test_help_imports_nothing_heavy():
    code = (
        "import sys, airswing.cli\n"
        "heavy = {'xarray', 'pandas', 'scipy', 'matplotlib', 'distributed', 'eccodes', 'metpy'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_what_editors_see_is_what_is_there():
    """The names written out for editors and mypy are those that are imported on first use."""
    tree = ast.parse(Path(airswing.__file__).read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    written = {
        alias.asname: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert written == airswing._STAGES
    for name in airswing.__all__:
        assert callable(getattr(airswing, name))
