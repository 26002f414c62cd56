"""Winds, speeds or directions that are sent again and again while the aircraft flies on.

Assumptions: a wind sent in degrees and knots is the same in the next report once in fifty times, a
direction or speed alone once in eight, and no oftener the longer it has been so: runs of equal
values thin out by the factor q by which those of three to six are fewer than those of two to five.
A run that chance does not give once in a thousand archives is a value that stuck. What the unit
would have sent errs as the reports about the run do: a first-order autoregression along the flight,
given the report before the run and that after it, of the scale that reports without it show at
their level. A value to which many runs come back is a floor, a bound or a default.

Validity: 25 repeated reports of an aircraft, on three days or more in all. On 72 sealed archives
runs of chance come to 5 winds, 9 directions and 10 speeds; directions in coarse steps to 29, with
q = 0.5. The first report of a run is taken for right.

Units: m/s, s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.ceiling import CHAINS, scale_by_level
from airswing.gap.as_sent.mended import Mended, days_of, in_aircraft, shortened
from airswing.gap.taken_off.closed_by_table import DRAWS, LASTS
from airswing.units import KNOT

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Runs by chance in an archive, at most, and what their length is multiplied by: they thin out more
#: slowly where a leg is flown in an even wind.
CHANCE, LONGER = 1e-3, 1.5
#: Length of a run, and reports of an aircraft in such runs, at least; days of all of them.
LEAST_RUN, LEAST_COUNT, LEAST_DAYS = 8, 25, 3
#: How many lengths of run, from two on, tell how they thin out.
SHORT = 4
#: Share of runs that thin out no faster than this: values come in steps too coarse to tell.
COARSE = 0.5
#: Share of runs at one value from which that is a bound or a default.
SAME = 0.3
#: Share of what repeats singly from which the whole wind is what repeats.
WHOLE = 0.7
#: Minutes for which a value has not changed.
MINUTES = (0.0, 10.0, 30.0, 60.0, 120.0, 1440.0)
#: What may repeat, and what is told of it.
TITLES = {
    "reported_wind": "winds sent again unchanged",
    "reported_direction": "directions sent again unchanged",
    "reported_speed": "speeds sent again unchanged",
}


@dataclass(frozen=True)
class _Runs:
    """Runs of equal values."""

    order: Integers  # (n,): rows by aircraft and time
    start: Integers  # (m,): place in the order
    length: Integers  # (m,)

    @classmethod
    def of(cls, frame: Frame, values: Floats) -> _Runs:
        """Runs of each aircraft, on from flight to flight; ``values`` (n, c)."""
        order = np.lexsort((frame.time, frame.aircraft))
        key = np.column_stack([frame.aircraft[order], values[order]])
        start = np.flatnonzero(np.r_[True, (np.diff(key, axis=0) != 0).any(axis=1)])
        return cls(order, start, np.diff(np.r_[start, order.size]))

    def take(self, keep: Mask) -> _Runs:
        """Some of the runs."""
        return _Runs(self.order, self.start[keep], self.length[keep])

    @property
    def places(self) -> Integers:
        """Places in the order of all reports of the runs but the first of each."""
        if not self.start.size:
            return np.zeros(0, np.int64)
        own = [np.arange(s + 1, s + n) for s, n in zip(self.start, self.length, strict=True)]
        return np.concatenate(own)


def repeated_of(frame: Frame) -> Mended | None:
    """Find values that stuck, and draw the winds that were there.

    Returns
    -------
    Mended or None
        None where runs of equal values are no longer than chance has them.
    """
    direction = np.round(np.degrees(np.arctan2(-frame.u_rep, -frame.v_rep)), 1) % 360.0
    speed = np.round(np.hypot(frame.u_rep, frame.v_rep) / KNOT, 1)
    told = {
        "reported_wind": np.column_stack([direction, speed]),
        "reported_direction": direction[:, None],
        "reported_speed": speed[:, None],
    }
    found = {name: _stuck(frame, values) for name, values in told.items()}
    size = {name: runs.places.size for name, runs in found.items()}
    most = max(size, key=lambda name: size[name])
    which = "reported_wind" if size["reported_wind"] >= WHOLE * size[most] else most
    runs = found[which]
    rows = np.zeros(frame.size, bool)
    rows[runs.order[runs.places]] = True
    if not rows.any() or days_of(frame, rows) < LEAST_DAYS:
        return None
    return _mended(frame, which, runs, rows)


def _stuck(frame: Frame, values: Floats) -> _Runs:
    """Runs longer than chance has them, of aircraft with enough of them."""
    runs = _Runs.of(frame, values)
    owner = frame.aircraft[runs.order[runs.start]]
    keep = np.zeros(runs.start.size, bool)
    for a in range(len(frame.tails)):
        own = owner == a
        two = (runs.length[own] >= 2).sum()
        # of short runs alone: those that stuck are long, and may be as many
        short = [((runs.length[own] >= k) & (runs.length[own] < k + SHORT)).sum() for k in (2, 3)]
        thin = (short[1] + 1) / (short[0] + 2)
        if two == 0 or thin > COARSE:
            continue
        once = np.log(max(two, 2)) / -np.log(thin)
        least = max(LEAST_RUN, 2 + LONGER * (once - np.log(CHANCE) / -np.log(thin)))
        told = values[runs.order[runs.start]]
        long = _changing(own & (runs.length >= least), told)
        if (runs.length[long] - 1).sum() >= LEAST_COUNT:
            # of an aircraft that has it those as well that chance gives once
            keep |= _changing(own & (runs.length > 2 + once), told)
    return runs.take(keep)


def _changing(chosen: Mask, told: Floats) -> Mask:
    """Runs chosen, (m,), but for those at a value to which many come back; their values, (m, c)."""
    _, which, count = np.unique(told[chosen], axis=0, return_inverse=True, return_counts=True)
    out = chosen.copy()
    if count.size:
        often = (count > 1) & (count > SAME * count.sum())
        out[chosen] = ~often[which.ravel()]
    return out


def _mended(frame: Frame, which: str, runs: _Runs, rows: Mask) -> Mended | None:
    """Draw the winds that were there in the runs, and tell what their absence costs."""
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    sent = np.stack([frame.u_rep, frame.v_rep], -1)
    winds = reference + _errors(frame, runs, rows)
    speed, drawn = np.hypot(*sent.T), np.hypot(winds[..., 0], winds[..., 1])
    if which == "reported_direction":
        # of a drawn calm the direction is anybody's: it is not blown up to the speed sent
        winds *= (speed / np.maximum(drawn, 0.1))[..., None]
    elif which == "reported_speed":
        # of a calm sent likewise
        winds = sent * (drawn / np.maximum(speed, 0.1))[..., None]
    winds = np.where(rows[:, None], winds, sent)
    saved = shortened(frame, winds)
    means = saved.mean(axis=1)
    middle = int(np.argmin(np.abs(means - means.mean())))  # of the archives drawn the middlemost
    left = float(np.hypot(*(winds[middle] - reference).T)[rows].sum()) / frame.size
    spread = np.hypot(means.std(ddof=1) * np.sqrt(1 + 1 / CHAINS), LASTS * left)
    if means.mean() < 2 * spread:  # a value that stuck in an even wind is as good as another
        return None
    moved = np.hypot(*(sent - winds[middle]).T)
    tails = tuple(int(a) for a in np.unique(frame.aircraft[rows]))
    # how long it has been so, of each report
    since = np.zeros(frame.size)
    begun = frame.time[runs.order[np.repeat(runs.start, runs.length - 1)]]
    # minutes, as the cells
    since[runs.order[runs.places]] = (frame.time[runs.order[runs.places]] - begun) / 60.0
    cell = np.searchsorted(MINUTES[1:-1], since, "right")
    each = [rows & (cell == k) for k in range(len(MINUTES) - 1)]
    known = [k for k, own in enumerate(each) if own.any()]
    return Mended(
        which,
        ("unchanged",),
        TITLES[which],
        tails,
        float(rows.sum()),
        float(np.sqrt((moved[rows] ** 2).mean())),
        without(frame, winds[middle] - reference),
        saved[middle],
        means.mean() + spread * np.random.default_rng(0).standard_normal(DRAWS),
        tuple(f"{MINUTES[k]:.0f} to {MINUTES[k + 1]:.0f} min" for k in known),
        tuple(float(np.sqrt((moved[each[k]] ** 2).mean())) for k in known),
        "m/s",
    )


def _errors(frame: Frame, runs: _Runs, rows: Mask) -> Floats:
    """Errors of the winds that were there in the runs, beside those about them, (chains, n, 2)."""
    order, residual = runs.order, frame.residual
    own = in_aircraft(frame, [int(a) for a in np.unique(frame.aircraft[rows])])
    calm = ~rows & (own if (own & ~rows).sum() > rows.sum() else True)
    scale = np.stack([scale_by_level(frame, residual[:, c], calm) for c in range(2)], -1)
    white = np.clip(residual / scale, -4, 4)
    near = frame.flight[order][1:] == frame.flight[order][:-1]
    both = near & calm[order][1:] & calm[order][:-1]
    pair = white[order]
    # below one: the next error is drawn with what is left, sqrt(1 - phi^2)
    phi = float(np.clip((pair[1:] * pair[:-1])[both].mean() / (white[calm] ** 2).mean(), 0, 0.98))
    out = np.broadcast_to(residual, (CHAINS, *residual.shape)).copy()
    rng = np.random.default_rng(0)
    for start, length in zip(runs.start, runs.length, strict=True):
        last = start + length
        ends = last < order.size and frame.flight[order[last]] == frame.flight[order[last - 1]]
        step = np.sqrt(1 - phi**2) * rng.standard_normal((CHAINS, length, 2))
        made = np.empty_like(step)
        for c in range(2):
            first = np.full((CHAINS, 1), phi * pair[start, c])
            made[..., c], _ = lfilter([1.0], [1.0, -phi], step[..., c], axis=1, zi=first)
        if ends:  # what the report after the run says of it
            k = np.arange(1, length + 1)
            gain = phi ** (length - k) * (1 - phi ** (2 * k)) / (1 - phi ** (2 * length))
            made += gain[:, None] * (pair[last] - made[:, -1])[:, None]
        here = order[start + 1 : last]
        out[:, here] = made[:, : length - 1] * scale[here]
    return out
