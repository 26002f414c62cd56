"""Reference winds at the reports: all model times, joined in time, lazily.

The work maps over model times, not over reports: each needed message is read
once, by the task of its model time, for the reports of both intervals that
share it; two bracketing samples are joined with their time weights.

Assumptions and validity
------------------------
* Linear in time between two valid times at most `max_time_gap` apart; no value
  outside. A report exactly at a valid time takes that one alone.
* Planning uses the reports' times and places; no message is read before the
  result is computed.
* A report's value depends on that report and its four or eight model points
  alone, so results are the same bit for bit on any scheduler and in any chunking.
* A file that vanished or was replaced gives no value to its reports, is
  logged, and is counted in `unread_messages`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import dask.array as da
import numpy as np
import pandas as pd
import xarray as xr
from dask.highlevelgraph import HighLevelGraph
from dask.typing import Key
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.catalogues import catalogues_of
from airswing.reference.geometry.model_time import ModelTime, Sample
from airswing.reference.geometry.wind_profiles import Catalogue
from airswing.reference.gridded.gridded_sampling import sample_gridded
from airswing.reference.gridded.stored import GriddedTime
from airswing.reference.planning import (
    Plan,
    Points,
    Schedule,
    plan,
    points_of,
    schedule,
)
from airswing.reference.sampling import sample_model_time
from airswing.reference.store import SampleStore
from airswing.vocabulary import describe

__all__ = ["Plan", "collocate", "plan"]

Floats = NDArray[np.float64]

_WINDS = ("reference_eastward_wind", "reference_northward_wind", "lead_time")
DERIVATIVES = (
    "reference_eastward_wind_tendency",
    "reference_northward_wind_tendency",
    "reference_eastward_wind_lnp_derivative",
    "reference_northward_wind_lnp_derivative",
    "reference_eastward_wind_x_derivative",
    "reference_northward_wind_x_derivative",
    "reference_eastward_wind_y_derivative",
    "reference_northward_wind_y_derivative",
    "grid_convergence",
)
"""What is given of the reference wind beside it."""
ACCOUNT = ("unread_messages", "decoded_messages", "decoded_bytes", "decoding_seconds")
"""What reading a reference took; the first is part of every result."""
PROBLEMS = "problems"
"""What could not be read, by reference: sets of (valid time, file, reason)."""
_LOG = logging.getLogger("airswing.reference")


class _SampleTask:
    """Model times that are read together and their reports: what one dask task needs."""

    __slots__ = ("models", "options", "places", "store")

    def __init__(
        self,
        models: list[ModelTime],
        places: list[tuple[Floats, Floats, Floats]],
        options: tuple[bool, bool],
        store: str | None,
    ) -> None:
        self.models, self.places, self.options, self.store = models, places, options, store

    def run(self, given: Mapping[str, xr.Dataset]) -> list[Sample]:
        """Sample, or take the finished samples of an earlier run."""
        # opened here: the task may run in another process, and an open store does not travel
        store = None if self.store is None else SampleStore(Path(self.store))
        derivatives = self.options[1]
        found: dict[int, Sample] = {}
        if store is not None:
            for number, (model, places) in enumerate(zip(self.models, self.places, strict=True)):
                known = store.get(model, places, derivatives)
                if known is not None:
                    found[number] = known
        left = [number for number in range(len(self.models)) if number not in found]
        for number, sample in zip(left, self._sampled(left, given), strict=True):
            found[number] = _logged(sample)
            if store is not None:
                store.put(self.models[number], self.places[number], derivatives, sample)
        return [found[number] for number in range(len(self.models))]

    def _sampled(self, numbers: list[int], given: Mapping[str, xr.Dataset]) -> list[Sample]:
        sparse, derivatives = self.options
        models = [self.models[number] for number in numbers]
        places = [self.places[number] for number in numbers]
        gridded = [model for model in models if isinstance(model, GriddedTime)]
        if gridded:
            return sample_gridded(gridded, places, derivatives=derivatives, given=given)
        return [
            sample_model_time(model, *where, sparse=sparse, derivatives=derivatives)
            for model, where in zip(models, places, strict=True)
        ]


def _logged(sample: Sample) -> Sample:
    for file, reason in sample.problems:
        _LOG.warning("%s: %s; its reports get no value", file, reason)
    return sample


@dataclass(frozen=True)
class _Given:
    """Datasets given in Python: one node of the graph that all tasks of a reference share."""

    datasets: dict[str, xr.Dataset]


def _run(task: _SampleTask, given: _Given | None = None) -> list[Sample]:
    return task.run({} if given is None else given.datasets)


class _Joined(NamedTuple):
    """Columns by report, rows of `ACCOUNT`, and what could not be read."""

    columns: Floats
    account: Floats
    problems: frozenset[tuple[int, str, str]]


class _Join:
    """Joins the samples of one reference in time, into columns in the reports' order."""

    def __init__(
        self,
        points: Points,
        times: Schedule,
        catalogue: Catalogue,
        used: NDArray[np.int64],
        *,
        derivatives: bool,
    ) -> None:
        self.derivatives = derivatives
        self.order, self.size = points.order, points.size
        self.earlier, self.weight, self.later = times.earlier, times.weight, times.later
        self.used, self.start, self.stop = used, times.start[used], times.stop[used]
        self.valid, self.leads = catalogue.valid, catalogue.leads

    def __call__(self, batches: list[list[Sample]]) -> _Joined:
        """Columns by report, and what reading took."""
        samples = [sample for batch in batches for sample in batch]
        count = self.earlier.size
        # wind; its derivatives by ln p, x and y, two each, and the convergence
        rows = 2 + (7 if self.derivatives else 0)
        first = np.full((rows, count), np.nan)
        second = np.full((rows, count), np.nan)
        account, problems = np.zeros(len(ACCOUNT)), set()
        for number, start, stop, sample in zip(
            self.used, self.start, self.stop, samples, strict=True
        ):
            run = slice(int(start), int(stop))
            # a model time is the earlier one of some of its reports and the later one of the others
            before = self.earlier[run] == number
            after = (self.earlier[run] == number - 1) & self.later[run]
            first[:, run][:, before] = sample.table[:, before]
            second[:, run][:, after] = sample.table[:, after]
            account += [len(sample.problems), sample.decoded, sample.octets, sample.seconds]
            valid = int(self.valid[number])
            problems |= {(valid, file, reason) for file, reason in sample.problems}
        return _Joined(self._columns(first, second), account, frozenset(problems))

    def _columns(self, first: Floats, second: Floats) -> Floats:
        weight = self.weight
        # at a valid time itself the later field need not be there: NaN times nothing is NaN
        joined = np.where(weight == 0.0, first, (1.0 - weight) * first + weight * second)
        wind = joined[:2]
        matched = np.isfinite(wind).all(axis=0)
        wind = np.where(matched, wind, np.nan)
        now, then = self.earlier, np.minimum(self.earlier + 1, self.valid.size - 1)
        lead = (1.0 - weight) * self.leads[now] + weight * self.leads[then]
        columns = [*wind, np.where(matched, lead / 3600.0, np.nan)]
        if self.derivatives:
            # zero at the last of all valid times: no later one is there to tell a tendency by
            step = (self.valid[then] - self.valid[now]) / 1e9
            with np.errstate(divide="ignore", invalid="ignore"):
                columns += list((second[:2] - first[:2]) / step)
            columns += [*joined[2:8], np.degrees(joined[8])]
        result = np.full((len(columns), self.size), np.nan)
        result[:, self.order] = columns
        return result


def collocate(
    reports: xr.Dataset,
    catalogues: Mapping[str, Catalogue | xr.Dataset],
    *,
    max_time_gap: float = 10800.0,
    derivatives: bool = False,
    sparse: bool = True,
    store: str | os.PathLike[str] | None = None,
    account: bool = False,
) -> xr.Dataset:
    """Reference winds at reports, lazily.

    Parameters
    ----------
    reports : Dataset
        With `time`, `latitude`, `longitude` (degrees, any convention) and `pressure` (Pa)
        by ``report``, in any order.
    catalogues : mapping of str to Catalogue or Dataset
        References by name. A Dataset with CF winds, dask-backed or lazy, is read chunk by chunk;
        nothing of it is loaded before the result is computed.
    max_time_gap : float
        Longest time between two bracketing valid times, s.
    derivatives : bool
        Also give the time derivative, derivatives by ln p and by true eastward and
        northward distance, and the grid's convergence.
    sparse : bool
        Read simply packed messages in place; otherwise decode every message whole.
        The results are the same bit for bit.
    store : path-like, optional
        Folder for finished samples: a later call reuses those whose files, reports and
        options are the same.
    account : bool
        Also give `decoded_messages`, `decoded_bytes` and `decoding_seconds` (summed over
        threads) by reference: what this call itself read, which differs from run to run; and
        `PROBLEMS`, sets that can be joined where an archive is collocated in parts.

    Returns
    -------
    Dataset
        Lazy, dims ``(reference, report)``: `reference_eastward_wind`,
        `reference_northward_wind` (m s-1, true), `lead_time` (h), the derivatives, and
        `unread_messages` by reference.

    Raises
    ------
    InputError
        Without references, or where reports lack a column.
    """
    if not catalogues:
        raise InputError("no reference given", field="references")
    models = catalogues_of(catalogues)
    points = points_of(reports)
    names = [*_WINDS, *(DERIVATIVES if derivatives else ())]
    options = _Options(max_time_gap, derivatives, sparse, None if store is None else str(store))
    graph: dict[Key, object] = {}
    joins = [_add_reference(graph, points, one, options) for one in models.values()]
    token = hashlib.blake2b("".join(joins).encode(), digest_size=16).hexdigest()
    base = f"winds-{token}"
    # all variables share the samples: keys of one graph, so that nothing is decoded twice
    data: dict[str, object] = {}
    for row, name in enumerate(names):
        keys: dict[Key, object] = {
            (f"{name}-{token}", n, 0): (_row, join, row) for n, join in enumerate(joins)
        }
        chunks = ((1,) * len(joins), (points.size,))
        array = _lazy(base, graph, f"{name}-{token}", keys, chunks, np.dtype("f8"))
        data[name] = (("reference", "report"), array)
    for row, name in enumerate(ACCOUNT if account else ACCOUNT[:1]):
        dtype = np.dtype("f8" if name == "decoding_seconds" else "i8")
        counts: dict[Key, object] = {
            (f"{name}-{token}", n): (_count, join, row, dtype) for n, join in enumerate(joins)
        }
        lazy = _lazy(base, graph, f"{name}-{token}", counts, ((1,) * len(joins),), dtype)
        data[name] = ("reference", lazy)
    coords = {"reference": ("reference", pd.Index(list(catalogues), dtype=object))}
    found = describe(xr.Dataset(data, coords=coords))
    notes = {name: one.notes for name, one in models.items() if one.given}
    if notes:
        found.attrs["reference_notes"] = json.dumps(notes)
    if account:
        kept: dict[Key, object] = {
            (f"{PROBLEMS}-{token}", n): (_problems, join) for n, join in enumerate(joins)
        }
        shape = ((1,) * len(joins),)
        lazy = _lazy(base, graph, f"{PROBLEMS}-{token}", kept, shape, np.dtype(object))
        found[PROBLEMS] = ("reference", lazy)
    return found


class _Options(NamedTuple):
    """How to collocate, as `collocate` takes it."""

    max_time_gap: float
    derivatives: bool
    sparse: bool
    store: str | None


def _lazy(
    base: str,
    graph: dict[Key, object],
    name: str,
    keys: dict[Key, object],
    chunks: tuple[tuple[int, ...], ...],
    dtype: np.dtype[np.generic],
) -> da.Array:
    """A lazy array over the samples and joins that all variables share."""
    layers = HighLevelGraph({base: graph, name: keys}, {base: set(), name: {base}})
    return da.Array(layers, name, chunks=chunks, dtype=dtype)


def _row(joined: _Joined, number: int) -> Floats:
    """One column of a join as a block with the reference's dimension."""
    return joined.columns[number : number + 1]


def _count(joined: _Joined, number: int, dtype: np.dtype[np.generic]) -> NDArray[np.generic]:
    return joined.account[number : number + 1].astype(dtype)


def _problems(joined: _Joined) -> NDArray[np.object_]:
    found = np.empty(1, dtype=object)
    found[0] = joined.problems
    return found


def _add_reference(
    graph: dict[Key, object], points: Points, catalogue: Catalogue, options: _Options
) -> str:
    """Add one reference to a graph, a task a model time and a join; the join's key."""
    times = schedule(
        points, catalogue.valid, max_time_gap=options.max_time_gap, both=options.derivatives
    )
    batches = catalogue.batches(np.flatnonzero(times.stop > times.start))
    used = np.concatenate([*batches, np.empty(0, dtype=np.int64)])
    join = _Join(points, times, catalogue, used, derivatives=options.derivatives)
    token = _token(points, catalogue, options)
    given = (f"given-{token}",) if catalogue.given else ()
    if given:
        graph[given[0]] = _Given(catalogue.given)
    keys = []
    for batch in batches:
        models, places = [], []
        for number in batch.tolist():
            run = slice(int(times.start[number]), int(times.stop[number]))
            models.append(catalogue.model_time(number))
            places.append((points.latitude[run], points.longitude[run], points.pressure[run]))
        key = f"sample-{token}-{int(batch[0])}"
        task = _SampleTask(models, places, (options.sparse, options.derivatives), options.store)
        graph[key] = (_run, task, *given)
        keys.append(key)
    graph[f"join-{token}"] = (join, keys)
    return f"join-{token}"


def _token(points: Points, catalogue: Catalogue, options: _Options) -> str:
    digest = hashlib.blake2b(digest_size=16)
    digest.update(catalogue.fingerprint.encode())
    digest.update(repr(options).encode())
    for array in (points.order, points.time, points.latitude, points.longitude, points.pressure):
        digest.update(array.tobytes())
    return digest.hexdigest()
