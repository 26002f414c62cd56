"""How far reported winds stand from a reference, in the measures the field uses.

Assumes both winds are true eastward and northward components in m/s at the same place and time.
The mean magnitude of the vector difference is the seed paper's measure (Jacobs et al. 2010,
Table 1); it is not additive, so component rms and the split along and across the heading are
given beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

KNOT = 1852.0 / 3600.0
"""Metres per second in one knot (exact by definition)."""

FloatArray = NDArray[np.floating[Any]]


def vector_difference(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
) -> FloatArray:
    """Magnitude of the wind vector difference.

    Parameters
    ----------
    eastward, northward, reference_eastward, reference_northward : arrays of float, m/s
        Broadcast against each other.

    Returns
    -------
    array of float, m/s
    """
    return np.hypot(eastward - reference_eastward, northward - reference_northward)


def disagreement(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
    heading: FloatArray,
) -> dict[str, float]:
    """Every measure of disagreement over a set of reports.

    Parameters
    ----------
    eastward, northward : arrays of float, shape (report,), m/s
        Reported or corrected wind.
    reference_eastward, reference_northward : arrays of float, shape (report,), m/s
    heading : array of float, shape (report,), radians
        Clockwise from north.

    Returns
    -------
    dict of str to float
        ``reports`` and, in m/s, ``mean_vector``, ``vector_rms``, ``eastward_rms``,
        ``northward_rms``, ``along_rms``, ``cross_rms``, ``eastward_mean``, ``northward_mean``;
        ``direction_rms_deg`` in degrees over winds of 5 m/s or more.
    """
    du, dv = eastward - reference_eastward, northward - reference_northward
    good = np.isfinite(du) & np.isfinite(dv)
    du, dv, heading = du[good], dv[good], heading[good]
    turned = np.arctan2(eastward, northward) - np.arctan2(reference_eastward, reference_northward)
    strong = good & (np.hypot(reference_eastward, reference_northward) >= 5.0)
    turned = np.arctan2(np.sin(turned[strong]), np.cos(turned[strong]))
    return {
        "reports": int(good.sum()),
        "mean_vector": _mean(np.hypot(du, dv)),
        "vector_rms": _rms(np.hypot(du, dv)),
        "eastward_rms": _rms(du),
        "northward_rms": _rms(dv),
        "along_rms": _rms(du * np.sin(heading) + dv * np.cos(heading)),
        "cross_rms": _rms(du * np.cos(heading) - dv * np.sin(heading)),
        "eastward_mean": _mean(du),
        "northward_mean": _mean(dv),
        "direction_rms_deg": float(np.degrees(_rms(turned))),
    }


def reference_mean(ds: xr.Dataset, members: list[str]) -> xr.Dataset:
    """Wind of a pool: the mean of the members that have a value at the report.

    Parameters
    ----------
    ds : Dataset
        With ``reference_eastward_wind`` and ``reference_northward_wind`` (reference, report).
    members : list of str
        Names on the ``reference`` dimension.

    Returns
    -------
    Dataset
        The two variables on ``report``.
    """
    names = ["reference_eastward_wind", "reference_northward_wind"]
    return ds[names].sel(reference=members).mean("reference", skipna=True)


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
