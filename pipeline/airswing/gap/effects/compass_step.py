"""A deviation that changes at a date."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from airswing.gap.effects.forms import OffsetAndCycle, told
from airswing.synthetic.sealed.draws import Both, Draw


class CompassStep(OffsetAndCycle):
    """Offset and one cycle of heading error that hold within a period only.

    The period belongs to the effect at work, not to its parameters; the columns are those of the
    full record, and whoever looks for dates switches them on and off.
    """

    name = "compass_step"
    title = "compass deviation that changes at a date"
    deviates = True
    draw = Draw(
        Both(),
        ("offset_deg", "amplitude_deg"),
        dated="always",
        compared=("offset_deg", "amplitude_deg", "phase_deg"),
        places=("date", "time"),
        read_from=(("across", "date"),),
    )
    told_apart_by: ClassVar[Mapping[str, str]] = {
        "compass_drift": "a longer record before and after the change",
        "compass_offset": "a longer record before and after the change",
        "hard_iron": "a longer record before and after the change",
    }
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

    def wording(self, values: Mapping[str, Any], errors: Mapping[str, float] | None = None) -> str:
        """See `Effect.wording`."""
        parts = []
        if float(values.get("offset_deg", 0.0)) != 0.0:
            parts.append(f"a constant part of {told(values, errors, 'offset_deg')} degrees")
        if float(values.get("amplitude_deg", 0.0)) != 0.0:
            cycle = f"one cycle of amplitude {told(values, errors, 'amplitude_deg')} degrees"
            parts.append(f"{cycle}, phase {told(values, errors, 'phase_deg')} degrees")
        return "heading error that changes at a date: " + (" and ".join(parts) or "nothing")


EFFECT = CompassStep()
