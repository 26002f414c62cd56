"""Magnetic variation of the unit out of date or scaled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import (
    Errors,
    FloatArray,
    Parameter,
    Parameters,
    State,
    Stated,
    number,
)
from airswing.gap.effects.forms import HeadingEffect, known, standard_error
from airswing.gap.effects.secular import (
    declination_change,
    project,
    secular_patterns,
    year_matching,
)
from airswing.synthetic.sealed.draws import Draw, sign


def _table(rng: np.random.Generator) -> dict[str, object]:
    """Draw a table that is scaled or out of date."""
    if rng.uniform() < 0.5:
        return {"factor": float(rng.choice([0.0, 0.5, 1.5])), "mean_deg": sign(rng)}
    return {"epoch_year": float(rng.integers(1960, 1996)), "mean_deg": sign(rng)}


class DeclinationError(HeadingEffect):
    """The unit adds the declination of an old epoch, or a wrong multiple of the right one.

    Three candidates: `years` out of date (the pattern of ten years' secular variation), the same
    with the `bend` of older tables, and `factor` minus one times the declination. ``mean_deg`` is
    the mean error that results; given alone it scales the secular pattern.
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
    distinguished_by: ClassVar[Mapping[str, str]] = {
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
    column_names = ("years", "factor", "bend")
    alternatives = ((0,), (1,), (0, 2))

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; years, 1, years."""
        return np.array([10.0, 0.3, 10.0])

    def basis(self, frame: Frame) -> FloatArray:
        """Return rad per year out of date, per unit of factor and per year of bend, (3, n)."""
        near, bend = secular_patterns(frame)
        return np.stack([near, frame.declination, bend])

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: a table of an old epoch is evaluated as such."""
        if values["epoch_year"] is None:
            return super().apply(state, frame, values, rng)
        error = known(declination_change(frame, epoch_year=number(values["epoch_year"])))
        return replace(state, heading_error=state.heading_error + error)

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`; of the age or of the factor, whichever is larger."""
        aged, factor = np.array([coefficients[0], coefficients[2]]), float(coefficients[1])
        old = abs(aged[0] / self.column_scales[0]) >= abs(factor / self.column_scales[1])
        used = [0, 2] if old else [1]
        per_unit = known(self.basis(frame)[used]).mean(axis=1)
        mean_error = float(np.sqrt(per_unit @ covariance[np.ix_(used, used)] @ per_unit))
        values: Stated = {"epoch_year": None, "factor": None}
        values["mean_deg"] = float(np.degrees(coefficients[used] @ per_unit))
        errors = {"mean_deg": float(np.degrees(mean_error))}
        if old:
            values["epoch_year"] = year_matching(frame, aged)
            return values, errors | {"epoch_year": standard_error(covariance, 0)}
        values["factor"] = 1.0 + factor
        return values, errors | {"factor": standard_error(covariance, 1)}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        if full["epoch_year"] is not None:
            years, bend = project(frame, number(full["epoch_year"]))
            return np.array([years, 0.0, bend])
        if full["factor"] is not None:
            return np.array([0.0, number(full["factor"]) - 1.0, 0.0])
        mean = float(np.mean(known(self.basis(frame)[0])))
        wanted = np.radians(number(full["mean_deg"] or 0.0))
        return np.array([wanted / mean if mean != 0.0 else 0.0, 0.0, 0.0])


EFFECT = DeclinationError()
