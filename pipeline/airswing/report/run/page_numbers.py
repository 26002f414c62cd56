"""The numbers a page states: disagreement before and after, audit, tables, headline.

Assumes SI winds and the Datasets of the stages.  Disagreement is the mean length of the vector
difference between reported and reference wind (the seed's metric), in knots; its interval
takes flights as the units (errors inside a flight are correlated).  Only reports that passed
the screening and were corrected are compared, the same ones before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, SupportsFloat

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.clustered_mean import cluster_sums, clustered_mean
from airswing.flags import SCREENING, STATUS, mended, published
from airswing.products.ragged import aircraft_of_report, blocks
from airswing.report.run.selection import pooled, status_words, tails, used
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
# Aircraft from which on nine in ten can be told from all.
_RANGE_FROM = 10
_WINDS = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "screening",
    "flight",
)
_MENDED = ("corrected_eastward_wind", "corrected_northward_wind", "correction_applied")


class Total(NamedTuple):
    """Fleet-wide disagreement (kt) before and after, reduction with 95 % interval, reports."""

    before: float
    after: float
    reduction: float
    half_width: float
    number: int


class BeforeAfter(NamedTuple):
    """Mean vector disagreement (kt) of each aircraft, and the reduction with its interval."""

    before: Floats
    after: Floats
    reduction: Floats
    half_width: Floats
    number: NDArray[np.int64]
    """Reports, (aircraft,)."""
    total: Total


def compared(
    headings: xr.Dataset, corrected: xr.Dataset, fits: xr.Dataset, reference: str
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Vector disagreement of each report before and after (kt), and which reports count."""
    wind = [
        pooled(headings, fits, reference, f"reference_{way}_wind")
        for way in ("eastward", "northward")
    ]
    before = (
        np.hypot(
            headings["eastward_wind"].to_numpy() - wind[0],
            headings["northward_wind"].to_numpy() - wind[1],
        )
        / KNOT
    )
    after = (
        np.hypot(
            corrected["corrected_eastward_wind"].to_numpy() - wind[0],
            corrected["corrected_northward_wind"].to_numpy() - wind[1],
        )
        / KNOT
    )
    keep = used(headings) & np.isfinite(before) & np.isfinite(after)
    # What was left as it was has the same disagreement twice and would only thin the gain.
    if "correction_applied" in corrected:
        keep &= mended(corrected["correction_applied"].to_numpy())
    return before, after, keep


def _sums(headings: xr.Dataset, corrected: xr.Dataset, fits: xr.Dataset, reference: str) -> Floats:
    """Sums behind the disagreement of each aircraft: before, after, gain (3, 6, aircraft)."""
    mended = [name for name in _MENDED if name in corrected]
    found = []
    for block, better in zip(blocks(headings, _WINDS), blocks(corrected, mended), strict=True):
        before, after, keep = compared(block, better, fits, reference)
        owner, flight = aircraft_of_report(block)[keep], block["flight"].to_numpy()[keep]
        found.append(
            [
                cluster_sums(values[keep], owner, flight, block.sizes["aircraft"])
                for values in (before, after, before - after)
            ]
        )
    return np.concatenate([np.array(part) for part in found], axis=-1)


def disagreement(
    headings: xr.Dataset, corrected: xr.Dataset, fits: xr.Dataset, reference: str
) -> BeforeAfter:
    """Before and after of each aircraft against one reference or pool.

    Parameters
    ----------
    headings, corrected, fits : Dataset
        Products of docs/formats.md, reports in the same order.
    reference : str
        Reference or pool.

    Returns
    -------
    BeforeAfter
        NaN for aircraft that were not corrected.
    """
    sums = _sums(headings, corrected, fits, reference)
    (before, after, gain), (*_, error) = zip(*map(clustered_mean, sums), strict=True)
    number = sums[0, 0].astype(np.int64)
    # A flight is of one aircraft: clustered sums of the fleet are those of its aircraft added.
    return BeforeAfter(before, after, gain, NORMAL_95 * error, number, _total(sums.sum(axis=-1)))


def _total(sums: Floats) -> Total:
    """Of all corrected reports, from their sums (3, 6)."""
    if not sums[0, 0]:
        return Total(np.nan, np.nan, np.nan, np.nan, 0)
    (before, after, gain), (*_, error) = zip(*map(clustered_mean, sums), strict=True)
    number = int(sums[0, 0])
    return Total(float(before), float(after), float(gain), float(NORMAL_95 * error), number)


class Rule(NamedTuple):
    """Reports one screening rule marks: in all, and those no other rule marks."""

    name: str
    together: int
    alone: int


def screening_audit(headings: xr.Dataset) -> list[Rule]:
    """Count what each screening rule removed, the largest first, rules that hit none omitted."""
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


def kept_reports(headings: xr.Dataset) -> int:
    """Count the reports that passed every screening rule."""
    return sum(int(used(block).sum()) for block in blocks(headings, ["screening"]))


def harmonic_amplitude(fits: xr.Dataset, reference: str) -> Floats:
    """Amplitude (degree) of each aircraft whose fit is ok, against one reference."""
    fit = fits.sel(reference=reference)
    return np.asarray(fit["amplitude"].to_numpy()[fit["status"].to_numpy() == 0], float)


def offsets_alone(fits: xr.Dataset, reference: str) -> Floats:
    """Offset (degree) of each aircraft that has no curve but a constant, against one reference."""
    fit = fits.sel(reference=reference)
    alone = fit["status"].to_numpy() == STATUS["offset_only"]
    return np.asarray(fit["offset"].to_numpy()[alone], float)


def headline(fits: xr.Dataset, total: Total | None, reference: str) -> str:
    """Return the page's first sentence: how many were fitted, how large, what it bought."""
    amplitude = harmonic_amplitude(fits, reference)
    offset = offsets_alone(fits, reference)
    fleet = fits.sizes["aircraft"]
    if amplitude.size + offset.size == 0:
        return (
            f"None of {fleet} aircraft could be fitted against {reference}: see below what was "
            "left out and why."
        )
    found = []
    if amplitude.size:
        found.append(
            f"{amplitude.size} of {fleet} aircraft fitted against {reference}: "
            + _typical(amplitude)
        )
    if offset.size:
        found.append(
            f"{offset.size} of {fleet} aircraft have an offset alone against {reference} (too few "
            f"headings or flights for a curve), {np.median(offset):+.1f}° in the middle"
        )
    text = "; ".join(found)
    if total is None:
        return text + "."
    if total.number == 0:
        return text + "; no report could be corrected."
    interval = f" ± {total.half_width:.2f}" if np.isfinite(total.half_width) else ""
    verb = "falls" if total.reduction > 0 else "rises"
    return (
        f"{text}; correcting it, the wind's mean disagreement {verb} from {total.before:.1f} kt "
        f"to {total.after:.1f} kt (by {abs(total.reduction):.2f}{interval} kt)."
    )


def _typical(amplitude: Floats) -> str:
    """Size of the deviations, with their range where there are enough for one."""
    size = f"{np.median(amplitude):.1f}° in amplitude"
    if amplitude.size == 1:
        return f"its compass deviation is {size}"
    low, high, words = amplitude.min(), amplitude.max(), "in all"
    if amplitude.size >= _RANGE_FROM:
        (low, high), words = np.percentile(amplitude, [5, 95]), "for nine in ten"
    return f"the typical compass deviation is {size} ({low:.1f}° to {high:.1f}° {words})"


def correction_rows(
    fits: xr.Dataset, reference: str, aircraft: Sequence[str]
) -> list[tuple[list[str], bool]]:
    """Cells of the table of corrections.

    Parameters
    ----------
    aircraft : sequence of str
        In the order of the rows.

    Returns
    -------
    list of (list of str, bool)
        Aircraft, the corrections, their residual, offset, amplitude and phase with intervals,
        reports and status; and whether the fit is to be trusted.
    """
    fit = fits.sel(reference=reference)
    known = {name: place for place, name in enumerate(tails(fits))}
    order = [known[name] for name in aircraft]
    status, reports, table, residual = (
        fit[name].to_numpy()[order]
        for name in ("status", "report_count", "table_correction", "table_residual_rms")
    )
    shape = [
        _intervals(fit, name, order, digits=digits)
        for name, digits in (("offset", 2), ("amplitude", 2), ("phase", 0))
    ]
    return [
        (
            [
                name,
                *(_signed_text(float(value)) for value in table[row]),
                number_text(residual[row]),
                *(words[row] for words in shape),
                f"{int(reports[row]):,}",
                status_words(status[row]),
            ],
            bool(published(status[row])),
        )
        for row, name in enumerate(aircraft)
    ]


def _intervals(fit: xr.Dataset, name: str, order: list[int], *, digits: int) -> list[str]:
    """``value ± half width`` of a fit's quantity by aircraft, or a dash."""
    values = fit[name].to_numpy()[order].tolist()
    halves = (NORMAL_95 * fit[f"{name}_standard_error"].to_numpy()[order]).tolist()
    return [
        number_text(value, digits=digits)
        + (f" ± {half:.{digits}f}" if np.isfinite(value) and np.isfinite(half) else "")
        for value, half in zip(values, halves, strict=True)
    ]


def _signed_text(value: float) -> str:
    """Return a correction with its sign and one decimal, zero as +0.0, or a dash."""
    return f"{round(value, 1) + 0.0:+.1f}" if np.isfinite(value) else "-"


def number_text(value: SupportsFloat, *, digits: int = 2) -> str:
    """Return a number with fixed digits, or a dash where there is none."""
    number = float(value)
    return f"{number:.{digits}f}" if np.isfinite(number) else "-"
