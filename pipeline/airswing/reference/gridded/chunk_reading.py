"""Values of stored fields at points, each chunk of a file read once whatever asks for it.

Many model times, levels and reports share a chunk. All that is wanted is gathered first, sorted by
chunk, and read chunk by chunk: of each only the box that holds what is wanted, and never two at a
time. A field stored in one piece is read as the box of its wanted points.

Assumptions and validity
------------------------
* A chunk is as long along each dimension as `StoredField.chunks` says; were it wrong, values would
  be the same and reading slower.
* Sums (staggered neighbours, P + PB) have two parts at most: their order changes no bit.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.reference.gridded.raw_chunks import RawVariable, raw_variable
from airswing.reference.gridded.stored import StoredField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Chunk = tuple[str, tuple[int, ...]]  # Variable, and the chunk's number along each of its dimensions


class _Piece(NamedTuple):
    """Part of what one request wants of one chunk: where it lies, and where it goes."""

    at: dict[str, int]  # index along each dimension that is not rows or columns
    j: Ints  # rows and columns
    i: Ints
    target: Floats  # the request's array, and the places in it
    places: Ints | slice
    weight: float  # of the value in the sum


@dataclass
class Account:
    """What reading took: chunks, octets as they are in memory before unpacking, seconds."""

    chunks: int = 0
    octets: int = 0
    seconds: float = 0.0
    problems: dict[str, None] = field(default_factory=dict)


class Wants:
    """All that is wanted of one Dataset, by chunk."""

    def __init__(self) -> None:
        self._pieces: dict[tuple[int, Chunk], list[_Piece]] = defaultdict(list)
        self._fields: dict[int, StoredField] = {}
        self._starts: dict[tuple[int, str], Ints] = {}
        self._sorted: dict[object, list[tuple[int, int, Ints, Ints, Ints]]] = {}
        self._kept: list[Ints] = []

    def add(self, stored: StoredField, row: np.void, points: Ints, columns: int) -> Floats:
        """Want the values of a field at points, row after row of a grid with so many columns.

        The array given, zeros, takes the values in :meth:`read`.
        """
        target, number = np.zeros(points.shape), int(row["offset"])
        self._fields[number] = stored
        at = {
            dim: int(place)
            for (dim, _), place in zip(
                stored.outer, stored.outer_places(int(row["index"])), strict=True
            )
        }
        if stored.level:
            at[stored.level] = int(row["level_index"])
        # Staggered points lie between: the mean of two neighbours counts.
        shifts = {"": [(0, 0)], "x": [(0, 0), (0, 1)], "y": [(0, 0), (1, 0)]}[stored.stagger]
        for down, along in shifts:
            for cj, ci, j, i, places in self._by_chunk(number, points, columns, down, along):
                for name in stored.names:
                    chunk = name, self._number(number, at, cj, ci)
                    self._pieces[number, chunk].append(
                        _Piece(at, j, i, target, places, 1.0 / len(shifts))
                    )
        return target

    def _ends(self, number: int, dim: str) -> Ints:
        key = number, dim
        if key not in self._starts:
            self._starts[key] = self._fields[number].starts(dim)
        return self._starts[key]

    def _number(self, field: int, at: dict[str, int], cj: int, ci: int) -> tuple[int, ...]:
        """Number of a chunk along each dimension."""
        stored = self._fields[field]
        found = {stored.y: cj, stored.x: ci}
        for dim, place in at.items():
            found[dim] = int(np.searchsorted(self._ends(field, dim), place, side="right")) - 1
        return tuple(found.get(dim, 0) for dim in stored.dims)

    def _by_chunk(
        self, field: int, points: Ints, columns: int, down: int, along: int
    ) -> list[tuple[int, int, Ints, Ints, Ints]]:
        """Points by chunk of rows and columns; remembered for the fields that share them."""
        stored = self._fields[field]
        rows, cols = self._ends(field, stored.y), self._ends(field, stored.x)
        key = (id(points), columns, down, along, rows.tobytes(), cols.tobytes())
        if key in self._sorted:
            return self._sorted[key]
        self._kept.append(points)  # so that its identity is not given to another array
        j, i = np.divmod(points, columns)
        j, i = j + down, i + along
        cj = np.searchsorted(rows, j, side="right") - 1
        ci = np.searchsorted(cols, i, side="right") - 1
        number = cj * cols.size + ci
        # chunk by chunk: each is read once, whatever is wanted of it
        order = np.argsort(number, kind="stable")
        found = []
        for own in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
            if own.size:
                found.append((int(cj[own[0]]), int(ci[own[0]]), j[own], i[own], own))
        self._sorted[key] = found
        return found

    def give_up(self) -> None:
        """Give no value to anything that is wanted."""
        for pieces in self._pieces.values():
            for piece in pieces:
                piece.target[piece.places] = np.nan

    def read(self, ds: xr.Dataset, account: Account) -> None:
        """Read every chunk that is wanted, put the values where they go, and account for it."""
        known: dict[tuple[int, str], RawVariable | None] = {}
        for (number, (name, chunk)), pieces in self._pieces.items():
            stored, key = self._fields[number], (number, name)
            if key not in known:
                known[key] = None if stored.either else raw_variable(ds, name, stored.chunks)
            began = time.perf_counter()
            try:
                octets = _as_stored(known[key], stored, chunk, pieces) or _by_library(
                    ds.variables[name], stored, pieces
                )
            except Exception as error:  # each backend raises its own
                account.problems[f"{name}: cannot be read: {_short(error)}"] = None
                for piece in pieces:
                    piece.target[piece.places] = np.nan
                continue
            account.seconds += time.perf_counter() - began
            account.chunks += 1
            account.octets += octets
        self._pieces.clear()
        self._sorted.clear()
        self._kept.clear()


def _by_library(variable: xr.Variable, stored: StoredField, pieces: list[_Piece]) -> int:
    """Read the box that holds all pieces by xarray, and put them in their places."""
    box = _box(stored, pieces)
    values = _load(variable[tuple(box[d] for d in stored.dims)])
    for piece in pieces:
        _put(stored, piece, values, box)
    return values.size * _width(variable)


def _as_stored(
    raw: RawVariable | None, stored: StoredField, chunk: tuple[int, ...], pieces: list[_Piece]
) -> int:
    """Expand a chunk once, and take the values of all pieces out of it; 0 where that cannot be."""
    if raw is None:
        return 0
    begins = tuple(n * length for n, length in zip(chunk, raw.chunks, strict=True))
    # Values that one step along each dimension passes over, in C order.
    steps = np.append(np.cumprod(raw.chunks[:0:-1])[::-1], 1).astype(np.int64)
    flats: list[Ints] = []
    for piece in pieces:
        flat: Ints = np.zeros(piece.j.shape, dtype=np.int64)
        for dim, begin, step in zip(stored.dims, begins, steps, strict=True):
            where = piece.j if dim == stored.y else piece.i if dim == stored.x else piece.at[dim]
            flat += (where - begin) * step
        flats.append(flat)
    values = raw.values(begins, np.concatenate(flats))
    if values is None:
        return 0
    ends = np.cumsum([flat.size for flat in flats])[:-1]
    for piece, found in zip(pieces, np.split(values, ends), strict=True):
        piece.target[piece.places] += piece.weight * found
    return int(np.prod(raw.chunks)) * raw.dtype.itemsize


def _box(stored: StoredField, pieces: list[_Piece]) -> dict[str, slice]:
    """The part of a chunk that holds all pieces."""
    box = {d: slice(0, size) for d, size in zip(stored.dims, stored.shape, strict=True)}
    for dim in pieces[0].at:
        numbers = [piece.at[dim] for piece in pieces]
        box[dim] = slice(min(numbers), max(numbers) + 1)
    for dim, places in (
        (stored.y, [piece.j for piece in pieces]),
        (stored.x, [piece.i for piece in pieces]),
    ):
        low, high = min(int(p.min()) for p in places), max(int(p.max()) for p in places)
        box[dim] = slice(low, high + 1)
    return box


def _put(
    stored: StoredField, piece: _Piece, values: NDArray[np.generic], box: dict[str, slice]
) -> None:
    """Add the wanted values to their places."""
    index: list[Ints | slice | int] = []
    for dim in stored.dims:
        if dim == stored.y:
            index.append(piece.j - box[dim].start)
        elif dim == stored.x:
            index.append(piece.i - box[dim].start)
        elif dim in piece.at:
            index.append(piece.at[dim] - box[dim].start)
        elif dim == stored.either:
            index.append(slice(None))
        else:
            index.append(0)
    if stored.either in stored.dims:
        axis = stored.dims.index(stored.either)
        found = np.moveaxis(values, axis, 0)
        del index[axis]
        chosen = [np.asarray(one[tuple(index)], dtype=np.float64) for one in found]
        taken = chosen[0]
        for other in chosen[1:]:
            taken = np.where(np.isnan(taken), other, taken)
    else:
        taken = np.asarray(values[tuple(index)], dtype=np.float64)
    piece.target[piece.places] += piece.weight * taken


def _load(variable: xr.Variable) -> NDArray[np.generic]:
    """Values of a part, in this thread."""
    if variable.chunks is not None:
        return np.asarray(variable.data.compute(scheduler="synchronous"))
    return np.asarray(variable.values)


def _width(variable: xr.Variable) -> int:
    """Octets of one value as it is stored."""
    stored = variable.encoding.get("dtype", variable.dtype)
    return int(np.dtype(stored).itemsize) if stored is not str else 8


def _short(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
