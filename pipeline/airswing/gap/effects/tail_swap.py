"""Two aircraft exchange identifiers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State
from airswing.synthetic.sealed.draws import Draw


class TailSwap(MomentEffect):
    """Each aircraft of a pair reports under the identifier of the other within a period.

    There are no columns: the errors of the two aircraft are exchanged.
    """

    name = "tail_swap"
    title = "two aircraft exchanged identifiers"
    draw = Draw(scaled=("amplitude_deg",), scope="pair", dated="late")
    physics = (
        "Units are exchanged between aircraft, or an identifier table is filled in wrongly: each "
        "report shows the deviation and airspeed error of the other aircraft."
    )
    source = "Fleet records that change identifiers; no free parameter besides pair and date."
    parameters = (Parameter("pair", "", 0.0, "the two aircraft", None, required=True),)
    scope = "pair"
    kind = "swap"
    stage = "identity"
    needs = ("time",)
    confused_with = ("compass_step: of both aircraft at one date, by opposite amounts",)

    def testable(self, frame: Frame) -> str | None:
        if np.unique(frame.aircraft).size < 2:
            return "only one aircraft in these reports"
        return super().testable(frame)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        pair = values["pair"]
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise InputError("a swap needs two aircraft", field="pair", found=pair)
        for tail in pair:
            frame.aircraft_mask(str(tail))  # raises for an unknown aircraft
        first, second = (frame.tails.index(str(tail)) for tail in pair)
        airframe = state.airframe.copy()
        airframe[state.airframe == first] = second
        airframe[state.airframe == second] = first
        return replace(state, airframe=airframe)


EFFECT = TailSwap()
