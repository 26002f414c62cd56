"""Gross errors of one, some or all aircraft are found with their share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design import exogenous
from airswing.gap.distribution.gross_errors import outliers, reduction_of_gross
from airswing.gap.noise import gross_errors
from airswing.units import KNOT


@pytest.fixture(scope="module")
def archive():
    frame = make_frame(seed=11, aircraft=8, days=20)
    return frame, noise_of(frame, exogenous(frame))


def with_gross_errors(archive, aircraft, share, size=20.0):
    """The archive with normal errors in a share of some aircraft's reports, and its noise."""
    frame, noise = archive
    rng = np.random.default_rng(5)
    hit = np.isin(frame.aircraft, aircraft) & (rng.random(frame.size) < share)
    error = hit[:, None] * rng.normal(0, size, (frame.size, 2))
    made = replace(frame, u_rep=frame.u_rep + error[:, 0], v_rep=frame.v_rep + error[:, 1])
    return made, replace(noise, gross=gross_errors(made.residual, noise.order))


@pytest.mark.parametrize("aircraft", [[2], [1, 4, 5], list(range(8))])
@pytest.mark.parametrize("share", [0.01, 0.03])
def test_share_of_gross_errors_and_aircraft(archive, aircraft, share):
    made, noise = with_gross_errors(archive, aircraft, share)
    found = outliers(made, made.residual, noise)
    assert found.tails == [made.tails[a] for a in aircraft]
    assert found.evidence_nats > 7.0
    count = share * np.isin(made.aircraft, aircraft).sum()
    assert found.parameters["fraction"] == pytest.approx(share, abs=3 * share / np.sqrt(count))
    reduction = reduction_of_gross(made, made.residual, found, noise.gross)
    frame, _ = archive
    true = (np.hypot(*made.residual.T).mean() - np.hypot(*frame.residual.T).mean()) / KNOT
    assert reduction.reduction_ci[0] < true < reduction.reduction_ci[1]


def test_no_gross_errors(archive):
    frame, noise = archive
    calm = replace(noise, gross=gross_errors(frame.residual, noise.order))
    assert outliers(frame, frame.residual, calm) is None


def test_moderate_scatter_is_no_gross_error(archive):
    made, noise = with_gross_errors(archive, [1, 2], 0.3, size=2.5)
    assert noise.gross.mean() > 0.002
    assert outliers(made, made.residual, noise) is None
