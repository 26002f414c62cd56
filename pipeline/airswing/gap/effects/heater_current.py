"""Extra deviation while icing protection is on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import FloatArray
from airswing.gap.effects.forms import OffsetAndCycle, told
from airswing.synthetic.sealed.draws import Both, Draw

if TYPE_CHECKING:
    import pandas as pd


def _band(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a band of temperature within what icing protection is used in."""
    low = float(rng.choice([-20.0, -15.0, -10.0]))
    return {"between_degC": [low, low + float(rng.choice([10.0, 15.0]))]}


def _heated(frame: pd.DataFrame, values: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Return the simulated reports with the heater on, by flag or by temperature."""
    if values.get("between_degC") is None:
        return np.asarray(frame["icing"] == 1)
    low, high = values["between_degC"]
    return np.asarray((frame["temperature"] - 273.15).between(low, high, inclusive="left"))


class HeaterCurrent(OffsetAndCycle):
    """Offset and one cycle of heading error where icing = 1; nothing is guessed without a flag."""

    name = "heater_current"
    title = "heading error while icing protection is on"
    draw = Draw(
        Both(),
        ("offset_deg", "amplitude_deg"),
        form=_band,
        acts=_heated,
        compared=("offset_deg", "amplitude_deg", "phase_deg"),
        places=("icing", "temperature"),
        read_from=(("across", "icing"),),
    )
    told_apart_by: ClassVar[Mapping[str, str]] = {
        "compass_offset": "the icing flag, on and off on each heading",
    }
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
