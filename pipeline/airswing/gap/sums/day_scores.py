"""Scores by day given what is included: what each day adds to the score of a column.

Assumptions: of included columns Y with coefficients beta, fitted over the archive with precisions
P, and of columns X, day d adds

    s_d = (X_d - Y_d g)'(r_d - Y_d beta),   g = (Y'Y + P)^-1 Y'X,

with the day fields eliminated; what P pulls at beta is shared out over the days. Summed they are
the scores of :mod:`airswing.gap.sums.elimination`. What is included is taken off as it is on that
day: a declination acts more on days flown far from where it is right, and taken off as if its share
of a column were the same every day it would leave scatter that is no error's.

Validity: exact for columns of the core. Of dictionary columns, whose products are summed by week,
the sums of a week are exact, and what the included ones explain beyond their share of the column is
the same on every day of it.

Source: scores beyond what else is fitted (van der Vaart 1998, Asymptotic Statistics, section 25.4).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.elimination import Conditional, included_by_fold

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def day_scores(given: Conditional, columns: Integers) -> Floats:
    """Scores of each aircraft's own columns by day.

    Parameters
    ----------
    columns : (k,) int

    Returns
    -------
    (A, D, k) float
        Summed over days ``given.score`` of these columns.
    """
    share = given.fit.covariance @ np.stack([row[:, columns] for row in given.rows], axis=1)
    left = residual_scores(given, columns)
    out = _beyond_included(given, columns, left, given.base.score[..., columns], share)
    if given.beside is None:
        return out
    beside = day_scores(replace(given, beside=None), given.beside.columns)
    return np.asarray(out - beside @ given.beside.own[..., columns])


def fleet_day_scores(given: Conditional, columns: Integers) -> Floats:
    """Scores of the fleet's columns by day.

    Parameters
    ----------
    columns : (k,) int

    Returns
    -------
    (D, k) float
        Summed over days ``given.fleet_score`` of these columns.
    """
    share = given.fit.covariance @ given.fleet_rows[:, columns]
    left, whole = (
        each.sum(axis=0)[None]
        for each in (residual_scores(given, columns), given.base.score[..., columns])
    )
    out = _beyond_included(given, columns, left, whole, share[None])[0]
    if given.beside is None:
        return np.asarray(out)
    beside = fleet_day_scores(replace(given, beside=None), given.beside.columns)
    return np.asarray(out - beside @ given.beside.fleet[:, columns])


def _beyond_included(
    given: Conditional, columns: Integers, left: Floats, whole: Floats, share: Floats
) -> Floats:
    """Scores (A, D, k), or (1, D, k) of the fleet, less the included columns' share of them.

    Parameters
    ----------
    left, whole : as returned
        Scores of the residual with the included columns taken off, and as it is.
    share : (A, m, k) or (1, m, k) float
        g, the included columns' coefficients in each.
    """
    out = np.asarray(left - _included_scores(given) @ share)
    outside = columns >= given.base.stats.layout.core
    if outside.any():
        plain = whole[..., outside] - given.fit.score @ share[..., outside]
        out[..., outside] = _by_week(given, plain, out[..., outside])
    return out


def _by_week(given: Conditional, plain: Floats, exact: Floats) -> Floats:
    """Scores (..., D, k) of dictionary columns: those of a week are known, and shared out.

    Parameters
    ----------
    plain : (A, D, k) float, or (1, D, k) of the fleet
        Of the residual with nothing taken off, beyond the included columns: by day, but with what
        those explain in it.
    exact : as ``plain``
        With it taken off, as if it were alike on every day of a week.
    """
    stats = given.base.stats
    count = stats.day_count if len(plain) > 1 else stats.day_count.sum(axis=0)[None]
    own = (stats.week_of_day[:, None] == np.arange(stats.weeks.size)).astype(float)
    total = (count @ own)[:, stats.week_of_day]
    share = np.divide(count, total, out=np.zeros_like(total), where=total > 0)
    more = own.T @ (exact - plain)
    return np.asarray(plain + share[..., None] * more[:, stats.week_of_day])


def residual_scores(given: Conditional, columns: Integers) -> Floats:
    """Scores of each aircraft's columns by day with the included ones taken off.

    Parameters
    ----------
    columns : (k,) int

    Returns
    -------
    (A, D, k) float
    """
    core = given.base.stats.layout.core
    inside = columns < core
    every = range(len(given.base.stats.tails))
    out = np.empty((*given.base.stats.day_count.shape, columns.size))
    for a in every:
        out[a][:, inside] = core_residual_scores(given, a)[:, columns[inside]]
    if not inside.all():
        out[..., ~inside] = _of_dictionary(given)[..., columns[~inside] - core]
    return out


def core_residual_scores(given: Conditional, aircraft: int) -> Floats:
    """Those of one aircraft's core columns, (D, c); computed once."""
    made, core = given.derived, slice(0, given.base.stats.layout.core)
    if (name := f"remains {aircraft}") not in made:
        cross = given.base.cross[aircraft][:, :, core]
        left = _taken_off(given, aircraft, core)
        made[name] = left - np.matmul(_shared(given)[:, None], cross)[:, 0]
    return made[name]


def _of_dictionary(given: Conditional) -> Floats:
    """Those of all columns outside the core, (A, D, p - c); computed once."""
    stats, made = given.base.stats, given.derived
    if "remains outside" not in made:
        outside = slice(stats.layout.core, stats.layout.size)
        out = np.empty((*stats.day_count.shape, outside.stop - outside.start))
        for a in range(len(out)):
            cross = given.base.cross[a][:, :, outside]
            out[a] = _taken_off(given, a, outside)
            out[a] -= np.matmul(_shared(given)[:, None], cross)[:, 0]
        made["remains outside"] = out
    return made["remains outside"]


def _fitted(given: Conditional) -> Floats:
    """Coefficient of every core column by aircraft and day, (A, D, c)."""
    made, stats = given.derived, given.base.stats
    if "fitted" not in made:
        made["fitted"] = fitted = np.zeros((*stats.day_count.shape, stats.layout.core))
        for x, value in zip(given.included, given.coefficients, strict=True):
            if x.column < stats.layout.core:
                fitted[:, :, x.column] += x.weights * value
    return made["fitted"]


def _shared(given: Conditional) -> Floats:
    """What is left of the day fields' scores, by ``root``, (D, q)."""
    if "shared" not in given.derived:
        left = _fields_taken_off(given)
        given.derived["shared"] = np.einsum("dij,dj->di", given.base.root, left)
    return given.derived["shared"]


def _fields_taken_off(given: Conditional) -> Floats:
    """Scores (D, q) of the day fields of all aircraft, as :func:`_taken_off` of one."""
    base, fitted = given.base, _fitted(given)
    stats = base.stats
    fields = stats.layout.blocks["day_fields"]
    left = stats.day_score[:, :, fields].sum(axis=0)
    for x, value in zip(given.included, given.coefficients, strict=True):
        if x.column >= stats.layout.core:
            rows = stats.week_gram[:, :, x.column, fields][:, stats.week_of_day]
            left -= np.einsum("ad,adq->dq", x.weights * stats.day_share * value, rows)
    live = np.flatnonzero(fitted.any(axis=(0, 1)))
    # the same columns are given in nearly every state of a search
    key = "fields beside", live.tobytes()
    if key not in base.blocks:
        base.blocks[key] = stats.day_gram[:, :, live, fields].astype(float)
    return np.asarray(left - np.einsum("adl,adlq->dq", fitted[:, :, live], base.blocks[key]))


def _taken_off(given: Conditional, aircraft: int, columns: slice) -> Floats:
    """Scores (D, k) of some columns of an aircraft less what the included ones explain.

    Parameters
    ----------
    columns : slice
        Of the core, or outside it.
    """
    stats, own = given.base.stats, _fitted(given)[aircraft]
    left: Floats = stats.day_score[aircraft][:, columns].copy()
    for x, value in zip(given.included, given.coefficients, strict=True):
        if x.column >= stats.layout.core and x.weights[aircraft].any():
            rows = stats.week_gram[aircraft, :, x.column, columns][stats.week_of_day]
            left -= rows * (x.weights[aircraft] * stats.day_share[aircraft] * value)[:, None]
    live = np.flatnonzero(own.any(axis=0))
    if columns.stop <= stats.layout.core:
        gram = stats.day_gram[aircraft][:, live, columns].astype(float)
        return np.asarray(left - np.matmul(own[:, None, live], gram)[:, 0])
    shared = own[:, live] * stats.day_share[aircraft][:, None]
    for w in np.unique(stats.week_of_day).tolist():
        days = stats.week_of_day == w
        left[days] -= shared[days] @ stats.week_gram[aircraft, w][live, columns]
    return left


def _included_scores(given: Conditional) -> Floats:
    """Residual scores of the included columns by day, (D, m), less their prior's part."""
    if "included" not in given.derived:
        stats = given.base.stats
        columns = np.array([x.column for x in given.included], np.int64)
        pull = np.array([x.precision for x in given.included]) * given.coefficients
        out = np.empty((stats.days.size, columns.size))
        unlike = np.unique(columns, return_inverse=True)
        left = residual_scores(given, unlike[0])
        for k, x in enumerate(given.included):
            out[:, k] = (x.weights * left[..., unlike[1][k]]).sum(axis=0)
        given.derived["included"] = out - pull / stats.days.size
    return given.derived["included"]


def fleet_day_grams(given: Conditional, columns: Integers) -> Floats:
    """X'X of the fleet's core columns by day beyond the included ones of the core.

    Columns that are projected out (:mod:`airswing.gap.sums.beyond`) are not taken off: they are
    asked of dictionary columns alone.

    Parameters
    ----------
    columns : (N, k) int
        Of N candidates.

    Returns
    -------
    (N, D, k, k) float
        Of day d (X_d - Y_d g)'(X_d - Y_d g) and its part of g'P g, as the scores have; the sum over
        days is ``given.fleet_gram`` where all that is included is of the core.
    """
    base = given.base
    each, where = np.unique(columns, return_inverse=True)
    where = where.reshape(columns.shape)
    core = np.array([x.column < base.stats.layout.core for x in given.included])
    share = (given.fit.covariance @ given.fleet_rows[:, each])[core]
    taken = _rows_by_day(given)[:, :, each].swapaxes(1, 2) @ share
    cross = base.fleet_cross[:, :, each]
    own = base.stats.fleet_day_gram[:, each[:, None], each] - cross.swapaxes(1, 2) @ cross
    own += share.T @ _included_by_day(given) @ share - taken - taken.swapaxes(1, 2)
    precision = np.array([x.precision for x in given.included])[core]
    own += (share.T * precision) @ share / len(own)
    return np.asarray(np.moveaxis(own[:, where[:, :, None], where[:, None]], 1, 0))


def _included_by_day(given: Conditional) -> Floats:
    """X'X by day among the included columns of the core, (D, m, m)."""
    if "included by day" not in given.derived:
        core = [x for x in given.included if x.column < given.base.stats.layout.core]
        every = np.arange(given.base.stats.days.size)
        given.derived["included by day"] = included_by_fold(given.base, core, every)[0]
    return given.derived["included by day"]


def _rows_by_day(given: Conditional) -> Floats:
    """X'Y by day of the included columns of the core with the fleet's, (D, m, c)."""
    base, core = given.base, given.base.stats.layout.core
    out = []
    for x in given.included:
        if x.column >= core:
            continue
        if (key := ("rows by day", *x.key)) not in base.blocks:
            active = np.flatnonzero(x.weights.any(axis=1))
            coupled = np.einsum("ad,adi->di", x.weights, base.cross[..., x.column])
            rows = base.stats.day_gram[active, :, x.column, :]
            own = np.einsum("ad,adc->dc", x.weights[active], rows)
            shared = np.einsum("di,dic->dc", coupled, base.fleet_cross[..., :core])
            base.blocks[key] = own - shared
        out.append(base.blocks[key])
    return np.stack(out, axis=1)
