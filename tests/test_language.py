"""Documents, messages, names and docstrings use the standard terms of the field.

The words below are not wrong English, but this package has used them in a private sense. The
message of a failure names the plain expression.
"""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PLAIN = {
    "told|untold": "estimated, stated, reported",
    "struck": "affected",
    "mended": "corrected",
    "lifted": "removed",
    "borne[ _]out": "confirmed by the data",
    "octets?": "bytes",
    "beside": "in addition to, next to",
    "spool": "store",
    "decoy": "placebo",
    "leftover": "remainder",
    "nats": "log Bayes factor",
}
FILES = [
    *(ROOT / "pipeline").rglob("*.py"),
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "notebooks").glob("*.ipynb"),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
]
#: Keys of gap.json and names of products, which other programs read.
CONTRACT = r"(raw|tempered|evidence|difference)_nats"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_standard_terms(path):
    text = re.sub(CONTRACT, "", path.read_text(encoding="utf-8"))
    matches = {
        f"line {text.count(chr(10), 0, match.start()) + 1}: {match[0]} ({term})"
        for words, term in PLAIN.items()
        for match in re.finditer(rf"(?<![A-Za-z])(?:{words})(?![A-Za-z])", text, re.IGNORECASE)
    }
    assert not matches
