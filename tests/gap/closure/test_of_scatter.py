"""What coarse coding and gross errors close, against reports made without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.closure.of_scatter import (
    Reduction,
    reduction_of,
    reduction_of_jitter,
    with_scatter,
)
from airswing.gap.held_out.reduction import Closure
from airswing.gap.scatter.excess_scatter import Scattering
from airswing.gap.scatter.moment_verdict import MomentVerdict

KNOT = 1852 / 3600


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=2, aircraft=4, days=10)


def mean_kt(residual):
    return float(np.hypot(*residual.T).mean()) / KNOT


def verdict(name, frame, values):
    return MomentVerdict(name, frame.tails, {}, {}, {t: values for t in frame.tails}, None, 99.0)


def test_gross_errors_of_the_whole_fleet(frame):
    rng = np.random.default_rng(0)
    gross = rng.uniform(size=frame.size) < 0.03
    residual = frame.residual + gross[:, None] * rng.normal(0, 20.0, (frame.size, 2))
    found = verdict("outliers", frame, {"fraction": 0.03, "size_m_s": 20.0})
    part = reduction_of(frame, residual, found, gross)
    true = mean_kt(residual) - mean_kt(frame.residual)
    assert true > 0.8
    assert part.kt == pytest.approx(true, abs=2.5 * part.error)
    assert part.interval[0] < true < part.interval[1]


def test_coarse_coding(frame):
    speed = np.hypot(frame.u_rep, frame.v_rep) / KNOT
    direction = np.degrees(np.arctan2(-frame.u_rep, -frame.v_rep))
    coarse, turned = 5 * np.round(speed / 5) * KNOT, np.radians(10 * np.round(direction / 10))
    coded = replace(frame, u_rep=-coarse * np.sin(turned), v_rep=-coarse * np.cos(turned))
    found = verdict("wind_coding", frame, {"step": 5.0, "direction_step_deg": 10.0})
    part = reduction_of(coded, coded.residual, found, np.zeros(frame.size, bool))
    true = mean_kt(coded.residual) - mean_kt(frame.residual)
    assert part.kt == pytest.approx(true, rel=0.35)
    assert part.interval[0] < true < part.interval[1]


@pytest.mark.parametrize("step", [2.0, 5.0, 10.0])
def test_coarse_headings(frame, step):
    north = frame.heading - frame.magnetic_heading
    width = np.radians(step)
    heading = width * np.round(frame.magnetic_heading / width) + north
    coded = replace(
        frame,
        u_rep=frame.ground_u - frame.airspeed * np.sin(heading),
        v_rep=frame.ground_v - frame.airspeed * np.cos(heading),
    )
    found = verdict("heading_coding", frame, {"step_deg": step})
    part = reduction_of(coded, coded.residual, found, np.zeros(frame.size, bool))
    true = mean_kt(coded.residual) - mean_kt(frame.residual)
    assert part.interval[0] < true < part.interval[1]
    assert part.kt == pytest.approx(true, rel=0.2)


def test_jitter_and_what_hardly_moves_the_wind(frame):
    rng = np.random.default_rng(3)
    own = frame.aircraft == 1
    residual = frame.residual + own[:, None] * rng.normal(0, 2.0, (frame.size, 2))
    true = mean_kt(residual) - mean_kt(frame.residual)
    scatter = Scattering((frame.tails[1],), (2.0,), 50.0, 2.0 * own)
    part = reduction_of_jitter(residual, scatter, np.zeros(frame.size, bool))
    assert part.interval[0] < true < part.interval[1]
    found = verdict("position_coding", frame, {"step": 1.0})
    assert reduction_of(frame, residual, found, np.zeros(frame.size, bool)).kt == 0.0


def test_a_closure_with_scatter_adds_up():
    closure = Closure(
        7.0, 6.0, (0.7, 1.3), (5.7, 6.3), (("hard_iron", 6.0, 0.8, 1.2),), (6.0,), np.zeros((2, 2))
    )
    out = with_scatter(closure, {"outliers": Reduction(0.5, 0.4 / 1.959964)})
    assert out.after == pytest.approx(5.5)
    assert out.reduction_ci == pytest.approx((1.0, 2.0))  # 0.3 and 0.4 in quadrature
    assert out.after_ci == pytest.approx((5.0, 6.0))
    assert out.sequence[-1][:2] == ("outliers", 5.5) and out.alone == (6.0, 6.5)
    assert with_scatter(replace(closure, reduction_ci=None), {}).reduction_ci is None
