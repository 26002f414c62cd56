"""Reference winds at the reports, lazily: model times are sampled one by one and joined in time.

The work maps over model times: each needed message is read once, for the reports of both intervals
that share it; two bracketing samples are joined linearly in time. A report exactly at a valid time
uses only that time. Nothing is read until the result is computed; results are identical for any
scheduler and chunking. Reports of a file that vanished or was replaced get no value; the file is
logged and counted in `unread_messages`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import dask.array as da
import numpy as np
import pandas as pd
import xarray as xr
from dask.base import is_dask_collection
from dask.delayed import delayed
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.catalogue import Catalogue, catalogues_of
from airswing.reference.grib.values import GribReader
from airswing.reference.gridded.datasets import DatasetReader
from airswing.reference.grids import Floats, Ints
from airswing.reference.winds import ISOBARIC, ModelTime, Request, winds_at
from airswing.vocabulary import describe

Places = tuple[Floats, Floats, Floats]
"""Latitudes, longitudes (degrees) and pressures (Pa) of reports."""
COLUMNS = ("time", "latitude", "longitude", "pressure")
_WINDS = ("reference_eastward_wind", "reference_northward_wind", "lead_time")
_DERIVED = ("tendency", "lnp_derivative", "x_derivative", "y_derivative")
DERIVATIVES = (
    *(f"{wind}_{derived}" for derived in _DERIVED for wind in _WINDS[:2]),
    "grid_convergence",
)
"""Names of the optional derivative variables."""
ACCOUNT = ("unread_messages", "decoded_messages")
"""Names of the counts of reading a reference; the first is part of every result."""
PROBLEMS = "problems"  # unreadable content by reference: sets of (valid time, file, reason)
_LOG = logging.getLogger("airswing.reference")


class Points(NamedTuple):
    """Times and places of reports, in order of time, without those that have no time."""

    order: Ints  # place of each in the Dataset
    time: Ints  # ns since 1970
    latitude: Floats  # degrees
    longitude: Floats
    pressure: Floats  # Pa
    size: int  # reports in the Dataset


def _points(times: NDArray[np.generic], *places: NDArray[np.generic]) -> Points:
    """Sort times and places of reports (`COLUMNS`) by time."""
    time = times.astype("datetime64[ns]")
    timed = np.flatnonzero(~np.isnat(time))
    order = timed[np.argsort(time[timed].astype(np.int64), kind="stable")]
    latitude, longitude, pressure = (
        np.ascontiguousarray(place[order], dtype=np.float64) for place in places
    )
    return Points(order, time[order].astype(np.int64), latitude, longitude, pressure, time.size)


def _require_columns(reports: xr.Dataset) -> None:
    absent = [name for name in COLUMNS if name not in reports.variables]
    if absent:
        raise InputError("reports lack " + ", ".join(absent), field="reports")


class Schedule(NamedTuple):
    """Reports that each model time serves, with their weights."""

    earlier: Ints  # model time at or before each report, -1 if it has no model
    weight: Floats  # of the model time after, 0 to 1; 0 exactly at a valid time
    later: NDArray[np.bool_]  # whether the model time after is needed
    start: Ints  # run of reports that each model time serves
    stop: Ints


def _schedule(points: Points, valid: Ints, *, max_time_gap: float, two: bool = False) -> Schedule:
    """Assign reports to model times, whose valid times (ns since 1970) increase.

    Two bracketing valid times are at most `max_time_gap` seconds apart. With `two` the model time
    after is used also at a valid time, if it is within the gap (time derivatives need it).
    """
    earlier = np.searchsorted(valid, points.time, side="right") - 1
    steps = np.append(np.diff(valid), 1)
    near = np.append(steps[:-1] <= round(max_time_gap * 1e9), False)
    exact = (earlier >= 0) & (valid[earlier] == points.time)
    bracketed = (earlier >= 0) & near[earlier]
    later = bracketed & (~exact | two)
    weight = np.where(later & ~exact, (points.time - valid[earlier]) / steps[earlier], 0.0)
    earlier = np.where(exact | bracketed, earlier, -1)
    served = np.concatenate([np.flatnonzero(earlier >= 0), np.flatnonzero(later)])
    number = np.concatenate([earlier[earlier >= 0], earlier[later] + 1])
    start, stop = np.full(valid.size, points.time.size), np.zeros(valid.size, dtype=np.int64)
    np.minimum.at(start, number, served)
    np.maximum.at(stop, number, served + 1)
    return Schedule(earlier, weight, later, np.minimum(start, stop), stop)


class Batch(NamedTuple):
    """Winds of model times at their reports: a table each, see :func:`winds.winds_at`."""

    tables: list[Floats]
    problems: tuple[tuple[str, str], ...]  # file and reason of unreadable content
    account: Ints  # as `ACCOUNT`


def collocate(
    reports: xr.Dataset,
    catalogues: Mapping[str, Catalogue | xr.Dataset],
    *,
    max_time_gap: float = 10800.0,
    derivatives: bool = False,
    sparse: bool = True,
    account: bool = False,
) -> xr.Dataset:
    """Reference winds at reports, lazily.

    Parameters
    ----------
    reports : Dataset
        With `time`, `latitude`, `longitude` (degrees, any convention) and `pressure` (Pa) by
        ``report``, in any order and chunking.
    catalogues : mapping of str to Catalogue or Dataset
        References by name. A Dataset with CF winds, dask-backed or lazy, is read chunk by chunk;
        no field of it is loaded before the result is computed.
    max_time_gap : float
        Longest time between two bracketing valid times, s.
    derivatives : bool
        Also give the time derivative, derivatives by ln p and by true eastward and northward
        distance, and the grid's convergence.
    sparse : bool
        Read simply packed messages at single points; otherwise decode every message whole. The
        results are identical.
    account : bool
        Also give `decoded_messages` by reference, and `PROBLEMS`.

    Returns
    -------
    Dataset
        Lazy, dims ``(reference, report)``: `reference_eastward_wind`, `reference_northward_wind`
        (m s-1, true), `lead_time` (h), the derivatives, and `unread_messages` by reference.

    Raises
    ------
    InputError
        Without references, or if reports lack a column.
    TypeError
        If the arguments are no Dataset and no mapping of catalogues.

    Examples
    --------
    >>> ruc = airswing.build_catalogue("data_samples/ruc/*.grb", name="ruc")
    >>> winds = airswing.collocate(reports, {"ruc": ruc})  # lazy
    >>> winds["reference_eastward_wind"].dims
    ('reference', 'report')
    """
    if not isinstance(reports, xr.Dataset):
        raise TypeError(
            f"reports are an xarray Dataset, not a {type(reports).__name__}: "
            'collocate(read_reports("reports.csv"), {"ruc": catalogue})'
        )
    models = catalogues_of(catalogues)
    _require_columns(reports)
    lazy = any(is_dask_collection(reports[name]) for name in COLUMNS)
    columns = [reports[name].data for name in COLUMNS]
    points: Any = delayed(_points)(*columns) if lazy else _points(*columns)
    for name, model in models.items():
        if model.alternatives:  # one of several grids must be chosen before the tasks are planned
            places = (np.asarray(reports[column].values, dtype=float) for column in COLUMNS[1:3])
            models[name] = model.for_places(*places)
    options: Any = {"max_time_gap": max_time_gap, "derivatives": derivatives, "sparse": sparse}
    joins = [_joined(points, model, lazy=lazy, **options) for model in models.values()]

    def rows(item: int, number: int, dtype: str, shape: tuple[int, ...] = ()) -> da.Array:
        parts = [da.from_delayed(join[item][number], shape, dtype) for join in joins]
        return da.stack(parts)  # type: ignore[no-any-return]

    data: dict[str, object] = {
        name: (("reference", "report"), rows(0, number, "f8", reports["time"].shape))
        for number, name in enumerate([*_WINDS, *(DERIVATIVES if derivatives else ())])
    }
    for number, name in enumerate(ACCOUNT if account else ACCOUNT[:1]):
        data[name] = ("reference", rows(1, number, "i8"))
    coords = {"reference": ("reference", pd.Index(list(models), dtype=object))}
    winds = describe(xr.Dataset(data, coords=coords))
    if account:
        winds[PROBLEMS] = ("reference", rows(2, 0, "O"))
    notes = {name: model.notes for name, model in models.items() if model.datasets}
    if notes:
        winds.attrs["reference_notes"] = json.dumps(notes)
    return winds


class _Hidden:
    """Content that dask neither searches for arrays nor copies."""

    def __init__(self, content: Any) -> None:
        self.content = content


def _joined(
    points: Any,
    catalogue: Catalogue,
    *,
    lazy: bool,
    max_time_gap: float,
    derivatives: bool,
    sparse: bool,
) -> Any:
    """Task that joins the samples of one reference; a task before it for each batch of times."""
    planned, places_of, sample, join = (
        delayed(function, pure=False) for function in (_schedule, _places_of, _sample, _join)
    )
    if not lazy:
        planned, places_of = _schedule, _places_of
    times = planned(points, catalogue.valid, max_time_gap=max_time_gap, two=derivatives)
    needed = np.arange(len(catalogue)) if lazy else np.flatnonzero(times.stop > times.start)
    datasets = delayed(_Hidden(catalogue.datasets), pure=False, traverse=False)
    batches = catalogue.batches(needed)
    tasks = [
        sample(
            _Hidden([catalogue.model_time(int(number)) for number in batch]),
            places_of(points, times, batch),
            datasets,
            derivatives=derivatives,
            sparse=sparse,
        )
        for batch in batches
    ]
    return join(tasks, batches, points, times, catalogue.valid, catalogue.leads, derivatives)


def _places_of(points: Points, times: Schedule, batch: Ints) -> list[Places]:
    runs = [slice(int(times.start[n]), int(times.stop[n])) for n in batch]
    return [(points.latitude[r], points.longitude[r], points.pressure[r]) for r in runs]


def _sample(models: _Hidden, places: list[Places], datasets: _Hidden, **options: bool) -> Batch:
    batch = sample_model_times(models.content, places, datasets=datasets.content, **options)
    for file, reason in batch.problems:
        _LOG.warning("%s: %s; its reports get no value", file, reason)
    return batch


def sample_model_times(
    models: Sequence[ModelTime],
    places: Sequence[Places],
    *,
    derivatives: bool = False,
    sparse: bool = True,
    datasets: Mapping[str, xr.Dataset] | None = None,
) -> Batch:
    """Winds of model times of one reference, which share chunks, at their reports.

    Datasets given in Python have the path that their catalogue has.
    """
    reader: GribReader | DatasetReader
    reader = DatasetReader(datasets or {}) if models[0].stored else GribReader(sparse=sparse)
    work = [winds_at(m, *w, derivatives=derivatives) for m, w in zip(models, places, strict=True)]
    tables = [np.empty(0)] * len(work)
    answers: dict[int, list[Floats] | None] = dict.fromkeys(range(len(work)))
    try:
        while answers:
            asked: dict[int, Request] = {}
            for number, values in answers.items():
                try:
                    asked[number] = work[number].send(values)  # type: ignore[arg-type]  # None: begin
                except StopIteration as done:
                    tables[number] = done.value
            received = reader.answer([models[n] for n in asked], list(asked.values()))
            answers = dict(zip(asked, received, strict=True))
    finally:
        reader.close()
    unread = len(reader.problems) * len(work)  # each model time lacks it
    return Batch(tables, tuple(reader.problems), np.array([unread, reader.decoded]))


def _join(
    samples: list[Batch],
    batches: list[Ints],
    points: Points,
    times: Schedule,
    valid: Ints,
    leads: Ints,
    derivatives: bool,
) -> tuple[Floats, Ints, list[NDArray[np.object_]]]:
    """Join samples in time: columns by report, `ACCOUNT`, and unreadable content."""
    first = np.full((9 if derivatives else 2, times.earlier.size), np.nan)
    second = first.copy()
    account, problems = np.zeros(len(ACCOUNT), dtype=np.int64), set()
    for batch, numbers in zip(samples, batches, strict=True):
        for number, table in zip(numbers.tolist(), batch.tables, strict=True):
            run = slice(int(times.start[number]), int(times.stop[number]))
            # a model time is the earlier one of some of its reports and the later one of the others
            before = times.earlier[run] == number
            after = (times.earlier[run] == number - 1) & times.later[run]
            first[:, run][:, before] = table[:, before]
            second[:, run][:, after] = table[:, after]
            problems |= {(int(valid[number]), file, reason) for file, reason in batch.problems}
        account += batch.account
    weight = times.weight
    # at a valid time itself the later field need not exist: NaN times zero is NaN
    joined = np.where(weight == 0.0, first, (1.0 - weight) * first + weight * second)
    matched = np.isfinite(joined[:2]).all(axis=0)
    now, then = times.earlier, np.minimum(times.earlier + 1, valid.size - 1)
    lead = (1.0 - weight) * leads[now] + weight * leads[then]
    columns = [*np.where(matched, joined[:2], np.nan), np.where(matched, lead / 3600.0, np.nan)]
    if derivatives:
        step = (valid[then] - valid[now]) / 1e9  # zero at the last of all valid times
        with np.errstate(divide="ignore", invalid="ignore"):
            columns += list((second[:2] - first[:2]) / step)
        columns += [*joined[2:8], np.degrees(joined[8])]
    result = np.full((len(columns), points.size), np.nan)
    result[:, points.order] = columns
    return result, account, [np.array(frozenset(problems), dtype=object)]


def overlap(
    reports: xr.Dataset,
    catalogues: Mapping[str, Catalogue | xr.Dataset],
    *,
    max_time_gap: float = 10800.0,
) -> dict[str, dict[str, Any]]:
    """Count the reports with model winds, without decoding.

    Reports, catalogues and `max_time_gap` (s) as for :func:`collocate`. Of each reference
    ``reports``, those ``matched``, the others by the first reason that applies (``without_time``,
    ``outside_grid``, ``outside_levels``), and as text the times, places and pressures of both
    (``report_extent``, ``model_extent``).
    """
    _require_columns(reports)
    points = _points(*(reports[name].values for name in COLUMNS))
    latitude, longitude = points.latitude, points.longitude
    counts: dict[str, dict[str, Any]] = {}
    for name, catalogue in catalogues_of(catalogues).items():
        model = catalogue.for_places(latitude, longitude)
        times = _schedule(points, model.valid, max_time_gap=max_time_gap)
        timed = times.earlier >= 0
        placed, between = np.zeros((2, points.time.size), dtype=bool)
        for number in np.unique(times.earlier[timed]).tolist():
            mine = times.earlier == number
            grid, levels = model.grids[int(model.profiles["grid"][number])], model.levels(number)
            low, high = levels[[0, -1]] if model.is_isobaric(number) else (-np.inf, np.inf)
            placed[mine] = grid.contains(latitude[mine], longitude[mine])
            between[mine] = (points.pressure[mine] >= low) & (points.pressure[mine] <= high)
        isobaric = np.repeat(model.profiles["level_kind"] == ISOBARIC, np.diff(model.bounds))
        numbers = np.unique(model.profiles["grid"]).tolist()
        outlines = np.array([model.grids[number].outline() for number in numbers])
        matched = int((placed & between).sum())
        counts[name] = {
            "reference": name,
            "reports": points.size,
            "matched": matched,
            "without_time": points.size - int(timed.sum()),
            "outside_grid": int((timed & ~placed).sum()),
            "outside_levels": int(placed.sum()) - matched,
            "report_extent": _extent(points.time, latitude, longitude, points.pressure),
            "model_extent": _extent(
                model.valid, outlines[:, :2], outlines[:, 2:], model.rows["level"][0, isobaric]
            ),
        }
    return counts


def _extent(time: Ints, latitude: Floats, longitude: Floats, pressure: Floats) -> str:
    """Ranges of increasing times, of places (degrees) and of pressures (Pa), as text."""
    first_and_last = time[[0, -1]] if time.size else time
    ends = first_and_last.astype("datetime64[ns]").astype("datetime64[m]")
    ranges = [" to ".join(f"{end}Z" for end in ends)]
    for name, values, unit in (
        ("latitude ", latitude, ""),
        ("longitude ", longitude, ""),
        ("", pressure / 100.0, " hPa"),
    ):
        finite = values[np.isfinite(values)]
        if finite.size:
            ranges.append(f"{name}{finite.min():.5g} to {finite.max():.5g}{unit}")
    return ", ".join(ranges)


def require_overlap(overlaps: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse references without winds for any report, stating times, places and levels of both."""
    for name, counts in overlaps.items():
        if counts["matched"]:
            continue
        raise InputError(
            "no report lies within the model winds",
            field=f"references.{name}",
            found=f"of {counts['reports']:,} reports {counts['without_time']:,} outside its times, "
            f"{counts['outside_grid']:,} outside its grid, {counts['outside_levels']:,} outside "
            f"its levels; reports {counts['report_extent']}; model {counts['model_extent']}",
            remedy="A report needs a valid time before and after it, at most max_time_gap apart, "
            "and a level above and below it; check the units of position, altitude and levels",
        )
