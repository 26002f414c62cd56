"""Ragged products written block by block, so that no process holds a whole one.

Assumes blocks of whole aircraft in order, each with the same variables; what is not on the
``report`` or ``aircraft`` dimension is the same in every block. Encodings, names and attributes are
those of :func:`airswing.products.netcdf.write_product`; columns of reports go into the file as
chunks (:mod:`airswing.products.chunks`), all else is small and is written at the end.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import h5py
import netCDF4
import numpy as np
import xarray as xr

from airswing.products.chunks import GrowingColumn, copy_column
from airswing.products.netcdf import (
    Packing,
    attribute_value,
    is_text,
    limit_chunk_cache,
    read_product,
    storage_of,
    with_plain_times,
)
from airswing.products.openable import written_here
from airswing.products.ragged import blocks
from airswing.products.whole_files import atomic
from airswing.vocabulary import describe


@contextlib.contextmanager
def ragged_writer(
    path: Path, *, reports: int, aircraft: int, carried: xr.Dataset | None = None
) -> Iterator[RaggedWriter]:
    """Open a product to be written block by block; it takes its name when all went well.

    Parameters
    ----------
    reports, aircraft : int
        Of all blocks together.
    carried : Dataset, optional
        Columns of the same reports that the product carries on from another, read lazily from it:
        they are copied as they are stored, and no block needs them.

    Yields
    ------
    RaggedWriter
        To be told when all is written (:meth:`RaggedWriter.finish`).

    Raises
    ------
    InputError
        If the file cannot be written.
    ValueError
        If it was not finished: nothing takes the name of a product that is not whole.
    """
    limit_chunk_cache()
    with atomic(path) as temporary:
        writer = RaggedWriter(temporary, reports=reports, aircraft=aircraft, carried=carried)
        with contextlib.closing(writer):
            yield writer
            if not writer.finished:
                raise ValueError(f"{path}: the product was not finished")
    written_here(path)


def write_joined(months: Path, path: Path) -> Path:
    """Write a folder of months as one product."""
    with read_product(months, lazy=True) as ds:
        reports, aircraft = ds.sizes["report"], ds.sizes["aircraft"]
        with ragged_writer(path, reports=reports, aircraft=aircraft) as writer:
            for block in blocks(ds):
                writer.append(block)
            writer.finish(ds.attrs)
    return path


def still_in_file(columns: xr.Dataset) -> bool:
    """Whether columns are those of the product they were opened from, none taken into memory.

    They are as :func:`airswing.products.netcdf.read_product` gave them, some left out.
    """
    # no public name tells what is in memory; where a later xarray has none, nothing is carried
    held = [getattr(variable.variable, "_in_memory", True) for variable in columns.values()]
    return "source" in columns.encoding and not any(held)


class RaggedWriter:
    """Appends blocks to a NetCDF file; parameters as for :func:`ragged_writer`.

    Attributes
    ----------
    finished : bool
        Whether the file is whole.
    """

    finished = False

    def __init__(
        self, path: Path, *, reports: int, aircraft: int, carried: xr.Dataset | None = None
    ) -> None:
        self._path, self._carried = path, carried
        self._sizes = {"report": reports, "aircraft": aircraft}
        self._file: h5py.File | None = None  # while columns are written
        self._columns: dict[str, GrowingColumn] = {}
        self._small: dict[str, list[xr.DataArray]] = {}

    def append(self, block: xr.Dataset) -> None:
        """Write the next block, of which every variable must be in the vocabulary."""
        known = [] if self._carried is None else self._carried.data_vars
        ready = _plain(block.drop_vars([name for name in known if name in block]))
        if self._file is None:
            self._begin(ready)
        for name in map(str, ready.variables):
            if name in self._columns:
                self._columns[name].append(ready[name].to_numpy())
            elif "aircraft" in ready[name].dims or name not in self._small:
                self._small.setdefault(name, []).append(ready[name])

    def finish(self, attributes: Mapping[str, object]) -> None:
        """Copy what is carried on; write all that is not a column of reports."""
        if self._carried is not None:
            if self._file is None:
                raise ValueError("a product of no block carries nothing on")
            with h5py.File(self._carried.encoding["source"], "r") as source:
                for name in map(str, self._carried.data_vars):
                    copy_column(source[name], self._file[name])
        self.close()
        with self._defined("a") as file:
            for parts in self._small.values():
                if is_text(parts[0]):
                    _write_names(file, parts)
                else:
                    self._write_small(file, parts)
            for name, value in attributes.items():
                file.setncattr(str(name), attribute_value(value))
        self.finished = True

    def close(self) -> None:
        """Close the file, whole or not."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _begin(self, first: xr.Dataset) -> None:
        """Create every column of reports, and take the file up where columns are written."""
        with self._defined("w") as file:
            for name in _of_reports(first):
                self._create(file, first[name])
            if self._carried is not None:
                described = _plain(self._carried.isel(report=slice(0, 0)))
                for name in _of_reports(described):
                    self._create(file, described[name])
                self._small |= {str(name): [described[name]] for name in described.coords}
        # The NetCDF library defines variables, h5py writes their chunks: it alone takes
        # them packed.
        self._file = h5py.File(self._path, "r+")
        self._columns = {name: GrowingColumn(self._file[name]) for name in _of_reports(first)}

    @contextlib.contextmanager
    def _defined(self, mode: Literal["w", "a"]) -> Iterator[netCDF4.Dataset]:
        """Open the file to define variables in it and to write small ones."""
        with netCDF4.Dataset(self._path, mode, format="NETCDF4") as file:
            file.set_auto_mask(False)
            yield file

    def _create(
        self, file: netCDF4.Dataset, variable: xr.DataArray
    ) -> netCDF4.Variable[np.generic]:
        sizes = {dim: self._sizes.get(str(dim), size) for dim, size in variable.sizes.items()}
        stored = storage_of(variable, sizes)
        fill = variable.attrs.get("_FillValue") if stored.fill is None else stored.fill
        named = {str(k): n for k, n in sizes.items()}
        return _create_array(file, variable, np.dtype(stored.dtype), named, fill, stored.packing)

    def _write_small(self, file: netCDF4.Dataset, parts: list[xr.DataArray]) -> None:
        first, made = parts[0], self._create(file, parts[0])
        axis = first.dims.index("aircraft") if "aircraft" in first.dims else None
        values = [part.to_numpy() for part in parts]
        made[...] = values[0] if axis is None else np.concatenate(values, axis=axis)


def _plain(block: xr.Dataset) -> xr.Dataset:
    """A block as it is stored."""
    return with_plain_times(describe(block).drop_encoding())


def _of_reports(block: xr.Dataset) -> list[str]:
    """Names of its columns of reports."""
    return [str(name) for name, variable in block.variables.items() if "report" in variable.dims]


def _write_names(file: netCDF4.Dataset, parts: list[xr.DataArray]) -> None:
    words = np.concatenate([np.char.encode(part.to_numpy().astype(str)) for part in parts])
    # HDF5 has no text of no octets.
    words = words.astype(f"S{max(words.dtype.itemsize, 1)}")
    width = words.dtype.itemsize
    sizes = {str(parts[0].dims[0]): words.size, f"string{width}": width}
    made = _create_array(file, parts[0], np.dtype("S1"), sizes)
    made.setncattr("_Encoding", "utf-8")
    made.set_auto_chartostring(False)
    made[:] = words.view("S1").reshape(len(words), -1)


def _create_array(
    file: netCDF4.Dataset,
    variable: xr.DataArray,
    kind: np.dtype[Any],  # netCDF4's stubs know no single characters
    sizes: Mapping[str, int],
    fill: np.generic | None = None,
    packing: Packing | None = None,
) -> netCDF4.Variable[np.generic]:
    for dim, size in sizes.items():
        if dim not in file.dimensions:
            file.createDimension(dim, size)
    made = file.createVariable(
        str(variable.name), kind, tuple(sizes), fill_value=fill, **(packing or Packing())
    )
    made.set_auto_maskandscale(False)
    attributes = {k: v for k, v in variable.attrs.items() if k != "_FillValue"}
    made.setncatts({key: attribute_value(value) for key, value in attributes.items()})
    return made
