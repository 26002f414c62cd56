"""Sums over short stretches of flight: where they are cut, and that they are sums."""

from __future__ import annotations

import numpy as np

from airswing.compass.fit.aircraft import fit_aircraft
from airswing.compass.fit.observations import Reports
from airswing.compass.fleet.flight_segments import (
    SLOPES,
    Places,
    duration_of,
    find_edges,
    speed_counts,
)


def made(n: int = 6000, flights: int = 150, seed: int = 0):
    """Reports that obey the vector equation with noise, every three minutes."""
    rng = np.random.default_rng(seed)
    flight = np.arange(n) // (n // flights)
    psi = rng.uniform(0, 360, flights)[flight] + rng.normal(0, 20, n)
    delta = 1.0 + 3.0 * np.sin(np.radians(psi)) - 2.0 * np.cos(np.radians(psi))
    speed = rng.uniform(105, 115, n)
    true = np.radians(psi - delta)
    implied = speed[:, None] * np.column_stack([np.sin(true), np.cos(true)])
    implied += rng.normal(0, 1.0, (n, 2)) - [0.4, -0.3]
    error = (psi - np.degrees(np.arctan2(*implied.T)) + 180) % 360 - 180
    reports = Reports(psi, psi, speed, error, speed - np.hypot(*implied.T), np.full(n, 0.1), flight)
    seconds = flight * 8 * 3600 + (np.arange(n) % (n // flights)) * 180
    time = np.datetime64("2009-01-01", "s") + seconds.astype("timedelta64[s]")
    places = Places(np.full(n, 43.0), np.linspace(-90, -85, n), np.full(n, 5e4), time)
    return reports, places


def test_blocks_end_with_flight_segment_and_length():
    time = np.datetime64("2009-01-01T05:30", "ns") + (
        np.array([0, 10, 29, 30, 50, 60, 61]) * 60
    ).astype("timedelta64[s]")
    edges = find_edges(np.array([0, 0, 0, 0, 0, 0, 1]), time, 1800)
    assert edges.start.tolist() == [0, 3, 5, 6]
    assert edges.opens.tolist() == [True, True, False, True]
    assert np.diff(edges.segment).tolist() == [1, 0, 0]
    # a jet is twice as fast: blocks of a quarter of an hour
    assert find_edges(np.zeros(7, int), time, 900).start.tolist() == [0, 2, 3, 4, 5]


def test_blocks_last_as_their_median_airspeed_asks_whatever_the_periods():
    # 240 km: 30 minutes up to 133.3 m/s, 20 up to 200, 15 up to 266.7, then 10
    for airspeed, seconds in (
        (110.0, 1800),
        (133.3, 1800),
        (133.4, 1200),
        (240.0, 900),
        (300, 600),
    ):
        assert duration_of(speed_counts(np.full(3, airspeed))) == seconds
    speed = np.random.default_rng(2).normal(133.3, 8.0, 999).astype(np.float32)
    parts = [speed_counts(speed[:400]), speed_counts(speed[400:])]
    np.testing.assert_array_equal(sum(parts), speed_counts(speed))
    assert duration_of(sum(parts)) == (1800 if np.median(speed) <= 240e3 / 1800 else 1200)


def test_block_sums_are_the_sums_of_their_reports():
    reports, places = made()
    day = np.arange(150) // 3
    fit = fit_aircraft([reports], day, places=[places])
    (blocks,) = fit.blocks
    edges = find_edges(reports.flight, places.time, 1800)
    assert blocks.size == edges.start.size
    counts = np.diff(np.append(edges.start, reports.size))
    np.testing.assert_allclose(blocks.sums[0].sum(), counts.sum(), rtol=1e-5)
    np.testing.assert_allclose(blocks.sums[0], counts, rtol=0.5)
    # the slope of A is the right-hand normal times the airspeed, of the scale the heading
    k, size = 40, SLOPES
    own = slice(edges.start[k], edges.start[k + 1])
    true = np.radians(reports.heading[own] - 1.0) - np.radians(
        3.0 * np.sin(np.radians(reports.heading[own]))
        - 2.0 * np.cos(np.radians(reports.heading[own]))
    )
    mean = blocks.sums[:, k] / blocks.sums[0, k]
    speed = reports.airspeed[own]
    np.testing.assert_allclose(mean[3], (speed * np.cos(true)).mean(), atol=6.0)
    np.testing.assert_allclose(mean[3 + size], (-speed * np.sin(true)).mean(), atol=6.0)
    np.testing.assert_allclose(mean[2 + size], (speed * np.sin(true)).mean(), atol=6.0)
    np.testing.assert_allclose(mean[2 + 2 * size], (speed * np.cos(true)).mean(), atol=6.0)


def test_the_bias_is_left_in_the_residual_and_the_noise_is_known():
    reports, places = made()
    fit = fit_aircraft([reports], np.arange(150) // 3, places=[places])
    (blocks,) = fit.blocks
    mean = blocks.sums[1:3].sum(axis=1) / blocks.sums[0].sum()
    np.testing.assert_allclose(mean, [0.4, -0.3], atol=0.05)
    # unit noise at 95 % efficiency
    assert abs(blocks.within / blocks.freedom - 1.0 / 0.95) < 0.04


def test_mixed_rows_give_the_same_blocks():
    reports, places = made()
    order = np.random.default_rng(1).permutation(reports.size)
    one = fit_aircraft([reports], np.arange(150) // 3, places=[places]).blocks[0]
    two = fit_aircraft([reports.at(order)], np.arange(150) // 3, places=[places.at(order)])
    np.testing.assert_allclose(one.sums, two.blocks[0].sums, rtol=2e-2, atol=2.0)
    np.testing.assert_array_equal(one.segment, two.blocks[0].segment)
