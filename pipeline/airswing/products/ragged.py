"""Contiguous ragged arrays: reports of many aircraft on one dimension, also of many months.

Assumes the CF contiguous ragged form: the reports of one aircraft are consecutive, in the order of
the ``aircraft`` dimension, and ``row_size`` counts them. A product by month is a folder of files
named in order of time (``2008-07.nc``), each with the flights that begin in one calendar month
(UTC), the aircraft of each in alphabetical order.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

BLOCK_REPORTS = 200_000
"""Most reports of a block, unless a single aircraft has more."""
FLIGHTS = "flight_total"
"""Attribute of a month: its number of flights."""
_TALLIES = ("screened_out", "reading_audit", "reference_audit")
COVERAGE = (
    *("time_coverage_start", "time_coverage_end", "geospatial_lat_min", "geospatial_lat_max"),
    *("geospatial_lon_min", "geospatial_lon_max"),
)
"""Attributes of the time and space that a product covers (ACDD 1.3)."""


def row_bounds(row_size: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First report and one past the last report (int64) of every aircraft, from their counts."""
    stop = np.cumsum(row_size, dtype=np.int64)
    return stop - np.asarray(row_size, dtype=np.int64), stop


def aircraft_groups(row_size: NDArray[np.integer], limit: int = BLOCK_REPORTS) -> list[slice]:
    """Group consecutive aircraft: at most ``limit`` reports in a group, or a single aircraft."""
    found: list[slice] = []
    total = 0
    for number, size in enumerate(np.asarray(row_size).tolist()):
        total += size
        if found and total <= limit:
            found[-1] = slice(found[-1].start, number + 1)
        else:
            found.append(slice(number, number + 1))
            total = size
    return found


def blocks(
    ds: xr.Dataset, names: Sequence[str] | None = None, *, limit: int | None = None
) -> Iterator[xr.Dataset]:
    """Iterate over an archive in blocks of whole aircraft, each in memory.

    Parameters
    ----------
    ds : Dataset
        Ragged, in memory or opened lazily; without ``row_size`` the reports of one aircraft.
    names : sequence of str, optional
        Variables to read, where they exist, in addition to ``row_size``; all by default.
    limit : int, optional
        Reports of a block; `BLOCK_REPORTS` by default.
    """
    if "row_size" not in ds:
        ds = ds.assign(row_size=("aircraft", np.array([ds.sizes["report"]])))
    row_size = ds["row_size"].to_numpy()
    start, stop = row_bounds(row_size)
    wanted = dict.fromkeys([*(names or ()), "row_size"])
    chosen = ds if names is None else ds[[name for name in wanted if name in ds]]
    for group in aircraft_groups(row_size, BLOCK_REPORTS if limit is None else limit):
        reports = slice(int(start[group.start]), int(stop[group.stop - 1]))
        yield chosen.isel({"aircraft": group, "report": reports}, missing_dims="ignore").load()


def time_span(ds: xr.Dataset) -> tuple[np.datetime64, np.datetime64]:
    """First and last time of an archive with at least one report."""
    times = [part["time"].to_numpy() for part in blocks(ds, ["time"]) if part.sizes["report"]]
    return min(time.min() for time in times), max(time.max() for time in times)


def some_reports(ds: xr.Dataset, chosen: NDArray[np.bool_]) -> xr.Dataset:
    """Select reports by a mask (report,), in memory; an aircraft may keep no report."""
    size = np.bincount(aircraft_of_report(ds)[chosen], minlength=ds.sizes["aircraft"])
    return ds.isel(report=np.flatnonzero(chosen)).assign(row_size=("aircraft", size))


def joined(parts: Sequence[xr.Dataset]) -> xr.Dataset:
    """Concatenate blocks of whole aircraft, with the attributes of the first."""
    found = parts[0].drop_vars(
        [name for name, v in parts[0].variables.items() if {"report", "aircraft"} & set(v.dims)]
    )
    for name, variable in parts[0].variables.items():
        dim = next((dim for dim in ("report", "aircraft") if dim in variable.dims), None)
        if dim is not None:
            values = [part[name].to_numpy() for part in parts]
            whole = np.concatenate(values, axis=variable.dims.index(dim))
            found[name] = (variable.dims, whole, variable.attrs)
    return found


def aircraft_of_report(ds: xr.Dataset) -> NDArray[np.int64]:
    """Index of the aircraft each report belongs to, (report,) int64, from ``row_size``."""
    row_size = ds["row_size"].to_numpy()
    return np.repeat(np.arange(row_size.size, dtype=np.int64), row_size)


def aircraft_reports(ds: xr.Dataset, aircraft: str) -> xr.Dataset:
    """Select the reports of one aircraft.

    Parameters
    ----------
    ds : Dataset
        Ragged, with ``row_size``.
    aircraft : str
        Its identifier.

    Returns
    -------
    Dataset
        Its reports in the order of time; ``aircraft`` is a scalar coordinate.

    Raises
    ------
    KeyError
        If the aircraft is not in the Dataset.

    Examples
    --------
    >>> one = airswing.aircraft_reports(headings, "N403")
    >>> one["aircraft"].item(), int(one["row_size"]) == one.sizes["report"]
    ('N403', True)
    """
    names = ds["aircraft"].to_numpy().astype(str).tolist()
    if aircraft not in names:
        raise KeyError(f"no aircraft {aircraft!r}; known: {', '.join(names)}")
    number = names.index(aircraft)
    start, stop = row_bounds(ds["row_size"].to_numpy())
    return ds.isel(aircraft=number, report=slice(int(start[number]), int(stop[number])))


def joined_months(months: Sequence[xr.Dataset]) -> xr.Dataset:
    """Months, in order of time and opened lazily, as one lazy Dataset by aircraft.

    It is dask-backed in chunks of whole aircraft: a chunk needs one contiguous slice of each month.
    Its ``uuid`` is a hash of those of the months; counts in its attributes are summed over them. A
    ValueError is raised if months hold different variables or references, or unordered aircraft.
    """
    first = months[0]
    same = {name for name in first.coords if not {"report", "aircraft"} & set(first[name].dims)}
    for other in months[1:]:
        if set(other.variables) != set(first.variables) or not all(
            np.array_equal(other[name].to_numpy(), first[name].to_numpy()) for name in same
        ):
            raise ValueError("the months hold different variables or references")
    names = [month["aircraft"].to_numpy().astype(str) for month in months]
    if any((part[1:] <= part[:-1]).any() for part in names):
        raise ValueError("the aircraft are not in alphabetical order")
    aircraft = np.unique(np.concatenate(names))
    counts = np.zeros((len(months), aircraft.size), dtype=np.int64)
    for row, part, month in zip(counts, names, months, strict=True):
        row[np.searchsorted(aircraft, part)] = month["row_size"].to_numpy()
    attributes = _attributes(months)
    total = counts.sum(axis=0).astype(np.int32)
    columns = {"row_size": xr.Variable("aircraft", total, first["row_size"].attrs)}
    for name, variable in first.data_vars.items():
        if "report" in variable.dims:
            added = np.zeros(len(months), dtype=np.int64)
            if name == "flight":
                added[1:] = np.cumsum([int(month.attrs.get(FLIGHTS, 0)) for month in months[:-1]])
            parts = [month.variables[name] for month in months]
            token = f"months-{attributes['uuid']}-{name}"
            lazy = _reports_by_aircraft(parts, counts, added, token)
            columns[str(name)] = xr.Variable(variable.dims, lazy, variable.attrs)
    # Values by aircraft are those of its last month.
    whole = xr.concat(
        [month.drop_dims("report") for month in months],
        "aircraft",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    ).drop_duplicates("aircraft", keep="last")
    whole = whole.assign_coords(aircraft=whole["aircraft"].astype(str).astype(object))
    return whole.sortby("aircraft").assign(columns)[list(first.data_vars)].assign_attrs(attributes)


def _reports_by_aircraft(
    parts: Sequence[xr.Variable], counts: NDArray[np.int64], added: NDArray[np.int64], token: str
) -> da.Array:
    """One variable of all months, (..., report), in lazy chunks of whole aircraft.

    ``counts`` (month, aircraft) are numbers of reports, ``added`` (month,) is added to the values.
    """
    stop = np.cumsum(counts, axis=1)
    start = stop - counts
    groups = aircraft_groups(counts.sum(axis=0))
    dtype = np.result_type(*(part.dtype for part in parts))

    def chunk(block_id: tuple[int, ...]) -> NDArray[np.generic]:
        group = groups[block_id[-1]]
        values = [
            part[..., low[group.start] : high[group.stop - 1]].to_numpy()
            for part, low, high in zip(parts, start, stop, strict=True)
        ]
        values = [part + more if more else part for part, more in zip(values, added, strict=True)]
        owner = np.concatenate([np.repeat(np.arange(row.size), row) for row in counts[:, group]])
        order = np.argsort(owner, kind="stable")
        return np.concatenate(values, axis=-1)[..., order].astype(dtype)

    sizes = tuple(int(counts[:, group].sum()) for group in groups)
    lazy: da.Array = da.map_blocks(
        chunk,
        chunks=(*((size,) for size in parts[0].shape[:-1]), sizes),
        dtype=dtype,
        meta=np.empty((0,) * parts[0].ndim, dtype),
        name=token,
    )
    return lazy


def _attributes(months: Sequence[xr.Dataset]) -> dict[str, object]:
    found = dict(months[-1].attrs)
    if len(months) == 1:
        return found
    uuids = "".join(str(month.attrs["uuid"]) for month in months)
    found["uuid"] = hashlib.sha256(uuids.encode()).hexdigest()[:32]
    for name in found:
        values = [month.attrs[name] for month in months if name in month.attrs]
        if name in (FLIGHTS, "kept_reports"):
            found[name] = sum(map(int, values))
        elif name in COVERAGE:
            found[name] = min(values) if name.endswith(("_start", "_min")) else max(values)
        elif name in _TALLIES:
            found[name] = json.dumps(_summed([json.loads(value) for value in values]))
    return found


def _summed(parts: Sequence[Any]) -> object:
    if all(isinstance(part, Mapping) for part in parts):
        names = dict.fromkeys(name for part in parts for name in part)
        return {name: _summed([part[name] for part in parts if name in part]) for name in names}
    if all(isinstance(part, int) for part in parts):
        return sum(parts)
    full = [part for part in parts if part]
    if all(isinstance(part, list) and isinstance(part[0], dict) for part in full):
        return [entry for part in full for entry in part]
    return parts[-1]


def month_bounds(month: str) -> tuple[np.datetime64, np.datetime64]:
    """Begin of a month such as ``2008-07`` and of the next one, datetime64[ns]."""
    begin = np.datetime64(month, "M")
    return begin.astype("M8[ns]"), (begin + 1).astype("M8[ns]")
