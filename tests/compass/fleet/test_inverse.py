"""The fleet's equations in parts: against matrices written out, and linear in the aircraft."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from tests.compass.fleet.blocks import fleet_blocks

from airswing.compass.fleet.inverse import Equations, Iterated, Written
from airswing.compass.fleet.reference_equations import Reference
from airswing.compass.fleet.solution import FleetFit, solve_fleet

AIRCRAFT = 7
FREE = np.ones((AIRCRAFT, 6), dtype=bool)
FREE[2, 3:5] = False


def references(count: int = 1, **options) -> list[Reference]:
    days = 40_000 + 4 * np.arange(6)
    return [
        Reference(fleet_blocks(AIRCRAFT, days.size, seed, **options), FREE, days)
        for seed in range(count)
    ]


def written_out(one: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Newton matrix and score of one reference, from the covariance of its blocks' means."""
    stretch, own = one.some.stretch, one.variances
    size, blocks = AIRCRAFT * 6 + one.size, stretch.weight.size
    passing, lasting = stretch.passing_design.toarray(), stretch.lasting_design.toarray()
    same = stretch.piece[:, np.newaxis] == stretch.piece
    covariance = own.passing * passing @ passing.T + own.piece * same
    covariance += np.diag(own.white[stretch.aircraft] / stretch.weight + own.block)
    design = np.zeros((2, blocks, size))
    for c in range(2):
        for k in range(blocks):
            a = stretch.aircraft[k]
            design[c, k, 6 * a : 6 * a + 6] = stretch.slopes[c, :, k]
            design[c, k, AIRCRAFT * 6 + 2 * a + c] = 1.0
        begin = AIRCRAFT * 8 + c * one.lasting
        design[c, :, begin : begin + one.lasting] = lasting
    weighted = [np.linalg.solve(covariance, part) for part in design]
    newton = sum(part.T @ other for part, other in zip(design, weighted, strict=True))
    score = sum(part.T @ r for part, r in zip(weighted, stretch.residual, strict=True))
    return newton, score


def times(equations: Equations, values: np.ndarray) -> np.ndarray:
    found = np.zeros_like(values)
    for part, (own, lasting) in zip(equations.parts, equations.split(), strict=True):
        above, below = part.times(values[own], values[lasting])
        found[own] += above
        found[lasting] += below
    return found


def test_the_parts_are_those_of_the_matrix_written_out():
    (one,) = references()
    expected, score = written_out(one)
    size = np.abs(expected).max()
    part = one.coupling()
    np.testing.assert_allclose(part.dense() / size, expected / size, atol=1e-7)
    equations = Equations([part], FREE)
    found = times(equations, np.eye(equations.size))
    np.testing.assert_allclose(found / size, expected / size, atol=1e-12)
    ((own, lasting),) = equations.split()
    for block, place in zip(part.own_blocks(), own, strict=True):
        np.testing.assert_allclose(block / size, expected[np.ix_(place, place)] / size, atol=1e-12)
    for low in lasting:
        np.testing.assert_allclose(part.lasting_block(), expected[np.ix_(low, low)], atol=1e-8)
    np.testing.assert_allclose(one.start.sum(axis=0), score, rtol=1e-7, atol=1e-7)


def test_some_segments_information_is_made_that_of_all(monkeypatch):
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 150)
    (one,) = references()
    part = one.coupling()
    assert one.thinned
    equations = Equations([part], FREE)
    dense = part.dense()
    found = times(equations, np.eye(equations.size))
    size = np.abs(dense).max()
    np.testing.assert_allclose(found / size, dense / size, atol=1e-7)
    for block, place in zip(part.own_blocks(), equations.split()[0][0], strict=True):
        np.testing.assert_allclose(block / size, dense[np.ix_(place, place)] / size, atol=1e-7)


def test_an_aircraft_none_of_whose_days_was_chosen_is_fitted_too(monkeypatch):
    blocks = fleet_blocks(AIRCRAFT, 30, 0)
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 420)
    segments = 40_000 + np.arange(120)
    seldom = segments[(segments % 4 != 0) & (segments % 4 != 2)][10:14]
    blocks[0] = blocks[0].of(seldom)
    one = Reference(blocks, FREE, 40_000 + 4 * np.arange(30))
    assert one.thinned and not np.isin(one.some.stretch.segments, seldom).any()
    found = solve_fleet([[part] for part in blocks], FREE)
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 50_000)
    exact = solve_fleet([[part] for part in blocks], FREE)
    spread, other = (
        np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2)) for fit in (exact, found)
    )
    assert np.abs((found.step - exact.step)[FREE] / spread[FREE]).max() < 0.5
    np.testing.assert_allclose(other, spread, rtol=0.2)


@pytest.mark.parametrize("count", [1, 2])
def test_both_inverses_are_that_of_the_matrix_written_out(count):
    every = references(count)
    equations = Equations([one.coupling() for one in every], FREE)
    newton = np.zeros((equations.size, equations.size))
    right = np.zeros(equations.size)
    for one, place in zip(every, equations.places(), strict=True):
        own, score = written_out(one)
        newton[np.ix_(place, place)] += own
        right[place] += score
    fixed = np.flatnonzero(~FREE.ravel())
    newton[fixed, fixed] = newton.max()
    columns = np.random.default_rng(3).normal(size=(equations.size, 5))
    for inverse in (Written(equations, right), Iterated(equations, right)):
        covariance = np.linalg.inv(newton + np.diag(inverse.prior))
        spread = np.sqrt(np.diagonal(covariance))
        free = spread[: FREE.size][FREE.ravel()]
        apart = (inverse.solve(right) - covariance @ right)[: FREE.size][FREE.ravel()]
        assert np.abs(apart / free).max() < 1e-4
        squares = ((covariance @ columns) ** 2).sum(axis=1)[: FREE.size]
        np.testing.assert_allclose(
            inverse.squares(columns).ravel()[FREE.ravel()], squares[FREE.ravel()], rtol=1e-2
        )
        exact = [covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(AIRCRAFT)]
        exact = np.sqrt(np.diagonal(exact, axis1=1, axis2=2))
        own = np.sqrt(np.diagonal(inverse.own(), axis1=1, axis2=2))
        tolerance = 1e-6 if isinstance(inverse, Written) else 0.05
        np.testing.assert_allclose(own[FREE], exact[FREE], rtol=tolerance)


def solved(aircraft: int, most: int, monkeypatch) -> FleetFit:
    monkeypatch.setattr("airswing.compass.fleet.inverse.WRITTEN_OUT", most)
    blocks = [[one] for one in fleet_blocks(aircraft, 6, 0, field=1.0)]
    return solve_fleet(blocks, np.ones((aircraft, 6), dtype=bool))


def test_a_fleet_iterated_is_the_fleet_written_out_and_repeats(monkeypatch):
    exact, found = solved(60, 10_000, monkeypatch), solved(60, 0, monkeypatch)
    spread, other = (
        np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2)) for one in (exact, found)
    )
    assert np.abs((found.step - exact.step) / spread).max() < 0.05
    np.testing.assert_allclose(other, spread, rtol=0.03)
    np.testing.assert_allclose(found.bias, exact.bias, atol=0.02)
    np.testing.assert_allclose(found.bias_covariance, exact.bias_covariance, rtol=0.1)
    again = solved(60, 0, monkeypatch)
    np.testing.assert_array_equal(again.step, found.step)
    np.testing.assert_array_equal(again.covariance, found.covariance)


def test_memory_grows_no_faster_than_the_aircraft(monkeypatch):
    def peak(aircraft: int) -> int:
        tracemalloc.start()
        solved(aircraft, 0, monkeypatch)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    small, large = peak(60), peak(120)
    assert large < 2.2 * small
    assert small < 8 * (8 * 60) ** 2 * 40


@pytest.mark.parametrize("most", [400, 4])
def test_the_date_line_and_a_turned_globe_change_nothing(monkeypatch, most):
    """Nor where the field is worked in regions."""
    monkeypatch.setattr("airswing.compass.fleet.field_basis.MOST_NODES", most)
    every = np.ones((AIRCRAFT, 6), dtype=bool)
    here, there = (
        solve_fleet([[one] for one in fleet_blocks(AIRCRAFT, 6, 0, middle=middle)], every)
        for middle in (-87.0, 179.0)
    )
    spread = np.sqrt(np.diagonal(here.covariance, axis1=1, axis2=2))
    assert np.abs((there.step - here.step) / spread).max() < 1e-4
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-4, atol=1e-12)
    assert here.regions == (1 if most == 400 else 9)


def test_regions_cost_little_of_what_the_field_tells(monkeypatch):
    """A hemisphere whole and in regions; the aircraft that made it have no deviation."""
    every = np.ones((30, 6), dtype=bool)
    blocks = [[one] for one in fleet_blocks(30, 12, 1, field=1.5, middle=179.0, reach=(60.0, 30.0))]
    found = {}
    for most in (10_000, 150):
        monkeypatch.setattr("airswing.compass.fleet.field_basis.MOST_NODES", most)
        found[most] = solve_fleet(blocks, every)
    whole, parts = found[10_000], found[150]
    assert (whole.regions, parts.regions > 4) == (1, True)
    spread = [np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2)) for one in (whole, parts)]
    assert np.abs((whole.step - parts.step) / spread[0]).max() < 0.5
    assert np.mean(spread[1] / spread[0]) == pytest.approx(1.0, abs=0.05)
    assert np.std(parts.step / spread[1]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("reach", [(90.0, 40.0), (180.0, 40.0)])
def test_over_a_hemisphere_the_fleet_is_solved(monkeypatch, reach):
    """All round the globe too; the nodes of a segment count as so many blocks."""
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_NODES", 10_000)
    every = np.ones((AIRCRAFT, 6), dtype=bool)
    blocks = fleet_blocks(AIRCRAFT, 2, 0, middle=179.0, reach=reach)
    one = Reference(blocks, every, 40_000 + 4 * np.arange(2))
    assert [nodes.size for nodes in one.basis.lasting[:2]] == [5, 8 if reach[0] < 100 else 15]
    assert one.thinned
    found = solve_fleet([[one] for one in blocks], every)
    assert np.isfinite(found.step).all()
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
