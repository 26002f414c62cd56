"""Which fields of which Datasets make a wind profile at which time: a catalogue, nothing read.

Assumptions and validity
------------------------
* As for GRIB files (:mod:`airswing.reference.geometry.wind_profiles`): u and v (and pressure) of
  one profile may stand in different files; among several leads the shortest counts, and so on.
* A file that cannot be opened is left out and named where there are others; a fault of another
  kind, which would be that of every file, is told.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.lead_times import Wanted, lead_condition
from airswing.reference.geometry.model_time import HYBRID, SourceFile
from airswing.reference.geometry.wind_profiles import (
    Catalogue,
    Skipped,
    paired,
    refuse,
    selected,
    skip,
)
from airswing.reference.grib.catalogue import find_files, identified
from airswing.reference.grib.filecache import identify
from airswing.reference.gridded.cf.naming import Naming
from airswing.reference.gridded.gathering import Gathering
from airswing.reference.gridded.gridded_sampling import GIVEN
from airswing.reference.gridded.opening import (
    identify_store,
    is_same,
    is_zarr,
    kind_of,
    opened,
)
from airswing.reference.gridded.stored import GriddedTime, StoredField
from airswing.reference.gridded.wrfout import is_wrfout


@dataclass(eq=False, repr=False)
class GriddedCatalogue(Catalogue):
    """Wind profiles of a reference that comes as Datasets.

    ``stored`` says how the variables are read, as rows' `offset` numbers them.
    """

    stored: tuple[StoredField, ...] = ()
    engine: str = ""

    def model_time(self, number: int) -> GriddedTime:
        """One model time with the files it needs, small enough to send to another process."""
        plain = super().model_time(number)
        columns = {one.name: getattr(plain, one.name) for one in fields(plain)}
        return GriddedTime(**columns, fields=self.stored, engine=self.engine)

    def reading(self, number: int, needed: NDArray[np.bool_]) -> tuple[int, int, int]:
        """As `Catalogue.reading`: fields, their octets before compression, none in place."""
        rows = slice(int(self.bounds[number]), int(self.bounds[number + 1]))
        tables = [self.u[rows][needed], self.v[rows][needed]]
        if self.level_kinds[number] == HYBRID and needed.any():
            tables.append(self.pressure[rows])
        table = np.concatenate(tables)
        keys = np.unique(table[["file", "part", "offset", "index", "level_index"]])
        size = int(self.grids[int(self.grid_numbers[number])].size)
        parts = np.array([len(one.names) for one in self.stored])
        count = int(parts[keys["offset"]].sum()) if keys.size else 0
        return count, 4 * size * count, 0

    def batches(self, numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Model times that share chunks of a file."""
        if not numbers.size:
            return []
        first = self.u[self.bounds[numbers]]
        # file, part and variable, then the chunk along up to three outer dimensions: a batch has
        # one key, so that no chunk is unpacked twice
        keys = np.zeros((numbers.size, 6), dtype=np.int64)
        keys[:, 0], keys[:, 1], keys[:, 2] = first["file"], first["part"], first["offset"]
        for offset in np.unique(first["offset"]):
            mine, stored = first["offset"] == offset, self.stored[int(offset)]
            places = stored.outer_places(first["index"][mine])
            for column, (place, (dim, _)) in enumerate(
                zip(places[:3], stored.outer[:3], strict=True)
            ):
                keys[mine, 3 + column] = np.searchsorted(stored.starts(dim), place, side="right")
        _, group = np.unique(keys, axis=0, return_inverse=True)
        group = np.ravel(group)
        order = np.argsort(group, kind="stable")
        return sorted(
            np.split(numbers[order], np.flatnonzero(np.diff(group[order])) + 1),
            # in the order of time, which reports come in, too
            key=lambda own: int(own[0]),
        )

    @property
    def fingerprint(self) -> str:
        """Hash of everything collocation depends on."""
        digest = hashlib.blake2b(digest_size=16)
        digest.update(super().fingerprint.encode())
        digest.update(repr((self.stored, self.engine)).encode())
        return digest.hexdigest()

    def changed(self) -> Skipped:
        """Files that vanished or were replaced since the catalogue was built."""
        result: Skipped = []
        for file in self.files if self.engine != GIVEN else ():
            try:
                if not is_same(file):
                    result.append(skip(file.path, "file", "replaced since it was catalogued"))
            except OSError:
                result.append(skip(file.path, "file", "vanished since it was catalogued"))
        return result


def find_stored(files: str | Sequence[str], name: str) -> list[str]:
    """Files and Zarr stores that patterns name, as :func:`find_files` gives files."""
    return find_files(files, name, is_one=lambda path: os.path.isfile(path) or is_zarr(path))


def engine_of(path: str) -> str:
    """How a file is to be opened: ``grib``, ``zarr``, ``wrf`` or ``netcdf``.

    Raises
    ------
    InputError
        Where it is none of them, or cannot be read.
    """
    try:
        kind = kind_of(path)
    except OSError as error:
        raise InputError("cannot be opened", file=path, found=error.strerror) from error
    if not kind:
        raise InputError(
            "neither GRIB nor NetCDF nor a Zarr store",
            file=path,
            remedy="Model winds come as GRIB, NetCDF, Zarr or wrfout",
        )
    if kind != "netcdf":
        return kind
    return "wrf" if is_wrfout(opened(identify(path), "netcdf")[0]) else "netcdf"


def build_gridded_catalogue(
    files: str | Sequence[str] | xr.Dataset,
    *,
    name: str,
    engine: str,
    lead: str = "any",
    member: int | None = None,
    naming: Naming | None = None,
    on_bad_file: str = "skip",
) -> GriddedCatalogue:
    """Catalogue the winds of files that are opened as Datasets, or of a Dataset.

    Arguments as of :func:`airswing.reference.catalogues.build_catalogue`; the engine, which is
    none of GRIB's octets, has no meaning for a Dataset.

    Raises
    ------
    InputError
        No file, no usable wind, or something needed that is missing or ambiguous.
    """
    lead_condition(lead)
    skipped: Skipped = []
    making = Gathering(naming or Naming(), skipped)
    given: dict[str, xr.Dataset] = {}
    if isinstance(files, xr.Dataset):
        engine = GIVEN
        path = f"Dataset {name}"
        given[path] = files
        sources = [SourceFile(path, 0, 0, _token(files))]
        making.add(0, [files], path)
    else:
        sources = identified(find_stored(files, name), skipped, by=_identity)
        for number, source in enumerate(sources):
            try:
                making.add(number, opened(source, engine), source.path)
            except InputError as error:
                if on_bad_file == "fail" or not _of_one_file(error, sources):
                    raise
                skipped.append(skip(source.path, "file", f"{error.what} ({error.found})"))
    table = making.table()
    pairs = paired(table, sources, skipped)
    if on_bad_file == "fail":
        refuse(skipped)
    wanted = Wanted(lead, member)
    found = selected(name, wanted, sources, making.grids(), pairs, skipped, int(table.size))
    found.notes += making.notes(found)
    found.given = given
    columns = {one.name: getattr(found, one.name) for one in fields(found)}
    return GriddedCatalogue(**columns, stored=tuple(making.stored), engine=engine)


def _token(ds: xr.Dataset) -> str:
    from dask.base import tokenize

    return str(tokenize(ds))


def _identity(path: str) -> SourceFile:
    return identify_store(path) if os.path.isdir(path) else identify(path)


def _of_one_file(error: InputError, sources: Sequence[SourceFile]) -> bool:
    """Whether a fault is of one damaged file among several, not of the kind of files."""
    return len(sources) > 1 and error.what.startswith("cannot be ")
