"""The stated truth against the units' errors, and the fit's equation against the generator.

The generator has no formula of a deviation curve, only fields, iron and a sensing plane; the fit
has no iron. With the true wind as reference and without rounding, their difference is the error of
the fit.
"""

from __future__ import annotations

from datetime import datetime

import numpy as np

from airswing.physics.compass_deviation import deviation_basis
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.instrument import parse_faults
from airswing.synthetic.observe import Coding
from airswing.synthetic.truth import fleet_deviations, truth_record

START = datetime(2009, 3, 1)
TAILS = [f"N{401 + k}" for k in range(6)]


def wrapped(degrees):
    return (degrees + 180.0) % 360.0 - 180.0


def test_every_unit_errs_by_its_stated_coefficients_at_the_field_it_flies_in() -> None:
    """Aircraft fly where the field is weaker or stronger than the fleet's, by several per cent."""
    effects = fleet_deviations(TAILS, 7)
    frame = simulate_arrays(
        coding=Coding(heading_noise=0.0), days=6, aircraft=6, seed=7, effects=effects
    )
    faults = parse_faults(effects, start=START, tails=TAILS)
    truth = truth_record(frame, faults, TAILS, effects)["aircraft"]
    for tail in TAILS:
        chosen = frame[(frame["tail"] == tail) & (frame["phase"] == 2)]
        error = wrapped(np.degrees(chosen["heading"] - chosen["true_heading"]))
        m = chosen["heading"] - chosen["declination"]
        gain = truth[tail]["mean_horizontal_field"] / chosen["horizontal"]
        basis = deviation_basis(m, gain)
        stated = [truth[tail]["deviation"][name] for name in "ABCDE"] @ basis
        bound = 0.01 + 3.0 * truth[tail]["deviation_residual_rms"]
        assert np.abs(error - stated).max() < bound, tail
