"""Extra deviation while icing protection is on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import FloatArray
from airswing.gap.effects.forms import OffsetAndCycle, told


class HeaterCurrent(OffsetAndCycle):
    """Offset and one cycle of heading error where icing = 1; nothing is guessed without a flag."""

    name = "heater_current"
    physics = (
        "The direct current of electric de-icing makes a magnetic field fixed in the aircraft; the "
        "compass deviates while it flows. Its one cycle grows as 1/H like any hard iron, which "
        "cannot be told within one region; it is stated as it stands there."
    )
    source = "FAA AC 43.13-1B, 12-37 (compass swing with electrical loads on and off)."
    needs = ("icing", "magnetic_heading")
    alternatives = ((0,), (1, 2), (0, 1, 2))
    confused_with = (
        "hard_iron, compass_offset: where icing protection is on most of the time",
        "errors of airspeed in icing: along the heading, so apart where headings vary",
    )

    def condition(self, frame: Frame) -> FloatArray:
        """Return 1 where icing protection is on, 0 where off or unknown."""
        return np.asarray(frame.icing == 1, dtype=np.float64)

    def wording(self, values: Mapping[str, Any], errors: Mapping[str, float] | None = None) -> str:
        """See `Effect.wording`."""
        text = (
            "extra heading error while icing protection is on: "
            f"{told(values, errors, 'offset_deg')} degrees"
        )
        if float(values.get("amplitude_deg", 0.0)) == 0.0:
            return text
        return f"{text} and one cycle of amplitude {told(values, errors, 'amplitude_deg')} degrees"


EFFECT = HeaterCurrent()
