"""Swing cards: a deterministic PDF of a page an aircraft, with every figure a workshop needs."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.report import write_swing_cards
from airswing.report.run.heading_error import steer, swing_card
from airswing.report.run.selection import Run, table_digits
from tests.report import factories

HEADINGS, FITS = factories.few(3, 840)
FITS.attrs |= {"history": "2009-12-24T10:00:00Z airswing 0.1.0", "airswing_version": "0.1.0"}
FITS["status"][:, 2] = STATUS["too_few_reports"]


def texts(aircraft, fits=FITS):
    figure = swing_card(Run(HEADINGS, fits, "ruc"), aircraft)
    inside = [text for axes in figure.axes for text in axes.texts]
    shown = [text.get_text() for text in [*figure.texts, *inside]]
    return [*shown, *(line for text in shown for line in text.split("\n"))]


@given(st.lists(st.floats(-15, 15), min_size=8, max_size=8), st.floats(0, 359))
def test_steering_gives_the_heading_wanted(table, wanted):
    steered = steer(table, [wanted])[0]
    nodes = np.arange(0.0, 361.0, 45.0)
    flown = steered - np.interp(steered, nodes, [*table, table[0]])
    assert (flown - wanted + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_one_pdf_page_for_each_fit_and_the_same_bytes_again(tmp_path):
    for name in ("first.pdf", "second.pdf"):
        assert write_swing_cards(FITS, HEADINGS, tmp_path / name, reference="ruc") == 2
    content = (tmp_path / "first.pdf").read_bytes()
    assert content.startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", content)) == 2
    assert content == (tmp_path / "second.pdf").read_bytes()
    refused = FITS.assign(status=FITS["status"] * 0 + 1)
    assert write_swing_cards(refused, HEADINGS, tmp_path / "none.pdf") == 0
    assert (tmp_path / "none.pdf").read_bytes().startswith(b"%PDF")
    odd = [r"$\frac{1$", "N_1^$", "N3"]
    fits, headings = (ds.assign_coords(aircraft=odd) for ds in (FITS, HEADINGS))
    assert write_swing_cards(fits, headings, tmp_path / "cards.pdf") == 2


def test_a_card_lists_the_table_the_curve_and_the_signatures():
    card = "\n".join(texts("N400"))
    for words in (
        "N400",
        "Magnetic compass",
        "ruc (model winds)",
        "2008-07-01 to 2008-07-20 (UTC)",
        "2009-12-24 with airswing 0.1.0",
        "Load the table below.",
        "Deviation = A + B sin m + C cos m + D sin 2m + E cos 2m",
        "it is largest at m = 90° - phase",
        "FOR",
        "STEER",
        "Checked by",
        "Signature",
    ):
        assert words in card, words
    fit = FITS.sel(reference="ruc", aircraft="N400")
    assert all(f"{value + 0.0:+.1f}" in texts("N400") for value in fit["table_correction"].values)


def test_cards_state_that_no_table_or_only_a_constant_is_needed():
    fits = FITS.copy(deep=True)
    fits["status"][0] = [STATUS["no_correction_needed"], STATUS["offset_only"], 1]
    assert any(text.startswith("No correction needed") for text in texts("N400", fits))
    assert any(text.startswith("Constant correction only") for text in texts("N401", fits))


def test_a_card_has_the_decimals_of_the_table_and_the_heading_of_the_fit():
    table = FITS["table_correction"] * 0 + 1.25
    fits = FITS.assign(table_correction=table).assign_attrs(FITS.attrs)
    fits.attrs |= {"table_resolution": 0.25, "abscissa": "true"}
    card = texts("N400", fits)
    assert card.count("+1.25") == 8
    assert "Deviation card (true headings)" in card
    assert any("with m the indicated true heading." in text for text in card)
    axes = swing_card(Run(HEADINGS, fits, "ruc"), "N400").axes[0]
    assert axes.get_xlabel() == "indicated true heading (degree)"


@pytest.mark.parametrize(
    ("resolution", "digits"),
    [(0.1, 1), (1.0, 1), (0.5, 1), (0.25, 2), (0.05, 2), (0.001, 3), (0, 3)],
)
def test_decimals_of_a_table(resolution, digits):
    assert table_digits(FITS.assign_attrs(table_resolution=resolution)) == digits


def test_fits_without_tables_and_unknown_references_are_refused(tmp_path):
    with pytest.raises(InputError, match="add_tables"):
        write_swing_cards(FITS.drop_vars("table_correction"), HEADINGS, tmp_path / "cards.pdf")
    with pytest.raises(InputError, match=r"found: gfs\). Known: ruc"):
        write_swing_cards(FITS, HEADINGS, tmp_path / "cards.pdf", reference="gfs")
