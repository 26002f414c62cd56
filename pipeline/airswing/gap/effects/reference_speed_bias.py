"""Model wind too strong or too weak at all levels, or above or below a level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects.base import (
    Effect,
    Estimate,
    Parameter,
    Parameters,
    Random,
    State,
    Stated,
    number,
    standard_error,
)
from airswing.synthetic.sealed.draws import Draw, sign

LEVELS = tuple(float(level) for level in range(875, 200, -50))
"""Candidate limits of a bias, hPa: midway between model levels every 50 hPa."""


def _draw_above(rng: np.random.Generator) -> dict[str, object]:
    # at all levels or above one
    above = None if rng.uniform() < 0.5 else float(rng.choice([500.0, 600.0, 700.0]))
    return {"bias_percent": 5.0 * sign(rng), "above_hPa": above}


def _draw_below(rng: np.random.Generator) -> dict[str, object]:
    return {"above_hPa": None, "below_hPa": float(rng.choice([600.0, 700.0, 800.0]))}


def _at_levels(frame: pd.DataFrame | Frame, values: Mapping[str, object]) -> Booleans:
    above, below = values.get("above_hPa"), values.get("below_hPa")
    pressure = np.asarray(frame.pressure)
    low = np.inf if above is None else 100.0 * number(above)
    high = -np.inf if below is None else 100.0 * number(below)
    return np.asarray((pressure < low) & (pressure >= high))


class ReferenceSpeedBias(Effect):
    """Reference wind is (1 + bias) times the wind met, at all levels or above or below a level."""

    name = "reference_speed_bias"
    title = "model wind too weak or too strong"
    draw = Draw(_draw_above, ("bias_percent",), scope="fleet", form=_draw_below, acts=_at_levels)
    physics = (
        "A model with too little or too much momentum shows winds too weak or too strong, often "
        "above a level only (jet too weak for lack of resolution): along the wind, not the heading."
    )
    source = "Benjamin et al. 1999, Wea. Forecasting 14 (ACARS against RUC winds by level)."
    parameters = (
        Parameter("bias_percent", "percent", 5.0, "positive: model too strong", required=True),
        Parameter("above_hPa", "hPa", 0.0, "at lower pressures only; null: everywhere", None),
        Parameter("below_hPa", "hPa", 0.0, "at higher pressures only; null: everywhere", None),
    )
    scope = "reference"
    stage = "atmosphere"
    confused_with = (
        "regression dilution: model error makes reports seem 1 to 8 percent weaker",
        "tas_scale: where aircraft always fly along the wind",
    )
    # at all levels, above each, below each
    column_scales = np.full(1 + 2 * len(LEVELS), 0.05)
    alternatives = tuple((k,) for k in range(1 + 2 * len(LEVELS)))

    def columns(self, frame: Frame) -> Floats:
        return self._columns(frame, 1e-9)

    def softened_columns(self, frame: Frame) -> Floats:
        # between a level with the bias and one without, 50 hPa apart, the bias changes linearly
        return self._columns(frame, 25.0)

    def _columns(self, frame: Frame, half: float) -> Floats:
        distance = np.array(LEVELS)[:, None] - frame.pressure / 100.0
        above = np.clip(0.5 + 0.5 * distance / half, 0.0, 1.0)
        shares = np.concatenate([np.ones((1, frame.size)), above, 1.0 - above])
        return np.stack([-shares * frame.u_ref, -shares * frame.v_ref], axis=-1)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        bias = number(values["bias_percent"])
        if bias <= -100.0:
            raise InputError(
                "a model wind cannot be weaker than none",
                field="bias_percent",
                found=bias,
                remedy="give a bias above -100 percent",
            )
        factor = np.where(_at_levels(frame, values), 1.0 / (1.0 + bias / 100.0), 1.0)
        return replace(state, wind_u=state.wind_u * factor, wind_v=state.wind_v * factor)

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # of the candidate with the largest coefficient c, the relative deficit of the reports
        k = int(np.argmax(np.abs(coefficients)))
        ratio = 1.0 - float(coefficients[k])
        values: Stated = {"bias_percent": 100.0 * (1.0 / ratio - 1.0)}
        above, place = divmod(k - 1, len(LEVELS))
        values["above_hPa"] = LEVELS[place] if above == 0 else None
        values["below_hPa"] = LEVELS[place] if above == 1 else None
        return values, {"bias_percent": 100.0 * standard_error(covariance, k) / ratio**2}


EFFECT = ReferenceSpeedBias()
