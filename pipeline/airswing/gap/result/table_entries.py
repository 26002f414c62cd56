"""An unknown that has a table, as gap.json tells it: place, curve, interval, what would settle it.

Assumptions: the draws of what a table closes hold all that is open about it
(:mod:`airswing.gap.taken_off`).

Units: m/s inside, kt in entries.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airswing.gap.archive.reported_variables import UNITS
from airswing.gap.archive.value_tables import UNIT_OF
from airswing.gap.as_sent.mended import Mended
from airswing.gap.evidence.gaussian import plain_probability
from airswing.gap.result.schema import ClosesEntry, CurveEntry, PlaceEntry
from airswing.gap.search.belief import outside_catalogue
from airswing.gap.taken_off.unknown_taken import Taken
from airswing.gap.witness.fitted_tables import Unknown
from airswing.units import KNOT

#: Quantiles between which what unknowns close lies in 95 of 100 draws.
LIMITS = (0.025, 0.975)


def interval(taken: Sequence[Taken | Mended]) -> tuple[float, float]:
    """95 % interval of what unknowns close together, kt; what is stated lies in it."""
    drawn = np.sum([one.drawn for one in taken], axis=0) / KNOT
    stated = sum(float(one.saved.mean()) for one in taken) / KNOT
    low, high = np.quantile(drawn, LIMITS)
    # kt: as printed, with two decimals, what is stated lies inside
    return min(float(low), stated) - 0.01, max(float(high), stated) + 0.01


def entry(taken: Taken, tails: Sequence[str]) -> PlaceEntry:
    """One of ``unknown.where`` of gap.json."""
    unknown = taken.unknown
    whole = len(unknown.tails) == len(tails)
    own = list(unknown.tails)
    names = list(unknown.grid.variables)
    reduction = float(taken.saved.mean()) / KNOT
    return PlaceEntry(
        component=unknown.component,
        variable=names[0],
        variables=names,
        group=f"{unknown.component}:{' x '.join(names)}",
        tails=[] if whole else [tails[a] for a in own],
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(unknown.evidence, 2),
        size_m_s=unknown.size,
        curve=_curve(unknown, tails),
        equally_good=[
            f"{c} by {' x '.join(v)}"
            for n, c, v in unknown.rivals[1:]
            # within a fifth of its evidence another table tells as much: the variables go together
            if n > 0.8 * unknown.evidence
        ],
        closure=ClosesEntry(reduction, list(interval([taken]))),
        held_out_energy=2 * unknown.held_out,
        held_out_energy_standard_error=2 * unknown.held_out_error,
        probability=plain_probability(unknown.evidence) * outside_catalogue(taken.share),
        largest_m_s=unknown.peak,
        nearest_effect=taken.nearest,
        nearest_effect_share=taken.share,
        settled_by=settled_by(names),
    )


def _curve(unknown: Unknown, tails: Sequence[str]) -> CurveEntry:
    """The table of an unknown: its mean over aircraft, and each one's where they differ."""
    own = list(unknown.tails)
    middle = [float(x) for x in unknown.values[own].mean(axis=0)]
    names = list(unknown.grid.variables)
    each = None
    if not unknown.shared:
        each = {tails[a]: [float(x) for x in unknown.values[a]] for a in own}
    return CurveEntry(
        labels=unknown.grid.labels,
        m_s=middle,
        unit=UNIT_OF[unknown.component],
        variables=names,
        variable_units=[UNITS[name] for name in names],
        edges=[[float(x) for x in axis.edges] for axis in unknown.grid.axes],
        values=middle,
        per_tail=each,
    )


def settled_by(names: Sequence[str]) -> str:
    """What measurement would settle what an unknown is."""
    told = {
        "magnetic_heading": "a compass swing of one of these aircraft on the ground and in flight",
        "track": "the unit's raw heading and track beside each other on flights both ways",
        "wind_direction": "the raw air and ground vectors beside the wind computed of them",
        "wind_speed": "the raw air and ground vectors beside the wind computed of them",
        "temperature": "a recorder of the unit's raw sensors through these temperatures",
        "icing": "flights with de-icing switched on and off in clear air on every heading",
        "ground_speed": "these legs flown both ways beside another aircraft",
        "drift": "the unit's raw heading and track beside each other on flights both ways",
        "airspeed": "a run at several airspeeds beside a trailing cone or a second air data unit",
        "altitude": "levels flown both ways beside another aircraft or a radiosonde",
        "hour": "the unit's clock and its data link beside a GPS clock over a day",
        "phase": "the unit's raw sensors through a climb, a cruise and a descent",
        "acceleration": "a recorder of raw heading through speed changes on several headings",
        "turn": "a recorder of raw heading through turns and for minutes after them",
        "last_turn": "the raw heading on one course, turned into from either side",
        "flight_time": "the unit's raw sensors through an hour of level flight on one course",
        "bank": "a recorder of raw heading through steady turns both ways",
    }
    found = [told[name] for name in names if name in told]
    return found[0] if found else "another unit on the same routes, or these units on other routes"
