"""Bank at a report, from the track between fixes and the roll flags.

A turn lasts about as long as the interval between reports, so the bank of three fixes is
distributed over neighbouring reports and too small at the turn (factor 1.4 to 1.8 in trials). The
roll flag marks the reports at which the aircraft banked by more than five degrees; the share of
flagged reports is the share of time in such a bank, and the total turned angle, which chords
conserve, gives its mean: ``(turned angle - part turned in a lesser bank) / time flagged``.

* flagged: that mean, towards the side the track turns;
* not flagged: the least of the banks at the report and its neighbours where all turn one way (a
  lasting turn), else zero: the turn was flown before or after; never over five degrees;
* no flag in the archive: the bank of the track.

The remaining error is of Berkson's kind (true = estimate + independent; Carroll et al. 2006,
Measurement Error in Nonlinear Models, ch. 1.4), which leaves regressions on the bank unbiased.
Valid for turns of less than half a circle between reports. Radians and seconds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.flags import ROLL
from airswing.physics.atmosphere import GRAVITY
from airswing.physics.triangle import wrap_degrees, wrap_signed
from airswing.units import METRES_PER_DEGREE

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LIMIT = float(np.radians(5.0))
"""Bank at which the roll flag turns bad, rad."""
LARGEST = float(np.radians(25.0))  # Bank of an ordinary turn at most, rad
VISIBLE = float(np.radians(1.0))  # Bank above the noise of three fixes, rad
# Largest turn between two chords for which the arc is taken as circular, rad.
WIDEST = float(np.radians(150.0))
FEWEST = 30
"""Flagged reports below which the track alone is used."""


def bank_at_reports(
    bank: Floats,
    roll_flag: Integers,
    flight: Integers,
    time: Floats,
    *,
    latitude: Floats,
    longitude: Floats,
) -> Floats:
    """Return the bank at each report, (n,) rad; NaN where `bank` is NaN.

    Parameters
    ----------
    bank : (n,) float
        Bank of a coordinated turn through three fixes, rad, right wing down positive; NaN unknown.
    roll_flag, flight, time, latitude, longitude : (n,)
        Codes of `airswing.flags`; number of the flight; s; degrees; in order of flight and time.
    """
    flagged = (roll_flag == ROLL["bad"]) & np.isfinite(bank)
    level = (roll_flag == ROLL["good"]) & np.isfinite(bank)
    if flagged.sum() < FEWEST or not level.any():
        return bank
    lasting = _sustained_bank(bank, flight)
    # half the time from the report before to the one after, s; 0 at a flight's ends
    inside = (flight[2:] == flight[1:-1]) & (flight[1:-1] == flight[:-2])
    interval = np.zeros(time.size)
    interval[1:-1][inside] = 0.5 * (time[2:] - time[:-2])[inside]
    chords = _chord_bank(latitude, longitude, interval)
    seen = np.abs(chords) > VISIBLE
    # the part of the angle that was turned at reports flagged as level
    lesser = np.where(level, np.abs(lasting), 0.0)
    spread = np.where(flagged | (level & seen), np.abs(chords) - lesser, 0.0) * interval
    # no two chords meet at a flight's end: its report gets the part, rad s, of the report on the
    # other side of the turn
    end = interval == 0.0
    first = inside & end[:-2] & flagged[1:-1] & level[2:]
    last = inside & end[2:] & flagged[1:-1] & level[:-2]
    unseen = float(np.sum(spread[2:][first]) + np.sum(spread[:-2][last]))
    duration = np.sum(interval[flagged])
    turned = np.sum(spread) + unseen
    mean = float(np.clip(turned / duration, LIMIT, LARGEST)) if duration > 0 else LIMIT
    side = np.where(seen, np.sign(chords), np.sign(bank))
    return np.where(flagged, side * mean, np.where(level, lasting, bank))


def _chord_bank(latitude: Floats, longitude: Floats, interval: Floats) -> Floats:
    """Bank of the turn between the chords to the fixes before and after; 0 at flights' ends."""
    north = np.diff(latitude)
    middle = np.radians(0.5 * (latitude[1:] + latitude[:-1]))
    east = wrap_degrees(np.diff(longitude)) * np.cos(middle)
    track = np.arctan2(east, north)
    turn = np.zeros(latitude.size)
    turn[1:-1] = wrap_signed(np.diff(track))
    length = METRES_PER_DEGREE * np.hypot(north, east)
    still = np.zeros(latitude.size, bool)  # a chord of no length has no direction
    still[1:-1] = (length[1:] == 0.0) | (length[:-1] == 0.0)
    moving = (interval > 0.0) & ~still
    path = np.zeros(latitude.size)
    path[1:-1] = 0.5 * (length[1:] + length[:-1])
    half = 0.5 * np.minimum(np.abs(turn), WIDEST)
    # An arc over its chord is (x/2) / sin(x/2) for a turn x; numpy's sinc includes pi.
    path /= np.sinc(half / np.pi)
    speed = np.divide(path, interval, out=np.zeros_like(path), where=moving)
    rate = np.divide(turn, interval, out=np.zeros_like(turn), where=moving)
    return np.asarray(np.arctan(speed * rate / GRAVITY))


def _sustained_bank(bank: Floats, flight: Integers) -> Floats:
    """Least bank of a report and its neighbours if all turn one way, at most the flag's limit."""
    # at the ends of a flight the report replaces the missing neighbour
    before, after = bank.copy(), bank.copy()
    linked = flight[1:] == flight[:-1]
    before[1:][linked] = bank[:-1][linked]
    after[:-1][linked] = bank[1:][linked]
    three = np.stack([np.where(np.isfinite(v), v, bank) for v in (before, bank, after)])
    least = np.min(np.abs(three), axis=0)
    one_way = np.abs(np.sign(three).sum(axis=0)) == 3
    # Zero times the bank, so that an unknown bank remains NaN.
    return np.asarray(np.where(one_way, np.sign(bank) * np.minimum(least, LIMIT), 0.0 * bank))
