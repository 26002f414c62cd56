"""An archive read an aircraft at a time gives the sums of the archive in memory."""

from __future__ import annotations

from dataclasses import replace

import dask
import numpy as np
import pytest
from tests.gap.frames import headings_dataset
from tests.gap.toy import make_frame, noise_of

from airswing.errors import InputError
from airswing.gap.archive.frame import REPORT_FIELDS, Frame
from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.layout import make_layout
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.search.tail_swaps import Swap, exchange
from airswing.gap.sums.accumulate import SumColumns, accumulate
from airswing.gap.sums.whole_archive import (
    Archive,
    held_archive,
    joined,
    read_archive,
    sum_reports,
)

EFFECTS = {n: CATALOGUE[n] for n in ("compass_offset", "hard_iron", "reference_speed_bias")}
SUMS = (
    "week_gram",
    "day_gram",
    "day_cross",
    "day_score",
    "raw_gram",
    "acting",
    "gross",
    "clipped",
    "day_count",
)


@pytest.fixture(scope="module")
def whole():
    return make_frame(seed=5, aircraft=4, days=9)


def columns_of(archive):
    noise = noise_of(archive.view, archive.context)
    plan = plan_dictionary(archive.context)
    return SumColumns(noise, make_layout(EFFECTS, plan, archive.context), EFFECTS, plan)


def read(frame, *, workers=1):
    """The same archive as if only its reports' first half were held, and the rest read."""
    archive = held_archive(frame, workers=workers)
    some = np.isin(frame.flight, np.unique(frame.flight)[::2])
    return Archive(
        frame.take(some),
        lambda k: frame.take(frame.aircraft == k),
        archive.winds,
        archive.days,
        archive.clock,
        archive.reports,
        archive.flights,
        workers,
    )


def test_aircraft_after_aircraft_gives_the_sums_of_one_frame(whole):
    archive = held_archive(whole)
    columns = columns_of(archive)
    found = sum_reports(archive, columns)
    expected = accumulate(
        archive.context,
        whole.residual,
        columns,
        clock=archive.clock,
    )
    np.testing.assert_array_equal(found.days, expected.days)
    for name in SUMS:
        scale = 1e-5 * np.abs(getattr(expected, name)).max()
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=scale)


def test_what_is_read_has_the_sums_of_what_is_held(whole):
    held, lazy = held_archive(whole), read(whole)
    columns = columns_of(held)
    one, two = sum_reports(held, columns), sum_reports(lazy, columns)
    assert one.gross.sum() == pytest.approx(two.gross.sum(), abs=3)
    # the airspeed's profile has its knots at the part's own levels, gross errors its own spread
    size = np.sqrt(np.einsum("aii->ai", one.whole_gram)).clip(1e-9)
    difference = (two.day_score - one.day_score).sum(axis=1) / size
    assert np.sqrt(np.mean(difference[:, : one.layout.core] ** 2)) < 0.3  # of a standard deviation


def test_noise_is_fitted_to_what_known_effects_leave(whole):
    def about(frame, context):
        known = np.zeros((frame.size, 2))
        known[::7, 0] = 40.0  # single reports that would stand out as gross errors
        return frame.residual, known

    columns = columns_of(held_archive(whole))
    without, beside = (
        sum_reports(read(whole), columns),
        sum_reports(read(whole), columns, about=about),
    )
    np.testing.assert_array_equal(beside.gross, without.gross)
    np.testing.assert_allclose(beside.week_gram, without.week_gram, rtol=1e-6)
    assert not np.allclose(beside.day_score, without.day_score)


def test_sums_are_the_same_bit_for_bit_whatever_the_number_of_workers(whole):
    for make in (held_archive, read):
        columns = columns_of(held_archive(whole))
        one, two = (sum_reports(make(whole, workers=n), columns) for n in (1, 3))
        for name in SUMS:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_lazy_dataset_is_read_by_aircraft_and_its_view_drawn_over_aircraft_and_days():
    ds = headings_dataset(flights=24)
    frame = Frame.from_headings(ds, reference="ruc")
    with dask.config.set(scheduler="synchronous"):
        archive = read_archive(ds.chunk(report=40), reference="ruc", most=ds.sizes["report"] // 3)
        parts = [archive.part(k) for k in range(len(frame.tails))]
    together = joined(parts)
    for name in REPORT_FIELDS:
        if name not in ("bank", "acceleration"):  # of the part's own turns and climbs
            np.testing.assert_array_equal(getattr(together, name), getattr(frame, name), name)
    assert archive.reports == frame.size
    assert archive.flights == np.unique(frame.flight).size
    assert archive.view.epoch == frame.epoch
    assert not archive.whole
    assert 0 < archive.view.size < 0.7 * frame.size
    seen = np.unique(archive.view.flight)  # whole flights
    np.testing.assert_array_equal(archive.view.report, frame.report[np.isin(frame.flight, seen)])
    expected = held_archive(frame)
    np.testing.assert_array_equal(archive.days, expected.days)
    fit, _ = expected.winds.at(frame)
    again, _ = archive.winds.at(frame)
    np.testing.assert_allclose(again, fit, atol=0.5)


def test_one_that_fits_into_memory_is_held_whole():
    ds = headings_dataset(flights=6)
    archive = read_archive(ds, reference="ruc")
    assert archive.whole
    assert archive.view.size == archive.reports


def test_aircraft_without_a_usable_report_are_passed_over_and_none_at_all_is_an_error():
    ds = headings_dataset(flights=3)
    first = int(ds.row_size.values[0])
    gone = ds.copy(deep=True)
    gone["eastward_wind"][:first] = np.nan
    archive = read_archive(gone, reference="ruc", most=ds.sizes["report"] - 1)
    assert archive.part(0) is None
    assert archive.part(1).size > 0
    nothing = ds.assign(eastward_wind=ds.heading * np.nan)
    with pytest.raises(InputError, match="overlap"):
        read_archive(nothing, reference="ruc", most=10)
    with pytest.raises(InputError, match="unknown reference"):
        read_archive(ds, reference="nam", most=10)


def test_exchanged_identifiers_are_given_back_in_what_is_held_and_what_is_read(whole):
    swap, start = Swap((0, 2), 4, 9.0, 9.0), float(np.median(whole.time))
    held, lazy = (
        make(whole).exchanged((0, 2), lambda f: exchange(f, swap, start))
        for make in (held_archive, read)
    )
    for number in range(4):
        own = held.view.take(held.view.aircraft == number)
        part = lazy.part(number)
        assert set(part.aircraft) == {number}
        np.testing.assert_array_equal(np.sort(part.time), np.sort(own.time))


def test_a_diagnosis_of_what_is_read_finds_what_one_of_what_is_held_does():
    frame = make_frame(seed=8, aircraft=5, days=21)
    lag = np.where(frame.aircraft == 3, np.radians(3.0), 0.0)
    turned = frame.airspeed * lag
    struck = replace(
        frame,
        u_rep=frame.u_rep - turned * np.cos(frame.heading),
        v_rep=frame.v_rep + turned * np.sin(frame.heading),
        heading=frame.heading + lag,
        magnetic_heading=frame.magnetic_heading + lag,
    )
    reports = [
        diagnose(archive, catalogue=EFFECTS, dictionary=False).report
        for archive in (struck, read(struck))
    ]
    for report in reports:
        (effect,) = report.effects
        assert effect.name == "compass_offset"
        assert effect.tails == [frame.tails[3]]
        assert effect.parameters["offset_deg"] == pytest.approx(3.0, abs=0.3)
