"""The reference's error as the fleet sees it: the field's functions, weights and variances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from airswing.compass.fleet.field_basis import MOST_NODES, FieldBasis
from airswing.compass.fleet.field_coupling import direct_information
from airswing.compass.fleet.flight_segments import ROWS, Blocks
from airswing.compass.fleet.reference_error import (
    Precision,
    Stretch,
    Variances,
    counted,
    estimate_variances,
)

PLACE = ("latitude", "longitude", "log_pressure")


def places(n: int = 3000, seed: int = 0, middle: float = -87.0):
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(39, 46, n),
        (rng.uniform(middle - 5, middle + 5, n) + 180) % 360 - 180,
        np.log(rng.uniform(3e4, 9e4, n)),
    )


def blocks(n: int = 3000, each: int = 3, segments: int = 20, seed: int = 0) -> Blocks:
    """Blocks of one aircraft, ``each`` a piece, with unit white noise and nothing else."""
    rng = np.random.default_rng(seed)
    sums = np.zeros((ROWS, n))
    sums[0] = 5.0
    sums[1:3] = 5.0 * rng.normal(0, np.sqrt(0.2), (2, n))
    sums[3:] = 5.0 * rng.normal(0, 100, (ROWS - 3, n))
    latitude, longitude, log_pressure = places(n, seed)
    piece = np.arange(n) // each
    return Blocks(
        sums.astype(np.float32),
        4.0 * n,
        4.0 * n,
        latitude,
        longitude,
        log_pressure,
        piece * segments // (n // each),
        piece,
    )


@pytest.mark.parametrize("middle", [-87.0, 179.0])
def test_the_functions_of_each_part_sum_to_one(middle):
    where = places(middle=middle)
    basis = FieldBasis.of(*where)
    for _, value in (basis.lasting_at(*where), basis.passing_at(*where[:2])):
        np.testing.assert_allclose(value.sum(axis=1), 1.0, atol=1e-12)
        assert value.min() >= 0
    assert basis.lasting_at(*where)[0].max() < basis.lasting_size
    assert basis.passing_at(*where[:2])[0].max() < basis.passing_size


def test_the_precision_is_the_inverse_of_the_covariance_written_out():
    one = blocks(60, segments=4)
    stretch = Stretch.of([one], FieldBasis.of(one.latitude, one.longitude, one.log_pressure))
    variances = Variances(np.array([1.3]), 0.4, 0.7, 0.9)
    design = stretch.passing_design.toarray()
    same = stretch.piece[:, np.newaxis] == stretch.piece
    covariance = np.diag(1.3 / stretch.weight + 0.4) + 0.7 * same + 0.9 * design @ design.T
    values = np.random.default_rng(1).normal(size=(2, 60))
    expected = np.linalg.solve(covariance, values.T).T
    np.testing.assert_allclose(Precision(stretch, variances).apply(values), expected, atol=1e-10)


def test_what_an_aircraft_tells_where_the_field_is_known_is_the_dense_information():
    """The last of three aircraft has no block."""
    parts = [blocks(60, segments=4), blocks(30, segments=2, seed=1)]
    where = (np.concatenate([getattr(p, n) for p in parts]) for n in PLACE)
    stretch = Stretch.of(parts, FieldBasis.of(*where))
    variances = Variances(np.array([1.3, 0.8]), 0.4, 0.7, 0.9)
    found = direct_information(Precision(stretch, variances), 3)
    for k in range(2):
        own = stretch.aircraft == k
        same = stretch.piece[own, np.newaxis] == stretch.piece[own]
        covariance = np.diag(variances.white[k] / stretch.weight[own] + 0.4) + 0.7 * same
        expected = np.zeros((8, 8))
        for component in range(2):  # A to E and the scale, then the bias of this component
            design = np.zeros((8, own.sum()))
            design[:6], design[6 + component] = stretch.slopes[component][:, own], 1.0
            expected += design @ np.linalg.solve(covariance, design.T)
        np.testing.assert_allclose(found[k], expected, rtol=1e-6, atol=1e-6 * expected.max())
    assert not found[2].any()


@pytest.mark.parametrize("middle", [-87.0, 179.0])
def test_a_field_in_regions_is_independent_beyond_their_borders(monkeypatch, middle):
    """The covariance written out from where the places are; also across the date line."""
    monkeypatch.setattr("airswing.compass.fleet.field_basis.MOST_NODES", 4)
    one = replace(blocks(60, each=6, segments=5), longitude=places(60, middle=middle)[1])
    basis = FieldBasis.of(one.latitude, one.longitude, one.log_pressure)
    assert [nodes.size for nodes in basis.passing] == [3, 3]
    assert (basis.cuts, basis.regions) == ((2, 2), 9)
    variances, stretch = Variances(np.array([1.3]), 0.4, 0.7, 0.9), Stretch.of([one], basis)
    index, value = basis.passing_at(one.latitude, one.longitude)
    functions = np.zeros((60, 9))
    np.put_along_axis(functions, index, value, axis=1)
    # borders half-way in each direction, a fifth of a region farther back each segment
    ends = [np.ptp(nodes) for nodes in basis.passing]
    east = (one.longitude - basis.origin[0] + 180) % 360 - 180
    sides = (one.latitude, east * basis.origin[1])
    part = [
        (2 * (side - nodes[0]) / end + (one.segment % 5) / 5) // 1
        for side, nodes, end in zip(sides, basis.passing, ends, strict=True)
    ]
    where = np.stack([one.segment, *part])
    near = (where[:, :, np.newaxis] == where[:, np.newaxis]).all(axis=0)
    together = near & (one.piece[:, np.newaxis] == one.piece)
    edge = np.concatenate([[True], ~np.diagonal(together, 1)])
    run = np.cumsum(edge)
    covariance = np.diag(1.3 / stretch.weight + 0.4) + 0.7 * (run[:, np.newaxis] == run)
    covariance += 0.9 * near * (functions @ functions.T)
    values = np.random.default_rng(1).normal(size=(2, 60))
    expected = np.linalg.solve(covariance, values.T).T
    np.testing.assert_allclose(Precision(stretch, variances).apply(values), expected, atol=1e-10)


def test_borders_move_and_regions_are_small():
    """Over a globe; two places near each other share a region in four segments of five."""
    rng = np.random.default_rng(4)
    latitude, longitude = rng.uniform(-60, 80, 20_000), rng.uniform(-180, 180, 20_000)
    basis = FieldBasis.of(latitude, longitude, np.log(rng.uniform(3e4, 9e4, latitude.size)))
    assert basis.passing_size > 3000
    other = latitude + rng.uniform(-2, 2, latitude.size)
    shared = np.zeros(latitude.size)
    for segment in range(40_000, 40_005):
        number = np.full(latitude.size, segment)
        cell = basis.cells(latitude, longitude, number)
        assert set(cell // basis.regions) == {segment}
        shared += cell == basis.cells(np.clip(other, -60, 80), longitude, number)
        index, _ = basis.passing_at(latitude, longitude)
        met = [np.unique(index[cell == one]).size for one in np.unique(cell)]
        assert max(met) <= basis.region_size <= 1.25 * MOST_NODES
    assert (shared >= 4).mean() > 0.99


def test_planted_variances_are_found_and_none_is_left_alone():
    one = blocks()
    basis = FieldBasis.of(one.latitude, one.longitude, one.log_pressure)
    stretch = Stretch.of([one], basis)
    nothing = estimate_variances(stretch, np.ones(1))
    assert nothing.block < 0.03
    assert nothing.piece < 0.05
    assert nothing.passing < 0.05
    rng = np.random.default_rng(2)
    field = rng.normal(0, 1.2, (stretch.passing_design.shape[1], 2))
    stretch.residual[:] += (stretch.passing_design @ field).T
    stretch.residual[:] += rng.normal(0, 0.8, (2, stretch.opens.size))[:, stretch.piece]
    stretch.residual[:] += rng.normal(0, 0.5, stretch.residual.shape)
    found = estimate_variances(stretch, np.ones(1))
    assert found.passing == pytest.approx(1.44, rel=0.2)
    assert found.piece == pytest.approx(0.64, rel=0.25)
    assert found.block == pytest.approx(0.25, rel=0.3)


def test_some_segments_are_the_stretch_without_the_others():
    one = blocks(600, segments=20)
    basis = FieldBasis.of(one.latitude, one.longitude, one.log_pressure)
    stretch = Stretch.of([one], basis)
    variances = Variances(np.array([1.0]), 0.4, 0.7, 0.9)
    whole = Precision(stretch, variances).apply(stretch.residual)
    for chosen in ([2, 6, 10, 14, 18], [4, 5, 6, 7]):
        some = Stretch.of([one.of(np.array(chosen))], basis)
        assert some.segments.tolist() == chosen
        keep = np.isin(stretch.segments[stretch.segment], some.segments)
        np.testing.assert_array_equal(some.residual, stretch.residual[:, keep])
        np.testing.assert_allclose(
            Precision(some, variances).apply(some.residual), whole[:, keep], atol=1e-10
        )


def test_segments_are_chosen_also_where_flights_are_numbered_out_of_time():
    one = blocks(60, segments=4)
    turned = replace(one, segment=one.segment[::-1])
    assert turned.falls
    assert not one.falls
    np.testing.assert_array_equal(
        turned.of(np.array([1, 2])).sums, one.sums[:, (turned.segment == 1) | (turned.segment == 2)]
    )


def test_numbers_are_counted_as_numpy_does_it():
    numbers = np.random.default_rng(3).integers(40_000, 40_100, 70)
    found, count, place = counted(numbers)
    expected = np.unique(numbers, return_inverse=True, return_counts=True)
    for one, other in zip((found, place, count), expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seam", [0.0, 20.0, 137.5, 180.0, 359.0])
def test_the_world_is_cut_where_fewest_fly(seam):
    rng = np.random.default_rng(5)
    longitude = (seam + rng.uniform(2, 358, 5000) + 180) % 360 - 180
    n = longitude.size
    basis = FieldBasis.of(rng.uniform(20, 60, n), longitude, np.log(rng.uniform(3e4, 9e4, n)))
    apart = (basis.origin[0] - seam) % 360 - 180
    assert abs(apart) < 2
    assert np.ptp(basis.passing[1]) == pytest.approx(356 * basis.origin[1], abs=1)
