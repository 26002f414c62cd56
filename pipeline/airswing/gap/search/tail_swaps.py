"""Two aircraft that exchange identifiers at a date.

Assumptions: every airframe has its own steady deviation (offset, one and two cycles) and airspeed
factor. Under a swap of a and b at a date, a's reports before it and b's after it share one set of
coefficients, and the other way round: as many coefficients as without a swap, so the evidence needs
no penalty beyond the number of pairs and dates. The alternatives are steady coefficients, or ones
that change at a date in each aircraft by itself.

Validity: aircraft that do not differ cannot be told apart. Core columns only; the climatology is
taken off at its fitted value.

Source: docs/gap.md sections 4 and 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.flight_time import flight_starts
from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.changepoint import own_day_grams
from airswing.gap.evidence.gaussian import gaussian_evidence
from airswing.gap.evidence.terms import Term
from airswing.gap.sums.cluster_inflation import aircraft_factor
from airswing.gap.sums.day_scores import residual_scores
from airswing.gap.sums.elimination import Base, Conditional

Floats = NDArray[np.float64]

#: Effects whose coefficients mark an airframe.
MARKS = ("compass_offset", "hard_iron", "soft_iron", "tas_scale")
#: Smallest evidence of an exchange, nats, and the share of the strongest nameless term's by which
#: it rises: unexplained structure makes exchanges of aircraft that share it unequally.
NEEDED, NEEDED_SHARE = 6.0, 0.05
#: Fewest days on either side of an exchange.
SHORTEST = 3
#: Prior probability of a change in one aircraft.
CHANGE = 0.1


@dataclass(frozen=True)
class Swap:
    """A swap found."""

    pair: tuple[int, int]  # aircraft
    day: int  # index of the first day under the other's name
    evidence: float  # log evidence over the alternatives, pairs and dates averaged, nats
    gain: float  # of the best pair and date


def beside(terms: Sequence[Term]) -> tuple[list[Term], float]:
    """Terms an exchange is looked for beside, and the evidence it then needs.

    What marks an airframe, and what changes in time, is what an exchange shows in; all else that
    was found is taken off first.

    Returns
    -------
    terms : list of Term
    threshold : float
        nats.
    """
    kept = [
        term
        for term in terms
        if term.period is None
        and ":date" not in term.candidate.name
        and term.candidate.kind != "drift"
        and term.candidate.name not in MARKS
    ]
    nameless = [term.score.tempered for term in terms if not term.candidate.known]
    return kept, NEEDED + NEEDED_SHARE * max(nameless, default=0.0)


def find_swap(
    base: Base,
    given: Conditional,
    effects: Mapping[str, Effect],
    *,
    threshold: float = NEEDED,
) -> Swap | None:
    """Look for one pair that exchanged identifiers.

    Parameters
    ----------
    given : Conditional
        Given the climatology and what :func:`beside` says.
    threshold : float
        Smallest evidence, nats.
    """
    layout = base.stats.layout
    names = [n for n in MARKS if n in layout.blocks]
    days, aircraft = base.stats.days.size, len(base.stats.tails)
    if not names or aircraft < 2 or days < 2 * SHORTEST:
        return None
    columns = np.concatenate([layout.columns(n) for n in names])
    factor = aircraft_factor(base.stats, given, columns)
    prior = 0.5 * np.concatenate([np.asarray(effects[n].column_scales, float) for n in names])
    cuts = np.arange(SHORTEST, days - SHORTEST + 1)
    scores = residual_scores(given, columns)
    # running sums of every aircraft, from none to all days
    gram = np.zeros((aircraft, days + 1, prior.size, prior.size))
    score = np.zeros((aircraft, days + 1, prior.size))
    for a in range(aircraft):
        np.cumsum(own_day_grams(base, a, columns), axis=0, out=gram[a, 1:])
        np.cumsum(scores[a], axis=0, out=score[a, 1:])
    before = gram[:, cuts], score[:, cuts]
    after = gram[:, -1:] - before[0], score[:, -1:] - before[1]
    own = [
        _own_evidence((before[0][a], before[1][a]), (after[0][a], after[1][a]), prior, factor)
        for a in range(aircraft)
    ]
    best, values = None, []
    for a in range(aircraft - 1):
        rest = slice(a + 1, aircraft)
        pair = ((before, after), (after, before))
        crossed = [
            _evidence(x[0][a] + y[0][rest], x[1][a] + y[1][rest], prior, factor) for x, y in pair
        ]
        gain = crossed[0] + crossed[1] - own[a] - np.array(own[rest])[:, None]
        values.append(gain.ravel())
        b, top = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if best is None or gain[b, top] > best[2]:
            best = ((a, a + 1 + int(b)), int(cuts[top]), float(gain[b, top]))
    whole = np.concatenate(values)
    evidence = float(np.logaddexp.reduce(whole) - np.log(whole.size))
    if best is None or evidence < threshold:
        return None
    return Swap(best[0], best[1], evidence, best[2])


def _evidence(information: Floats, score: Floats, prior: Floats, factor: float) -> Floats:
    k = prior.size
    nothing = np.zeros((k, k))
    return gaussian_evidence(information, score, factor=factor, allowance=nothing, prior=prior)[0]


def _own_evidence(
    before: tuple[Floats, Floats], after: tuple[Floats, Floats], prior: Floats, factor: float
) -> float:
    """Evidence of an aircraft by itself: steady, or changed once."""
    whole = before[0][:1] + after[0][:1], before[1][:1] + after[1][:1]
    steady = float(_evidence(*whole, prior, factor)[0])
    changed = _evidence(*before, prior, factor) + _evidence(*after, prior, factor)
    once = float(np.logaddexp.reduce(changed)) - np.log(changed.size)
    return float(np.logaddexp(np.log1p(-CHANGE) + steady, np.log(CHANGE) + once))


def exchange(frame: Frame, swap: Swap, first_time: float) -> Frame:
    """Frame with the pair's reports given back to their airframes from a time on.

    Parameters
    ----------
    first_time : float
        s since 1970.

    Returns
    -------
    Frame
        In the same order of rows.
    """
    a, b = swap.pair
    start, which = flight_starts(frame.flight, frame.time)
    late = start[which] >= first_time
    aircraft = frame.aircraft.copy()
    aircraft[(frame.aircraft == a) & late] = b
    aircraft[(frame.aircraft == b) & late] = a
    return replace(frame, aircraft=aircraft)
