"""The numbers and warnings of the page, by hand and against plain loops."""

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.evaluation.innovations import member_mean, members_of
from airswing.flags import SCREENING, STATUS
from airswing.report.html import amount
from airswing.report.run import selection
from airswing.report.run.heading_error import binned_medians
from airswing.report.run.reading_warnings import model_reasons
from airswing.report.run.selection import Run
from airswing.reports.audit import similar
from airswing.units import KNOT
from tests.report import factories
from tests.report.factories import POOL

HEADINGS, FITS, _ = factories.products()


def tiny():
    """Two aircraft, two flights each, two reports a flight; the reference is calm."""
    headings, _ = factories.few(2, 4)
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
    return headings, corrected


def test_disagreement_by_hand():
    headings, corrected = tiny()
    levels = selection.disagreement(headings, corrected, "ruc")
    assert levels.before.tolist() == pytest.approx([4.0, 1.5])
    assert levels.after.tolist() == pytest.approx([2.0, 0.75])
    assert levels.number.tolist() == [4, 4]
    # N400's flights both gain 2.0 on average; N401's gain 0.5 and 1.0: residual sums -0.5, 0.5,
    # se^2 = 2/1 (0.25 + 0.25) / 16.
    assert levels.half_width.tolist() == pytest.approx([0.0, 1.959964 * 0.25], abs=1e-12)
    assert levels.total.before == pytest.approx(2.75) and levels.total.number == 8
    # uncorrected and screened reports do not count
    corrected["correction_applied"][:4] = 1
    headings["screening"][4:6] = SCREENING["turn"]
    levels = selection.disagreement(headings, corrected, "ruc")
    assert np.isnan(levels.before[0]) and levels.before[1] == pytest.approx(2.0)
    assert levels.total.number == 2


def test_a_pool_is_the_mean_of_its_members():
    headings, _ = tiny()
    headings["heading_error"][:2] = np.array([[1.0], [4.0]])
    headings["heading_error"][1, 3] = np.nan
    value = member_mean(headings["heading_error"].sel(reference=members_of(headings, POOL)))
    assert value.to_numpy()[[0, 1, 2]].tolist() == [2.5] * 3
    assert value[3] == headings["heading_error"][0, 3], "the member that has a value, as in the fit"
    assert members_of(headings, "no members") == ["ruc", "rtfdaa", "nam"]
    asked = headings.assign_attrs(airswing_config='{"pool": {"both": ["ruc", "nam"]}}')
    assert members_of(asked, "both") == ["ruc", "nam"]


def test_the_fitted_bias_of_the_reference_is_subtracted():
    """W_ref = W + b alone: V psi_err = b_u cos psi - b_v sin psi, so nothing is left."""
    headings, fits = HEADINGS.copy(deep=True), FITS.copy(deep=True)
    fits["reference_bias"][:] = [0.8, -0.5]
    psi = np.radians(headings["heading"].to_numpy())
    error = (0.8 * np.cos(psi) + 0.5 * np.sin(psi)) / headings["airspeed"].to_numpy()
    headings["heading_error"][:] = np.degrees(error)
    _, remainder = Run(headings, fits, "ruc").points("N000")
    assert np.abs(remainder).max() < 1e-9 < 0.3 < np.abs(np.degrees(error)).max()


def test_a_table_within_its_error_needs_no_correction():
    small = FITS.assign(table_correction=0.4 * np.sign(FITS["table_correction"]))
    narrow, wide = (
        small.assign(deviation_covariance=FITS["deviation_covariance"] * 0.0 + np.eye(5) * size**2)
        for size in (0.06, 0.3)
    )
    fine, coarse = (narrow.assign_attrs(table_resolution=step) for step in (0.05, 1.0))
    zero = FITS.assign(status=FITS["status"] * 0 + STATUS["no_correction_needed"])
    expected = ((FITS, 0, False), (wide, 0, True), (narrow, 0, False), (wide, "N005", False))
    expected += ((fine, 0, False), (coarse, 0, True))
    for fits, aircraft, needs_none in (*expected, (zero, 0, True)):
        fit = Run(HEADINGS, fits, "ruc").fit(aircraft)
        assert bool(selection.needs_no_correction(fit)) == needs_none
        _, error = selection.table_error(fit.assign_attrs(table_sign="add_error"))
        assert error.tolist() == (-selection.table_error(fit)[1]).tolist()


def test_coefficients_carry_their_intervals():
    fit = Run(HEADINGS, FITS, "ruc").fit(0).copy(deep=True)
    fit["deviation"][:] = [1.0, -2.0, 0.5, 0.0, 0.0]
    fit["deviation_covariance"][:] = np.eye(5) * 0.06**2
    for harmonics, name, text in ((2, "B", "-2.00 ± 0.12°"), (1, "D", "0")):
        fit["harmonics"] = harmonics
        assert selection.coefficient_texts(fit)[name] == text


def test_screening_counts_together_and_alone():
    headings, _ = factories.few(1, 10)
    turn, roll = SCREENING["turn"], SCREENING["roll"]
    headings["screening"][:] = [turn, turn, turn | roll, roll, 0, 0, 0, 0, 0, 0]
    assert selection.screening_audit(headings) == [("turn", 3, 2), ("roll", 2, 1)]
    assert selection.kept_reports(headings) == 6
    assert selection.screening_warnings(headings) == []
    headings["screening"][:] = [turn] * 7 + [roll | turn, 0, 0]
    (warning,) = selection.screening_warnings(headings)
    assert "kept 2 of 10 reports (20%): the rule turn left out most, 8 (7 of them" in warning


def test_unknown_names_are_refused_with_the_known_ones():
    for reference, aircraft, words in (
        ("ruc", "N999", r"N999.*Choose from N000"),
        ("gfs", "N000", "Known: ruc, rtfdaa"),
        ("ruc", 6, r"found: 6.*Choose from N000"),
    ):
        with pytest.raises(InputError, match=words):
            Run(HEADINGS, FITS, reference).fit(aircraft)


def test_headlines_have_at_most_25_words_and_say_which_way_the_winds_went():
    (headings, corrected), fits = tiny(), FITS.isel(aircraft=[0, 5])
    total = selection.disagreement(headings, corrected, "ruc").total
    corrected["corrected_eastward_wind"][:] = headings["eastward_wind"].to_numpy() * 2
    worse = selection.disagreement(headings, corrected, "ruc").total
    none = selection.BeforeAfter(np.nan, np.nan, np.nan, np.nan, 0)
    status = {name: fits["status"] * 0 + code for name, code in STATUS.items()}
    first = np.arange(2) == 0
    offset = fits.assign(status=status["ok"].where(first, STATUS["offset_only"]))
    nothing = fits.assign(status=status["too_few_reports"])
    wrong = fits.assign(status=status["implausible_reports"])
    for ds, levels, words in (
        (fits, total, "fitted for 1 of 2 aircraft (median amplitude "),
        (fits, total, "falls from 2.8 to 1.4 kt."),
        (fits, worse, "rises from"),
        (fits, total._replace(after=total.before + 0.01), "disagreement remains 2.8 kt."),
        (offset, total, "fitted for 1 of 2 aircraft, offset only for 1 (median "),
        (nothing, none, "No usable fit for any of 2 aircraft"),
        (wrong, None, "contradict the reference"),
    ):
        assert words in selection.headline(ds, levels, "ruc")
        assert len(selection.headline(ds, levels, POOL).split()) <= 25


def test_binned_medians_by_hand():
    heading = np.array([1.0, 2, 3, 4, 5, 359, 100, 101])
    value = np.array([1.0, 2, 3, 4, 100, 7, 8, 9])
    bins = binned_medians(heading, value, width=15.0)
    assert bins[:2].tolist() == [[7.5], [3.0]]
    assert bins[2, 0] == pytest.approx(1.959964 * 1.2533 * 1.4826 * 1.0 / np.sqrt(5))


def test_an_amount_that_is_not_known_has_no_unit():
    assert amount(None, None, unit="kt") == "-"
    assert amount(1.234, [1.0, 1.5], unit="kt") == "1.23 kt (1.00 to 1.50)"


def test_one_more_file_is_singular():
    entry = {"what": "message", "reason": "truncated", "count": 1}
    skipped = [entry | {"file": f"{name}.grb"} for name in "abc"]
    assert model_reasons(skipped[:2]) == ["left out: truncated, 2 times in a.grb and 1 more file"]
    assert model_reasons(skipped) == ["left out: truncated, 3 times in a.grb and 2 more files"]


def test_tails_that_differ_in_case_or_blanks():
    tails = ["N 401", "N401", "n402", "b", "B", "b ", "N-401", "N4O1"]
    assert similar(tails) == [["B", "b", "b "], ["N 401", "N401"]]
    assert similar([]) == []
