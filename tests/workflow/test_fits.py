"""What an earlier run noted of the cards it drew."""

from pathlib import Path

import pytest

from airswing.products.checked import note
from airswing.workflow.fits import _noted


@pytest.mark.parametrize("code", ["now", "then"])
def test_a_note_leads_to_no_file_of_another_folder(tmp_path: Path, code: str) -> None:
    kept = tmp_path / "cards.json"
    cards = {"N401": {"card": "../elsewhere/N401.pdf", "mark": "m", "status": 0}}
    kept.write_text(note({"code": code, "cards": cards}))
    told = _noted(kept, "now")["N401"]
    assert told["card"] == "N401.pdf"
    # of other code a card is known, and drawn anew
    assert told["mark"] == ("m" if code == "now" else "")
