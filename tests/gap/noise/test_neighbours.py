"""A report's error beyond what its flight foretells is that of the inverse covariance."""

from dataclasses import replace

import numpy as np

from airswing.gap.noise.neighbours import (
    even_interpolation_errors,
    evened,
    interpolation_errors,
)
from airswing.gap.noise.whitening import Evened, flight_order, kalman_gains


def _flights(keep):
    rng = np.random.default_rng(4)
    flight = np.repeat([3, 1, 2], [5, 7, 1])
    step = np.where(np.r_[True, flight[1:] != flight[:-1]], np.inf, rng.uniform(5, 60, 13))
    order = flight_order(flight, np.arange(13.0))
    level = rng.uniform(0.8, 1.3, 13)
    gains = kalman_gains(order, np.exp(-step / 90), level, keep, correlated_sd=2.1, white_sd=0.5)
    far = np.cumsum(np.where(np.isfinite(step), step, 0.0))
    gap = np.abs(far[:, None] - far)
    alike = flight[:, None] == flight
    signal = np.where(alike, 2.1**2 * np.exp(-gap / 90), 0.0)
    covariance = (signal + 0.25 * np.eye(13)) * level[:, None] * level
    return order, gains, covariance, rng.normal(size=(13, 2))


def test_errors_are_those_of_the_inverse_covariance():
    order, gains, covariance, values = _flights(np.ones(13, bool))
    errors, precision = interpolation_errors(values, order, gains)
    inverse = np.linalg.inv(covariance)
    np.testing.assert_allclose(precision, inverse.diagonal(), rtol=1e-10)
    np.testing.assert_allclose(errors, inverse @ values / inverse.diagonal()[:, None], atol=1e-10)


def test_a_masked_report_is_as_if_it_were_not_there():
    keep = np.ones(13, bool)
    keep[[2, 8]] = False
    order, gains, covariance, values = _flights(keep)
    errors, precision = interpolation_errors(values, order, gains)
    inverse = np.linalg.inv(covariance[np.ix_(keep, keep)])
    np.testing.assert_allclose(precision[keep], inverse.diagonal(), rtol=1e-10)
    np.testing.assert_allclose(
        errors[keep], inverse @ values[keep] / inverse.diagonal()[:, None], atol=1e-10
    )
    assert not errors[~keep].any() and not precision[~keep].any()


def test_errors_larger_across_the_heading_are_those_of_the_whole_covariance():
    order, alike, covariance, values = _flights(np.ones(13, bool))
    heading = np.random.default_rng(6).uniform(0, 2 * np.pi, 13)
    uneven = Evened(np.stack([np.sin(heading), np.cos(heading)]), 0.7, 1.2)
    gains = replace(alike, evened=uneven.inverse)
    told, _ = interpolation_errors(np.concatenate([values, 2 * values], axis=1), order, gains)
    # every report's 2 x 2 block of the inverse of the covariance of both components
    root = np.zeros((13, 2, 13, 2))
    for i in range(13):
        root[i, :, i] = uneven.take([i]).of(np.eye(2)[:, :, None])[..., 0]
    root = root.reshape(26, 26)
    inverse = np.linalg.inv(root @ np.kron(covariance, np.eye(2)) @ root)
    pulled = (inverse @ values.ravel()).reshape(13, 2)
    blocks = [inverse[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(13)]
    expected = np.stack([np.linalg.solve(b, p) for b, p in zip(blocks, pulled, strict=True)])
    np.testing.assert_allclose(told, np.concatenate([expected, 2 * expected], axis=1), atol=1e-10)
    errors, precision = even_interpolation_errors(values, order, gains)
    np.testing.assert_allclose(evened(errors * precision[:, None], gains), pulled, atol=1e-10)
