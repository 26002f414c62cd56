"""One pass over the reports: sums from which everything else is computed.

Assumptions: the whitened residual is linear in the columns; a flight belongs to the day on which
it starts, and flights are never split. For all p columns the pass accumulates, per aircraft and
week, G = X'X, and per aircraft and day, b = X'r; for the core columns (day fields, climatology,
catalogue) G is kept per aircraft and day as well, for dates, drifts and clustering. The whitened
residual is winsorised at 5 standard deviations *about a smooth per-aircraft fit*, so that a large
effect is not clipped with the outliers; the count is kept.

Validity: columns are evaluated, and their products summed, in chunks of one aircraft and one week,
in single precision; scores are in double. Reports may be added in parts (:func:`add_reports`).
Memory: 4 p^2 bytes per aircraft-week and 4 c^2 bytes per aircraft-day (c core columns).

Source: docs/gap.md section 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.flight_time import flight_starts
from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.design.layout import Layout, build_columns
from airswing.gap.effects.base import Effect
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.residual_statistics import remove_smooth_effects
from airswing.gap.noise.whitening import flight_order, take_gains, whiten, whiten_blocks
from airswing.units import DAY

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

AIRCRAFT_DAYS = 3_600
"""Aircraft times days of which sums are kept apart. Beyond, "days" are some days together: the sums
of a year of sixty aircraft then take hardly more memory than those of a month."""
AIRCRAFT_WEEKS = 600
"""The same of weeks."""


FEW_DAYS = 3
"""Days under which sums are of parts of days: of fewer none could be left out."""
PART_HOURS = 2.0
"""Hours of such a part: an aircraft's next flight is in another, and a day's business has six."""


class Clock(NamedTuple):
    """How flights are counted by days, or in an archive of a day or two by parts of them."""

    start: float  # hour UTC at which a day starts
    hours: float = 24.0  # length of what is counted as a day

    @property
    def short(self) -> bool:
        """Whether parts of days are counted."""
        return self.hours < 24.0

    def days(self, seconds: Floats) -> Integers:
        """Days (or parts) since 1970 of times in seconds."""
        return np.floor((seconds - self.start * 3600) / (self.hours * 3600)).astype(np.int64)

    def begins(self, days: Integers) -> Floats:
        """Seconds since 1970 at which days (or parts) begin."""
        return np.asarray((days * self.hours + self.start) * 3600)


class Calendar(NamedTuple):
    """Aircraft and days that sums are kept of."""

    aircraft: int  # how many
    days: Integers  # (D,): as `Statistics.days`

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of aircraft and of days."""
        return self.aircraft, self.days.size


class Timed(Protocol):
    """Reports of which the flight and the time are known."""

    @property
    def flight(self) -> Integers:
        """Number of the flight, (n,)."""
        ...

    @property
    def time(self) -> Floats:
        """Seconds since 1970, (n,)."""
        ...


@dataclass(frozen=True)
class Statistics:
    """Sums of the whitened columns and residuals."""

    layout: Layout
    tails: tuple[str, ...]
    # (D,): days since 1970, or parts of days, as ``clock`` counts them; the first of each where
    # several are taken together (`AIRCRAFT_DAYS`)
    days: Integers
    # (W,): week of each entry of ``week_gram``: day // 7 counted from 1970; the first likewise
    weeks: Integers
    week_gram: Floats  # (A, W, p, p): whitened X'X
    day_gram: Floats  # (A, D, c, c): the same for core columns
    day_cross: Floats  # (A, D, q, p): whitened Z'X of the day fields Z
    day_score: Floats  # (A, D, p): whitened X'r
    day_energy: Floats  # (A, D): sum of squares of the whitened residual
    day_count: Floats  # (A, D): reports
    raw_gram: Floats  # (A, c, c): X'X without whitening, for the size of an effect in m s-1
    # (A, c): reports on which a core column is not zero and its effect acts by nature
    # (`airswing.gap.effects.base.Effect.acts`)
    acting: Floats
    clipped: Floats  # (A,): whitened residuals winsorised
    gross: Floats  # (A,): reports left out as gross errors
    clock: Clock  # how days are counted

    @property
    def calendar(self) -> Calendar:
        """Aircraft and days of the sums."""
        return Calendar(len(self.tails), self.days)

    @cached_property
    def whole_gram(self) -> Floats:
        """Whitened X'X of every aircraft over all weeks, (A, p, p)."""
        return np.asarray(self.week_gram.sum(axis=1, dtype=np.float64))

    @cached_property
    def fleet_day_gram(self) -> Floats:
        """Whitened X'X of the core columns by day over all aircraft, (D, c, c)."""
        return np.asarray(self.day_gram.sum(axis=0, dtype=np.float64))

    @cached_property
    def week_of_day(self) -> Integers:
        """Position in ``weeks`` of every day, (D,)."""
        # weeks may be joined (`together`): a day belongs to the last that begins before it
        return np.asarray(np.searchsorted(self.weeks, self.days // 7, side="right") - 1)

    @property
    def calendar_day(self) -> Integers:
        """Whole day since 1970 of every entry of ``days``, (D,)."""
        return np.asarray(self.days * self.clock.hours // 24, np.int64)

    def day_index(self, day: Integers) -> Integers:
        """Position in ``days`` of whole days since 1970, (n,)."""
        return np.asarray(np.searchsorted(self.days, day, side="right") - 1)

    @cached_property
    def day_share(self) -> Floats:
        """Share of each day in its week's reports, per aircraft, (A, D)."""
        own = self.week_of_day[:, None] == np.arange(self.weeks.size)
        total = (self.day_count @ own)[:, self.week_of_day]
        share = np.divide(self.day_count, total, out=np.zeros_like(total), where=total > 0)
        return np.asarray(share)


def day_of_report(frame: Timed, *, clock: Clock | None = None) -> tuple[Integers, Clock]:
    """Day of each report's flight, and how days are counted.

    Parameters
    ----------
    clock : Clock, optional
        When not given days start at the quietest hour, and of an archive of fewer than
        :data:`FEW_DAYS` parts of days are counted.

    Returns
    -------
    day : (n,) int
        Days since 1970 of the flight's first report.
    clock : Clock
    """
    start, inverse = flight_starts(frame.flight, frame.time)
    if clock is None:
        hours = np.bincount((np.mod(start, DAY) // 3600).astype(int), minlength=24)
        # three hours together: a single empty hour of the day's rush is no night
        clock = Clock(float(np.argmin(hours + np.roll(hours, 1) + np.roll(hours, -1))))
        if np.unique(clock.days(start)).size < FEW_DAYS:
            clock = clock._replace(hours=PART_HOURS)
    return clock.days(start)[inverse], clock


def empty_statistics(
    layout: Layout, tails: tuple[str, ...], days: Integers, clock: Clock
) -> Statistics:
    """Sums of no reports.

    Parameters
    ----------
    days : (D,) int
        Whole days since 1970 of all reports to come.
    clock : Clock
    """
    days = together(np.unique(days), len(tails), AIRCRAFT_DAYS)
    weeks = together(np.unique(days // 7), len(tails), AIRCRAFT_WEEKS)
    a, d, p, c = len(tails), days.size, layout.size, layout.core
    q = layout.blocks["day_fields"].stop
    return Statistics(
        layout,
        tails,
        days,
        weeks,
        np.zeros((a, weeks.size, p, p), np.float32),
        np.zeros((a, d, c, c), np.float32),
        np.zeros((a, d, q, p), np.float32),
        np.zeros((a, d, p)),
        np.zeros((a, d)),
        np.zeros((a, d)),
        np.zeros((a, c, c)),
        np.zeros((a, c)),
        np.zeros(a),
        np.zeros(a),
        clock,
    )


def together(numbers: Integers, aircraft: int, most: int) -> Integers:
    """Days or weeks, as many of them taken together as leave no more than `most` of the fleet.

    Parameters
    ----------
    numbers : (d,) int
        Ascending.

    Returns
    -------
    (e,) int
        The first of each that stand together.
    """
    step = 1
    while aircraft * np.unique(numbers // step).size > max(most, aircraft):
        step += 1
    return np.unique(numbers // step) * step


def aircraft_weeks(aircraft: Integers, day: Integers) -> Iterator[Integers]:
    """Yield the reports of one aircraft and week after the other.

    Parameters
    ----------
    aircraft, day : (n,) int

    Yields
    ------
    (m,) int
        Indices, in their own order.
    """
    order = np.lexsort((day, aircraft))
    # one number for both: there are fewer than ten million weeks
    key = aircraft[order] * 10**7 + day[order] // 7
    cuts = np.flatnonzero(np.diff(key)) + 1
    yield from np.split(order, cuts)


@dataclass(frozen=True)
class SumColumns:
    """What sums are made of: noise, layout, effects and the nonparametric basis."""

    noise: NoiseFit
    layout: Layout
    effects: Mapping[str, Effect]
    plan: DictionaryPlan


def accumulate(
    frame: Frame,
    residual: Floats,
    columns: SumColumns,
    *,
    clip: float = 5.0,
    known: Floats | None = None,
    clock: Clock | None = None,
) -> Statistics:
    """Whiten and sum over all reports of an archive.

    Parameters
    ----------
    residual : (n, 2) float
        Reported minus simulated wind, m s-1.
    columns : SumColumns
        Its noise has the gains for these reports.
    clip : float
        Winsorising bound on the whitened residual about the smooth fit.
    known : (n, 2) float, optional
        Part of the residual that effects already found explain: it is never clipped, m/s.
    clock : Clock, optional
        How days are counted; archives to be merged need the same.
    """
    day, clock = day_of_report(frame, clock=clock)
    out = empty_statistics(columns.layout, tuple(frame.tails), np.unique(day), clock)
    add_reports(out, frame, residual, columns, clip=clip, known=known, day=day)
    return out


def add_reports(
    out: Statistics,
    frame: Frame,
    residual: Floats,
    columns: SumColumns,
    *,
    clip: float = 5.0,
    known: Floats | None = None,
    day: Integers | None = None,
) -> None:
    """Add the sums of some reports: whole aircraft that are not in the sums yet, or other weeks.

    Parameters
    ----------
    out : Statistics
        Changed in place.
    frame, residual, columns, clip, known
        As in :func:`accumulate`.
    day : (n,) int, optional
        Day of each report's flight, where it is known already.
    """
    if day is None:
        day, _ = day_of_report(frame, clock=out.clock)
    day, noise = out.days[out.day_index(day)], columns.noise
    values = clipped_residual(frame, residual, noise=noise, clip=clip, known=known)
    own = np.unique(frame.aircraft)  # other aircraft may be added by other threads
    out.clipped[own] += np.bincount(frame.aircraft, values[1])[own]
    out.gross[own] += np.bincount(frame.aircraft, noise.gross)[own]
    for index in aircraft_weeks(frame.aircraft, day):
        _add_chunk(out, frame, index, day, values[0], columns)


def clipped_residual(
    frame: Frame, residual: Floats, *, noise: NoiseFit, clip: float, known: Floats | None = None
) -> tuple[Floats, Floats]:
    """Whitened residual, winsorised about a smooth per-aircraft fit.

    Parameters
    ----------
    residual : (n, 2) float
    known : (n, 2) float, optional
        Part of the residual that is not clipped, m/s.

    Returns
    -------
    whitened : (n, 2) float
    excess : (n,) float
        1 where a component was clipped.
    """
    rest = residual if known is None else residual - known
    smooth = remove_smooth_effects(rest, frame.aircraft, frame.heading, frame.airspeed)
    white_smooth = whiten(smooth, noise.order, noise.gains)
    excess = white_smooth - np.clip(white_smooth, -clip, clip)
    white = whiten(residual, noise.order, noise.gains)
    return white - excess, (excess != 0).any(axis=1).astype(float)


def _add_chunk(
    out: Statistics,
    frame: Frame,
    index: Integers,
    day: Integers,
    values: Floats,
    made_of: SumColumns,
) -> None:
    """Add the sums of one aircraft-week, whose whole flights are ``index``."""
    own = flight_order(frame.flight[index], frame.time[index])
    index = index[own.index]
    gains = take_gains(made_of.noise.gains, index)
    part = frame.take(index)
    columns = build_columns(part, out.layout, made_of.effects, made_of.plan)
    columns[:, :, gains.weight == 0] = 0.0
    aircraft = int(frame.aircraft[index[0]])
    _add_raw(out, aircraft, columns, part, made_of.effects)
    whiten_blocks(columns, own.starts, gains)
    target = np.asarray(values[index].T, np.float32)
    week = int(out.week_of_day[out.day_index(day[index[:1]])[0]])
    total = np.zeros((out.layout.size, out.layout.size))
    q, c = out.layout.blocks["day_fields"].stop, out.layout.core
    bins = np.unique(day[index])
    for one in bins:
        today = np.flatnonzero(day[index] == one)
        d = int(np.searchsorted(out.days, one))
        some = columns if bins.size == 1 else columns.take(today, axis=2)
        x, r = some.reshape(out.layout.size, -1), target[:, today].ravel()
        gram = x @ x.T
        total += gram
        out.day_gram[aircraft, d] += gram[:c, :c]
        out.day_cross[aircraft, d] += gram[:q]
        out.day_score[aircraft, d] += x @ r
        out.day_energy[aircraft, d] += float(r @ r)
        out.day_count[aircraft, d] += float((gains.weight[today] > 0).sum())
    out.week_gram[aircraft, week] += total.astype(np.float32)


def _add_raw(
    out: Statistics,
    aircraft: int,
    columns: NDArray[np.float32],
    part: Frame,
    effects: Mapping[str, Effect],
) -> None:
    """Add the sums of core columns (p, 2, n) as they are; 0 at reports that do not count."""
    core = columns[: out.layout.core]
    flat = core.reshape(core.shape[0], -1)
    out.raw_gram[aircraft] += flat @ flat.T
    there = (core[:, 0] != 0) | (core[:, 1] != 0)
    for name in out.layout.effects:
        where = effects[name].acts(part)
        if where is not None:
            there[out.layout.blocks[name]] &= where
    out.acting[aircraft] += np.count_nonzero(there, axis=1)
