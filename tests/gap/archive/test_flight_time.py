"""Minutes since the first report of a flight, in whatever order reports come."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from airswing.gap.archive.flight_time import flight_time


def reports(flight, time):
    return SimpleNamespace(flight=np.array(flight, int), time=np.array(time, float))


def test_it_is_counted_from_the_first_report_of_each_flight():
    frame = reports([7, 3, 7, 3, 3], [600.0, 60.0, 0.0, 120.0, 3660.0])
    assert flight_time(frame).tolist() == [10.0, 0.0, 0.0, 1.0, 60.0]
    assert flight_time(reports([], [])).size == 0


def test_reports_of_one_number_for_days_are_of_no_flight():
    flown = flight_time(reports([0, 0, 0], [0.0, 86400.0, 86460.0]))
    assert flown[:2].tolist() == [0.0, 1440.0] and np.isnan(flown[2])


@given(st.permutations(range(12)), st.floats(-1e6, 1e6))
def test_order_and_epoch_do_not_matter(order, epoch):
    flight = np.repeat([4, 1, 9], 4)
    time = np.arange(12) * 97.0
    own = flight_time(reports(flight, time))
    other = flight_time(reports(flight[order], time[order] + epoch))
    np.testing.assert_allclose(other, own[order], atol=1e-6)
    assert own.min() == 0.0
