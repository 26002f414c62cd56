"""Inverses, solutions and determinants of very many very small matrices.

Assumptions: symmetric, positive definite, scaled so that their entries are of like size (a matrix
whose smallest eigenvalue is under about 1e-6 of its largest loses digits here as anywhere).

Validity: any size; closed forms (cofactors, elimination across all matrices at once) where a call
of LAPACK per matrix costs ten times its arithmetic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def inverse_and_logdet(matrix: Floats) -> tuple[Floats, Floats]:
    """Inverse and logarithm of the determinant of each of many matrices.

    Parameters
    ----------
    matrix : (..., k, k) float
        Symmetric and positive definite.

    Returns
    -------
    inverse : (..., k, k) float
    logdet : (...) float
    """
    k = matrix.shape[-1]
    if k > 3:
        return np.asarray(np.linalg.inv(matrix)), np.asarray(np.linalg.slogdet(matrix)[1])
    cofactors = np.empty(matrix.shape)
    if k == 1:
        cofactors[...] = 1.0
    elif k == 2:
        cofactors[..., 0, 0], cofactors[..., 1, 1] = matrix[..., 1, 1], matrix[..., 0, 0]
        cofactors[..., 0, 1] = cofactors[..., 1, 0] = -matrix[..., 0, 1]
    else:
        for i in range(3):
            for j in range(i, 3):
                a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                minor = matrix[..., a, c] * matrix[..., b, d]
                minor -= matrix[..., a, d] * matrix[..., b, c]
                cofactors[..., i, j] = cofactors[..., j, i] = minor
    determinant = (matrix[..., 0, :] * cofactors[..., 0, :]).sum(axis=-1)
    inverse = cofactors / determinant[..., None, None]
    return np.asarray(inverse), np.asarray(np.log(determinant))


def solved_and_logdet(matrix: Floats, vector: Floats) -> tuple[Floats, Floats, Floats]:
    """Solution of each of many systems, its product with the vector, and the log determinant.

    Parameters
    ----------
    matrix : (..., k, k) float
        Symmetric and positive definite.
    vector : (..., k) float

    Returns
    -------
    solution : (..., k) float
        M^-1 v.
    square : (...) float
        v' M^-1 v.
    logdet : (...) float
    """
    k = vector.shape[-1]
    shape = np.broadcast_shapes(matrix.shape[:-2], vector.shape[:-1])
    # rows first: every step below then goes through memory in one piece
    wide, rows = np.broadcast_to(matrix, (*shape, k, k)), np.broadcast_to(vector, (*shape, k))
    left = np.array(np.moveaxis(wide, (-2, -1), (0, 1)), order="C")
    right = np.array(np.moveaxis(rows, -1, 0), order="C")
    for j in range(k - 1):  # no pivoting: of a positive definite matrix all pivots are positive
        share = left[j + 1 :, j] / left[j, j]
        left[j + 1 :, j + 1 :] -= share[:, None] * left[j, j + 1 :]
        right[j + 1 :] -= share * right[j]
    pivot = left[np.arange(k), np.arange(k)]
    solution = right / pivot
    square = (right * solution).sum(axis=0)
    for j in range(k - 2, -1, -1):
        solution[j] -= (left[j, j + 1 :] * solution[j + 1 :]).sum(axis=0) / pivot[j]
    return np.moveaxis(solution, 0, -1), square, np.asarray(np.log(pivot.prod(axis=0)))
