"""Times of reports: notations, zones, blanks and the unreadable."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from airswing.reports.values import parse_times

NOON = np.datetime64("2009-01-05T12:00:00", "ns")


@pytest.mark.parametrize(
    "text",
    [
        "2009-01-05T12:00:00Z",
        "2009-01-05 12:00:00",
        "2009-01-05T12:00",
        "2009-01-05T06:00:00-06:00",
        "2009-01-05T13:00:00+0100",
        " 2009-01-05T12:00:00.000Z ",
        "20090105T120000Z",
        "200901051200",
        "20090105120000",
        "1231156800",
    ],
)
def test_one_moment_in_many_notations(text):
    time, blank = parse_times(pd.Series([text]))
    assert time[0] == NOON
    assert not blank[0]


def test_blank_and_unreadable_differ():
    time, blank = parse_times(pd.Series(["", "  ", None, "noon", "05/01/2009 12:00", "2009-13-01"]))
    assert np.isnat(time).all()
    assert blank.tolist() == [True, True, True, False, False, False]


def test_rows_keep_their_own_notation():
    time, _ = parse_times(
        pd.Series(["2009-01-05T12:00:00", "2009-01-05T13:00:00+01:00", "x", "2009-01-05T12:00:00"])
    )
    assert (time[[0, 1, 3]] == NOON).all()
    assert np.isnat(time[2])


@pytest.mark.parametrize("value", [1231156800, 200901051200, 20090105120000])
def test_numbers(value):
    assert parse_times(pd.Series([value]))[0][0] == NOON


def test_timestamps_with_a_zone_become_utc():
    stamps = pd.Series(pd.to_datetime(["2009-01-05T06:00:00-06:00"]))
    assert parse_times(stamps)[0][0] == NOON
    time, blank = parse_times(pd.Series(pd.to_datetime(["2009-01-05T12:00:00", None])))
    assert time[0] == NOON
    assert blank.tolist() == [False, True]


def test_fractions_of_a_second_survive():
    time, _ = parse_times(pd.Series(["2009-01-05T12:00:00.25Z"]))
    assert time[0] - NOON == np.timedelta64(250, "ms")
