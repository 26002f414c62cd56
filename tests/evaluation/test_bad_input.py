"""Bad input to `airswing evaluate` and `airswing compare`: one message, status 2."""

from __future__ import annotations

import sys

import pytest
import yaml

from airswing import cli
from airswing.products.netcdf import write_product
from tests.evaluation.fleets import simulate_fleet

GROUPS = {
    "start": "2009-10-20",
    "before_start": "2009-07-20",
    "corrected": ["N000", "N001"],
    "controls": ["N002", "N003"],
}


@pytest.fixture(scope="module")
def products(tmp_path_factory):
    """A folder with the headings of a small fleet, as `airswing collocate` writes them."""
    folder = tmp_path_factory.mktemp("products")
    fleet = simulate_fleet(0, days=(5, 5), corrected=2, controls=2, flights=1, reports=2)
    write_product(fleet.headings, folder / "headings.nc", title="headings of a simulated fleet")
    return folder


def asked(products, monkeypatch, capsys, command: str, **changes) -> str:
    """Run a command that must end with status 2, and return its one message."""
    content = {
        "reports": {"files": "none"},
        "references": {"rr": {"files": "none"}},
        "field_test": GROUPS | changes,
        "output": str(products),
    }
    path = products / "config.yaml"
    path.write_text(yaml.safe_dump(content))
    monkeypatch.setattr(sys, "argv", ["airswing", command, str(path), "--quiet"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "Traceback" not in said.err
    return said.err.strip().splitlines()[-1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"corrected": ["N000", "N777"]}, ["N777", "does not hold", "N003"]),
        ({"controls": []}, ["at least one aircraft"]),
        ({"before_start": "2010-07-20"}, ["before_start", "earlier"]),
    ],
    ids=["unknown aircraft", "empty group", "wrong order"],
)
def test_a_field_test_that_cannot_be_is_refused(products, monkeypatch, capsys, changes, words):
    message = asked(products, monkeypatch, capsys, "evaluate", **changes)
    assert all(word in message for word in words), message


def test_one_reference_only_cannot_be_compared(products, monkeypatch, capsys):
    message = asked(products, monkeypatch, capsys, "compare")
    assert "references.rr.files" in message  # of one, what an interval costs is looked for
    assert "no file found" in message
