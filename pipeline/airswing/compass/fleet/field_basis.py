"""Functions of place that a reference's error is made of: hats between nodes over a region.

Assumes places given by latitude, longitude (degrees) and ln p; the seam of longitude lies where
fewest fly, so that the date line and a hemisphere are like any other place.

The passing part of a field of more than `MOST_NODES` nodes is worked in regions: within a segment
what lies in different regions is taken as independent, where its nodes reach over the border
(a node belongs to each region that flew beside it). The borders move from one segment to the next,
so that the regions of five segments overlap and no place is always at a border. The lasting part
is one whatever the size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airswing.physics.splines import hats_not_zero
from airswing.physics.triangle import wrap_degrees
from airswing.units import METRES_PER_DEGREE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Short = NDArray[np.int32]

SPACING_KM = 400.0
"""Distance of the passing part's nodes: the reach of a model's synoptic error."""

STATIC_NODES = (4, 5, 3)
"""Nodes of the lasting part in latitude, longitude and ln p, at quantiles of the blocks: so many
at least,"""

STATIC_KM = 2000.0
"""and one for so many kilometres of latitude and longitude."""

MOST_NODES = 400
"""Nodes of the passing part that are worked as one: a square of 8,000 km. Their covariance takes
the square of their number in every segment, its inverse the cube."""

SHIFTS = 5
"""Places the borders of regions take in turn: no part of the four segments of a day."""

KM_A_DEGREE = METRES_PER_DEGREE / 1e3


@dataclass(frozen=True)
class FieldBasis:
    """Which functions make up the field."""

    lasting: tuple[Floats, ...]  # nodes in latitude, eastward degrees and ln p
    passing: tuple[Floats, ...]  # nodes in latitude and eastward degrees
    origin: tuple[float, float]  # longitude of the middle, cosine of the middle latitude

    @classmethod
    def of(cls, latitude: Floats, longitude: Floats, log_pressure: Floats) -> FieldBasis:
        """Choose the functions for some places.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        log_pressure : array of float, shape (n,)
        """
        origin = (_middle(longitude), float(np.cos(np.radians(np.median(latitude)))))
        east = _eastward(longitude, origin)
        places = (latitude, east, log_pressure)
        apart = (STATIC_KM / KM_A_DEGREE, STATIC_KM / KM_A_DEGREE, np.inf)
        lasting = tuple(
            np.unique(np.quantile(values, np.linspace(0, 1, max(nodes, 1 + int(span // step)))))
            for values, nodes, step in zip(places, STATIC_NODES, apart, strict=True)
            for span in (np.ptp(values),)
        )
        return cls(lasting, tuple(_even(v) for v in (latitude, east)), origin)

    @property
    def lasting_size(self) -> int:
        """Number of functions of the lasting part."""
        return int(np.prod([nodes.size for nodes in self.lasting]))

    @property
    def passing_size(self) -> int:
        """Number of functions of the passing part in one segment."""
        return int(np.prod([nodes.size for nodes in self.passing]))

    @cached_property
    def cuts(self) -> tuple[int, int]:
        """Into how many parts the passing part is cut in latitude and eastward."""
        rows, columns = (nodes.size for nodes in self.passing)
        down, across = 1, 1
        while rows * columns > MOST_NODES * down * across:
            if rows * across >= columns * down:  # the longer side of a region
                down += 1
            else:
                across += 1
        return down, across

    @property
    def regions(self) -> int:
        """Number of regions of a segment: borders that have moved make one more on each axis."""
        return int(np.prod([parts + (parts > 1) for parts in self.cuts]))

    @property
    def region_size(self) -> int:
        """Functions of the passing part that blocks of one region may meet."""
        found = 1
        for nodes, parts in zip(self.passing, self.cuts, strict=True):
            # the nodes of a border that lies between two of them, on both sides
            found *= min(nodes.size, -(-(nodes.size - 1) // parts) + 2)
        return found

    def lasting_at(
        self, latitude: Floats, longitude: Floats, log_pressure: Floats
    ) -> tuple[Short, Floats]:
        """Functions of the lasting part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 8)
            The values of a place sum to one.
        """
        values = (latitude, _eastward(longitude, self.origin), log_pressure)
        return _product(values, self.lasting)

    def passing_at(self, latitude: Floats, longitude: Floats) -> tuple[Short, Floats]:
        """Functions of the passing part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 4)
            The values of a place sum to one.
        """
        return _product((latitude, _eastward(longitude, self.origin)), self.passing)

    def cells(self, latitude: Floats, longitude: Floats, segment: Ints) -> Ints:
        """Number of the region and segment of some places: segment times regions, and the region.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        segment : array of int, shape (n,)

        Returns
        -------
        array of int, shape (n,)
        """
        if self.regions == 1:
            return segment
        found = np.zeros(segment.size, dtype=np.int64)
        shift = (segment % SHIFTS) / SHIFTS
        places = (latitude, _eastward(longitude, self.origin))
        for values, nodes, parts in zip(places, self.passing, self.cuts, strict=True):
            if parts > 1:
                width = float(nodes[-1] - nodes[0]) / parts
                own = np.floor((values - nodes[0]) / width + shift).astype(np.int64)
                found = found * (parts + 1) + np.clip(own, 0, parts)
        return np.asarray(segment * np.int64(self.regions) + found)


def _middle(longitude: Floats) -> float:
    """Longitude opposite the widest gap; where all are flown, opposite the fewest blocks."""
    degree = np.floor(longitude % 360.0).astype(np.int64) % 360
    count = np.bincount(degree, minlength=360)
    least = np.tile(count == count.min(), 2)
    # twice around, for the widest gap may lie across the meridian where counting begins
    run = np.zeros(720, dtype=np.int64)
    for k in range(1, 720):
        run[k] = (run[k - 1] + 1) * least[k]
    last = int(np.argmax(np.minimum(run, 360)))
    return (last + 1 - float(run[last]) / 2.0 + 180.0) % 360.0


def _eastward(longitude: Floats, origin: tuple[float, float]) -> Floats:
    """Degrees of great circle east of the middle, without a jump at the antimeridian."""
    return np.asarray(wrap_degrees(longitude - origin[0]) * origin[1])


def _even(values: Floats) -> Floats:
    low, high = float(values.min()), float(values.max())
    count = max(2, round((high - low) / (SPACING_KM / KM_A_DEGREE)) + 1)
    return np.linspace(low, high, count) if high > low else np.array([low])


def _product(values: tuple[Floats, ...], nodes: tuple[Floats, ...]) -> tuple[Short, Floats]:
    """Products of the hats of every coordinate."""
    size = values[0].size
    index, value = np.zeros((size, 1), dtype=np.int32), np.ones((size, 1))
    for one, knots in zip(values, nodes, strict=True):
        left, share = hats_not_zero(one, knots)
        old, each = index.shape[1], left.shape[1]
        first, factor = index * np.int32(knots.size), value
        index, value = np.empty((size, old * each), np.int32), np.empty((size, old * each))
        # column by column: loops over the few functions of one place are slow
        for k, j in np.ndindex(old, each):
            np.add(first[:, k], left[:, j], out=index[:, k * each + j])
            np.multiply(factor[:, k], share[:, j], out=value[:, k * each + j])
    return index, value
