"""Pairs of variables of which an error may be a function: a screen of all pairs by their scores.

For functions f and g of two variables and the unit change e of a component, the score of their
product in a period is the sum of f g e' V^-1 r over its reports. With all functions of all
variables these are products of two matrices, so that every pair costs little; the most likely pairs
become tables whose evidence is computed like that of all others.
"""

from __future__ import annotations

import itertools

import numpy as np

from airswing.gap.arrays import Floats
from airswing.gap.model.candidates import COMPONENTS, Group, Table
from airswing.gap.model.evidence import share_of_aircraft
from airswing.gap.model.sums import GATE
from airswing.gap.model.terms import Model
from airswing.gap.noise import scaled, weighted_scores

#: Knots of each variable in tables that enter the contest, and in final ones.
COARSE, FINE = 4, 7
#: Pairs that become tables: as many, of 16 to 25 columns, as `sums.SPARE` columns hold.
PAIRS = 20


def add_pairs(model: Model) -> list[Group]:
    """Add tables of the most likely pairs, given the terms in the model, to the candidates."""
    candidates = model.sums.candidates
    if not candidates.tables:
        return []
    out = []
    for evidence, *names, component in _ranked(model)[:PAIRS]:
        curves = tuple(candidates.pair_curve(name, COARSE) for name in names)
        table = Table(curves, component)
        prior = candidates.log_prior(table)
        if evidence + prior < GATE:
            break
        group = candidates.add_table(table, prior, refined=True)
        if group is not None:
            out.append(group)
    if out:
        model.sums.extend()
        model.condition(model.terms)
    return out


def _ranked(model: Model) -> list[tuple[float, str, str, str]]:
    """Pairs with a component, and their approximate log evidence, largest first."""
    functions = model.sums.candidates.contrasts
    constant = np.ones((model.sums.n, 1))
    stops = 1 + np.cumsum([f.shape[1] for f in functions.values()])
    columns = {
        name: slice(stop - f.shape[1], stop)
        for (name, f), stop in zip(functions.items(), stops, strict=True)
    }
    evidence = _evidence(model, np.concatenate([constant, *functions.values()], axis=1))
    # the variable that has the larger effect alone is the first of a pair
    alone = {name: evidence[:, 0, 0, at].sum() for name, at in columns.items()}
    ordered = sorted(functions, key=lambda name: -alone[name])
    out = []
    for first, second in itertools.combinations(ordered, 2):
        block = evidence[:, :, columns[first], columns[second]]  # (components, aircraft + 1)
        total = (block - 1.0).sum(axis=(2, 3))  # less one a coefficient (Akaike 1974)
        for component, (of_fleet, *gain) in zip(COMPONENTS, total.tolist(), strict=True):
            of_some, _ = share_of_aircraft(np.array(gain))
            out.append((max(of_fleet, of_some), first, second, component))
    return sorted(out, reverse=True)


def _evidence(model: Model, functions: Floats) -> Floats:
    """Log evidence of products of functions (n, k), (components, aircraft + 1, k, k).

    The first is that of all aircraft together. With scores s_t of T periods that scatter about
    their share of the sum, it is that of a Gaussian mean with unknown variance.
    """
    sums, candidates = model.sums, model.sums.candidates
    score = report_scores(model)
    units = (candidates.unit_change(component) for component in COMPONENTS)
    scores = np.stack([(score * unit).sum(axis=1)[sums.order] for unit in units])
    functions = functions[sums.order]
    k = functions.shape[1]
    fleet = np.zeros((sums.T, len(COMPONENTS), k, k))
    count = np.zeros((sums.A, sums.T))
    out = np.zeros((len(COMPONENTS), sums.A + 1, k, k))
    for a, cells in itertools.groupby(sums.cells, key=lambda cell: cell[0]):
        by_period = np.zeros_like(fleet)
        for _, d, span in cells:
            rows = slice(span.start // 2, span.stop // 2)
            f, t = functions[rows], sums.stretch[d]
            count[a, t] += len(f)
            for c, s in enumerate(scores[:, rows]):
                by_period[t, c] += (f * s[:, None]).T @ f
        fleet += by_period
        out[:, a + 1] = _mean_evidence(by_period, count[a])
    out[:, 0] = _mean_evidence(fleet, count.sum(axis=0))
    return out


def report_scores(model: Model) -> Floats:
    """V^-1 (r - X_S theta_S) of every report, (n, 2) s m-1, given the terms in the model."""
    sums = model.sums
    white: Floats = np.empty((sums.n, 2))
    white[sums.order] = model.inverse_residual.reshape(sums.n, 2)
    score, _ = weighted_scores(white, sums.noise.order, sums.noise.gains)
    return np.asarray(scaled(score, sums.noise.gains.direction))


def _mean_evidence(scores: Floats, count: Floats) -> Floats:
    """Log evidence of sums of scores (T, ...) of periods with numbers of reports (T,)."""
    flown = count > 0
    number = int(flown.sum())
    if number < 3:
        return np.zeros(scores.shape[1:])
    share = (count[flown] / count.sum()).reshape(-1, *[1] * (scores.ndim - 1))
    total = scores.sum(axis=0)
    scatter = ((scores[flown] - share * total) ** 2).sum(axis=0) * number / (number - 1)
    ratio = total**2 / np.maximum(scatter, 1e-30)
    return np.asarray(0.5 * number * np.log1p(ratio / (number - 1)))
