"""Residuals of archives in which nothing is left to be found: the witness's null.

Assumptions: the error of the reference is noise along flights of the size and reach the archive
shows, day fields and a climatology of their estimated sizes, each drawn anew. Columns that stand on
the path alone meet these residuals as they meet the real one.

Validity: that of the noise model.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.design.weather import climatology_columns, day_field_columns
from airswing.gap.noise.model import NoiseFit
from airswing.gap.simulation.forward import draw_noise
from airswing.gap.sums.variance_components import Variances
from airswing.units import Picked

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Least variance of a dependence between simulated archives: of four it is small by chance.
LEAST_SPREAD = 0.1**2


def small_scale_slope(
    frame: Frame, quiet: Frame, residual: Floats, use: Picked
) -> tuple[Floats, float]:
    """What the residual follows of the reference's wind beside the large-scale one.

    Parameters
    ----------
    frame, quiet : Frame
        Reports with the reference wind, and with its large-scale part.
    residual : (n, 2) float
        m/s.
    use : (n,) bool
        Reports fitted.

    Returns
    -------
    followed : (n, 2) float
        Slope times the reference's small scales, m/s.
    share : float
        Part of the residual's mean square it makes.
    """
    small = np.stack([frame.u_ref - quiet.u_ref, frame.v_ref - quiet.v_ref], -1)
    square = float((small[use] ** 2).sum())
    slope = float((small[use] * residual[use]).sum()) / square if square > 0 else 0.0
    whole = float((residual[use] ** 2).sum())
    share = slope**2 * square / whole if whole > 0 else 0.0
    # some noise is left to draw, however well a short archive's small scales happen to fit
    return slope * small, min(share, 0.9)


def drawn_errors(
    frame: Frame,
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
    day : (n,) int

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


def shown_share(sums: Sequence[Floats]) -> float:
    """Share of what simulated archives depend on that the real one does.

    Each dependence counts as sure as simulated archives agree about it among themselves: where
    strong and weak winds come in a few spells, speed tells next to nothing.

    Parameters
    ----------
    sums : sequence of (1 + B, cells) float
        Of each dependence: sums over cells of the real archive and of each simulated one, in units
        of their noise.

    Returns
    -------
    float
        Between 0 and 1; by least absolute deviations over cells, so that an effect in some cells
        does not move it; 1 where nothing is told.
    """
    if not sums:
        return 1.0
    slopes = [[_median_slope(one[1:].mean(axis=0), own) for own in one] for one in sums]
    sure = [1.0 / max(float(np.var(own[1:])), LEAST_SPREAD) for own in slopes]
    return float(np.clip(np.average([own[0] for own in slopes], weights=sure), 0.0, 1.0))


def _median_slope(x: Floats, y: Floats) -> float:
    """Slope of y on x through nothing, by least absolute deviations; 0 where x is nothing."""
    use = np.abs(x) > 1e-9  # cells that no simulated wind moves have no slope
    if not use.any():
        return 0.0
    slopes, weights = y[use] / x[use], np.abs(x[use])
    order = np.argsort(slopes)
    middle = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    return float(slopes[order][middle])
