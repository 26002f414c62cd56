"""Joint estimate of deviations and reference error: exact matrices, large fleets, regions."""

import numpy as np
import pytest
import xarray as xr

from airswing.compass.fit.deviation import fit_deviation, fit_sums, sum_aircraft
from airswing.compass.fleet import solution
from airswing.compass.fleet.field import Blocks
from airswing.compass.fleet.information import Reference
from airswing.compass.fleet.solution import Equations, ExactInverse, IterativeInverse, solve_fleet
from airswing.physics.compass_deviation import deviation_basis
from tests.compass.flown import Setting, fleet_deviations, fly, wrap

AIRCRAFT = 7
FREE = np.ones((AIRCRAFT, 6), dtype=bool)
FREE[2, 3:5] = False


def fleet_blocks(aircraft, days, seed, *, field=0.5, middle=-87.0, reach=(5.0, 3.5)):
    """Blocks in a field of waves, two a piece and a piece a segment, east and north of a middle."""
    segments = 40_000 + np.repeat(np.arange(4 * days), 2)
    n = segments.size
    phase = np.random.default_rng([seed, 9]).uniform(0, 2 * np.pi, (2, 4 * days))
    fleet = []
    for number in range(aircraft):
        rng = np.random.default_rng([seed, number])
        east, north = (rng.uniform(-half_width, half_width, n) for half_width in reach)
        heading = rng.uniform(0, 2 * np.pi, n)
        sums = np.zeros((15, n))
        sums[0] = rng.uniform(3, 8, n)
        error = field * np.sin(0.4 * (east + north) + phase[:, segments - 40_000])
        sums[1:3] = error + rng.normal(0, 0.7, (2, n))
        curve, air = deviation_basis(heading), 150.0 * np.stack([np.sin(heading), np.cos(heading)])
        sums[3:8], sums[8] = -air[1] * curve, air[0]
        sums[9:14], sums[14] = air[0] * curve, air[1]
        sums[1:] *= sums[0]
        places = 42.5 + north, wrap(middle + east), np.log(rng.uniform(3e4, 9e4, n))
        numbers = segments.astype(np.int32), (np.arange(n) // 2).astype(np.int32)
        fleet.append(Blocks(sums.astype(np.float32), 8.0 * n, 8.0 * n, *places, *numbers))
    return fleet


def dense(reference):
    """Newton matrix and score of one reference, from the covariance of its blocks' means."""
    stretch, variances = reference.sample.stretch, reference.variances
    size, blocks = AIRCRAFT * 6 + reference.size, stretch.weight.size
    passing, lasting = stretch.passing_design.toarray(), stretch.lasting_design.toarray()
    same_piece = stretch.piece[:, np.newaxis] == stretch.piece
    covariance = variances.passing * passing @ passing.T + variances.piece * same_piece
    covariance += np.diag(variances.white[stretch.aircraft] / stretch.weight + variances.block)
    design = np.zeros((2, blocks, size))
    for c in range(2):
        for k in range(blocks):
            a = stretch.aircraft[k]
            design[c, k, 6 * a : 6 * a + 6] = stretch.slopes[c, :, k]
            design[c, k, AIRCRAFT * 6 + 2 * a + c] = 1.0
        begin = AIRCRAFT * 8 + c * reference.functions
        design[c, :, begin : begin + reference.functions] = lasting
    weighted = [np.linalg.solve(covariance, columns) for columns in design]
    newton = sum(columns.T @ solved for columns, solved in zip(design, weighted, strict=True))
    score = sum(columns.T @ r for columns, r in zip(weighted, stretch.residual, strict=True))
    return newton, score


def spread_of(fit):
    return np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_both_inverses_are_that_of_the_dense_matrix(count):
    days = 40_000 + 4 * np.arange(6)
    references = [Reference(fleet_blocks(AIRCRAFT, 6, seed), FREE, days) for seed in range(count)]
    equations = Equations(references, FREE)
    newton = np.zeros((equations.size, equations.size))
    right = np.zeros(equations.size)
    for reference, place in zip(references, equations.places, strict=True):
        matrix, score = dense(reference)
        newton[np.ix_(place, place)] += matrix
        right[place] += score
    fixed = np.flatnonzero(~FREE.ravel())
    newton[fixed, fixed] = newton.max()
    columns = np.random.default_rng(3).normal(size=(equations.size, 5))
    for inverse in (ExactInverse(equations, right), IterativeInverse(equations, right)):
        covariance = np.linalg.inv(newton + np.diag(inverse.prior))
        free = np.sqrt(np.diagonal(covariance))[: FREE.size][FREE.ravel()]
        difference = (inverse.solve(right) - covariance @ right)[: FREE.size][FREE.ravel()]
        assert np.abs(difference / free).max() < 1e-3
        squares = ((covariance @ columns) ** 2).sum(axis=1)[: FREE.size].reshape(FREE.shape)
        np.testing.assert_allclose(inverse.squares(columns)[FREE], squares[FREE], rtol=1e-2)
        exact = [covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(AIRCRAFT)]
        exact = np.sqrt(np.diagonal(exact, axis1=1, axis2=2))
        errors = np.sqrt(np.diagonal(inverse.covariances(), axis1=1, axis2=2))
        tolerance = 1e-6 if isinstance(inverse, ExactInverse) else 0.05
        np.testing.assert_allclose(errors[FREE], exact[FREE], rtol=tolerance)


def test_a_large_fleet_is_solved_as_a_small_one_and_repeats(monkeypatch):
    blocks = [[aircraft] for aircraft in fleet_blocks(30, 4, 0, field=1.0)]
    free = np.ones((30, 6), dtype=bool)
    solutions = []
    for most in (10_000, 0, 0):
        monkeypatch.setattr(solution, "MOST_EXACT", most)
        solutions.append(solve_fleet(blocks, free))
    exact, iterated, repeated = solutions
    assert np.abs((iterated.step - exact.step) / spread_of(exact)).max() < 0.05
    np.testing.assert_allclose(spread_of(iterated), spread_of(exact), rtol=0.03)
    np.testing.assert_allclose(iterated.bias, exact.bias, atol=0.02)
    np.testing.assert_allclose(iterated.bias_covariance, exact.bias_covariance, rtol=0.1)
    np.testing.assert_array_equal(repeated.step, iterated.step)
    np.testing.assert_array_equal(repeated.covariance, iterated.covariance)


def test_the_date_line_changes_nothing_in_a_field_of_regions(monkeypatch):
    monkeypatch.setattr("airswing.compass.fleet.field.MOST_NODES", 4)
    free = np.ones((AIRCRAFT, 6), dtype=bool)
    america, pacific = (
        solve_fleet([[aircraft] for aircraft in fleet_blocks(AIRCRAFT, 6, 0, middle=middle)], free)
        for middle in (-87.0, 179.0)
    )
    assert np.abs((pacific.step - america.step) / spread_of(america)).max() < 1e-4
    np.testing.assert_allclose(pacific.covariance, america.covariance, rtol=1e-4, atol=1e-12)
    assert america.regions == 9


def errors(seed, **options):
    """Errors and standard errors of A, B, C where days of model error dominate."""
    setting = Setting(aircraft=8, days=25, day_error=2.5, flight_error=0.5, noise=1.0)
    deviation = fleet_deviations(8, np.random.default_rng(seed), two_cycles=0.0)
    ds, _ = fly(deviation, setting, seed)
    fits = fit_deviation(ds, harmonics=1, **options).isel(reference=0)
    spread = np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=1, axis2=2))
    return (fits["deviation"].to_numpy() - deviation)[:, :3], spread[:, :3]


def test_the_shared_error_is_removed_and_intervals_hold():
    with_field = [errors(seed) for seed in range(5)]
    without_field = [errors(seed, shared_error=False) for seed in range(5)]
    rms = [np.sqrt(np.nanmean([e**2 for e, _ in runs])) for runs in (with_field, without_field)]
    assert rms[0] < 0.85 * rms[1]
    score = np.concatenate([(e / s).ravel() for e, s in with_field])
    score = score[np.isfinite(score)]
    assert (np.abs(score) < 1.96).mean() >= 0.88
    assert np.abs(score).max() < 4.5


def test_a_fleet_summed_in_parts_gives_the_same_fits():
    ds, _ = fly(fleet_deviations(5, np.random.default_rng(6)), Setting(aircraft=5, days=15), 6)
    fits = fit_deviation(ds)
    size = int(ds["row_size"][0])
    parts = [
        sum_aircraft(ds.isel(aircraft=slice(a, b), report=slice(a * size, b * size)))
        for a, b in ((0, 2), (2, 3), (3, 5))
    ]
    assert fit_sums(xr.concat(parts, "aircraft")).identical(fits)


def test_regions_lose_little_of_the_information(monkeypatch):
    """A hemisphere whole and in regions; the aircraft have no deviation."""
    free = np.ones((30, 6), dtype=bool)
    blocks = [[b] for b in fleet_blocks(30, 12, 1, field=1.5, middle=179.0, reach=(60.0, 30.0))]
    solutions = {}
    for most in (10_000, 150):
        monkeypatch.setattr("airswing.compass.fleet.field.MOST_NODES", most)
        solutions[most] = solve_fleet(blocks, free)
    single_region, by_region = solutions[10_000], solutions[150]
    assert (single_region.regions, by_region.regions > 4) == (1, True)
    assert np.abs((single_region.step - by_region.step) / spread_of(single_region)).max() < 0.5
    assert np.mean(spread_of(by_region) / spread_of(single_region)) == pytest.approx(1.0, abs=0.05)
    assert np.std(by_region.step / spread_of(by_region)) == pytest.approx(1.0, abs=0.15)
