"""Numbers with a unit: what they are worth, and what is none."""

from __future__ import annotations

import math
from datetime import datetime

import pytest

from airswing.quantities import quantity, spelt_out


def test_quantities():
    assert quantity("0.1 arcmin", "radian") == pytest.approx(math.radians(0.1 / 60))
    assert quantity("1 kt", "meter / second") == pytest.approx(0.514444, abs=1e-6)


@pytest.mark.parametrize(
    ("bare", "unit"), [(None, "second"), (3, "second"), ("3", "second"), (" 0.1", "radian")]
)
def test_a_bare_number_is_refused_also_as_a_string(bare, unit):
    with pytest.raises(ValueError, match=r"needs a unit, such as '[\d.]+ (min|deg)'"):
        quantity(bare, unit)


@pytest.mark.parametrize(
    "text",
    ["(3 h", "5 m/s/", "  ", "5..2 h", "2**2**100 s", "1e400 s", "nan s", "3 kt", "3 h )"],
)
def test_what_is_no_number_with_a_unit_is_refused(text):
    with pytest.raises(ValueError, match="is not a quantity"):
        quantity(text, "second")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        (20091020, datetime(2009, 10, 20)),
        ("20091020", datetime(2009, 10, 20)),
        ("2009102006", datetime(2009, 10, 20, 6)),
        (200910200630, datetime(2009, 10, 20, 6, 30)),
        ("20091020063015", datetime(2009, 10, 20, 6, 30, 15)),
        ("2009-10-20T06:00", "2009-10-20T06:00"),
        (None, None),
    ],
)
def test_times_of_digits_are_dates_and_not_seconds(written, meant):
    assert spelt_out(written) == meant


@pytest.mark.parametrize("written", [-1, 1, 0.5, "1256018400", "20091320", "2009", True, "1e9"])
def test_numbers_that_are_no_time_are_refused(written):
    with pytest.raises(ValueError, match="is no time"):
        spelt_out(written)
