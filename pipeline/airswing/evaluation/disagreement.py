"""Disagreement of reported winds with a reference, in the measures the field uses.

Assumes that both winds are true eastward and northward components in m/s at the same place and
time. The mean magnitude of the vector difference is the measure of Jacobs et al. (2010, Table 1);
it is not additive, so component rms and the components along and across the heading are given as
well.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.physics.compass_deviation import deviation_basis

Floats = NDArray[np.float64]
FloatArray = NDArray[np.floating]
_Winds = TypeVar("_Winds", xr.DataArray, xr.Dataset)
WINDS = ("eastward_wind", "northward_wind", "reference_eastward_wind", "reference_northward_wind")
CORRECTED_WINDS = ("corrected_eastward_wind", "corrected_northward_wind")
MIN_DIRECTION_WIND = 5.0
"""Reference wind, m/s, below which the direction has no meaning: it is mostly that of the error."""


def innovations(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
) -> dict[str, NDArray[np.float64]]:
    """Innovation of the speed, the direction and both components of a wind, m/s and degrees.

    Directions are in (-180, 180], positive where the observation is veered (clockwise). NaN where a
    wind is missing, and of the direction where the reference wind is weaker than
    :data:`MIN_DIRECTION_WIND`.
    """
    u, v, u_ref, v_ref = eastward, northward, reference_eastward, reference_northward
    speed = np.hypot(u_ref, v_ref)
    # the angle between the two vectors, clockwise positive, is the same for directions "from"
    turned = np.degrees(np.arctan2(u * v_ref - v * u_ref, u * u_ref + v * v_ref))
    found = {
        "speed": np.hypot(u, v) - speed,
        "direction": np.where(speed >= MIN_DIRECTION_WIND, turned, np.nan),
        "eastward": u - u_ref,
        "northward": v - v_ref,
    }
    return {name: np.asarray(values, np.float64) for name, values in found.items()}


def disagreement_sums(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
    heading: FloatArray,
    group: NDArray[np.int64],
    groups: int,
) -> NDArray[np.float64]:
    """Sums behind the measures of disagreement by group, (11, group), for :func:`measures_of`.

    Winds in m/s and headings in radians are (report,). Sums of parts of an archive add up.
    """
    found = innovations(eastward, northward, reference_eastward, reference_northward)
    du, dv, turned = found["eastward"], found["northward"], np.radians(found["direction"])
    parts = [
        np.ones(du.size),
        np.hypot(du, dv),
        du**2 + dv**2,
        du**2,
        dv**2,
        (du * np.sin(heading) + dv * np.cos(heading)) ** 2,
        (du * np.cos(heading) - dv * np.sin(heading)) ** 2,
        du,
        dv,
        np.ones(du.size),
        turned**2,
    ]
    good = [np.isfinite(du + dv)] * 9 + [np.isfinite(turned)] * 2
    return np.array(
        [
            np.bincount(group[rows], part[rows], groups)
            for rows, part in zip(good, parts, strict=True)
        ]
    )


def measures_of(sums: NDArray[np.float64]) -> dict[str, float]:
    """Measures of disagreement from sums (11,) of one group, m/s and degrees.

    The direction counts over reference winds of 5 m/s or more.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[1:9] / sums[0]
        direction = np.degrees(np.sqrt(sums[10] / sums[9]))
    names = ("mean_vector", "vector_rms", "eastward_rms", "northward_rms", "along_rms", "cross_rms")
    return {
        "reports": int(sums[0]),
        **{
            name: float(np.sqrt(value) if name.endswith("rms") else value)
            for name, value in zip((*names, "eastward_mean", "northward_mean"), mean, strict=True)
        },
        "direction_rms_deg": float(direction),
    }


def reference_mean(ds: xr.Dataset, members: list[str]) -> xr.Dataset:
    """Wind of a pool (``report``): the mean of the members that have a value at the report."""
    names = ["reference_eastward_wind", "reference_northward_wind"]
    return member_mean(ds[names].sel(reference=members))


def member_mean(values: _Winds) -> _Winds:
    """Mean over ``reference`` of the members that have a value at the report, NaN where none has.

    A report outside one model's grid or hours still has the wind of the other model.
    """
    return values.mean("reference", skipna=True)


def paired_design(
    magnetic_heading: Floats, heading: Floats, airspeed: Floats
) -> tuple[Floats, Floats]:
    """Design of the joint fit across and along the heading, each (report, 8), rows in m/s.

    Columns A, B, C, D, E (radians), airspeed scale, and the bias b_u, b_v (m/s); see
    docs/method.md: cross-track V psi_err, along-track |V_A| - |V'_A|. Headings in radians, airspeed
    in m/s.
    """
    zero, sine, cosine = np.zeros_like(heading), np.sin(heading), np.cos(heading)
    cross = [*(airspeed * deviation_basis(magnetic_heading)), zero, cosine, -sine]
    along = [zero, zero, zero, zero, zero, airspeed, sine, cosine]
    return np.column_stack(cross), np.column_stack(along)
