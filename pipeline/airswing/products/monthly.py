"""Products by month, a folder of one file a month, looked at as one ragged Dataset.

Assumes files of :mod:`airswing.products.ragged_product`, each of the flights that begin in one
month (UTC), the aircraft of each in alphabetical order, named so that the order of names is that of
time. What they say together stands by aircraft as in a single file: nothing is copied, and a part
that is asked for is read from the months it lies in, one stretch of each.

What an aircraft has once (its platform, its resolutions) is that of its last month. Flights are
numbered month after month.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from airswing.products.ragged import row_bounds

_Key = tuple[slice | int, ...]
FLIGHTS = "flight_total"
"""Attribute of a month: how many flights it has, or one more than the largest number of one."""


def by_report(month: xr.Dataset) -> xr.Dataset:
    """A month with the name of the aircraft at every report, for ``xarray.open_mfdataset``.

    ``xr.open_mfdataset("headings/*.nc", preprocess=airswing.by_report, combine="nested",
    concat_dim="report")`` gives one Dataset in order of months, without the ``aircraft``
    dimension; ``aircraft`` is a coordinate of ``report``.
    """
    names = np.repeat(month["aircraft"].to_numpy().astype(str), month["row_size"].to_numpy())
    return month.drop_dims("aircraft").assign_coords(aircraft=("report", names))


def joined_months(
    months: Sequence[xr.Dataset], *, aircraft: NDArray[np.generic] | None = None
) -> xr.Dataset:
    """Months as one Dataset by aircraft, read lazily.

    Parameters
    ----------
    months : sequence of Dataset
        In order of time, opened lazily; they stay open.
    aircraft : array of str, optional
        Further ones, without a report in these months.

    Returns
    -------
    Dataset
        Its ``uuid`` stands for those of the months.

    Raises
    ------
    ValueError
        If the months hold different variables or references.
    """
    first = months[0]
    for other in months[1:]:
        alike = set(other.variables) == set(first.variables) and all(
            np.array_equal(other[name].to_numpy(), first[name].to_numpy())
            for name in first.coords
            if not {"report", "aircraft"} & set(first[name].dims)
        )
        if not alike:
            raise ValueError("the months hold different variables or references")
    runs = _Runs(months, aircraft)
    found = first.drop_vars(
        [name for name, v in first.variables.items() if {"report", "aircraft"} & set(v.dims)]
    )
    flights = np.cumsum([0, *(int(month.attrs.get(FLIGHTS, 0)) for month in months[:-1])])
    for name, variable in first.variables.items():
        if "report" in variable.dims:
            add = flights if name == "flight" else None
            array = _Joined([month.variables[name] for month in months], runs, add)
            lazy = indexing.LazilyIndexedArray(array)
            found[name] = xr.Variable(variable.dims, lazy, variable.attrs)
        elif name != "aircraft" and "aircraft" in variable.dims:
            values = _latest(months, str(name), runs)
            found[name] = xr.Variable(variable.dims, values, variable.attrs)
    found["row_size"] = xr.Variable("aircraft", runs.row_size, first["row_size"].attrs)
    names = xr.Variable("aircraft", runs.aircraft.astype(object), first["aircraft"].attrs)
    return found.assign_coords(aircraft=names).assign_attrs(_attributes(months))


def _attributes(months: Sequence[xr.Dataset]) -> dict[str, object]:
    """Of all months: counts summed, the last month's for the rest."""
    told = dict(months[-1].attrs)
    uuids = "".join(month.attrs["uuid"] for month in months)
    told["uuid"] = hashlib.sha256(uuids.encode()).hexdigest()[:32]
    told[FLIGHTS] = sum(int(month.attrs.get(FLIGHTS, 0)) for month in months)
    if "kept_reports" in told:
        told["kept_reports"] = sum(int(month.attrs["kept_reports"]) for month in months)
    for name in ("screened_out", "reading_audit", "reference_audit"):
        if name in told:
            told[name] = json.dumps(_together([json.loads(month.attrs[name]) for month in months]))
    return told


def _together(parts: Sequence[object]) -> object:
    """Tallies of several months: counts summed, lists of what was left out joined."""
    tallies = [part for part in parts if isinstance(part, Mapping)]
    if len(tallies) == len(parts):
        names = dict.fromkeys(name for part in tallies for name in part)
        return {name: _together([part[name] for part in tallies if name in part]) for name in names}
    counts = [part for part in parts if isinstance(part, int)]
    if len(counts) == len(parts):
        return sum(counts)
    full = [part for part in parts if part]
    lists = [part for part in full if isinstance(part, list) and isinstance(part[0], dict)]
    if len(lists) == len(full):
        return [one for part in lists for one in part]
    return parts[-1]


def _latest(months: Sequence[xr.Dataset], name: str, runs: _Runs) -> NDArray[np.generic]:
    """Value of every aircraft in the last month it has one."""
    parts = [month[name].to_numpy() for month in months]
    axis = months[0][name].dims.index("aircraft")
    shape = [*parts[0].shape]
    shape[axis] = runs.aircraft.size
    kind = np.result_type(*parts)
    # Later months overwrite earlier ones; an aircraft without any keeps NaN or zero.
    found = np.full(shape, np.nan if kind.kind == "f" else 0, dtype=kind)
    by_aircraft = np.moveaxis(found, axis, 0)
    for part, place in zip(parts, runs.places, strict=True):
        by_aircraft[place] = np.moveaxis(part, axis, 0)
    return found


class _Runs:
    """Where the reports of each aircraft lie: by aircraft, and of each by month."""

    def __init__(self, months: Sequence[xr.Dataset], aircraft: NDArray[np.generic] | None) -> None:
        names = [month["aircraft"].to_numpy().astype(str) for month in months]
        sizes = [month["row_size"].to_numpy() for month in months]
        others = [] if aircraft is None else [aircraft.astype(str)]
        self.aircraft = np.unique(np.concatenate([*names, *others]))
        self.places = [np.searchsorted(self.aircraft, one) for one in names]
        owner = np.concatenate(self.places)
        month = np.repeat(np.arange(len(months)), [one.size for one in names])
        start = np.concatenate([row_bounds(size)[0] for size in sizes])
        # By aircraft, and of each in order of months: stretches as a single file would
        # have them.
        order = np.lexsort((month, owner))
        size = np.concatenate(sizes).astype(np.int64)
        self.row_size = np.bincount(owner, size, self.aircraft.size).astype(np.int32)
        self.month, self.start, self.size = month[order], start[order], size[order]
        self.at = np.cumsum(self.size) - self.size
        self.total = int(size.sum())

    def within(self, begin: int, end: int) -> tuple[NDArray[np.int64], ...]:
        """Runs with reports from one to before another: month, first row, rows, place in these."""
        low = int(np.searchsorted(self.at + self.size, begin, side="right"))
        high = int(np.searchsorted(self.at, end, side="left"))
        some = slice(low, high)
        first = np.maximum(self.at[some], begin)
        last = np.minimum(self.at[some] + self.size[some], end)
        return self.month[some], self.start[some] + first - self.at[some], last - first, first


class _Joined(BackendArray):
    """One variable of reports over all months; each look reads the files.

    ``add`` is what is added to the values of each month, (month,).
    """

    def __init__(
        self, parts: list[xr.Variable], runs: _Runs, add: NDArray[np.int64] | None
    ) -> None:
        self.parts, self.runs, self.add = parts, runs, add
        self.shape = (*parts[0].shape[:-1], runs.total)
        self.dtype = np.result_type(*(part.dtype for part in parts))

    def __getitem__(self, key: indexing.ExplicitIndexer) -> object:
        basic = indexing.IndexingSupport.BASIC
        return indexing.explicit_indexing_adapter(key, self.shape, basic, self._some)

    def _some(self, key: _Key) -> NDArray[np.generic]:
        rows = range(self.shape[-1])[key[-1]]
        if isinstance(rows, int):
            return np.asarray(self._stretch(key[:-1], rows, rows + 1)[..., 0])
        if not len(rows):
            return self._stretch(key[:-1], 0, 0)
        low, high = min(rows[0], rows[-1]), max(rows[0], rows[-1])
        found = self._stretch(key[:-1], low, high + 1)
        return found if rows.step == 1 else found[..., np.asarray(rows) - low]

    def _stretch(self, others: _Key, begin: int, end: int) -> NDArray[np.generic]:
        """Reports from one to before another; of each month one stretch is read."""
        shape = np.empty(self.shape[:-1])[others].shape
        found = np.empty((*shape, end - begin), dtype=self.dtype)
        month, row, size, place = self.runs.within(begin, end)
        for number in np.unique(month[size > 0]):
            own = np.flatnonzero((month == number) & (size > 0))
            # One read of a month for all its stretches: octets between two are cheaper
            # than a look.
            low, high = int(row[own].min()), int((row[own] + size[own]).max())
            values = self.parts[number][(*others, slice(low, high))].to_numpy()
            if self.add is not None:
                values = values + self.add[number].astype(self.dtype)
            for k in own:
                inside = slice(int(row[k]) - low, int(row[k] + size[k]) - low)
                at = int(place[k]) - begin
                found[..., at : at + int(size[k])] = values[..., inside]
        return found
