"""Context of the design columns."""

from __future__ import annotations

import numpy as np

import airswing  # noqa: F401
from airswing.gap.archive.acceleration import expected_acceleration


def test_acceleration_is_the_fleets_profile_and_not_the_reports_noise():
    rng = np.random.default_rng(2)
    phase = np.tile(np.repeat([1, 2, 3], 20), 400)
    flight = np.repeat(np.arange(400), 60)
    level = np.tile(
        np.concatenate(
            [np.linspace(11.5, 10.6, 20), np.full(20, 10.6), np.linspace(10.6, 11.5, 20)]
        ),
        400,
    )
    true = np.choose(phase, [0.0, 0.06 - 0.02 * (11.5 - level), 0.0, -0.05])
    found = expected_acceleration(true + rng.normal(0, 0.05, phase.size), level, phase, flight)
    steady = phase != 2
    np.testing.assert_allclose(found[steady], true[steady], atol=0.006)


def test_chords_spreading_is_undone_in_cruise():
    # a curve x^2 under a triangle over (-1, 1) is x^2 + 1/6
    true = np.arange(-3.0, 4.0) ** 2
    found = expected_acceleration(true + 1 / 6, np.full(7, 10.5), np.full(7, 2), np.zeros(7, int))
    np.testing.assert_allclose(found[1:-1], true[1:-1], atol=1e-12)
