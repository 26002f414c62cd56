"""Whether the headings of an archive are of the kind they are taken for: true or magnetic.

Assumptions
-----------
A magnetic heading taken for true is in error by minus the declination where it was flown, a true
one taken for magnetic (or corrected twice) by the declination. Compass offsets proper differ from
aircraft to aircraft and have a mean: in Mode-S data of 27 types their mean is 1.0
degree and their scatter 0.7, which is what the offsets are weighed against, as two normal
hypotheses. Where the declination is small (under 3 degrees all over; under 4 with a single
aircraft) nothing can be decided and no note is made.

References
----------
de Haan 2016 (KNMI): offsets by type in Mode-S headings.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.flags import published
from airswing.products.ragged import aircraft_of_report, blocks

Array = NDArray[np.float64]

FLEET_MEAN, SCATTER = 1.0, 0.7
"""Degrees: standard deviation of the mean offset of a fleet, and scatter between its aircraft."""
EVIDENCE = float(np.log(100.0))  # log odds from which on a warning is given
_WORDS = {
    "magnetic_for_true": (
        "minus the declination",
        "headings taken for true are magnetic",
        "map their column as magnetic_heading_deg (winds that a unit computed itself along a "
        "magnetic heading need the unit's own remedy)",
    ),
    "true_for_magnetic": (
        "the declination",
        "headings taken for magnetic are true",
        "map their column as heading_deg",
    ),
}


def mean_declination(headings: xr.Dataset) -> Array:
    """Mean declination (aircraft,) of the reports used, degrees; NaN without a report."""
    found: list[Array] = []
    for block in blocks(headings, ["declination", "screening"]):
        value = block["declination"].to_numpy().astype(np.float64)
        used = np.isfinite(value) & (block["screening"].to_numpy() == 0)
        aircraft, number = aircraft_of_report(block)[used], block.sizes["aircraft"]
        count = np.bincount(aircraft, minlength=number)
        total = np.bincount(aircraft, weights=value[used], minlength=number)
        found.append(np.divide(total, count, out=np.full(number, np.nan), where=count > 0))
    return np.concatenate(found)


def taken_for(offset: ArrayLike, standard_error: ArrayLike, declination: ArrayLike) -> str:
    """Whether the headings of a fleet are of another kind than assumed.

    Parameters
    ----------
    offset, standard_error, declination : array_like, shape (aircraft,)
        Offsets of the headings, their standard errors and the mean declinations, degrees.

    Returns
    -------
    str
        ``magnetic_for_true``, ``true_for_magnetic``, or empty: as assumed, or not known.
    """
    error, wide, angle = (
        np.asarray(values, dtype=np.float64) for values in (offset, standard_error, declination)
    )
    if not error.size:
        return ""
    # offsets share a mean of variance FLEET_MEAN^2 and scatter by SCATTER^2 about it
    inverse = np.linalg.inv(np.diag(SCATTER**2 + wide**2) + FLEET_MEAN**2)
    odds = {
        # log likelihood ratio: the same covariance with the declination subtracted
        name: 0.5 * float(error @ inverse @ error - rest @ inverse @ rest)
        for name, rest in (
            ("magnetic_for_true", error + angle),
            ("true_for_magnetic", error - angle),
        )
    }
    best = max(odds, key=lambda name: odds[name])
    return best if odds[best] > EVIDENCE else ""


def heading_kind_warnings(fits: xr.Dataset, reference: str) -> list[str]:
    """Return one sentence if the offsets of a fleet are those of the other kind of heading.

    Parameters
    ----------
    fits : Dataset
        With ``mean_declination`` (aircraft).
    reference : str
        Whose fits to use.
    """
    known_from_reports = '"reported_heading"' in str(fits.attrs.get("implausible_reports", ""))
    if "mean_declination" not in fits or known_from_reports:
        return []
    fit = fits.sel(reference=reference)
    offset, angle = fit["offset"].to_numpy(), fit["mean_declination"].to_numpy()
    good = published(fit["status"]) & np.isfinite(offset) & np.isfinite(angle)
    kind = taken_for(offset[good], fit["offset_standard_error"].to_numpy()[good], angle[good])
    if not kind:
        return []
    like, what, remedy = _WORDS[kind]
    return [
        f"The heading offsets of {np.count_nonzero(good)} aircraft (median "
        f"{np.median(offset[good]):+.1f} degrees) are {like} where they flew "
        f"({np.median(angle[good]):+.1f} degrees): it seems that {what}; {remedy}"
    ]
