"""Which message holds the wind of which level at which time: a catalogue, nothing decoded.

Assumptions and validity
------------------------
* Which of several candidates counts: :mod:`airswing.reference.geometry.wind_profiles`.
* Valid time is base time plus lead; only instantaneous fields count.
"""

from __future__ import annotations

import glob
import os
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from airswing.errors import InputError
from airswing.lead_times import Wanted, lead_condition
from airswing.products.named_files import none_found
from airswing.reference.geometry.grids import Grid
from airswing.reference.geometry.model_time import SourceFile
from airswing.reference.geometry.wind_profiles import (
    FIELD,
    Catalogue,
    Skipped,
    Table,
    changes,
    ordered,
    paired,
    refuse,
    selected,
    skip,
)
from airswing.reference.grib.fields import FIELD_DTYPE, FileContents
from airswing.reference.grib.filecache import FileCache, contents_of, identify
from airswing.reference.grib.gridsections import read_grid


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

    Arguments as of :func:`airswing.reference.catalogues.build_catalogue`; patterns only find
    files, what a message is comes from the message.

    Raises
    ------
    InputError
        No file found, no usable wind at all, or bad input under ``on_bad_file="fail"``.
    """
    if on_bad_file not in ("skip", "fail"):
        raise InputError("must be skip or fail", field="on_bad_file", found=on_bad_file)
    lead_condition(lead)  # a fault of it is told before any file is read
    skipped: Skipped = []
    sources = identified(find_files(files, name), skipped, by=identify)
    table, grids, count = _read_all(sources, cache_dir, skipped)
    pairs = paired(_without_contradictions(table, sources, skipped), sources, skipped)
    if on_bad_file == "fail":
        refuse(skipped)
    return selected(name, Wanted(lead, member), sources, grids, pairs, skipped, count)


def find_files(
    files: str | Sequence[str], name: str, *, is_one: Callable[[str], bool] = os.path.isfile
) -> list[str]:
    """Whole paths of what patterns name, sorted.

    Parameters
    ----------
    files : str or sequence of str
        Paths or glob patterns.
    name : str
        The reference's.
    is_one : callable
        Whether a path is one of the files looked for; a store may be a folder.

    Raises
    ------
    InputError
        Where a pattern finds none.
    """
    patterns = [files] if isinstance(files, str | os.PathLike) else list(files)
    found: set[str] = set()
    for pattern in (os.path.expanduser(os.fspath(one)) for one in patterns):
        # A path that is there is itself, whatever brackets its name holds.
        matches = [pattern] if os.path.exists(pattern) else glob.glob(pattern, recursive=True)
        # A link that leads nowhere is a file that is missing: opening it fails and names it.
        there = [os.path.abspath(p) for p in matches if is_one(p) or not os.path.exists(p)]
        if not there:
            raise none_found(pattern, f"references.{name}.files")
        found.update(there)
    if not found:
        raise InputError("names no file", field=f"references.{name}.files")
    return sorted(found)


def identified(
    paths: Sequence[str], skipped: Skipped, *, by: Callable[[str], SourceFile]
) -> list[SourceFile]:
    """Identities of files; what cannot be opened is skipped and named."""
    sources = []
    for path in paths:
        try:
            sources.append(by(path))
        except OSError as error:
            skipped.append(skip(path, "file", f"cannot be opened: {error.strerror}"))
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
                skipped.append(skip(path, "file", f"cannot be read: {contents.strerror}"))
                continue
            count += contents.messages
            skipped += [skip(path, *key, n) for key, n in contents.skipped.items()]
            tables.append(_renumbered(contents, index, numbers))
    return np.concatenate(tables), tuple(numbers), count


def _renumbered(contents: FileContents, index: int, numbers: dict[Grid, int]) -> Table:
    table = contents.table()
    table["file"] = index
    known = [numbers.setdefault(read_grid(*section), len(numbers)) for section in contents.grids]
    if known:
        table["grid"] = np.asarray(known, dtype="i4")[table["grid"]]
    return table


def _without_contradictions(table: Table, sources: Sequence[SourceFile], skipped: Skipped) -> Table:
    """Leave out what one file holds twice with different values: one header of two is wrong.

    Which one cannot be told, so neither is used. Copies of one another are no contradiction.
    """
    table = ordered(table)
    same = ~changes(table, (*FIELD, "file"))
    if not same.any():
        return table
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
    skipped += [skip(path, "message", why, n) for path, n in counts.items()]
    return table[~doubtful]


def _packed_octets(path: str, row: np.void) -> bytes:
    """Octets that a field's values come from; empty where they cannot be read any more."""
    start = int(row["section_data"])
    scale = repr((row["packing"], row["bits"], row["decimal_scale"], row["coded"]))
    try:
        with open(path, "rb") as file:
            file.seek(start)
            return scale.encode() + file.read(int(row["data_end"]) - start)
    except OSError:
        return b""
