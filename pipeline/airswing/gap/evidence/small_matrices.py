"""Inverses and determinants of very many very small matrices.

Assumptions: symmetric, positive definite, scaled so that their entries are of like size (a matrix
whose smallest eigenvalue is under about 1e-6 of its largest loses digits here as anywhere).

Validity: any size; closed forms (cofactors) up to three rows, where a call of LAPACK per matrix
costs ten times its arithmetic.
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
