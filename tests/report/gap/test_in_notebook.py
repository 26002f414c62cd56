"""A diagnosis in a notebook: its figures are those of the page, its table what was found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from tests.gap.toy import make_frame
from tests.report import gap_factories
from tests.report.test_page import Balance

import airswing
from airswing.gap.checks.refit_claims import Adjustment
from airswing.gap.diagnose import Diagnosis
from airswing.gap.result.schema import GapReport, UnknownClosureEntry, UnknownEntry
from airswing.products.netcdf import read_product
from airswing.report import write_gap_page
from airswing.report.gap.in_notebook import ShownDiagnosis
from airswing.report.gap.verdict import verdict


@pytest.fixture(scope="module")
def found(gap_product: Path) -> ShownDiagnosis:
    """A diagnosis as the command wrote it."""
    report = GapReport.read(gap_product / "gap.json")
    adjustment = object.__new__(Adjustment)  # not looked at here
    return ShownDiagnosis(report, read_product(gap_product / "gap.nc"), adjustment)


def test_figures_are_those_of_the_page(found, tmp_path):
    drawn = found.figures
    assert all(isinstance(figure, Figure) for figure in drawn.values())
    page = write_gap_page(tmp_path, gap=found.report, maps=found.dataset)
    assert page.read_text(encoding="utf-8").count("<figure") == len(drawn)


def test_html_has_the_verdict_and_a_row_for_everything_found(found):
    shown = found._repr_html_()
    assert str(verdict(found.report))[:20] in shown
    rows = len(found.report.effects) + len(found.report.unknown.where)
    assert rows > 0
    assert shown.count("<tr") == rows + 1
    Balance().feed(shown)


def test_what_has_no_name_has_its_row_and_its_figure(found):
    place = gap_factories.unknown_place()
    unknown = UnknownEntry(True, [place], UnknownClosureEntry(7.4, 7.2, 0.2, [0.1, 0.3]))
    more = replace(found, report=replace(found.report, unknown=unknown))
    assert "without a name" in more._repr_html_()
    assert "unknown_1" in more.figures


def test_the_public_function_returns_one():
    quiet = make_frame(aircraft=3, days=6, seed=3)
    one = airswing.diagnose(quiet, dictionary=False)
    assert isinstance(one, ShownDiagnosis)
    assert isinstance(one, Diagnosis)
    assert repr(one).startswith("Diagnosis:")
    assert airswing.diagnose.__doc__
    assert repr(quiet).startswith(f"<Frame: {quiet.size:,} reports")
