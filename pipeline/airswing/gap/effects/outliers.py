"""Gross errors in some reports."""

from __future__ import annotations

from dataclasses import replace

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State, number
from airswing.synthetic.sealed.draws import Draw


class Outliers(MomentEffect):
    """Random isotropic vector errors in a fraction of the reports."""

    name = "outliers"
    title = "gross errors"
    draw = Draw(ladder=tuple({"fraction": share} for share in (0.005, 0.01, 0.02, 0.04)))
    physics = (
        "Transmission errors, wrong digits, winds computed in a manoeuvre: single reports that are "
        "grossly wrong, independent of their neighbours."
    )
    source = "Moninger, Mamrosh & Pauley 2003, Bull. Amer. Meteor. Soc. 84 (quality of ACARS)."
    parameters = (
        Parameter("fraction", "1", 0.02, "share of the reports, 0 to 1", required=True),
        Parameter("size_m_s", "m/s", 20.0, "standard deviation of either component", 20.0),
    )
    confused_with = ("heavy tails of the model error",)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        hit = rng.random(frame.size) < number(values["fraction"])
        error = number(values["size_m_s"]) * rng.standard_normal((2, frame.size)) * hit
        return replace(
            state, report_u=state.report_u + error[0], report_v=state.report_v + error[1]
        )


EFFECT = Outliers()
