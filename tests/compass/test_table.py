"""Tables of the units: interpolation, projection of the curve, signs, rounding, CSV file."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import airswing  # noqa: F401
from airswing.compass.correction import (
    FINE,
    NODES,
    add_tables,
    deviation_curve,
    error_from_table,
    heading_histogram,
    unit_interpolation,
    write_tables_csv,
)
from airswing.errors import InputError
from airswing.flags import STATUS

EVEN = np.ones((1, 360), dtype=int)
"""Numbers of reports at headings that are flown equally often."""


def fits_of(*coefficients):
    rows = np.array(coefficients, float)
    aircraft = len(rows)
    covariance = np.tile(0.01 * np.eye(5), (1, aircraft, 1, 1))
    return xr.Dataset(
        {
            "deviation": (("reference", "aircraft", "coefficient"), rows[None]),
            "deviation_covariance": (
                ("reference", "aircraft", "coefficient", "coefficient_2"),
                covariance,
            ),
            "status": (("reference", "aircraft"), np.zeros((1, aircraft), np.int8)),
        },
        coords={"reference": ["ruc"], "aircraft": [f"N{k}" for k in range(aircraft)]},
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


def nodes_of(coefficients, histogram=EVEN, resolution=0.0):
    """Heading error at the nodes of the table."""
    fits = add_tables(fits_of(coefficients), histogram, resolution=resolution)
    return error_from_table(fits)[0, 0].to_numpy()


def test_interpolation_by_hand():
    table = np.array([0.0, 4.5, 0, 0, 0, 0, 0, 9.0])
    assert unit_interpolation(table, [0, 10, 45, 315, 337.5, 359, 360, 370, -45]) == pytest.approx(
        [0, 1, 4.5, 9, 4.5, 0.2, 0, 1, 9]
    )
    assert np.isnan(unit_interpolation(table, [np.nan]))[0]


@given(st.lists(st.floats(-20, 20), min_size=8, max_size=8), st.floats(-720, 720))
def test_interpolation_is_the_periodic_one_of_numpy(table, heading):
    expected = np.interp(heading, NODES, table, period=360)
    assert unit_interpolation(table, [heading])[0] == pytest.approx(expected, abs=1e-9)
    assert unit_interpolation(np.array([table]), [heading])[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("cycles", "curve", "gain", "residual"),
    [(1, [0, 1, 0, 0, 0], 1.052, 0.025), (2, [0, 0, 0, 1, 0], 1.216, 0.120)],
)
def test_projection_has_the_known_gain_and_residual(cycles, curve, gain, residual):
    # the nodes sample sin at 45 degrees (one cycle) and at its maxima (two cycles)
    nodes = nodes_of(curve)
    assert nodes == pytest.approx(gain * np.sin(np.radians(cycles * NODES)), abs=2e-3)
    apart = unit_interpolation(nodes, FINE) - deviation_curve(curve, FINE)
    assert np.sqrt(2.0 * np.mean(apart**2)) == pytest.approx(residual, abs=2e-3)


@pytest.mark.parametrize("sign", ["subtract_error", "add_error"])
def test_round_trip_of_the_sign(sign):
    # headings with the error of the curve are right after the table's rule for its sign
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
    with pytest.raises(InputError, match=r"table\.sign.*add_error"):
        add_tables(fits, headings_of(indicated), sign="east")


def test_rounding_to_the_unit_and_refused_fits():
    m = np.random.default_rng(0).uniform(0, 360, 3000)
    fits = fits_of([1, 2, 3, 0, 0], [np.nan] * 5)
    fine = add_tables(fits, headings_of(m, m), resolution=0.0)
    coarse = add_tables(fits, headings_of(m, m), resolution=0.1)
    exact = fine["table_correction"][0, 0].to_numpy()
    assert coarse["table_correction"][0, 0].to_numpy().tolist() == np.round(exact, 1).tolist()
    assert coarse["table_residual_rms"][0, 0] > fine["table_residual_rms"][0, 0]
    assert np.isnan(coarse["table_correction"][0, 1]).all()
    assert np.isnan(coarse["table_residual_rms"][0, 1])
    assert fine["table_heading"].to_numpy().tolist() == NODES.tolist()
    assert fine["table_correction"].attrs["units"] == "degree"
    zero = add_tables(fits_of([-0.01, 0, 0, 0, 0]), EVEN, resolution=0.1)["table_correction"]
    assert (zero == 0).all() and not np.signbit(zero).any()


def test_histogram_counts_used_reports_only():
    ds = headings_of(np.array([0.5, 359.9, 10.2, np.nan]), np.array([90.0]))
    ds["screening"][2] = 4
    counts = heading_histogram(ds).to_numpy()
    assert counts.sum(axis=1).tolist() == [2, 1]
    assert counts[0, 0] == counts[0, 359] == counts[1, 90] == 1


def test_the_csv_file_has_every_node_and_refused_fits(tmp_path):
    fits = fits_of([1, 3, -2, 0, 0], [np.nan] * 5)
    with pytest.raises(InputError, match="add_tables"):
        write_tables_csv(fits, tmp_path / "tables.csv")
    fits["status"][0, 1] = STATUS["implausible_reports"]  # has coefficients, but no table to load
    fits["deviation"][0, 1] = 1.0
    fits = add_tables(fits, np.tile(EVEN, (2, 1)))
    path = write_tables_csv(fits, tmp_path / "tables.csv")
    rows = list(csv.DictReader(path.open(newline="")))
    assert [float(row["heading_deg"]) for row in rows] == [*NODES, *NODES]
    assert [float(row["table_correction_deg"]) for row in rows[:8]] == pytest.approx(
        fits["table_correction"][0, 0].to_numpy()
    )
    # A, C and E at north: sqrt(3) of 0.1
    assert rows[0]["standard_error_deg"] == "0.173"
    assert {(row["aircraft"], row["reference"], row["status"]) for row in rows[:8]} == {
        ("N0", "ruc", "ok")
    }
    numbers = ("status", "table_correction_deg", "standard_error_deg")
    assert {tuple(row[name] for name in numbers) for row in rows[8:]} == {
        ("implausible_reports", "", "")
    }
    assert {row["sign"] for row in rows} == {"subtract_error"}
