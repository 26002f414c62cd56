"""Functions over ragged Datasets in blocks of whole aircraft, lazy where the Dataset is.

Assumes contiguous ragged reports: those of one aircraft are consecutive, ``row_size`` counts them.
The mapped functions process one aircraft at a time, so that their result does not depend on the
blocks. Blocks of a dask-backed Dataset are about as long as its chunks, moved to the borders
between aircraft. Where ``row_size`` itself is a dask array, the borders are not known without
computing it; the Dataset is then one block.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from dask.delayed import Delayed, delayed

from airswing.products.ragged import aircraft_groups, row_bounds


def _is_lazy(ds: xr.Dataset) -> bool:
    return any(variable.chunks is not None for variable in ds.variables.values())


def aircraft_batches(ds: xr.Dataset, reports: int) -> Iterator[xr.Dataset]:
    """Divide a Dataset into batches of whole aircraft without computing anything.

    A batch has at most ``reports`` reports, unless a single aircraft has more, and is a single
    chunk.
    """
    row_size = ds.variables["row_size"]
    lazy = _is_lazy(ds)
    if row_size.chunks is not None or not row_size.size:
        yield ds.chunk({"report": -1, "aircraft": -1}) if lazy else ds
        return
    start, stop = row_bounds(row_size.to_numpy())
    for group in aircraft_groups(row_size.to_numpy(), reports):
        rows = slice(int(start[group.start]), int(stop[group.stop - 1]))
        batch = ds.isel(aircraft=group, report=rows)
        yield batch.chunk({"report": -1}) if lazy else batch


def lazy_dataset(
    task: Any, template: xr.Dataset, sizes: Mapping[str, int], coordinates: xr.Dataset
) -> xr.Dataset:
    """Return the Dataset that a delayed ``task`` makes, as dask arrays.

    The ``template`` has its variables, dimensions, types and attributes; ``sizes`` and the index
    variables of ``coordinates`` are those that differ from the template's.
    """
    variables: dict[Hashable, xr.Variable] = {}
    for name, variable in template.variables.items():
        if name in template.indexes:
            variables[name] = coordinates.variables.get(name, variable)
            continue
        shape = tuple(sizes.get(str(dim), template.sizes[dim]) for dim in variable.dims)
        values = da.from_delayed(  # type: ignore[no-untyped-call]
            task[name].to_numpy(), shape=shape, dtype=variable.dtype
        )
        variables[name] = xr.Variable(variable.dims, values, variable.attrs)
    return _dataset(variables, list(template.coords), template.attrs)


def _dataset(variables: Any, coords: list[Hashable], attrs: Any) -> xr.Dataset:
    return xr.Dataset(variables, attrs=attrs).set_coords(coords)


def single_task(array: da.Array) -> Delayed:
    """Return all values of a dask array as one delayed object that shares the array's tasks."""
    one_chunk = array.rechunk(-1).to_delayed(optimize_graph=False)  # type: ignore[no-untyped-call]
    task: Delayed = one_chunk.item()
    return task


def _empty(ds: xr.Dataset) -> xr.Dataset:
    """Dataset of the same variables in memory without reports and aircraft, zeros elsewhere."""
    variables = {}
    for name, variable in ds.variables.items():
        shape = [0 if dim in ("report", "aircraft") else ds.sizes[dim] for dim in variable.dims]
        values = variable[: shape[0]] if name in ds.indexes else np.zeros(shape, variable.dtype)
        variables[name] = xr.Variable(variable.dims, values, variable.attrs)
    return _dataset(variables, list(ds.coords), ds.attrs)


def map_aircraft(
    function: Callable[..., xr.Dataset], ds: xr.Dataset, *args: xr.Dataset, **kwargs: Any
) -> xr.Dataset:
    """Apply a function of whole aircraft to a ragged Dataset, block by block where it is lazy.

    ``function(block, *args, **kwargs)`` returns a Dataset whose dimensions are those of the block
    and others of fixed size; it must accept Datasets without reports and aircraft. The Datasets
    ``args`` are computed before it is called. The result is dask-backed where ``ds`` or an argument
    is.
    """
    if not any(_is_lazy(dataset) for dataset in (ds, *args)):
        return function(ds, *args, **kwargs)
    template = function(*(_empty(dataset) for dataset in (ds, *args)), **kwargs)
    chunks = [
        max(v.chunks[v.dims.index("report")])
        for v in ds.variables.values()
        if v.chunks is not None and "report" in v.dims
    ]
    blocks = []
    for batch in aircraft_batches(ds, max(chunks, default=ds.sizes["report"])):
        arguments = []
        for dataset in (batch, *args):
            # variables one by one: dask would not share the tasks of a whole Dataset
            variables = {
                name: (v.dims, v.to_numpy() if v.chunks is None else single_task(v.data), v.attrs)
                for name, v in dataset.variables.items()
            }
            arguments.append(delayed(_dataset)(variables, list(dataset.coords), dataset.attrs))
        sizes = {name: batch.sizes[name] for name in ("report", "aircraft")}
        blocks.append(lazy_dataset(delayed(function)(*arguments, **kwargs), template, sizes, batch))
    merged: dict[Hashable, xr.Variable] = {}
    for name, variable in blocks[0].variables.items():
        dim = next((dim for dim in ("report", "aircraft") if dim in variable.dims), None)
        if name in ds.indexes:
            merged[name] = ds.variables[name]
        elif dim is None:
            merged[name] = variable
        else:
            values = da.concatenate(  # type: ignore[no-untyped-call]
                [block.variables[name].data for block in blocks], axis=variable.dims.index(dim)
            )
            merged[name] = xr.Variable(variable.dims, values, variable.attrs)
    return _dataset(merged, list(blocks[0].coords), blocks[0].attrs)
