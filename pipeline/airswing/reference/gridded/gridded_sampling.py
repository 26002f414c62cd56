"""Some model times of a Dataset in, winds at their reports out.

Model times that share chunks are sampled together: each says what it needs
(:func:`airswing.reference.geometry.winds.winds_at`), the chunks are read once for all, and each is
given its values; for native levels first the pressures, then the winds.

Assumptions and validity
------------------------
* A file is the one that was catalogued where its size and modification time are the same; else,
  and where a chunk cannot be read, its reports get no value and the problem is noted.
* Results are the same bit for bit however reports and model times are divided among calls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.geometry.model_time import NOT_OPENED, REPLACED, Sample, SourceFile
from airswing.reference.geometry.winds import Asked, Winds, winds_at
from airswing.reference.gridded.chunk_reading import Account, Wants
from airswing.reference.gridded.opening import is_same, opened
from airswing.reference.gridded.stored import GriddedTime, StoredField

Floats = NDArray[np.float64]
Places = tuple[Floats, Floats, Floats]
"""Latitudes, longitudes (degrees) and pressures (Pa) of reports."""
GIVEN = "given"
"""Engine of Datasets given in Python."""


class _Reader:
    """Values for several model times at a time, with problems noted once."""

    def __init__(self, engine: str, given: Mapping[str, xr.Dataset]) -> None:
        self.engine, self.given = engine, given
        self.account = Account()
        self.problems: dict[tuple[str, str], None] = {}
        self._known: dict[SourceFile, list[xr.Dataset] | None] = {}

    def datasets(self, file: SourceFile) -> list[xr.Dataset] | None:
        """Datasets of a file, None where it is gone or another."""
        if file not in self._known:
            self._known[file] = self._open(file)
        return self._known[file]

    def _open(self, file: SourceFile) -> list[xr.Dataset] | None:
        if self.engine == GIVEN:
            return [self.given[file.path]]
        try:
            if not is_same(file):
                self.problems[file.path, REPLACED] = None
                return None
            return opened(file, self.engine)
        except OSError as error:
            self.problems[file.path, f"{NOT_OPENED}: {error.strerror}"] = None
        except InputError as error:
            self.problems[file.path, f"{NOT_OPENED}: {error.found}"] = None
        return None

    def answer(self, models: Sequence[GriddedTime], asked: Sequence[Asked]) -> list[list[Floats]]:
        """Values of all that several model times ask for."""
        wants: dict[tuple[SourceFile, int], Wants] = {}
        targets: list[list[tuple[np.void, StoredField, Floats]]] = []
        seen: dict[object, Floats] = {}
        for model, wanted in zip(models, asked, strict=True):
            own = []
            for row, points in wanted:
                stored = model.fields[int(row["offset"])]
                place = model.files[int(row["file"])], int(row["part"])
                # A surface pressure serves every level.
                numbers = (int(row[c]) for c in ("offset", "index", "level_index"))
                key = (place, *numbers, id(points))
                if key not in seen:
                    want = wants.setdefault(place, Wants())
                    seen[key] = want.add(stored, row, points, model.grid.ni)
                own.append((row, stored, seen[key]))
            targets.append(own)
        for (file, part), want in wants.items():
            self._read(file, part, want)
        return [[_finished(*one) for one in own] for own in targets]

    def _read(self, file: SourceFile, part: int, want: Wants) -> None:
        found = self.datasets(file)
        if found is None:
            want.give_up()
            return
        want.read(found[part], self.account)
        for problem in self.account.problems:
            self.problems[file.path, problem] = None
        self.account.problems.clear()


def _finished(row: np.void, stored: StoredField, values: Floats) -> Floats:
    """Values in SI units; of a pressure by its level's formula."""
    values = values * stored.scale if stored.scale != 1.0 else values
    if stored.exponential:
        with np.errstate(over="ignore"):
            values = np.exp(values)
    if row["kind"] < 2:
        return values
    return values if row["a"] == 0.0 and row["b"] == 1.0 else row["a"] + row["b"] * values


def sample_gridded(
    models: Sequence[GriddedTime],
    places: Sequence[Places],
    *,
    derivatives: bool = False,
    given: Mapping[str, xr.Dataset] | None = None,
) -> list[Sample]:
    """Winds of some model times of one reference at their reports.

    Parameters
    ----------
    places : sequence of (latitude, longitude, pressure)
        Degrees and Pa, of each model time.
    derivatives : bool
        As for :func:`airswing.reference.geometry.winds.winds_at`.
    given : mapping of str to Dataset, optional
        Datasets given in Python, by the path their catalogue has.

    Returns
    -------
    list of Sample
        What reading took stands in the first.
    """
    if not models:
        return []
    reader = _Reader(models[0].engine, given or {})
    work = [
        winds_at(model, *where, derivatives=derivatives)
        for model, where in zip(models, places, strict=True)
    ]
    tables: list[Floats] = [np.empty((0, 0))] * len(work)
    asked: dict[int, Asked] = {}
    for number, one in enumerate(work):
        _advance(number, one, None, asked, tables)
    while asked:
        waiting = sorted(asked)
        answers = reader.answer([models[n] for n in waiting], [asked.pop(n) for n in waiting])
        for number, values in zip(waiting, answers, strict=True):
            _advance(number, work[number], values, asked, tables)
    samples = [Sample(table, tuple(reader.problems), 0) for table in tables]
    account = reader.account
    samples[0] = samples[0]._replace(
        decoded=account.chunks, octets=account.octets, seconds=account.seconds
    )
    return samples


def _advance(
    number: int,
    work: Winds,
    values: list[Floats] | None,
    asked: dict[int, Asked],
    tables: list[Floats],
) -> None:
    """Let one model time go on until it asks again or is done."""
    try:
        asked[number] = next(work) if values is None else work.send(values)
    except StopIteration as done:
        tables[number] = done.value
