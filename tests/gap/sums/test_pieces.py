"""An archive in pieces gives the sums of the archive in one frame."""

from __future__ import annotations

import dask
import numpy as np
import pytest
from tests.gap.frames import headings_dataset
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.archive.frame import REPORT_FIELDS, Frame
from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.exogenous import LargeScale, exogenous
from airswing.gap.design.layout import make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise.model import fit_noise, fitted_gains, flown
from airswing.gap.sums.accumulate import accumulate, day_of_report
from airswing.gap.sums.pieces import (
    Pieces,
    pieces_of_headings,
    prepare,
    statistics_of_pieces,
)
from airswing.physics.turns import heading_doubt

EFFECTS = {n: CATALOGUE[n] for n in ("compass_offset", "hard_iron", "reference_speed_bias")}


@pytest.fixture(scope="module")
def whole():
    return make_frame(seed=5, aircraft=4, days=9)


def _pieces(frame):
    def one(number, first, last):
        part = frame.of_aircraft(frame.tails[number])
        return part.take(slice(int(first * part.size), int(last * part.size)))

    return Pieces(len(frame.tails), frame.size, one)


def test_pieces_have_the_winds_noise_plan_and_sums_of_the_whole(whole):
    columns = exogenous(whole)
    noise = fit_noise(whole.residual, flown(columns, heading_doubt(whole, columns)))
    plan = plan_dictionary(columns)
    expected = accumulate(
        columns, whole.residual, noise=noise, effects=EFFECTS, plan=plan,
        layout=make_layout(EFFECTS, plan, columns),
    )  # fmt: skip
    pieces = _pieces(whole)
    ready = prepare(pieces)
    assert ready.noise.model.length == pytest.approx(noise.model.length, rel=1e-6)
    np.testing.assert_allclose(ready.plan.knots["airspeed"], plan.knots["airspeed"], rtol=1e-3)
    found = statistics_of_pieces(pieces, ready, effects=EFFECTS)
    np.testing.assert_array_equal(found.days, expected.days)
    assert found.gross.sum() == pytest.approx(expected.gross.sum(), abs=3)
    assert found.day_count.sum() == pytest.approx(expected.day_count.sum(), abs=3)
    # the airspeed's profile has its knots at the piece's own levels, gross errors its own spread
    core = expected.layout.core
    scale = np.sqrt(np.einsum("aii->ai", expected.raw_gram)).clip(1e-9)
    np.testing.assert_allclose(
        found.raw_gram / scale[:, :, None] / scale[:, None],
        expected.raw_gram / scale[:, :, None] / scale[:, None], atol=0.01,
    )  # fmt: skip
    size = np.sqrt(np.einsum("aii->ai", expected.whole_gram)[:, :core]).clip(1e-9)
    difference = (found.day_score - expected.day_score)[:, :, :core].sum(axis=1) / size
    assert np.sqrt(np.mean(difference**2)) < 0.3  # of a standard deviation


def test_sums_are_the_same_bit_for_bit_whatever_the_number_of_workers(whole):
    pieces = _pieces(whole)
    one, two = (
        statistics_of_pieces(pieces, prepare(pieces, workers=n), effects=EFFECTS, workers=n)
        for n in (1, 3)
    )
    for name in ("week_gram", "day_gram", "day_cross", "day_score", "raw_gram", "acting", "gross",
                 "clipped"):  # fmt: skip
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_thin_sample_is_spread_over_time_and_aircraft(whole):
    ready = prepare(_pieces(whole), most=whole.size // 4)
    assert ready.sample.size == pytest.approx(whole.size / 4, rel=0.05)
    assert set(ready.sample.aircraft) == set(range(4))
    assert np.ptp(ready.sample.time) > 0.8 * np.ptp(whole.time)
    days, _ = day_of_report(whole, shift=ready.day_shift)
    np.testing.assert_array_equal(ready.days, np.unique(days))


def test_gains_of_fitted_reports_are_those_of_the_fit(whole):
    columns = exogenous(whole)
    reports = flown(columns, heading_doubt(whole, columns))
    fit = fit_noise(whole.residual, reports)
    again = fitted_gains(fit, whole.residual, reports)
    np.testing.assert_array_equal(again.gains.weight, fit.gains.weight)
    np.testing.assert_array_equal(again.gross, fit.gross)


def test_a_lazy_headings_dataset_is_cut_into_its_aircraft():
    ds = headings_dataset(flights=6)
    frame = Frame.from_headings(ds, reference="ruc")
    with dask.config.set(scheduler="synchronous"):
        pieces = pieces_of_headings(ds.chunk(report=40), reference="ruc")
        parts = [pieces.frame(k, 0.0, 1.0) for k in range(pieces.count)]
    for name in REPORT_FIELDS:
        if name not in ("bank", "acceleration"):  # of the piece's own turns and climbs
            together = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_array_equal(together, getattr(frame, name), err_msg=name)
    assert {part.epoch for part in parts} == {frame.epoch}
    half = pieces.frame(0, 0.5, 1.0)
    np.testing.assert_array_equal(half.time, parts[0].time[-half.size :])


def test_aircraft_without_a_usable_report_are_passed_over_and_none_at_all_is_an_error():
    ds = headings_dataset(flights=3)
    first = int(ds.row_size.values[0])
    gone = ds.copy(deep=True)
    gone["eastward_wind"][:first] = np.nan
    pieces = pieces_of_headings(gone, reference="ruc")
    assert pieces.frame(0, 0.0, 1.0) is None
    assert pieces.frame(1, 0.0, 1.0).size > 0
    nothing = ds.assign(eastward_wind=ds.heading * np.nan)
    with pytest.raises(InputError, match="overlap"):
        prepare(pieces_of_headings(nothing, reference="ruc"))
    with pytest.raises(InputError, match="unknown reference"):
        prepare(pieces_of_headings(ds, reference="nam"))


def test_large_scale_wind_of_pieces_is_that_of_the_whole(whole):
    fit, shear = LargeScale.of(whole).at(whole)
    ready = prepare(_pieces(whole))
    again, slope = ready.winds.at(whole)
    np.testing.assert_allclose(again, fit, atol=1e-6)
    np.testing.assert_allclose(slope, shear, atol=1e-6)
