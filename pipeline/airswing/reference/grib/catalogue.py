"""Which message holds the wind of which level at which time: a catalogue, nothing decoded.

Assumptions and validity
------------------------
* A level with u but no v (or v but no u) on the same grid is no wind.
* Among several leads for one valid time the shortest that meets the condition
  is used; among ensemble members the lowest number; isobaric levels before
  hybrid ones; the grid with most levels where there are several.
* Where two files hold the same field of the same valid time and lead, the file
  whose full path sorts last is used, and `Catalogue.notes` says so.
* Valid time is base time plus lead; only instantaneous fields count.
"""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.lead_times import Wanted, lead_condition
from airswing.reference.geometry.grids import Grid
from airswing.reference.geometry.model_time import HYBRID, ModelTime, SourceFile
from airswing.reference.grib.fields import FIELD_DTYPE, FileContents
from airswing.reference.grib.filecache import FileCache, contents_of, identify
from airswing.reference.grib.gridsections import read_grid

Table = NDArray[Any]
Skipped = list[dict[str, Any]]


@dataclass(eq=False)
class Catalogue:
    """Wind profiles of one reference, by valid time.

    Parameters
    ----------
    name : str
    lead : str
        The condition on leads.
    files : tuple of SourceFile
        Every file found that could be opened.
    grids : tuple of Grid
    valid, leads, members : (time,) int arrays
        Valid time (ns since 1970, increasing), lead (s), ensemble member.
    grid_numbers, level_kinds : (time,) int arrays
    bounds : (time + 1,) int array
        Rows of `u`, `v`, `pressure` of each model time.
    u, v, pressure : (level rows,) arrays of `fields.FIELD_DTYPE`
    skipped : list of {"file", "what", "reason", "count"}
    notes : list of str
        Choices made between candidates.
    messages : int
        Messages seen.
    """

    name: str
    lead: str
    files: tuple[SourceFile, ...]
    grids: tuple[Grid, ...]
    valid: NDArray[np.int64]
    leads: NDArray[np.int64]
    members: NDArray[np.int64]
    grid_numbers: NDArray[np.int64]
    level_kinds: NDArray[np.int64]
    bounds: NDArray[np.int64]
    u: Table
    v: Table
    pressure: Table
    skipped: Skipped = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    messages: int = 0

    def __len__(self) -> int:
        return int(self.valid.size)

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
                result.append(_skip(file.path, "file", "vanished since it was catalogued"))
                continue
            if (status.st_size, status.st_mtime_ns) != (file.size, file.mtime_ns):
                result.append(_skip(file.path, "file", "replaced since it was catalogued"))
        return result


def build_catalogue(
    files: str | Sequence[str],
    *,
    name: str,
    lead: str = "any",
    member: int | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    on_bad_file: str = "skip",
) -> Catalogue:
    """Catalogue the winds of a folder of GRIB files.

    Parameters
    ----------
    files : str or sequence of str
        Paths or glob patterns; they only find files, what a message is comes from the message.
    name : str
        The reference's name.
    lead : str
        ``any``, ``analysis`` or a comparison such as ``>= 1 h``.
    member : int, optional
        Number of the ensemble member whose winds count; any where not given.
    cache_dir : path-like, optional
        Folder for the header cache; default the user's cache folder.
    on_bad_file : {"skip", "fail"}
        Whether truncated or garbage files and messages, grids that cannot be placed and u
        without v are skipped (named and counted) or refused.

    Returns
    -------
    Catalogue

    Raises
    ------
    InputError
        No file found, no usable wind at all, or bad input under ``on_bad_file="fail"``.
    """
    if on_bad_file not in ("skip", "fail"):
        raise InputError("must be skip or fail", field="on_bad_file", found=on_bad_file)
    lead_condition(lead)  # a fault of it is told before any file is read
    skipped: Skipped = []
    sources = _identified(_find(files, name), skipped)
    table, grids, count = _read_all(sources, cache_dir, skipped)
    pairs = _pair(table, sources, skipped)
    if on_bad_file == "fail":
        _refuse(skipped)
    return _select(name, Wanted(lead, member), sources, grids, pairs, skipped, count)


def _skip(file: str, what: str, reason: str, count: int = 1) -> dict[str, Any]:
    return {"file": file, "what": what, "reason": reason, "count": count}


def _find(files: str | Sequence[str], name: str) -> list[str]:
    patterns = [files] if isinstance(files, str | os.PathLike) else list(files)
    found: set[str] = set()
    for pattern in (os.path.expanduser(os.fspath(one)) for one in patterns):
        matches = [pattern] if os.path.isfile(pattern) else glob.glob(pattern, recursive=True)
        files_there = [os.path.abspath(path) for path in matches if os.path.isfile(path)]
        if not files_there:
            raise _none_found(pattern, name)
        found.update(files_there)
    if not found:
        raise InputError("names no file", field=f"references.{name}.files")
    return sorted(found)


def _none_found(pattern: str, name: str) -> InputError:
    folder = os.path.isdir(pattern)
    return InputError(
        "is a folder" if folder else "no GRIB file found",
        field=f"references.{name}.files",
        found=f"pattern {pattern!r} in folder {os.getcwd()}",
        remedy=f"Name the files in it, such as {os.path.join(pattern, '*')}"
        if folder
        else "Check the pattern; relative paths start at the current directory",
    )


def _identified(paths: Sequence[str], skipped: Skipped) -> list[SourceFile]:
    sources = []
    for path in paths:
        try:
            sources.append(identify(path))
        except OSError as error:
            skipped.append(_skip(path, "file", f"cannot be opened: {error.strerror}"))
    return sources


def _read_all(
    sources: Sequence[SourceFile], cache_dir: str | os.PathLike[str] | None, skipped: Skipped
) -> tuple[Table, tuple[Grid, ...], int]:
    """Fields of every file in one table, with grids numbered over all files."""
    numbers: dict[Grid, int] = {}
    tables, count = [np.empty(0, dtype=FIELD_DTYPE)], 0
    with FileCache(cache_dir) as cache:
        for index, contents in enumerate(contents_of(sources, cache)):
            path = sources[index].path
            if isinstance(contents, OSError):
                skipped.append(_skip(path, "file", f"cannot be read: {contents.strerror}"))
                continue
            count += contents.messages
            skipped += [_skip(path, *key, n) for key, n in contents.skipped.items()]
            tables.append(_renumbered(contents, index, numbers))
    return np.concatenate(tables), tuple(numbers), count


def _renumbered(contents: FileContents, index: int, numbers: dict[Grid, int]) -> Table:
    table = contents.table()
    table["file"] = index
    known = [numbers.setdefault(read_grid(*section), len(numbers)) for section in contents.grids]
    if known:
        table["grid"] = np.asarray(known, dtype="i4")[table["grid"]]
    return table


_PROFILE = ("valid", "lead", "member", "level_kind", "grid")


def _changes(table: Table, names: Sequence[str]) -> NDArray[np.bool_]:
    """True where a sorted table's row differs from the one before in any of the columns."""
    first = np.ones(table.size, dtype=bool)
    if table.size:
        first[1:] = False
        for column in names:
            first[1:] |= table[column][1:] != table[column][:-1]
    return first


def _pair(
    table: Table, sources: Sequence[SourceFile], skipped: Skipped
) -> tuple[Table, Table, Table, list[str]]:
    """Levels with both u and v (and pressure where hybrid), sorted by profile and level."""
    keys = (*_PROFILE, "level", "kind")
    order = np.lexsort([table[c] for c in ("part", "offset", "file", *reversed(keys))])
    table = _without_contradictions(table[order], keys, sources, skipped)
    notes = _duplicates(table, keys, sources)
    last = np.append(_changes(table, keys)[1:], True)[: table.size]
    table = table[last]
    level = np.cumsum(_changes(table, (*_PROFILE, "level"))) - 1
    count = int(level[-1]) + 1 if level.size else 0
    rows = np.full((3, count), -1)
    rows[table["kind"], level] = np.arange(table.size)
    u, v, pressure = rows
    alone = (u >= 0) ^ (v >= 0)
    reasons = Counter(
        (sources[table["file"][i]].path, f"{'u without v' if u[n] >= 0 else 'v without u'}")
        for n in np.flatnonzero(alone)
        for i in [max(u[n], v[n])]
    )
    skipped += [_skip(path, "level", why, n) for (path, why), n in reasons.items()]
    both = (u >= 0) & (v >= 0)
    hybrid = np.zeros(count, dtype=bool)
    hybrid[both] = table["level_kind"][u[both]] == HYBRID
    bare = Counter(
        sources[table["file"][u[n]]].path for n in np.flatnonzero(both & hybrid & (pressure < 0))
    )
    why = "hybrid level without a pressure field"
    skipped += [_skip(path, "level", why, n) for path, n in bare.items()]
    both &= ~hybrid | (pressure >= 0)
    return table[u[both]], table[v[both]], table[np.maximum(pressure[both], 0)], notes


def _without_contradictions(
    table: Table, keys: Sequence[str], sources: Sequence[SourceFile], skipped: Skipped
) -> Table:
    """Leave out what one file holds twice with different values: one header of two is wrong.

    Which one cannot be told, so neither is used. Copies of one another are no contradiction.
    """
    same = ~_changes(table, (*keys, "file"))
    doubtful = np.zeros(table.size, dtype=bool)
    counts: Counter[str] = Counter()
    group = np.cumsum(~same)
    for number in np.unique(group[same]):
        rows = np.flatnonzero(group == number)
        path = sources[int(table["file"][rows[0]])].path
        if len({_packed_octets(path, table[row]) for row in rows}) > 1:
            doubtful[rows] = True
            counts[path] += rows.size
    why = "a field of one level and time given again with other values"
    skipped += [_skip(path, "message", why, n) for path, n in counts.items()]
    return table[~doubtful]


def _packed_octets(path: str, row: Any) -> bytes:
    """Octets that a field's values come from; empty where they cannot be read any more."""
    start = int(row["section_data"])
    scale = repr((row["packing"], row["bits"], row["decimal_scale"], row["coded"]))
    try:
        with open(path, "rb") as file:
            file.seek(start)
            return scale.encode() + file.read(int(row["data_end"]) - start)
    except OSError:
        return b""


def _duplicates(table: Table, keys: Sequence[str], sources: Sequence[SourceFile]) -> list[str]:
    """Say which file is used where two hold the same field."""
    again = np.flatnonzero(~_changes(table, keys))
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


def _describe_time(row: Any) -> str:
    valid = np.datetime64(int(row["valid"]), "ns").astype("datetime64[m]")
    return f"{valid}Z, lead {int(row['lead']) / 3600:g} h"


def _refuse(skipped: Skipped) -> None:
    for skip in skipped:
        if skip["what"] in ("file", "message", "grid", "level"):
            raise InputError(
                f"{skip['reason']} ({skip['count']} {skip['what']}s)", file=skip["file"],
                remedy="Mend or remove the file, or let bad files be skipped",
            )  # fmt: skip


def _select(
    name: str,
    wanted: Wanted,
    sources: Sequence[SourceFile],
    grids: tuple[Grid, ...],
    pairs: tuple[Table, Table, Table, list[str]],
    skipped: Skipped,
    count: int,
) -> Catalogue:
    """One profile a valid time."""
    u, v, pressure, notes = pairs
    starts = np.flatnonzero(_changes(u, _PROFILE))
    sizes = np.diff(np.append(starts, u.size))
    heads = u[starts]
    meeting = np.flatnonzero(wanted.of(heads))
    if meeting.size == 0:
        _no_winds(name, wanted, heads, skipped, sources)
    starts, sizes, heads = starts[meeting], sizes[meeting], heads[meeting]
    preference = ("level_kind", "member", "lead", "valid")
    order = np.lexsort([heads["grid"], -sizes, *(heads[c] for c in preference)])
    first = _changes(heads[order], ("valid",))
    chosen = order[first]
    _note_choices(heads[order], first, notes)
    rows = np.concatenate([np.arange(starts[n], starts[n] + sizes[n]) for n in chosen])
    bounds = np.concatenate([[0], np.cumsum(sizes[chosen])]).astype(np.int64)
    columns = {c: heads[c][chosen].astype(np.int64) for c in _PROFILE}
    return Catalogue(
        name=name, lead=wanted.lead, files=tuple(sources), grids=grids, valid=columns["valid"],
        leads=columns["lead"], members=columns["member"], grid_numbers=columns["grid"],
        level_kinds=columns["level_kind"], bounds=bounds, u=u[rows], v=v[rows],
        pressure=pressure[rows], skipped=skipped, notes=notes, messages=count,
    )  # fmt: skip


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
        counts[next((c for c in said if heads[c][n] != heads[c][n - 1]), "grid")] += 1
    notes += [f"{counts[c]} further profile(s) at the same valid time, {said[c]}"
              for c in said if counts[c]]  # fmt: skip


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
    if any(skip["what"] == "grid" for skip in skipped):
        remedy = (
            "Grids that can be placed are Lambert, polar stereographic, Mercator, and regular or "
            "rotated latitude/longitude: take the same model's files on one of them"
        )
    raise InputError(
        f"no wind on pressure levels that can be used in {len(sources)} file(s)",
        file=sources[0].path if len(sources) == 1 else None, field=where,
        found=found or "no u or v at all",
        remedy=remedy,
    )  # fmt: skip
