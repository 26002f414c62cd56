"""The package's front: stages found by name, quick to start."""

from __future__ import annotations

import subprocess
import sys

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
