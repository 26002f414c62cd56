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
from itertools import chain
from typing import Any

import dask.array as da
import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

BLOCK_REPORTS = 200_000
"""Most reports of a block, unless a single aircraft has more."""
FLIGHTS = "flight_total"
"""Attribute of a month: its number of flights."""
_CONCAT: dict[str, Any] = {
    **{"data_vars": "minimal", "coords": "minimal", "compat": "override"},
    **{"join": "override", "combine_attrs": "override"},
}
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
    groups: list[slice] = []
    total = 0
    for number, size in enumerate(np.asarray(row_size).tolist()):
        total += size
        if groups and total <= limit:
            groups[-1] = slice(groups[-1].start, number + 1)
        else:
            groups.append(slice(number, number + 1))
            total = size
    return groups


def blocks(ds: xr.Dataset, names: Sequence[str] | None = None) -> Iterator[xr.Dataset]:
    """Iterate over an archive in blocks of whole aircraft, each in memory.

    ``names`` are the variables to read where they exist, all by default. Without ``row_size`` all
    reports are of one aircraft.
    """
    if "row_size" not in ds:
        ds = ds.assign(row_size=("aircraft", np.array([ds.sizes["report"]])))
    row_size = ds["row_size"].to_numpy()
    start, stop = row_bounds(row_size)
    wanted = dict.fromkeys([*(names or ()), "row_size"])
    subset = ds if names is None else ds[[name for name in wanted if name in ds]]
    for group in aircraft_groups(row_size):
        reports = slice(int(start[group.start]), int(stop[group.stop - 1]))
        yield subset.isel({"aircraft": group, "report": reports}, missing_dims="ignore").load()


def time_span(ds: xr.Dataset) -> tuple[np.datetime64, np.datetime64]:
    """First and last time of an archive with at least one report."""
    first, last = (extreme.compute().data[()] for extreme in (ds["time"].min(), ds["time"].max()))
    return first, last


def some_reports(ds: xr.Dataset, mask: NDArray[np.bool_]) -> xr.Dataset:
    """Select reports by a mask (report,), in memory; an aircraft may keep no report."""
    size = np.bincount(aircraft_of_report(ds)[mask], minlength=ds.sizes["aircraft"])
    return ds.isel(report=np.flatnonzero(mask)).assign(row_size=("aircraft", size))


def joined(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    """Concatenate blocks of whole aircraft, with the attributes of the first."""
    reports = xr.concat([ds.drop_dims("aircraft") for ds in datasets], "report", **_CONCAT)
    return reports.merge(_by_aircraft(datasets))


def _by_aircraft(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    return xr.concat([ds.drop_dims("report") for ds in datasets], "aircraft", **_CONCAT)


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
    >>> reports = airswing.aircraft_reports(headings, "N403")
    >>> reports["aircraft"].item(), int(reports["row_size"]) == reports.sizes["report"]
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
    other_dims = [month.drop_dims(["report", "aircraft"]) for month in months]
    if any(set(month.variables) != set(first.variables) for month in months) or not all(
        month.coords.equals(other_dims[0].coords) for month in other_dims
    ):
        raise ValueError("the months hold different variables or references")
    sizes = [month["row_size"].to_series() for month in months]
    if not all(size.index.is_monotonic_increasing and size.index.is_unique for size in sizes):
        raise ValueError("the aircraft are not in alphabetical order")
    counts = pd.concat(sizes, axis=1).sort_index().fillna(0).to_numpy(np.int64).T
    flights = [int(month.attrs.get(FLIGHTS, 0)) for month in months]
    attributes = _attributes(months)
    # Values by aircraft are those of its last month.
    archive = _by_aircraft(months).drop_duplicates("aircraft", keep="last").sortby("aircraft")
    archive = archive.assign_coords(aircraft=archive["aircraft"].astype(str).astype(object))
    total = counts.sum(axis=0).astype(np.int32)
    fields: dict[Any, Any] = {"row_size": ("aircraft", total, first["row_size"].attrs)}
    for name, variable in first.data_vars.items():
        if "report" in variable.dims:
            variables = [month.variables[name] for month in months]
            earlier = np.cumsum([0, *flights[:-1]]) if name == "flight" else np.zeros(len(months))
            token = f"months-{attributes['uuid']}-{name}"
            lazy = _reports_by_aircraft(variables, counts, earlier.astype(np.int64), token)
            fields[name] = variable.dims, lazy, variable.attrs
    # All at once: each assignment copies every variable.
    return archive.assign(fields)[list(first.data_vars)].assign_attrs(attributes)


def _reports_by_aircraft(
    columns: Sequence[xr.Variable], counts: NDArray[np.int64], added: NDArray[np.int64], token: str
) -> da.Array:
    """One variable of all months, (..., report), in lazy chunks of whole aircraft.

    ``counts`` (month, aircraft) are numbers of reports, ``added`` (month,) is added to the values.
    """
    stop = np.cumsum(counts, axis=1)
    groups = aircraft_groups(counts.sum(axis=0))
    dtype = np.result_type(*(variable.dtype for variable in columns))

    def chunk(block_id: tuple[int, ...]) -> NDArray[np.generic]:
        group = groups[block_id[-1]]
        by_month = []
        for variable, number, end, more in zip(
            columns, counts[:, group], stop[:, group], added, strict=True
        ):
            block = variable[..., end[0] - number[0] : end[-1]].to_numpy()
            block = block + more if more else block
            by_month.append(np.split(block, np.cumsum(number[:-1]), axis=-1))
        return np.concatenate([*chain(*zip(*by_month, strict=True))], axis=-1, dtype=dtype)

    sizes = tuple(int(counts[:, group].sum()) for group in groups)
    lazy: da.Array = da.map_blocks(
        chunk,
        chunks=(*((size,) for size in columns[0].shape[:-1]), sizes),
        dtype=dtype,
        meta=np.empty((0,) * columns[0].ndim, dtype),
        name=token,
    )
    return lazy


def _attributes(months: Sequence[xr.Dataset]) -> dict[str, object]:
    attributes = dict(months[-1].attrs)
    if len(months) == 1:
        return attributes
    uuids = "".join(str(month.attrs["uuid"]) for month in months)
    attributes["uuid"] = hashlib.sha256(uuids.encode()).hexdigest()[:32]
    for name in attributes:
        values = [month.attrs[name] for month in months if name in month.attrs]
        if name in (FLIGHTS, "kept_reports"):
            attributes[name] = sum(map(int, values))
        elif name in COVERAGE:
            attributes[name] = min(values) if name.endswith(("_start", "_min")) else max(values)
        elif name in _TALLIES:
            attributes[name] = json.dumps(_summed([json.loads(value) for value in values]))
    return attributes


def _summed(values: Sequence[Any]) -> object:
    if all(isinstance(value, Mapping) for value in values):
        names = dict.fromkeys(name for value in values for name in value)
        return {name: _summed([value[name] for value in values if name in value]) for name in names}
    if all(isinstance(value, int) for value in values):
        return sum(values)
    full = [value for value in values if value]
    if all(isinstance(value, list) and isinstance(value[0], dict) for value in full):
        return [entry for value in full for entry in value]
    return values[-1]
