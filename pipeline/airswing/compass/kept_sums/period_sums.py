"""One aircraft's reports of one period, as the last pass of a robust fit sums them.

Assumptions and validity
------------------------
* A fit of all reports said where (:class:`Base`): its parameters and the scatters that weigh the
  reports. Every period is summed there, in one pass
  (:func:`airswing.compass.fit.normal_equations.accumulate`), so that the sums of all periods
  together are those of one pass over all reports, and the step from there is the fit.
* The step is small: Newton's step with robust weights leaves two or three hundredths of itself
  (:mod:`airswing.compass.fit.aircraft`). Beyond `FARTHEST` standard errors the weights would move,
  and the aircraft is to be fitted anew.
* Weights are those of the base's scatter. Where the errors that are left have grown or shrunk by
  more than `SCATTER` since, the aircraft is to be fitted anew too.
* Flights are of one period each.

Iron's one cycle is told at the mean horizontal field; each period's sums are made at its own and
turned to that of all, which scales the columns of B and C and nothing else.

Radians and m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from airswing.compass.fit.aircraft import (
    ENOUGH,
    AircraftFit,
    bias_of,
    days_of,
    edges_of,
    finish,
    in_order,
    joined,
    local,
    solve,
    spread_of,
)
from airswing.compass.fit.normal_equations import (
    LOCAL,
    PassSums,
    Scatter,
    accumulate,
)
from airswing.compass.fit.report_columns import Columns
from airswing.compass.fit.sandwich import MANY, Array, Index
from airswing.compass.fleet.flight_segments import (
    SLOPES,
    Cut,
    Places,
    blocks_of,
    cut_of,
    duration_of,
    speed_counts,
)

FARTHEST = 1.0
"""Standard errors (clustered) the fit may lie from where the periods were summed. On 48 made
aircraft of 2,900 reports, with and without gross errors, the fit then came 0.03 standard errors
(rms; 0.10 at most) from where it is; from three 0.11 (0.39)."""

SCATTER = 0.1
"""Share by which the rms heading error after the curve may differ from the base's: Tukey's constant
moves by as much, between 4.5 and 5.5. Of the same aircraft a tenth moved the fit by 0.03 standard
errors (rms; 0.11 at most), two tenths by 0.06 (0.23)."""


@dataclass(frozen=True)
class Base:
    """Where the periods of an aircraft are summed."""

    theta: Array  # (p,): a to E, airspeed scale, biases; B and C at ``field``
    free: Index  # which of them are fitted
    scatters: list[Scatter]  # one a member
    field: float  # mean horizontal field, nT; NaN where none is known
    # seconds a block of each member lasts: blocks are cut alike in all periods
    durations: list[int]
    few: bool  # whether flights or days are so few that each needs a normal matrix of its own
    rms: float  # robust rms of the heading error after the curve, radians
    reports: int  # it was fitted to

    @classmethod
    def of(cls, fit: AircraftFit, field: float, reports: int) -> Base:
        """That of a fit of all reports."""
        few = min(fit.flight.shape[0], fit.day_number.size) < MANY
        return cls(
            fit.theta, fit.free, fit.scatters, field, fit.durations, few, fit.rms_after, reports
        )

    def at(self, field: float) -> Array:
        """Its parameters for another mean field."""
        found = self.theta.copy()
        found[1:3] *= _ratio(self.field, field)
        return found


@dataclass(frozen=True)
class PeriodSums:
    """Sums of one aircraft's reports of one period."""

    reports: int  # that count for any member
    field: float  # their mean horizontal field, nT
    points: Index  # (8,): of them nearest to each compass point
    day: Index  # (flights,): days since 1970 on which the flights began
    parts: list[PassSums]  # one a member
    cuts: list[Cut]  # of the blocks of each member; empty without them
    # list of array of int, shape (4,): as of
    # :func:`airswing.compass.fleet.flight_segments.speed_counts`, one a member
    speeds: list[Index]


def sum_period(
    columns: Columns, aircraft: int, members: list[int], base: Base, *, joint: bool, blocks: bool
) -> PeriodSums | None:
    """Sum one aircraft's reports of one period.

    Parameters
    ----------
    columns : Columns
        Of the period, the members in use.
    aircraft : int
        Its row.
    joint : bool
        As for :func:`airswing.compass.fit.aircraft.fit_aircraft`.
    blocks : bool
        Keep the sums of blocks too, which the reference's shared error needs.

    Returns
    -------
    PeriodSums or None
        None where a member has no report that counts.
    """
    sets, day, abscissa, places, field = columns.observations(aircraft, members)
    if not all(reports.size for reports in sets):
        return None
    sets, ordered = in_order(sets, places if blocks else None)
    edges = edges_of(sets, ordered, base.durations)
    theta = base.at(field)
    parts = [
        accumulate(
            reports,
            local(theta, k),
            base.scatters[k],
            day.size,
            joint=joint,
            by_flight=base.few,
            starts=edges[k].start if edges else None,
        )
        for k, reports in enumerate(sets)
    ]
    # whole turns are added so that cutting the fraction off is rounding to the nearest point
    point = (abscissa * (1 / 45.0) + 16.5).astype(np.int8) & 7
    cuts = [cut_of(edge, place) for edge, place in zip(edges, ordered or [], strict=True)]
    points = np.bincount(point, minlength=8).astype(np.int64)
    speeds = [speed_counts(reports.airspeed) for reports in sets]
    return PeriodSums(int(abscissa.size), field, points, np.asarray(day), parts, cuts, speeds)


def mean_field(periods: list[PeriodSums]) -> float:
    """Mean horizontal field over the reports of some periods that count, nT.

    Returns
    -------
    float
        NaN where none is known.
    """
    known = [(one.field, one.reports) for one in periods if np.isfinite(one.field)]
    total = sum(number for _, number in known)
    return sum(field * number for field, number in known) / total if total else np.nan


def durations_of(periods: list[PeriodSums]) -> list[int]:
    """Seconds a block of each member would last, were the aircraft fitted to all reports."""
    members = zip(*(one.speeds for one in periods), strict=True)
    return [duration_of(np.sum(counts, axis=0)) for counts in members]


def merged_fit(
    periods: list[PeriodSums],
    base: Base,
    *,
    farthest: float = FARTHEST,
    scatter: float = SCATTER,
) -> AircraftFit | None:
    """The fit of all reports from the sums of their periods.

    Parameters
    ----------
    periods : list of PeriodSums
        In order of time, all summed at the base.
    farthest, scatter : float
        As `FARTHEST` and `SCATTER`.

    Returns
    -------
    AircraftFit or None
        None where the sums do not tell it: it lies too far from the base, the scatter is another,
        or a period was summed without the normal matrices of its flights.
    """
    field, size = mean_field(periods), base.theta.size
    theta = base.at(field)
    turned = [_turned(one, _ratio(field, one.field)) for one in periods]
    parts = [_added([one[k] for one in turned]) for k in range(len(base.scatters))]
    days = days_of(np.concatenate([one.day for one in periods]))
    by_flight = min(days[1].size, days[0].size) < MANY
    if by_flight and not base.few:
        return None
    normal, score, kappa = joined(parts, size)
    free = base.free
    step = solve(normal[np.ix_(free, free)], score[free]) / kappa
    theta[free] += step
    near = np.abs(step) <= farthest * spread_of(normal, parts, free, kappa) + ENOUGH
    if not (np.isfinite(step).all() and near.all()):
        return None
    move = np.zeros(size)
    move[free] = step
    blocks = []
    for k, part in enumerate(parts):
        if part.block is not None:
            cut = _joined_cuts([one.cuts[k] for one in periods])
            before = (theta - move)[bias_of(k)]
            blocks.append(blocks_of(part.block, part.square, cut, before, move[:SLOPES], kappa))
    found = finish(theta, free, normal, kappa, parts, days, True, by_flight)
    if not abs(np.log(found.rms_after / base.rms)) <= scatter:
        return None
    return replace(found, blocks=blocks, scatters=base.scatters, durations=base.durations)


def _ratio(one: float, other: float) -> float:
    ratio = one / other if other else np.nan
    return float(ratio) if np.isfinite(ratio) else 1.0


def _turned(period: PeriodSums, ratio: float) -> list[PassSums]:
    """Sums of a period with B and C told at another mean field."""
    if ratio == 1.0:
        return period.parts
    scale = np.ones(LOCAL)
    scale[1:3] = ratio
    slopes = np.ones(1 + 2 + 2 * SLOPES)
    # B and C of either component grow with the field; A, D, E and the rest do not
    slopes[[4, 5, 4 + SLOPES, 5 + SLOPES]] = ratio
    square = np.outer(scale, scale)
    return [
        replace(
            part,
            normal=part.normal * square,
            score=part.score * scale,
            flight_score=part.flight_score * scale,
            flight_normal=None if part.flight_normal is None else part.flight_normal * square,
            block=None if part.block is None else part.block * slopes[:, np.newaxis],
        )
        for part in period.parts
    ]


def _added(parts: list[PassSums]) -> PassSums:
    """Sums of one member over all periods."""
    return PassSums(
        normal=np.asarray(sum(part.normal for part in parts)),
        score=np.asarray(sum(part.score for part in parts)),
        flight_score=np.concatenate([part.flight_score for part in parts]),
        flight_normal=_end_to_end([part.flight_normal for part in parts], 0),
        weight=sum(part.weight for part in parts),
        slope=sum(part.slope for part in parts),
        before2=sum(part.before2 for part in parts),
        after2=sum(part.after2 for part in parts),
        square=sum(part.square for part in parts),
        block=_end_to_end([part.block for part in parts], 1),
        scatter=parts[0].scatter,
    )


def _end_to_end(each: list[Array | None], axis: int) -> Array | None:
    """Arrays of all periods in one; None where a period has none."""
    known = [one for one in each if one is not None]
    return np.concatenate(known, axis=axis) if len(known) == len(each) else None


def _joined_cuts(cuts: list[Cut]) -> Cut:
    count, segment, opens = (
        np.concatenate([getattr(cut, name) for cut in cuts])
        for name in ("count", "segment", "opens")
    )
    columns = (
        np.concatenate([getattr(cut.middle, name) for cut in cuts])
        for name in ("latitude", "longitude", "pressure", "time")
    )
    return Cut(count, Places(*columns), segment, opens)
