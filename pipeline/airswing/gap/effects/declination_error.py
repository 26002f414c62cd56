"""Magnetic variation of the unit out of date or scaled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Errors, FloatArray, Parameter, Parameters, State
from airswing.gap.effects.forms import HeadingEffect, known, standard_error, told
from airswing.gap.effects.secular import declination_change, project, year_matching
from airswing.synthetic.sealed.draws import Draw, sign


def _table(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a table that is scaled or out of date."""
    if rng.uniform() < 0.5:
        return {"factor": float(rng.choice([0.0, 0.5, 1.5])), "mean_deg": sign(rng)}
    return {"epoch_year": float(rng.integers(1960, 1996)), "mean_deg": sign(rng)}


class DeclinationError(HeadingEffect):
    """The unit adds the declination of an old epoch, or a wrong multiple of the right one.

    Two candidates: `years` out of date (the pattern of ten years' secular variation) and
    `factor` minus one times the declination. ``mean_deg`` is the mean error that results; given
    alone it scales the secular pattern.
    """

    name = "declination_error"
    title = "wrong magnetic variation"
    draw = Draw(
        _table,
        ("mean_deg",),
        whose="fleet",
        compared=("mean_deg",),
        read_from=(("across", "longitude"),),
    )
    told_apart_by: ClassVar[Mapping[str, str]] = {
        "compass_offset": "flights over a larger region, where the declination varies",
    }
    physics = (
        "The unit turns magnetic into true heading by a stored table of the magnetic variation. "
        "An old table is wrong by the secular variation since, a pattern over the region that is "
        "the same for every aircraft."
    )
    source = "IGRF-14, Alken et al. 2021, Earth Planets Space 73:49; RTCA DO-236C (MAGVAR tables)."
    parameters = (
        Parameter("epoch_year", "year", 10.0, "epoch of the table in use", None),
        Parameter("factor", "1", 0.3, "declination in use over the right one", None),
        Parameter("mean_deg", "degree", 1.0, "mean heading error that results", None),
    )
    scope = "fleet"
    needs = ("heading", "declination")
    confused_with = ("compass_offset: of the whole fleet, where the region is small",)
    column_names = ("years", "factor")
    alternatives = ((0,), (1,))

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; years, 1."""
        return np.array([10.0, 0.3])

    def basis(self, frame: Frame) -> FloatArray:
        """Return rad per year out of date and rad per unit of factor, (2, n)."""
        return np.stack([declination_change(frame, years=10.0) / 10.0, frame.declination])

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: a table of an old epoch is evaluated as such."""
        if values["epoch_year"] is None:
            return super().apply(state, frame, values, rng)
        error = known(declination_change(frame, epoch_year=float(values["epoch_year"])))
        return replace(state, heading_error=state.heading_error + error)

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Parameters, Errors]:
        """See `Effect.to_parameters`; of the candidate with the larger coefficient."""
        k = int(np.argmax(np.abs(coefficients / self.column_scales)))
        error, per_unit = standard_error(covariance, k), np.mean(known(self.basis(frame)[k]))
        values: Parameters = {"epoch_year": None, "factor": None}
        values["mean_deg"] = float(np.degrees(coefficients[k] * per_unit))
        errors = {"mean_deg": float(np.degrees(error * abs(per_unit)))}
        if k == 0:
            values["epoch_year"] = year_matching(frame, float(coefficients[0]))
            return values, errors | {"epoch_year": error}
        values["factor"] = 1.0 + float(coefficients[1])
        return values, errors | {"factor": error}

    def from_parameters(self, values: Mapping[str, Any], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        if full["epoch_year"] is not None:
            return np.array([project(frame, float(full["epoch_year"])), 0.0])
        if full["factor"] is not None:
            return np.array([0.0, float(full["factor"]) - 1.0])
        mean = float(np.mean(known(self.basis(frame)[0])))
        wanted = np.radians(float(full["mean_deg"] or 0.0))
        return np.array([wanted / mean if mean != 0.0 else 0.0, 0.0])

    def wording(self, values: Mapping[str, Any], errors: Mapping[str, float] | None = None) -> str:
        """See `Effect.wording`."""
        mean = ""
        if values.get("mean_deg") is not None:
            mean = f", a mean heading error of {told(values, errors, 'mean_deg')} degrees"
        if values.get("factor") is not None:
            factor = told(values, errors, "factor")
            return f"magnetic variation in use is {factor} times the right one{mean}"
        if values.get("epoch_year") is not None:
            return f"magnetic variation in use dates from {float(values['epoch_year']):.0f}{mean}"
        return f"magnetic variation in use is out of date{mean}"


EFFECT = DeclinationError()
