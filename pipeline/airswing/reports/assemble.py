"""From canonical frames to the reports Dataset: order, duplicates, ragged layout.

Assumes frames of :func:`airswing.reports.canonical.clean`. Columns are gathered one by one and
each piece is let go as it is taken up, so the archive stands in memory once; tails and flight
labels are kept as integers throughout.

Duplicates
----------
Two reports of one tail at one time and place (within 1e-4 degree and 15 m) are one: the more
complete stays, then the one with the smaller values, never the one that happened to come
first: the result does not depend on the order of rows or files. Same tail and time at another
place is kept where the time (a whole minute) is coarse enough for both to be true, else it is a
conflict and the more complete stays. Those kept follow the climb or descent around them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.reports.audit import Audit
from airswing.reports.derive import derive_flight, derive_phase, seconds_since_1970
from airswing.reports.resolution import detect_resolution
from airswing.vocabulary import describe

FASTEST = 350.0
"""m/s over ground; two places farther apart than this allows are not one moment of a flight."""
REPORTS_AT_ONCE = 500_000
"""Reports whose flights and phases are derived together (more where one aircraft has more)."""
_METRES_PER_DEGREE = 111_195.0
_SAME_PLACE = 1e-4  # degrees
_TREND_GAP = 1200.0  # s: farther reports do not tell a climb from a descent
_CATEGORIES = ("tail", "flight")
_OUTPUT = (
    "latitude", "longitude", "pressure", "pressure_altitude", "eastward_wind", "northward_wind",
    "air_temperature", "roll_flag", "temperature_qc", "wind_qc", "phase", "icing",
    "reported_airspeed", "reported_heading",
)  # fmt: skip
_MAY_BE_MISSING = ("pressure", "eastward_wind", "air_temperature")

Columns = dict[str, NDArray[Any]]


class Gatherer:
    """Takes up canonical frames column by column.

    Examples
    --------
    >>> gatherer = Gatherer()
    >>> for frame in frames:  # doctest: +SKIP
    ...     gatherer.add(frame)
    >>> ds = gatherer.dataset(audit)  # doctest: +SKIP
    """

    def __init__(self) -> None:
        self._pieces: dict[str, list[NDArray[Any]]] = {}
        self._codes: dict[str, dict[str, int]] = {name: {} for name in _CATEGORIES}

    def add(self, frame: pd.DataFrame) -> None:
        """Take up one frame.

        Parameters
        ----------
        frame : DataFrame
            From :func:`airswing.reports.canonical.clean`.
        """
        for name in frame.columns:
            values = self._integers(frame, name) if name in _CATEGORIES else frame[name].to_numpy()
            self._pieces.setdefault(str(name), []).append(values)

    def _integers(self, frame: pd.DataFrame, name: str) -> NDArray[np.int32]:
        known, column = self._codes[name], frame[name].cat
        codes = [known.setdefault(str(label), len(known)) for label in column.categories]
        return np.asarray(np.array(codes, dtype=np.int32)[column.codes.to_numpy()], dtype=np.int32)

    def dataset(self, audit: Audit) -> xr.Dataset:
        """Order, thin and lay out what was taken up; the gatherer is empty afterwards.

        Parameters
        ----------
        audit : Audit
            Duplicates and derived values are added to it.

        Returns
        -------
        Dataset
            The reports (see the package's documentation), audit in ``reading_audit``.
        """
        columns = {name: np.concatenate(self._pieces.pop(name)) for name in list(self._pieces)}
        tails, columns["tail"] = _alphabetic(self._codes["tail"], columns["tail"])
        labels, columns["flight"] = _alphabetic(self._codes["flight"], columns["flight"])
        columns["flight"] = np.where(np.array([*labels, ""]) == "", -1, np.arange(len(labels) + 1))[
            columns["flight"]
        ].astype(np.int32)
        _take(columns, _order(columns))
        _drop_same_place(columns, audit)
        _drop_conflicts(columns, audit)
        _take(columns, _along_climb(columns))
        return _layout(columns, tails, audit)


def _alphabetic(
    known: dict[str, int], codes: NDArray[Any]
) -> tuple[NDArray[np.object_], NDArray[np.int32]]:
    labels = np.array(list(known), dtype=object)
    order = np.argsort(labels)
    renumbered = np.empty(labels.size, dtype=np.int32)
    renumbered[order] = np.arange(labels.size, dtype=np.int32)
    return labels[order], renumbered[codes]


def _take(columns: Columns, index: NDArray[Any]) -> None:
    for name in columns:
        columns[name] = columns[name][index]


def _order(columns: Columns) -> NDArray[np.int64]:
    """Order by tail and time; ties by place, completeness and value, never by row or file."""
    order = np.lexsort((columns["time"], columns["tail"]))
    same = _same_moment(columns["tail"][order], columns["time"][order])
    tied = np.flatnonzero(same | np.r_[same[1:], False])
    if tied.size:
        members = order[tied]
        first = ("tail", "time", "latitude", "longitude", "pressure")
        rest = [name for name in sorted(columns) if name not in first]
        keys = [columns[name][members] for name in rest]
        keys.append(_gaps(columns, members))
        keys += [columns[name][members] for name in reversed(first)]
        order[tied] = members[np.lexsort(keys)]
    return np.asarray(order, dtype=np.int64)


def _same_moment(tail: NDArray[Any], time: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which reports share tail and time with the one before."""
    same = np.zeros(tail.size, dtype=bool)
    same[1:] = (tail[1:] == tail[:-1]) & (time[1:] == time[:-1])
    return same


def _gaps(columns: Columns, members: NDArray[Any]) -> NDArray[np.int64]:
    """Count what each report lacks."""
    names = ("eastward_wind", "air_temperature", "pressure")
    return np.asarray(sum(np.isnan(columns[name][members]).astype(np.int64) for name in names))


def _drop_same_place(columns: Columns, audit: Audit) -> None:
    later = np.flatnonzero(_same_moment(columns["tail"], columns["time"]))
    north, east, up = _apart(columns, later, later - 1)
    later = later[(np.abs(north) < _SAME_PLACE) & (np.abs(east) < _SAME_PLACE) & ~(up >= 15.0)]
    exact = np.ones(later.size, dtype=bool)
    for values in columns.values():
        one, other = values[later], values[later - 1]
        exact &= (one == other) | ((one != one) & (other != other))
    audit.drop("exact_duplicate", int(np.count_nonzero(exact)))
    audit.drop("same_tail_and_time", int(np.count_nonzero(~exact)))
    if later.size:
        _take(columns, np.delete(np.arange(columns["tail"].size), later))


def _drop_conflicts(columns: Columns, audit: Audit) -> None:
    """Of two places no aircraft could both be at, drop the less complete report's."""
    while True:
        later = np.flatnonzero(_same_moment(columns["tail"], columns["time"]))
        north, east, _ = _apart(columns, later, later - 1)
        east = east * np.cos(np.radians(columns["latitude"][later]))
        metres = np.hypot(north, east) * _METRES_PER_DEGREE
        later = later[metres > FASTEST * _clock(columns["time"][later])]
        later = later[np.r_[True, np.diff(later) > 1][: later.size]]  # one of a chain at a time
        if not later.size:
            return
        worse_before = _gaps(columns, later - 1) > _gaps(columns, later)
        audit.drop("conflicting_position", later.size)
        _take(columns, np.delete(np.arange(columns["tail"].size), later - worse_before))


def _along_climb(columns: Columns) -> NDArray[np.int64]:
    """Order that lets reports of one minute climb or descend with those around them."""
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
    here = np.arange(starts.size)
    gap = np.diff(seconds_since_1970(columns["time"][starts]))
    close = (tail[1:] == tail[:-1]) & (gap < _TREND_GAP)
    before = np.where(np.r_[False, close], here - 1, here)
    after = np.where(np.r_[close, False], here + 1, here)
    trend = np.nan_to_num(np.sign(mean[after] - mean[before]))[moment[tied]]
    order[tied] = tied[np.lexsort((trend * altitude[tied], moment[tied]))]
    return order


def _apart(
    columns: Columns, one: NDArray[Any], other: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Degrees north and east (the short way round) and metres up between reports."""
    north, east, up = (
        columns[name][one] - columns[name][other]
        for name in ("latitude", "longitude", "pressure_altitude")
    )
    return north, (east + 180.0) % 360.0 - 180.0, np.abs(up)


def _clock(time: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Precision a time claims: a whole minute may be cut to the minute, others to a second (s)."""
    whole = time.astype("datetime64[ms]").astype(np.int64) % 60_000 == 0
    return np.where(whole, 60.0, 1.0)


def _derived(
    columns: Columns, row_size: NDArray[Any]
) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Flights and phases, a few aircraft at a time: the working arrays stay small."""
    flight = np.empty(columns["tail"].size, dtype=np.int32)
    phase = np.empty(columns["tail"].size, dtype=np.int8)
    stops = np.cumsum(row_size)
    start, number = 0, 0
    for stop, ahead in zip(stops, [*stops[1:], np.inf], strict=True):
        if ahead - start <= REPORTS_AT_ONCE:
            continue
        part = {name: values[start:stop] for name, values in columns.items()}
        own = derive_flight(part)
        phase[start:stop] = derive_phase(part, own)
        flight[start:stop] = own + number
        number += int(own.max(initial=-1)) + 1
        start = int(stop)
    return flight, phase


def _layout(columns: Columns, tails: NDArray[np.object_], audit: Audit) -> xr.Dataset:
    row_size = np.bincount(columns["tail"], minlength=tails.size)
    present = row_size > 0
    columns["tail"] = (np.cumsum(present) - 1)[columns["tail"]].astype(np.int32)
    resolution = detect_resolution(columns, row_size[present])
    flight, derived = _derived(columns, row_size)
    unknown = columns["phase"] == 0
    columns["phase"] = np.where(unknown, derived, columns["phase"]).astype(np.int8)
    audit.repair("phase_derived", int(np.count_nonzero(unknown & (derived != 0))))
    audit.repair("flight_derived", int(np.count_nonzero(columns["flight"] < 0)))
    for name in _MAY_BE_MISSING:
        absent = int(np.count_nonzero(np.isnan(columns[name])))
        if absent:
            audit.missing[name] += absent
    ds = xr.Dataset(
        {
            "row_size": ("aircraft", row_size[present].astype(np.int32)),
            "time": ("report", columns["time"]),
            **{name: ("report", columns[name]) for name in _OUTPUT},
            "flight": ("report", flight),
            **{name: ("aircraft", values) for name, values in resolution.items()},
        },
        coords={"aircraft": ("aircraft", tails[present])},
        attrs={"reading_audit": audit.as_json(), "featureType": "trajectory"},
    )
    return describe(ds)
