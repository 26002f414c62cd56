"""Disagreement of reported winds with a reference, in the measures the field uses.

Assumes that both winds are true eastward and northward components in m/s at the same place and
time. The mean magnitude of the vector difference is the measure of Jacobs et al. (2010, Table 1);
it is not additive, so component rms and the components along and across the heading are given as
well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import CORRECTION
from airswing.physics.compass_deviation import deviation_basis
from airswing.products.ragged import aircraft_of_report, blocks

Floats = NDArray[np.float64]
FloatArray = NDArray[np.floating]
Ints = NDArray[np.int64]
_Winds = TypeVar("_Winds", xr.DataArray, xr.Dataset)
WINDS = ("eastward_wind", "northward_wind", "reference_eastward_wind", "reference_northward_wind")
CORRECTED_WINDS = ("corrected_eastward_wind", "corrected_northward_wind")
MIN_DIRECTION_WIND = 5.0
"""Reference wind, m/s, below which the direction has no meaning: it is mostly that of the error."""


@dataclass(frozen=True)
class Part:
    """Some whole aircraft of an archive, in memory."""

    block: xr.Dataset
    aircraft: Ints  # (report,): numbered over the archive
    day: Ints  # (report,): since 1970
    wind: Floats  # (2, report): eastward and northward, as reported, m/s
    model: dict[str, Floats]  # (2, report): of each reference or pool
    corrected: Floats  # (2, report): as reported without a corrected product
    applied: NDArray[np.integer]  # (report,): codes of `CORRECTION`

    def column(self, name: str) -> Floats:
        """A variable of the reports."""
        return self.block[name].to_numpy().astype(np.float64)


def parts_of(
    headings: xr.Dataset,
    pools: Mapping[str, list[str]],
    names: Sequence[str] = (),
    corrected: xr.Dataset | None = None,
) -> Iterator[Part]:
    """Read an archive, some whole aircraft at a time.

    ``names`` are further variables to read; ``corrected`` the corrected winds of the same reports.
    """
    first = 0
    wanted = (*CORRECTED_WINDS, "correction_applied")
    others = iter(()) if corrected is None else blocks(corrected, wanted)
    for block in blocks(headings, [*WINDS, "time", *names]):
        aircraft = aircraft_of_report(block) + first
        first += block.sizes["aircraft"]
        better = next(others, block)
        applied = np.full(aircraft.size, CORRECTION["corrected"])
        if "correction_applied" in better:
            applied = better["correction_applied"].to_numpy()
        yield Part(
            block,
            aircraft,
            block["time"].to_numpy().astype("datetime64[D]").astype(np.int64),
            _vectors(block, WINDS[:2]),
            {
                key: _vectors(member_mean(block[[*WINDS[2:]]].sel(reference=members)), WINDS[2:])
                for key, members in pools.items()
            },
            _vectors(better, WINDS[:2] if better is block else CORRECTED_WINDS),
            applied,
        )


def _vectors(ds: xr.Dataset, names: Sequence[str]) -> Floats:
    return np.array([ds[name].to_numpy() for name in names], dtype=np.float64)


def require_reference(pools: Mapping[str, list[str]], reference: str) -> None:
    """Raise InputError for a reference or pool that is not known."""
    if reference not in pools:
        raise InputError(
            "no such reference or pool",
            field="reference",
            found=reference,
            remedy=f"Known: {', '.join(pools)}",
        )


def innovations(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
) -> dict[str, Floats]:
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
    wind: Floats, reference: Floats, heading: FloatArray, group: Ints, groups: int
) -> Floats:
    """Sums behind the measures of disagreement by group, (11, group), for :func:`measures_of`.

    Winds (2, report) in m/s, headings (report,) in radians. Sums of parts of an archive add up.
    """
    found = innovations(*wind, *reference)
    du, dv, turned = found["eastward"], found["northward"], np.radians(found["direction"])
    one = np.ones(du.size)
    along = du * np.sin(heading) + dv * np.cos(heading)
    across = du * np.cos(heading) - dv * np.sin(heading)
    rows = [one, np.hypot(du, dv), du**2 + dv**2, du**2, dv**2, along**2, across**2, du, dv]
    columns = [(np.isfinite(du + dv), row) for row in rows]
    columns += [(np.isfinite(turned), row) for row in (one, turned**2)]
    return np.array([np.bincount(group[good], row[good], groups) for good, row in columns])


def measures_of(sums: Floats) -> dict[str, float]:
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


def member_mean(values: _Winds) -> _Winds:
    """Mean over ``reference`` of the members with a value at the report, NaN without any.

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
