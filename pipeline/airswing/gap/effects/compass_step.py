"""Deviation that changes at a date."""

from __future__ import annotations

from airswing.gap.effects.base import OffsetAndCycle
from airswing.synthetic.sealed.draws import Draw, offset_and_cycle


class CompassStep(OffsetAndCycle):
    """Offset and one cycle of heading error within a period.

    The period is that of the `ActiveEffect`; the columns are for all reports, and the search for
    dates restricts them.
    """

    name = "compass_step"
    title = "compass deviation that changes at a date"
    deviates = True
    draw = Draw(offset_and_cycle, ("offset_deg", "amplitude_deg"), dated="always")
    distinguished_by = dict.fromkeys(
        ("compass_drift", "compass_offset", "hard_iron"),
        "a longer record before and after the change",
    )
    physics = (
        "Maintenance, a lightning strike, a replaced flux valve or magnetised cargo changes the "
        "deviation from one day to the next: an offset, one cycle in magnetic heading, or both."
    )
    source = "EASA AMC 25.1327 and FAA AC 43.13-1B (when a compass must be swung again)."
    kind = "step"
    needs = ("magnetic_heading", "time")
    confused_with = (
        "compass_drift: where the record is short or the step small",
        "compass_offset, hard_iron: where the date lies near an end of the record",
        "tail_swap: where the other aircraft changes by the opposite at the same date",
    )


EFFECT = CompassStep()
