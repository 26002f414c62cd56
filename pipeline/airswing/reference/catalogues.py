"""Catalogue the winds of any model: GRIB by its headers, everything else as a Dataset.

Assumptions and validity
------------------------
* All files of one reference are read in one way, which their content decides.
* GRIB files on grids or levels that the header scanner does not know are opened by cfgrib, which
  is slower. What was refused because it is no state of the atmosphere, or because it contradicts
  itself, is not tried again.
* Where both can read a file they give the same winds.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.lead_times import Wanted, lead_condition
from airswing.model_formats import model_formats
from airswing.reference.catalogue import (
    GIVEN,
    ISOBARIC,
    Catalogue,
    ModelTime,
    Skipped,
    SourceFile,
    StoredField,
    Table,
    on_one_grid,
    paired,
    refuse,
    selected,
    skip,
)
from airswing.reference.files import find_files, identified, kind_of, local_path
from airswing.reference.grib.decoding import UnreadableMessageError
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.header_cache import contents_of
from airswing.reference.grib.headers import FIELD_DTYPE, FileContents
from airswing.reference.grib.values import (
    field_values,
    probes_of,
    read_bytes,
)
from airswing.reference.gridded.fields import Gathering
from airswing.reference.gridded.naming import Naming
from airswing.reference.gridded.opening import ENGINES, engine_of, opened
from airswing.reference.gridded.reading import DatasetReader
from airswing.reference.grids import Grid

_SAME = 0.1  # m/s or Pa: copies in another packing differ by less
_COMPARED = 20  # duplicates of one pair of files whose values are compared
FALL_BACK = "opened by cfgrib, which is slower: the header scanner found {what}"


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
        from dask.base import tokenize

        path = f"Dataset {name}"
        source = SourceFile(path, 0, 0, str(tokenize(files)))
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
        refuse(skipped)
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
    compared: dict[tuple[int, ...], int] = {}

    def differ(rows: Table) -> bool:
        pair = tuple(np.unique(rows["file"]).tolist())
        compared[pair] = compared.get(pair, 0) + 1
        if len(pair) > 1 and compared[pair] > _COMPARED:
            return False
        return _grib_values_differ(rows, sources, grids)

    pairs = paired(table, sources, skipped, differ)
    if on_bad_file == "fail":
        refuse(skipped)
    found = selected(name, wanted, sources, grids, pairs, skipped, count)
    found.notes += notes
    return found


def _grib_values_differ(rows: Table, sources: Sequence[SourceFile], grids: Sequence[Grid]) -> bool:
    """Whether fields that have the same header have other values."""
    packed = set()
    for row in rows:
        scale = repr([row[c] for c in ("packing", "bits", "decimal_scale", "reference_value")])
        packed.add(scale.encode() + _packed(sources[int(row["file"])].path, row))
    if len(packed) == 1:
        return False
    size = grids[int(rows["points"][0])].size
    values = []
    for row in rows:
        try:
            path = local_path(sources[int(row["file"])].path)
            values.append(field_values(path, row, size, probes_of(size)))
        except (UnreadableMessageError, OSError):
            return True
    first = np.nan_to_num(values[0])
    return any(np.abs(np.nan_to_num(one) - first).max() > _SAME for one in values[1:])


def _packed(path: str, row: np.void) -> bytes:
    """Bytes that a field's values come from; empty if they cannot be read any more."""
    start, end = int(row["data_start"]), int(row["data_end"])
    try:
        descriptor = os.open(local_path(path), os.O_RDONLY)
        try:
            return read_bytes(descriptor, start, end - start)
        finally:
            os.close(descriptor)
    except (OSError, UnreadableMessageError):
        return b""


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
    making = Gathering(naming, skipped)
    for number, source in enumerate(sources):
        try:
            parts = [given[source]] if given is not None else opened(source, engine)
            making.add(number, parts, source.path)
        except InputError as error:
            # a file that cannot be opened is left out if there are others
            of_one_file = len(sources) > 1 and error.what.startswith("cannot be ")
            if on_bad_file == "fail" or not of_one_file:
                raise
            skipped.append(skip(source.path, "file", f"{error.what} ({error.found})"))
    table, grids, stored = making.table(), making.grids(), tuple(making.stored)
    datasets = {} if given is None else {one.path: ds for one, ds in given.items()}
    compared: dict[tuple[int, ...], int] = {}

    def differ(rows: Table) -> bool:
        pair = tuple(np.unique(rows["file"]).tolist())
        compared[pair] = compared.get(pair, 0) + 1
        if given is not None or compared[pair] > _COMPARED:
            return False
        return _stored_values_differ(rows, sources, grids, stored, engine)

    pairs = paired(table, sources, skipped, differ)
    if on_bad_file == "fail":
        refuse(skipped)
    found = selected(name, wanted, sources, grids, pairs, skipped, int(table.size))
    found.notes += making.notes(found)
    for one in (found, *found.alternatives):
        one.given, one.stored, one.engine = datasets, stored, engine
    return found


def _stored_values_differ(
    rows: Table,
    sources: Sequence[SourceFile],
    grids: Sequence[Grid],
    stored: tuple[StoredField, ...],
    engine: str,
) -> bool:
    """Whether fields of Datasets with the same level and time have other values."""
    grid = grids[int(rows["points"][0])]
    model = ModelTime(
        valid=0,
        lead=0,
        grids=(grid, grid, grid),
        native=bool(rows["level_kind"][0] != ISOBARIC),
        u=rows,
        v=rows,
        pressure=rows,
        files=tuple(sources),
        stored=stored,
        engine=engine,
    )
    probes = probes_of(grid.size)
    values = DatasetReader({}).answer([model], [[(row, probes.copy()) for row in rows]])[0]
    first = np.nan_to_num(values[0])
    return any(np.abs(np.nan_to_num(one) - first).max() > _SAME for one in values[1:])


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
