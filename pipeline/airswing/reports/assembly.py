"""From cleaned reports to the reports Dataset: order, duplicates, flights, ragged layout.

The result does not depend on the order of rows or files. Of two reports of one aircraft at one time
and place the more complete is kept. Two of one time at different places are both kept if the time
is coarse enough for both or if their flight labels differ; otherwise the more complete is kept.
Reports of one time are ordered by the climb or descent around them.

Flights that overlap another flight of the same identifier for half of their time belong to two
aircraft. All flights of such an identifier are divided into sequences that one aircraft can have
flown: each flight continues the sequence that has ended, whose callsigns have the same operator
(leading letters), and that ended nearest, if it can be there in time. The sequences become aircraft
numbered from west to east (``4840D6-1``, ``4840D6-2``).
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import takewhile

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from pandas.api.types import union_categoricals

from airswing.flags import PHASE, PLATFORM
from airswing.physics.triangle import direction_in_degrees, wrap_degrees
from airswing.reports.audit import Audit
from airswing.reports.columns import EARLIEST, Floats, Index, Integers, Mask, seconds_since_1970
from airswing.reports.flights import (
    Columns,
    derive_flight,
    derive_phase,
    number_of_run,
    resolutions,
    step_distance,
)
from airswing.units import METRES_PER_DEGREE
from airswing.vocabulary import describe

# m/s over ground, and m/s of climb: positions farther apart are not of the same time.
FASTEST, CLIMB = 350.0, 10.0
STRAIGHT = 10.0  # degrees of heading within which an interval of averaging counts as straight
_SAME_PLACE, _SAME_ALTITUDE = 1e-4, 15.0  # degrees, m
_TREND_GAP = 1200.0  # s: reports farther away show no climb or descent
_FEWEST_OVERLAPPING = 5  # reports of a flight that overlaps another; fewer are wrong positions
_AIRPORT = 100_000.0  # m: a flight may begin at once this far from the end of the last one
_LATEST = np.datetime64("2200", "ns")  # later than any possible time
_INTERNAL = ("tail", "platform", "counted", "wind_speed", "wind_direction")  # not in the Dataset


def assemble(
    parts: Iterable[pd.DataFrame],
    *,
    interval: float = 0.0,
    begins: tuple[np.datetime64, np.datetime64] | None = None,
    audit: Audit | None = None,
) -> xr.Dataset:
    """Assemble the cleaned reports of several files into one ragged Dataset, which may be empty.

    ``parts`` are of :func:`airswing.reports.read.read_file`, or rows of it; read only. With
    ``interval`` reports are averaged over so many seconds of straight flight. With ``begins`` only
    flights whose first report lies between these times are kept, so that with the reports of a
    margin every flight is kept once and complete. Duplicates and derived values are added to
    ``audit``, of ``begins`` alone; the caller adds the audits of the files.
    """
    audit = Audit() if audit is None else audit
    columns, tails, labels = _gathered(parts)
    # Reports of the margin are counted with their own period.
    first, after = begins or (EARLIEST, _LATEST)
    columns["counted"] = (columns["time"] >= first) & (columns["time"] < after)
    _take(columns, _order(columns))
    _drop_same_place(columns, audit)
    _drop_conflicts(columns, audit)
    _take(columns, _along_climb(columns))
    averaged = _average(columns, interval)
    flight = derive_flight(columns)
    _, begin, number = np.unique(flight, return_index=True, return_inverse=True)
    retained = columns["counted"][begin][number]
    _take(columns, retained)
    flight = flight[retained]
    audit.drop("averaged", int(averaged[retained].sum()))
    audit.repair("flight_derived", np.count_nonzero(columns["flight"] < 0))
    tails = _separate(columns, flight, tails, labels, audit)
    order = np.lexsort((flight, columns["tail"]))
    _take(columns, order)
    columns["flight"] = number_of_run(columns["tail"], flight[order])
    present, columns["tail"] = np.unique(columns["tail"], return_inverse=True)
    derived = derive_phase(columns, columns["flight"])
    unknown = columns["phase"] == PHASE["unknown"]
    columns["phase"] = np.where(unknown, derived, columns["phase"]).astype(np.int8)
    audit.repair("phase_derived", np.count_nonzero(unknown & (derived != 0)))
    for name in ("pressure", "eastward_wind", "air_temperature"):
        if absent := int(np.count_nonzero(np.isnan(columns[name]))):
            audit.missing[name] += absent
    row_size = np.bincount(columns["tail"], minlength=present.size)
    of_aircraft = {
        "row_size": row_size.astype(np.int32),
        "platform": _platform(columns, present.size),
        **resolutions(columns, row_size),
    }
    reports = xr.Dataset(
        {name: ("report", values) for name, values in columns.items() if name not in _INTERNAL}
        | {name: ("aircraft", values) for name, values in of_aircraft.items()},
        coords={"aircraft": ("aircraft", tails[present])},
        attrs={"featureType": "trajectory"},
    )
    return describe(reports)


def _gathered(
    parts: Iterable[pd.DataFrame],
) -> tuple[Columns, NDArray[np.object_], NDArray[np.object_]]:
    """Columns of all parts, with tails and labels as numbers (-1: none), and their names."""
    frames = list(parts)
    columns: Columns = {
        name: np.concatenate([frame[name].to_numpy() for frame in frames])
        for name in frames[0].columns
        if name not in ("tail", "flight")
    }
    names = {}
    for name in ("tail", "flight"):
        labels = union_categoricals([frame[name] for frame in frames], sort_categories=True)
        labels = labels.remove_unused_categories()
        columns[name] = labels.codes.astype(np.int32)
        names[name] = np.array([str(label) for label in labels.categories], dtype=object)
    # The blank label comes first in alphabetical order.
    blank = int(names["flight"].size > 0 and names["flight"][0] == "")
    columns["flight"] -= np.int32(blank)
    return columns, names["tail"], names["flight"][blank:]


def _take(columns: Columns, index: NDArray[np.integer | np.bool_]) -> None:
    for name in columns:
        columns[name] = columns[name][index]


def _order(columns: Columns) -> Integers:
    """Order by tail and time; ties by place, completeness and value, never by row or file."""
    # A sort by all keys is slow and few reports are tied: only those are sorted by the rest.
    order = np.lexsort((columns["time"], columns["tail"]))
    same = _same_moment(columns["tail"][order], columns["time"][order])
    tied = np.flatnonzero(same | np.r_[same[1:], False])
    if tied.size:
        members = order[tied]
        first = ("tail", "time", "latitude", "longitude", "pressure")
        rest = [name for name in sorted(columns) if name not in first]
        keys = [columns[name][members] for name in rest]
        keys.append(_number_missing(columns, members))
        keys += [columns[name][members] for name in reversed(first)]
        order[tied] = members[np.lexsort(keys)]
    return np.asarray(order, dtype=np.int64)


def _same_moment(tail: Index, time: NDArray[np.datetime64]) -> Mask:
    same = np.zeros(tail.size, dtype=bool)
    same[1:] = (tail[1:] == tail[:-1]) & (time[1:] == time[:-1])
    return same


def _number_missing(columns: Columns, members: Index) -> Integers:
    names = ("eastward_wind", "air_temperature", "pressure")
    return np.asarray(sum(np.isnan(columns[name][members]).astype(np.int64) for name in names))


def _drop_same_place(columns: Columns, audit: Audit) -> None:
    later = np.flatnonzero(_same_moment(columns["tail"], columns["time"]))
    north, east, up = _separation(columns, later)
    # An unknown altitude (NaN) passes.
    near = (np.abs(north) < _SAME_PLACE) & (np.abs(east) < _SAME_PLACE) & ~(up >= _SAME_ALTITUDE)
    later = later[near]
    exact = np.ones(later.size, dtype=bool)
    for values in columns.values():
        value, previous = values[later], values[later - 1]
        # NaN differs from itself: two absent values are equal here.
        exact &= (value == previous) | ((value != value) & (previous != previous))
    counted = columns["counted"][later]
    audit.drop("exact_duplicate", np.count_nonzero(exact & counted))
    audit.drop("same_tail_and_time", np.count_nonzero(~exact & counted))
    if later.size:
        _take(columns, np.delete(np.arange(columns["tail"].size), later))


def _drop_conflicts(columns: Columns, audit: Audit) -> None:
    """Of two positions that one aircraft cannot have had, drop the less complete report."""
    while True:
        later = np.flatnonzero(_same_moment(columns["tail"], columns["time"]))
        north, east, up = _separation(columns, later)
        east = east * np.cos(np.radians(columns["latitude"][later]))
        # A whole minute may be truncated; others are exact to a second.
        minute = columns["time"][later].astype("datetime64[ms]").astype(np.int64) % 60_000 == 0
        uncertain = np.where(minute, 60.0, 1.0) + np.nan_to_num(up) / CLIMB
        label, before = columns["flight"][later], columns["flight"][later - 1]
        conflict = np.hypot(north, east) * METRES_PER_DEGREE > FASTEST * uncertain
        later = later[conflict & ~((label >= 0) & (before >= 0) & (label != before))]
        later = later[np.r_[True, np.diff(later) > 1][: later.size]]  # one of a chain at a time
        if not later.size:
            return
        worse_before = _number_missing(columns, later - 1) > _number_missing(columns, later)
        audit.drop("conflicting_position", np.count_nonzero(columns["counted"][later]))
        _take(columns, np.delete(np.arange(columns["tail"].size), later - worse_before))


def _along_climb(columns: Columns) -> Integers:
    """Order of reports of one time that continues the climb or descent of those around them."""
    order = np.arange(columns["tail"].size)
    same = _same_moment(columns["tail"], columns["time"])
    tied = np.flatnonzero(same | np.r_[same[1:], False])
    if not tied.size:
        return order
    moment = np.cumsum(~same) - 1
    starts = np.flatnonzero(~same)
    altitude = columns["pressure_altitude"].astype(np.float64)
    mean = np.add.reduceat(altitude, starts) / np.diff(np.r_[starts, altitude.size])
    tail = columns["tail"][starts]
    moment_number = np.arange(starts.size)
    gap = np.diff(seconds_since_1970(columns["time"][starts]))
    close = (tail[1:] == tail[:-1]) & (gap < _TREND_GAP)
    before = np.where(np.r_[False, close], moment_number - 1, moment_number)
    after = np.where(np.r_[close, False], moment_number + 1, moment_number)
    trend = np.nan_to_num(np.sign(mean[after] - mean[before]))
    phase = columns["phase"][starts]
    trend = np.where(phase == PHASE["ascent"], 1.0, trend)
    trend = np.where(phase == PHASE["descent"], -1.0, trend)[moment[tied]]
    # Stable: without a trend all keys are zero and the order is unchanged.
    order[tied] = tied[np.lexsort((trend * altitude[tied], moment[tied]))]
    return order


def _separation(columns: Columns, later: Index) -> tuple[Floats, Floats, Floats]:
    """Degrees north and east (the short way round) and metres up from the reports before."""
    north, east, up = (
        columns[name][later] - columns[name][later - 1]
        for name in ("latitude", "longitude", "pressure_altitude")
    )
    return north, wrap_degrees(east), np.abs(up)


def _separate(
    columns: Columns,
    flight: NDArray[np.int32],
    tails: NDArray[np.object_],
    labels: NDArray[np.object_],
    audit: Audit,
) -> NDArray[np.object_]:
    flown = pd.Series(np.arange(flight.size)).groupby(flight).agg(["first", "last", "size"])
    seconds = seconds_since_1970(columns["time"])
    flown = flown.assign(
        tail=columns["tail"][flown["first"]],
        begin=seconds[flown["first"]],
        end=seconds[flown["last"]],
        label=pd.Series(columns["flight"]).groupby(flight).max(),
    )
    flown = flown[flown["size"] >= _FEWEST_OVERLAPPING]
    before = flown.groupby("tail").shift()
    common = np.minimum(flown["end"], before["end"]) - flown["begin"]
    shorter = np.minimum(flown["end"] - flown["begin"], before["end"] - before["begin"])
    overlaps = common > 0.5 * shorter
    smaller = np.minimum(flown["size"], before["size"])
    audit.repair("same_identifier_at_two_places", int(smaller[overlaps].sum()))
    names = list(tails)
    for tail in flown.loc[overlaps, "tail"].unique().tolist():
        of_tail = flown[flown["tail"] == tail]
        sequence = _sequences(of_tail, columns, labels)
        east = pd.Series(columns["longitude"][of_tail["first"]]).groupby(sequence).mean()
        place = (east.rank(method="first").astype(int) - 1 + len(names)).to_numpy()[sequence]
        names += [f"{tails[tail]}-{k + 1}" for k in range(east.size)]
        inside = np.flatnonzero(columns["tail"] == tail)
        # Flights of few reports are wrong positions.
        new = pd.Series(place, of_tail.index).reindex(flight[inside], fill_value=place[0])
        columns["tail"][inside] = new
    order = np.argsort(names)
    columns["tail"] = np.argsort(order).astype(np.int32)[columns["tail"]]
    return np.array(names, dtype=object)[order]


def _sequences(flown: pd.DataFrame, columns: Columns, labels: NDArray[np.object_]) -> Integers:
    """Number the sequences of flights of one identifier that one aircraft can have flown."""
    operators = [
        "" if code < 0 else "".join(takewhile(str.isalpha, labels[code]))
        for code in flown["label"].tolist()
    ]
    ends: list[tuple[int, float, str]] = []  # last report of each sequence, its time and operator
    number = []
    columns_of = (flown[name].tolist() for name in ("first", "last", "begin", "end"))
    for first, last, begin, end, operator in zip(*columns_of, operators, strict=True):
        candidates = []
        for sequence, (before, ended, previous) in enumerate(ends):
            pair = [before, first]
            away = step_distance(columns["latitude"][pair], columns["longitude"][pair])[0]
            if begin >= ended and away <= FASTEST * (begin - ended) + _AIRPORT:
                candidates.append((operator != previous, float(away), sequence))
        best = min(candidates, default=(False, 0.0, len(ends)))[2]
        ends[best : best + 1] = [(last, end, operator)]
        number.append(best)
    return np.array(number)


def _average(columns: Columns, interval: float) -> Integers:
    """Average reports in order of tail and time over intervals (s; 0: none), in place.

    Returns the number of other reports that each remaining one replaces, (report,).
    Reports of neighbouring seconds differ by coding noise; the errors of model and compass are the
    same in all of them, so that a mean is one report with less noise. Where the heading changes by
    more than :data:`STRAIGHT` the middle report is kept unchanged, because a mean over a turn is
    not on the path. Positions are averaged in degrees, the short way round at the antimeridian.
    """
    if interval <= 0.0 or columns["tail"].size < 2:
        return np.zeros(columns["tail"].size, dtype=np.int64)
    seconds = columns["time"].astype("datetime64[ms]").astype(np.int64) / 1e3
    group = number_of_run(columns["tail"], np.floor(seconds / interval), columns["flight"])
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    heading, longitude = columns["reported_heading"], columns["longitude"]
    # Relative to the first, because sums of seconds since 1970 lose the milliseconds.
    first = starts[group]
    values = {n: v.astype(np.float64) for n, v in columns.items() if v.dtype.kind == "f"} | {
        "reported_heading": wrap_degrees(heading.astype(np.float64) - heading[first]),
        "longitude": wrap_degrees(longitude - longitude[first]),
        "time": seconds - seconds[first],
    }
    grouped = pd.DataFrame(values).groupby(group)
    turn = grouped["reported_heading"].max() - grouped["reported_heading"].min()
    sizes = grouped.size().to_numpy()
    straight = (sizes > 1) & ~(turn.to_numpy() > STRAIGHT)
    means = {str(name): column.to_numpy() for name, column in grouped.mean().items()}
    means["reported_heading"] = (heading[starts] + means["reported_heading"]) % 360.0
    means["longitude"] = wrap_degrees(longitude[starts] + means["longitude"])
    means["time"] = np.round((seconds[starts] + means["time"]) * 1e9).astype("datetime64[ns]")
    east, north = means["eastward_wind"], means["northward_wind"]
    means["wind_speed"] = np.hypot(east, north)
    means["wind_direction"] = direction_in_degrees(east, north)
    for name, original in columns.items():
        # the month of an interval is that of its first report, as that of a flight
        columns[name] = original[starts if name == "counted" else starts + sizes // 2]
        if name in means:
            columns[name][straight] = means[name][straight]
    return np.asarray(sizes - 1, dtype=np.int64)


def _platform(columns: Columns, aircraft: int) -> NDArray[np.int8]:
    counts = np.zeros((aircraft, max(PLATFORM.values()) + 1), dtype=np.int64)
    np.add.at(counts, (columns["tail"], columns["platform"]), 1)
    counts[:, PLATFORM["unknown"]] = 0
    return np.asarray(counts.argmax(axis=1), dtype=np.int8)
