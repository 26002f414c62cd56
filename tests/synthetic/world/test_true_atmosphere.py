"""The wind and its references: sizes, correlations, seeds."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.synthetic.atmosphere import (
    WaveKind,
    World,
    WorldParameters,
    model_wind,
    random_waves,
    stream,
)


@pytest.fixture(scope="module")
def grid() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(-800.0, 801.0, 50.0), np.arange(-600.0, 601.0, 50.0))
    return x, y


def errors(world: World, name: str, grid: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Reference minus the resolved truth, (T, 2, L, rows, columns)."""
    zeta, hours = np.log([0.7, 0.5]), np.arange(0.0, 480.0, 3.0)
    large = world.large_scale_on_grid(*grid, zeta, hours)
    return model_wind(world, name, *grid, zeta, hours, large) - large


def test_waves_on_the_grid_are_the_waves_at_the_points(grid: tuple) -> None:
    waves = random_waves(
        np.random.default_rng(3),
        WaveKind(count=40, rms=2.0, lengths=(100, 300), depth=0.4, memory=6.0, drift=(30.0, 5.0)),
        start=-5.0,
        end=30.0,
    )
    x, y = grid
    zeta, hours = np.log([0.8, 0.4]), np.array([0.0, 1.25, 7.5])
    field = waves.on_grid(x, y, zeta, hours)
    for step, level in np.ndindex(3, 2):
        points = waves.at_points(
            x.ravel(), y.ravel(), np.full(x.size, zeta[level]), np.full(x.size, hours[step])
        )
        np.testing.assert_allclose(field[step, :, level].reshape(2, -1), points, atol=2e-3)


def test_waves_have_the_size_and_the_correlation_asked_for() -> None:
    """A Gaussian spectrum of one length L gives the covariance exp(-r^2 / 2 L^2)."""
    values = []
    for seed in range(200):
        waves = random_waves(
            np.random.default_rng(seed),
            WaveKind(
                count=60, rms=2.0, lengths=(200.0, 200.001), depth=0.5, memory=6.0, rotational=0.0
            ),
            start=0.0,
            end=8.0,
        )
        points = np.array([0.0, 200.0, 0.0, 0.0])
        values.append(
            waves.at_points(
                points, np.zeros(4), np.array([0, 0, 0.5, 0.0]), np.array([1.0, 1.0, 1.0, 7.0])
            )
        )
    sample = np.concatenate(values)
    covariance = sample.T @ sample / len(sample)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(2.0, rel=0.08)
    correlation = covariance[0] / covariance[0, 0]
    np.testing.assert_allclose(
        correlation[1:], [np.exp(-0.5), np.exp(-0.5), np.exp(-1.0)], atol=0.12
    )


def test_reference_errors_are_shared_in_part_and_correlated_over_distance(grid: tuple) -> None:
    world = World(WorldParameters(), 4, 480.0)
    first, second = (errors(world, name, grid)[:, 0, 1] for name in ("ruc", "rtfdaa"))

    def correlation(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    near, far = (correlation(first[:, :, :-n], first[:, :, n:]) for n in (2, 16))
    assert near > 0.75
    assert abs(far) < 0.25
    assert 0.2 < correlation(first, second) < 0.75
    soon, late = (correlation(first[:-n], first[n:]) for n in (1, 16))
    assert soon > 0.3
    assert abs(late) < 0.3
    assert 1.6 < first.std() < 2.9


def test_hard_world_has_heavier_tails(grid: tuple) -> None:
    kurtosis = []
    for sizes in (WorldParameters(), WorldParameters.hard()):
        error = errors(World(sizes, 5, 480.0), "ruc", grid)[:, 0, 1]
        error = error - error.mean(axis=0)
        kurtosis.append(np.mean(error**4) / np.mean(error**2) ** 2)
    assert kurtosis[1] > kurtosis[0] + 0.4


def test_jet_has_shear_and_blows_from_the_west() -> None:
    world = World(WorldParameters(), 6, 480.0)
    hours = np.arange(0.0, 480.0, 2.0)
    zero = np.zeros(hours.size)
    mean = [
        world.at_points(zero, zero, zero + np.log(level), hours).mean(axis=1)
        for level in (0.9, 0.5, 0.3)
    ]
    assert mean[0][0] < mean[1][0] < mean[2][0]
    assert mean[1][0] > 6.0
    assert abs(mean[1][1]) < 6.0


def test_everything_follows_from_the_seed_and_parts_are_independent() -> None:
    assert stream(1, "a").normal() == stream(1, "a").normal()
    assert stream(1, "a").normal() != stream(1, "b").normal()
    assert stream(1, "a").normal() != stream(2, "a").normal()
