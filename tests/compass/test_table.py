import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import airswing  # noqa: F401
from airswing.compass.table import (
    FINE,
    NODES,
    _project_curve,
    _round_to,
    add_tables,
    deviation_curve,
    error_from_table,
    heading_histogram,
    table_slope,
    unit_interpolation,
)
from airswing.errors import InputError


def fits_of(coefficients, **attrs):
    rows = np.atleast_2d(np.asarray(coefficients, float))
    return xr.Dataset(
        {
            "deviation": (("reference", "aircraft", "coefficient"), rows[None]),
            "status": (("reference", "aircraft"), np.zeros((1, len(rows)), np.int8)),
        },
        coords={"reference": ["ruc"], "aircraft": [f"N{k}" for k in range(len(rows))]},
        attrs=attrs,
    )


def headings_of(*parts):
    m = np.concatenate(parts)
    return xr.Dataset(
        {
            "row_size": ("aircraft", [len(part) for part in parts]),
            "magnetic_heading": ("report", m),
            "screening": ("report", np.zeros(m.size, int)),
        }
    )


def test_curve_at_the_compass_points():
    # A + C at north, A + B at east, D adds at NE, E takes away at east
    assert deviation_curve([1, 2, 3, 4, 5], [0, 90]) == pytest.approx([1 + 3 + 5, 1 + 2 - 5])
    half = np.sqrt(0.5)
    assert deviation_curve([1, 2, 3, 4, 5], [45])[0] == pytest.approx(1 + 2 * half + 3 * half + 4)


def test_interpolation_by_hand():
    table = np.array([0.0, 4.5, 0, 0, 0, 0, 0, 9.0])
    assert unit_interpolation(table, [0, 10, 45, 315, 337.5, 359, 360, 370, -45]) == pytest.approx(
        [0, 1, 4.5, 9, 4.5, 0.2, 0, 1, 9]
    )
    assert np.isnan(unit_interpolation(table, [np.nan]))[0]


@given(st.lists(st.floats(-20, 20), min_size=8, max_size=8), st.floats(-720, 720))
def test_interpolation_is_numpys_periodic_one(table, heading):
    expected = np.interp(heading, NODES, table, period=360)
    assert unit_interpolation(table, [heading])[0] == pytest.approx(expected, abs=1e-9)
    assert unit_interpolation(np.array([table]), [heading])[0] == pytest.approx(expected, abs=1e-9)


@given(st.lists(st.floats(-20, 20), min_size=8, max_size=8), st.integers(0, 2**32 - 1))
def test_a_curve_in_the_span_comes_back(nodes, seed):
    weight = np.random.default_rng(seed).poisson(1.0, 360) * (np.arange(360) < 200) + 0.05
    found = _project_curve(unit_interpolation(nodes, FINE), weight)
    assert np.abs(found - nodes).max() < 1e-6


@pytest.mark.parametrize(("cycles", "gain", "residual"), [(1, 1.052, 0.025), (2, 1.216, 0.120)])
def test_projection_has_the_known_gain_and_residual(cycles, gain, residual):
    # the nodes sample sin at 45 degrees (one cycle) and at its tops (two cycles)
    error = np.sin(np.radians(cycles * FINE))
    weight = np.full(360, 1 / 360)
    nodes = _project_curve(error, weight)
    assert nodes == pytest.approx(gain * np.sin(np.radians(cycles * NODES)), abs=2e-3)
    left = np.sqrt(np.sum(weight * (unit_interpolation(nodes, FINE) - error) ** 2) * 2)
    assert left == pytest.approx(residual, abs=2e-3)


def test_projection_is_better_than_sampling_and_follows_the_histogram():
    curve = deviation_curve([1, 3, -2, 1, 0.5], FINE)
    busy, weight = np.where((FINE > 60) & (FINE < 120), 1 / 59, 0.0), np.full(360, 1 / 360)
    even = _project_curve(curve, weight)
    sampled = deviation_curve([1, 3, -2, 1, 0.5], NODES)

    def rms(nodes, part):
        return np.sqrt(np.average((unit_interpolation(nodes, FINE) - curve) ** 2, weights=part))

    assert rms(even, weight) < 0.75 * rms(sampled, weight)
    lobed = _project_curve(curve, 0.95 * busy + 0.05 * weight)
    assert rms(lobed, busy) < rms(even, busy)
    assert rms(lobed, None) < 3 * rms(even, None)  # empty sectors follow the curve


def test_rounding_to_the_unit():
    assert _round_to(np.array([0.14, -0.04, 2.26, -1.0]), 0.1).tolist() == [0.1, 0.0, 2.3, -1.0]
    assert _round_to(np.array([0.3, 0.8]), 0.5).tolist() == [0.5, 1.0]
    assert _round_to(np.array([0.123]), 0.0)[0] == 0.123
    assert not np.signbit(_round_to(np.array([-0.01]), 0.1))[0]


@pytest.mark.parametrize("sign", ["subtract_error", "add_error"])
def test_round_trip_of_the_sign(sign):
    # headings made wrong by the curve come right by the table's rule for its sign
    coefficients = [1.5, 4.0, -3.0, 0.0, 0.0]
    indicated = np.linspace(0, 360, 721)
    fits = add_tables(fits_of(coefficients), headings_of(indicated), resolution=0.0, sign=sign)
    true = indicated - deviation_curve(coefficients, indicated)
    held = unit_interpolation(fits["table_correction"][0, 0].to_numpy(), indicated)
    corrected = indicated + held if sign == "subtract_error" else indicated - held
    assert np.abs(corrected - true).max() < 0.35
    assert np.sqrt(np.mean((corrected - true) ** 2)) == pytest.approx(
        fits["table_residual_rms"].item(), abs=5e-3
    )
    # a navigator's deviation (magnetic - compass) is what subtract_error adds
    east = fits["table_correction"][0, 0, 2].item()
    assert np.sign(east) == (-1 if sign == "subtract_error" else 1)
    assert error_from_table(fits)[0, 0, 2].item() == pytest.approx(5.5, abs=0.3)


def test_rounding_costs_and_refused_fits_stay_nan():
    m = np.random.default_rng(0).uniform(0, 360, 3000)
    fits = fits_of([[1, 2, 3, 0, 0], [np.nan] * 5])
    fine = add_tables(fits, headings_of(m, m), resolution=0.0)
    coarse = add_tables(fits, headings_of(m, m), resolution=1.0)
    assert coarse["table_residual_rms"][0, 0] > fine["table_residual_rms"][0, 0]
    assert np.all(coarse["table_correction"][0, 0] == np.rint(coarse["table_correction"][0, 0]))
    assert np.isnan(coarse["table_correction"][0, 1]).all()
    assert np.isnan(coarse["table_residual_rms"][0, 1])
    assert fine["table_heading"].to_numpy().tolist() == NODES.tolist()
    assert fine["table_correction"].attrs["units"] == "degree"


def test_histogram_counts_used_reports_only():
    ds = headings_of(np.array([0.5, 359.9, 10.2, np.nan]), np.array([90.0]))
    ds["screening"][2] = 4
    counts = heading_histogram(ds).to_numpy()
    assert counts.sum(axis=1).tolist() == [2, 1]
    assert counts[0, 0] == counts[0, 359] == counts[1, 90] == 1


def test_unknown_sign_is_refused():
    with pytest.raises(InputError, match=r"table\.sign.*add_error"):
        add_tables(fits_of([0] * 5), headings_of(np.zeros(1)), sign="east")


def test_slope_of_tables():
    table = np.tile(np.array([0.0, 4.5, 0, 0, 0, 0, 0, 9.0]), (3, 1))
    np.testing.assert_allclose(table_slope(table, [10.0, 80.0, -20.0]), [0.1, -0.1, -0.2])
