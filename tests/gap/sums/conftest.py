"""An archive's sums and the dense columns they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.layout import build_columns, make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise.whitening import whiten
from airswing.gap.sums.accumulate import SumColumns, accumulate, day_of_report
from airswing.gap.sums.elimination import Included, climatology, eliminate_days

EFFECTS = {n: CATALOGUE[n] for n in ("compass_offset", "hard_iron", "tas_scale")}


@pytest.fixture(scope="module")
def made():
    frame = exogenous(make_frame(seed=3, aircraft=3, days=9))
    noise, plan = noise_of(frame), plan_dictionary(frame)
    layout = make_layout(EFFECTS, plan, frame)
    stats = accumulate(frame, frame.residual, SumColumns(noise, layout, EFFECTS, plan), clip=50.0)
    return frame, noise, plan, layout, stats


def dense_of(made):
    frame, noise, plan, layout, _ = made
    columns = build_columns(frame, layout, EFFECTS, plan).astype(float).T
    columns = whiten(columns, noise.order, noise.gains)
    return columns.reshape(-1, layout.size), whiten(
        frame.residual, noise.order, noise.gains
    ).reshape(-1)


@pytest.fixture(scope="module")
def mixed(made):
    """Dense columns, residual and elimination of the days; what is given, and its columns."""
    frame, _, _, layout, stats = made
    x, r = dense_of(made)
    base = eliminate_days(stats)
    days, _ = day_of_report(frame)
    day = np.repeat(np.searchsorted(stats.days, days), 2)
    aircraft = np.repeat(frame.aircraft, 2)
    q = layout.blocks["day_fields"].stop
    z = np.zeros((x.shape[0], q * stats.days.size))
    for d in range(stats.days.size):
        z[day == d, d * q : (d + 1) * q] = x[day == d, :q]
    inner = z.T @ z + np.diag(np.tile(1 / base.variances.day, stats.days.size))

    def out(y):
        return y - z @ np.linalg.solve(inner, z.T @ y)

    ones = np.ones(stats.day_count.shape)
    first = np.zeros_like(ones)
    first[1, 3:] = 1.0
    hard = layout.columns("hard_iron")
    included = [
        *climatology(base),
        Included(int(hard[0]), first, 1e-3),
        Included(int(hard[1]), ones, 1e-3),
    ]
    m = np.stack([x[:, j.column] * j.weights[aircraft, day] for j in included], -1)
    return base, included, m, out, day, aircraft, x, r
