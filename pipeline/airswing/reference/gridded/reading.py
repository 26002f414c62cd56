"""Values of stored fields of Datasets at grid points, through xarray.

The requests of several model times are collected and read chunk by chunk along time, member and
level; of rows and columns the box around all points is read. So no chunk of a file is decompressed
twice for one batch of model times.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.files import NOT_OPENED, REPLACED, SourceFile, is_same
from airswing.reference.gridded.opening import opened
from airswing.reference.grids import Floats, Ints
from airswing.reference.profiles import GIVEN, PRESSURE, ModelTime, StoredField
from airswing.reference.winds import MAX_PRESSURE, MAX_WIND, Request


class _Piece(NamedTuple):
    """Request for the values of one field: where they are, and the array that takes them."""

    at: dict[str, int]  # index along each dimension that is not rows or columns
    j: Ints
    i: Ints
    target: Floats


class DatasetReader:
    """Values of the fields of model times at grid points; problems are noted once.

    Parameters
    ----------
    given : mapping of str to Dataset
        Datasets given in Python, by the path that their catalogue has.
    """

    def __init__(self, given: Mapping[str, xr.Dataset]) -> None:
        self.given = given
        self.problems: dict[tuple[str, str], None] = {}
        self.decoded = self.n_bytes = 0
        self.seconds = 0.0
        self._known: dict[SourceFile, list[xr.Dataset] | None] = {}

    def close(self) -> None:
        """Forget the Datasets."""
        self._known.clear()

    def answer(self, models: Sequence[ModelTime], asked: Sequence[Request]) -> list[list[Floats]]:
        """Values of all requests of some model times; NaN if a field cannot be read."""
        pieces: dict[tuple[SourceFile, int, StoredField], list[_Piece]] = defaultdict(list)
        seen: dict[object, Floats] = {}
        answers: list[list[tuple[np.void, StoredField, Floats]]] = []
        engine = models[0].engine if models else ""
        for model, wanted in zip(models, asked, strict=True):
            mine = []
            for row, points in wanted:
                stored, file = model.stored[int(row["offset"])], model.files[int(row["file"])]
                # one surface pressure serves every level
                numbers = (int(row[c]) for c in ("part", "offset", "index", "level_index"))
                key = (file, *numbers, id(points))
                if key not in seen:
                    seen[key] = np.zeros(points.shape)
                    columns = model.grids[min(int(row["kind"]), PRESSURE)].ni
                    pieces[file, int(row["part"]), stored].append(
                        _piece(stored, row, points, columns, seen[key])
                    )
                mine.append((row, stored, seen[key]))
            answers.append(mine)
        began = time.perf_counter()
        for (file, part, stored), together in pieces.items():
            self._read(file, part, stored, together, engine)
        self.seconds += time.perf_counter() - began
        return [[_in_si(*one) for one in mine] for mine in answers]

    def _datasets(self, file: SourceFile, engine: str) -> list[xr.Dataset] | None:
        """Datasets of a file; None if it is gone or was replaced."""
        if engine == GIVEN:
            return [self.given[file.path]]
        if file not in self._known:
            self._known[file] = None
            try:
                if is_same(file):
                    self._known[file] = opened(file, engine)
                else:
                    self.problems[file.path, REPLACED] = None
            except OSError as error:
                self.problems[file.path, f"{NOT_OPENED}: {error.strerror}"] = None
            except InputError as error:
                self.problems[file.path, f"{NOT_OPENED}: {error.found}"] = None
        return self._known[file]

    def _read(
        self, file: SourceFile, part: int, stored: StoredField, pieces: list[_Piece], engine: str
    ) -> None:
        datasets = self._datasets(file, engine)
        if datasets is None:
            for piece in pieces:
                piece.target[...] = np.nan
            return
        chunks: dict[tuple[int, ...], list[_Piece]] = defaultdict(list)
        for piece in pieces:
            number = [
                int(np.searchsorted(starts, piece.at[dim], side="right")) if dim in piece.at else 0
                for dim, starts in zip(stored.dims, stored.chunks, strict=True)
            ]
            chunks[tuple(number)].append(piece)
        for together in chunks.values():
            for name in stored.names:
                try:
                    self.n_bytes += _add(datasets[part].variables[name], stored, together)
                    self.decoded += 1
                except Exception as error:  # each backend raises its own
                    reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
                    self.problems[file.path, f"{name}: cannot be read: {reason}"] = None
                    for piece in together:
                        piece.target[...] = np.nan


def _piece(stored: StoredField, row: np.void, points: Ints, columns: int, target: Floats) -> _Piece:
    at = {dim: int(place) for dim, place in stored.outer_places(row["index"])}
    if stored.level:
        at[stored.level] = int(row["level_index"])
    j, i = np.divmod(points, columns)
    return _Piece(at, j, i, target)


def _add(variable: xr.Variable, stored: StoredField, pieces: list[_Piece]) -> int:
    """Read the box around all pieces and add their values to the targets; bytes read."""
    down, along = int(stored.stagger == "y"), int(stored.stagger == "x")
    box = {d: slice(0, size) for d, size in zip(stored.dims, stored.shape, strict=True)}
    for dim in pieces[0].at:
        numbers = [piece.at[dim] for piece in pieces]
        box[dim] = slice(min(numbers), max(numbers) + 1)
    box[stored.y] = _span([piece.j for piece in pieces], down)
    box[stored.x] = _span([piece.i for piece in pieces], along)
    part = variable[tuple(box[d] for d in stored.dims)]
    if part.chunks is not None:
        values = np.asarray(part.data.compute(scheduler="synchronous"))
    else:
        values = np.asarray(part.values)
    for piece in pieces:
        taken = _taken(stored, piece, values, box, 0, 0)
        if stored.stagger:  # points lie between: the mean of the two neighbours
            taken = 0.5 * taken + 0.5 * _taken(stored, piece, values, box, down, along)
        piece.target[...] += taken
    return values.size * values.dtype.itemsize


def _span(places: list[Ints], further: int) -> slice:
    low, high = min(int(p.min()) for p in places), max(int(p.max()) for p in places)
    return slice(low, high + 1 + further)


def _taken(
    stored: StoredField,
    piece: _Piece,
    values: NDArray[np.generic],
    box: dict[str, slice],
    down: int,
    along: int,
) -> Floats:
    """The values of a piece from those of a box."""
    place: dict[str, Ints | int] = {d: n - box[d].start for d, n in piece.at.items()}
    place[stored.y], place[stored.x] = (
        piece.j - box[stored.y].start + down,
        (piece.i - box[stored.x].start + along),
    )
    if stored.either in stored.dims:
        # each time is in one of the alternatives: the first that is not missing counts
        values = np.moveaxis(values, stored.dims.index(stored.either), 0)
        index = tuple(place.get(d, 0) for d in stored.dims if d != stored.either)
        chosen = [np.asarray(one[index], dtype=np.float64) for one in values]
        taken = chosen[0]
        for other in chosen[1:]:
            taken = np.where(np.isnan(taken), other, taken)
        return taken
    index = tuple(place.get(d, 0) for d in stored.dims)
    return np.asarray(values[index], dtype=np.float64)


def _in_si(row: np.void, stored: StoredField, values: Floats) -> Floats:
    """Values in SI units; of a pressure by its level's formula."""
    if stored.scale != 1.0:
        values = values * stored.scale
    if stored.exponential:
        with np.errstate(over="ignore"):
            values = np.exp(values)
    if row["kind"] < PRESSURE:
        low, high = -MAX_WIND, MAX_WIND
    else:
        values, low, high = row["a"] + row["b"] * values, 0.0, MAX_PRESSURE
    # fill values that no attribute names would be interpolated
    with np.errstate(invalid="ignore"):
        return np.where((values >= low) & (values <= high), values, np.nan)
