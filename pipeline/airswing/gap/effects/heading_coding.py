"""Headings coded more coarsely than documented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import HeadingSteps
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State, number
from airswing.synthetic.sealed.draws import Draw


class HeadingCoding(MomentEffect):
    """Heading rounded to `step_deg` degrees before the wind is computed.

    The error is constant while the aircraft keeps its course, but has no mean over all courses: it
    cannot be removed from a report, and a table over the heading does not resolve the steps.
    """

    name = "heading_coding"
    title = "headings coded more coarsely than stated"
    draw = Draw(ladder=tuple({"step_deg": step} for step in (2.0, 5.0, 10.0, 15.0)))
    physics = (
        "The unit takes its heading from a bus or a display in steps of a few degrees: the wind "
        "errs across the heading by up to half a step of the airspeed, the same along one course."
    )
    source = "ARINC 429, labels 014 and 320 (resolution); WMO No. 958, AMDAR Reference Manual."
    parameters = (
        Parameter("step_deg", "degree", 5.0, "step of the heading", required=True),
        Parameter("true_north", "", 0.0, "true: from true north; null: from magnetic north", None),
    )
    confused_with = ("scatter across the heading: where the step is finer than the noise",)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        # the implied air vector is rotated to the nearest step
        step = np.radians(number(values["step_deg"]))
        north = np.zeros(frame.size) if values["true_north"] else frame.declination
        steps = HeadingSteps(np.full(frame.size, step), north, frame.ground_u, frame.ground_v)
        u, v = steps.apply(state.report_u, state.report_v)
        return replace(state, report_u=u, report_v=v)


EFFECT = HeadingCoding()
