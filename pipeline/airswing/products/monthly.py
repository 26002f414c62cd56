"""Products by month, a folder of one file a month, opened as one lazy Dataset.

Assumes files named in order of time (``2008-07.nc``), each with the flights that begin in one
calendar month (UTC), the aircraft of each in alphabetical order. The Dataset has the reports of all
months ordered by aircraft, then by month, in dask chunks of whole aircraft: of each month a chunk
needs one contiguous slice.

What an aircraft has once (its platform, its resolutions) is that of its last month. Flights are
numbered month after month.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.products.ragged import aircraft_groups

FLIGHTS = "flight_total"
"""Attribute of a month: how many flights it has."""
_TALLIES = ("screened_out", "reading_audit", "reference_audit")
_EXTREMES: dict[str, Callable[[list[Any]], Any]] = {
    "time_coverage_start": min,
    "time_coverage_end": max,
    "geospatial_lat_min": min,
    "geospatial_lat_max": max,
    "geospatial_lon_min": min,
    "geospatial_lon_max": max,
}
COVERAGE = tuple(_EXTREMES)
"""Attributes of the time and space that a product covers (ACDD 1.3)."""


def joined_months(months: Sequence[xr.Dataset]) -> xr.Dataset:
    """Months as one lazy Dataset by aircraft.

    Parameters
    ----------
    months : sequence of Dataset
        In order of time, opened lazily; they stay open.

    Returns
    -------
    Dataset
        Dask-backed in chunks of whole aircraft; its ``uuid`` is a hash of those of the months, and
        counts in its attributes are summed over them.

    Raises
    ------
    ValueError
        If the months hold different variables or references, or aircraft out of order.
    """
    first = months[0]
    for other in months[1:]:
        same = set(other.variables) == set(first.variables) and all(
            np.array_equal(other[name].to_numpy(), first[name].to_numpy())
            for name in first.coords
            if not {"report", "aircraft"} & set(first[name].dims)
        )
        if not same:
            raise ValueError("the months hold different variables or references")
    names = [month["aircraft"].to_numpy().astype(str) for month in months]
    if any((part[1:] <= part[:-1]).any() for part in names):
        raise ValueError("the aircraft are not in alphabetical order")
    aircraft = np.unique(np.concatenate(names))
    places = [np.searchsorted(aircraft, part) for part in names]
    counts = np.zeros((len(months), aircraft.size), dtype=np.int64)
    for number, (place, month) in enumerate(zip(places, months, strict=True)):
        counts[number, place] = month["row_size"].to_numpy()
    attributes = _attributes(months)
    flights = np.cumsum([0, *(int(month.attrs.get(FLIGHTS, 0)) for month in months[:-1])])
    columns: dict[str, xr.Variable] = {}
    for name, variable in first.variables.items():
        if "report" in variable.dims:
            parts = [month.variables[name] for month in months]
            lazy = _lazy(
                parts, counts, flights if name == "flight" else None, attributes["uuid"], str(name)
            )
            columns[str(name)] = xr.Variable(variable.dims, lazy, variable.attrs)
        elif name != "aircraft" and "aircraft" in variable.dims:
            parts = [month.variables[name] for month in months]
            columns[str(name)] = _last_values(parts, places, aircraft.size)
    row_size = counts.sum(axis=0).astype(np.int32)
    columns["row_size"] = xr.Variable("aircraft", row_size, first["row_size"].attrs)
    coordinate = xr.Variable("aircraft", aircraft.astype(object), first["aircraft"].attrs)
    rest = first.drop_dims(["report", "aircraft"]).assign_attrs(attributes)
    order = [str(name) for name in first.data_vars if name in columns]
    return rest.assign({name: columns[name] for name in order}).assign_coords(aircraft=coordinate)


def _lazy(
    parts: Sequence[xr.Variable],
    counts: NDArray[np.int64],
    added: NDArray[np.int64] | None,
    *identity: object,
) -> da.Array:
    """One variable of reports over all months, (..., report), in chunks of whole aircraft."""
    groups = aircraft_groups(counts.sum(axis=0))
    start = np.cumsum(counts, axis=1) - counts
    stop = start + counts
    pieces = [
        (
            [
                slice(*map(int, rows))
                for rows in zip(start[:, group.start], stop[:, group.stop - 1], strict=True)
            ],
            counts[:, group],
        )
        for group in groups
    ]
    sizes = tuple(int(part.sum()) for _, part in pieces)
    outer = parts[0].shape[:-1]
    dtype = np.result_type(*(part.dtype for part in parts))
    lazy: da.Array = da.map_blocks(
        partial(_rows_of_block, parts=parts, pieces=pieces, added=added, dtype=dtype),
        chunks=(*((size,) for size in outer), sizes),
        dtype=dtype,
        meta=np.empty((0,) * (len(outer) + 1), dtype),
        name="-".join(["months", *map(str, identity)]),
    )
    return lazy


def _rows_of_block(
    *,
    parts: Sequence[xr.Variable],
    pieces: Sequence[tuple[list[slice], NDArray[np.int64]]],
    added: NDArray[np.int64] | None,
    dtype: np.dtype[np.generic],
    block_id: tuple[int, ...],
) -> NDArray[np.generic]:
    """Reports of one chunk of aircraft, by aircraft and month."""
    slices, counts = pieces[block_id[-1]]
    found = []
    for number, (part, rows) in enumerate(zip(parts, slices, strict=True)):
        if rows.start < rows.stop:
            values = part[..., rows].to_numpy()
            found.append(values if added is None else values + added[number].astype(dtype))
    if len(found) < 2:
        return found[0].astype(dtype) if found else np.empty((*parts[0].shape[:-1], 0), dtype)
    owner = np.concatenate([np.repeat(np.arange(month.size), month) for month in counts])
    return np.concatenate(found, axis=-1)[..., np.argsort(owner, kind="stable")].astype(dtype)


def _last_values(
    parts: Sequence[xr.Variable], places: Sequence[NDArray[np.int64]], aircraft: int
) -> xr.Variable:
    """Value of every aircraft in the last month that has it."""
    dims = parts[0].dims
    axis = dims.index("aircraft")
    kind = np.result_type(*(part.dtype for part in parts))
    values = np.zeros(
        [aircraft if dim == "aircraft" else parts[0].sizes[dim] for dim in dims], kind
    )
    by_aircraft = np.moveaxis(values, axis, 0)
    for part, place in zip(parts, places, strict=True):
        by_aircraft[place] = np.moveaxis(part.to_numpy(), axis, 0)
    return xr.Variable(dims, values, parts[0].attrs)


def _attributes(months: Sequence[xr.Dataset]) -> dict[str, object]:
    """Attributes of all months: counts summed, those of the last month for the rest."""
    found = dict(months[-1].attrs)
    if len(months) == 1:
        return found
    uuids = "".join(str(month.attrs["uuid"]) for month in months)
    found["uuid"] = hashlib.sha256(uuids.encode()).hexdigest()[:32]
    for name in (FLIGHTS, "kept_reports"):
        if name in found:
            found[name] = sum(int(month.attrs.get(name, 0)) for month in months)
    for name, choose in _EXTREMES.items():
        values = [month.attrs[name] for month in months if name in month.attrs]
        if values:
            found[name] = choose(values)
    for name in _TALLIES:
        if name in found:
            found[name] = json.dumps(_summed([json.loads(month.attrs[name]) for month in months]))
    return found


def _summed(parts: Sequence[object]) -> object:
    """Tallies of several months: counts summed, lists joined, else the last value."""
    tallies = [part for part in parts if isinstance(part, Mapping)]
    if len(tallies) == len(parts):
        names = dict.fromkeys(name for part in tallies for name in part)
        return {name: _summed([part[name] for part in tallies if name in part]) for name in names}
    counts = [part for part in parts if isinstance(part, int)]
    if len(counts) == len(parts):
        return sum(counts)
    full = [part for part in parts if part]
    lists = [part for part in full if isinstance(part, list) and isinstance(part[0], dict)]
    if len(lists) == len(full):
        return [entry for part in lists for entry in part]
    return parts[-1]


def month_bounds(month: str) -> tuple[np.datetime64, np.datetime64]:
    """Begin of a month such as ``2008-07`` and of the next one, datetime64[ns]."""
    begin = np.datetime64(month, "M")
    return begin.astype("M8[ns]"), (begin + 1).astype("M8[ns]")
