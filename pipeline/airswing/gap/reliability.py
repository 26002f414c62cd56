"""How far the reference's gradients are the true ones, so that lags and offsets keep their size.

Assumptions: a lag, a time offset or an altitude offset shows as a multiple of a *gradient* of the
wind. The reference's gradients hold its error's gradients too, and a regression on them is too flat
(0.7 in trials for a lag of a minute). The reported winds along the flight have the true gradient,
with noise that is independent of the reference's: their regression on the column is the factor by
which a coefficient must be divided. It corrects parameters only; what closes the gap best is the
coefficient as fitted.

Validity: factors are kept between 0.2 and 1.2; 1 where fewer than 500 reports have neighbours.

Source: instrumental variables; attenuation of regression (Fuller 1987, section 1.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.noise import NoiseFit
from airswing.gap.whitening import whiten

Floats = NDArray[np.float64]


def path_derivative(values: Floats, scale: Floats, flight: NDArray[np.integer]) -> Floats:
    """Central difference of values along flights by a coordinate, NaN at the ends.

    Parameters
    ----------
    values : (n, 2) float
        In order of flight and time.
    scale : (n,) float
        The coordinate: time (s) or ln p.
    flight : (n,) int

    Returns
    -------
    (n, 2) float
    """
    out = np.full(values.shape, np.nan)
    step = scale[2:] - scale[:-2]
    inside = (flight[2:] == flight[:-2]) & (np.abs(step) > 1e-3)
    out[1:-1][inside] = (values[2:] - values[:-2])[inside] / step[inside, None]
    return out


def reliability(
    frame: Any, columns_frame: Any, noise: NoiseFit, effects: Mapping[str, Any]
) -> dict[str, float]:
    """Factors of the gradient effects.

    Parameters
    ----------
    frame : Frame
        Reports as they are, in order of flight and time within an aircraft.
    columns_frame : Frame
        The frame of the design columns.
    noise : NoiseFit
    effects : mapping

    Returns
    -------
    dict
        Effect name -> factor.
    """
    order = np.lexsort((frame.time, frame.flight))
    reported = np.stack([frame.u_rep, frame.v_rep], -1)[order]
    flight = frame.flight[order]
    along = np.empty_like(reported)
    along[order] = path_derivative(reported, frame.time[order], flight)
    vertical = np.empty_like(reported)
    vertical[order] = path_derivative(reported, np.log(frame.pressure)[order], flight)
    level = np.abs(frame.climb_rate) < 0.5
    vertical[np.abs(frame.climb_rate) < 1.5] = np.nan
    out: dict[str, float] = {}
    if "time_lag" in effects:
        column = -np.asarray(effects["time_lag"].columns(columns_frame))[0]
        out["time_lag"] = _slope(along, column, noise, np.ones(frame.size, bool))
    if "altitude_offset" in effects:
        shear = np.stack([columns_frame.dudlnp, columns_frame.dvdlnp], -1)
        out["altitude_offset"] = _slope(vertical, shear, noise, np.ones(frame.size, bool))
    if "reference_time_offset" in effects:
        advection = np.stack(
            [
                frame.dudt + frame.ground_u * frame.dudx + frame.ground_v * frame.dudy,
                frame.dvdt + frame.ground_u * frame.dvdx + frame.ground_v * frame.dvdy,
            ],
            -1,
        )
        out["reference_time_offset"] = _slope(along, advection, noise, level)
    return out


def _slope(truth: Floats, column: Floats, noise: NoiseFit, where: NDArray[np.bool_]) -> float:
    """Regression of the reported gradient on the reference's, whitened along flights."""
    good = where & np.isfinite(truth).all(axis=1) & np.isfinite(column).all(axis=1)
    if good.sum() < 500:
        return 1.0
    bound = 6 * np.median(np.abs(truth[good])) + 1e-12
    good &= (np.abs(truth) < bound).all(axis=1)
    x = whiten(np.where(good[:, None], column, 0.0), noise.order, noise.gains)
    y = whiten(np.where(good[:, None], truth, 0.0), noise.order, noise.gains)
    energy = float((x * x).sum())
    return float(np.clip((x * y).sum() / energy, 0.2, 1.2)) if energy > 0 else 1.0
