"""Sums of a table's cells against dense algebra; what is smooth within cells keeps its size."""

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import plan_dictionary, unit_vectors
from airswing.gap.design.weather import day_field_columns
from airswing.gap.noise.whitening import whiten
from airswing.gap.sums.variance_components import SLOPE_SD, Variances
from airswing.gap.witness.cell_means import CellModel, reports_to_one
from airswing.gap.witness.ground import lasting_columns


@pytest.fixture(scope="module")
def some():
    """Some flights of two aircraft on three days."""
    frame = make_frame(seed=2, aircraft=2, days=3)
    return frame.take(np.isin(frame.flight, np.unique(frame.flight)[::6]))


def model_of(frame, *, of_days=0.3, lasts=0.05):
    noise, plan = noise_of(frame), plan_dictionary(frame, {})
    fields, lasting = day_field_columns(frame, plan), lasting_columns(frame, plan)
    variances = Variances(
        np.full(fields.shape[-1], of_days), np.full(lasting.shape[-1] - len(SLOPE_SD), lasts)
    )
    _, day = np.unique(frame.day, return_inverse=True)
    made = CellModel.of(frame, plan, noise=noise, variances=variances, day=day)
    return made, noise, fields, lasting, day


def test_values_are_those_of_one_mixed_model(some):
    made, noise, fields, lasting, day = model_of(some)
    cells = (some.longitude > np.median(some.longitude)).astype(int)
    cells[::7] = -1
    cross, _ = unit_vectors(some.heading)
    fold = np.array([0, 1, 1])
    sums = made.sums(cells, 2, cross, weights=made.weigh(some.residual), fold=fold)
    m = noise.model
    variance = reports_to_one(noise) * (m.correlated_sd**2 + m.white_sd**2)
    for keep in (np.array([True, True]), np.array([False, True])):
        use = keep[fold[day]] & (noise.gains.weight > 0)
        sd = np.sqrt(variance) / noise.gains.scale[use]

        def flat(columns, use=use, sd=sd):
            return (columns[use] / sd[:, None, None]).reshape(2 * use.sum(), -1)

        prior = np.sqrt(np.r_[np.full(lasting.shape[-1] - 2, 0.05), np.square(SLOPE_SD)])
        known = [flat(lasting) * prior]
        known += [flat(fields * (day == d)[:, None, None]) * np.sqrt(0.3) for d in range(3)]
        known = np.concatenate(known, axis=1)
        inverse = np.linalg.inv(np.eye(known.shape[0]) + known @ known.T)
        x = flat(np.stack([cross * (cells == k)[:, None] for k in range(2)], -1))
        gram, score = sums.of_table(keep)
        np.testing.assert_allclose(gram, x.T @ inverse @ x, rtol=1e-6)
        r = flat(some.residual[..., None])[:, 0]
        np.testing.assert_allclose(score, x.T @ inverse @ r, rtol=1e-5, atol=1e-8)
    values, left = np.array([0.7, -0.4]), r - x @ [0.7, -0.4]
    gained = r @ inverse @ r - left @ inverse @ left  # of the second fold, the last above
    assert sums.explained(values, 1) == pytest.approx(gained / sums.factor, rel=1e-5)


def test_errors_larger_across_the_heading_count_less_there(some):
    """With no day field and nothing lasting: generalised least squares of two cells."""
    noise, plan = noise_of(some), plan_dictionary(some, {})
    model = replace(noise.model, along=0.6, across=1.28)
    uneven = model.uneven(some.heading)
    noise = replace(noise, model=model, gains=replace(noise.gains, evened=uneven.inverse))
    fields, lasting = day_field_columns(some, plan), lasting_columns(some, plan)
    none = Variances(
        np.full(fields.shape[-1], 1e-12), np.full(lasting.shape[-1] - len(SLOPE_SD), 1e-12)
    )
    day = np.unique(some.day, return_inverse=True)[1]
    made = CellModel.of(some, plan, noise=noise, variances=none, day=day)
    east = np.tile([1.0, 0.0], (some.size, 1))
    cells = (some.longitude > np.median(some.longitude)).astype(int)
    sums = made.sums(cells, 2, east, weights=made.weigh(some.residual), fold=np.zeros(3, int))
    nose = np.stack([np.sin(some.heading), np.cos(some.heading)], -1)
    whole = nose[:, :, None] * nose[:, None] * (0.6**-2 - 1.28**-2) + np.eye(2) * 1.28**-2
    whole *= made.weight[:, None, None]
    gram = np.bincount(cells, whole[:, 0, 0])
    score = np.bincount(cells, (whole[:, 0] * some.residual).sum(axis=1))
    own, told = sums.gram[0, -2:, -2:], sums.score[0, -2:]
    np.testing.assert_allclose(own, np.diag(gram), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(told, score, rtol=1e-3)


def test_scores_of_reports_are_those_of_the_same_model(some):
    made, noise, fields, lasting, day = model_of(some)
    m = noise.model
    variance = reports_to_one(noise) * (m.correlated_sd**2 + m.white_sd**2)
    use = noise.gains.weight > 0
    weight = np.where(use, noise.gains.scale**2 / variance, 0.0).repeat(2)
    prior = np.sqrt(np.r_[np.full(lasting.shape[-1] - 2, 0.05), np.square(SLOPE_SD)])
    parts = [
        lasting * prior,
        *(fields * (day == d)[:, None, None] * np.sqrt(0.3) for d in range(3)),
    ]
    known = np.concatenate(parts, axis=-1).reshape(2 * some.size, -1)
    inside = np.eye(known.shape[1]) + known.T @ (weight[:, None] * known)
    r = weight * some.residual.ravel()
    expected = r - weight * (known @ np.linalg.solve(inside, known.T @ r))
    told = made.score(made.weigh(some.residual))
    np.testing.assert_allclose(told.ravel(), expected, rtol=1e-4, atol=1e-5)


def test_a_table_of_whole_days_is_least_squares_with_its_own_covariance(some):
    """Days scatter the scores instead of being fitted beside the table."""
    made, noise, fields, lasting, day = model_of(some)
    cells, (cross, _) = day // 2, unit_vectors(some.heading)
    sums = made.sums(
        cells,
        2,
        cross,
        weights=made.weigh(some.residual),
        fold=np.array([0, 1, 1]),
        whole_days=True,
    )
    m, use = noise.model, noise.gains.weight > 0
    variance = reports_to_one(noise) * (m.correlated_sd**2 + m.white_sd**2)

    def flat(columns):
        scaled = columns[use] * noise.gains.scale[use, None, None] / np.sqrt(variance)
        return scaled.reshape(2 * use.sum(), -1)

    prior = np.r_[np.full(lasting.shape[-1] - 2, 0.05), np.square(SLOPE_SD)]
    steady = flat(lasting)
    x = flat(np.stack([cross * (cells == k)[:, None] for k in range(2)], -1))
    days = [flat(fields * (day == d)[:, None, None]) * np.sqrt(0.3) for d in range(3)]
    days = np.concatenate(days, axis=1)
    both = np.concatenate([steady, x], axis=1)
    normal = both.T @ both + np.diag(np.r_[1 / prior, 0, 0])
    hat = np.linalg.solve(normal, both.T)
    r = flat(some.residual[..., None])[:, 0]
    estimate = (hat @ r)[-2:]
    known = np.concatenate([days, steady * np.sqrt(prior)], axis=1)
    spread = hat @ (np.eye(r.size) + known @ known.T) @ hat.T
    gram, score = sums.of_table(np.array([True, True]))
    np.testing.assert_allclose(np.linalg.solve(gram, score), estimate, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.inv(gram), spread[-2:, -2:], rtol=1e-4)
    assert 0 < sums.lasting_share < 1


def test_reports_to_one_is_the_mean_sum_of_correlations(some):
    noise = noise_of(some)
    total, m = 0.0, noise.model
    for flight in np.unique(some.flight):
        own = np.flatnonzero(some.flight == flight)
        own = own[np.argsort(some.time[own])]
        reach = np.cumsum(np.log(np.maximum(noise.gains.decay[own], 1e-300)))
        total += np.exp(-np.abs(np.subtract.outer(reach, reach))).sum()
    whole = m.correlated_sd**2 + m.white_sd**2
    expected = (m.correlated_sd**2 * total / some.size + m.white_sd**2) / whole
    assert reports_to_one(noise) == pytest.approx(expected, rel=1e-6)


def test_a_ramp_keeps_its_size_in_coarse_cells(some):
    """Whitened least squares sees the cells' edges alone and gives a part of it."""
    made, noise, _, _, _ = model_of(some, of_days=1e-6, lasts=1e-6)
    start = np.array([some.time[some.flight == f].min() for f in some.flight])
    ramp = (some.time - start) / (some.time - start).std() - 1.0
    cross, _ = unit_vectors(some.heading)
    cells = np.digitize(ramp, np.quantile(ramp, [0.25, 0.5, 0.75]))
    table = np.stack([cross * (cells == k)[:, None] for k in range(4)], -1)
    means = np.array([ramp[cells == k].mean() for k in range(4)])
    weights = made.weigh(ramp[:, None] * cross)
    sums = made.sums(cells, 4, cross, weights=weights, fold=np.zeros(3, int))
    gram, score = sums.of_table(np.array([True]))
    found = np.linalg.solve(gram, score)
    assert found @ means / (means @ means) == pytest.approx(1.0, abs=0.03)
    x = whiten(table, noise.order, noise.gains).reshape(-1, 4)
    r = whiten(ramp[:, None] * cross, noise.order, noise.gains).ravel()
    edges = np.linalg.lstsq(x, r, rcond=None)[0]
    assert edges @ means / (means @ means) < 0.9
