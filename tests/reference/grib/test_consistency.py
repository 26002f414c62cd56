"""What a field's header says of its lowest value: taken as it is, or told damaged."""

from __future__ import annotations

import pytest

from airswing.reference.grib.consistency import check_lowest
from airswing.reference.grib.fields import PRESSURE, SkippedError, U


@pytest.mark.parametrize(
    ("kind", "reference", "binary", "decimal"),
    [(U, -45.3, -3, 0), (U, -453.0, 5, 1), (PRESSURE, 2.0e4, -4, 0), (PRESSURE, 200.0, 0, -2)],
)
def test_usual_headers_pass(kind, reference, binary, decimal):
    check_lowest(kind, reference, binary, decimal)


@pytest.mark.parametrize(
    ("kind", "reference", "binary", "decimal"),
    [
        (U, -45.3, -3, -2),  # R 10^-D: 4,530 m/s
        (U, float("nan"), 0, 0),
        (PRESSURE, -1.0, 0, 0),
        (U, 1.0, 30_000, 0),
        (U, 0.0, 0, -30_000),
    ],
)
def test_what_no_field_has_is_told_damaged(kind, reference, binary, decimal):
    with pytest.raises(SkippedError):
        check_lowest(kind, reference, binary, decimal)
