"""The two-sample classifier: silent where winds err any way, sure where a compass is off."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from airswing.blind_check.baselines import classifier

FLIGHTS, EACH = 90, 60


def frame(across_m_s: float) -> Any:
    """Reports whose winds err by 2 m/s each way, and across the heading by so much more."""
    rng = np.random.default_rng(3)
    size = FLIGHTS * EACH
    heading = rng.uniform(0, 2 * np.pi, size)
    cross = np.stack([np.cos(heading), -np.sin(heading)], axis=1)
    return SimpleNamespace(
        size=size,
        tails=("N1", "N2"),
        aircraft=np.repeat(np.arange(FLIGHTS) % 2, EACH),
        flight=np.repeat(np.arange(FLIGHTS), EACH),
        heading=heading,
        magnetic_heading=heading,
        pressure=rng.uniform(3e4, 8e4, size),
        phase=rng.integers(1, 4, size),
        icing=np.zeros(size, dtype=int),
        residual=rng.normal(0, 2.0, (size, 2)) + across_m_s * cross,
    )


@pytest.mark.parametrize(("across", "detected"), [(0.0, False), (4.0, True)])
def test_the_classifier_claims_an_error_and_no_more(across, detected):
    found = classifier(frame(across))
    assert found["detected"] is detected and found["names"] == []
    assert abs(found["area"] - 0.5) < 0.05 if not detected else found["area"] > 0.75
