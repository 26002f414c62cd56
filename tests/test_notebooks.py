"""The tutorials run; `make test-all` and `make docs` also run each in a kernel of its own."""

import ast
import json
import sys

import matplotlib.pyplot as plt
import pytest
from IPython.core.formatters import DisplayFormatter

from tests.conftest import ROOT


@pytest.mark.parametrize("path", sorted(ROOT.glob("notebooks/*.ipynb")), ids=lambda path: path.stem)
def test_every_cell_runs_and_is_shown(path, monkeypatch, blank_cards):
    monkeypatch.setattr("airswing.report.run.page.write_page", lambda *_, **__: "")
    monkeypatch.setattr(sys, "displayhook", DisplayFormatter().format)
    names = {}
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            statements = ast.Interactive(ast.parse("".join(cell["source"])).body)
            exec(compile(statements, path.name, "single"), names)
    for number in plt.get_fignums():
        plt.figure(number).canvas.draw()
    plt.close("all")
