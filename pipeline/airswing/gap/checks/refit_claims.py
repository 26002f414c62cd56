"""Fit deviations and field test again with the other effects removed from the winds.

The diagnosed effects other than a deviation are removed, those of the reference from the reference
winds and all others from the reported winds. Both fits use the same reports and options; their
difference has less noise than either. Effects on scatter or rounding, and exchanged identifiers,
are not removed. Angles in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from airswing.gap.arrays import Floats, Integers
from airswing.gap.result.schema import ClaimsEntry, FieldTestEntry, FitEntry
from airswing.physics.triangle import wrap_degrees
from airswing.units import NORMAL_95

Options = Mapping[str, Any]  # a section of the configuration as keyword arguments

_SIDES = ("eastward", "northward")


@dataclass(frozen=True)
class Adjustment:
    """Corrections of the winds for all diagnosed effects other than the deviation."""

    report: Integers  # (n,): rows of the headings
    # (n, 2): to be added to the reported and to the reference wind (u, v), m s-1
    reported: Floats
    reference: Floats
    names: tuple[str, ...]  # the removed effects


def adjusted_headings(headings: xr.Dataset, adjustment: Adjustment) -> xr.Dataset:
    """Correct winds, headings, airspeeds and their errors on the rows of an adjustment."""
    rows = adjustment.report
    dims: dict[str, tuple[str, ...]]
    dims = {name: ("reference", "report") for name in ("heading_error", "airspeed_error")}
    dims |= {f"reference_{side}_wind": ("reference", "report") for side in _SIDES}
    dims |= {f"{side}_wind": ("report",) for side in _SIDES}
    dims |= {name: ("report",) for name in ("heading", "magnetic_heading", "airspeed")}
    new = {
        name: np.array(headings[name].transpose(*order).to_numpy(), np.float64)
        for name, order in dims.items()
    }
    air, implied = [], []
    for k, side in enumerate(_SIDES):
        ground = headings[f"ground_{side}_velocity"].to_numpy()[rows].astype(np.float64)
        new[f"{side}_wind"][rows] += adjustment.reported[:, k]
        new[f"reference_{side}_wind"][:, rows] += adjustment.reference[:, k]
        air.append(ground - new[f"{side}_wind"][rows])
        implied.append(ground - new[f"reference_{side}_wind"][:, rows])
    heading, airspeed = np.degrees(np.arctan2(*air)), np.hypot(*air)
    new["heading"][rows] = heading % 360.0
    new["airspeed"][rows] = airspeed
    declination = headings["declination"].to_numpy()[rows].astype(np.float64)
    new["magnetic_heading"][rows] = (heading - declination) % 360.0
    new["heading_error"][:, rows] = wrap_degrees(heading - np.degrees(np.arctan2(*implied)))
    new["airspeed_error"][:, rows] = airspeed - np.hypot(*implied)
    return headings.assign({name: (dims[name], values) for name, values in new.items()})


def review_claims(
    headings: xr.Dataset,
    adjustment: Adjustment,
    *,
    pools: Mapping[str, Sequence[str]],
    reference: str,
    fit: Options,
    field_test: Options | None = None,
) -> ClaimsEntry:
    """Fit the deviations and the field test before and after the other effects are removed.

    ``reference`` is one of the ``pools``; ``fit`` and ``field_test`` are options of `fit_deviation`
    and `field_test`. Without fits where no effect was removed.
    """
    names = list(adjustment.names)
    if not names:
        return ClaimsEntry(names)
    from airswing.compass.fit.deviation import fit_deviation

    adjusted = adjusted_headings(headings, adjustment)
    members = list(pools[reference])
    before, after = (
        fit_deviation(part, pools={reference: members}, alone=False, **fit).sel(reference=reference)
        for part in (headings, adjusted)
    )
    fits = compared_fits(before, after)
    judged = [entry.stays for entry in fits if entry.stays is not None]
    test = None
    if field_test is not None:
        test = _field_tests(headings, adjusted, members, reference, field_test)
    return ClaimsEntry(names, fits, stay=sum(judged), of=len(judged), field_test=test)


def compared_fits(before: xr.Dataset, after: xr.Dataset) -> list[FitEntry]:
    """Compare offset and amplitude of each aircraft with the 95 % intervals of the first fit."""
    entries = []
    for tail in before["aircraft"].to_numpy():
        first, second = before.sel(aircraft=tail), after.sel(aircraft=tail)
        numbers: dict[str, float] = {}
        stays = True
        for name in ("offset", "amplitude"):
            value, adjusted = float(first[name]), float(second[name])
            error = float(first[f"{name}_standard_error"])
            numbers |= {
                f"{name}_deg": value,
                f"{name}_deg_after": adjusted,
                f"{name}_deg_standard_error": error,
            }
            stays &= abs(adjusted - value) <= NORMAL_95 * error
        trusted = int(first["status"]) == 0 and int(second["status"]) == 0
        entries.append(FitEntry(str(tail), **numbers, stays=bool(stays) if trusted else None))
    return entries


def _field_tests(
    headings: xr.Dataset,
    adjusted: xr.Dataset,
    members: Sequence[str],
    reference: str,
    options: Options,
) -> FieldTestEntry:
    from airswing.evaluation.field_test import field_test

    before, after = (
        field_test(part, pools={reference: list(members)}, reference=reference, **options)
        for part in (headings, adjusted)
    )
    low, high = before["adjusted_reduction_ci_kt"]
    value = float(after["adjusted_reduction_kt"])
    return FieldTestEntry(
        reduction_kt=float(before["adjusted_reduction_kt"]),
        reduction_ci_kt=[float(low), float(high)],
        reduction_kt_after=value,
        stays=bool(low <= value <= high),
    )
