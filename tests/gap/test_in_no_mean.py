"""What moves no mean and has no name."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from airswing.gap.closure.of_scatter import Reduction
from airswing.gap.in_no_mean import in_no_mean


@pytest.mark.parametrize(("floor_closes", "stands"), [(0.2, "sent"), (0.05, "scatter")])
def test_of_scatter_and_winds_sent_otherwise_the_one_that_closes_more(
    monkeypatch, floor_closes, stands
):
    """A floor of the speeds scatters, and jitter sends other speeds: one of them is at work."""
    module = "airswing.gap.in_no_mean"
    problem = SimpleNamespace(
        archive=SimpleNamespace(tails=("N1", "N2"), aircraft=np.array([0, 1, 1]))
    )
    jitter = SimpleNamespace(tails=["N2"])
    floor = SimpleNamespace(
        aircraft=(0, 1),
        component="reported_speed",
        speeds=np.zeros(2),
        closes=floor_closes,
        closes_error=0.01,
    )
    monkeypatch.setattr(f"{module}.reduction_of_jitter", lambda *_: Reduction(0.1, 0.01))
    monkeypatch.setattr(f"{module}._scatters", lambda p, r, g, known: None if known else jitter)
    monkeypatch.setattr(f"{module}._sent_otherwise", lambda p, r, known: None if known else floor)
    search = SimpleNamespace(tell=lambda *_: None)
    found = in_no_mean(problem, np.zeros((3, 2)), [], np.zeros(3, bool), search)
    expected = {
        "sent": (None, floor, {"reported_speed": Reduction(0.2, 0.01)}),
        "scatter": (jitter, None, {"scatter": Reduction(0.1, 0.01)}),
    }
    assert found == expected[stands]
