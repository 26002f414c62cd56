"""What the noise fit starts from: single gross reports, levels, smooth effects."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.noise.test_model import flown_archive

from airswing.gap.noise.residual_statistics import (
    gross_errors,
    level_factors,
    remove_smooth_effects,
)
from airswing.gap.noise.whitening import flight_order


def test_gross_errors_are_single_reports_not_long_departures():
    data = flown_archive(2, flights=300)
    order = flight_order(data["flight"], data["time"])
    first = np.flatnonzero(data["flight"] == 50)
    residual = data["residual"].copy()
    residual[first] += 15.0
    residual[first[3]] += 25.0
    found = np.flatnonzero(gross_errors(residual, order))
    assert first[3] in found
    assert set(first) & set(found) == {first[3]}


def test_level_factors_follow_the_spread():
    rng = np.random.default_rng(3)
    log_pressure = np.linspace(np.log(2e4), np.log(9e4), 10_000)
    residual = rng.normal(size=(10_000, 2))
    residual[:4000] *= 2.0  # two of the five levels
    nodes, factors = level_factors(residual, log_pressure)
    assert nodes.size == 5 and (np.diff(nodes) > 0).all()
    np.testing.assert_allclose(factors[:2] / factors[2:4], 2.0, rtol=0.1)
    assert np.mean(factors**2) == pytest.approx(1.0)
    nodes, factors = level_factors(residual, np.full(10_000, 11.0))
    assert nodes.tolist() == [11.0] and factors.tolist() == [1.0]


def test_smooth_effects_leave_pure_noise_alone():
    data = flown_archive(4, flights=200)
    out = remove_smooth_effects(
        data["residual"], data["aircraft"], data["heading"], data["airspeed"]
    )
    assert out.std() == pytest.approx(data["residual"].std(), rel=0.05)
