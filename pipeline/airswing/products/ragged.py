"""Contiguous ragged arrays: reports of many aircraft on one dimension.

Assumes the CF contiguous ragged form: the reports of one aircraft are consecutive, in the order of
the ``aircraft`` dimension, and ``row_size`` counts them. Archives larger than memory are read in
blocks of whole aircraft (:func:`blocks`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def row_bounds(row_size: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First report and one past the last report (int64) of every aircraft, from their counts."""
    stop = np.cumsum(row_size, dtype=np.int64)
    return stop - np.asarray(row_size, dtype=np.int64), stop


BLOCK_REPORTS = 200_000
"""Reports of a block, where no single aircraft has more."""


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
    """Iterate over an archive in blocks of whole aircraft.

    Parameters
    ----------
    ds : Dataset
        Ragged, in memory or opened lazily; without ``row_size`` the reports of one aircraft.
    names : sequence of str, optional
        Variables to read, where they exist, besides ``row_size``; all by default.
    limit : int, optional
        Reports of a block; `BLOCK_REPORTS` by default.

    Yields
    ------
    Dataset
        In memory; the aircraft in their order.
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
    """First and last time of an archive's reports, of which there is at least one."""
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
