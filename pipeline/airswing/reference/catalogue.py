"""Catalogue of a reference: where the wind profile of each valid time is stored, without decoding.

A row is one field of one level; a profile is the u and v of all levels of one valid time, lead,
member and grid, with the pressure of each level where levels are not isobaric. A level with u but
no v has no wind. `_CHOICES` selects one of several profiles of a valid time; of grids with equally
many levels the one that contains more reports is used. Copies of a field count once (the file whose
path sorts last); if the values differ, one header must be wrong and neither is used. GRIB that the
header scanner does not know is opened by cfgrib, which is slower; a field that is not a state of
the atmosphere is not tried again.
"""

from __future__ import annotations

import contextlib
import os
import reprlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.config import Naming
from airswing.errors import InputError
from airswing.quantities import lead_condition
from airswing.reference.files import (
    Skipped,
    SourceFile,
    find_files,
    identified,
    kind_of,
    skip,
)
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import FIELD_DTYPE, FileContents, contents_of, off_levels
from airswing.reference.grib.values import GribReader, probes_of
from airswing.reference.gridded.datasets import ENGINES, DatasetReader, opened
from airswing.reference.gridded.fields import Gathering
from airswing.reference.gridded.wrf import is_wrf
from airswing.reference.grids import Floats, Grid
from airswing.reference.winds import (
    GIVEN,
    HYBRID,
    ISOBARIC,
    PRESSURE,
    ModelTime,
    StoredField,
    Table,
    on_one_grid,
)

_SAME = 0.1  # m/s or Pa: copies in another packing differ by less
_COMPARED = 20  # equal fields of two files after which the others are taken as equal
_PROFILE = ("valid", "lead", "member", "level_kind", "grid")
_FIELD = (*_PROFILE, "level", "kind")
#: Columns in which profiles of one valid time differ, and which of them is used.
_CHOICES = {
    "lead": "several leads: the shortest is used",
    "member": "several ensemble members: the lowest number is used",
    "level_kind": "isobaric and other levels: isobaric are used",
    "grid": "several grids: the one with most levels is used if it contains reports",
}


@dataclass(eq=False, repr=False)
class Catalogue:
    """Wind profiles of one reference, by valid time."""

    name: str
    lead: str  # the condition on leads
    files: tuple[SourceFile, ...]  # every file that could be opened
    grids: tuple[Grid, ...]
    profiles: Table  # by increasing valid time (time,): its time, lead, member, grid, kind of level
    bounds: NDArray[np.int64]  # rows of each model time below, (time + 1,)
    rows: Table  # of u, v and, where levels are not isobaric, pressure: (3, level)
    skipped: Skipped
    notes: list[str]  # choices made between candidates
    datasets: dict[str, xr.Dataset]  # by the path in `files`
    stored: tuple[StoredField, ...]
    engine: str
    alternatives: tuple[Catalogue, ...] = ()  # catalogues with the other grids

    def __len__(self) -> int:
        return int(self.profiles.size)

    def __repr__(self) -> str:
        span = " to ".join(np.datetime_as_string(self.times[[0, -1]], "m")) if len(self) else "none"
        counted = f"{len(self)} model times of {len(self.files)} files"
        return f"<{type(self).__name__} {self.name!r}: {counted}, {span}, lead {self.lead}>"

    @property
    def valid(self) -> NDArray[np.int64]:
        """Valid times, increasing, ns since 1970."""
        return self.profiles["valid"].astype(np.int64)

    @property
    def times(self) -> NDArray[np.datetime64]:
        """Valid times, increasing."""
        return self.valid.astype("datetime64[ns]")

    @property
    def leads(self) -> NDArray[np.int64]:
        """Lead times, s."""
        return self.profiles["lead"].astype(np.int64)

    def is_isobaric(self, number: int) -> bool:
        """Whether the levels of a model time have one pressure each."""
        return bool(self.profiles["level_kind"][number] == ISOBARIC)

    def model_time(self, number: int) -> ModelTime:
        """One model time with the files it needs."""
        kinds = slice(2 if self.is_isobaric(number) else 3)
        rows = self.rows[kinds, self.bounds[number] : self.bounds[number + 1]].copy()
        grids = tuple(self.grids[n] for n in rows["points"][:, 0].tolist())
        # only the files it needs: the list of a year would be sent with each of its hours
        used = np.unique(rows["file"])
        rows["file"] = np.searchsorted(used, rows["file"])
        files = tuple(self.files[n] for n in used.tolist())
        return ModelTime(grids, rows, files, self.stored, self.engine)

    def levels(self, number: int) -> Floats:
        """Levels of a model time: Pa, or level numbers."""
        rows = slice(int(self.bounds[number]), int(self.bounds[number + 1]))
        return np.asarray(self.rows["level"][0, rows], dtype=np.float64)

    def at_times(self, numbers: NDArray[np.int64]) -> Catalogue:
        """The catalogue of some of its model times."""
        rows = [np.arange(self.bounds[n], self.bounds[n + 1]) for n in numbers.tolist()]
        selected = np.concatenate([*rows, np.empty(0, dtype=np.int64)])
        return replace(
            self,
            profiles=self.profiles[numbers],
            bounds=np.cumsum([0, *(row.size for row in rows)]).astype(np.int64),
            rows=self.rows[:, selected],
            alternatives=tuple(catalogue.at_times(numbers) for catalogue in self.alternatives),
        )

    def for_places(self, latitude: Floats, longitude: Floats) -> Catalogue:
        """The catalogue with the grid that contains most places (degrees); the finer if equal."""
        if not self.alternatives or not len(self):
            return self

        def coverage(catalogue: Catalogue) -> tuple[int, float]:
            grid = catalogue.grids[int(catalogue.profiles["grid"][0])]
            south, north, west, east = grid.outline()
            area = (north - south) * (east - west) / grid.size
            return int(grid.contains(latitude, longitude).sum()), -area

        # with fewer levels only if no other grid contains any place
        equal = [c for c in self.alternatives if c.rows.size == self.rows.size]
        best = max((self, *equal), key=coverage)
        return best if coverage(best)[0] else max((best, *self.alternatives), key=coverage)

    def batches(self, numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Model times that are read together: for Datasets those that share chunks of a file."""
        groups: dict[object, list[int]] = {}
        for number in numbers.tolist():
            row = self.rows[0, self.bounds[number]]
            key: tuple[object, ...] = (number,)
            if self.stored:
                chunk = self.stored[row["offset"]].chunk_numbers(row["index"])
                key = (row["file"], row["subindex"], row["offset"], int(chunk))
            groups.setdefault(key, []).append(number)
        return [np.array(group) for group in groups.values()]


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
    """Catalogue the winds of a model from files of one kind, or from a Dataset.

    Parameters
    ----------
    files : str, sequence of str, or Dataset
        Paths, glob patterns or URLs of GRIB or NetCDF files or Zarr stores; or a Dataset with CF
        winds. Files may be compressed with gzip, bzip2 or xz.
    name : str
        Name of the reference.
    engine : {"auto", "grib", "cfgrib", "netcdf", "zarr", "wrf"}
        How files are opened; ``auto`` follows their content.
    lead : str
        ``any``, ``analysis`` or a comparison such as ``>= 1 h``.
    member : int, optional
        Number of the ensemble member whose winds count; by default the lowest.
    naming : Naming or mapping, optional
        Metadata that a Dataset lacks: names of variables and coordinates, units, projection,
        direction of the winds. For GRIB files only ``winds`` applies.
    cache_dir : path-like, optional
        Folder for the cache of GRIB headers; by default the user's cache folder.
    on_bad_file : {"skip", "fail"}
        Whether damaged files and unusable content are skipped (named and counted) or refused.

    Returns
    -------
    Catalogue
        With `skipped` (content that was not used) and `notes` (choices that were made).

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
    where = f"references.{name}"
    if on_bad_file not in ("skip", "fail"):
        raise InputError("must be skip or fail", field="on_bad_file", found=on_bad_file)
    lead_condition(lead)  # its errors are reported before any file is read
    if engine not in ENGINES:
        remedy = "Engines are " + ", ".join(ENGINES)
        raise InputError("no such engine", field=f"{where}.engine", found=engine, remedy=remedy)
    naming = Naming(**naming) if isinstance(naming, Mapping) else naming or Naming()
    if naming.winds not in (None, "grid", "earth"):
        raise InputError("must be grid or earth", field=f"{where}.winds", found=naming.winds)
    work = _Work(name, naming, lead, member, on_bad_file == "fail", cache_dir)
    if isinstance(files, xr.Dataset):
        work.sources = [SourceFile(f"Dataset {name}", 0, 0, "")]
        work.datasets = {work.sources[0].path: files}
        return work.catalogue(GIVEN)
    work.sources = identified(find_files(files, name), work.skipped)
    work.refuse_if_strict()
    used = _engine(work.sources, where) if engine == "auto" else engine
    if used != "grib":
        return work.catalogue(used)
    odd = [key for key in naming.stated() if key != "winds"]
    if odd:
        raise InputError(
            "this key does not apply to GRIB, whose messages describe themselves",
            field=f"{where}.{odd[0]}",
            remedy="Remove it, or give engine: cfgrib to have it applied",
        )
    try:
        return work.catalogue("grib")
    except InputError as refused:
        # about an unknown grid, level or bitmap, not about the kind of field
        reasons = ("hybrid level", "predefined bitmap")
        technical = any(
            s["what"] == "grid" or s["reason"].startswith(reasons) for s in work.skipped
        )
        if engine == "grib" or not technical or not refused.what.startswith("no wind on"):
            raise
        try:
            catalogue = replace(work, skipped=[], notes=[]).catalogue("cfgrib")
        except InputError as second:
            raise (second if "not on a grid of rows" in second.what else refused) from second
        reason = f"opened by cfgrib, which is slower: the header scanner found {refused.found}"
        catalogue.notes.insert(0, reason)
        return catalogue


def _engine(sources: Sequence[SourceFile], where: str) -> str:
    """The engine of all files; damaged ones are reported by the reader."""
    kinds: dict[str, SourceFile] = {}
    for source in sources:
        with contextlib.suppress(OSError, InputError):
            kinds.setdefault(kind_of(source.path), source)
    kinds.pop("", None)
    if len(kinds) > 1:
        raise InputError(
            "files of several kinds under one reference",
            field=f"{where}.files",
            found="; ".join(f"{kind}: {kinds[kind].path}" for kind in sorted(kinds)),
            remedy="Give each kind a reference of its own, or narrow the pattern",
        )
    # damaged content is counted and named by the scanner
    kind = next(iter(kinds), "grib")
    is_netcdf_of_wrf = kind == "netcdf" and is_wrf(opened(kinds[kind], "netcdf")[0])
    return "wrf" if is_netcdf_of_wrf else kind


def catalogues_of(references: object) -> dict[str, Catalogue]:
    """Catalogues of references, some of which may be given as Datasets."""
    if (
        not isinstance(references, Mapping)
        or isinstance(references, xr.Dataset)
        or not all(isinstance(value, Catalogue | xr.Dataset) for value in references.values())
    ):
        raise TypeError(
            "references are a mapping from names to catalogues or Datasets, not "
            f"{reprlib.repr(references)}: "
            'collocate(reports, {"ruc": build_catalogue("ruc/*.grb", name="ruc")})'
        )
    if not references:
        raise InputError("no reference given", field="references")
    return {
        str(name): value if isinstance(value, Catalogue) else build_catalogue(value, name=str(name))
        for name, value in references.items()
    }


@dataclass
class _Work:
    """Builds the catalogue of a reference from its files: options, and content found so far."""

    name: str
    naming: Naming
    lead: str
    member: int | None  # None: any
    strict: bool  # whether bad input is refused
    cache_dir: str | os.PathLike[str] | None
    sources: list[SourceFile] = field(default_factory=list)
    datasets: dict[str, xr.Dataset] = field(default_factory=dict)
    skipped: Skipped = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def catalogue(self, engine: str) -> Catalogue:
        """Read the files' rows, pair u with v, and choose a profile for each valid time."""
        reader: GribReader | DatasetReader
        stored: tuple[StoredField, ...] = ()
        gathered = None if engine == "grib" else Gathering(self.naming, self.skipped)
        if gathered is None:
            table, grids, notes = self._grib_rows()
            reader = GribReader()
        else:
            self._gather(gathered, engine)
            table, grids, stored = gathered.table(), gathered.grids(), tuple(gathered.stored)
            reader = DatasetReader(self.datasets)
        # lexsort takes its last key first
        order = np.lexsort([table[c] for c in ("subindex", "offset", "file", *reversed(_FIELD))])
        table = table[order]

        def values(rows: Table) -> list[Floats]:
            grid = grids[int(rows["points"][0])]
            model = ModelTime((grid,) * 3, rows, tuple(self.sources), stored, engine)
            points = probes_of(grid.size)
            return reader.answer([model], [[(row, points.copy()) for row in rows]])[0]

        try:
            table = table[self._without_copies(table, values)]
        finally:
            reader.close()
        rows = self._paired(table)
        self.refuse_if_strict()
        bounds = np.append(np.flatnonzero(_changes(rows[0], _PROFILE)), rows[0].size)
        profiles = rows[0, bounds[:-1]]
        everything = Catalogue(
            *(self.name, self.lead, tuple(self.sources), grids, profiles, bounds, rows),
            *(self.skipped, self.notes, self.datasets, stored, engine),
        )
        result = self._profiles_by_time(everything)
        result.notes += gathered.notes(result.profiles["grid"]) if gathered else notes
        return result

    def _grib_rows(self) -> tuple[Table, tuple[Grid, ...], list[str]]:
        numbers: dict[Grid, int] = {}
        tables = [np.empty(0, dtype=FIELD_DTYPE)]
        for index, contents in enumerate(contents_of(self.sources, self.cache_dir)):
            path = self.sources[index].path
            if not isinstance(contents, FileContents):
                reason = contents.strerror if isinstance(contents, OSError) else contents.what
                self.skipped.append(skip(path, "file", f"cannot be read: {reason}"))
                continue
            self.skipped += [skip(path, *key, n) for key, n in contents.skipped.items()]
            table = contents.table()
            table["file"] = index
            order = [numbers.setdefault(read_grid(*s), len(numbers)) for s in contents.grids]
            if order:
                table["grid"] = np.asarray(order, dtype="i4")[table["grid"]]
            tables.append(table)
        grids: tuple[Grid, ...] = tuple(numbers)
        notes, winds = [], self.naming.winds
        if winds:
            along = winds == "grid"
            if any(grid.wind_along_grid != along and not grid.north_up for grid in grids):
                notes.append(f"winds: {winds} used in place of the flag of the messages")
            grids = tuple(grid.directed(along and not grid.north_up) for grid in grids)
        return on_one_grid(np.concatenate(tables), grids), grids, notes

    def _gather(self, gathered: Gathering, engine: str) -> None:
        """Collect the rows of Datasets; of several files, unreadable ones are skipped."""
        for number, source in enumerate(self.sources):
            try:
                dataset = self.datasets.get(source.path)
                datasets = opened(source, engine) if dataset is None else [dataset]
                gathered.add(number, datasets, source.path)
            except InputError as error:
                of_one_file = len(self.sources) > 1 and error.what.startswith("cannot be ")
                if self.strict or not of_one_file:
                    raise
                self.skipped.append(skip(source.path, "file", f"{error.what} ({error.found})"))

    def _without_copies(
        self, table: Table, values: Callable[[Table], list[Floats]]
    ) -> NDArray[np.bool_]:
        """Mask of the sorted rows to keep: the last of copies, none of contradicting values."""
        first = _changes(table, _FIELD)
        keep, group = np.ones(table.size, dtype=bool), np.cumsum(first)
        equal: Counter[tuple[int, ...]] = Counter()
        contradicting: set[tuple[int, ...]] = set()
        contradictions: Counter[str] = Counter()
        copies: dict[tuple[int, int], list[np.void]] = {}
        for number in np.unique(group[~first]):
            rows = np.flatnonzero(group == number)
            files = tuple(np.unique(table["file"][rows]).tolist())
            if len(files) == 1 or equal[files] <= _COMPARED or files in contradicting:
                first_values, *repeated = (np.nan_to_num(array) for array in values(table[rows]))
                if any(bool(np.abs(array - first_values).max() > _SAME) for array in repeated):
                    contradicting.add(files)
                    keep[rows] = False
                    contradictions[self.sources[int(table["file"][rows[-1]])].path] += rows.size
                    continue
                equal[files] += 1
            keep[rows[:-1]] = False
            lost, used = table["file"][rows[-2:]].tolist()
            copies.setdefault((lost, used), []).append(table[rows[-1]])
        why = "a field of one level and time given again with other values"
        self.skipped += [skip(path, "message", why, n) for path, n in contradictions.items()]
        for (lost, used), fields in sorted(copies.items()):
            lost_path, used_path = self.sources[lost].path, self.sources[used].path
            time = np.datetime64(int(fields[0]["valid"]), "ns").astype("datetime64[m]")
            note = (
                f"{lost_path} and {used_path} both hold {len(fields)} field(s) of the same valid "
                f"time and lead (such as {time}Z, lead {int(fields[0]['lead']) / 3600:g} h): "
                f"{used_path} is used, as its path sorts last"
            )
            twice = f"{used_path} holds {len(fields)} field(s) twice: the later one is used"
            self.notes.append(note if lost != used else twice)
        return keep

    def _paired(self, table: Table) -> Table:
        """Rows of u, v and pressure (if native), one a level that has them, by profile."""
        level = np.cumsum(_changes(table, (*_PROFILE, "level"))) - 1
        count = int(level[-1]) + 1 if level.size else 0
        rows = np.full((3, count), -1)  # of u, v and pressure of each level; -1 if there is none
        rows[table["kind"], level] = np.arange(table.size)
        u, v, pressure = rows
        paired, kind = (u >= 0) & (v >= 0), table["level_kind"][np.max(rows, axis=0)]
        native = kind != ISOBARIC
        # level kinds without any pressure have no profile
        bare = native & ~np.isin(kind, table["level_kind"][table["kind"] == PRESSURE])
        excluded = bare & (kind > HYBRID)

        def skip_rows(rows: NDArray[np.int64], content: str, why: str) -> None:
            files = Counter(self.sources[number].path for number in table["file"][rows].tolist())
            self.skipped.extend(skip(path, content, why, n) for path, n in files.items())

        skip_rows(u[(u >= 0) & (v < 0) & ~excluded], "level", "u without v")
        skip_rows(v[(v >= 0) & (u < 0) & ~excluded], "level", "v without u")
        without = paired & native & (pressure < 0) & ~excluded
        skip_rows(u[without], "level", "hybrid level without a pressure field")
        off = np.flatnonzero(np.isin(level, np.flatnonzero(excluded)))
        kinds, place = np.unique(table[off][["kind", "level_kind"]], return_inverse=True)
        for number, (component, surface) in enumerate(kinds.tolist()):
            skip_rows(off[place == number], "wind", off_levels(component, surface))
        paired &= ~native | (pressure >= 0)
        # isobaric levels have no pressure field: use any row in its place
        return np.asarray(table[np.maximum(rows[:, paired], 0)])

    def refuse_if_strict(self) -> None:
        """Refuse damaged files, messages, unknown grids, u without v under on_bad_file="fail"."""
        for entry in self.skipped if self.strict else ():
            if entry["what"] in ("file", "message", "grid", "level"):
                raise InputError(
                    f"{entry['reason']} ({entry['count']} {entry['what']}s)",
                    file=entry["file"],
                    remedy="Repair or remove the file, or let bad files be skipped",
                )

    def _profiles_by_time(self, everything: Catalogue) -> Catalogue:
        """The catalogue with one profile for each valid time, and alternatives on other grids."""
        profiles, sizes = everything.profiles, np.diff(everything.bounds)
        # a single height level with a pressure (10 m) is not a profile
        usable = (sizes > 1) | (profiles["level_kind"] <= HYBRID)
        meets = lead_condition(self.lead)(profiles["lead"])
        if self.member is not None:
            meets &= profiles["member"] == self.member
        meeting = np.flatnonzero(usable & meets)
        if meeting.size == 0:
            raise self._no_winds(profiles[usable])
        # best first within each valid time; lexsort takes its last key first
        native = profiles["level_kind"] != ISOBARIC
        keys = [profiles["lead"], profiles["member"], native, profiles["valid"]]
        keys = [profiles["grid"], profiles["level_kind"], -sizes, *keys]
        order = meeting[np.lexsort([key[meeting] for key in keys])]
        first = _changes(profiles[order], ("valid",))
        time = np.cumsum(first) - 1  # number of the valid time of each
        best = order[first]
        # the first of these columns in which a profile differs from the best of its time
        remaining, best_of_each = ~first, best[time]
        for column, choice in _CHOICES.items():
            differs = remaining & (profiles[column][order] != profiles[column][best_of_each])
            remaining &= ~differs
            if column == "grid":
                tied = differs
                differs = differs & (sizes[order] != sizes[best_of_each])
            if number := differs.sum():
                note = f"{number} further profile(s) at the same valid time, {choice}"
                self.notes.append(note)
        alternatives, equal = [], 1
        for number in np.unique(profiles["grid"][order[tied]]):
            mine, alternative = tied & (profiles["grid"][order] == number), best.copy()
            alternative[time[mine][::-1]] = order[mine][::-1]  # the first of several of one time
            equal += bool((sizes[alternative] == sizes[best]).all())
            alternatives.append(everything.at_times(alternative))
        if equal > 1:
            note = "grids with the same levels: the one that contains more of the reports is used"
            self.notes.append(f"{equal} {note}")
        return replace(everything.at_times(best), alternatives=tuple(alternatives))

    def _no_winds(self, profiles: Table) -> InputError:
        text = f"no wind on pressure levels that can be used in {len(self.sources)} file(s)"
        remedy = (
            "u and v are needed at the same levels, on a grid that the file defines: Lambert, "
            "polar stereographic, Mercator, Gaussian, or regular or rotated latitude/longitude"
        )
        reasons: Counter[str] = Counter()
        for entry in self.skipped:
            reasons[f"{entry['what']}: {entry['reason']}"] += entry["count"]
        details = "; ".join(f"{why} ({n})" for why, n in reasons.most_common(4))
        if profiles.size:
            members, leads = (np.unique(profiles[key]).tolist() for key in ("member", "lead"))
            asked = "any" if self.member is None else self.member
            text = f"no wind of ensemble member {asked} meets the lead condition {self.lead!r}"
            details = "leads " + ", ".join(f"{lead / 3600:g} h" for lead in leads)
            details += "; members " + ", ".join(map(str, members))
            remedy = "Choose one of those found: keys `lead` and `member` of the reference"
        return InputError(
            text,
            file=self.sources[0].path if len(self.sources) == 1 else None,
            field=f"references.{self.name}",
            found=details or "no u or v at all",
            remedy=remedy,
        )


def _changes(table: Table, names: Sequence[str]) -> NDArray[np.bool_]:
    """True where a sorted table's row differs from the one before in any of the columns."""
    first = np.ones(table.size, dtype=bool)
    first[1:] = np.any([table[name][1:] != table[name][:-1] for name in names], axis=0)
    return first
