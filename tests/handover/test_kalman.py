"""The filter against its equations number by number, its limit, and the model it assumes."""

import math

import numpy as np
import pytest

from airswing.handover.forecasts.correcting import (
    kalman_bias,
    known_before,
    running_mean,
)


def by_hand(errors, ratio):
    """The equations of Delle Monache et al. (2006) for one series, with scalars and a list."""
    first = (4 + ratio) / (5 + ratio)
    x, noise, p, last = 0.0, None, None, None
    p_s, bias, wait = 1.0, [], 0
    for error in errors:
        wait += 1
        if math.isnan(error):
            if p is not None:
                p += ratio * noise
            bias.append(x)
            continue
        if last is None:
            x = first * error
        else:
            z = (error - last) ** 2 / (2 + wait * ratio)
            if noise is None:
                noise, p = z, z * (first + ratio * (wait - 1))
            else:
                b_s = (p_s + 0.0005) / (p_s + 0.0005 + 1.0)
                p_s = (p_s + 0.0005) * (1 - b_s)
                noise += b_s * (z - noise)
            gain = (p + ratio * noise) / (p + ratio * noise + noise)
            p = (p + ratio * noise) * (1 - gain)
            x += gain * (error - x)
        last, wait = error, 0
        bias.append(x)
    return np.array(bias)


def test_first_days_by_hand():
    # Day 1: the gain is 4.06 / 5.06 = g. Day 2: z = (3 - 1)^2 / 2.06 and p = g z, so that the
    # gain is (g + 0.06) / (g + 1.06).
    g = 4.06 / 5.06
    found = kalman_bias(np.array([1.0, 3.0]), 0.06)
    assert found == pytest.approx([g, g + (3.0 - g) * (g + 0.06) / (g + 1.06)])


def test_series_one_by_one():
    rng = np.random.default_rng(3)
    errors = rng.normal(1.0, 2.0, (5, 3, 40))
    errors[rng.uniform(size=errors.shape) < 0.2] = np.nan
    errors[0, 0] = np.nan
    ratio = np.array([0.02, 0.06, 0.4])
    found = kalman_bias(errors, ratio)
    for place in np.ndindex(5, 3):
        wanted = by_hand(errors[place].tolist(), ratio[place[1]])
        np.testing.assert_allclose(found[place], wanted, rtol=1e-12)


def test_equal_errors_are_no_division_by_zero():
    assert kalman_bias(np.full(10, 2.5), 0.06)[1:] == pytest.approx(np.full(9, 2.5))


def test_running_mean_by_hand():
    errors = np.array([1.0, np.nan, 3.0, 5.0, np.nan, np.nan, np.nan])
    found = running_mean(errors, 3)
    np.testing.assert_allclose(found, [1.0, 1.0, 2.0, 4.0, 4.0, 5.0, np.nan])


def test_the_filter_is_optimal_for_the_assumed_model():
    rng = np.random.default_rng(7)
    walk = np.cumsum(rng.normal(0.0, math.sqrt(0.1), (400, 200)), axis=1)
    errors = walk + rng.normal(size=walk.shape)
    ahead = np.ones(400, dtype=np.int64)

    def square(bias):
        return np.mean((errors - known_before(bias, ahead))[:, 30:] ** 2)

    right = square(kalman_bias(errors, 0.1))
    assert right < min(square(kalman_bias(errors, ratio)) for ratio in (0.01, 1.0))
    assert right < square(running_mean(errors, 7))
    # Innovation variance of the exact filter: steady spread + 0.1 + noise.
    gain = 0.05 * (math.sqrt(41.0) - 1.0)
    assert right == pytest.approx(1.0 / (1.0 - gain), rel=0.03)
