"""Headings of some aircraft that follow late: filtered, lagging, sampled seldom.

Assumptions: psi_sent = psi + k (m - psi), m the heading with an exponential memory of tau seconds,
dm/dt = (psi - m) / tau. Between two reports the aircraft turns evenly, or at once: whichever fits.
The track tells how it turned, free of what the unit computes. Of right headings the difference
from the one that the reference implies, d, does not go with x = m - psi, so k is the regression of
d on x, and an aircraft whose k lies between 0.3 and 1.5 with eight standard errors over days
follows late. In turns such errors are tens of degrees: single reports that any other look at the
archive would take for gross errors.

Validity: five days of an aircraft and more, turns between them. What is left in turns beside other
reports may be of the same effect: the interval reaches as far. A small lag is a table by what
turned (:mod:`airswing.gap.archive.recent_turns`).

Units: rad, s, m/s.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.archive.recent_turns import turn
from airswing.gap.as_sent.day_regression import regressed
from airswing.gap.as_sent.mended import Mended, days_of, in_aircraft, shortened
from airswing.gap.taken_off.closed_by_table import DRAWS, LASTS
from airswing.physics.triangle import wrap_signed

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Memories that are tried, s.
MEMORIES = (15.0, 30.0, 60.0, 120.0, 240.0)
#: Least and greatest k, in standard errors over days, days of an aircraft.
LEAST, MOST, SIGNIFICANT, LEAST_DAYS = 0.3, 1.5, 8.0, 5
#: What a heading must lag by for a report to tell, rad.
TOLD = np.radians(3.0)
#: Edges of the table by what turned in two minutes, degrees.
EDGES = (-180.0, -90.0, -45.0, -20.0, -5.0, 5.0, 20.0, 45.0, 90.0, 180.0)


def late_heading_of(frame: Frame) -> Mended | None:
    """Find aircraft whose heading follows late, and give them their own."""
    implied = np.arctan2(frame.ground_u - frame.u_ref, frame.ground_v - frame.v_ref)
    off = np.asarray(wrap_signed(frame.heading - implied))
    best: tuple[float, Floats, float, list[int]] | None = None
    for evenly in (True, False):
        for memory in MEMORIES:
            behind = lag(frame, memory, evenly=evenly)
            own, factor, gain = _followers(frame, off, behind)
            if own and (best is None or gain > best[0]):
                best = gain, factor * behind, memory, own
    return None if best is None else _mended(frame, *best[1:])


def lag(frame: Frame, memory: float, *, evenly: bool) -> Floats:
    """What a heading with a memory is behind, (n,) rad; 0 where a flight begins.

    Parameters
    ----------
    memory : float
        s.
    evenly : bool
        Whether the aircraft turns evenly from one report to the next, else at once after the first.
    """
    order = np.lexsort((frame.time, frame.flight))
    track = np.unwrap(np.arctan2(frame.ground_u, frame.ground_v)[order])
    begins = np.r_[True, np.diff(frame.flight[order]) != 0]
    apart = np.where(begins, 0.0, np.diff(frame.time[order], prepend=0.0))
    turned = np.where(begins, 0.0, np.diff(track, prepend=0.0))
    keeps = np.exp(-apart / memory)
    # of what was turned since the report before: all of it decayed alike, or each part by its age
    share = keeps
    if evenly:
        # two reports of one second: the share goes to one, and is not nought by nought
        age = np.maximum(apart / memory, 1e-9)
        share = (1 - keeps) / age
    starts = np.flatnonzero(begins)
    place = np.arange(order.size) - np.repeat(starts, np.diff(np.r_[starts, order.size]))
    behind = np.zeros(order.size)
    by_place = np.argsort(place, kind="stable")
    for rows in np.split(by_place, np.flatnonzero(np.diff(place[by_place])) + 1)[1:]:
        behind[rows] = keeps[rows] * behind[rows - 1] - share[rows] * turned[rows]
    out = np.empty(order.size)
    out[order] = behind
    return out


def _followers(frame: Frame, off: Floats, behind: Floats) -> tuple[list[int], float, float]:
    """Aircraft whose heading goes with a lag, their common factor, and what it explains."""
    told = np.abs(behind) > TOLD
    own = []
    for a in range(len(frame.tails)):
        rows = told & (frame.aircraft == a)
        if days_of(frame, rows) < LEAST_DAYS:
            continue
        value, error = _factor(frame, off, behind, rows)
        if LEAST < value < MOST and value > SIGNIFICANT * error:
            own.append(a)
    if not own:
        return own, 0.0, 0.0
    rows = told & in_aircraft(frame, own)
    value, _ = _factor(frame, off, behind, rows)
    left = np.asarray(wrap_signed(off - value * behind))
    # all reports of these aircraft count: what a memory too long adds elsewhere is against it
    every = in_aircraft(frame, own)
    return own, value, float((np.abs(off) - np.abs(left))[every].sum())


def _factor(frame: Frame, off: Floats, behind: Floats, rows: Mask) -> tuple[float, float]:
    """Regression of a heading's error on its lag, and its standard error over days."""
    value, error = regressed(behind[rows][:, None], off[rows][:, None], frame.day[rows])
    return float(value[0, 0]), float(error[0, 0])


def _mended(frame: Frame, late: Floats, memory: float, own: list[int]) -> Mended | None:
    rows = in_aircraft(frame, own)
    late = np.where(rows, late, 0.0)
    heading = frame.heading - late
    air = frame.airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
    winds = np.stack([frame.ground_u, frame.ground_v], -1) - air
    winds = np.where(rows[:, None], winds, np.stack([frame.u_rep, frame.v_rep], -1))
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    saved = shortened(frame, winds)
    mean = float(saved.mean())
    turning = rows & (np.abs(late) > TOLD)
    left = np.hypot(*(winds - reference).T)
    beyond = float((left[turning] - left[rows & ~turning].mean()).sum()) / frame.size
    if mean <= 0.0:
        return None
    rng = np.random.default_rng(0)
    drawn = mean + max(beyond, 0.0) * rng.uniform(0, 1, DRAWS)
    drawn += LASTS * mean * rng.standard_normal(DRAWS)
    moved = np.hypot(*(winds - np.stack([frame.u_rep, frame.v_rep], -1))[turning].T)
    cell = np.clip(np.searchsorted(EDGES, turn(frame), "right") - 1, 0, len(EDGES) - 2)
    count = np.maximum(np.bincount(cell[rows], minlength=len(EDGES) - 1), 1)
    table = np.degrees(np.bincount(cell[rows], late[rows], len(EDGES) - 1) / count)
    return Mended(
        "heading_angle",
        ("turn",),
        f"heading that follows late, by about {memory:.0f} s",
        tuple(own),
        0.5 * float((moved**2).sum()) / float((left[rows] ** 2).mean()),
        float(np.sqrt((moved**2).mean())),
        without(frame, winds - reference),
        saved,
        drawn,
        tuple(f"{low:.0f} to {high:.0f}" for low, high in pairwise(EDGES)),
        tuple(float(x) for x in table),
        "degree",
        EDGES,
    )
