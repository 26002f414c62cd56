"""From canonical columns to the reports Dataset: order, duplicates, ragged layout.

Assumes columns of :func:`airswing.reports.canonical.cleaning.clean`, tails and flight labels as
integers in alphabetical order. What becomes of an aircraft's reports depends on that aircraft's
reports alone, but for two things a fleet shares: the numbers its flights begin at, and the
resolutions that stand in for aircraft with too few reports. So a fleet may be assembled in blocks
of whole aircraft (:func:`assembled`) and completed afterwards (:func:`completed`), with the same
result bit for bit however it is divided.

Duplicates
----------
Two reports of one tail at one time and place (within 1e-4 degree and 15 m) are one: the more
complete stays, then the one with the smaller values, never the one that happened to come
first: the result does not depend on the order of rows or files. Same tail and time at another
place is kept where the time (a whole minute) is coarse enough for both to be true, else it is a
conflict and the more complete stays. Those kept follow the climb or descent around them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.flags import PLATFORM
from airswing.physics.triangle import wrap_degrees
from airswing.reports.averaging import averaged
from airswing.reports.canonical.audit import Audit
from airswing.reports.derive import Columns, derive_flight, derive_phase, seconds_since_1970
from airswing.reports.resolution import count_on_steps, resolutions
from airswing.units import METRES_PER_DEGREE
from airswing.vocabulary import describe

# m/s over ground; two places farther apart than this allows are not one moment of a flight.
FASTEST = 350.0
# Reports whose flights and phases are derived together (more where one aircraft has more).
REPORTS_AT_ONCE = 500_000
_SAME_PLACE = 1e-4  # degrees
_TREND_GAP = 1200.0  # s: farther reports do not tell a climb from a descent
_OUTPUT = (
    "latitude",
    "longitude",
    "pressure",
    "pressure_altitude",
    "eastward_wind",
    "northward_wind",
    "air_temperature",
    "roll_flag",
    "temperature_qc",
    "wind_qc",
    "phase",
    "icing",
    "wind_source",
    "reported_airspeed",
    "reported_heading",
)
_MAY_BE_MISSING = ("pressure", "eastward_wind", "air_temperature")


class Block(NamedTuple):
    """Reports of some aircraft, but for what the whole fleet decides."""

    reports: xr.Dataset  # flights numbered from 0 within the block; no resolutions yet
    counts: dict[str, NDArray[np.int64]]  # of `airswing.reports.resolution.count_on_steps`
    flights: int


def assemble(
    parts: Iterable[pd.DataFrame],
    *,
    interval: float = 0.0,
    begins: tuple[np.datetime64, np.datetime64] | None = None,
    audit: Audit | None = None,
) -> xr.Dataset:
    """Assemble the cleaned reports of several files into one ragged Dataset.

    The result does not depend on the order of the parts nor on the order of rows in them.

    Parameters
    ----------
    parts : iterable of DataFrame
        Cleaned reports, each of :func:`airswing.reports.read.read_file` or rows of it; read only.
    interval : float, default 0
        Reports are averaged over intervals of so many seconds of straight flight; 0 keeps them all.
    begins : (datetime64, datetime64), optional
        Keep only the flights whose first report lies from the first time to before the second:
        give the reports of a margin around that time too, and every flight is kept whole once.
    audit : Audit, optional
        Duplicates and derived values are added to it, and with ``begins`` the reports of other
        flights are subtracted from ``read``; the caller adds the audits of the files before.

    Returns
    -------
    Dataset
        As of :func:`airswing.reports.read.read_reports`, without its audit; aircraft without a
        report are left out, so that it may be empty.
    """
    columns, tails = gathered(parts)
    block = assembled(
        columns, tails, Audit() if audit is None else audit, interval=interval, begins=begins
    )
    (reports,) = completed([block])
    return reports.assign_attrs(featureType="trajectory")


def gathered(parts: Iterable[pd.DataFrame]) -> tuple[Columns, NDArray[np.object_]]:
    """Columns of all parts, tails and flight labels numbered in alphabetical order, and the tails.

    A report without a flight label has the number -1.
    """
    frames = list(parts)
    columns: Columns = {
        name: np.concatenate([frame[name].to_numpy() for frame in frames])
        for name in frames[0].columns
        if name not in ("tail", "flight")
    }
    tails, columns["tail"] = _numbered(frame["tail"] for frame in frames)
    labels, flight = _numbered(frame["flight"] for frame in frames)
    # The blank label comes first in alphabetical order.
    columns["flight"] = flight - np.int32(labels.size > 0 and labels[0] == "")
    return columns, tails


def _numbered(
    columns: Iterable[pd.Series[str]],
) -> tuple[NDArray[np.object_], NDArray[np.int32]]:
    """Labels that occur, in alphabetical order, and the number of each value's label."""
    together = pd.api.types.union_categoricals(list(columns), ignore_order=True)
    codes = np.asarray(together.codes)
    used, index = np.unique(codes, return_inverse=True)
    labels = np.array([str(label) for label in together.categories[used]], dtype=object)
    order = np.argsort(labels)
    number = np.empty(labels.size, dtype=np.int32)
    number[order] = np.arange(labels.size, dtype=np.int32)
    return labels[order], number[index]


def assembled(
    columns: Columns,
    tails: NDArray[np.object_],
    audit: Audit,
    *,
    interval: float = 0.0,
    begins: tuple[np.datetime64, np.datetime64] | None = None,
) -> Block:
    """Order, thin and lay out the reports of some aircraft; those left without any are not in it.

    Parameters
    ----------
    columns : dict of arrays, shape (report,)
        Canonical columns; ``tail`` numbers ``tails``, ``flight`` is -1 without a label. Emptied.
    tails : array of str, shape (aircraft,)
        In alphabetical order.
    audit : Audit
        Duplicates and derived values are added to it.
    interval : float, default 0
        Reports are brought to one in so many seconds (:mod:`airswing.reports.averaging`); 0 leaves
        them as they are.
    begins : (datetime64, datetime64), optional
        Only flights whose first report lies from the first to before the second stay.
    """
    _take(columns, _order(columns))
    _drop_same_place(columns, audit)
    _drop_conflicts(columns, audit)
    _take(columns, _along_climb(columns))
    averaged(columns, interval, audit)
    return _layout(columns, tails, audit, begins)


def completed(blocks: Sequence[Block]) -> Iterator[xr.Dataset]:
    """Complete all blocks of a fleet, in order, with what the fleet shares."""
    shared = Shared.of(blocks)
    for number, block in enumerate(blocks):
        yield shared.complete(number, block.reports)


class Shared:
    """What the blocks of one fleet share.

    Parameters
    ----------
    counts : sequence of dict
        Of :func:`airswing.reports.resolution.count_on_steps`, block by block.
    flights : sequence of int
        Of each block.
    """

    def __init__(
        self, counts: Sequence[dict[str, NDArray[np.int64]]], flights: Sequence[int]
    ) -> None:
        sizes = [one["steady"].size for one in counts]
        self._stop = np.cumsum(sizes)
        self._first = self._stop - sizes
        self._flight = np.cumsum(flights) - np.asarray(flights)
        self._found = resolutions(
            {name: np.concatenate([one[name] for one in counts]) for name in counts[0]}
        )

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> Shared:
        """Gather from blocks in memory."""
        return cls([block.counts for block in blocks], [block.flights for block in blocks])

    def complete(self, number: int, reports: xr.Dataset) -> xr.Dataset:
        """Number the flights of a block over the fleet and give its aircraft their resolutions."""
        own = slice(int(self._first[number]), int(self._stop[number]))
        flight = reports["flight"].to_numpy() + np.int32(self._flight[number])
        found: dict[str, object] = {
            name: ("aircraft", values[own]) for name, values in self._found.items()
        }
        return describe(reports.assign(found | {"flight": ("report", flight)}))


def in_alphabetical_order(
    labels: Sequence[str], codes: NDArray[np.integer]
) -> tuple[NDArray[np.object_], NDArray[np.int32]]:
    """Labels in alphabetical order, and codes (int32) that number them anew."""
    names = np.array(list(labels), dtype=object)
    order = np.argsort(names)
    renumbered = np.empty(names.size, dtype=np.int32)
    renumbered[order] = np.arange(names.size, dtype=np.int32)
    return names[order], renumbered[codes]


def _take(columns: Columns, index: NDArray[np.integer]) -> None:
    for name in columns:
        columns[name] = columns[name][index]


def _order(columns: Columns) -> NDArray[np.int64]:
    """Order by tail and time; ties by place, completeness and value, never by row or file."""
    # All keys are costly, few reports are tied: those alone are sorted by the rest.
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


def _same_moment(tail: NDArray[np.integer], time: NDArray[np.datetime64]) -> NDArray[np.bool_]:
    """Tell which reports share tail and time with the one before."""
    same = np.zeros(tail.size, dtype=bool)
    same[1:] = (tail[1:] == tail[:-1]) & (time[1:] == time[:-1])
    return same


def _gaps(columns: Columns, members: NDArray[np.integer]) -> NDArray[np.int64]:
    """Count what each report lacks."""
    names = ("eastward_wind", "air_temperature", "pressure")
    return np.asarray(sum(np.isnan(columns[name][members]).astype(np.int64) for name in names))


def _drop_same_place(columns: Columns, audit: Audit) -> None:
    later = np.flatnonzero(_same_moment(columns["tail"], columns["time"]))
    north, east, up = _apart(columns, later, later - 1)
    # An unknown altitude (NaN) passes: `~(up >= 15)` where `up < 15` would not.
    later = later[(np.abs(north) < _SAME_PLACE) & (np.abs(east) < _SAME_PLACE) & ~(up >= 15.0)]
    exact = np.ones(later.size, dtype=bool)
    for values in columns.values():
        one, other = values[later], values[later - 1]
        # NaN differs from itself: two absent values are equal here.
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
        metres = np.hypot(north, east) * METRES_PER_DEGREE
        later = later[metres > FASTEST * _clock(columns["time"][later])]
        later = later[np.r_[True, np.diff(later) > 1][: later.size]]  # one of a chain at a time
        if not later.size:
            return
        # A bool taken off the number: the report before goes where it lacks more.
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
    # Ascending in a climb, descending in a descent; without a trend all keys are zero and the
    # sort, which is stable, leaves the order.
    order[tied] = tied[np.lexsort((trend * altitude[tied], moment[tied]))]
    return order


def _apart(
    columns: Columns, one: NDArray[np.integer], other: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Degrees north and east (the short way round) and metres up between reports."""
    north, east, up = (
        columns[name][one] - columns[name][other]
        for name in ("latitude", "longitude", "pressure_altitude")
    )
    return north, wrap_degrees(east), np.abs(up)


def _clock(time: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Precision a time claims: a whole minute may be cut to the minute, others to a second (s)."""
    whole = time.astype("datetime64[ms]").astype(np.int64) % 60_000 == 0
    return np.where(whole, 60.0, 1.0)


def _derived(
    columns: Columns, row_size: NDArray[np.integer]
) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Flights and phases, a few aircraft at a time: the working arrays stay small."""
    flight = np.empty(columns["tail"].size, dtype=np.int32)
    phase = np.empty(columns["tail"].size, dtype=np.int8)
    stops = np.cumsum(row_size)
    start, number = 0, 0
    for stop, ahead in zip(stops, [*stops[1:], np.inf], strict=True):
        # The next aircraft still fits in: wait for it.
        if ahead - start <= REPORTS_AT_ONCE:
            continue
        part = {name: values[start:stop] for name, values in columns.items()}
        own = derive_flight(part)
        phase[start:stop] = derive_phase(part, own)
        flight[start:stop] = own + number
        number += int(own.max(initial=-1)) + 1
        start = int(stop)
    return flight, phase


def _begun(
    time: NDArray[np.datetime64],
    flight: NDArray[np.int32],
    begins: tuple[np.datetime64, np.datetime64],
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Reports of the flights that begin in some time, and these flights numbered from 0."""
    _, first, number = np.unique(flight, return_index=True, return_inverse=True)
    begun = (time[first] >= begins[0]) & (time[first] < begins[1])
    kept = np.flatnonzero(begun[number])
    return kept, (np.cumsum(begun) - 1)[number[kept]].astype(np.int32)


def _layout(
    columns: Columns,
    tails: NDArray[np.object_],
    audit: Audit,
    begins: tuple[np.datetime64, np.datetime64] | None = None,
) -> Block:
    row_size = np.bincount(columns["tail"], minlength=tails.size)
    flight, derived = _derived(columns, row_size)
    if begins is not None:
        kept, flight = _begun(columns["time"], flight, begins)
        audit.read -= derived.size - kept.size
        derived = derived[kept]
        _take(columns, kept)
        row_size = np.bincount(columns["tail"], minlength=tails.size)
    present = row_size > 0
    columns["tail"] = (np.cumsum(present) - 1)[columns["tail"]].astype(np.int32)
    counts = count_on_steps(columns, row_size[present])
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
            "platform": ("aircraft", _platform(columns, int(present.sum()))),
            "time": ("report", columns["time"]),
            **{name: ("report", columns[name]) for name in _OUTPUT},
            "flight": ("report", flight),
        },
        coords={"aircraft": ("aircraft", tails[present])},
    )
    return Block(ds, counts, int(flight.max(initial=-1)) + 1)


def _platform(columns: Columns, aircraft: int) -> NDArray[np.int8]:
    """Platform most of an aircraft's reports tell; unknown where none does."""
    size = max(PLATFORM.values()) + 1
    place = columns["tail"].astype(np.int64) * size + columns["platform"]
    told = np.bincount(place, minlength=aircraft * size).reshape(aircraft, size)
    told[:, PLATFORM["unknown"]] = 0
    return np.asarray(told.argmax(axis=1), dtype=np.int8)
