"""Closed forms against LAPACK and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.gap.evidence.small_matrices import inverse_and_logdet, solved_and_logdet


def test_two_rows_by_hand():
    inverse, logdet = inverse_and_logdet(np.array([[2.0, 1.0], [1.0, 3.0]]))
    np.testing.assert_allclose(inverse, [[0.6, -0.2], [-0.2, 0.4]])
    assert logdet == pytest.approx(np.log(5.0))


@pytest.mark.parametrize("size", [1, 2, 3, 4, 6])
def test_every_size_agrees_with_lapack(size):
    rng = np.random.default_rng(size)
    half = rng.normal(size=(5, 7, size, size + 2))
    matrix = half @ np.swapaxes(half, -1, -2)
    inverse, logdet = inverse_and_logdet(matrix)
    np.testing.assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(logdet, np.linalg.slogdet(matrix)[1], atol=1e-9)
    vector = rng.normal(size=(3, 5, 7, size))
    solution, square, again = solved_and_logdet(matrix, vector)
    expected = np.linalg.solve(np.broadcast_to(matrix, (3, *matrix.shape)), vector[..., None])[
        ..., 0
    ]
    np.testing.assert_allclose(solution, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(square, (expected * vector).sum(axis=-1), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(again[0], logdet, atol=1e-9)


def test_nearly_collinear_columns_keep_their_digits():
    matrix = np.ones((3, 3)) + 1e-4 * np.diag([1.0, 2.0, 3.0])
    inverse, _ = inverse_and_logdet(matrix)
    np.testing.assert_allclose(inverse @ matrix, np.eye(3), atol=1e-7)
