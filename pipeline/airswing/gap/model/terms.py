"""Terms that are in the model, fitted jointly; and the statistics of every candidate given them.

With X the columns of all terms and prior precision P (1 / s^2 of each coefficient),

    H = X' V^-1 X + P,   theta = H^-1 X' V^-1 r,
    log p(r) = const + h'H^-1 h / 2 - log det(H) / 2 + log det(P) / 2,

h = X' V^-1 r; with a noise factor kappa both X' V^-1 X and h are divided by it. Given the terms,
the score of a candidate Z is b_ad = Z_ad' V^-1 (r - X theta) and its information G - W'W, with W =
H^-1/2 X' V^-1 Z; for one aircraft X are the columns of terms that act on it, and H^-1 that block of
the inverse (other aircraft are concerned through the day fields only).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln

from airswing.gap.arrays import Floats, Integers, Singles
from airswing.gap.model.candidates import Group
from airswing.gap.model.sums import Sums

#: L, m/s: the lasting error of the reference, which no number of days averages out, in the frame of
#: the wind and in that of the aircraft, where it averages over headings. Root mean square of fleet
#: coefficients beyond their noise on simulated archives without an effect: 0.00 to 0.02 and, of
#: errors along the wind, 0.03 to 0.07.
LASTING = {"wind": 0.07, "aircraft": 0.03}
#: Relative error of every coefficient beyond its noise: soft iron of 1.1 degrees and hard iron of
#: 2 degrees put into archives without an effect came out at 0.9997, 0.997 and 0.989 of the truth;
#: fleet-wide ones of simulated archives at 0.94 and 0.96.
FIRST_ORDER = 0.02
#: Prior standard deviation of the reference's climatology, m/s: the error of weather models in the
#: mean of a month at one place and level (bias of upper-air winds in radiosonde verification).
CLIMATOLOGY = 0.6


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate in the model: its aircraft, dates, prior scale and evidence."""

    group: Group
    scope: str  # ``a`` or ``f``
    tails: tuple[int, ...]  # aircraft, by number
    scale: float  # prior standard deviation s, m/s where it acts
    # aircraft -> days (indices) from and before which it is in force; empty for the whole archive
    period: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    score: float = 0.0  # log evidence with the log prior: of the exact contest after one
    gate: float = 0.0  # the same by the candidate's noise factor
    inclusion: Floats | None = None  # (A,): posterior probability of each aircraft
    # ratio of tau to s where aircraft share a mean, theta_a ~ N(mu, tau^2), mu ~ N(0, s^2); or 0
    spread: float = 0.0
    # (evidence it lies ahead, name, scope) of the other candidates of the contest
    rivals: tuple[tuple[float, str, str], ...] = ()
    weight: float = 1.0  # posterior probability among the candidates of the contest
    # (m, m): prior precision of an aircraft's coefficients for s = 1; None: the unit matrix
    shape: Floats | None = None

    @property
    def key(self) -> tuple[object, ...]:
        """Identification of its columns."""
        group, columns = self.group, self.group.columns
        identity = (group.name, columns.start, columns.stop, group.form, group.dated)
        return *identity, self.scope, self.tails, tuple(sorted(self.period.items()))

    @property
    def label(self) -> tuple[str, str, tuple[int, ...]]:
        """Identification without aircraft and dates."""
        return self.group.name, self.scope, (*self.group.form, self.group.dated)

    @property
    def freedom(self) -> int:
        """Number of its coefficients and dates."""
        number = 1 if self.scope == "f" else len(self.tails)
        return number * self.group.size + len(set(self.period.values()))

    @property
    def precision(self) -> Floats:
        """Prior precision of all its coefficients."""
        number = 1 if self.scope == "f" else len(self.tails)
        between: Floats = np.eye(number)
        if self.spread and number > 1:
            shared = np.ones((number, number)) + self.spread**2 * np.eye(number)
            between = np.asarray(np.linalg.inv(shared), np.float64)
        shape = np.eye(self.group.size) if self.shape is None else self.shape
        return np.asarray(np.kron(between, shape) / self.scale**2)


def set_prior(model: Model, term: Term) -> float:
    """Log prior of a term's aircraft and dates."""
    out = 0.0
    if term.scope == "a":
        out += float(number_prior(model.sums.A)[len(term.tails)])
    days = model.sums.D
    for _, stop in set(term.period.values()):
        out -= float(np.log(2 * days)) + (float(np.log(days)) if stop < days else 0.0)
    return out


def number_prior(aircraft: int) -> Floats:
    """Log prior of each set of 0, 1, ... A aircraft under a uniform share."""
    sizes = np.arange(aircraft + 1)
    sets = gammaln(aircraft + 1) - gammaln(sizes + 1) - gammaln(aircraft - sizes + 1)
    return np.asarray(-np.log(aircraft + 1) - sets)


class Columns:
    """Columns of a term on the rows of each aircraft, and their products with the day fields.

    ``raw`` (2 n, k) are whitened raw columns evaluated elsewhere than those of the sums.
    """

    def __init__(self, sums: Sums, term: Term, raw: Singles | None = None) -> None:
        m = term.group.size
        self.sums = sums
        transform = term.group.transform.astype(np.float32)
        self.width = m if term.scope == "f" else m * len(term.tails)
        self.rows: dict[int, tuple[Integers, Singles]] = {}
        self.shared = np.zeros((sums.D, sums.fields.shape[1], self.width))
        for j, a in enumerate(term.tails):
            span = sums.rows_of(a)
            rows = sums.rows[span, term.group.columns] if raw is None else raw[span]
            values = rows @ transform
            first, stop = term.period.get(a, (0, sums.D))
            day = sums.day_of_row[span]
            values[(day < first) | (day >= stop)] = 0.0
            at = np.arange(m) if term.scope == "f" else np.arange(j * m, (j + 1) * m)
            self.rows[a] = (at, values)
            self.shared[:, :, at] += sums.root @ sums.by_day(a, sums.fields[span], values)
        self.score = np.zeros(self.width)
        for a, (at, values) in self.rows.items():
            self.score[at] += values.T @ sums.inverse_residual[sums.rows_of(a)]
        self._cross = np.zeros((self.width, 0), np.float32)
        self._cross_by_aircraft = {
            a: np.zeros((at.size, 0), np.float32) for a, (at, _) in self.rows.items()
        }
        self._extensions = len(sums.extended_from)

    @cached_property
    def inverse(self) -> dict[int, Singles]:
        """Rows of V^-1 X of each aircraft."""
        coefficients = np.swapaxes(self.sums.root, 1, 2) @ self.shared.astype(np.float32)
        return {
            a: values - self.sums.of_fields(a, coefficients[..., at])
            for a, (at, values) in self.rows.items()
        }

    def with_candidates(self) -> tuple[Singles, dict[int, Singles]]:
        """X' V^-1 Z with the columns Z of all candidates, (k, p): of all aircraft, and of each."""
        sums = self.sums
        summed = min([self._cross.shape[1], *sums.extended_from[self._extensions :]])
        self._extensions = len(sums.extended_from)
        new = slice(summed, sums.width)
        shared = self.shared.astype(np.float32).reshape(-1, self.width)
        cross = -shared.T @ sums.shared[..., new].reshape(shared.shape[0], -1)
        for a, (at, values) in self.rows.items():
            both = np.concatenate([values, self.inverse[a]], axis=1)
            of_rows, product = np.split(both.T @ sums.rows[sums.rows_of(a), new], 2)
            cross[at] += of_rows
            old = self._cross_by_aircraft[a][:, :summed]
            self._cross_by_aircraft[a] = np.concatenate([old, product], axis=1)
        self._cross = np.concatenate([self._cross[:, :summed], cross], axis=1)
        return self._cross, self._cross_by_aircraft

    def product(self, right: Columns) -> Floats:
        """X' V^-1 Y with the columns of another term."""
        out = -np.einsum("dqi,dqj->ij", self.shared, right.shared, optimize=True)
        for a in self.rows.keys() & right.rows.keys():
            (i, x), (j, y) = self.rows[a], right.rows[a]
            out[np.ix_(i, j)] += x.T @ y
        return np.asarray(out)

    def product_by_fold(self, right: Columns, of_row: Integers, folds: int) -> Floats:
        """The same over each group of days, (folds, i, j); ``of_row`` is the group of each row."""
        out = np.zeros((folds, self.width, right.width))
        of_day = np.zeros(self.shared.shape[0], np.int64)
        of_day[self.sums.day_of_row] = of_row
        for k in range(folds):
            days = of_day == k
            out[k] = -np.einsum("dqi,dqj->ij", self.shared[days], right.shared[days], optimize=True)
        for a in self.rows.keys() & right.rows.keys():
            (i, x), (j, y) = self.rows[a], right.rows[a]
            numbers = of_row[self.sums.rows_of(a)]
            for k in range(folds):
                out[k][np.ix_(i, j)] += x[numbers == k].T @ y[numbers == k]
        return out


@dataclass(frozen=True)
class AircraftTerms:
    """Coefficients of the terms in the model that act on an aircraft."""

    rows: Singles  # (2 n_a, w): those of V^-1 X on its rows
    root: Floats  # (w, w): a root of their posterior covariance, root' root


@dataclass(frozen=True)
class Statistics:
    """Scores and information of a candidate given the terms in the model, by aircraft and day."""

    score: Floats  # (A, m)
    information: Floats  # (A, m, m)
    fleet_information: Floats  # (m, m)
    ridge: Floats  # (m, m)
    fleet_inverse: Floats  # (m, m)
    factor: Floats  # (A,): of single aircraft
    fleet_factor: float
    # variances, m2 s-2: of the lasting error of the reference; of the error that all aircraft
    # have; by aircraft, of the residual effect of terms in the model whose columns are inexact
    lasting: float = 0.0
    usual: float = 0.0
    remainder: Floats | float = 0.0

    @property
    def mean_factor(self) -> float:
        """Mean noise factor of the aircraft that have reports."""
        return float(np.nanmean(self.factor))


def log_evidence(gram: Floats, score: Floats, precision: Floats, kappa: float) -> float:
    """Log marginal likelihood of the module with noise factor kappa, up to a constant."""
    root = np.linalg.cholesky(gram / kappa + precision)
    solved = solve_triangular(root, score / kappa, lower=True)
    determinants = np.diag(np.linalg.cholesky(precision)) / np.diag(root)
    return float(0.5 * solved @ solved + np.log(determinants).sum())


class Model:
    """Terms that are conditioned on."""

    def __init__(self, sums: Sums) -> None:
        self.sums = sums
        nuisance = next(g for g in sums.candidates.groups if g.kind == "nuisance")
        self.base = Term(nuisance, "f", tuple(range(sums.A)), CLIMATOLOGY)
        self._columns: dict[tuple[object, ...], Columns] = {}
        self._products: dict[tuple[object, object], Floats] = {}
        self.kappa = 1.0
        self.usual: dict[str, tuple[float, float]] = {}
        self._factored: tuple[tuple[object, ...], Floats, Floats] = ((), np.eye(0), np.eye(0))
        self._residual = sums.residual
        self.condition([])

    def renew(self, residual: Floats) -> None:
        """Take another residual (n, 2), m/s; the variances of the day fields are kept."""
        self._residual = self.sums.whitened(residual[:, :, None])[:, 0]
        self.condition(self.terms)

    def _set_residual(self, residual: Singles) -> None:
        if residual is not self.sums.residual:
            self.sums.residual = residual
            self.sums.inverse_residual = self.sums.invert(residual)
            self._columns = {}
            self._factored = ((), np.eye(0), np.eye(0))

    def columns(self, term: Term) -> Columns:
        """Columns of a term, kept while it is in the model."""
        if term.key not in self._columns:
            self._columns[term.key] = Columns(self.sums, term)
        return self._columns[term.key]

    def _product(self, first: Term, second: Term) -> Floats:
        pair = (first.key, second.key)
        if pair not in self._products:
            product = self.columns(first).product(self.columns(second))
            self._products[pair], self._products[pair[::-1]] = product, product.T
        return self._products[pair]

    # ----------------------------------------------------------------------------------- the fit
    def system(self, terms: Sequence[Term]) -> tuple[Floats, Floats, Floats]:
        """X' V^-1 X, X' V^-1 r and P of the climatology and some terms."""
        every = [self.base, *terms]
        gram = np.block([[self._product(x, y) for y in every] for x in every])
        score = np.concatenate([self.columns(x).score for x in every])
        return gram, score, self.precision(terms)

    def precision(self, terms: Sequence[Term]) -> Floats:
        """Prior precision of the coefficients of the climatology and some terms."""
        return np.asarray(block_diag(*(x.precision for x in (self.base, *terms))))

    def evidence(self, terms: Sequence[Term], kappa: float) -> float:
        """Log marginal likelihood of terms with noise variance kappa, up to a constant."""
        return log_evidence(*self.system(terms), kappa)

    def gain(self, terms: Sequence[Term], term: Term) -> float:
        """Log marginal likelihood of terms with one more, less that without it.

        By the Schur complement of the terms in H.
        """
        return log_evidence(*self.given(terms, term), term.precision, 1.0)

    def given(self, terms: Sequence[Term], term: Term) -> tuple[Floats, Floats]:
        """X' V^-1 X and X' V^-1 r of a term, over kappa, given others."""
        key = (*terms, self.kappa)
        if key != self._factored[0]:
            gram, score, precision = self.system(terms)
            root = np.asarray(np.linalg.cholesky(gram / self.kappa + precision), np.float64)
            solved = solve_triangular(root, score / self.kappa, lower=True)
            self._factored = key, root, np.asarray(solved, np.float64)
        _, root, solved = self._factored
        cross = np.concatenate([self._product(x, term) for x in (self.base, *terms)]) / self.kappa
        explained = solve_triangular(root, cross, lower=True)
        gram = self._product(term, term) / self.kappa - explained.T @ explained
        score = self.columns(term).score / self.kappa - explained.T @ solved
        return np.asarray(gram, np.float64), np.asarray(score, np.float64)

    def condition(self, terms: Sequence[Term]) -> None:
        """Fit terms, and take the candidates' statistics given them.

        The square of a coefficient, where a term has it, is subtracted from the residual.
        """
        self._set_residual(self._residual)
        self._fit(terms)
        for k, term in enumerate(terms):
            if term.group.name in self.sums.candidates.curved:
                self._set_residual(self.sums.residual - self._square(k))
                self._fit(terms)

    def _square(self, k: int) -> Singles:
        """Whitened rows of the squared part of a term of one coefficient, given all others."""
        sums, term = self.sums, self.terms[k]
        raw = sums.candidates.curved[term.group.name] * float(term.group.transform[0, 0]) ** 2
        z: Singles = np.zeros(2 * sums.n, np.float32)
        for a, (_, values) in self.columns(term).rows.items():
            z[sums.rows_of(a)] = values[:, 0]
        c = sums.whitened(raw)[:, 0]
        of_z, of_c = sums.invert(z), sums.invert(c)
        residual = self.inverse_residual + of_z * float(self.theta[self.offsets[k + 1]])
        zr, cr, zz, zc, cc = (
            float(x @ y) for x, y in ((z, residual), (c, residual), (z, of_z), (z, of_c), (c, of_c))
        )
        # of z t + c t^2; zero where z alone fits better
        misfit = np.polynomial.Polynomial([0.0, -2 * zr, zz - 2 * cr, 2 * zc, cc])
        turns = misfit.trim().deriv().roots()
        best = min(turns[np.isreal(turns)].real, key=misfit)
        if misfit(best) > -(zr**2) / zz:
            best = 0.0
        return np.asarray(c * best**2, np.float32)

    def _fit(self, terms: Sequence[Term]) -> None:
        sums = self.sums
        self.terms = list(terms)
        self._remainders: dict[str, Floats] = {}  # by part
        every = [self.base, *terms]
        gram, score, precision = self.system(terms)
        self.hessian = gram + precision
        self.theta: Floats = np.asarray(np.linalg.solve(self.hessian, score), np.float64)
        columns = [self.columns(x) for x in every]
        self.offsets = np.cumsum([0] + [x.width for x in columns])
        inverse = np.linalg.inv(self.hessian)
        fitted = np.zeros(2 * sums.n, np.float32)
        crossed = [x.with_candidates() for x in columns]
        self.by_aircraft, explained = [], []
        for a in range(sums.A):
            span = sums.rows_of(a)
            active = [k for k, x in enumerate(columns) if a in x.rows]
            at = np.concatenate([self.offsets[k] + columns[k].rows[a][0] for k in active])
            rows = np.concatenate([columns[k].rows[a][1] for k in active], axis=1)
            fitted[span] = rows @ self.theta[at].astype(np.float32)
            rows = np.concatenate([columns[k].inverse[a] for k in active], axis=1)
            acting = AircraftTerms(rows, np.linalg.cholesky(inverse[np.ix_(at, at)]).T)
            self.by_aircraft.append(acting)
            explained.append(acting.root @ np.concatenate([crossed[k][1][a] for k in active]))
        self.inverse_residual = sums.inverse_residual - sums.invert(fitted)
        self.day_score = sums.scores(self.inverse_residual)
        most = max(x.shape[0] for x in explained)
        self.explained = np.stack([np.pad(x, ((0, most - len(x)), (0, 0))) for x in explained])
        cross = np.concatenate([of_all for of_all, _ in crossed])
        self.fleet_explained = np.linalg.solve(np.linalg.cholesky(self.hessian), cross)
        self.release(terms)

    def release(self, terms: Sequence[Term]) -> None:
        """Free the memory of columns other than those of the terms."""
        keys = {term.key for term in (self.base, *terms)}
        self._columns = {key: value for key, value in self._columns.items() if key in keys}
        self._products = {pair: gram for pair, gram in self._products.items() if set(pair) <= keys}

    # ------------------------------------------------------------------------------ one candidate
    def statistics(self, group: Group) -> Statistics:
        """Scores and information of a candidate, with its noise factors."""
        by_day, fleet_by_day = self.sums.information(group)
        t = group.transform
        explained = self.explained[:, :, group.columns] @ t
        information = by_day.sum(axis=1) - np.einsum("aim,ain->amn", explained, explained)
        of_fleet = self.fleet_explained[:, group.columns] @ t
        fleet_information = fleet_by_day.sum(axis=0) - of_fleet.T @ of_fleet
        day_score = self.day_score[:, :, group.columns] @ t
        given = information, fleet_information
        stats = _with_factors(day_score, by_day, fleet_by_day, *given, WIDE)
        usual, _ = self.usual.get(group.quantity, (0.0, 0.0))
        lasting, remainder = self.lasting(group), self._remainder(group)
        return replace(stats, usual=usual, lasting=lasting, remainder=remainder)

    def lasting(self, group: Group) -> float:
        """L^2 of a candidate: the usual variance in this archive, at least `LASTING`, m2 s-2."""
        least = LASTING["wind" if group.quantity == "wind" else "aircraft"] ** 2
        return max(least, self.usual.get(group.quantity, (0.0, 0.0))[1])

    def _remainder(self, group: Group) -> Floats:
        """Variance that inexact columns of terms leave, by aircraft, m2 s-2.

        With q the squared correlation of a column with the true one, (1 / q - 1) and the square of
        `FIRST_ORDER` times the mean square of the effect over the aircraft's reports; half of it in
        candidates of another part, for headings lie at all angles to the wind.
        """
        if group.quantity not in self._remainders:
            out = np.zeros(self.sums.A)
            for k, term in enumerate(self.terms):
                missing = FIRST_ORDER**2 + 1 / term.group.reliability - 1
                missing *= 1.0 if term.group.quantity == group.quantity else 0.5
                theta = self.theta[self.offsets[k + 1] : self.offsets[k + 2]]
                theta = theta.reshape(-1, term.group.size)
                for j, a in enumerate(term.tails):
                    acting = np.abs(self.columns(term).rows[a][1]).sum(axis=1)
                    if not acting.size:  # the aircraft has no reports
                        continue
                    share = float((acting > 1e-3 * acting.max(initial=1e-12)).mean())
                    square = float((theta[0 if term.scope == "f" else j] ** 2).mean())
                    out[a] += missing * square * share
            self._remainders[group.quantity] = out
        return self._remainders[group.quantity]


def noise_factor(score: Floats, by_day: Floats) -> Statistics:
    """Statistics of a scalar regression: scores (A, D, m) and information (A, D, m, m) by day."""
    fleet = by_day.sum(axis=0)
    return _with_factors(score, by_day, fleet, by_day.sum(axis=1), fleet.sum(axis=0), 1.0)


def _with_factors(
    score: Floats,
    by_day: Floats,
    fleet_by_day: Floats,
    information: Floats,
    fleet_information: Floats,
    width: float,
) -> Statistics:
    """Statistics of scores by day and information given the terms, with noise factors."""
    # the fit of each aircraft, of prior standard deviation ``width``, is no scatter of its days
    total, m = by_day.sum(axis=1), score.shape[-1]
    ridge = 1e-7 * np.trace(total.sum(axis=0)) / m * np.eye(m) + 1e-12 * np.eye(m)
    summed = score.sum(axis=1)
    fit = np.linalg.solve(information + np.eye(m) / width**2, summed[..., None])[..., 0]
    back = np.einsum("amn,an->am", np.linalg.solve(total + ridge, information), fit)
    residual = score - np.einsum("adij,aj->adi", by_day, back)
    inverse = np.asarray(np.linalg.inv(information + ridge), np.float64)
    fleet_inverse = np.asarray(np.linalg.inv(fleet_information + ridge), np.float64)
    factor = np.maximum(*(cluster_factor(residual, by_day, inverse, ridge, n) for n in BLOCKS))
    together = residual.sum(axis=0)[None]
    fleet_factor = max(
        float(cluster_factor(together, fleet_by_day[None], fleet_inverse[None], ridge, n)[0])
        for n in BLOCKS
    )
    given = information, fleet_information, ridge, fleet_inverse
    return Statistics(summed, *given, factor, fleet_factor)


#: Largest prior scale, m/s: a compass error of 5 degrees and an airspeed of 130 m/s give 8 m/s rms.
WIDE = 8.1
#: Days in a cluster; the larger scatter counts: errors that last for days show in blocks of four.
BLOCKS = (1, 4)


def cluster_factor(
    score: Floats, by_day: Floats, inverse: Floats, ridge: Floats, block: int
) -> Floats:
    """Scatter of scores of blocks of days relative to that of independent errors, by aircraft.

    ``score`` (A, D, m) is the residual of the fit of the aircraft, ``by_day`` the information by
    day, ``inverse`` (A, m, m) the inverse of the information given the terms. With the fit taking a
    part of every block's score the factor is sum_d s_d' G^-1 s_d / (m - tr sum_d (G^-1 G_d)^2);
    that of an aircraft without reports is not a number.
    """
    cuts = np.arange(0, score.shape[1], block)
    score = np.add.reduceat(score, cuts, axis=1)
    by_day = np.add.reduceat(by_day, cuts, axis=1)
    total = by_day.sum(axis=1)
    turned = np.linalg.solve(total + ridge, by_day.swapaxes(0, 1)).swapaxes(0, 1)
    product = inverse @ total
    taken = ((product[:, None] @ turned) * turned.swapaxes(-1, -2)).sum(axis=(1, 2, 3))
    free = np.trace(product, axis1=1, axis2=2)
    squared = ((score @ inverse) * score).sum(axis=(1, 2))
    factor = squared / np.maximum(free - taken, 0.2 * free + 1e-12)
    return np.asarray(np.where(np.trace(total, axis1=1, axis2=2) > 0, factor, np.nan))
