import csv

import pytest

import airswing  # noqa: F401
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import NODES, add_tables, write_tables_csv
from airswing.errors import InputError
from tests.compass.flown import Setting, fly


@pytest.fixture(scope="module")
def fits():
    headings, _ = fly([[1, 3, -2, 0, 0], [0, 2, 0, 0, 0]], Setting(aircraft=2, days=15), 31)
    headings["screening"][int(headings["row_size"][0]) :] = 1
    return add_tables(fit_deviation(headings), headings)


def test_csv_contains_every_node_and_refused_fits(fits, tmp_path):
    rows = list(csv.DictReader(write_tables_csv(fits, tmp_path / "tables.csv").open()))
    assert len(rows) == 16
    assert [float(row["heading_deg"]) for row in rows[:8]] == NODES.tolist()
    assert [float(row["table_correction_deg"]) for row in rows[:8]] == pytest.approx(
        fits["table_correction"][0, 0].to_numpy()
    )
    assert {row["status"] for row in rows[8:]} == {"too_few_reports"}
    assert {row["table_correction_deg"] for row in rows[8:]} == {""}
    assert {row["sign"] for row in rows} == {"subtract_error"}


def test_fits_without_tables_are_refused(fits, tmp_path):
    with pytest.raises(InputError, match="add_tables"):
        write_tables_csv(fits.drop_vars("table_correction"), tmp_path / "tables.csv")
