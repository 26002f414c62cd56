"""Whitened columns and their sums by aircraft and day, with the days' common fields eliminated.

Symbols and the identity Z' V^-1 Z = Z'Z - C'C are those of docs/gap.md, section 2. Units: m/s;
whitened values are dimensionless. Rows are kept in single precision, 2 (n p) numbers.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame, end_of_day
from airswing.gap.arrays import Floats, Integers, Singles
from airswing.gap.model.candidates import Candidates, Group
from airswing.gap.noise import NoiseFit, whiten
from airswing.units import DAY

#: Columns reserved beyond those of the first call, for pairs and finer tables; memory is used as
#: they are filled.
SPARE = 1000
#: Stretches of days that sums are kept by, at most; dates are found in them and then by day. Memory
#: of a diagnosis grows with their number, and two months hold as many days.
STRETCHES = 60
#: Variance of the day fields that expectation maximisation starts from, m2 s-2, and its steps.
START, STEPS = 0.5, 30
#: Least days with reports before and after a change.
SIDES = 2
#: Log posterior odds from which a candidate may enter: probability 0.95.
GATE = 3.0


def days_of(frame: Frame) -> tuple[Integers, Integers, float]:
    """Days with reports, the index of each report's day, and the second of the day they end at."""
    ends = end_of_day(frame.time)
    day = np.floor((frame.time - ends) / DAY).astype(np.int64)
    days, index = np.unique(day, return_inverse=True)
    return days, index, ends


class Sums:
    """Whitened rows of an archive by aircraft and day, and sums of their columns.

    ``days`` (D,) are those since 1970, shifted by ``ends`` (s), ``span`` their number from the
    first to the last report; ``aircraft`` and ``day`` are of each report, in the frame's order.
    ``rows`` (2 n, p) are sorted by aircraft and day; ``shared`` (D, q, p) is C of the module.
    Scores and information are kept by stretch of days, of which ``first_day`` (T,) is the first.
    """

    def __init__(
        self,
        frame: Frame,
        noise: NoiseFit,
        candidates: Candidates,
        fields: Floats,
        residual: Floats,
    ) -> None:
        self.frame, self.noise, self.candidates = frame, noise, candidates
        self.days, self.day, self.ends = days_of(frame)
        # Reports of one calendar day may lie in two of the days that end at the quiet hour.
        self.span = int(np.ceil(np.ptp(frame.time) / DAY))
        self.aircraft = frame.aircraft
        self.A, self.D, self.n = len(frame.tails), self.days.size, frame.size
        self.order = np.lexsort((self.day, frame.aircraft))
        key = (frame.aircraft * self.D + self.day)[self.order]
        self.cuts = 2 * np.searchsorted(key, np.arange(self.A * self.D + 1))
        self.day_of_row = np.repeat(key, 2) % self.D
        self.cells = [
            (i // self.D, i % self.D, slice(int(self.cuts[i]), int(self.cuts[i + 1])))
            for i in range(self.A * self.D)
            if self.cuts[i] < self.cuts[i + 1]
        ]
        length = -(-self.D // STRETCHES)
        self.stretch, self.first_day = np.arange(self.D) // length, np.arange(0, self.D, length)
        self.T = self.first_day.size
        self.flown = np.zeros((self.A, self.T), bool)
        for a, d, _ in self.cells:
            self.flown[a, self.stretch[d]] = True
        self.fields = self.whitened(fields)
        self.residual = self.whitened(residual[:, :, None])[:, 0]
        self._fit_fields()
        self.inverse_residual = self.invert(self.residual)
        self.rows = np.empty((2 * self.n, candidates.width + SPARE), np.float32, order="F")
        self.shared = np.empty((self.D, self.fields.shape[1], 0), np.float32)
        self.width = 0
        # first column that each extension built
        self.extended_from: list[int] = []
        self._grams: dict[tuple[int, int], tuple[Floats, Floats]] = {}
        self._of_group: dict[int, tuple[Group, Floats, Floats]] = {}
        self.extend()

    def rows_of(self, aircraft: int) -> slice:
        """Rows of an aircraft."""
        return slice(int(self.cuts[aircraft * self.D]), int(self.cuts[(aircraft + 1) * self.D]))

    def whitened(self, columns: NDArray[np.floating]) -> Singles:
        """Whitened rows (2 n, k) of columns (n, 2, k), sorted by aircraft and day."""
        white = whiten(np.asarray(columns, np.float32), self.noise.order, self.noise.gains)
        return np.ascontiguousarray(white[self.order]).reshape(2 * self.n, -1)

    def extend(self) -> None:
        """Whiten and sum the candidates' columns built since the last call."""
        pending = self.candidates.pending()
        # columns of groups that were forgotten are overwritten
        first = min([self.width, *(where.start for where in pending)])
        self.extended_from.append(first)
        self._grams = {key: gram for key, gram in self._grams.items() if key[1] <= first}
        self._of_group = {key: x for key, x in self._of_group.items() if x[0].columns.stop <= first}
        for where in pending:
            if where.stop > self.rows.shape[1]:
                more = where.stop + SPARE - self.rows.shape[1]
                self.rows = np.pad(self.rows, ((0, 0), (0, more)))
            self.rows[:, where] = self.whitened(self.candidates.raw(where))
        self.width = self.candidates.width
        new = np.zeros((self.D, self.fields.shape[1], self.width - first), np.float32)
        for _, d, span in self.cells:
            new[d] += self.fields[span].T @ self.rows[span, first : self.width]
        self.shared = np.concatenate([self.shared[..., :first], self.root @ new], axis=2)

    def _rows_by_day(self, aircraft: int) -> list[slice]:
        cuts = self.cuts[aircraft * self.D : (aircraft + 1) * self.D + 1]
        return [slice(i, j) for i, j in itertools.pairwise((cuts - cuts[0]).tolist())]

    def by_day(self, aircraft: int, left: Singles, right: Singles) -> Singles:
        """Products (D, i, j) by day of rows (2 n_a, i) and (2 n_a, j) of an aircraft."""
        return np.stack([left[span].T @ right[span] for span in self._rows_by_day(aircraft)])

    def of_fields(self, aircraft: int, coefficients: Singles) -> Singles:
        """Day fields with coefficients (D, q, k) on the rows of an aircraft, (2 n_a, k)."""
        fields = self.fields[self.rows_of(aircraft)]
        days = zip(self._rows_by_day(aircraft), coefficients, strict=True)
        return np.concatenate([fields[span] @ of_day for span, of_day in days])

    def release(self) -> None:
        """Free the memory of the rows; only fitted values can be used from then on."""
        self.rows = np.empty((0, 0), np.float32)
        self._grams, self._of_group = {}, {}

    def _fit_fields(self) -> None:
        """Variances of the day fields by expectation maximisation, and roots of M_d."""
        q = self.fields.shape[1]
        gram, score = np.zeros((self.D, q, q)), np.zeros((self.D, q))
        for _, d, span in self.cells:
            rows = self.fields[span].astype(float)
            gram[d] += rows.T @ rows
            score[d] += rows.T @ self.residual[span]
        variance = self.field_variance = field_variance(gram, score)
        root = np.linalg.inv(np.linalg.cholesky(gram + np.diag(1 / variance)))
        self.root = root.astype(np.float32)

    def invert(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """V^-1 times a vector over the rows."""
        total = np.zeros((self.D, self.fields.shape[1]))
        for _, d, span in self.cells:
            total[d] += values[span] @ self.fields[span]
        fitted = np.einsum("dji,djk,dk->di", self.root, self.root, total).astype(np.float32)
        return np.asarray(values - np.einsum("nq,nq->n", self.fields, fitted[self.day_of_row]))

    def scores(self, values: NDArray[np.floating]) -> Floats:
        """Columns' products with a vector over the rows, by aircraft and stretch, (A, T, p)."""
        out = np.zeros((self.A, self.T, self.width))
        for a, d, span in self.cells:
            out[a, self.stretch[d]] += values[span] @ self.rows[span, : self.width]
        return out

    def by_stretch(self, by_day: NDArray[np.floating]) -> Floats:
        """Sums (T, ...) over the days of each stretch of values (D, ...)."""
        return np.asarray(np.add.reduceat(by_day, self.first_day), np.float64)

    def information(self, group: Group) -> tuple[Floats, Floats]:
        """Information about a group's coefficients: (A, T, m, m) of aircraft, (T, m, m) of all."""
        cached = self._of_group.get(id(group))
        if cached is not None and cached[0] is group:
            return cached[1], cached[2]
        by_aircraft, of_fleet = self._gram(group.columns)
        t = group.transform
        out = (
            np.einsum("ki,adkl,lj->adij", t, by_aircraft, t, optimize=True),
            np.einsum("ki,dkl,lj->dij", t, of_fleet, t, optimize=True),
        )
        self._of_group[id(group)] = (group, *out)
        return out

    def _gram(self, columns: slice) -> tuple[Floats, Floats]:
        key = (columns.start, columns.stop)
        if key not in self._grams:
            k = columns.stop - columns.start
            by_aircraft, of_fleet = np.zeros((self.A, self.T, k, k)), np.zeros((self.T, k, k))
            q = self.fields.shape[1]
            for a in range(self.A):
                span = self.rows_of(a)
                rows = np.concatenate([self.fields[span], self.rows[span, columns]], axis=1)
                products = self.by_day(a, rows, rows[:, q:])
                gram = self.by_stretch(products[:, q:])
                by_aircraft[a] = gram - self._of_shared(self.root @ products[:, :q])
                of_fleet += gram
            self._grams[key] = by_aircraft, of_fleet - self._of_shared(self.shared[..., columns])
        return self._grams[key]

    def _of_shared(self, shared: Singles) -> Floats:
        """C'C of the module, (T, k, k), of columns whose C is ``shared`` (D, q, k)."""
        shared = shared.astype(float)
        return self.by_stretch(np.swapaxes(shared, 1, 2) @ shared)


def field_variance(gram: Floats, score: Floats) -> Floats:
    """Variances (q,) of the day fields about zero, or about means that change on a day.

    A change of the mean wind that all aircraft meet (a new version of the reference, an effect on
    all aircraft from a date on) would otherwise pass for weather. ``gram`` (D, q, q) and ``score``
    (D, q) are of each day; the constant of either component may change, on the day that reduces
    its variance most, if the evidence (Schwarz 1978) passes the gate.
    """
    number, q = score.shape
    constants = [0, q // 2]
    variance, evidence, fields = _fit_by_em(gram, score, np.zeros((number, 1)), constants)
    if number < 2 * SIDES:
        return variance
    winds = fields[:, constants]
    within = [
        np.log(winds[:d].var(axis=0) * d + winds[d:].var(axis=0) * (number - d)).sum()
        for d in range(SIDES, number - SIDES + 1)
    ]
    late = np.arange(number) >= SIDES + int(np.argmin(within))
    changed, more, _ = _fit_by_em(gram, score, np.stack([~late, late], -1), constants)
    parameters = 2 * len(constants) + 2  # means, and the day, which counts as two
    return changed if more - evidence - 0.5 * parameters * np.log(number) > GATE else variance


def _fit_by_em(
    gram: Floats, score: Floats, segments: Floats, constants: list[int]
) -> tuple[Floats, float, Floats]:
    """Variances, log likelihood and fields (D, q); the constants have a mean in each segment."""
    variance, mean = np.full(score.shape[1], START), np.zeros_like(score)
    weights = segments / np.maximum(segments.sum(axis=0), 1)
    for _ in range(STEPS):
        inverse = np.linalg.inv(gram + np.diag(1 / variance))
        fields = np.einsum("dij,dj->di", inverse, score + mean / variance)
        mean[:, constants] = segments @ (weights.T @ fields[:, constants])
        variance = ((fields - mean) ** 2 + np.einsum("dii->di", inverse)).mean(axis=0)
    precision, right = gram + np.diag(1 / variance), score + mean / variance
    likelihood = (
        (right * np.linalg.solve(precision, right[..., None])[..., 0]).sum()
        - np.linalg.slogdet(precision)[1].sum()
        - (np.zeros_like(mean) + np.log(variance) + mean**2 / variance).sum()
    )
    return variance, 0.5 * float(likelihood), fields
