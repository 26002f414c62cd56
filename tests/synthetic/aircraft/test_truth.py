"""The stated truth is what the archive's units do: coefficients against exact heading errors."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.instrument import parse_faults
from airswing.synthetic.observe import Coding
from airswing.synthetic.truth import fleet_deviations, truth_record

START = datetime(2009, 3, 1)


@pytest.mark.parametrize("seed", [7, 8])
def test_every_unit_errs_by_its_stated_coefficients_at_the_field_it_flies_in(seed: int) -> None:
    """Aircraft fly where the field is weaker or stronger than the fleet's, by several per cent."""
    tails = [f"N{401 + index}" for index in range(8)]
    effects = fleet_deviations(tails, seed)
    options = {"days": 6, "aircraft": 8, "seed": seed, "effects": effects, "derivatives": False}
    frame = simulate_arrays(coding=Coding(heading_noise=0.0), **options)
    faults = parse_faults(effects, start=START, tails=tails)
    truth = truth_record(frame, faults, tails, effects)["aircraft"]
    for tail in tails:
        own = frame[(frame["tail"] == tail) & (frame["phase"] == 2)]
        error = np.degrees((own["heading"] - own["true_heading"] + np.pi) % (2 * np.pi) - np.pi)
        m = own["heading"] - own["declination"]
        gain = truth[tail]["mean_horizontal_field"] / own["horizontal"]
        a, b, c, d, e = (truth[tail]["deviation"][name] for name in "ABCDE")
        stated = a + gain * (b * np.sin(m) + c * np.cos(m)) + d * np.sin(2 * m) + e * np.cos(2 * m)
        bound = 0.01 + 3.0 * truth[tail]["deviation_residual_rms"]
        assert np.abs(error - stated).max() < bound, tail
