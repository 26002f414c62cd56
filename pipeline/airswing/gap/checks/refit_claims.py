"""Deviations and field test fitted again with the other effects removed from the winds.

Assumptions: a deviation is fitted as if nothing else were wrong but what the fit itself allows for
(an airspeed scale, the reference's error shared by the fleet). Here the effects found that are not
a steady or stepping deviation are taken off first: reference-side errors off the reference winds,
all others off the reported winds, at coefficients of the whole archive. Both fits are otherwise
alike and see the same reports; their difference has less noise than either.

Validity: effects known only by spread or rounding, and exchanged identifiers, are not taken off.
A deviation that changed at a date is one mean curve in both fits. Angles in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.gap.result.schema import ClaimsEntry, FieldTestEntry, FitEntry
from airswing.physics.triangle import wrap_degrees
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Options = Mapping[str, Any]  # a section of the configuration, of which pydantic tells no types


@dataclass(frozen=True)
class Adjustment:
    """What to add to winds so that effects other than the deviation are gone."""

    report: Integers  # (n,): rows of the headings
    # reported, reference: (n, 2): to add to the reported and to the reference wind (u, v), m s-1
    reported: Floats
    reference: Floats
    names: tuple[str, ...]  # the effects taken off


def adjusted_headings(headings: xr.Dataset, adjustment: Adjustment) -> xr.Dataset:
    """Headings and heading errors as they would be without the effects taken off.

    Parameters
    ----------
    headings : Dataset
        Screened headings (``report``, ``reference``, ``aircraft``).

    Returns
    -------
    Dataset
        Winds, ``heading``, ``magnetic_heading``, ``airspeed``, ``heading_error`` and
        ``airspeed_error`` replaced on the rows of the adjustment.
    """
    rows = adjustment.report

    def column(name: str) -> Floats:
        return np.array(headings[name].to_numpy(), dtype=np.float64)

    ground = [column(f"ground_{side}_velocity")[rows] for side in ("eastward", "northward")]
    new: dict[str, object] = {}
    wind, model = [], []
    for k, side in enumerate(("eastward", "northward")):
        own, other = column(f"{side}_wind"), headings[f"reference_{side}_wind"]
        own[rows] += adjustment.reported[:, k]
        values = np.array(other.transpose("reference", "report").to_numpy(), dtype=np.float64)
        values[:, rows] += adjustment.reference[:, k]
        new[f"{side}_wind"] = ("report", own)
        new[f"reference_{side}_wind"] = (("reference", "report"), values)
        wind.append(own[rows])
        model.append(values[:, rows])
    air = [g - w for g, w in zip(ground, wind, strict=True)]
    implied = [g - m for g, m in zip(ground, model, strict=True)]
    heading, true = np.arctan2(*air), np.arctan2(*implied)
    for name, before in (("heading", column("heading")), ("airspeed", column("airspeed"))):
        before[rows] = np.degrees(heading) % 360.0 if name == "heading" else np.hypot(*air)
        new[name] = ("report", before)
    magnetic = column("magnetic_heading")
    magnetic[rows] = (np.degrees(heading) - column("declination")[rows]) % 360.0
    new["magnetic_heading"] = ("report", magnetic)
    turned = np.degrees(heading - true)
    errors = {
        "heading_error": wrap_degrees(turned),
        "airspeed_error": np.hypot(*air) - np.hypot(*implied),
    }
    for name, found in errors.items():
        values = np.array(headings[name].transpose("reference", "report").to_numpy(), np.float64)
        values[:, rows] = found
        new[name] = (("reference", "report"), values)
    return headings.assign(new)


def review_claims(
    headings: xr.Dataset,
    adjustment: Adjustment,
    *,
    pools: Mapping[str, Sequence[str]],
    reference: str,
    fit: Options,
    field_test: Options | None = None,
) -> ClaimsEntry:
    """Fit the deviations and the field test before and after the other effects are taken off.

    Parameters
    ----------
    pools : mapping
        Name -> references fitted together.
    reference : str
        Key of ``pools``.
    fit : mapping
        Options of :func:`airswing.compass.fit.deviation.fit_deviation`.
    field_test : mapping, optional
        Further keywords of :func:`airswing.evaluation.field_test.field_test`.

    Returns
    -------
    ClaimsEntry
        Without fits where the diagnosis found nothing but the deviation.
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
    """Compare offset and amplitude of each aircraft with their intervals before.

    Parameters
    ----------
    before, after : Dataset
        Fits against one reference (``aircraft``).
    """
    out = []
    for tail in before["aircraft"].to_numpy():
        one, two = before.sel(aircraft=tail), after.sel(aircraft=tail)
        numbers: dict[str, float] = {}
        stays = True
        for name in ("offset", "amplitude"):
            value, then = float(one[name]), float(two[name])
            error = float(one[f"{name}_standard_error"])
            numbers |= {
                f"{name}_deg": value,
                f"{name}_deg_after": then,
                f"{name}_deg_standard_error": error,
            }
            stays &= abs(then - value) <= NORMAL_95 * error
        trusted = int(one["status"]) == 0 and int(two["status"]) == 0
        out.append(FitEntry(str(tail), **numbers, stays=bool(stays) if trusted else None))
    return out


def _field_tests(
    headings: xr.Dataset,
    adjusted: xr.Dataset,
    members: Sequence[str],
    reference: str,
    options: Options,
) -> FieldTestEntry:
    """Adjusted reduction of the field test before and after, kt."""
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
