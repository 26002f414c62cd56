"""Model times that reports need, and the reports that they cannot serve; nothing is decoded.

Assumptions and validity
------------------------
* A report between two valid times at most `max_time_gap` apart needs both; a report exactly at a
  valid time needs that one alone. Others have no model.
* Reports are taken in order of time, so that the reports of one model time are one run.
* Places and levels are compared with the grids' projections and the catalogued levels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.catalogue import ISOBARIC, Catalogue
from airswing.reference.catalogues import catalogues_of
from airswing.reference.winds import level_brackets

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COLUMNS = ("time", "latitude", "longitude", "pressure")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Times and places of reports, in order of time, without those that have no time."""

    order: Ints  # place of each in the Dataset
    time: Ints  # ns since 1970
    latitude: Floats  # degrees
    longitude: Floats
    pressure: Floats  # Pa
    size: int  # reports in the Dataset


def points_of(reports: xr.Dataset) -> Points:
    """Times and places of reports, sorted by time.

    Raises
    ------
    InputError
        If a column is missing.
    """
    absent = [name for name in COLUMNS if name not in reports.variables]
    if absent:
        raise InputError("reports lack " + ", ".join(absent), field="reports")
    time = np.asarray(reports["time"].values).astype("datetime64[ns]")
    known = np.flatnonzero(~np.isnat(time))
    order = known[np.argsort(time[known].astype(np.int64), kind="stable")]
    latitude, longitude, pressure = (
        np.ascontiguousarray(np.asarray(reports[name].values)[order], dtype=np.float64)
        for name in COLUMNS[1:]
    )
    return Points(order, time[order].astype(np.int64), latitude, longitude, pressure, time.size)


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """Reports that each model time serves, with their weights."""

    earlier: Ints  # model time at or before each report, -1 if it has no model
    weight: Floats  # of the model time after, 0 to 1; 0 exactly at a valid time
    later: NDArray[np.bool_]  # whether the model time after is needed
    start: Ints  # run of reports that each model time serves
    stop: Ints


def schedule(points: Points, valid: Ints, *, max_time_gap: float, both: bool = False) -> Schedule:
    """Assign reports to model times, whose valid times (ns since 1970) increase.

    Parameters
    ----------
    max_time_gap : float
        Longest time between two bracketing valid times, s.
    both : bool
        Use the model time after also at a valid time, if there is one in reach (time derivatives
        need it).
    """
    count = valid.size
    earlier = np.searchsorted(valid, points.time, side="right") - 1
    steps = np.diff(valid)
    near = np.append(steps <= round(max_time_gap * 1e9), False)
    exact = (earlier >= 0) & (valid[earlier] == points.time)
    bracketed = (earlier >= 0) & (earlier < count - 1) & near[earlier]
    later = bracketed & (~exact | both)
    step = np.append(steps, 1)[earlier]
    weight = np.where(later & ~exact, (points.time - valid[earlier]) / step, 0.0)
    earlier = np.where(exact | bracketed, earlier, -1)
    start = np.searchsorted(points.time, valid, side="left")
    stop = np.searchsorted(points.time, valid, side="right")
    after = np.searchsorted(points.time, np.append(valid[1:], valid[-1:]), side="left")
    previous, side = np.append(valid[:1], valid[:-1]), "left" if both else "right"
    before = np.searchsorted(points.time, previous, side=side)  # type: ignore[call-overload]
    stop = np.where(near, after, stop)
    start = np.where(np.concatenate([[False], near[:-1]]), before, start)
    return Schedule(earlier, weight, later, start, np.maximum(stop, start))


@dataclass(frozen=True, slots=True)
class Plan:
    """What collocation with one reference will read, and the reports without a model."""

    reference: str
    model_times: int  # to read, as the messages; bytes as stored
    messages: int
    bytes: int
    sparse_messages: int  # read at single points rather than decoded whole
    reports: int
    matched: int  # inside the reference's time, grid and levels
    without_time: int  # reports without a model, by the first reason that applies
    outside_grid: int
    outside_levels: int
    report_times: tuple[str, str]  # first and last
    model_span: tuple[str, str]
    # south, north, west, east, degrees; of the grids' outlines for the model
    report_box: tuple[float, float, float, float]
    model_box: tuple[float, float, float, float]
    model_levels: tuple[float, ...] = ()  # highest and lowest pressure level, hPa

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary, ready for JSON."""
        return asdict(self)


def plan(
    reports: xr.Dataset,
    catalogues: Mapping[str, Catalogue | xr.Dataset],
    *,
    max_time_gap: float = 10800.0,
    derivatives: bool = False,
    sparse: bool = True,
) -> dict[str, Plan]:
    """What collocation will read and which reports have no model, before anything is decoded.

    Parameters
    ----------
    reports : Dataset
        With `time`, `latitude`, `longitude` (degrees), `pressure` (Pa) by ``report``.
    max_time_gap : float
        Longest time between two bracketing valid times, s.
    derivatives, sparse : bool
        As for `airswing.reference.collocate.collocate`.

    Returns
    -------
    dict of str to Plan
        By reference.
    """
    points = points_of(reports)
    return {
        name: _plan(
            name,
            model.for_places(points.latitude, points.longitude),
            points,
            schedule(points, model.valid, max_time_gap=max_time_gap, both=derivatives),
            derivatives,
            sparse,
        )
        for name, model in catalogues_of(catalogues).items()
    }


def _plan(
    name: str,
    model: Catalogue,
    points: Points,
    times: Schedule,
    derivatives: bool,
    sparse: bool,
) -> Plan:
    timed = times.earlier >= 0
    placed = np.zeros(points.time.size, dtype=bool)
    leveled = np.zeros(points.time.size, dtype=bool)
    counts = np.zeros(4, dtype=np.int64)
    for number in np.flatnonzero(times.stop > times.start).tolist():
        run = slice(int(times.start[number]), int(times.stop[number]))
        inside, on_level, needed = _needs(model, number, points, run, derivatives)
        mine = times.earlier[run] == number
        placed[run] |= inside & mine
        leveled[run] |= inside & on_level & mine
        counts += [bool(needed.any()), *model.reading(number, needed)]
    known = np.isfinite(points.latitude) & np.isfinite(points.longitude)
    places = points.latitude[known], points.longitude[known]
    box = [f(p) if known.any() else np.nan for p in places for f in (np.min, np.max)]
    isobaric = np.repeat(model.level_kinds == ISOBARIC, np.diff(model.bounds))
    levels = model.u["level"][isobaric] / 100.0
    outlines = np.array([model.grids[int(n)].outline() for n in np.unique(model.grid_numbers)])
    low, high = outlines.min(axis=0), outlines.max(axis=0)
    return Plan(
        reference=name,
        model_times=int(counts[0]),
        messages=int(counts[1]),
        bytes=int(counts[2]),
        sparse_messages=int(counts[3]) if sparse else 0,
        reports=points.size,
        matched=int(leveled.sum()),
        without_time=points.size - int(timed.sum()),
        outside_grid=int((timed & ~placed).sum()),
        outside_levels=int(placed.sum()) - int(leveled.sum()),
        report_times=_span(points.time),
        model_span=_span(model.valid),
        report_box=tuple(round(float(x), 2) for x in box),  # type: ignore[arg-type]
        model_box=tuple(round(float(x), 2) for x in (low[0], high[1], low[2], high[3])),  # type: ignore[arg-type]
        model_levels=(float(levels.min()), float(levels.max())) if levels.size else (),
    )


def _needs(
    model: Catalogue, number: int, points: Points, run: slice, derivatives: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Reports inside the grid, reports between levels, levels needed of one model time."""
    grid = model.grids[int(model.grid_numbers[number])]
    inside = grid.contains(points.latitude[run], points.longitude[run])
    pressure, levels = points.pressure[run], model.levels(number)
    needed = np.zeros(levels.size, dtype=bool)
    if model.level_kinds[number] != ISOBARIC:
        needed[:] = inside.any()
        return inside, np.isfinite(pressure), needed
    brackets = level_brackets(levels, pressure, both=derivatives)
    use = inside & brackets.inside
    needed[brackets.k[use & ((brackets.weight < 1) | derivatives)]] = True
    below = use & ((brackets.weight > 0) | derivatives) & (brackets.k + 1 < levels.size)
    needed[brackets.k[below] + 1] = True
    return inside, brackets.inside, needed


def _span(time: Ints) -> tuple[str, str]:
    if time.size == 0:
        return ("", "")
    ends = time[[0, -1]].astype("datetime64[ns]").astype("datetime64[m]")
    return (f"{ends[0]}Z", f"{ends[1]}Z")


def require_overlap(plans: Mapping[str, Plan]) -> None:
    """Refuse references that serve no report at all.

    Raises
    ------
    InputError
        With the times, places or levels of reports and model.
    """
    for name, one in plans.items():
        if one.matched:
            continue
        field = f"references.{name}"
        if one.without_time == one.reports:
            raise _untimed(one, field)
        if one.outside_levels == 0:
            raise InputError(
                "no overlap in space between reports and model winds",
                field=field,
                found=f"reports {_place(one.report_box)}, model {_place(one.model_box)}",
            )
        levels = " to ".join(f"{level:g}" for level in dict.fromkeys(one.model_levels))
        raise InputError(
            "no report lies between the model's levels",
            field=field,
            found=f"{one.outside_levels} reports above the highest or below the lowest level "
            f"({levels} hPa)",
            remedy="Check the unit of the reports' altitude or pressure column, and of the levels"
            if len(set(one.model_levels)) > 1
            else "Winds are interpolated between levels: two are needed",
        )


def _untimed(one: Plan, field: str) -> InputError:
    """No report has a model time on both sides: the spans are apart, or the gaps too wide."""
    reports, model = one.report_times, one.model_span
    apart = reports[1] < model[0] or model[1] < reports[0]
    if apart or not all((*reports, *model)):
        what = "no overlap in time between reports and model winds"
    elif model[0] == model[1]:
        what = "the model has a single valid time; a report needs one before and one after it"
    else:
        what = "no report lies between two model times that are close enough together"
    return InputError(
        what,
        field=field,
        found=f"reports {' to '.join(reports)}, model {' to '.join(model)}",
        remedy="Two valid times around a report may be at most max_time_gap apart",
    )


def _place(box: tuple[float, float, float, float]) -> str:
    return f"latitude {box[0]:g} to {box[1]:g}, longitude {box[2]:g} to {box[3]:g}"
