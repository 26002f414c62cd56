"""Residuals of archives in which nothing is left to be found: the witness's null.

Assumptions: the error of the reference is noise along flights of the size and reach the archive
shows, day fields and a climatology of their estimated sizes, each drawn anew. Columns that stand on
the path alone meet these residuals as they meet the real one.

Validity: that of the noise model.

Units: m/s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.design.weather import climatology_columns, day_field_columns
from airswing.gap.noise.model import NoiseFit
from airswing.gap.simulation.forward import draw_noise
from airswing.gap.sums.variance_components import Variances

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def drawn_errors(
    frame: Any,
    number: int,
    *,
    noise: NoiseFit,
    plan: DictionaryPlan,
    variances: Variances,
    day: Integers,
    rng: np.random.Generator,
) -> Floats:
    """Draw errors of the reference along an archive's paths.

    Parameters
    ----------
    frame : Frame
    number : int
    noise : NoiseFit
    plan : DictionaryPlan
    variances : Variances
    day : (n,) int
    rng : numpy.random.Generator

    Returns
    -------
    (number, n, 2) float
        Reported minus reference wind, m/s.
    """
    fields, steady = day_field_columns(frame, plan), climatology_columns(frame, plan)
    out = np.empty((number, frame.size, 2))
    for k in range(number):
        daily = rng.standard_normal((int(day.max()) + 1, fields.shape[-1])) * np.sqrt(variances.day)
        lasting = rng.standard_normal(steady.shape[-1]) * np.sqrt(variances.climatology)
        out[k] = draw_noise(frame, noise.model, rng=rng) + steady @ lasting
        out[k] += np.einsum("nck,nk->nc", fields, daily[day])
    return out
