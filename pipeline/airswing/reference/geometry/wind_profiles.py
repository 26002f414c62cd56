"""Wind profiles of a reference by valid time: which fields make them, which of several count.

Assumptions and validity
------------------------
* A level with u but no v (or v but no u) on the same grid is no wind; nor is a native level
  without a pressure.
* Among several leads for one valid time the shortest that meets the condition
  is used; among ensemble members the lowest number; isobaric levels before
  hybrid ones; the grid with most levels where there are several.
* Where two files hold the same field of the same valid time and lead, the file
  whose full path sorts last is used, and `Catalogue.notes` says so.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.lead_times import Wanted
from airswing.reference.geometry.model_time import HYBRID, ModelTime, SourceFile
from airswing.reference.geometry.placing import Placing

Table = NDArray[np.void]


class LeftOut(TypedDict):
    """A part of a model file that gave no wind: the file, what it was of it, and how often."""

    file: str
    what: str
    reason: str
    count: int


Skipped = list[LeftOut]


@dataclass(eq=False, repr=False)
class Catalogue:
    """Wind profiles of one reference, by valid time."""

    name: str
    lead: str  # the condition on leads
    files: tuple[SourceFile, ...]  # every file found that could be opened
    grids: tuple[Placing, ...]
    valid: NDArray[np.int64]  # ns since 1970, increasing, (time,) as all that follow
    leads: NDArray[np.int64]  # s
    members: NDArray[np.int64]  # ensemble member
    grid_numbers: NDArray[np.int64]
    level_kinds: NDArray[np.int64]
    bounds: NDArray[np.int64]  # rows of each model time below, (time + 1,)
    u: Table
    v: Table
    pressure: Table
    skipped: Skipped = field(default_factory=list)  # of `skip`
    notes: list[str] = field(default_factory=list)  # choices made between candidates
    messages: int = 0  # seen
    given: dict[str, xr.Dataset] = field(default_factory=dict)  # by the path in `files`

    def __len__(self) -> int:
        return int(self.valid.size)

    def __repr__(self) -> str:
        # A year of hourly files listed one by one would fill a notebook.
        first_last = np.datetime_as_string(self.times[[0, -1]], "m") if len(self) else ()
        span = f", {' to '.join(first_last)}" if len(self) else ""
        counted = f"{len(self)} model times of {len(self.files)} files"
        return f"<{type(self).__name__} {self.name!r}: {counted}{span}, lead {self.lead}>"

    @property
    def times(self) -> NDArray[np.datetime64]:
        """Valid times, increasing."""
        return self.valid.astype("datetime64[ns]")

    def model_time(self, number: int) -> ModelTime:
        """One model time with the files it needs, small enough to send to another process."""
        rows = slice(int(self.bounds[number]), int(self.bounds[number + 1]))
        hybrid = self.level_kinds[number] == HYBRID
        tables = [self.u[rows].copy(), self.v[rows].copy()]
        tables.append(self.pressure[rows].copy() if hybrid else self.pressure[:0].copy())
        # its own files alone: a year's list would go along with every one of its thousands of hours
        used, _ = np.unique(np.concatenate([t["file"] for t in tables]), return_inverse=True)
        for table in tables:
            table["file"] = np.searchsorted(used, table["file"])
        return ModelTime(
            valid=int(self.valid[number]),
            lead=int(self.leads[number]),
            grid=self.grids[int(self.grid_numbers[number])],
            level_kind=int(self.level_kinds[number]),
            u=tables[0],
            v=tables[1],
            pressure=tables[2],
            files=tuple(self.files[int(i)] for i in used),
        )

    def levels(self, number: int) -> NDArray[np.float64]:
        """Levels of a model time: Pa, or hybrid level numbers."""
        rows = slice(int(self.bounds[number]), int(self.bounds[number + 1]))
        return np.asarray(self.u["level"][rows], dtype=np.float64)

    def reading(self, number: int, needed: NDArray[np.bool_]) -> tuple[int, int, int]:
        """What sampling some levels of a model time reads: fields, octets, fields read in place.

        Octets are as stored; a message of many fields counts once.
        """
        rows = slice(int(self.bounds[number]), int(self.bounds[number + 1]))
        tables = [self.u[rows][needed], self.v[rows][needed]]
        if self.level_kinds[number] == HYBRID and needed.any():
            tables.append(self.pressure[rows])
        table = np.concatenate(tables)
        # fields of one message have one place in the file
        octets = int(np.unique(table[["file", "offset", "length"]])["length"].sum())
        return int(table.size), octets, int(table["sparse"].sum())

    def at_times(self, numbers: NDArray[np.int64]) -> Self:
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
        )

    def batches(self, numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Model times that share what is read at once: of messages each by itself."""
        return [numbers[n : n + 1] for n in range(numbers.size)]

    @property
    def fingerprint(self) -> str:
        """Hash of everything collocation depends on."""
        digest = hashlib.blake2b(digest_size=16)
        digest.update(repr((self.name, self.lead, self.files, self.grids)).encode())
        for array in (self.valid, self.leads, self.bounds, self.u, self.v, self.pressure):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def changed(self) -> Skipped:
        """Files that vanished or were replaced since the catalogue was built."""
        result: Skipped = []
        for file in self.files:
            try:
                status = os.stat(file.path)
            except OSError:
                result.append(skip(file.path, "file", "vanished since it was catalogued"))
                continue
            # as every file's identity here: contents are too large to be hashed
            if (status.st_size, status.st_mtime_ns) != (file.size, file.mtime_ns):
                result.append(skip(file.path, "file", "replaced since it was catalogued"))
        return result


def skip(file: str, what: str, reason: str, count: int = 1) -> LeftOut:
    """One entry of `Catalogue.skipped`."""
    return {"file": file, "what": what, "reason": reason, "count": count}


_PROFILE = ("valid", "lead", "member", "level_kind", "grid")
FIELD = (*_PROFILE, "level", "kind")
"""What two rows of one field have in common."""


def ordered(table: Table) -> Table:
    """Rows by profile, level and kind; of one field by file and place in it."""
    # lexsort takes its last key first.
    return table[np.lexsort([table[c] for c in ("part", "offset", "file", *reversed(FIELD))])]


def changes(table: Table, names: Sequence[str]) -> NDArray[np.bool_]:
    """True where a sorted table's row differs from the one before in any of the columns."""
    first = np.ones(table.size, dtype=bool)
    if table.size:
        first[1:] = False
        for column in names:
            first[1:] |= table[column][1:] != table[column][:-1]
    return first


def paired(
    table: Table, sources: Sequence[SourceFile], skipped: Skipped
) -> tuple[Table, Table, Table, list[str]]:
    """Levels with both u and v (and pressure where hybrid), by profile and level, and notes.

    The table has a row a field, with the columns of a profile, `level`, `kind` (0 u, 1 v, 2
    pressure), `file`, `part` and `offset`; what has no partner goes into ``skipped``.
    """
    table = ordered(table)
    notes = _duplicates(table, sources)
    # Of rows of one field the last counts.
    last = np.append(changes(table, FIELD)[1:], True)[: table.size]
    table = table[last]
    # number of the level, the same for u, v and pressure, which stand together in this order
    level = np.cumsum(changes(table, (*_PROFILE, "level"))) - 1
    count = int(level[-1]) + 1 if level.size else 0
    # one place for each kind; -1 where there is none
    rows = np.full((3, count), -1)
    rows[table["kind"], level] = np.arange(table.size)
    u, v, pressure = rows
    alone = (u >= 0) ^ (v >= 0)
    reasons = Counter(
        (sources[table["file"][i]].path, f"{'u without v' if u[n] >= 0 else 'v without u'}")
        for n in np.flatnonzero(alone)
        for i in [max(u[n], v[n])]
    )
    skipped += [skip(path, "level", why, n) for (path, why), n in reasons.items()]
    both = (u >= 0) & (v >= 0)
    hybrid = np.zeros(count, dtype=bool)
    hybrid[both] = table["level_kind"][u[both]] == HYBRID
    bare = Counter(
        sources[table["file"][u[n]]].path for n in np.flatnonzero(both & hybrid & (pressure < 0))
    )
    why = "hybrid level without a pressure field"
    skipped += [skip(path, "level", why, n) for path, n in bare.items()]
    both &= ~hybrid | (pressure >= 0)
    # isobaric levels have no pressure field: any row holds their place
    return table[u[both]], table[v[both]], table[np.maximum(pressure[both], 0)], notes


def _duplicates(table: Table, sources: Sequence[SourceFile]) -> list[str]:
    """Say which file is used where two hold the same field."""
    again = np.flatnonzero(~changes(table, FIELD))
    pairs: Counter[tuple[int, int]] = Counter()
    example: dict[tuple[int, int], int] = {}
    for n in again:
        pair = (int(table["file"][n - 1]), int(table["file"][n]))
        pairs[pair] += 1
        example.setdefault(pair, int(n))
    return [
        f"{sources[lost].path} and {sources[kept].path} both hold {count} field(s) of the same "
        f"valid time and lead (such as {_describe_time(table[example[lost, kept]])}): "
        f"{sources[kept].path} is used, as its path sorts last"
        if lost != kept
        else f"{sources[kept].path} holds {count} field(s) twice: the later one is used"
        for (lost, kept), count in sorted(pairs.items())
    ]


def _describe_time(row: np.void) -> str:
    valid = np.datetime64(int(row["valid"]), "ns").astype("datetime64[m]")
    return f"{valid}Z, lead {int(row['lead']) / 3600:g} h"


def refuse(skipped: Skipped) -> None:
    """Refuse damaged files and messages, grids that cannot be placed and u without v."""
    for skip in skipped:
        if skip["what"] in ("file", "message", "grid", "level"):
            raise InputError(
                f"{skip['reason']} ({skip['count']} {skip['what']}s)",
                file=skip["file"],
                remedy="Mend or remove the file, or let bad files be skipped",
            )


def selected(
    name: str,
    wanted: Wanted,
    sources: Sequence[SourceFile],
    grids: tuple[Placing, ...],
    pairs: tuple[Table, Table, Table, list[str]],
    skipped: Skipped,
    count: int,
) -> Catalogue:
    """One profile a valid time, of the pairs of :func:`paired` from so many messages.

    Raises
    ------
    InputError
        Where there is none.
    """
    u, v, pressure, notes = pairs
    starts = np.flatnonzero(changes(u, _PROFILE))
    sizes = np.diff(np.append(starts, u.size))
    heads = u[starts]
    meeting = np.flatnonzero(wanted.of(heads))
    if meeting.size == 0:
        _no_winds(name, wanted, heads, skipped, sources)
    starts, sizes, heads = starts[meeting], sizes[meeting], heads[meeting]
    preference = ("level_kind", "member", "lead", "valid")
    # Best first within each valid time: isobaric, low member, short lead, most levels.
    order = np.lexsort([heads["grid"], -sizes, *(heads[c] for c in preference)])
    first = changes(heads[order], ("valid",))
    chosen = order[first]
    # in the order of preference: what differs first is why the other was not taken
    _note_choices(heads[order], first, notes)
    rows = np.concatenate([np.arange(starts[n], starts[n] + sizes[n]) for n in chosen])
    bounds = np.concatenate([[0], np.cumsum(sizes[chosen])]).astype(np.int64)
    columns = {c: heads[c][chosen].astype(np.int64) for c in _PROFILE}
    return Catalogue(
        name=name,
        lead=wanted.lead,
        files=tuple(sources),
        grids=grids,
        valid=columns["valid"],
        leads=columns["lead"],
        members=columns["member"],
        grid_numbers=columns["grid"],
        level_kinds=columns["level_kind"],
        bounds=bounds,
        u=u[rows],
        v=v[rows],
        pressure=pressure[rows],
        skipped=skipped,
        notes=notes,
        messages=count,
    )


def _note_choices(heads: Table, first: NDArray[np.bool_], notes: list[str]) -> None:
    again = np.flatnonzero(~first)
    said = {
        "lead": "several leads: the shortest is used",
        "member": "several ensemble members: the lowest number is used",
        "level_kind": "isobaric and hybrid levels: isobaric are used",
        "grid": "several grids: the one with most levels is used",
    }
    counts: Counter[str] = Counter()
    for n in again:
        # with the row before, which is the chosen one or one passed over for a like reason
        counts[next((c for c in said if heads[c][n] != heads[c][n - 1]), "grid")] += 1
    notes += [
        f"{counts[c]} further profile(s) at the same valid time, {said[c]}"
        for c in said
        if counts[c]
    ]


def _no_winds(
    name: str, wanted: Wanted, heads: Table, skipped: Skipped, sources: Sequence[SourceFile]
) -> None:
    where = f"references.{name}"
    if heads.size:
        raise wanted.none_met(heads, where)
    reasons: Counter[str] = Counter()
    for skip in skipped:
        reasons[f"{skip['what']}: {skip['reason']}"] += skip["count"]
    found = "; ".join(f"{why} ({n})" for why, n in reasons.most_common(4))
    remedy = "u and v are needed at the same levels, on a grid that is defined in the file"
    if any(entry["what"] == "grid" for entry in skipped):
        remedy = (
            "Grids that can be placed are Lambert, polar stereographic, Mercator, and regular or "
            "rotated latitude/longitude: take the same model's files on one of them"
        )
    raise InputError(
        f"no wind on pressure levels that can be used in {len(sources)} file(s)",
        file=sources[0].path if len(sources) == 1 else None,
        field=where,
        found=found or "no u or v at all",
        remedy=remedy,
    )
