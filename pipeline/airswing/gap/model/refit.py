"""Coefficients fitted exactly (docs/gap.md, end of section 5).

Effects are evaluated at the reports, with columns free of the reports' noise as instruments (Durbin
1954). Coefficients without a group of days follow by one more step of Newton's method. The prior of
a term of several aircraft is theta_a ~ N(mu, tau^2), mu ~ N(0, s^2), with the most likely s and
tau.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats, Integers, Singles
from airswing.gap.model.terms import Columns, Model
from airswing.physics.triangle import wind_from_triangle

#: Groups of days, and days in a block: weather lasts for two days.
FOLDS, BLOCK = 5, 2


def fold_of_day(days: int) -> Integers:
    """Group of each day, (D,); single days in turn where there are few."""
    if days < FOLDS * BLOCK:
        return np.asarray(np.arange(days) % min(FOLDS, days))
    return np.asarray((np.arange(days) // BLOCK) % FOLDS)


class Response:
    """Changes of every report by terms, at the heading, airspeed and wind that were reported.

    ``sensor`` marks the terms of the model that act on the indicated heading or airspeed.
    """

    def __init__(self, frame: Frame, model: Model, sensor: Sequence[bool]) -> None:
        self.frame, self.model, self.sensor = frame, model, tuple(sensor)
        candidates = model.sums.candidates
        groups = [term.group for term in (model.base, *model.terms)]
        self.reported = [candidates.raw(group.columns, frame) for group in groups]
        self.raw = list(self.reported)
        self.averaged: set[int] = set()  # terms subtracted at the large-scale wind
        self.curved = [candidates.curvature(term.group.name, frame) for term in model.terms]

    def without_noise(self, k: int) -> None:
        """Fit the k-th term by its columns without the reports' noise."""
        candidates = self.model.sums.candidates
        self.raw[k + 1] = candidates.raw(self.model.terms[k].group.columns)

    def linear(self, k: int, theta: Floats, raw: Singles | None = None) -> Floats:
        """Change of the wind by the k-th term, (n, 2) m/s; to first order of a sensor's error.

        ``theta`` are the coefficients of the whole model; with a row for each group of days, each
        report is changed by the coefficients of its group. ``raw`` are columns (n, 2, k) in place
        of those that the term is fitted by.
        """
        columns = self.raw[k + 1] if raw is None else raw
        of_report = of_reports(self.model, k, theta)
        effect = np.einsum("nck,nk->nc", columns, of_report)
        curved = self.curved[k]
        if curved is not None:
            effect = effect + np.einsum("nck,nk->nc", curved, of_report**2)
        return np.asarray(effect)

    def derivative(self, k: int, theta: Floats) -> Singles:
        """Columns of a term at its coefficients, (n, 2, k)."""
        curved = self.curved[k]
        if curved is None:
            return self.raw[k + 1]
        return np.asarray(self.raw[k + 1] + 2 * curved * of_reports(self.model, k, theta)[:, None])

    def combined(self, effects: Sequence[Floats], numbers: Sequence[int]) -> Floats:
        """Change by several terms, given the first-order change by each, (n, 2) m/s."""
        nothing = np.zeros((self.frame.size, 2))
        linear = sum((effects[k] for k in numbers if not self.sensor[k]), nothing)
        errors = sum((effects[k] for k in numbers if self.sensor[k]), nothing)
        corrected, _, _ = without_errors(self.frame, errors)
        return np.asarray(linear + self.frame.residual - corrected.residual)


def of_reports(model: Model, k: int, theta: Floats) -> Floats:
    """Coefficients (n, k) of the k-th term's raw columns at each report; `Response.linear`."""
    sums, term = model.sums, model.terms[k]
    block = np.atleast_2d(theta)[:, model.offsets[k + 1] : model.offsets[k + 2]]
    coefficients = np.zeros((block.shape[0], sums.A, term.group.size))
    coefficients[:, list(term.tails)] = block.reshape(block.shape[0], -1, term.group.size)
    by_aircraft = coefficients @ term.group.transform.T
    fold = fold_of_day(sums.D)[sums.day] if block.shape[0] > 1 else np.zeros(sums.n, np.int64)
    of_report = by_aircraft[fold, sums.aircraft]
    if term.period:
        nothing = (sums.D, sums.D)
        first, stop = np.array([term.period.get(a, nothing) for a in range(sums.A)]).T
        late = (sums.day >= first[sums.aircraft]) & (sums.day < stop[sums.aircraft])
        of_report[~late] = 0.0
    return np.asarray(of_report)


def without_errors(frame: Frame, effect: Floats) -> tuple[Frame, Floats, Floats]:
    """Remove a sensor effect (n, 2) exactly: corrected frame, turn (rad), airspeed error (m/s)."""
    sine, cosine = np.sin(frame.heading), np.cos(frame.heading)
    turn = -(effect[:, 0] * cosine - effect[:, 1] * sine) / np.maximum(frame.airspeed, 1.0)
    faster = -(effect[:, 0] * sine + effect[:, 1] * cosine)
    heading, airspeed = frame.heading - turn, frame.airspeed - faster
    u, v = wind_from_triangle(frame.ground_u, frame.ground_v, airspeed, heading)
    before = wind_from_triangle(frame.ground_u, frame.ground_v, frame.airspeed, frame.heading)
    corrected = replace(
        frame,
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(frame.magnetic_heading - turn, 2 * np.pi),
        airspeed=airspeed,
        u_rep=frame.u_rep + u - before[0],
        v_rep=frame.v_rep + v - before[1],
    )
    return corrected, turn, faster


@dataclass(frozen=True)
class Refit:
    """Coefficients of all terms after the exact fit."""

    theta: Floats  # (m,): in the order of `Model.offsets`
    covariance: Floats  # (m, m)
    by_fold: Floats  # (FOLDS, m): fitted without each group of days
    instrumented: tuple[bool, ...]  # terms whose columns differ from their instruments
    response: Response


def refit(frame: Frame, model: Model, sensor: Sequence[bool]) -> Refit:
    """Fit the coefficients of all terms exactly; arguments of `Response`."""
    sums = model.sums
    every = [model.base, *model.terms]
    instruments = [model.columns(term) for term in every]
    response = Response(frame, model, sensor)
    exact = [
        Columns(sums, term, sums.whitened(raw))
        for term, raw in zip(every, response.raw, strict=True)
    ]
    precision = model.kappa * _precision(model)
    fold = fold_of_day(sums.D)
    of_row, folds = fold[sums.day_of_row], int(fold.max()) + 1

    def products() -> Floats:
        rows = [[z.product_by_fold(x, of_row, folds) for x in exact] for z in instruments]
        return np.concatenate([np.concatenate(row, axis=2) for row in rows], axis=1)

    def without_noise(k: int) -> None:
        response.without_noise(k)
        exact[k + 1] = instruments[k + 1]
        column = [z.product_by_fold(exact[k + 1], of_row, folds) for z in instruments]
        by_fold[:, :, blocks[k]] = np.concatenate(column, axis=1)

    by_fold = products()
    gram = np.block([[z.product(y) for y in instruments] for z in instruments])
    blocks = [slice(int(i), int(j)) for i, j in itertools.pairwise(model.offsets[1:])]
    for k, block in enumerate(blocks):
        cross = by_fold[:, block, block].sum(axis=0)
        if _weak_direction(gram[block, block], cross, precision[block, block]) is not None:
            without_noise(k)
    # functions of the reported and of the reference wind, or curves of one heading, may cancel
    while (weak := _weak_direction(gram, by_fold.sum(axis=0), precision)) is not None:
        size = [float(weak[block] @ gram[block, block] @ weak[block]) for block in blocks]
        noisy = [k for k in range(len(blocks)) if exact[k + 1] is not instruments[k + 1]]
        if not noisy:
            break
        k = max(noisy, key=lambda k: size[k])
        without_noise(k)
        response.reported[k + 1] = response.raw[k + 1]
    curved = [k for k in range(len(model.terms)) if response.curved[k] is not None]
    theta = np.array(model.theta)
    steps = 8
    for step in range(steps + 1):
        for k in curved:
            raw = sums.whitened(response.derivative(k, theta))
            exact[k + 1] = instruments[k + 1] = Columns(sums, model.terms[k], raw)
        by_fold = products() if curved else by_fold
        normal = by_fold.sum(axis=0) + precision
        linear = [response.linear(k, theta) for k in range(len(model.terms))]
        residual = frame.residual - response.combined(linear, range(len(model.terms)))
        base = model.base.group
        residual = residual - response.raw[0] @ (base.transform @ theta[: base.size])
        inverse = sums.invert(sums.whitened(residual[:, :, None])[:, 0])
        scores = np.zeros((folds, theta.size))
        for start, columns in zip(model.offsets, instruments, strict=False):
            for a, (at, values) in columns.rows.items():
                span = sums.rows_of(a)
                for j in range(folds):
                    in_fold = of_row[span] == j
                    scores[j, start + at] += values[in_fold].T @ inverse[span][in_fold]
        if step == steps:
            break
        move = np.linalg.solve(normal, scores.sum(axis=0) - precision @ theta)
        theta = theta + move
        if np.abs(move).max(initial=0.0) < 1e-3:  # m/s
            break
    inner = np.linalg.inv(normal)
    gram = np.block([[z.product(y) for y in instruments] for z in instruments])
    covariance = model.kappa * inner @ (gram + precision) @ inner.T
    without = theta - np.linalg.solve(normal - by_fold, scores[..., None])[..., 0]
    differs = [
        any(not np.array_equal(z.rows[a][1], x.rows[a][1]) for a in z.rows)
        for z, x in zip(instruments[1:], exact[1:], strict=True)
    ]
    fit = _with_levels(Refit(theta, covariance, without, tuple(differs), response), model)
    _choose_columns(fit, model)
    return fit


def _choose_columns(fit: Refit, model: Model) -> None:
    """Subtract tables of the wind at the large-scale wind where that leaves less disagreement.

    The reported wind has noise, and the error itself where that is large. The physics of a name
    says at which wind it acts.
    """
    response, frame = fit.response, fit.response.frame
    every = range(len(model.terms))
    linear = [response.linear(k, fit.by_fold, response.reported[k + 1]) for k in every]
    residual = frame.residual - response.combined(linear, every)
    for k in every:
        if not (response.sensor[k] or model.terms[k].group.named):
            raw = model.sums.candidates.raw(model.terms[k].group.columns)
            other = residual + linear[k] - response.linear(k, fit.by_fold, raw)
            if np.hypot(*other.T).mean() < np.hypot(*residual.T).mean():
                response.reported[k + 1], residual = raw, other
                response.averaged.add(k)


def _with_levels(fit: Refit, model: Model) -> Refit:
    """Fit with the likely levels of curves of the wind on all aircraft (docs/gap.md, section 5).

    Lasting errors of the reference explain a constant as well. The median over the reports is
    zero (an error of a part of the range) or, equally likely, of the size of the curve.
    """
    theta, covariance, by_fold = fit.theta.copy(), fit.covariance.copy(), fit.by_fold.copy()
    for k, term in enumerate(model.terms):
        group = term.group
        if group.kind != "table" or group.quantity != "wind" or term.scope != "f":
            continue
        block = slice(int(model.offsets[k + 1]), int(model.offsets[k + 2]))
        constant = model.sums.candidates.constant(group)
        columns = fit.response.reported[k + 1] @ group.transform
        unit = columns @ constant
        squared = (unit**2).sum(axis=1)
        known = squared > 0.0
        values = np.einsum("nck,nc->nk", columns[known], unit[known] / squared[known, None])
        level = float(np.median(values @ theta[block]))
        levels = np.median(values @ by_fold[:, block].T, axis=0)
        mean = values.mean(axis=0)
        stated = float(mean @ covariance[block, block] @ mean)
        # by the jackknife, errors of the reference that last for days included
        scatter = (len(levels) - 1) * float(levels.var())
        variance = max(stated, scatter) + model.lasting(group) / squared[known].mean()
        wide = variance + term.scale**2 / squared[known].mean()
        odds = np.sqrt(variance / wide) * np.exp(0.5 * level**2 * (1 / variance - 1 / wide))
        absent = float(1 / (1 + odds))
        theta[block] -= absent * level * constant
        by_fold[:, block] -= absent * levels[:, None] * constant
        doubt = variance - stated + absent * (1 - absent) * level**2
        covariance[block, block] += doubt * np.outer(constant, constant)
    return replace(fit, theta=theta, covariance=covariance, by_fold=by_fold)


def _weak_direction(gram: Floats, cross: Floats, prior: Floats) -> Floats | None:
    """Coefficients for which columns share less than half with their instruments; None for none.

    ``gram`` are the products of the instruments, ``cross`` those with the columns. Functions of
    the reported wind are weak: they are fitted by columns averaged over likely winds (Berkson's
    case, unbiased).
    """
    inner = np.linalg.inv(np.linalg.cholesky(gram + prior))
    shared = inner @ (cross + prior) @ inner.T
    values, vectors = np.linalg.eigh((shared + shared.T) / 2)
    return np.asarray(inner.T @ vectors[:, 0]) if values[0] < 0.5 else None


def _precision(model: Model) -> Floats:
    """Prior precision P of all coefficients, with the most likely s and tau of each term."""
    gram, score, precision = model.system(model.terms)
    gram, score = gram / model.kappa, score / model.kappa
    for k, term in enumerate(model.terms):
        block = slice(int(model.offsets[k + 1]), int(model.offsets[k + 2]))
        # tau from that of independent aircraft (s) to one size of all in steps of two; multiples of
        # the s of the search, whose grid has steps of three
        several = term.scope == "a" and len(term.tails) > 1
        if term.group.kind == "table" and term.shape is None:
            # standard normal coefficients plus a level of the same variance: that of a fine curve,
            # whose coefficients are nearly independent, would be close to zero
            constant = model.sums.candidates.constant(term.group)
            shrunk = np.outer(constant, constant) / (1.0 + constant @ constant)
            term = replace(term, shape=np.eye(constant.size) - shrunk)
        options = [
            replace(term, scale=term.scale * factor, spread=2.0**-j).precision
            for factor in (0.5, 1.0, 2.0, 4.0)
            for j in range(7 if several else 1)
        ]
        evidences = []
        for option in options:
            precision[block, block] = option
            solved = np.linalg.solve(gram + precision, score)
            log_det = np.linalg.slogdet(gram + precision)[1]
            evidences.append(score @ solved - log_det + np.linalg.slogdet(option)[1])
        precision[block, block] = options[int(np.argmax(evidences))]
    return np.asarray(precision)
