"""The public functions: found by name, documented; their examples and the notebooks run.

The examples of the docstrings use the products of the quickstart: ``reports``, ``headings``,
``fits`` and ``corrected``, and an output folder ``folder``.
"""

import ast
import doctest
import inspect
import json
import re
import shutil
import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from IPython.core.formatters import DisplayFormatter

import airswing
from tests.conftest import ROOT

SLOW = {"run", "diagnose"}
NAMES = [
    pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
    for name in airswing.__all__
]


@pytest.fixture(scope="module")
def products(tmp_path_factory, quickstart, root):
    """What the examples use."""
    folder = tmp_path_factory.mktemp("examples") / "results"
    shutil.copytree(quickstart, folder)
    modules = {"airswing": airswing, "np": np, "pd": pd, "xr": xr}
    datasets = {
        "reports": airswing.read_reports(str(root / "data_samples/reports/N40[1-3].csv")),
        "headings": airswing.open_product(folder / "headings"),
        "fits": airswing.read_product(folder / "fits.nc"),
        "corrected": airswing.open_product(folder / "corrected"),
    }
    return modules | datasets | {"folder": folder}


@pytest.mark.parametrize("name", NAMES)
def test_examples_give_what_they_state(name, products, root, monkeypatch):
    monkeypatch.chdir(root)
    text = inspect.getdoc(getattr(airswing, name)) or ""
    example = doctest.DocTestParser().get_doctest(text, dict(products), name, None, None)
    assert example.examples and "+SKIP" not in text
    messages = []
    runner = doctest.DocTestRunner()
    assert runner.run(example, out=messages.append).failed == 0, "".join(messages)


@pytest.mark.parametrize("name", airswing.__all__)
def test_docstrings_name_every_parameter_and_the_result(name):
    function = getattr(airswing, name)
    assert name in dir(airswing) and callable(function)
    text = inspect.getdoc(function) or ""
    if inspect.isclass(function):
        assert "Attributes\n" in text
        return
    signature = inspect.signature(function)
    section = text.partition("Parameters\n")[2]
    for parameter in signature.parameters.values():
        listed = re.search(rf"^[\w, *]*\b{parameter.name}\b[\w, *]*( :|$)", section, re.MULTILINE)
        assert listed, parameter.name
    if signature.return_annotation not in (None, "None"):
        assert "Returns\n-------" in text


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


@pytest.mark.parametrize("path", sorted(ROOT.glob("notebooks/*.ipynb")), ids=lambda path: path.stem)
def test_every_cell_of_a_notebook_runs_and_is_shown(path, monkeypatch):
    """In this process; ``make test-all`` and ``make docs`` run each in a kernel of its own."""
    monkeypatch.setattr(sys, "displayhook", DisplayFormatter().format)
    names = {}
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            statements = ast.Interactive(ast.parse("".join(cell["source"])).body)
            exec(compile(statements, path.name, "single"), names)
    for number in plt.get_fignums():
        plt.figure(number).canvas.draw()
    plt.close("all")
