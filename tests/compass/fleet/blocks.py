"""Blocks of a fleet made for the tests of its equations."""

from __future__ import annotations

import numpy as np

from airswing.compass.fleet.flight_segments import ROWS, Blocks


def fleet_blocks(
    aircraft: int,
    days: int,
    seed: int,
    *,
    field: float = 0.5,
    middle: float = -87.0,
    reach: tuple[float, float] = (5.0, 3.5),
) -> list[Blocks]:
    """Blocks of aircraft that meet in a field of waves: two in a piece, a piece a segment.

    ``middle`` is a longitude, ``reach`` how far east and north of (middle, 42.5 N) they fly.
    """
    segments = 40_000 + np.repeat(np.arange(4 * days), 2)
    n = segments.size
    phase = np.random.default_rng([seed, 9]).uniform(0, 2 * np.pi, (2, 4 * days))
    found = []
    for number in range(aircraft):
        rng = np.random.default_rng([seed, number])
        east, north = (rng.uniform(-one, one, n) for one in reach)
        heading = rng.uniform(0, 2 * np.pi, n)
        sums = np.zeros((ROWS, n))
        sums[0] = rng.uniform(3, 8, n)
        error = field * np.sin(0.4 * (east + north) + phase[:, segments - 40_000])
        sums[1:3] = error + rng.normal(0, 0.7, (2, n))
        curve = np.stack(
            [np.ones(n), np.sin(heading), np.cos(heading), np.sin(2 * heading), np.cos(2 * heading)]
        )
        speed = 150.0
        sums[3:8], sums[8] = -speed * np.cos(heading) * curve, speed * np.sin(heading)
        sums[9:14], sums[14] = speed * np.sin(heading) * curve, speed * np.cos(heading)
        sums[1:] *= sums[0]
        found.append(
            Blocks(
                sums.astype(np.float32),
                8.0 * n,
                8.0 * n,
                42.5 + north,
                (middle + east + 180.0) % 360.0 - 180.0,
                np.log(rng.uniform(3e4, 9e4, n)),
                segments.astype(np.int32),
                (np.arange(n) // 2).astype(np.int32),
            )
        )
    return found
