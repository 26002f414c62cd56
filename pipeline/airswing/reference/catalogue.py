"""Catalogue of a reference: where the wind profile of each valid time is stored; nothing decoded.

A row is one field of one level; a profile is the u and v of all levels of one valid time, lead,
member and grid, with the pressure of each level where levels are not isobaric.

Assumptions and validity
------------------------
* All files of one reference are read in one way, which their content decides. GRIB files on grids
  or levels that the header scanner does not know are opened by cfgrib, which is slower. What was
  refused because it is no state of the atmosphere, or because it contradicts itself, is not tried
  again. Where both can read a file they give the same winds.
* A level with u but no v (or v but no u) is no wind; nor is a native level without a pressure.
* u and v (and pressure) may lie on grids that are shifted against each other by up to a grid
  length, or stored in another order: each is then interpolated on its own points.
* Among several leads for one valid time the shortest that meets the condition is used; among
  members of an ensemble the lowest number; isobaric levels before others; then the grid with most
  levels. Of grids with equally many levels the one that contains more of the reports is used; if
  none contains any, another grid.
* Of a field that is given twice, copies count once (the file whose path sorts last); if the values
  differ, neither is used, because one of the two headers must be wrong.
* Files that keep their size and time of modification keep their content.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.lead_times import Wanted, lead_condition
from airswing.model_formats import model_formats
from airswing.reference.files import (
    LeftOut,
    Skipped,
    SourceFile,
    find_files,
    identified,
    is_lost_file,
    kind_of,
    skip,
)
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.header_cache import contents_of
from airswing.reference.grib.headers import FIELD_DTYPE, FileContents
from airswing.reference.grib.values import GribReader, probes_of
from airswing.reference.gridded.fields import Gathering
from airswing.reference.gridded.naming import Naming
from airswing.reference.gridded.opening import ENGINES, engine_of, opened
from airswing.reference.gridded.reading import DatasetReader
from airswing.reference.grids import Floats, Grid
from airswing.reference.profiles import (
    GIVEN,
    HYBRID,
    ISOBARIC,
    PRESSURE,
    ModelTime,
    StoredField,
    Table,
    on_one_grid,
)

__all__ = ["Catalogue", "LeftOut", "build_catalogue", "catalogues_of", "is_lost_file"]

_SAME = 0.1  # m/s or Pa: copies in another packing differ by less
_COMPARED = 20  # fields of two files that were found equal: the rest are taken to be
FALL_BACK = "opened by cfgrib, which is slower: the header scanner found {what}"
_PROFILE = ("valid", "lead", "member", "level_kind", "grid")
_FIELD = (*_PROFILE, "level", "kind")


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
    # the same with another of several grids
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
        # only the files it needs: a year's list would go along with each of its thousands of hours
        used = np.unique(np.concatenate([t["file"] for t in tables]))
        for table in tables:
            table["file"] = np.searchsorted(used, table["file"])
        return ModelTime(
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

        # with fewer levels only if no other grid contains any place
        equal = [one for one in self.alternatives if one.u.size == self.u.size]
        best = max((self, *equal), key=worth)
        return best if worth(best)[0] else max((best, *self.alternatives), key=worth)

    def batches(self, numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Model times that are read together: of Datasets those that share chunks of a file."""
        if not self.stored or not numbers.size:
            return [numbers[n : n + 1] for n in range(numbers.size)]
        first = self.u[self.bounds[numbers]]
        keys = np.zeros((numbers.size, 6), dtype=np.int64)
        keys[:, 0], keys[:, 1], keys[:, 2] = first["file"], first["part"], first["offset"]
        for offset in np.unique(first["offset"]):
            mine, stored = first["offset"] == offset, self.stored[int(offset)]
            for column, (dim, place) in enumerate(stored.outer_places(first["index"][mine])[:3]):
                starts = stored.chunks[stored.dims.index(dim)]
                keys[mine, 3 + column] = np.searchsorted(starts, place, side="right")
        _, group = np.unique(keys, axis=0, return_inverse=True)
        order = np.argsort(np.ravel(group), kind="stable")
        parts = np.split(numbers[order], np.flatnonzero(np.diff(np.ravel(group)[order])) + 1)
        return sorted(parts, key=lambda part: int(part[0]))


def build_catalogue(
    files: str | os.PathLike[str] | Sequence[str] | xr.Dataset,
    *,
    name: str,
    engine: str = "auto",
    lead: str = "any",
    member: int | None = None,
    naming: Naming | Mapping[str, object] | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    on_bad_file: str = "skip",
) -> Catalogue:
    """Catalogue the winds of a model: of files of one kind, or of a Dataset.

    Parameters
    ----------
    files : str, sequence of str, or Dataset
        Paths, glob patterns or URLs of GRIB or NetCDF files or Zarr stores; or a Dataset with CF
        winds. Files may be compressed with gzip, bzip2 or xz.
    name : str
        Name of the reference.
    engine : {"auto", "grib", "cfgrib", "netcdf", "zarr", "wrf"}
        How files are opened; ``auto``: by their content.
    lead : str
        ``any``, ``analysis`` or a comparison such as ``>= 1 h``.
    member : int, optional
        Number of the ensemble member whose winds count; by default the lowest.
    naming : Naming or mapping, optional
        What a Dataset does not say itself: names of variables and coordinates, units, projection,
        direction of the winds. Of these GRIB files take ``winds`` only.
    cache_dir : path-like, optional
        Folder for the cache of GRIB headers; by default the user's cache folder.
    on_bad_file : {"skip", "fail"}
        Whether damaged files and unusable content are skipped (named and counted) or refused.

    Returns
    -------
    Catalogue
        With `skipped` and `notes` about what was not used and which choices were made.

    Raises
    ------
    InputError
        No file found, no usable wind at all, files of several kinds, a key that does not apply, or
        bad input under ``on_bad_file="fail"``.

    Examples
    --------
    >>> ruc = airswing.build_catalogue("data_samples/ruc/*.grb", name="ruc")
    >>> (ruc.times[1] - ruc.times[0]).astype("timedelta64[h]")
    np.timedelta64(3,'h')
    """
    if on_bad_file not in ("skip", "fail"):
        raise InputError("must be skip or fail", field="on_bad_file", found=on_bad_file)
    lead_condition(lead)  # a fault of it is reported before any file is read
    engines = [*ENGINES, *model_formats()]
    if engine not in engines:
        raise InputError(
            "no such engine",
            field=f"references.{name}.engine",
            found=engine,
            remedy="Engines are " + ", ".join(engines),
        )
    if isinstance(naming, Mapping):
        naming = Naming(**naming)  # type: ignore[arg-type]
    naming = naming or Naming()
    if naming.winds not in (None, "grid", "earth"):
        raise InputError(
            "must be grid or earth", field=f"references.{name}.winds", found=naming.winds
        )
    skipped: Skipped = []
    wanted = Wanted(lead, member)
    if isinstance(files, xr.Dataset):
        source = SourceFile(f"Dataset {name}", 0, 0, "")
        return _of_datasets({source: files}, [source], GIVEN, naming, wanted, name, skipped)
    if not isinstance(files, str | os.PathLike) and not (
        isinstance(files, Sequence) and all(isinstance(one, str | os.PathLike) for one in files)
    ):
        raise TypeError(
            f"build_catalogue takes paths, patterns, URLs or a Dataset, not {type(files).__name__}"
            ": "
            f'build_catalogue("{name}/*.grb", name="{name}")'
        )
    sources = identified(find_files(files, name), name, skipped)
    if on_bad_file == "fail":
        _refuse(skipped)
    used = _engine(sources, name) if engine == "auto" else engine
    if used != "grib":
        return _of_datasets(None, sources, used, naming, wanted, name, skipped, on_bad_file)
    odd = [key for key in naming.given() if key != "winds"]
    if odd:
        raise InputError(
            "this key does not apply to GRIB, whose messages describe themselves",
            field=f"references.{name}.{odd[0]}",
            remedy="Remove it, or give engine: cfgrib to have it applied",
        )
    try:
        return _of_grib(sources, naming, wanted, name, skipped, cache_dir, on_bad_file)
    except InputError as refused:
        technical = any(_may_be_read_by_cfgrib(one["what"], one["reason"]) for one in skipped)
        if engine == "grib" or not technical or not refused.what.startswith("no wind on"):
            raise
        try:
            found = _of_datasets(None, sources, "cfgrib", naming, wanted, name, [], on_bad_file)
        except InputError as second:
            raise (second if "no grid of rows" in second.what else refused) from second
        found.notes.insert(0, FALL_BACK.format(what=refused.found))
        return found


def _may_be_read_by_cfgrib(what: str, reason: str) -> bool:
    """Whether a refusal is about an unknown grid, level or bitmap, not about what the field is."""
    return what == "grid" or reason.startswith(("hybrid level", "predefined bitmap"))


def _engine(sources: Sequence[SourceFile], name: str) -> str:
    """The engine of all files; damaged ones are left to the reader."""
    kinds: dict[str, str] = {}
    for source in sources:
        try:
            kind = kind_of(source.path)
        except (OSError, InputError):
            continue
        if kind:
            kinds.setdefault(kind, source.path)
    if len(kinds) > 1:
        raise InputError(
            "files of several kinds under one reference",
            field=f"references.{name}.files",
            found="; ".join(f"{kind}: {path}" for kind, path in sorted(kinds.items())),
            remedy="Give each kind a reference of its own, or narrow the pattern",
        )
    for kind, path in kinds.items():
        return engine_of(path) if kind == "netcdf" else kind
    return "grib"  # damaged content is counted and named by the scanner


def _of_grib(
    sources: list[SourceFile],
    naming: Naming,
    wanted: Wanted,
    name: str,
    skipped: Skipped,
    cache_dir: str | os.PathLike[str] | None,
    on_bad_file: str,
) -> Catalogue:
    numbers: dict[Grid, int] = {}
    tables, count = [np.empty(0, dtype=FIELD_DTYPE)], 0
    for index, contents in enumerate(contents_of(sources, cache_dir)):
        path = sources[index].path
        if not isinstance(contents, FileContents):
            reason = contents.strerror if isinstance(contents, OSError) else contents.what
            skipped.append(skip(path, "file", f"cannot be read: {reason}"))
            continue
        count += contents.messages
        skipped += [skip(path, *key, n) for key, n in contents.skipped.items()]
        table = contents.table()
        table["file"] = index
        known = [numbers.setdefault(read_grid(*one), len(numbers)) for one in contents.grids]
        if known:
            table["grid"] = np.asarray(known, dtype="i4")[table["grid"]]
        tables.append(table)
    grids: tuple[Grid, ...] = tuple(numbers)
    notes = []
    if naming.winds:
        along = naming.winds == "grid"
        if any(grid.wind_along_grid != along and not grid.north_up for grid in grids):
            notes.append(f"winds: {naming.winds} used in place of the flag of the messages")
        grids = tuple(grid.directed(along and not grid.north_up) for grid in grids)
    table = on_one_grid(np.concatenate(tables), grids)
    reader = GribReader()
    try:
        pairs = _paired(table, sources, skipped, _comparison(reader, sources, grids))
    finally:
        reader.close()
    if on_bad_file == "fail":
        _refuse(skipped)
    found = _selected(name, wanted, sources, grids, pairs, skipped, count)
    found.notes += notes
    return found


def _of_datasets(
    given: Mapping[SourceFile, xr.Dataset] | None,
    sources: list[SourceFile],
    engine: str,
    naming: Naming,
    wanted: Wanted,
    name: str,
    skipped: Skipped,
    on_bad_file: str = "skip",
) -> Catalogue:
    gathered = Gathering(naming, skipped)
    for number, source in enumerate(sources):
        try:
            parts = [given[source]] if given is not None else opened(source, engine)
            gathered.add(number, parts, source.path)
        except InputError as error:
            # a file that cannot be opened is left out if there are others
            of_one_file = len(sources) > 1 and error.what.startswith("cannot be ")
            if on_bad_file == "fail" or not of_one_file:
                raise
            skipped.append(skip(source.path, "file", f"{error.what} ({error.found})"))
    table, grids, stored = gathered.table(), gathered.grids(), tuple(gathered.stored)
    datasets = {} if given is None else {one.path: ds for one, ds in given.items()}
    compare = _comparison(DatasetReader(datasets), sources, grids, stored, engine)
    pairs = _paired(table, sources, skipped, compare)
    if on_bad_file == "fail":
        _refuse(skipped)
    found = _selected(name, wanted, sources, grids, pairs, skipped, int(table.size))
    found.notes += gathered.notes(found.grid_numbers)
    for one in (found, *found.alternatives):
        one.given, one.stored, one.engine = datasets, stored, engine
    return found


def _comparison(
    reader: GribReader | DatasetReader,
    sources: Sequence[SourceFile],
    grids: Sequence[Grid],
    stored: tuple[StoredField, ...] = (),
    engine: str = "grib",
) -> Callable[[Table], bool]:
    """Function that says whether rows of one field have other values, at some of its points."""
    equal: Counter[tuple[int, ...]] = Counter()
    other: set[tuple[int, ...]] = set()

    def differ(rows: Table) -> bool:
        files = tuple(np.unique(rows["file"]).tolist())
        if len(files) > 1 and equal[files] > _COMPARED and files not in other:
            return False
        grid, native = grids[int(rows["points"][0])], bool(rows["level_kind"][0] != ISOBARIC)
        model = ModelTime((grid,) * 3, native, rows, rows, rows, tuple(sources), stored, engine)
        points = probes_of(grid.size)
        values = reader.answer([model], [[(row, points.copy()) for row in rows]])[0]
        first, *others = (np.nan_to_num(one) for one in values)
        if any(bool(np.abs(one - first).max() > _SAME) for one in others):
            other.add(files)
            return True
        equal[files] += 1
        return False

    return differ


def catalogues_of(references: object) -> dict[str, Catalogue]:
    """Catalogues of references, some of which may be given as Datasets.

    Raises
    ------
    TypeError
        If they are no mapping of names to catalogues or Datasets, with the right call.
    InputError
        Without any.
    """
    right = 'collocate(reports, {"ruc": build_catalogue("ruc/*.grb", name="ruc")})'
    if isinstance(references, Catalogue | xr.Dataset):
        raise TypeError(f"references are a mapping from names: {right}")
    if not isinstance(references, Mapping):
        kind = type(references).__name__
        raise TypeError(f"references are a mapping from names, not a {kind}: {right}")
    if not references:
        raise InputError("no reference given", field="references")
    found = {}
    for name, one in references.items():
        if isinstance(one, xr.Dataset):
            one = build_catalogue(one, name=str(name))
        if not isinstance(one, Catalogue):
            raise TypeError(
                f"reference {name!r} is a {type(one).__name__}, not a catalogue or a Dataset: "
                f"{right}"
            )
        found[str(name)] = one
    return found


def _changes(table: Table, names: Sequence[str]) -> NDArray[np.bool_]:
    """True where a sorted table's row differs from the one before in any of the columns."""
    first = np.ones(table.size, dtype=bool)
    if table.size:
        first[1:] = False
        for column in names:
            first[1:] |= table[column][1:] != table[column][:-1]
    return first


def _paired(
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


def _refuse(skipped: Skipped) -> None:
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


def _selected(
    name: str,
    wanted: Wanted,
    sources: Sequence[SourceFile],
    grids: Sequence[Grid],
    pairs: tuple[Table, Table, Table, list[str]],
    skipped: Skipped,
    count: int,
) -> Catalogue:
    """Catalogue of one profile a valid time, of the levels of :func:`_paired`.

    Raises
    ------
    InputError
        If there is none.
    """
    u, v, pressure, notes = pairs
    bounds = np.append(np.flatnonzero(_changes(u, _PROFILE)), u.size)
    profiles, sizes = u[bounds[:-1]], np.diff(bounds)
    everything = Catalogue(
        name=name,
        lead=wanted.lead,
        files=tuple(sources),
        grids=tuple(grids),
        valid=profiles["valid"].astype(np.int64),
        leads=profiles["lead"].astype(np.int64),
        members=profiles["member"].astype(np.int64),
        grid_numbers=profiles["grid"].astype(np.int64),
        level_kinds=profiles["level_kind"].astype(np.int64),
        bounds=bounds.astype(np.int64),
        u=u,
        v=v,
        pressure=pressure,
        skipped=skipped,
        notes=notes,
        messages=count,
    )
    # one level of heights with a pressure (10 m) is no profile
    usable = (sizes > 1) | (profiles["level_kind"] <= HYBRID)
    meeting = np.flatnonzero(usable & wanted.of(profiles))
    if meeting.size == 0:
        raise _no_winds(name, wanted, profiles[usable], skipped, sources)
    # best first within each valid time; lexsort takes its last key first
    native = profiles["level_kind"] != ISOBARIC
    keys = [profiles["lead"], profiles["member"], native, profiles["valid"]]
    keys = [profiles["grid"], profiles["level_kind"], -sizes, *keys]
    order = meeting[np.lexsort([key[meeting] for key in keys])]
    ordered = profiles[order]
    first = _changes(ordered, ("valid",))
    time = np.cumsum(first) - 1  # number of the valid time of each
    best = order[first]
    _note_choices(ordered, sizes[order], first, notes)
    # profiles that differ from the best by their grid and number of levels alone
    tied = ordered["grid"] != profiles["grid"][best[time]]
    for column in ("lead", "member", "level_kind"):
        tied &= ordered[column] == profiles[column][best[time]]
    others, equal = [], 1
    for number in np.unique(ordered["grid"][tied]):
        mine, chosen = tied & (ordered["grid"] == number), best.copy()
        chosen[time[mine][::-1]] = order[mine][::-1]  # of several of one time the first
        equal += bool((sizes[chosen] == sizes[best]).all())
        others.append(everything.at_times(chosen))
    if equal > 1:
        notes.append(
            f"{equal} grids with the same levels: the one that contains more of the reports is used"
        )
    return replace(everything.at_times(best), alternatives=tuple(others))


def _note_choices(
    profiles: Table, sizes: NDArray[np.int64], first: NDArray[np.bool_], notes: list[str]
) -> None:
    """Count why sorted profiles were not taken: the first column that differs from the best."""
    texts = {
        "lead": "several leads: the shortest is used",
        "member": "several ensemble members: the lowest number is used",
        "level_kind": "isobaric and other levels: isobaric are used",
        "grid": "several grids: the one with most levels is used if it contains reports",
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


def _no_winds(
    name: str, wanted: Wanted, profiles: Table, skipped: Skipped, sources: Sequence[SourceFile]
) -> InputError:
    """The error for files without a wind that can be used."""
    where = f"references.{name}"
    if profiles.size:
        return wanted.none_met(profiles, where)
    reasons: Counter[str] = Counter()
    for one in skipped:
        reasons[f"{one['what']}: {one['reason']}"] += one["count"]
    if {one["reason"] for one in skipped} == {"no whole GRIB message"}:
        raise InputError(
            "no whole GRIB message in it, and neither NetCDF nor Zarr",
            file=sources[0].path,
            field=where,
            remedy="It is damaged, still being written, or of a kind that holds no model winds",
        )
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
