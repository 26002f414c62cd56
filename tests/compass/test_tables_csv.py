import csv
import io

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import airswing  # noqa: F401
from airswing.compass.cardpage import CardPage, Curves, Words
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import NODES, add_tables, error_from_table, unit_interpolation
from airswing.compass.tables_csv import (
    _card_rows,
    _Drawing,
    _with_error,
    steer,
    write_swing_cards,
    write_tables_csv,
)
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
    rows = _card_rows(np.full(8, 4.0))
    assert rows[0] == ("N", "004")
    assert rows[1] == ("030", "034")
    assert rows[9] == ("W", "274")
    assert _card_rows(np.full(8, -1.0))[0] == ("N", "359")


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
    assert [card.name for card in cards] == ["N000.pdf"]  # N001 was refused
    assert not (tmp_path / "cards" / "N001.pdf").exists()
    for card in cards:
        content = card.read_bytes()
        assert content.startswith(b"%PDF")
        assert content.count(b"/Type /Page\n") + content.count(b"/Type /Page ") == 1
    index = list(csv.DictReader((tmp_path / "cards" / "index.csv").open()))
    assert [row["status"] for row in index] == ["ok", "too_few_reports"]
    assert [row["card"] for row in index] == ["N000.pdf", ""]
    assert float(index[0]["amplitude_deg"]) == pytest.approx(
        fits["amplitude"][0, 0].item(), abs=0.01
    )
    assert index[1]["amplitude_deg"] == ""


def card(fits, aircraft):
    return _Drawing().of(_with_error(fits.isel(aircraft=aircraft, reference=0)))


def pixels(figure):
    stream = io.BytesIO()
    figure.savefig(stream, format="rgba", dpi=50)
    return stream.getvalue()


def test_a_page_drawn_over_again_keeps_nothing_of_the_aircraft_before(fits, tmp_path):
    changed = fits.copy(deep=True)
    changed["aircraft"] = ["N002", "N003"]
    for name in ("deviation", "table_correction"):
        changed[name] = -3.0 * changed[name]
    both = xr.concat([fits, changed], "aircraft", data_vars="minimal")
    write_swing_cards(both, tmp_path / "both", suffix="png")
    write_swing_cards(changed, tmp_path / "alone", suffix="png")
    drawn = [(tmp_path / place / "N002.png").read_bytes() for place in ("both", "alone")]
    assert drawn[0] == drawn[1]
    assert (tmp_path / "both/N000.png").read_bytes() != drawn[0]


def test_an_aircraft_may_have_any_name(fits, tmp_path):
    names = [r"$\frac{1$", "N_1^$"]
    named = fits.isel(aircraft=[0, 0]).assign_coords(aircraft=names)
    files = write_swing_cards(named, tmp_path)
    assert len(files) == 2 and all(file.is_file() for file in files)
    assert card(named, 1).texts[0].get_text().endswith("N_1^$")


def test_a_card_shows_its_words_and_its_curve(fits):
    page = card(fits, 0)
    words = [word for part in page.artists if isinstance(part, Words) for word in part.words]
    one = fits.isel(aircraft=0, reference=0)
    nodes = one["table_correction"].to_numpy()
    assert [w for w in words if w.startswith(("+", "-"))] == [f"{value:+.1f}" for value in nodes]
    for aim, held in _card_rows(error_from_table(one)):
        assert held in words and aim in words
    assert {"FOR", "STEER"} <= set(words) and page.texts[0].get_text().endswith("N000")
    west, east = page.axes
    assert words[-2:] == ["fit, 95 %", "table"]
    below = words.index("heading error (°)")
    assert words[below - 3 : below] == ["W", "N", "E"]
    assert words[words.index("E", below) :][:3] == ["E", "S", "W"]
    low, high = west.get_ylim()
    values = [float(word.replace("−", "-")) for word in words[below + 1 : words.index("E", below)]]
    assert len(values) >= 4 and low <= min(values) and max(values) <= high
    assert np.diff(values) == pytest.approx(values[1] - values[0])
    fit, table = (np.asarray(line.get_ydata()) for line in east.lines[1:])
    assert table[::45] == pytest.approx(error_from_table(one)[2:7])  # from east to west
    curve = one["deviation"].to_numpy()
    assert fit[90] == pytest.approx(curve @ [1, 0, -1, 0, 1], abs=0.02)  # south
    blank = CardPage((("",) * 4, ("",) * 4), (6, 8)).figure
    assert pixels(page) != pixels(blank)


def test_a_unit_without_any_error_has_a_card_too():
    none = [np.zeros(181), np.zeros(181)]
    page, words = CardPage((("",) * 4, ("",) * 4), (6, 8)), [("",) * 4]
    assert pixels(page.show("", "", (words * 6, words * 8), Curves(none, none, none, none)))


def test_fits_without_tables_have_no_cards(fits, tmp_path):
    with pytest.raises(InputError, match="add_tables"):
        write_swing_cards(fits.drop_vars("table_correction"), tmp_path)
