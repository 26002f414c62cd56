import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airswing  # noqa: F401
from airswing.compass.deviation import fit_deviation
from airswing.compass.swingcard import (
    card_rows,
    steer,
    swing_card,
    write_swing_cards,
    write_tables_csv,
)
from airswing.compass.table import NODES, add_tables, unit_interpolation
from airswing.errors import InputError
from tests.compass.flown import Setting, fly


@pytest.fixture(scope="module")
def fits():
    headings, _ = fly([[1, 3, -2, 0, 0], [0, 2, 0, 0, 0]], Setting(aircraft=2, days=15), 31)
    headings["screening"][int(headings["row_size"][0]) :] = 1
    return add_tables(fit_deviation(headings), headings)


@given(st.lists(st.floats(-15, 15), min_size=8, max_size=8), st.floats(0, 359))
def test_steering_gives_the_heading_wanted(table, wanted):
    held = steer(table, [wanted])
    made = held - unit_interpolation(table, held)
    assert (made[0] - wanted + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_card_by_hand():
    # the compass reads 4 degrees too much everywhere: steer 4 more
    rows = card_rows(np.full(8, 4.0))
    assert rows[0] == ("N", "004")
    assert rows[1] == ("030", "034")
    assert rows[9] == ("W", "274")
    assert card_rows(np.full(8, -1.0))[0] == ("N", "359")


def test_csv_holds_every_node_and_the_refused(fits, tmp_path):
    rows = list(csv.DictReader(write_tables_csv(fits, tmp_path / "tables.csv").open()))
    assert len(rows) == 16
    assert [float(row["heading_deg"]) for row in rows[:8]] == NODES.tolist()
    assert [float(row["table_correction_deg"]) for row in rows[:8]] == pytest.approx(
        fits["table_correction"][0, 0].to_numpy()
    )
    assert {row["status"] for row in rows[8:]} == {"too_few_reports"}
    assert {row["table_correction_deg"] for row in rows[8:]} == {""}
    assert {row["sign"] for row in rows} == {"subtract_error"}


def test_cards_are_one_page_each_and_indexed(fits, tmp_path):
    cards = write_swing_cards(fits, tmp_path / "cards")
    assert [card.name for card in cards] == ["N000.pdf", "N001.pdf"]
    for card in cards:
        content = card.read_bytes()
        assert content.startswith(b"%PDF")
        assert content.count(b"/Type /Page\n") + content.count(b"/Type /Page ") == 1
    index = list(csv.DictReader((tmp_path / "cards" / "index.csv").open()))
    assert [row["status"] for row in index] == ["ok", "too_few_reports"]
    assert float(index[0]["amplitude_deg"]) == pytest.approx(
        fits["amplitude"][0, 0].item(), abs=0.01
    )
    assert index[1]["amplitude_deg"] == ""


def test_a_refused_card_says_why(fits):
    figure = swing_card(fits, aircraft="N001")
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert words == ["NO CARD", "fit refused: too few reports"]


def test_unknown_aircraft_or_no_table(fits):
    with pytest.raises(InputError, match="N999"):
        swing_card(fits, aircraft="N999")
    with pytest.raises(InputError, match="add_tables"):
        swing_card(fits.drop_vars("table_correction"), aircraft="N000")
