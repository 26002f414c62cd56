"""The reference's error as the fleet sees it: the field's functions, its estimate, its cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.compass.fleet_error import (
    FieldBasis,
    adjusted_errors,
    deviation_columns,
    fit_field,
    reference_air,
    widening,
)


def places(n: int = 4000, days: int = 10, seed: int = 0, middle: float = -87.0):
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(39, 46, n),
        (rng.uniform(middle - 5, middle + 5, n) + 180) % 360 - 180,
        np.log(rng.uniform(3e4, 9e4, n)),
        np.sort(rng.uniform(0, days * 86400.0, n)),
    )


@pytest.mark.parametrize("middle", [-87.0, 179.0])
def test_the_functions_of_each_part_sum_to_one(middle):
    where = places(middle=middle)
    basis = FieldBasis.of(*where)
    design = basis.design(*where)
    for part in (0, 1):
        total = np.asarray(design[:, basis.part == part].sum(axis=1)).ravel()
        np.testing.assert_allclose(total, 1.0, atol=1e-12)


def test_a_time_outside_every_segment_is_told():
    where = places(days=2)
    basis = FieldBasis.of(*where)
    assert basis.segment_of(np.array([0.0 + where[3].min(), 30 * 86400.0])).tolist() == [0, -1]


def test_a_planted_field_is_found_and_no_field_is_left_alone():
    rng, where = np.random.default_rng(1), places()
    basis = FieldBasis.of(*where)
    design, flight = basis.design(*where), np.arange(4000) // 10
    true = design @ rng.normal(0, 1.0, (basis.part.size, 2))
    noise = rng.normal(0, 1.0, (2, 4000))
    fit = fit_field(design, basis.part, true.T + noise, flight)
    found = design @ fit.coefficients
    assert np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.9
    nothing = fit_field(design, basis.part, noise, flight)
    assert np.sqrt(np.mean((design @ nothing.coefficients) ** 2)) < 0.3


def test_the_air_vector_and_its_derivatives():
    heading, speed = np.radians([0.0, 90.0, 200.0]), np.array([100.0, 110.0, 120.0])
    theta, scale = np.radians([1.0, 2.0, -1.0, 0.5, 0.2]), 0.01
    vector, slope = deviation_columns(theta, scale, heading, heading, speed)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        up, _ = deviation_columns(theta + step[:5], scale + step[5], heading, heading, speed)
        np.testing.assert_allclose((up - vector).T / 1e-6, slope[:, :, k], atol=1e-3)
    north, _ = deviation_columns(np.zeros(5), 0.0, heading[:1], heading[:1], speed[:1])
    np.testing.assert_allclose(north.ravel(), [0.0, 100.0], atol=1e-12)


@given(st.floats(-3, 3), st.floats(-20, 20), st.floats(-5, 5), st.floats(-5, 5))
def test_taking_an_error_off_the_reference_and_putting_it_back(heading, slow, east, north):
    psi, speed = np.array([heading]), np.array([120.0])
    error = np.array([[east], [north]])
    once = adjusted_errors(psi, speed, np.array([0.1]), np.array([slow]), error)
    back = adjusted_errors(psi, speed, *once, -error)
    np.testing.assert_allclose(np.ravel(back), [0.1, slow], atol=1e-9)
    moved = reference_air(psi, speed, *once) - reference_air(psi, speed, [0.1], [slow])
    np.testing.assert_allclose(moved, error, atol=1e-9)


def test_a_known_field_costs_nothing_and_an_unknown_one_widens():
    rng, where = np.random.default_rng(2), places(2000)
    basis = FieldBasis.of(*where)
    design = basis.design(*where)
    fit = fit_field(design, basis.part, rng.normal(size=(2, 2000)), np.arange(2000) // 10)
    columns = [rng.normal(size=(1000, 2, 2)), rng.normal(size=(1000, 2, 2))]
    columns[0][:, 0, 0] = 50.0  # looks like a lasting eastward error
    rows = [np.arange(1000), np.arange(1000, 2000)]
    small = type(fit)(fit.coefficients, np.full(2, 1e-9), fit.weight)
    known = widening(design, basis.part, [small], columns, rows)
    np.testing.assert_allclose(known, np.eye(4), atol=1e-4)
    large = type(fit)(fit.coefficients, np.full(2, 1.0), fit.weight)
    factor = widening(design, basis.part, [large], columns, rows)
    assert factor[0, 0] > 5.0
    assert np.linalg.eigvals(factor).real.min() > 1 - 1e-6
