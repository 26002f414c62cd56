"""Functions over ragged Datasets in blocks of whole aircraft, lazy where the Dataset is.

Assumes contiguous ragged reports: those of one aircraft are consecutive, ``row_size`` counts them.
The functions that are mapped look at one aircraft at a time, so that their result does not depend
on the blocks. Blocks of a dask-backed Dataset are about as long as its chunks, moved to the borders
between aircraft. Where ``row_size`` itself is a dask array, the borders are not known without
computing it; the Dataset is then one block.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from dask.delayed import Delayed, delayed
from numpy.typing import NDArray

from airswing.products.ragged import aircraft_groups, row_bounds


def is_lazy(ds: xr.Dataset, names: Iterable[str] | None = None) -> bool:
    """Return True where a variable (of ``names``, of all by default) is a dask array."""
    chosen = ds.variables if names is None else [name for name in names if name in ds.variables]
    return any(ds.variables[name].chunks is not None for name in chosen)


def aircraft_batches(ds: xr.Dataset, reports: int) -> Iterator[xr.Dataset]:
    """Divide a Dataset into batches of whole aircraft without computing anything.

    Parameters
    ----------
    ds : Dataset
        Ragged; without index variables.
    reports : int
        Reports of a batch, where no single aircraft has more.

    Yields
    ------
    Dataset
        One batch, a single chunk in ``report`` and ``aircraft``.
    """
    row_size = ds.variables["row_size"]
    lazy = is_lazy(ds)
    if row_size.chunks is not None or not row_size.size:
        yield ds.chunk({"report": -1, "aircraft": -1}) if lazy else ds
        return
    start, stop = row_bounds(row_size.to_numpy())
    for group in aircraft_groups(row_size.to_numpy(), reports):
        part = ds.isel(
            {"aircraft": group, "report": slice(int(start[group.start]), int(stop[group.stop - 1]))}
        )
        yield part.chunk({"report": -1}) if lazy else part


def lazy_dataset(
    task: Any, template: xr.Dataset, sizes: Mapping[str, int], coordinates: xr.Dataset
) -> xr.Dataset:
    """Return the Dataset that a delayed task makes, as dask arrays.

    Parameters
    ----------
    task : Delayed
        Of a Dataset.
    template : Dataset
        With the variables, dimensions, types and attributes of the result.
    sizes : mapping of str to int
        Sizes of dimensions that differ from the template's.
    coordinates : Dataset
        Index variables of the result, in memory, where they differ from the template's.

    Returns
    -------
    Dataset
    """
    variables = {}
    for name, variable in template.variables.items():
        if name in template.indexes:
            variables[name] = coordinates.variables.get(name, variable)
            continue
        shape = tuple(sizes.get(str(dim), template.sizes[dim]) for dim in variable.dims)
        values = da.from_delayed(  # type: ignore[no-untyped-call]
            delayed(_values)(task, name), shape=shape, dtype=variable.dtype
        )
        variables[name] = xr.Variable(variable.dims, values, variable.attrs)
    coords = {name: variables.pop(name) for name in template.coords}
    return xr.Dataset(variables, coords, template.attrs)


def single_task(array: da.Array) -> Delayed:
    """Return all values of a dask array as one delayed object that shares the array's tasks."""
    one_chunk = array.rechunk(-1).to_delayed(optimize_graph=False)  # type: ignore[no-untyped-call]
    task: Delayed = one_chunk.item()
    return task


def _parts(arg: Any) -> Any:
    """Take a Dataset apart, so that the tasks of its variables stay shared; other values as is."""
    if not isinstance(arg, xr.Dataset):
        return arg
    values = [
        single_task(variable.data) if variable.chunks is not None else variable.to_numpy()
        for variable in arg.variables.values()
    ]
    header = [(name, variable.dims, variable.attrs) for name, variable in arg.variables.items()]
    return "dataset", header, values, list(arg.coords), arg.attrs


def _apply(function: Callable[..., xr.Dataset], parts: list[Any], kwargs: Any) -> xr.Dataset:
    args = []
    for part in parts:
        if not (isinstance(part, tuple) and part and part[0] == "dataset"):
            args.append(part)
            continue
        _, header, values, coords, attrs = part
        variables = {
            name: (dims, value, attributes)
            for (name, dims, attributes), value in zip(header, values, strict=True)
        }
        args.append(xr.Dataset(variables, attrs=attrs).set_coords(coords))
    return function(*args, **kwargs)


def _values(ds: xr.Dataset, name: Hashable) -> NDArray[Any]:
    return np.asarray(ds[name].to_numpy())


def _zeros(ds: xr.Dataset, sizes: Mapping[str, int]) -> xr.Dataset:
    """Dataset of the same variables in memory, filled with zeros, with some sizes changed."""
    variables = {}
    for name, variable in ds.variables.items():
        shape = [sizes.get(str(dim), ds.sizes[dim]) for dim in variable.dims]
        if name in ds.indexes:
            variables[name] = variable[: shape[0]]
        else:
            variables[name] = xr.Variable(
                variable.dims, np.zeros(shape, variable.dtype), variable.attrs
            )
    coords = {name: variables.pop(name) for name in ds.coords}
    return xr.Dataset(variables, coords, ds.attrs)


def map_aircraft(
    function: Callable[..., xr.Dataset], ds: xr.Dataset, *args: Any, **kwargs: Any
) -> xr.Dataset:
    """Apply a function of whole aircraft to a Dataset, block by block where it is lazy.

    Parameters
    ----------
    function : callable
        ``function(block, *args, **kwargs)`` returns a Dataset whose dimensions are those of the
        block and others of fixed size; it must accept a block without reports.
    ds : Dataset
        Ragged.
    *args, **kwargs
        Given to the function; a Dataset among them is computed before the function is called.

    Returns
    -------
    Dataset
        Dask-backed where ``ds`` or an argument is.
    """
    if not is_lazy(ds) and not any(isinstance(arg, xr.Dataset) and is_lazy(arg) for arg in args):
        return function(ds, *args, **kwargs)
    none = {"report": 0, "aircraft": 0}
    zeros = [_zeros(arg, {}) if isinstance(arg, xr.Dataset) else arg for arg in args]
    template = function(_zeros(ds, none), *zeros, **kwargs)
    chunks = [
        max(v.chunks[v.dims.index("report")])
        for v in ds.variables.values()
        if v.chunks is not None and "report" in v.dims
    ]
    parts = []
    for batch in aircraft_batches(ds, max(chunks, default=ds.sizes["report"])):
        sizes = {"report": batch.sizes["report"], "aircraft": batch.sizes["aircraft"]}
        task = delayed(_apply)(function, [_parts(one) for one in (batch, *args)], kwargs)
        parts.append(lazy_dataset(task, template, sizes, batch))
    if len(parts) == 1:
        return parts[0]
    variables = {}
    for name, variable in parts[0].variables.items():
        dim = next((dim for dim in ("report", "aircraft") if dim in variable.dims), None)
        if name in ds.indexes:
            variables[name] = ds.variables[name]
        elif dim is None:
            variables[name] = variable
        else:
            whole = da.concatenate(  # type: ignore[no-untyped-call]
                [part.variables[name].data for part in parts], axis=variable.dims.index(dim)
            )
            variables[name] = xr.Variable(variable.dims, whole, variable.attrs)
    coords = {name: variables.pop(name) for name in parts[0].coords}
    return xr.Dataset(variables, coords, parts[0].attrs)
