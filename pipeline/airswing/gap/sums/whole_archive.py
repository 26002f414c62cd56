"""All reports of an archive, an aircraft at a time, and those of them that are held in memory.

Assumptions: sums need every report once; everything that looks at reports themselves (noise,
closure, checks, maps) is as well told by :data:`VIEW` of them, whole flights drawn evenly over
aircraft and days. An archive of no more is held whole. What a design column takes from the fleet
(the large-scale wind of a day) comes from all reports; bank and acceleration of an ordinary turn or
climb, which a frame takes from all of its reports, a part takes from its own aircraft.

Validity: the sums are the same bit for bit whatever the number of workers. Memory: the view, the
sums (of bounded size, :mod:`airswing.gap.sums.accumulate`) and one aircraft for each worker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import REPORT_FIELDS, Frame
from airswing.gap.archive.headings_columns import AIRCRAFT_FIELDS, middle_longitude
from airswing.gap.design.exogenous import LargeScale, day_sums, exogenous
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.noise.model import NoiseFit, fitted_gains, flown
from airswing.gap.noise.whitening import flight_order, take_gains
from airswing.gap.sums.accumulate import (
    Clock,
    Statistics,
    SumColumns,
    add_reports,
    day_of_report,
    empty_statistics,
)
from airswing.physics.triangle import wrap_degrees

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Result = TypeVar("Result")
About = Callable[[Frame, Frame], tuple[Floats, Floats]]
"""Of reports and their context: the residual with the effects found so far taken off, and what they
are to first order, both (n, 2) m s-1."""

VIEW = 400_000
"""Reports held in memory, about."""
_SPREAD, _WHOLE = 2654435761, 2**32
"""Multiplicative hash that draws flights evenly (Knuth, The Art of Computer Programming, 6.4)."""


@dataclass(frozen=True)
class Archive:
    """An archive against one reference."""

    view: Frame  # the reports held in memory: all of them where `part` is None
    # number of an aircraft -> all of its reports, None where it has none
    part: Callable[[int], Frame | None] | None
    winds: LargeScale  # large-scale reported wind of all reports
    days: Integers  # (D,): days with flights since 1970
    clock: Clock  # how they are counted
    # reports, flights: all of them
    reports: int
    flights: int
    workers: int = 1  # threads

    @property
    def whole(self) -> bool:
        """Whether all reports are held."""
        return self.part is None

    @cached_property
    def context(self) -> Frame:
        """The view with the heading and airspeed design columns are made of."""
        made: Frame = exogenous(self.view, self.winds)
        return made

    def held(self) -> Archive:
        """Return what is held in memory as an archive of its own, over the same days."""
        return replace(self, part=None)

    def exchanged(self, pair: tuple[int, int], exchange: Callable[[Frame], Frame]) -> Archive:
        """Return the archive with two aircraft's reports given back to their airframes.

        Parameters
        ----------
        exchange : callable
            Gives a frame's reports the right aircraft.
        """
        read = self.part
        if read is None:
            return replace(self, view=exchange(self.view))

        def part(number: int) -> Frame | None:
            if number not in pair:
                return read(number)
            found = [read(one) for one in pair]
            # reports of one airframe stand under the other's name: both are read for either
            both = [exchange(one) for one in found if one is not None]
            own = [one.take(one.aircraft == number) for one in both]
            mine = [one for one in own if one.size]
            return joined(mine) if mine else None

        return replace(self, view=exchange(self.view), part=part)


def held_archive(frame: Frame, *, workers: int = 1) -> Archive:
    """Archive of reports that are in memory."""
    days, clock = day_of_report(frame)
    flights = int(np.unique(frame.flight).size)
    return Archive(
        frame, None, LargeScale.of(frame), np.unique(days), clock, frame.size, flights, workers
    )


def read_archive(
    ds: xr.Dataset,
    *,
    reference: str | Sequence[str],
    phases: Sequence[str] = ("ascent", "cruise", "descent"),
    workers: int = 1,
    most: int = VIEW,
) -> Archive:
    """Archive of a headings Dataset; a lazy one that is large is read an aircraft at a time.

    Parameters
    ----------
    ds : Dataset
        As `Frame.from_headings` takes it.
    reference : str or sequence of str
        One reference, or the members of a pool.
    phases : sequence of str
        Phases of flight kept.
    most : int
        Reports held in memory, about.

    Raises
    ------
    InputError
        The reference is unknown, or no report is usable.
    """
    if ds.sizes["report"] <= most:
        frame = Frame.from_headings(ds, reference=reference, phases=phases)
        return held_archive(frame, workers=workers)
    source = _Source(ds, reference, phases)
    # flights are drawn whole: errors along a flight are told by their neighbours
    share = most / ds.sizes["report"]
    # in order, threads or not: the same archive gives the same view
    looks = [look for look in _in_turn(source.look(share), source.number, workers) if look]
    if not looks:
        raise InputError(
            "no report has a wind, a ground vector and a reference wind at once",
            field="reports",
            remedy="check that reports and references overlap in time, space and level",
        )
    view = joined([look.view for look in looks])
    starts = np.concatenate([look.starts for look in looks])
    days, clock = day_of_report(_Starts(np.arange(starts.size), starts))
    winds = LargeScale.solved([look.winds for look in looks], source.epoch, source.centre)
    return Archive(
        view,
        source.part,
        winds,
        np.unique(days),
        clock,
        sum(look.reports for look in looks),
        starts.size,
        workers,
    )


class _Starts(NamedTuple):
    """First reports of flights, as far as days are counted by them."""

    flight: Integers
    time: Floats


class _Look(NamedTuple):
    """What the first reading of an aircraft keeps."""

    view: Frame
    starts: Floats  # first times of its flights, s
    winds: tuple[Integers, Floats]
    reports: int


class _Source:
    """A headings Dataset read aircraft by aircraft."""

    def __init__(
        self, ds: xr.Dataset, reference: str | Sequence[str], phases: Sequence[str]
    ) -> None:
        self.ds, self.reference, self.phases = ds, reference, phases
        counts = np.asarray(ds["row_size"].values, dtype=np.int64)
        self.counts, self.number = counts, counts.size
        self.start = np.r_[0, np.cumsum(counts)]
        flown_ = ds["time"].isel(report=self.start[:-1][counts > 0]).values
        self.epoch = float(flown_.min().astype("datetime64[ns]").astype(np.int64)) / 1e9
        # constants of the archive from as many reports as are held: they need no more
        few = slice(None, None, max(1, int(self.start[-1]) // VIEW))
        longitude = ds["longitude"][few].values.astype(float)
        self.meridian = middle_longitude(longitude)
        field = ds["horizontal_field"][few].values if "horizontal_field" in ds else np.array([])
        known = field[np.isfinite(field)]
        self.reference_field = float(np.median(known)) if known.size else None
        east = wrap_degrees(longitude - self.meridian) + self.meridian
        places = east, ds["latitude"][few].values, np.log(ds["pressure"][few].values.astype(float))
        # sums of squares about a middle known beforehand: about nought they would lose digits
        self.centre = np.array([[np.nanmean(v), np.nanstd(v) or 1.0] for v in places])

    def part(self, number: int) -> Frame | None:
        """Reports of one aircraft; None where none is usable."""
        own = slice(int(self.start[number]), int(self.start[number + 1]))
        # all aircraft stay in it, without reports: their numbers are the archive's
        rows = np.where(np.arange(self.number) == number, self.counts, 0)
        part = self.ds.isel(report=own).assign(row_size=(self.ds["row_size"].dims, rows))
        try:
            made = Frame.from_headings(
                part,
                reference=self.reference,
                phases=self.phases,
                epoch=self.epoch,
                reference_field=self.reference_field,
                meridian=self.meridian,
            )
        except InputError as error:
            if error.field == "reports":
                return None
            raise
        # numbered in the whole archive again
        return replace(made, report=made.report + own.start)

    def look(self, share: float) -> Callable[[int], _Look | None]:
        """Make the first reading, which keeps this share of the flights in memory."""

        def one(number: int) -> _Look | None:
            frame = self.part(number)
            if frame is None:
                return None
            flights, first = np.unique(frame.flight, return_index=True)
            # by the flight's number and not by lot: the same flights whatever the order of reading
            drawn = (flights * _SPREAD) % _WHOLE < share * _WHOLE
            kept = drawn[np.searchsorted(flights, frame.flight)]
            return _Look(
                frame.take(np.flatnonzero(kept)),
                frame.time[first],
                day_sums(frame, self.centre),
                frame.size,
            )

        return one


def joined(frames: Sequence[Frame]) -> Frame:
    """One frame of several of the same archive, at least one."""
    first = frames[0]
    return Frame(
        tails=first.tails,
        epoch=first.epoch,
        reference_field=first.reference_field,
        **{name: getattr(first, name) for name in AIRCRAFT_FIELDS},
        **{name: np.concatenate([getattr(one, name) for one in frames]) for name in REPORT_FIELDS},
    )


def _in_turn(work: Callable[[int], Result], number: int, workers: int) -> Iterator[Result]:
    """What the work makes of every number, in order, one to each thread."""
    if workers == 1:
        yield from map(work, range(number))
        return
    with ThreadPoolExecutor(max_workers=workers) as pool:
        yield from pool.map(work, range(number))


def sum_reports(
    archive: Archive,
    columns: SumColumns,
    *,
    about: About | None = None,
    progress: Callable[[float], None] | None = None,
) -> Statistics:
    """Whiten and sum all reports, aircraft after aircraft.

    Parameters
    ----------
    about : callable, optional
        Effects to be linearised about.
    progress : callable, optional
        Called with the fraction done.
    """
    view = archive.view
    out = empty_statistics(columns.layout, view.tails, archive.days, archive.clock)

    def add(number: int) -> int:
        made = _held(archive, number, columns) if archive.whole else _read(archive, number)
        if made is None:
            return 0
        frame, context, noise = made
        residual, known = frame.residual, None
        if about is not None:
            quiet, known = about(frame, context)
            # the sums are of what is left and what is taken as known together; the noise is of what
            # is left alone
            residual = quiet + known
        if noise is None:
            calm = residual if known is None else residual - known
            reports = flown(context, heading_doubt(frame, context))
            noise = fitted_gains(columns.noise, calm, reports)
        add_reports(out, context, residual, replace(columns, noise=noise), known=known)
        return frame.size

    done = 0
    for size in _in_turn(add, len(view.tails), archive.workers):
        done += size
        if progress is not None:
            progress(done / max(archive.reports, 1))
    return out


def _held(
    archive: Archive, number: int, columns: SumColumns
) -> tuple[Frame, Frame, NoiseFit | None] | None:
    """Reports of an aircraft that are in memory, with their context and noise."""
    index = np.flatnonzero(archive.view.aircraft == number)
    if not index.size:
        return None
    frame, context, fit = archive.view.take(index), archive.context.take(index), columns.noise
    noise = replace(
        fit,
        order=flight_order(frame.flight, frame.time),
        gains=take_gains(fit.gains, index),
        gross=fit.gross[index],
    )
    return frame, context, noise


def _read(archive: Archive, number: int) -> tuple[Frame, Frame, NoiseFit | None] | None:
    """Reports of an aircraft as they are read, with their context; the noise is still to be had."""
    frame = None if archive.part is None else archive.part(number)
    return None if frame is None else (frame, exogenous(frame, archive.winds), None)
