"""A placebo closes nothing where it is not fitted; a real effect by the same road would."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.checks.negative_control import (
    Placebo,
    fitted_placebo,
    placebo_columns,
    placebo_errors,
)
from airswing.gap.noise.whitening import whiten


@pytest.fixture(scope="module")
def struck():
    """Frame with a strong deviation on every aircraft, and its noise."""
    frame = make_frame(
        seed=3,
        aircraft=4,
        days=12,
        noise=0.3,
        heading_error=lambda context: np.radians(3.0) * np.sin(context["magnetic_heading"]),
    )
    noise = noise_of(frame)
    return frame, noise


def _fold(frame):
    return (frame.day - frame.day.min()) % 4


def test_decoy_closes_nothing_on_held_out_flights(struck):
    frame, noise = struck
    day = frame.day - frame.day.min()
    made = fitted_placebo(frame, frame.residual, noise=noise, day=day, fold=_fold(frame))
    assert made.closes_nothing
    assert made.held_out < 0.02
    assert made.fitted > made.held_out
    assert made.held_out_ci[0] < made.held_out < made.held_out_ci[1]


def test_the_real_cause_by_the_same_road_closes(struck):
    frame, noise = struck
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    cycle = np.stack([np.sin(frame.magnetic_heading), np.cos(frame.magnetic_heading)], -1)
    columns = -(frame.airspeed[:, None] * right)[:, :, None] * cycle[:, None, :]
    white = whiten(columns, noise.order, noise.gains)
    target = whiten(frame.residual, noise.order, noise.gains)
    _, error = placebo_errors(columns, white, target, frame.aircraft, _fold(frame))
    closed = np.hypot(*frame.residual.T) - np.hypot(*(frame.residual - error).T)
    assert closed.mean() > 0.5


def test_decoy_has_the_size_of_the_real_columns(struck):
    frame, _ = struck
    columns = placebo_columns(frame, np.random.default_rng(0))
    energy = (columns**2).sum(axis=(1, 2))
    np.testing.assert_allclose(energy, frame.airspeed**2)


def test_errors_agree_with_ridge_by_hand():
    rng = np.random.default_rng(2)
    columns, target = rng.normal(size=(30, 2, 2)), rng.normal(size=(30, 2))
    aircraft, fold = np.zeros(30, int), np.arange(30) % 3
    fitted, held = placebo_errors(columns, columns, target, aircraft, fold)
    ridge = np.eye(2) / np.radians(2.0) ** 2
    for keep, out, rows in ((fold >= 0, fitted, fold >= 0), (fold != 1, held, fold == 1)):
        x, y = columns[keep].reshape(-1, 2), target[keep].reshape(-1)
        theta = np.linalg.solve(x.T @ x + ridge, x.T @ y)
        np.testing.assert_allclose(out[rows], columns[rows] @ theta)


def test_what_counts_as_nothing():
    assert Placebo(0.1, -0.002, (-0.01, -0.001), 4).closes_nothing
    assert not Placebo(0.1, 0.05, (0.03, 0.07), 4).closes_nothing
