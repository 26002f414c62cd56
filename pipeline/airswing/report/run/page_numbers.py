"""Numbers of the page: disagreement before and after, screening counts, headline.

Disagreement is the mean length of the vector difference between reported and reference wind, in
knots; its interval takes flights as the independent units. Only reports that passed the screening
and were corrected are compared, the same ones before and after.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.resampling import cluster_sums, clustered_mean
from airswing.flags import SCREENING, STATUS, is_corrected
from airswing.products.ragged import aircraft_of_report, blocks
from airswing.report.run.selection import members, pooled, used
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
_WINDS = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "screening",
    "flight",
)
_CORRECTED = ("corrected_eastward_wind", "corrected_northward_wind", "correction_applied")


class Total(NamedTuple):
    """Disagreement of the fleet (kt) before and after, reduction with 95 % interval, reports."""

    before: float
    after: float
    reduction: float
    half_width: float
    number: int


class BeforeAfter(NamedTuple):
    """Disagreement (kt) of each aircraft, reduction with half its 95 % interval, reports."""

    before: Floats
    after: Floats
    reduction: Floats
    half_width: Floats
    number: NDArray[np.int64]
    total: Total


def disagreement(
    headings: xr.Dataset, corrected: xr.Dataset, fits: xr.Dataset, reference: str
) -> BeforeAfter:
    """Return the disagreement of each aircraft with a reference or pool, before and after.

    Parameters
    ----------
    headings, corrected, fits : Dataset
        Products of docs/formats.md, reports in the same order, in memory or lazy.
    reference : str
        Reference or pool.

    Returns
    -------
    BeforeAfter
        NaN for aircraft that were not corrected.
    """
    chosen = members(headings, fits, reference)
    parts = []
    pairs = zip(blocks(headings, _WINDS), blocks(corrected, _CORRECTED), strict=True)
    for block, better in pairs:
        u, v = (pooled(block, chosen, f"reference_{way}_wind") for way in ("eastward", "northward"))
        before, after = (
            np.hypot(
                ds[f"{prefix}eastward_wind"].to_numpy() - u,
                ds[f"{prefix}northward_wind"].to_numpy() - v,
            )
            / KNOT
            for ds, prefix in ((block, ""), (better, "corrected_"))
        )
        # Reports without a correction have the same disagreement twice and would dilute the gain.
        keep = used(block) & is_corrected(better["correction_applied"].to_numpy())
        keep &= np.isfinite(before) & np.isfinite(after)
        row, flight = aircraft_of_report(block)[keep], block["flight"].to_numpy()[keep]
        parts.append(
            [
                cluster_sums(values[keep], row, flight, block.sizes["aircraft"])
                for values in (before, after, before - after)
            ]
        )
    sums = np.concatenate([np.array(part) for part in parts], axis=-1)  # (3, 6, aircraft)
    (before, after, gain), (*_, error) = zip(*map(clustered_mean, sums), strict=True)
    # A flight belongs to one aircraft, so clustered sums of the fleet are sums over aircraft.
    whole = sums.sum(axis=-1)
    total = Total(np.nan, np.nan, np.nan, np.nan, 0)
    if number := int(whole[0, 0]):
        (start, end, reduction), (*_, spread) = zip(*map(clustered_mean, whole), strict=True)
        half = float(NORMAL_95 * spread)
        total = Total(float(start), float(end), float(reduction), half, number)
    reports = sums[0, 0].astype(np.int64)
    return BeforeAfter(before, after, gain, NORMAL_95 * error, reports, total)


class Rule(NamedTuple):
    """Reports marked by a screening rule: in all, and by no other rule."""

    name: str
    together: int
    alone: int


def screening_audit(headings: xr.Dataset) -> list[Rule]:
    """Return what each screening rule marked, the largest first; rules without a report omitted."""
    together, alone = np.zeros((2, len(SCREENING)), dtype=np.int64)
    for block in blocks(headings, ["screening"]):
        flags = block["screening"].to_numpy()
        together += [np.count_nonzero(flags & bit) for bit in SCREENING.values()]
        alone += [np.count_nonzero(flags == bit) for bit in SCREENING.values()]
    rules = [
        Rule(name, int(one), int(other))
        for name, one, other in zip(SCREENING, together, alone, strict=True)
    ]
    return sorted((rule for rule in rules if rule.together), key=lambda rule: -rule.together)


def screening_warnings(headings: xr.Dataset) -> list[str]:
    """Return a warning where screening kept less than a third of the reports, or none."""
    kept, number = kept_reports(headings), headings.sizes["report"]
    if 3 * kept >= number:
        return []
    first = screening_audit(headings)[0]
    return [
        f"screening kept {kept:,} of {number:,} reports ({kept / number:.0%}): the rule "
        f"{first.name} left out most, {first.together:,} ({first.alone:,} of them alone)"
    ]


def kept_reports(headings: xr.Dataset) -> int:
    """Return the number of reports that passed every screening rule."""
    return sum(int(used(block).sum()) for block in blocks(headings, ["screening"]))


def amplitudes(fits: xr.Dataset, reference: str) -> Floats:
    """Return the amplitude (degree) of each aircraft with a fitted curve."""
    fit = fits.sel(reference=reference)
    curve = np.isin(fit["status"], [STATUS["ok"], STATUS["no_correction_needed"]])
    return np.asarray(fit["amplitude"].to_numpy()[curve], float)


def offsets_only(fits: xr.Dataset, reference: str) -> Floats:
    """Return the offset (degree) of each aircraft with a constant instead of a curve."""
    fit = fits.sel(reference=reference)
    return np.asarray(fit["offset"].to_numpy()[fit["status"] == STATUS["offset_only"]], float)


def headline(
    fits: xr.Dataset, total: Total | None, reference: str, *, per_kt: float = 1.0, units: str = "kt"
) -> str:
    """Return the headline of a run, at most 25 words."""
    sizes, constants = amplitudes(fits, reference), offsets_only(fits, reference)
    fitted, fleet = sizes.size + constants.size, fits.sizes["aircraft"]
    implausible = int(
        (fits["status"].sel(reference=reference) == STATUS["implausible_reports"]).sum()
    )
    if implausible:
        return (
            f"Reports of {implausible} of {fleet} aircraft contradict the reference {reference}: "
            "check their units before any correction."
        )
    if not fitted:
        return (
            f"No usable fit for any of {fleet} aircraft against {reference}; see What was left out."
        )
    typical = (
        f"median amplitude {np.median(sizes):.1f}°"
        if sizes.size
        else f"median offset {np.median(constants):+.1f}°"
    )
    text = f"Compass deviation fitted for {fitted} of {fleet} aircraft ({typical})"
    if total is None:
        return f"{text}."
    if not total.number:
        return f"{text}; no report could be corrected."
    change = "falls" if total.reduction > 0 else "rises"
    return (
        f"{text}; the corrected winds' disagreement {change} from {per_kt * total.before:.1f} to "
        f"{per_kt * total.after:.1f} {units}."
    )
