"""How far the reference's gradients are the true ones, so that a lag keeps its size.

Assumptions: a lag shows as a multiple of the *gradient* of the wind along the path. The reference's
gradients hold its error's gradients too, and a regression on them is too flat. The reported winds
along the flight have the true gradient, with noise that is independent of the reference's: their
regression on the column is the factor by which a coefficient must be divided.

Validity: factors are kept between 0.2 and 1.2; 1 where fewer than 500 reports have neighbours.

Source: instrumental variables; attenuation of regression (Fuller 1987, section 1.1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Effect
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import whiten

Floats = NDArray[np.float64]


def path_derivative(values: Floats, scale: Floats, flight: NDArray[np.integer]) -> Floats:
    """Central difference of values along flights by a coordinate, NaN at the ends; shape (n, 2).

    Parameters
    ----------
    values : (n, 2) float
        In order of flight and time.
    scale : (n,) float
        The coordinate: time (s) or ln p.
    flight : (n,) int
    """
    out = np.full(values.shape, np.nan)
    step = scale[2:] - scale[:-2]
    # level flight has no step in ln p: its gradient would be any number
    inside = (flight[2:] == flight[:-2]) & (np.abs(step) > 1e-3)
    out[1:-1][inside] = (values[2:] - values[:-2])[inside] / step[inside, None]
    return out


def lag_reliability(frame: Frame, columns_frame: Frame, noise: NoiseFit, effect: Effect) -> float:
    """Factor of a lag along the path.

    Parameters
    ----------
    frame : Frame
        Reports as they are, in order of flight and time within an aircraft.
    columns_frame : Frame
        The frame of the design columns.
    effect : Effect
        ``time_lag``.
    """
    order = np.lexsort((frame.time, frame.flight))
    reported = np.stack([frame.u_rep, frame.v_rep], -1)[order]
    along = np.empty_like(reported)
    along[order] = path_derivative(reported, frame.time[order], frame.flight[order])
    return _slope(along, -np.asarray(effect.columns(columns_frame))[0], noise)


def _slope(truth: Floats, column: Floats, noise: NoiseFit) -> float:
    """Regression of the reported gradient on the reference's, whitened along flights."""
    good = np.isfinite(truth).all(axis=1) & np.isfinite(column).all(axis=1)
    # of fewer the slope follows single flights: one leaves what is read off as it is
    if good.sum() < 500:
        return 1.0
    # neighbours that far apart differ by a gross error, not by the wind's gradient
    bound = 6 * np.median(np.abs(truth[good])) + 1e-12
    good &= (np.abs(truth) < bound).all(axis=1)
    x = whiten(np.where(good[:, None], column, 0.0), noise.order, noise.gains)
    y = whiten(np.where(good[:, None], truth, 0.0), noise.order, noise.gains)
    energy = float((x * x).sum())
    # what is read off is divided by it: noise must not multiply that by more than five
    return float(np.clip((x * y).sum() / energy, 0.2, 1.2)) if energy > 0 else 1.0
