"""Catalogue of a reference: where the wind profile of each valid time is stored; nothing decoded.

A row is one field of one level; a profile is the u and v of all levels of one valid time, lead,
member and grid, with the pressure of each level where levels are not isobaric.

Assumptions and validity
------------------------
* A level with u but no v (or v but no u) is no wind; nor is a native level without a pressure.
* u and v (and pressure) may lie on grids that are shifted against each other by up to a grid
  length, or stored in another order: each is then interpolated on its own points.
* Among several leads for one valid time the shortest that meets the condition is used; among
  members of an ensemble the lowest number; isobaric levels before others; then the grid with most
  levels. Of grids with equally many levels the one that contains more of the reports is used.
* Of a field that is given twice, copies count once (the file whose path sorts last); if the values
  differ, neither is used, because one of the two headers must be wrong.
* Files that keep their size and time of modification keep their content.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.lead_times import Wanted
from airswing.reference.grids import Grid, are_shifted

Table = NDArray[np.void]
Floats = NDArray[np.float64]

U, V, PRESSURE, SURFACE = 0, 1, 2, 3
"""Kinds of field; SURFACE is the surface pressure of hybrid levels."""
ISOBARIC, HYBRID = 0, 1
"""Kinds of level; further ones are GRIB level types."""
GIVEN = "given"
"""Engine of Datasets given in Python."""
NOT_OPENED, REPLACED = "cannot be opened", "replaced since it was catalogued"
ZARR_MARKS = (".zmetadata", ".zgroup", "zarr.json")


class SourceFile(NamedTuple):
    """A file as the catalogue saw it; `sample` is a hash of parts of its content."""

    path: str
    size: int
    mtime_ns: int
    sample: str


class LeftOut(TypedDict):
    """A part of a model file that gave no wind: file, kind of part, reason, and how often."""

    file: str
    what: str
    reason: str
    count: int


Skipped = list[LeftOut]


class StoredField(NamedTuple):
    """How the fields of one variable of a Dataset are read."""

    names: tuple[str, ...]  # variables, summed
    dims: tuple[str, ...]
    outer: tuple[tuple[str, int], ...]  # dimensions that a row's `index` counts, and their sizes
    level: str  # dimension of the levels (empty without), of rows and of columns
    y: str
    x: str
    shape: tuple[int, ...]
    chunks: tuple[tuple[int, ...], ...]  # start of every chunk along each dimension, and the end
    scale: float = 1.0  # to SI units
    # "x" or "y": points lie half a grid length before the grid's along this axis, and one more
    # follows the last: the mean of two neighbours counts
    stagger: str = ""
    exponential: bool = False  # the logarithm is stored
    either: str = ""  # dimension along which the first value that is not missing counts


#: `index` counts the fields of a variable over its outer dimensions, `level_index` its levels; the
#: value of a pressure is ``a + b * field``. `offset` numbers the stored field.
ROW_DTYPE = np.dtype(
    [
        *[(name, "i4") for name in ("file", "offset", "member", "grid", "points")],
        *[(name, "i4") for name in ("index", "level_index")],
        *[(name, "i2") for name in ("part", "kind", "level_kind")],
        *[(name, "f8") for name in ("level", "a", "b")],
        *[(name, "i8") for name in ("valid", "lead")],
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class ModelTime:
    """The wind profile of one valid time, small enough to send to another process.

    Rows of u, v and pressure are those of the catalogue, one a level; isobaric levels by increasing
    pressure. `pressure` is empty for isobaric levels.
    """

    valid: int  # ns since 1970
    lead: int  # s
    grids: tuple[Grid, Grid, Grid]  # of u, v and pressure
    native: bool  # levels have a pressure field
    u: Table
    v: Table
    pressure: Table
    files: tuple[SourceFile, ...]  # as the rows' ``file`` numbers them
    stored: tuple[StoredField, ...] = ()  # as the rows' ``offset`` numbers them; empty for GRIB
    engine: str = "grib"

    @property
    def grid(self) -> Grid:
        """Grid of u."""
        return self.grids[0]


@dataclass(eq=False, repr=False)
class Catalogue:
    """Wind profiles of one reference, by valid time."""

    name: str
    lead: str  # the condition on leads
    files: tuple[SourceFile, ...]  # every file that could be opened
    grids: tuple[Grid, ...]
    valid: NDArray[np.int64]  # ns since 1970, increasing, (time,) as all that follow
    leads: NDArray[np.int64]  # s
    members: NDArray[np.int64]
    grid_numbers: NDArray[np.int64]
    level_kinds: NDArray[np.int64]
    bounds: NDArray[np.int64]  # rows of each model time below, (time + 1,)
    u: Table
    v: Table
    pressure: Table
    skipped: Skipped = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # choices made between candidates
    messages: int = 0
    given: dict[str, xr.Dataset] = field(default_factory=dict)  # by the path in `files`
    stored: tuple[StoredField, ...] = ()
    engine: str = "grib"
    # the same with another of several grids that have equally many levels
    alternatives: tuple[Catalogue, ...] = ()

    def __len__(self) -> int:
        return int(self.valid.size)

    def __repr__(self) -> str:
        span = " to ".join(np.datetime_as_string(self.times[[0, -1]], "m")) if len(self) else "none"
        counted = f"{len(self)} model times of {len(self.files)} files"
        return f"<{type(self).__name__} {self.name!r}: {counted}, {span}, lead {self.lead}>"

    @property
    def times(self) -> NDArray[np.datetime64]:
        """Valid times, increasing."""
        return self.valid.astype("datetime64[ns]")

    def rows(self, number: int) -> slice:
        """Rows of a model time."""
        return slice(int(self.bounds[number]), int(self.bounds[number + 1]))

    def model_time(self, number: int) -> ModelTime:
        """One model time with the files it needs."""
        rows, native = self.rows(number), bool(self.level_kinds[number] != ISOBARIC)
        pressure = self.pressure[rows] if native else self.pressure[:0]
        tables = [self.u[rows].copy(), self.v[rows].copy(), pressure.copy()]
        grids = [self.grids[int(t["points"][0])] for t in tables[: 3 if native else 2]]
        # its own files only: a year's list would go along with each of its thousands of hours
        used = np.unique(np.concatenate([t["file"] for t in tables]))
        for table in tables:
            table["file"] = np.searchsorted(used, table["file"])
        return ModelTime(
            valid=int(self.valid[number]),
            lead=int(self.leads[number]),
            grids=(grids[0], grids[1], grids[-1] if native else grids[0]),
            native=native,
            u=tables[0],
            v=tables[1],
            pressure=tables[2],
            files=tuple(self.files[int(i)] for i in used),
            stored=self.stored,
            engine=self.engine,
        )

    def levels(self, number: int) -> Floats:
        """Levels of a model time: Pa, or level numbers."""
        return np.asarray(self.u["level"][self.rows(number)], dtype=np.float64)

    def at_times(self, numbers: NDArray[np.int64]) -> Catalogue:
        """The catalogue of some of its model times."""
        rows = [np.arange(self.bounds[n], self.bounds[n + 1]) for n in numbers.tolist()]
        chosen = np.concatenate([*rows, np.empty(0, dtype=np.int64)])
        sizes = [0, *(one.size for one in rows)]
        return replace(
            self,
            valid=self.valid[numbers],
            leads=self.leads[numbers],
            members=self.members[numbers],
            grid_numbers=self.grid_numbers[numbers],
            level_kinds=self.level_kinds[numbers],
            bounds=np.cumsum(sizes).astype(np.int64),
            u=self.u[chosen],
            v=self.v[chosen],
            pressure=self.pressure[chosen],
            alternatives=tuple(one.at_times(numbers) for one in self.alternatives),
        )

    def for_places(self, latitude: Floats, longitude: Floats) -> Catalogue:
        """The catalogue with the grid that contains most places (degrees); the finer if equal."""
        if not self.alternatives or not len(self):
            return self

        def worth(one: Catalogue) -> tuple[int, float]:
            grid = one.grids[int(one.grid_numbers[0])]
            south, north, west, east = grid.outline()
            area = (north - south) * (east - west) / grid.size
            return int(grid.contains(latitude, longitude).sum()), -area

        return max((self, *self.alternatives), key=worth)

    def batches(self, numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Model times that are read together: of Datasets those that share chunks of a file."""
        if not self.stored or not numbers.size:
            return [numbers[n : n + 1] for n in range(numbers.size)]
        first = self.u[self.bounds[numbers]]
        keys = np.zeros((numbers.size, 6), dtype=np.int64)
        keys[:, 0], keys[:, 1], keys[:, 2] = first["file"], first["part"], first["offset"]
        for offset in np.unique(first["offset"]):
            mine, stored = first["offset"] == offset, self.stored[int(offset)]
            for column, (dim, place) in enumerate(outer_places(stored, first["index"][mine])[:3]):
                starts = stored.chunks[stored.dims.index(dim)]
                keys[mine, 3 + column] = np.searchsorted(starts, place, side="right")
        _, group = np.unique(keys, axis=0, return_inverse=True)
        order = np.argsort(np.ravel(group), kind="stable")
        parts = np.split(numbers[order], np.flatnonzero(np.diff(np.ravel(group)[order])) + 1)
        return sorted(parts, key=lambda part: int(part[0]))

    def reading(self, number: int, needed: NDArray[np.bool_]) -> tuple[int, int, int]:
        """Fields, bytes and fields read at single points that some levels of a time need."""
        rows = self.rows(number)
        tables = [self.u[rows][needed], self.v[rows][needed]]
        if self.level_kinds[number] != ISOBARIC and needed.any():
            tables.append(self.pressure[rows])
        table = np.concatenate(tables)
        if self.stored:
            keys = np.unique(table[["file", "part", "offset", "index", "level_index"]])
            size = self.grids[int(self.grid_numbers[number])].size
            return keys.size, 4 * size * keys.size, 0
        n_bytes = int(np.unique(table[["file", "offset", "length"]])["length"].sum())
        return int(table.size), n_bytes, int(table["sparse"].sum())

    @property
    def fingerprint(self) -> str:
        """Hash of everything that collocation depends on."""
        digest = hashlib.blake2b(digest_size=16)
        known = (self.name, self.lead, self.files, self.grids, self.stored, self.engine)
        digest.update(repr(known).encode())
        for array in (self.valid, self.leads, self.bounds, self.u, self.v, self.pressure):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def changed(self) -> Skipped:
        """Files that vanished or were replaced since the catalogue was built."""
        result: Skipped = []
        for file in self.files if self.engine != GIVEN else ():
            try:
                if not is_same(file):
                    result.append(skip(file.path, "file", REPLACED))
            except OSError:
                result.append(skip(file.path, "file", "vanished since it was catalogued"))
        return result


def outer_places(
    stored: StoredField, index: NDArray[np.integer]
) -> list[tuple[str, NDArray[np.int64]]]:
    """Outer dimensions of a stored field and the indices along them of rows' `index`."""
    shape = tuple(size for _, size in stored.outer)
    if not shape:
        return []
    places = np.unravel_index(np.asarray(index), shape)
    return [(dim, np.asarray(place)) for (dim, _), place in zip(stored.outer, places, strict=True)]


def mark_of(path: str) -> str:
    """File whose size and time stand for a file or a Zarr store."""
    if os.path.isdir(path):
        marks = (os.path.join(path, mark) for mark in ZARR_MARKS)
        return next((mark for mark in marks if os.path.isfile(mark)), path)
    return path


def is_same(file: SourceFile) -> bool:
    """Whether a file has the size and time it was catalogued with; `OSError` if it is gone."""
    if "://" in file.path:
        return True
    status = os.stat(mark_of(file.path))
    return (status.st_size, status.st_mtime_ns) == (file.size, file.mtime_ns)


def is_lost_file(reason: str) -> bool:
    """Whether a problem is a file that vanished or changed, which may be there at the next run."""
    return reason.startswith((NOT_OPENED, REPLACED))


def skip(file: str, what: str, reason: str, count: int = 1) -> LeftOut:
    """One entry of `Catalogue.skipped`."""
    return {"file": file, "what": what, "reason": reason, "count": count}


_PROFILE = ("valid", "lead", "member", "level_kind", "grid")
_FIELD = (*_PROFILE, "level", "kind")


def _changes(table: Table, names: Sequence[str]) -> NDArray[np.bool_]:
    """True where a sorted table's row differs from the one before in any of the columns."""
    first = np.ones(table.size, dtype=bool)
    if table.size:
        first[1:] = False
        for column in names:
            first[1:] |= table[column][1:] != table[column][:-1]
    return first


def paired(
    table: Table,
    sources: Sequence[SourceFile],
    skipped: Skipped,
    differ: Callable[[Table], bool],
) -> tuple[Table, Table, Table, list[str]]:
    """Levels with u and v (and pressure if native), by profile and level, and notes.

    Parameters
    ----------
    table : structured array
        A row a field, with the columns of a profile, `level`, `kind`, `file`, `part`, `offset`.
    skipped : list
        Takes what has no partner.
    differ : function of rows of one field to bool
        Whether their values differ.
    """
    # lexsort takes its last key first
    order = np.lexsort([table[c] for c in ("part", "offset", "file", *reversed(_FIELD))])
    table, notes = _without_duplicates(table[order], sources, skipped, differ)
    level = np.cumsum(_changes(table, (*_PROFILE, "level"))) - 1
    count = int(level[-1]) + 1 if level.size else 0
    rows = np.full((3, count), -1)  # of u, v and pressure of each level; -1 if there is none
    rows[table["kind"], level] = np.arange(table.size)
    u, v, pressure = rows
    both = (u >= 0) & (v >= 0)
    some = table[np.max(rows, axis=0)]
    native = some["level_kind"] != ISOBARIC
    # level kinds without any pressure hold no profile, whatever else they hold
    bare = native & ~np.isin(some["level_kind"], table["level_kind"][table["kind"] == PRESSURE])
    reasons: Counter[tuple[str, str, str]] = Counter()
    for n in np.flatnonzero(((u >= 0) ^ (v >= 0)) & ~(bare & (some["level_kind"] != HYBRID))):
        row = table[max(u[n], v[n])]
        why = "u without v" if u[n] >= 0 else "v without u"
        reasons[sources[row["file"]].path, "level", why] += 1
    for n in np.flatnonzero(both & native & (pressure < 0) & (~bare | (some["level_kind"] == 1))):
        path = sources[table["file"][u[n]]].path
        reasons[path, "level", "hybrid level without a pressure field"] += 1
    for number in np.flatnonzero(np.isin(level, np.flatnonzero(bare & (some["level_kind"] > 1)))):
        row = table[number]
        why = f"{'uv'[row['kind']]} not on pressure levels (level type {row['level_kind']})"
        reasons[sources[row["file"]].path, "wind", why] += 1
    skipped += [skip(*key, n) for key, n in reasons.items()]
    both &= ~native | (pressure >= 0)
    # isobaric levels have no pressure field: any row takes its place
    return table[u[both]], table[v[both]], table[np.maximum(pressure[both], 0)], notes


def on_one_grid(table: Table, grids: Sequence[Grid]) -> Table:
    """Give v and pressure the grid number of u if they lie on points shifted against u's.

    The number of a row's own grid is kept in ``points``.
    """
    table["points"] = table["grid"]
    known: dict[tuple[int, int], bool] = {}

    def shifted(one: int, other: int) -> bool:
        if (one, other) not in known:
            known[one, other] = are_shifted(grids[one], grids[other])
        return known[one, other]

    numbers = {kind: np.unique(table["grid"][table["kind"] == kind]).tolist() for kind in range(4)}
    for kind in (V, PRESSURE, SURFACE):
        mine = table["kind"] == kind
        for number in set(numbers[kind]) - set(numbers[U]):
            target = next((one for one in numbers[U] if shifted(one, number)), number)
            table["grid"][mine & (table["points"] == number)] = target
    return table


def _without_duplicates(
    table: Table,
    sources: Sequence[SourceFile],
    skipped: Skipped,
    differ: Callable[[Table], bool],
) -> tuple[Table, list[str]]:
    """Sorted rows of which each field has one, and which file was used for copies."""
    again = np.flatnonzero(~_changes(table, _FIELD))
    if not again.size:
        return table, []
    keep = np.ones(table.size, dtype=bool)
    pairs: Counter[tuple[int, int]] = Counter()
    example: dict[tuple[int, int], int] = {}
    contradictions: Counter[str] = Counter()
    group = np.cumsum(_changes(table, _FIELD))
    for number in np.unique(group[again]):
        rows = np.flatnonzero(group == number)
        if differ(table[rows]):
            keep[rows] = False
            contradictions[sources[int(table["file"][rows[-1]])].path] += rows.size
            continue
        keep[rows[:-1]] = False
        pair = int(table["file"][rows[-2]]), int(table["file"][rows[-1]])
        pairs[pair] += 1
        example.setdefault(pair, int(rows[-1]))
    why = "a field of one level and time given again with other values"
    skipped += [skip(path, "message", why, n) for path, n in contradictions.items()]
    notes = []
    for (lost, used), count in sorted(pairs.items()):
        row = table[example[lost, used]]
        time = np.datetime64(int(row["valid"]), "ns").astype("datetime64[m]")
        notes.append(
            f"{sources[lost].path} and {sources[used].path} both hold {count} field(s) of the same "
            f"valid time and lead (such as {time}Z, lead {int(row['lead']) / 3600:g} h): "
            f"{sources[used].path} is used, as its path sorts last"
            if lost != used
            else f"{sources[used].path} holds {count} field(s) twice: the later one is used"
        )
    return table[keep], notes


def refuse(skipped: Skipped) -> None:
    """Refuse damaged files and messages, unknown grids and u without v (``on_bad_file="fail"``).

    Raises
    ------
    InputError
        For the first of them.
    """
    for one in skipped:
        if one["what"] in ("file", "message", "grid", "level"):
            raise InputError(
                f"{one['reason']} ({one['count']} {one['what']}s)",
                file=one["file"],
                remedy="Repair or remove the file, or let bad files be skipped",
            )


def selected(
    name: str,
    wanted: Wanted,
    sources: Sequence[SourceFile],
    grids: Sequence[Grid],
    pairs: tuple[Table, Table, Table, list[str]],
    skipped: Skipped,
    count: int,
) -> Catalogue:
    """Catalogue of one profile a valid time, of the levels of :func:`paired`.

    Raises
    ------
    InputError
        If there is none.
    """
    u, v, pressure, notes = pairs
    starts = np.flatnonzero(_changes(u, _PROFILE))
    sizes = np.diff(np.append(starts, u.size))
    profiles = u[starts]
    # one level of heights with a pressure (10 m) is no profile
    usable = (sizes > 1) | (profiles["level_kind"] <= HYBRID)
    starts, sizes, profiles = starts[usable], sizes[usable], profiles[usable]
    meeting = np.flatnonzero(wanted.of(profiles))
    if meeting.size == 0:
        raise no_winds(name, wanted, profiles, skipped, sources)
    starts, sizes, profiles = starts[meeting], sizes[meeting], profiles[meeting]
    # best first within each valid time; lexsort takes its last key first
    native = profiles["level_kind"] != ISOBARIC
    keys = [profiles["lead"], profiles["member"], native, profiles["valid"]]
    order = np.lexsort([profiles["grid"], profiles["level_kind"], -sizes, *keys])
    first = _changes(profiles[order], ("valid",))
    best = order[first]
    _note_choices(profiles[order], sizes[order], first, notes)

    def catalogue(chosen: NDArray[np.int64], others: tuple[Catalogue, ...]) -> Catalogue:
        rows = np.concatenate([np.arange(starts[n], starts[n] + sizes[n]) for n in chosen])
        columns = {c: profiles[c][chosen].astype(np.int64) for c in _PROFILE}
        return Catalogue(
            name=name,
            lead=wanted.lead,
            files=tuple(sources),
            grids=tuple(grids),
            valid=columns["valid"],
            leads=columns["lead"],
            members=columns["member"],
            grid_numbers=columns["grid"],
            level_kinds=columns["level_kind"],
            bounds=np.concatenate([[0], np.cumsum(sizes[chosen])]).astype(np.int64),
            u=u[rows],
            v=v[rows],
            pressure=pressure[rows],
            skipped=skipped,
            notes=notes,
            messages=count,
            alternatives=others,
        )

    # profiles that differ from the best by their grid alone
    equal = ("valid", "lead", "member", "level_kind")
    position = np.repeat(
        np.arange(best.size), np.diff(np.append(np.flatnonzero(first), len(order)))
    )
    tied = sizes[order] == sizes[best[position]]
    for column in equal:
        tied &= profiles[column][order] == profiles[column][best[position]]
    tied &= profiles["grid"][order] != profiles["grid"][best[position]]
    others = []
    for number in np.unique(profiles["grid"][order[tied]]):
        mine, chosen = tied & (profiles["grid"][order] == number), best.copy()
        chosen[position[mine]] = order[mine]
        others.append(catalogue(chosen, ()))
    if others:
        notes.append(
            f"{len(others) + 1} grids with the same levels: the one that contains more of the "
            "reports is used"
        )
    return catalogue(best, tuple(others))


def _note_choices(
    profiles: Table, sizes: NDArray[np.int64], first: NDArray[np.bool_], notes: list[str]
) -> None:
    """Count why sorted profiles were not taken: the first column that differs from the best."""
    texts = {
        "lead": "several leads: the shortest is used",
        "member": "several ensemble members: the lowest number is used",
        "level_kind": "isobaric and other levels: isobaric are used",
        "grid": "several grids: the one with most levels is used",
    }
    counts: Counter[str] = Counter()
    best = np.maximum.accumulate(np.where(first, np.arange(first.size), 0))
    for n in np.flatnonzero(~first):
        reason = next((c for c in texts if profiles[c][n] != profiles[c][best[n]]), "grid")
        counts[reason if reason != "grid" or sizes[n] != sizes[best[n]] else ""] += 1
    notes += [
        f"{counts[c]} further profile(s) at the same valid time, {texts[c]}"
        for c in texts
        if counts[c]
    ]


def no_winds(
    name: str, wanted: Wanted, profiles: Table, skipped: Skipped, sources: Sequence[SourceFile]
) -> InputError:
    """The error for files without a wind that can be used."""
    where = f"references.{name}"
    if profiles.size:
        return wanted.none_met(profiles, where)
    reasons: Counter[str] = Counter()
    for one in skipped:
        reasons[f"{one['what']}: {one['reason']}"] += one["count"]
    remedy = "u and v are needed at the same levels, on a grid that is defined in the file"
    if any(one["what"] == "grid" for one in skipped):
        remedy = (
            "Known grids are Lambert, polar stereographic, Mercator, Gaussian, and regular or "
            "rotated latitude/longitude: use the same model's files on one of them"
        )
    return InputError(
        f"no wind on pressure levels that can be used in {len(sources)} file(s)",
        file=sources[0].path if len(sources) == 1 else None,
        field=where,
        found="; ".join(f"{why} ({n})" for why, n in reasons.most_common(4)) or "no u or v at all",
        remedy=remedy,
    )
