"""Ragged products written block by block, so that no process holds a whole one.

Assumes blocks of whole aircraft in order, each with the same variables; what is not on the
``report`` or ``aircraft`` dimension is the same in every block. Encodings, names and attributes are
those of :func:`airswing.products.write_product`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import xarray as xr

from airswing.products import (
    atomic,
    attribute_value,
    encoding_of,
    is_text,
    limit_chunk_cache,
    with_plain_times,
)
from airswing.vocabulary import describe


@contextlib.contextmanager
def ragged_writer(path: Path, *, reports: int, aircraft: int) -> Iterator[RaggedWriter]:
    """Open a product to be written block by block; it takes its name when all went well.

    Parameters
    ----------
    path : Path
    reports, aircraft : int
        Of all blocks together.

    Yields
    ------
    RaggedWriter

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    limit_chunk_cache()
    with atomic(path) as temporary, netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
        yield RaggedWriter(file, reports=reports, aircraft=aircraft)


class RaggedWriter:
    """Appends blocks to a NetCDF file.

    Parameters
    ----------
    file : netCDF4.Dataset
    reports, aircraft : int
    """

    def __init__(self, file: Any, *, reports: int, aircraft: int) -> None:
        self._file = file
        self._sizes = {"report": reports, "aircraft": aircraft}
        self._written = {"report": 0, "aircraft": 0}
        self._names: dict[str, list[xr.DataArray]] = {}
        file.set_auto_mask(False)

    def append(self, block: xr.Dataset) -> None:
        """Write the next block.

        Parameters
        ----------
        block : Dataset
            Every variable must be in the vocabulary.
        """
        ready = with_plain_times(describe(block).drop_encoding())
        if not self._file.variables:
            self._create(ready)
        for name, variable in ready.variables.items():
            known = bool(self._written["aircraft"]) and not set(variable.dims) & set(self._sizes)
            if not known and is_text(ready[name]):
                self._names.setdefault(str(name), []).append(ready[name])
            if known or is_text(ready[name]):
                continue
            place = tuple(self._next(dim, size) for dim, size in variable.sizes.items())
            self._file[str(name)][place if place else ...] = variable.to_numpy()
        for dim in self._written:
            self._written[dim] += ready.sizes.get(dim, 0)

    def describe(self, attributes: Mapping[str, Any]) -> None:
        """Write the global attributes, and the names: how long they are is known at the end.

        Parameters
        ----------
        attributes : mapping
        """
        for parts in self._names.values():
            self._write_names(parts)
        for name, value in attributes.items():
            self._file.setncattr(str(name), attribute_value(value))

    def _next(self, dim: Any, size: int) -> slice:
        start = self._written.get(str(dim), 0)
        return slice(start, start + size)

    def _create(self, first: xr.Dataset) -> None:
        for dim, size in first.sizes.items():
            self._file.createDimension(str(dim), self._sizes.get(str(dim), size))
        for name in first.variables:
            if not is_text(first[name]):
                self._create_variable(first[name])

    def _create_variable(self, variable: xr.DataArray) -> None:
        sizes = {dim: self._sizes.get(str(dim), size) for dim, size in variable.sizes.items()}
        options = encoding_of(variable, sizes)
        kind = np.dtype(options.pop("dtype"))
        fill = options.pop("_FillValue", variable.attrs.get("_FillValue"))
        self._create_array(variable, kind, tuple(map(str, variable.dims)), fill, options)

    def _write_names(self, parts: list[xr.DataArray]) -> None:
        first = parts[0]
        words = np.concatenate([np.char.encode(part.to_numpy().astype(str)) for part in parts])
        words = words.astype(f"S{max(words.dtype.itemsize, 1)}")
        length = f"string{words.dtype.itemsize}"
        if length not in self._file.dimensions:
            self._file.createDimension(length, words.dtype.itemsize)
        made = self._create_array(first, np.dtype("S1"), (*map(str, first.dims), length))
        made.setncattr("_Encoding", "utf-8")
        made.set_auto_chartostring(False)
        made[:] = words.view("S1").reshape(len(words), -1)

    def _create_array(
        self,
        variable: xr.DataArray,
        kind: np.dtype[Any],
        dims: tuple[str, ...],
        fill: Any = None,
        options: Mapping[str, Any] | None = None,
    ) -> Any:
        made = self._file.createVariable(
            str(variable.name), kind, dims, fill_value=fill, **(options or {})
        )
        made.set_auto_maskandscale(False)
        attributes = {k: v for k, v in variable.attrs.items() if k != "_FillValue"}
        made.setncatts({key: attribute_value(value) for key, value in attributes.items()})
        return made
