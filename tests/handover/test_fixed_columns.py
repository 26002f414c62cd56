"""Numbers, texts, dates and winds in fixed columns, compared with Python's formatting and MetPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from metpy.calc import wind_components
from metpy.units import units

from airswing.handover.fixed_columns import (
    lines_of,
    put_number,
    put_text,
    put_time,
    speed_and_direction,
    text_table,
)


def written(values, width, decimals):
    lines = lines_of("|" + "x" * width + "|", len(values))
    put_number(lines, 2, width, values, decimals=decimals)
    texts = [bytes(line).decode() for line in lines]
    assert all(text[0] == text[-1] == "|" for text in texts)
    return [text[1:-1] for text in texts]


@given(
    st.lists(st.floats(-9999.0, 99999.0, allow_nan=False), min_size=1, max_size=20),
    st.sampled_from([0, 2, 3, 5]),
)
def test_numbers_are_written_as_python_would_write_them(values, decimals):
    for value, text in zip(values, written(values, 13, decimals), strict=True):
        assert len(text) == 13 and text == text.rjust(13)
        assert float(text) == pytest.approx(value, abs=0.5000001 * 10.0**-decimals)
        assert ("." in text) == bool(decimals)
        assert not text.strip().startswith("-0.0000") or float(text) != 0.0


@pytest.mark.parametrize(
    ("value", "width", "decimals", "text"),
    [
        (-888888.0, 11, 3, "-888888.000"),
        (-0.0004, 9, 3, "    0.000"),
        (0.0, 4, 0, "   0"),
        (129.0, 11, 3, "    129.000"),
        (-12.5, 8, 2, "  -12.50"),
        (99999.0, 5, 0, "99999"),
        (-0.5, 6, 1, "  -0.5"),
        (9.9996, 8, 3, "  10.000"),
    ],
)
def test_numbers_by_hand(value, width, decimals, text):
    assert written([value], width, decimals) == [text]


@pytest.mark.parametrize(
    ("value", "width", "decimals"),
    [
        (100000.0, 5, 0),
        (-888888.0, 10, 3),
        (np.nan, 11, 3),
        (np.inf, 11, 3),
        (9999.9999, 8, 3),
        (-1.0, 5, 3),
        (1e30, 12, 3),
    ],
)
def test_numbers_that_do_not_fit_are_refused(value, width, decimals):
    with pytest.raises(ValueError, match="columns"):
        written([1.0, value], width, decimals)


def test_texts_and_dates():
    lines = lines_of(f"{'':30}", 3)
    put_text(lines, 3, text_table(["N1", "abc", "x y"], 5)[[2, 0, 1]])
    moments = np.array(["2008-12-31T23:59:59", "2009-01-01T00:00:00", "2000-02-29T12:34:56"])
    put_time(lines, 10, moments.astype("M8[s]").astype(np.int64), pattern="yyyymmddhhmmss")
    assert [bytes(line).decode() for line in lines] == [
        "  x y    20081231235959       ",
        "  N1     20090101000000       ",
        "  abc    20000229123456       ",
    ]
    put_time(lines, 1, moments.astype("M8[s]").astype(np.int64), pattern="yyyy-mm-dd_hh:mm:ss")
    assert bytes(lines[0]).decode()[:19] == "2008-12-31_23:59:59"


def test_components_come_back_through_metpy():
    rng = np.random.default_rng(1)
    u, v = rng.normal(0.0, 20.0, (2, 500))
    u[:9], v[:9] = [0, -9, -9, -9, 0, 9, 9, 9, -0.0], [-9, -9, 0, 9, 9, 9, 0, -9, -5]
    speed, direction = speed_and_direction(u, v)
    assert ((direction > 0.0) & (direction <= 360.0)).all() and direction[[0, 8]].tolist() == [
        360
    ] * 2
    back = wind_components(speed * units("m/s"), direction * units.degree)
    np.testing.assert_allclose([part.magnitude for part in back], [u, v], atol=1e-9)
    assert speed_and_direction([0.0], [0.0]) == (0.0, 360.0)


def test_directions_below_the_least_are_north():
    _, direction = speed_and_direction([-1e-5, -1e-5, 1e-5], [-1.0, -1.0, -1.0], least=0.001)
    assert direction[:2] == pytest.approx([360.0, 360.0]) and direction[2] > 359.999
    assert speed_and_direction([-1e-5], [-1.0])[1] == pytest.approx([5.73e-4], rel=1e-3)
