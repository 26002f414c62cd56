"""Two aircraft exchange identifiers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Parameter, Parameters, State
from airswing.gap.effects.forms import MomentEffect
from airswing.synthetic.sealed.draws import Draw


class TailSwap(MomentEffect):
    """From a date on (or within a period) each of a pair reports under the other's name.

    It has no column of its own: what the two aircraft differ in changes hands.
    """

    name = "tail_swap"
    title = "two aircraft exchanged identifiers"
    draw = Draw(scaled=("amplitude_deg",), whose="pair", dated="late")
    physics = (
        "Units are exchanged between aircraft, or an identifier table is filled in wrongly: each "
        "report shows the deviation and airspeed error of the other aircraft."
    )
    source = "Fleet records that change identifiers; no free parameter besides pair and date."
    parameters = (
        Parameter("pair", "", 0.0, "the two aircraft", None, required=True, number=False),
    )
    scope = "pair"
    kind = "swap"
    stage = "identity"
    needs = ("time",)
    confused_with = ("compass_step: of both aircraft at one date, by opposite amounts",)

    def testable(self, frame: Frame) -> str | None:
        """See `Effect.testable`; two aircraft are needed."""
        if np.unique(frame.aircraft).size < 2:
            return "only one aircraft in these reports"
        return super().testable(frame)

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: exchange the airframes behind the two names."""
        pair = values["pair"]
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise InputError("a swap needs two aircraft", field="pair", found=pair)
        for tail in pair:
            frame.aircraft_mask(str(tail))  # refuses an unknown aircraft
        first, second = (frame.tails.index(str(tail)) for tail in pair)
        airframe = state.airframe.copy()
        airframe[state.airframe == first] = second
        airframe[state.airframe == second] = first
        return replace(state, airframe=airframe)


EFFECT = TailSwap()
