"""The reference's error as the whole fleet sees it, estimated beside the deviations.

Assumes the error of the reference wind is a smooth field shared by every aircraft that flies
through it: a part that lasts over the archive (hat functions in latitude, longitude and ln p)
and a part that changes every six hours (hat functions about 400 km apart). Both are Gaussian
random effects whose variances are estimated from the data, so that a reference without error
leaves the fits as they were. An aircraft's deviation turns with its heading and is its own; the
field does neither, and that is how the two are told apart. What cannot be told apart widens the
deviation's covariance.

Valid for any number of aircraft; the more of them share the air, the more it helps. SI units and
radians inside; latitude and longitude in degrees.

References
----------
Generalized least squares by backfitting: Hastie & Tibshirani 1990, Generalized Additive Models,
ch. 5; variances by expectation-maximization: Laird & Ware 1982, Biometrics 38, 963-974.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]
Columns = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]

SPACING_KM = 400.0
"""Distance of the passing part's nodes: the reach of a model's synoptic error."""
SEGMENT_SECONDS = 6 * 3600.0
STATIC_NODES = (4, 5, 3)
"""Nodes of the lasting part in latitude, longitude and ln p, at quantiles of the reports."""
LARGEST_VARIANCE = 9.0
"""(m/s)2: more than this is not the reference's error."""
ROUNDS = 6
CLIP = 5.0
"""Robust standard deviations at which a residual is cut."""


@dataclass(frozen=True)
class FieldBasis:
    """Which functions make up the field.

    Attributes
    ----------
    lasting : tuple of arrays of float
        Nodes in latitude, eastward degrees and ln p.
    passing : tuple of arrays of float
        Nodes in latitude and eastward degrees.
    origin : tuple of float
        Longitude of the middle, cosine of the middle latitude, first second.
    segments : array of int
        Numbers of the six-hour segments that hold reports.
    """

    lasting: tuple[Floats, ...]
    passing: tuple[Floats, ...]
    origin: tuple[float, float, float]
    segments: Ints

    @classmethod
    def of(
        cls, latitude: Floats, longitude: Floats, log_pressure: Floats, seconds: Floats
    ) -> FieldBasis:
        """Choose the functions for some reports.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (report,), degrees
        log_pressure : array of float, shape (report,)
        seconds : array of float, shape (report,)
            Since any epoch.

        Returns
        -------
        FieldBasis
        """
        angle = np.radians(longitude)
        middle = float(np.degrees(np.arctan2(np.sin(angle).mean(), np.cos(angle).mean())))
        origin = (middle, float(np.cos(np.radians(np.median(latitude)))), float(seconds.min()))
        east = _eastward(longitude, origin)
        lasting = tuple(
            np.unique(np.quantile(values, np.linspace(0, 1, nodes)))
            for values, nodes in zip((latitude, east, log_pressure), STATIC_NODES, strict=True)
        )
        passing = tuple(_even(values, SPACING_KM / 111.2) for values in (latitude, east))
        return cls(lasting, passing, origin, np.unique(_segment(seconds, origin)))

    @property
    def part(self) -> Ints:
        """0 for each column of the lasting part, 1 for each of the passing one."""
        sizes = [
            int(np.prod([nodes.size for nodes in part])) for part in (self.lasting, self.passing)
        ]
        return np.repeat([0, 1], [sizes[0], sizes[1] * self.segments.size]).astype(np.int64)

    def segment_of(self, seconds: Floats) -> Ints:
        """Place of each time among the segments, -1 where it falls in none of them.

        Parameters
        ----------
        seconds : array of float, shape (report,)

        Returns
        -------
        array of int, shape (report,)
        """
        number = _segment(seconds, self.origin)
        place = np.searchsorted(self.segments, number)
        known = self.segments[np.minimum(place, self.segments.size - 1)] == number
        return np.where(known, place, -1)

    def design(
        self, latitude: Floats, longitude: Floats, log_pressure: Floats, seconds: Floats
    ) -> sparse.csr_matrix:
        """Values of every function at some reports.

        Parameters
        ----------
        latitude, longitude, log_pressure, seconds
            As for :meth:`of`.

        Returns
        -------
        sparse matrix, shape (report, column)
        """
        east = _eastward(longitude, self.origin)
        values = (latitude, east, log_pressure)
        lasting = _product([_hats(v, n) for v, n in zip(values, self.lasting, strict=True)])
        passing = _product([_hats(v, n) for v, n in zip(values[:2], self.passing, strict=True)])
        width = passing.shape[1]
        number = self.segment_of(seconds)
        shift = np.repeat(number * width, np.diff(passing.indptr))
        moved = sparse.csr_matrix(
            (passing.data, passing.indices + shift, passing.indptr),
            shape=(latitude.size, width * self.segments.size),
        )
        return sparse.hstack([lasting, moved]).tocsr()


@dataclass(frozen=True)
class FieldFit:
    """An estimated field.

    Attributes
    ----------
    coefficients : array of float, shape (column, 2), m/s
        Eastward and northward.
    variance : array of float, shape (2,)
        (m/s)2 of the lasting and the passing part's coefficients.
    weight : array of float, shape (report,)
        Weight each report had, (m/s)^-2, its flight's common error allowed for.
    """

    coefficients: Floats
    variance: Floats
    weight: Floats


def fit_field(
    design: sparse.csr_matrix,
    part: Ints,
    residual: Floats,
    flight: Ints,
    *,
    start: Floats | None = None,
) -> FieldFit:
    """Estimate the field from what the deviations leave unexplained.

    Parameters
    ----------
    design : sparse matrix, shape (report, column)
    part : array of int, shape (column,)
        Of :attr:`FieldBasis.part`.
    residual : array of float, shape (2, report), m/s
        Reference wind minus corrected wind.
    flight : array of int, shape (report,)
    start : array of float, shape (2,), optional
        Variances of an earlier, nearby estimate: fewer rounds are needed from there.

    Returns
    -------
    FieldFit
    """
    spread = 1.4826 * np.median(np.abs(residual), axis=1, keepdims=True)
    residual = np.clip(residual, -CLIP * spread, CLIP * spread)
    variance = np.full(2, 0.5) if start is None else start
    error = np.zeros_like(residual)
    weight, coefficients = np.ones(residual.shape[1]), np.zeros((part.size, 2))
    _, flight = np.unique(flight, return_inverse=True)
    for _ in range(ROUNDS if start is None else ROUNDS // 3):
        weight = _flight_weight(residual - error, flight)
        solver = Solver(design, part, weight, variance)
        coefficients = solver.solve(design.T @ (weight * residual).T)
        error = np.asarray((design @ coefficients).T)
        variance = _updated(coefficients, solver.spread(), part)
    return FieldFit(coefficients, variance, weight)


class Solver:
    """Solves the penalized normal equations of the field.

    Parameters
    ----------
    design : sparse matrix, shape (report, column)
    part : array of int, shape (column,)
    weight : array of float, shape (report,)
    variance : array of float, shape (2,)
        Of the two parts' coefficients.
    """

    def __init__(
        self, design: sparse.csr_matrix, part: Ints, weight: Floats, variance: Floats
    ) -> None:
        normal = design.T @ sparse.diags(weight) @ design
        penalty = 1.0 / variance[part]
        # The lasting columns meet all the others: last, they leave the factors sparse.
        self._order = np.argsort(-part, kind="stable")
        matrix = (normal + sparse.diags(penalty)).tocsc()[self._order][:, self._order]
        self._factors = splu(matrix, permc_spec="NATURAL" if matrix.shape[0] < 500 else "COLAMD")
        self._diagonal = np.asarray(normal.diagonal()) + penalty

    def solve(self, right: Floats) -> Floats:
        """Solve for one or more right-hand sides.

        Parameters
        ----------
        right : array of float, shape (column, k)

        Returns
        -------
        array of float, shape (column, k)
        """
        found = np.empty_like(right, dtype=np.float64)
        found[self._order] = self._factors.solve(np.ascontiguousarray(right[self._order]))
        return found

    def spread(self) -> Floats:
        """Lower bound of each coefficient's posterior variance: what its own data leave."""
        return np.asarray(1.0 / self._diagonal, dtype=np.float64)


def widening(
    design: sparse.csr_matrix,
    part: Ints,
    fits: list[FieldFit],
    columns: list[Floats],
    rows: list[Ints],
) -> Floats:
    """Factor that turns estimates with a known field, and their errors, into joint ones.

    Parameters
    ----------
    design : sparse matrix, shape (report, column)
    part : array of int, shape (column,)
    fits : list of FieldFit
        One a reference.
    columns : list of arrays of float, shape (rows, 2, p)
        One an aircraft: what each coefficient moves the residual by, eastward and northward.
    rows : list of arrays of int
        Reports of each aircraft.

    Returns
    -------
    array of float, shape (aircraft * p, aircraft * p)
        ``K = M^-1 N``, N the information with a known field, M what an unknown one leaves of
        it. A step of the estimates with the field held fixed times K is the joint step. For
        their covariance C, ``K C K'`` is the joint one from above: for ``C = N^-1`` the exact
        one is ``M^-1``, smaller by K, which would hold if the field's model did.
    """
    size = columns[0].shape[2]
    total = len(columns) * size
    known, left = np.zeros((total, total)), np.zeros((total, total))
    for fit in fits:
        solver = Solver(design, part, fit.weight, fit.variance)
        for component in range(2):
            seen = np.empty((part.size, total))
            for k, (own, index) in enumerate(zip(columns, rows, strict=True)):
                place = slice(k * size, (k + 1) * size)
                weighted = fit.weight[index][:, np.newaxis] * own[:, component]
                seen[:, place] = design[index].T @ weighted
                known[place, place] += own[:, component].T @ weighted
            left -= seen.T @ solver.solve(seen)
    left += known
    ridge = 1e-9 * np.trace(known) / total
    return np.linalg.solve(left + ridge * np.eye(total), known + ridge * np.eye(total))


def _updated(coefficients: Floats, spread: Floats, part: Ints) -> Floats:
    """Expectation-maximization step for the two variances."""
    found = np.empty(2)
    for number in range(2):
        mine = part == number
        energy = (coefficients[mine] ** 2).mean(axis=1) + spread[mine]
        found[number] = np.clip(energy.mean() if mine.any() else 0.0, 1e-4, LARGEST_VARIANCE)
    return found


def _flight_weight(residual: Floats, flight: Ints) -> Floats:
    """Weight of a report whose flight shares an error: 1 / (white + count * shared)."""
    count = np.bincount(flight)
    mean = np.stack([np.bincount(flight, weights=part) / count for part in residual])
    within = residual - mean[:, flight]
    freedom = max(residual.shape[1] - count.size, 1)
    white = max(float((within**2).sum()) / (2 * freedom), 1e-4)
    shared = max(float((mean**2).mean()) - white * float((1.0 / count).mean()), 0.0)
    return np.asarray(1.0 / (white + count[flight] * shared), dtype=np.float64)


def _hats(values: Floats, nodes: Floats) -> sparse.csr_matrix:
    """Piecewise linear functions, one a node, that sum to one."""
    size = values.size
    if nodes.size == 1:
        return sparse.csr_matrix(np.ones((size, 1)))
    left = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, nodes.size - 2)
    share = np.clip((values - nodes[left]) / (nodes[left + 1] - nodes[left]), 0.0, 1.0)
    data = np.column_stack([1.0 - share, share]).ravel()
    indices = np.column_stack([left, left + 1]).ravel()
    return sparse.csr_matrix((data, indices, np.arange(size + 1) * 2), shape=(size, nodes.size))


def _product(parts: list[sparse.csr_matrix]) -> sparse.csr_matrix:
    """Row by row product of every column of one with every column of the others."""
    found = parts[0]
    for other in parts[1:]:
        one, two = np.diff(found.indptr)[0], np.diff(other.indptr)[0]
        data = found.data.reshape(-1, one, 1) * other.data.reshape(-1, 1, two)
        index = found.indices.reshape(-1, one, 1) * other.shape[1]
        index = index + other.indices.reshape(-1, 1, two)
        rows, shape = found.shape[0], (found.shape[0], found.shape[1] * other.shape[1])
        starts = np.arange(rows + 1) * one * two
        found = sparse.csr_matrix((data.ravel(), index.ravel(), starts), shape=shape)
    return found


def _even(values: Floats, step: float) -> Floats:
    low, high = float(values.min()), float(values.max())
    return (
        np.linspace(low, high, max(2, round((high - low) / step) + 1))
        if high > low
        else (np.array([low]))
    )


def _eastward(longitude: Floats, origin: tuple[float, float, float]) -> Floats:
    """Degrees of great circle east of the middle, without a jump at the antimeridian."""
    return np.asarray(((longitude - origin[0] + 180.0) % 360.0 - 180.0) * origin[1])


def _segment(seconds: Floats, origin: tuple[float, float, float]) -> Ints:
    return np.floor((seconds - origin[2]) / SEGMENT_SECONDS).astype(np.int64)


def deviation_columns(
    coefficients: Floats, scale: float, heading: Floats, abscissa: Floats, airspeed: Floats
) -> tuple[Floats, Floats]:
    """True air vector of one aircraft's reports, and what its coefficients move it by.

    Parameters
    ----------
    coefficients : array of float, shape (5,), radians
        A to E.
    scale : float
        Airspeed scale.
    heading, abscissa : arrays of float, shape (report,), radians
    airspeed : array of float, shape (report,), m/s

    Returns
    -------
    vector : array of float, shape (2, report), m/s
        Eastward and northward.
    columns : array of float, shape (report, 2, 6)
        Derivatives by A to E and by the scale.
    """
    m = abscissa
    basis = np.stack([np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)], axis=1)
    true = heading - basis @ coefficients
    speed = airspeed * (1.0 - scale)
    along = np.stack([np.sin(true), np.cos(true)])
    across = np.stack([np.cos(true), -np.sin(true)])
    turned = -(speed * across).T[:, :, np.newaxis] * basis[:, np.newaxis, :]
    scaled = -(airspeed * along).T[:, :, np.newaxis]
    return np.asarray(speed * along), np.asarray(np.concatenate([turned, scaled], axis=2))


def adjusted_errors(
    heading: Columns,
    airspeed: Columns,
    heading_error: Columns,
    airspeed_error: Columns,
    error: Floats,
) -> tuple[Floats, Floats]:
    """Heading and airspeed errors once an error is taken off the reference wind.

    Parameters
    ----------
    heading : array of float, shape (report,), radians
    airspeed, airspeed_error : arrays of float, shape (report,), m/s
    heading_error : array of float, shape (report,), radians
    error : array of float, shape (2, report), m/s

    Returns
    -------
    heading_error : array of float, shape (report,), radians
    airspeed_error : array of float, shape (report,), m/s
    """
    east, north = reference_air(heading, airspeed, heading_error, airspeed_error) + error
    turned = heading - np.arctan2(east, north)
    turned = np.arctan2(np.sin(turned), np.cos(turned))
    return np.asarray(turned), np.asarray(airspeed - np.hypot(east, north))


def reference_air(
    heading: Columns, airspeed: Columns, heading_error: Columns, airspeed_error: Columns
) -> Floats:
    """Air vector the reference implies, eastward and northward, shape (2, report), m/s."""
    direction, length = heading - heading_error, airspeed - airspeed_error
    found: Any = np.stack([length * np.sin(direction), length * np.cos(direction)])
    return np.asarray(found, dtype=np.float64)
