"""Which model times a table of reports needs, and which reports they cannot serve.

Assumptions and validity
------------------------
* A report between two valid times at most `max_time_gap` apart needs both; a
  report exactly at a valid time needs that one alone. Others have no model.
* Reports are looked at in order of time, so that the reports of one model
  time are one run of that order.
* Places and levels are judged by the grids' projections and the catalogued
  levels; nothing is decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.catalogues import catalogues_of
from airswing.reference.geometry.interpolation import level_brackets
from airswing.reference.geometry.model_time import ISOBARIC, ModelTime
from airswing.reference.geometry.wind_profiles import Catalogue

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

Finished = Callable[[ModelTime, tuple[Floats, Floats, Floats]], bool]
"""Whether a model time was sampled before at these latitudes, longitudes and pressures."""

_NEVER = int(np.iinfo(np.int64).max)
COLUMNS = ("time", "latitude", "longitude", "pressure")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Where and when the reports are, in order of time, without those that have none."""

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
        Where a column is missing.
    """
    absent = [name for name in COLUMNS if name not in reports.variables]
    if absent:
        raise InputError("reports lack " + ", ".join(absent), field="reports")
    time = np.asarray(reports["time"].values).astype("datetime64[ns]")
    known = np.flatnonzero(~np.isnat(time))
    stamp = time[known].astype(np.int64)
    order = known[np.argsort(stamp, kind="stable")]
    latitude, longitude, pressure = (
        np.ascontiguousarray(np.asarray(reports[name].values)[order], dtype=np.float64)
        for name in COLUMNS[1:]
    )
    stamps = time[order].astype(np.int64)
    return Points(order, stamps, latitude, longitude, pressure, time.size)


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """Which reports each model time serves, and with which weights."""

    earlier: Ints  # model time at or before each report, -1 where it has no model
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
        Ask for the model time after even at a valid time, where there is one in reach
        (time derivatives need it).
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
    before = np.searchsorted(points.time, np.append(valid[:1], valid[:-1]), side="right")
    stop = np.where(near, after, stop)
    reach = np.concatenate([[False], near[:-1]])
    if both:
        before = np.searchsorted(points.time, np.append(valid[:1], valid[:-1]), side="left")
    start = np.where(reach, before, start)
    return Schedule(earlier, weight, later, start, np.maximum(stop, start))


@dataclass(frozen=True, slots=True)
class Plan:
    """What collocating against one reference will take."""

    reference: str
    model_times: int  # to read, as the messages; their octets as stored
    messages: int
    bytes: int
    sparse_messages: int  # read in place rather than decoded whole
    reports: int
    matched: int  # inside the reference's time, grid and levels
    without_time: int  # reports without a model, by the first reason that applies
    outside_grid: int
    outside_levels: int
    report_times: tuple[str, str]  # first and last
    model_span: tuple[str, str]
    # South, north, west, east, degrees; of the grids' outlines for the model.
    report_box: tuple[float, float, float, float]
    model_box: tuple[float, float, float, float]
    # Highest and lowest pressure level, hPa; empty for native levels.
    model_levels: tuple[float, ...] = ()

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
    """
    points = points_of(reports)
    return {
        name: Need.of(points, catalogue, max_time_gap=max_time_gap, derivatives=derivatives).plan(
            name, catalogue, sparse=sparse
        )
        for name, catalogue in catalogues_of(catalogues).items()
    }


@dataclass(eq=False)
class Need:
    """What some reports need of one reference; those of several parts of an archive add up."""

    rows: NDArray[np.bool_]  # levels of model times that are needed, as the catalogue has them
    times: NDArray[np.bool_]  # model times with reports around them
    finished: NDArray[np.bool_]  # those of them that need not be read again
    reports: int
    matched: int
    without_time: int
    outside_grid: int
    outside_levels: int
    first: int  # times of the reports, ns since 1970
    last: int
    box: Floats  # south, north, west, east of the reports, degrees; NaN without any

    @classmethod
    def of(
        cls,
        points: Points,
        catalogue: Catalogue,
        *,
        max_time_gap: float,
        derivatives: bool,
        finished: Finished | None = None,
    ) -> Need:
        """Find what reports need.

        ``finished`` tells whether a model time (with the latitudes, longitudes and pressures of the
        reports around it) was finished by an earlier run; nothing was by default.
        """
        times = schedule(points, catalogue.valid, max_time_gap=max_time_gap, both=derivatives)
        timed = times.earlier >= 0
        placed = np.zeros(points.time.size, dtype=bool)
        leveled = np.zeros(points.time.size, dtype=bool)
        rows = np.zeros(int(catalogue.bounds[-1]), dtype=bool)
        done = np.zeros(times.start.size, dtype=bool)
        for number in np.flatnonzero(times.stop > times.start):
            run = slice(int(times.start[number]), int(times.stop[number]))
            inside, on_level, needed = _needs(catalogue, int(number), points, run, derivatives)
            mine = times.earlier[run] == number
            placed[run] |= inside & mine
            leveled[run] |= inside & on_level & mine
            rows[catalogue.bounds[number] : catalogue.bounds[number + 1]] = needed
            if finished is not None:
                at = (points.latitude[run], points.longitude[run], points.pressure[run])
                done[number] = finished(catalogue.model_time(int(number)), at)
        return cls(
            rows=rows,
            times=times.stop > times.start,
            finished=done,
            reports=points.size,
            matched=int(leveled.sum()),
            without_time=points.size - int(timed.sum()),
            outside_grid=int((timed & ~placed).sum()),
            outside_levels=int(placed.sum()) - int(leveled.sum()),
            first=int(points.time[0]) if points.time.size else _NEVER,
            last=int(points.time[-1]) if points.time.size else -_NEVER,
            box=_corners(points.latitude, points.longitude),
        )

    def __add__(self, other: Need) -> Need:
        """Need of both parts."""
        counts = ("reports", "matched", "without_time", "outside_grid", "outside_levels")
        low, high = np.fmin(self.box, other.box), np.fmax(self.box, other.box)
        return Need(
            rows=self.rows | other.rows,
            times=self.times | other.times,
            # A model time at the seam of two parts is finished where it is for both.
            finished=(self.finished | other.finished)
            & (self.finished | ~self.times)
            & (other.finished | ~other.times),
            first=min(self.first, other.first),
            last=max(self.last, other.last),
            box=np.where([True, False, True, False], low, high),
            **{name: getattr(self, name) + getattr(other, name) for name in counts},
        )

    def plan(
        self, reference: str, catalogue: Catalogue, *, sparse: bool, left: bool = False
    ) -> Plan:
        """Count what will be read.

        Parameters
        ----------
        catalogue : Catalogue
            The one the need was found with.
        left : bool, default False
            Count only what is not finished.
        """
        counts = np.zeros(4, dtype=np.int64)
        for number in np.flatnonzero(self.times & ~self.finished if left else self.times):
            bounds = slice(int(catalogue.bounds[number]), int(catalogue.bounds[number + 1]))
            needed = self.rows[bounds]
            counts += [bool(needed.any()), *catalogue.reading(int(number), needed)]
        ends = np.array([self.first, self.last] if self.first <= self.last else [], dtype=np.int64)
        return Plan(
            reference=reference,
            model_times=int(counts[0]),
            messages=int(counts[1]),
            bytes=int(counts[2]),
            sparse_messages=int(counts[3]) if sparse else 0,
            reports=self.reports,
            matched=self.matched,
            without_time=self.without_time,
            outside_grid=self.outside_grid,
            outside_levels=self.outside_levels,
            report_times=_span(ends),
            model_span=_span(catalogue.valid),
            report_box=tuple(round(float(x), 2) for x in self.box),  # type: ignore[arg-type]
            model_box=_outline(catalogue),
            model_levels=_level_span(catalogue),
        )


def _needs(
    catalogue: Catalogue, number: int, points: Points, run: slice, derivatives: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Reports inside the grid, reports between levels, levels needed of one model time."""
    grid = catalogue.grids[int(catalogue.grid_numbers[number])]
    fi, _ = grid.fractional_index(points.latitude[run], points.longitude[run])
    pressure = points.pressure[run]
    inside = np.isfinite(fi)
    levels = catalogue.levels(number)
    needed = np.zeros(levels.size, dtype=bool)
    if catalogue.level_kinds[number] != ISOBARIC:
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


def _corners(latitude: Floats, longitude: Floats) -> Floats:
    """South, north, west and east of places; NaN without any."""
    known = np.isfinite(latitude) & np.isfinite(longitude)
    if not known.any():
        return np.full(4, np.nan)
    lat, lon = latitude[known], longitude[known]
    return np.array([lat.min(), lat.max(), lon.min(), lon.max()])


def _level_span(catalogue: Catalogue) -> tuple[float, ...]:
    rows = np.repeat(catalogue.level_kinds == ISOBARIC, np.diff(catalogue.bounds))
    levels = catalogue.u["level"][rows] / 100.0
    return (float(levels.min()), float(levels.max())) if levels.size else ()


def _outline(catalogue: Catalogue) -> tuple[float, float, float, float]:
    boxes = np.array([catalogue.grids[int(n)].outline() for n in np.unique(catalogue.grid_numbers)])
    low, high = boxes.min(axis=0), boxes.max(axis=0)
    return tuple(round(float(x), 2) for x in (low[0], high[1], low[2], high[3]))  # type: ignore[return-value]
