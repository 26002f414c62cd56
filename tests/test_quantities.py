"""Numbers with a unit: what they are worth, and what is none."""

from __future__ import annotations

import math

import pytest

from airswing.quantities import quantity


def test_quantities():
    assert quantity("0.1 arcmin", "radian") == pytest.approx(math.radians(0.1 / 60))
    assert quantity("1 kt", "meter / second") == pytest.approx(0.514444, abs=1e-6)
    with pytest.raises(ValueError, match="needs a unit"):
        quantity(3, "second")


@pytest.mark.parametrize(
    "text",
    ["(3 h", "5 m/s/", "  ", "5..2 h", "2**2**100 s", "1e400 s", "nan s", "3", "3 kt", "3 h )"],
)
def test_what_is_no_number_with_a_unit_is_refused(text):
    with pytest.raises(ValueError, match="is not a quantity"):
        quantity(text, "second")
