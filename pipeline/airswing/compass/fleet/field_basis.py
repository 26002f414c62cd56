"""Basis functions of the reference's error: hat functions between nodes over a region.

Assumes places given by latitude, longitude (degrees) and ln p. The seam of longitude lies where
the fewest blocks are, so that the date line and a hemisphere need no special case.

A passing part of more than `MOST_NODES` nodes is divided into regions: within a segment, blocks of
different regions are taken as independent, although nodes reach over the border (a node belongs to
each region with blocks near it). The borders move from one segment to the next, so that the regions
of five segments overlap and no place is always at a border. The lasting part is never divided.
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

SPACING = 400e3 / METRES_PER_DEGREE
"""Degrees between the nodes of the passing part (400 km): the scale of a model's synoptic error."""
STATIC_NODES = (4, 5, 3)
"""Least numbers of nodes of the lasting part in latitude, longitude and ln p, at quantiles of the
blocks."""
STATIC_SPACING = 2000e3 / METRES_PER_DEGREE
"""Degrees (2000 km) for which there is one node more in latitude and longitude."""
MOST_NODES = 400
"""Nodes of the passing part in one region: a square of 8,000 km. Their covariance takes the square
of their number in each segment, its inverse the cube."""
SHIFTS = 5
"""Positions that the borders of regions take in turn; no divisor of the four segments of a day."""


@dataclass(frozen=True)
class FieldBasis:
    """Nodes of the lasting and the passing part of the field."""

    lasting: tuple[Floats, ...]  # nodes in latitude, eastward degrees and ln p
    passing: tuple[Floats, ...]  # nodes in latitude and eastward degrees
    origin: tuple[float, float]  # longitude of the middle, cosine of the middle latitude

    @classmethod
    def of(cls, latitude: Floats, longitude: Floats, log_pressure: Floats) -> FieldBasis:
        """Place the nodes for some blocks.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        log_pressure : array of float, shape (n,)
        """
        origin = (_middle(longitude), float(np.cos(np.radians(np.median(latitude)))))
        east = _eastward(longitude, origin)
        places = (latitude, east, log_pressure)
        apart = (STATIC_SPACING, STATIC_SPACING, np.inf)
        lasting = tuple(
            np.unique(
                np.quantile(values, np.linspace(0, 1, max(nodes, 1 + int(np.ptp(values) // step))))
            )
            for values, nodes, step in zip(places, STATIC_NODES, apart, strict=True)
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
        """Numbers of parts into which the passing part is divided in latitude and eastward."""
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
        """Number of regions of a segment; shifted borders add one on each axis."""
        return int(np.prod([parts + (parts > 1) for parts in self.cuts]))

    @property
    def region_size(self) -> int:
        """Largest number of functions of the passing part in one region."""
        found = 1
        for nodes, parts in zip(self.passing, self.cuts, strict=True):
            # with the nodes beyond both borders
            found *= min(nodes.size, -(-(nodes.size - 1) // parts) + 2)
        return found

    def lasting_at(
        self, latitude: Floats, longitude: Floats, log_pressure: Floats
    ) -> tuple[Short, Floats]:
        """Return the functions of the lasting part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 8)
            The values at a place add up to one.
        """
        return _product((latitude, _eastward(longitude, self.origin), log_pressure), self.lasting)

    def passing_at(self, latitude: Floats, longitude: Floats) -> tuple[Short, Floats]:
        """Return the functions of the passing part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 4)
            The values at a place add up to one.
        """
        return _product((latitude, _eastward(longitude, self.origin)), self.passing)

    def cells(self, latitude: Floats, longitude: Floats, segment: Ints) -> Ints:
        """Return the region of some places in their segments.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        segment : array of int, shape (n,)

        Returns
        -------
        array of int, shape (n,)
            Segment times number of regions, plus the region.
        """
        if self.regions == 1:
            return segment
        found = np.zeros(segment.size, dtype=np.int64)
        shift = (segment % SHIFTS) / SHIFTS
        places = (latitude, _eastward(longitude, self.origin))
        for values, nodes, parts in zip(places, self.passing, self.cuts, strict=True):
            if parts > 1:
                width = float(nodes[-1] - nodes[0]) / parts
                part = np.floor((values - nodes[0]) / width + shift).astype(np.int64)
                found = found * (parts + 1) + np.clip(part, 0, parts)
        return np.asarray(segment * np.int64(self.regions) + found)


def _middle(longitude: Floats) -> float:
    """Longitude opposite the widest gap; where there is none, opposite the fewest blocks."""
    degree = np.floor(longitude % 360.0).astype(np.int64) % 360
    count = np.bincount(degree, minlength=360)
    least = np.tile(count == count.min(), 2)
    # twice around, for a gap across the meridian where counting begins
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
    count = max(2, round((high - low) / SPACING) + 1)
    return np.linspace(low, high, count) if high > low else np.array([low])


def _product(values: tuple[Floats, ...], nodes: tuple[Floats, ...]) -> tuple[Short, Floats]:
    """Products of the hat functions of every coordinate."""
    index = np.zeros((values[0].size, 1), dtype=np.int32)
    value = np.ones((values[0].size, 1))
    for coordinate, knots in zip(values, nodes, strict=True):
        left, share = hats_not_zero(coordinate, knots)
        index = (index * np.int32(knots.size))[:, :, np.newaxis] + left[:, np.newaxis]
        value = value[:, :, np.newaxis] * share[:, np.newaxis]
        index, value = index.reshape(len(index), -1), value.reshape(len(value), -1)
    return index, value
