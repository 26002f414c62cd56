"""Doubt about the heading at reports in a turn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from airswing.gap.design import heading_doubt


def test_only_a_deviated_aircraft_is_doubted_and_only_in_a_turn():
    heading = np.radians([0.0, 0.0, 60.0, 60.0] * 2)
    error = np.radians([np.nan, 12.0, 12.0, 0.0] * 2)
    frame = SimpleNamespace(
        tails=("N1", "N2"),
        aircraft=np.repeat([0, 1], 4),
        flight=np.repeat([0, 1], 4),
        time=np.arange(8.0),
        ground_u=100 * np.sin(heading),
        ground_v=100 * np.cos(heading),
        u_ref=np.zeros(8),
        v_ref=np.zeros(8),
        heading_error=error,
        heading=heading,
        magnetic_heading=heading,
    )
    deviated = np.repeat([0.0, np.radians(3.0)], 4)
    columns = SimpleNamespace(
        heading=heading + deviated, airspeed=np.full(8, 100.0), u_ref=np.zeros(8), v_ref=np.zeros(8)
    )
    doubt = heading_doubt(frame, columns)
    np.testing.assert_allclose(doubt[:4], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[[4, 7]], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[5:7], 100 * np.radians(3.0) * np.radians(12.0), rtol=1e-6)
