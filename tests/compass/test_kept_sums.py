"""Sums that periods keep: put together they are the fit of all reports."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from airswing.compass.fit.deviation import sum_aircraft
from airswing.compass.fit.report_columns import Columns
from airswing.compass.kept_sums.packed import (
    packed,
    packed_bases,
    packed_sums,
    unpacked,
    unpacked_bases,
    unpacked_sums,
)
from airswing.compass.kept_sums.period_sums import (
    FARTHEST,
    SCATTER,
    Base,
    durations_of,
    mean_field,
    merged_fit,
    sum_period,
)
from airswing.products.ragged import some_reports
from tests.compass.flown import Setting, fleet_deviations, fly

SETTING = Setting(aircraft=3, days=40)
NIGHTS = 36
"""Days before those that are new."""


@pytest.fixture(scope="module")
def fleet():
    """Headings, a field that grows by a tenth, and which reports are of the last days."""
    deviation = fleet_deviations(3, np.random.default_rng(5))
    headings, _ = fly(deviation, SETTING, 12)
    time = headings["time"].to_numpy()
    share = (time - time.min()) / (time.max() - time.min())
    headings = headings.assign(horizontal_field=("report", 20_000.0 * (1.0 + 0.1 * share)))
    begin = time.min() + NIGHTS * np.timedelta64(1, "D")
    flight = headings["flight"].to_numpy()
    late = np.zeros(flight.max() + 1, dtype=bool)
    first = np.unique(flight, return_index=True)
    late[first[0]] = time[first[1]] >= begin
    return headings, late[flight]


def sums_of(headings):
    return sum_aircraft(headings, shared_error=True).groups[str(headings["reference"][0].item())]


def periods_of(parts, bases):
    found = []
    for part in parts:
        columns = Columns(part, "magnetic")
        columns.use([0])
        found.append(
            {
                str(k): sum_period(columns, k, [0], base, joint=True, blocks=True)
                for k, base in enumerate(bases)
            }
        )
    return found


def test_a_fit_of_the_days_before_and_the_sums_of_the_new_ones_are_the_fit_of_all(fleet):
    headings, late = fleet
    parts = [some_reports(headings, chosen) for chosen in (~late, late)]
    bases = [Base.of(one.fit, one.field, one.reports) for one in sums_of(parts[0])]
    first, second = periods_of(parts, bases)
    for k, whole in enumerate(sums_of(headings)):
        own = [first[str(k)], second[str(k)]]
        assert mean_field(own) == pytest.approx(whole.field, rel=1e-6)
        assert sum(one.reports for one in own) == whole.reports
        assert durations_of(own) == whole.fit.durations
        found = merged_fit(own, bases[k])
        error = np.sqrt(np.diagonal(whole.fit.covariance))
        apart = np.abs(found.theta - whole.fit.theta)
        assert np.all(apart <= 0.1 * error) and apart.any()
        spread = np.sqrt(np.diagonal(found.covariance) / np.diagonal(whole.fit.covariance))
        assert spread == pytest.approx(1.0, abs=0.03)


def test_blocks_of_periods_are_those_of_all_reports(fleet):
    """Summed where the fit of all reports is, but for the last step its blocks were made before."""
    headings, late = fleet
    every = sums_of(headings)
    bases = [Base.of(one.fit, one.field, one.reports) for one in every]
    parts = periods_of([some_reports(headings, chosen) for chosen in (~late, late)], bases)
    for k, whole in enumerate(every):
        found = merged_fit([part[str(k)] for part in parts], bases[k])
        one, other = found.blocks[0], whole.fit.blocks[0]
        for name in ("segment", "piece", "latitude", "longitude", "log_pressure"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        size = np.abs(other.sums).max(axis=1, keepdims=True)
        assert np.all(np.abs(one.sums - other.sums) <= 0.01 * size)
        assert one.within == pytest.approx(other.within, rel=0.01)
        assert one.freedom == other.freedom


def test_far_from_where_they_were_summed_the_sums_tell_nothing(fleet):
    headings, _ = fleet
    known = [Base.of(one.fit, one.field, one.reports) for one in sums_of(headings)]
    far = [replace(b, theta=b.theta + np.radians(3.0)) for b in known]
    (period,) = periods_of([headings], far)
    assert merged_fit([period["0"]], far[0]) is None


def test_what_the_limits_allow_moves_the_fit_by_hundredths_of_its_error(fleet):
    headings, _ = fleet
    rng, moved = np.random.default_rng(3), []
    for k, one in enumerate(sums_of(headings)):
        base = Base.of(one.fit, one.field, one.reports)
        error = np.sqrt(np.diagonal(one.fit.covariance))
        away = [base.theta + FARTHEST * error * rng.choice([-1, 1], error.size) for _ in range(3)]
        wide = [
            [replace(s, along=s.along * share, cross=s.cross * share) for s in base.scatters]
            for share in np.exp([-2 * SCATTER, 2 * SCATTER])
        ]
        bases = [base, *(replace(base, theta=theta) for theta in away)]
        bases += [replace(base, scatters=scatters) for scatters in wide]
        columns = Columns(headings, "magnetic")
        columns.use([0])
        periods = [sum_period(columns, k, [0], at, joint=True, blocks=False) for at in bases]
        near = {"farthest": np.inf, "scatter": np.inf}
        there, *found = (merged_fit([p], at, **near) for p, at in zip(periods, bases, strict=True))
        moved += [(other.theta - there.theta)[:5] / error[:5] for other in found]
    assert 0.005 < np.sqrt(np.mean(np.square(moved))) < 0.06
    assert np.abs(moved).max() < 0.2


def test_what_is_packed_comes_back(fleet):
    headings, _ = fleet
    bases = [Base.of(one.fit, one.field, one.reports) for one in sums_of(headings)]
    again = unpacked_bases(packed_bases({str(k): base for k, base in enumerate(bases)}))
    for k, base in enumerate(bases):
        np.testing.assert_array_equal(again[str(k)].theta, base.theta)
        np.testing.assert_array_equal(again[str(k)].free, base.free)
        for part in ("scatters", "durations", "few", "rms", "reports"):
            assert getattr(again[str(k)], part) == getattr(base, part)
    (period,) = periods_of([headings], bases)
    back = unpacked(packed(period))
    for name, base in again.items():
        one, other = merged_fit([period[name]], base), merged_fit([back[name]], base)
        np.testing.assert_array_equal(one.theta, other.theta)
        np.testing.assert_array_equal(one.flight, other.flight)
        np.testing.assert_array_equal(one.blocks[0].sums, other.blocks[0].sums)


def test_another_scatter_asks_for_a_fit(fleet):
    headings, _ = fleet
    one, *_ = sums_of(headings)
    base = replace(Base.of(one.fit, one.field, one.reports), rms=one.fit.rms_after * 1.2)
    (period,) = periods_of([headings], [base])
    assert merged_fit([period["0"]], base) is None
    found = merged_fit([period["0"]], base, scatter=0.3)
    assert found.rms_after == pytest.approx(one.fit.rms_after, rel=0.01)


def test_fits_without_a_curve_come_back(fleet):
    every = dict(zip("abc", sums_of(fleet[0]), strict=True))
    every["none"] = replace(every["a"], fit=None, reports=3)
    every["constant"] = replace(every["b"], fit=None, constant=every["c"].fit)
    back = unpacked_sums(packed_sums(every))
    for name, one in every.items():
        other = back[name]
        assert (one.reports, one.flights, one.compass_points, one.status) == (
            other.reports,
            other.flights,
            other.compass_points,
            other.status,
        )
        for fit, again in ((one.fit, other.fit), (one.constant, other.constant)):
            assert (fit is None) == (again is None)
            for part in () if fit is None else fields(fit):
                if part.name not in ("blocks", "scatters", "durations"):
                    np.testing.assert_array_equal(
                        getattr(fit, part.name), getattr(again, part.name), err_msg=part.name
                    )
