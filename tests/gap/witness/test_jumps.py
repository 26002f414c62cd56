"""Jumps: a sector's sides are found to half the distance between reports, and none on a null."""

import numpy as np
import pytest
from tests.gap.toy import make_frame
from tests.gap.witness.test_learned import setting_of

from airswing.gap.archive.other_winds import without
from airswing.gap.archive.value_tables import Axis
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.fitted_tables import LEAST_EVIDENCE, explained, field_of, fitted
from airswing.gap.witness.jumps import CROSSED, deviations, jumps
from airswing.gap.witness.unknowns import _cut_at, edged, refined


def in_sector(frame):
    return (frame.latitude > 38.4) & (frame.latitude < 40.3)


@pytest.fixture(scope="module")
def sector():
    """Winds of one band of latitude are 1.2 m/s too strong, for all aircraft."""
    frame = make_frame(seed=6, aircraft=4, days=12, noise=0.4)
    inside = in_sector(frame)
    wind = np.stack([frame.u_ref, frame.v_ref], -1)
    unit = wind / np.hypot(*wind.T)[:, None]
    struck = without(frame, frame.residual + 1.2 * inside[:, None] * unit)
    return [Bench.of(setting_of(one), one.residual) for one in (struck, frame)]


def test_the_sides_of_a_sector_are_the_edges_of_its_table(sector):
    struck, null = sector
    found = jumps(struck)[0]
    assert (found.variable, found.component) == ("latitude", "along_wind")
    for side in (38.4, 40.3):
        assert np.abs(np.array(found.at) - side).min() < 0.1
    best = edged(struck)[0]
    assert best.strength > LEAST_EVIDENCE and "latitude" in best.grid.variables
    days = np.arange(int(struck.setting.day.max()) + 1)
    assert "latitude" in refined(struck, best, days // 3).grid.variables
    sums = [one.cell_sums(best.grid, "along_wind", range(4), 0 * days) for one in sector]
    with_it, without_it = (np.linalg.solve(*one.of_table(np.array([True]))) for one in sums)
    middle = int(np.searchsorted(best.grid.axes[0].edges, 39.0)) - 1
    assert (with_it - without_it)[middle] == pytest.approx(1.2, abs=0.15)
    assert not edged(null)


def test_deviations_are_local_sums_over_their_scatter(sector):
    bench, _ = sector
    setting = bench.setting
    rng = np.random.default_rng(0)
    pulled = rng.normal(size=(setting.frame.size, 2))
    cell = rng.integers(-1, 3, setting.frame.size)
    told = deviations(bench, pulled, "along_wind", cell, 3)
    pull = (pulled * bench.direction("along_wind")).sum(axis=1)
    days = int(setting.day.max()) + 1
    owner = setting.frame.aircraft * days + setting.day
    each = []
    for one in np.unique(owner):
        sums = [pull[(owner == one) & (cell == c)].sum() for c in range(3)]
        each.append([sums[1] - sums[0], sums[1] + sums[2] - sums[0]])
    each = np.array(each)
    assert each.shape[0] >= CROSSED
    near, wide = each.sum(axis=0) / np.sqrt((each**2).sum(axis=0))
    assert told[0] == pytest.approx(near if abs(near) >= abs(wide) else wide)


def teeth(frame):
    """An error that grows from -1.4 to 1.4 m/s over four degrees of longitude, and again."""
    return 1.4 * (2 * np.mod(frame.longitude / 4.0, 1.0) - 1.0)


def test_what_falls_back_at_each_jump_and_grows_again_is_told_between_the_jumps():
    """On average over a tooth it is nothing: a table that is cut at the jumps alone is empty."""
    frame = make_frame(seed=6, aircraft=5, days=14, noise=0.4)
    wind = np.stack([frame.u_ref, frame.v_ref], -1)
    error = teeth(frame)[:, None] * wind / np.hypot(*wind.T)[:, None]
    struck = without(frame, frame.residual + error)
    bench = Bench.of(setting_of(struck), struck.residual)
    best = edged(bench)[0]
    assert best.grid.variables == ("longitude",)
    fold = np.arange(int(bench.setting.day.max()) + 1) // 3
    found = refined(bench, best, fold)
    alone = fitted(bench, best, fold)
    told, bare = (explained(bench, field_of(bench, one, fold)) for one in (found, alone))
    assert found.grid.variables == ("longitude",)
    assert found.grid.size > 2 * best.grid.size
    assert set(best.grid.axes[0].edges) <= set(found.grid.axes[0].edges)
    whole = float((error**2).sum(axis=1).mean())
    assert told > 0.5 * whole > 2 * bare


def test_jumps_take_the_place_of_the_edges_nearest_to_them():
    fine = Axis("longitude", "linear", np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    cut = _cut_at(fine, Axis("longitude", "linear", np.array([0.0, 1.2, 2.5, 4.0])))
    assert cut.edges.tolist() == [0.0, 1.2, 2.0, 2.5, 3.0, 4.0]
    none = _cut_at(fine, Axis("longitude", "linear", np.array([0.0, 4.0])))
    assert none.edges.tolist() == fine.edges.tolist()
