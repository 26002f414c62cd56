"""A deviation that changes linearly in time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Errors, FloatArray, Parameter, Stated, number
from airswing.gap.effects.forms import DEGREE, HeadingEffect, standard_error
from airswing.synthetic.sealed.draws import Draw, Signed
from airswing.units import DAY


class CompassDrift(HeadingEffect):
    """Heading error growing by a rate from an offset at its first report in the archive."""

    name = "compass_drift"
    title = "compass deviation that drifts"
    deviates = True
    draw = Draw(
        Signed("rate_deg_per_day", 0.05),
        ("rate_deg_per_day",),
        dated="late",
        grows=True,
        compared=("rate_deg_per_day",),
        places=("date", "time"),
    )
    physics = (
        "Parts magnetise slowly, a gyro's slaving drifts out of adjustment: the heading error "
        "changes by a little every day."
    )
    source = "NGA Handbook of Magnetic Compass Adjustment (change of deviation with time)."
    parameters = (
        Parameter(
            "rate_deg_per_day",
            "degree/day",
            0.05,
            "change of the error",
            required=True,
            si=DEGREE / DAY,
        ),
        Parameter(
            "offset_deg",
            "degree",
            1.0,
            "error at the archive's first report, or at the start of its period",
            si=DEGREE,
        ),
    )
    kind = "drift"
    needs = ("heading", "time")
    confused_with = (
        "compass_step: where the record is short",
        "compass_offset: where the drift is slow",
    )
    column_names = ("rate", "offset")
    alternatives = ((0,), (0, 1))

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; rad s-1 and rad."""
        return np.array([p.scale * p.si for p in self.parameters])

    def basis(self, frame: Frame) -> FloatArray:
        """Return the time since the archive's first report (s) and one, (2, n)."""
        return np.stack([frame.time - frame.epoch, np.ones(frame.size)])

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`."""
        values: Stated = {
            p.name: float(c) / p.si for p, c in zip(self.parameters, coefficients, strict=True)
        }
        errors = {
            p.name: standard_error(covariance, i) / p.si for i, p in enumerate(self.parameters)
        }
        return values, errors

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        return np.array([number(full[p.name]) * p.si for p in self.parameters])


EFFECT = CompassDrift()
