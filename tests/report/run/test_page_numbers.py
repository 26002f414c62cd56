"""The numbers of the page, by hand and against plain loops."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tests.report import factories

from airswing.errors import InputError
from airswing.flags import SCREENING
from airswing.report.run import page_numbers as summaries
from airswing.report.run import selection

KNOT = 1852 / 3600


def tiny() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Two aircraft, two flights each, two reports a flight; the reference is calm."""
    headings = factories.headings(aircraft=2, reports=4)
    off = np.array([3.0, 5.0, 4.0, 4.0, 1.0, 1.0, 2.0, 2.0]) * KNOT
    headings["eastward_wind"][:] = off
    for name in ("northward_wind", "reference_eastward_wind", "reference_northward_wind"):
        headings[name][:] = 0.0
    headings["flight"][:] = [0, 0, 1, 1, 2, 2, 3, 3]
    headings["screening"][:] = 0
    corrected = headings[["time", "row_size"]].assign(
        corrected_eastward_wind=("report", off / 2),
        corrected_northward_wind=("report", np.zeros(8)),
        correction_applied=("report", np.zeros(8, np.int8)),
    )
    return headings, factories.fits(aircraft=2), corrected


def test_disagreement_by_hand() -> None:
    headings, fits, corrected = tiny()
    found = summaries.disagreement(headings, corrected, fits, "ruc")
    assert found.before.tolist() == pytest.approx([4.0, 1.5])
    assert found.after.tolist() == pytest.approx([2.0, 0.75])
    assert found.number.tolist() == [4, 4]
    # N401's flights both gain 2.0 on average; N402's gain 0.5 and 1.0: residual sums -0.5, 0.5,
    # se^2 = 2/1 (0.25 + 0.25) / 16.
    assert found.half_width[0] == pytest.approx(0.0, abs=1e-12)
    assert found.half_width[1] == pytest.approx(1.959964 * 0.25)


def test_uncorrected_and_screened_reports_do_not_count() -> None:
    headings, fits, corrected = tiny()
    corrected["correction_applied"][:4] = 1
    headings["screening"][4:6] = SCREENING["turn"]
    found = summaries.disagreement(headings, corrected, fits, "ruc")
    assert np.isnan(found.before[0])
    assert found.before[1] == pytest.approx(2.0)
    assert found.total.number == 2


def test_pool_is_the_mean_of_its_members() -> None:
    headings, fits, _ = tiny()
    headings["heading_error"][0], headings["heading_error"][1] = 1.0, 4.0
    headings["heading_error"][1, 3] = np.nan
    value = selection.pooled(headings, fits, factories.POOL, "heading_error")
    assert value[[0, 1, 2]].tolist() == [2.5] * 3
    assert value[3] == headings["heading_error"][0, 3], "the member that has a value, as in the fit"
    fits.attrs["pools"] = '{"both": ["rtfdaa"]}'
    assert selection.members(headings, fits, "both") == ["rtfdaa"]
    assert selection.members(headings, fits, "a name without members") == ["ruc", "rtfdaa"]


def test_fitted_reference_bias_is_taken_out() -> None:
    """W_ref = W + b alone: V psi_err = b_u cos psi - b_v sin psi, so nothing is left."""
    headings, fits = factories.headings(aircraft=1), factories.fits(aircraft=1)
    fits["reference_bias"][:] = [0.8, -0.5]
    psi = np.radians(headings["heading"].to_numpy())
    error = (0.8 * np.cos(psi) + 0.5 * np.sin(psi)) / headings["airspeed"].to_numpy()
    headings["heading_error"][:] = np.degrees(error)
    _, left = selection.compass_points(headings, fits, 0, "ruc")
    assert np.abs(left).max() < 1e-9
    assert np.abs(np.degrees(error)).max() > 0.3


def test_table_is_minus_its_correction_unless_it_says_otherwise() -> None:
    fits = factories.fits()
    fit = selection.one_fit(fits, "N401", "ruc")
    nodes, error = selection.table_error(fit)
    expected, _ = selection.curve_with_error(fit, nodes)
    assert np.abs(error - expected).max() < 0.06
    fits.attrs["table_sign"] = "add_error"
    _, flipped = selection.table_error(selection.one_fit(fits, "N401", "ruc"))
    assert flipped.tolist() == (-error).tolist()


def test_curve_error_of_an_offset_alone() -> None:
    fit = selection.one_fit(factories.fits(), 0, "ruc")
    fit["deviation_covariance"][:] = np.diag([0.04, 0, 0, 0, 0])
    _, error = selection.curve_with_error(fit, np.array([0.0, 77.0]))
    assert error.tolist() == pytest.approx([0.2, 0.2])


def test_screening_audit_counts_together_and_alone() -> None:
    headings = factories.headings(aircraft=1, reports=10)
    turn, roll = SCREENING["turn"], SCREENING["roll"]
    headings["screening"][:] = [turn, turn, turn | roll, roll, 0, 0, 0, 0, 0, 0]
    assert summaries.screening_audit(headings) == [("turn", 3, 2), ("roll", 2, 1)]


def test_unknown_names_are_told() -> None:
    fits = factories.fits()
    with pytest.raises(InputError, match=r"N999.*Choose from N401"):
        selection.one_fit(fits, "N999", "ruc")
    with pytest.raises(InputError, match="Choose from ruc, rtfdaa"):
        selection.one_fit(fits, "N401", "gfs")


def test_headline_gives_the_rise_too() -> None:
    headings, fits, corrected = tiny()
    own, own_fits, own_corrected = _first_aircraft(headings, fits, corrected)
    total = summaries.disagreement(own, own_corrected, own_fits, "ruc").total
    assert "falls from 4.0 kt to 2.0 kt" in summaries.headline(own_fits, total, "ruc")
    corrected["corrected_eastward_wind"][:] = headings["eastward_wind"].to_numpy() * 2
    total = summaries.disagreement(headings, corrected, fits, "ruc").total
    assert "rises from" in summaries.headline(fits, total, "ruc")


def test_headline_gives_a_range_only_where_there_is_one() -> None:
    _, fits, _ = tiny()
    text = summaries.headline(fits.isel(aircraft=slice(0, 1)), None, "ruc")
    assert (
        "1 of 1 aircraft" in text and "its compass deviation is" in text and "to" not in text[30:]
    )
    fits["status"][:] = 0
    assert "in all)" in summaries.headline(fits, None, "ruc")
    assert "nine in ten" in summaries.headline(factories.fits(aircraft=14), None, "ruc")


def _first_aircraft(
    headings: xr.Dataset, fits: xr.Dataset, corrected: xr.Dataset
) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    first = {"report": slice(0, 4), "aircraft": slice(0, 1)}
    chosen = fits.isel(aircraft=slice(0, 1))
    chosen["status"][:] = 0
    return headings.isel(first), chosen, corrected.isel(first)
