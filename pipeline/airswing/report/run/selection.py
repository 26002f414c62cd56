"""Selection of reports and fits for figures; numbers of the page, and text on a fit.

Reports are sorted by aircraft with ``row_size``; ``screening`` is 0 for the reports of the fit. The
heading error of a pool is the mean over its members. Angles are degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, SupportsInt

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import error_from_table
from airswing.errors import InputError
from airswing.evaluation.innovations import chunks, member_mean, members_of, require_reference
from airswing.evaluation.resampling import SUMS, cluster_sums, clustered_mean
from airswing.flags import SCREENING, STATUS, is_corrected, published
from airswing.physics.compass_deviation import deviation_basis
from airswing.products.ragged import aircraft_reports
from airswing.report.html import interval_text
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]


def abscissa(fits: xr.Dataset) -> str:
    """Return which indicated heading the deviation is a function of: ``magnetic`` or ``true``."""
    return str(fits.attrs.get("abscissa", "magnetic"))


def formula(fits: xr.Dataset) -> list[str]:
    """Return the deviation's formula and the words of its one-cycle part, for page and card."""
    return [
        "Deviation = A + B sin m + C cos m + D sin 2m + E cos 2m, with m the indicated "
        f"{abscissa(fits)} heading.",
        "Offset = A, amplitude² = B² + C².",
        "The one-cycle part B sin m + C cos m equals amplitude × sin(m + phase): it is largest at "
        "m = 90° - phase.",
    ]


def names_of(ds: xr.Dataset, coordinate: str = "aircraft") -> list[str]:
    """Return the aircraft or references of a Dataset as strings."""
    return [str(name) for name in ds[coordinate].to_numpy()]


def used(headings: xr.Dataset) -> NDArray[np.bool_]:
    """Return which reports passed every screening rule."""
    return np.asarray(headings["screening"].to_numpy() == 0)


def drawn_columns(headings: xr.Dataset) -> xr.Dataset:
    """Return the variables that drawings of heading errors need, in memory."""
    names = "heading_error magnetic_heading heading airspeed screening time row_size"
    return headings[[name for name in names.split() if name in headings]].load()


@dataclass(frozen=True)
class Run:
    """Headings and fits of a fleet against one reference or pool."""

    headings: xr.Dataset
    fits: xr.Dataset
    reference: str

    @cached_property
    def order(self) -> list[str]:
        """Aircraft with the largest amplitude first and refused fits last."""
        fit = self.fits.sel(reference=self.reference)
        amplitude = np.nan_to_num(fit["amplitude"].to_numpy().astype(float), nan=-1.0)
        return names_of(fit.isel(aircraft=np.lexsort((-amplitude, ~published(fit["status"])))))

    def __post_init__(self) -> None:
        require_reference(names_of(self.fits, "reference"), self.reference)

    def fit(self, aircraft: str | int) -> xr.Dataset:
        """Return the fit of one aircraft, or raise InputError."""
        names, name = names_of(self.fits), aircraft
        if isinstance(name, int | np.integer) and -len(names) <= name < len(names):
            name = names[name]
        if name not in names:
            choice = f"Choose from {', '.join(names[:8])}{' ...' if len(names) > 8 else ''}"
            raise InputError("no such aircraft", field="aircraft", found=name, remedy=choice)
        return self.fits.sel(reference=self.reference).isel(aircraft=names.index(str(name)))

    @cached_property
    def bias(self) -> Floats:
        """Fitted eastward and northward bias of the reference (m/s), zero without one."""
        if "reference_bias" not in self.fits:
            return np.zeros(2)
        return np.asarray(np.nan_to_num(self.fits["reference_bias"].sel(reference=self.reference)))

    @property
    def bias_words(self) -> str:
        """A sentence on the bias subtracted from the points; empty without a bias."""
        if not self.bias.any():
            return ""
        east, north = self.bias / KNOT
        return (
            f" The fitted bias of the reference ({east:+.2f} kt eastward, {north:+.2f} "
            "kt northward) is subtracted from the points."
        )

    def points(self, aircraft: str) -> tuple[Floats, Floats]:
        """Return the heading (see `abscissa`) and its error (degrees) of the reports of a fit.

        The fitted bias b of the reference is subtracted as in the joint fit, so that the reports
        lie about the fitted curve: psi_err - (b_u cos psi - b_v sin psi) / V (docs/method.md).
        """
        name = "heading" if abscissa(self.fits) == "true" else "magnetic_heading"
        reports = drawn_columns(aircraft_reports(self.headings, aircraft))
        heading = reports[name].to_numpy().astype(float) % 360.0
        errors = reports["heading_error"].sel(reference=members_of(reports, self.reference))
        error = member_mean(errors.astype(float)).to_numpy()
        if self.bias.any():
            true = np.radians(reports["heading"].to_numpy().astype(float))
            airspeed = reports["airspeed"].to_numpy().astype(float)
            across = self.bias[0] * np.cos(true) - self.bias[1] * np.sin(true)
            error = error - np.degrees(across / np.where(airspeed > 0, airspeed, np.nan))
        keep = used(reports) & np.isfinite(heading) & np.isfinite(error)
        return heading[keep], error[keep]


def adds_error(fits: xr.Dataset) -> bool:
    """Return whether the stored table is the heading error itself, which the unit subtracts."""
    return "add_error" in str(fits.attrs.get("table_sign", ""))


def table_resolution(fits: xr.Dataset) -> float:
    """Return the step of the nodes of the tables, degrees."""
    return float(fits.attrs.get("table_resolution", 0.1))


def table_digits(fits: xr.Dataset) -> int:
    """Return the decimals, at most three, that the nodes of a table have by its resolution."""
    resolution = table_resolution(fits)
    exact = (k for k in (1, 2) if resolution > 0 and np.isclose(round(resolution, k), resolution))
    return next(exact, 3)


def table_error(fit: xr.Dataset) -> tuple[Floats, Floats]:
    """Return the nodes of the 8-point table and the heading error it represents, degrees."""
    error = error_from_table(fit).to_numpy().astype(float)
    return fit["table_heading"].to_numpy().astype(float), error


def needs_no_correction(fits: xr.Dataset) -> NDArray[np.bool_]:
    """Return a mask of the fits against one reference whose 8-point table is zero within its error.

    Either the status is ``no_correction_needed``, or every node of the table is smaller than half
    the width of the 95 % interval of the curve there, or rounds to zero.
    """
    status = fits["status"].to_numpy()
    nodes, error = table_error(fits)
    least = np.maximum(curve_half_width(fits, nodes), table_resolution(fits) / 2)
    small = (np.abs(error) <= least).all(axis=-1) & (status == STATUS["ok"])
    return np.asarray(small | (status == STATUS["no_correction_needed"]))


def curve_half_width(fits: xr.Dataset, heading: Floats) -> Floats:
    """Return half the width of the 95 % interval of fitted curves at headings, (..., heading)."""
    covariance = np.nan_to_num(fits["deviation_covariance"].to_numpy().astype(float))
    basis = deviation_basis(np.radians(heading))
    variance = np.einsum("...ij,ik,jk->...k", covariance, basis, basis)
    return np.asarray(NORMAL_95 * np.sqrt(np.maximum(variance, 0.0)))


def status_words(code: SupportsInt) -> str:
    """Return the status of a fit in words."""
    return {value: name.replace("_", " ") for name, value in STATUS.items()}[int(code)]


def fit_words(fit: xr.Dataset) -> str:
    """Return a fit in one line: offset, amplitude and phase with 95 % intervals."""
    if not published(fit["status"]):
        return f"no fit ({status_words(fit['status'])})"
    text = {
        name: interval_text(
            float(fit[name]),
            NORMAL_95 * float(fit[f"{name}_standard_error"]),
            digits=0 if name == "phase" else 2,
            sign=name == "offset",
        )
        for name in ("offset", "amplitude", "phase")
    }
    if text["amplitude"] == "-":
        return f"offset only, {text['offset']}°"
    return ", ".join(f"{name} {value}°" for name, value in text.items())


def coefficient_texts(fit: xr.Dataset) -> dict[str, str]:
    """Return the coefficients A to E with 95 % intervals and unit; zero where not fitted."""
    value = fit["deviation"].to_numpy().astype(float)
    variance = np.diagonal(fit["deviation_covariance"].to_numpy().astype(float))
    half = NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
    texts = {
        name: f"{interval_text(value[k], half[k], sign=True)}°" for k, name in enumerate("ABCDE")
    }
    if "harmonics" in fit and int(fit["harmonics"]) == 1:
        texts |= {"D": "0", "E": "0"}
    return texts


class BeforeAfter(NamedTuple):
    """Disagreement (kt), its reduction with half the 95 % interval, reports: by aircraft, total."""

    before: Any
    after: Any
    reduction: Any
    half_width: Any
    number: Any
    total: Any = None


def disagreement(headings: xr.Dataset, corrected: xr.Dataset, reference: str) -> BeforeAfter:
    """Return the disagreement of each aircraft with a reference or pool, before and after.

    It is the mean length of the vector difference between reported and reference wind over screened
    and corrected reports, the same ones before and after; its interval takes flights as the
    independent units. Headings and corrected winds have the reports in the same order, in memory or
    lazy. NaN for aircraft that were not corrected.
    """
    number, names = headings.sizes["aircraft"], ["screening", "flight"]
    sums = np.zeros((3, SUMS, number))
    for chunk in chunks(headings, {"": members_of(headings, reference)}, names, corrected):
        before, after = (
            np.hypot(*(wind - chunk.model[""])) / KNOT for wind in (chunk.wind, chunk.corrected)
        )
        # Reports without a correction have equal disagreements and would reduce the gain.
        keep = used(chunk.block) & is_corrected(chunk.applied) & np.isfinite(before + after)
        cells = chunk.aircraft[keep], chunk.block["flight"].to_numpy()[keep], number
        for part_sums, values in zip(sums, (before, after, before - after), strict=True):
            part_sums += cluster_sums(values[keep], *cells)
    # A flight belongs to one aircraft, so clustered sums of the fleet are sums over aircraft.
    sums = np.concatenate([sums, sums.sum(axis=-1, keepdims=True)], axis=-1)
    (before, after, gain), (*_, error) = zip(*map(clustered_mean, sums), strict=True)
    columns = before, after, gain, NORMAL_95 * error, sums[0, 0]
    total = BeforeAfter(*(float(column[-1]) for column in columns))
    return BeforeAfter(*(column[:-1] for column in columns))._replace(total=total)


def screening_audit(headings: xr.Dataset) -> list[tuple[str, int, int]]:
    """Return the screening rules with the reports they marked, in total and as the only rule."""
    flags = headings["screening"].to_numpy()
    rules = [
        (name, int((flags & bit > 0).sum()), int((flags == bit).sum()))
        for name, bit in SCREENING.items()
    ]
    return sorted((rule for rule in rules if rule[1]), key=lambda rule: -rule[1])


def screening_warnings(headings: xr.Dataset) -> list[str]:
    """Return a warning where screening kept less than a third of the reports, or none."""
    passed, number = kept_reports(headings), headings.sizes["report"]
    if 3 * passed >= number:
        return []
    rule, marked, alone = screening_audit(headings)[0]
    return [
        f"screening kept {passed:,} of {number:,} reports ({passed / number:.0%}): the rule {rule} "
        f"left out most, {marked:,} ({alone:,} of them alone)"
    ]


def kept_reports(headings: xr.Dataset) -> int:
    """Return the number of reports that passed every screening rule."""
    return int(used(headings).sum())


def status_counts(fits: xr.Dataset, reference: str) -> dict[str, int]:
    """Return the number of aircraft by the status of their fit against one reference."""
    status = fits["status"].sel(reference=reference)
    return {name: int((status == code).sum()) for name, code in STATUS.items()}


def fitted_text(counts: Mapping[str, int]) -> str:
    """Return the numbers of aircraft with a curve and with an offset only, from `status_counts`."""
    curves, offsets = counts["ok"] + counts["no_correction_needed"], counts["offset_only"]
    text = f"Compass deviation fitted for {curves} of {sum(counts.values())} aircraft"
    return text + (f", offset only for {offsets}" if offsets else "")


def fitted_sizes(fits: xr.Dataset, reference: str) -> tuple[Floats, Floats]:
    """Return the amplitudes of aircraft with a curve and the offsets of those with a constant."""
    fit = fits.sel(reference=reference)
    curve = np.isin(fit["status"], [STATUS["ok"], STATUS["no_correction_needed"]])
    constant = fit["status"].to_numpy() == STATUS["offset_only"]
    return fit["amplitude"].to_numpy()[curve], fit["offset"].to_numpy()[constant]


def headline(fits: xr.Dataset, total: BeforeAfter | None, reference: str) -> str:
    """Return the headline of a run, at most 25 words."""
    sizes, constants = fitted_sizes(fits, reference)
    counts, fleet = status_counts(fits, reference), fits.sizes["aircraft"]
    if implausible := counts["implausible_reports"]:
        return (
            f"Reports of {implausible} of {fleet} aircraft contradict the reference {reference}: "
            "check their units before any correction."
        )
    if not sizes.size + constants.size:
        return (
            f"No usable fit for any of {fleet} aircraft against {reference}; see Omitted reports."
        )
    typical = f"median offset {np.median(constants):+.1f}°" if constants.size else ""
    if sizes.size:
        typical = f"median amplitude {np.median(sizes):.1f}°"
    text = f"{fitted_text(counts)} ({typical})"
    if total is None:
        return f"{text}."
    if not total.number:
        return f"{text}; no report could be corrected."
    before, after = f"{total.before:.1f}", f"{total.after:.1f}"
    change = f"{'falls' if total.after < total.before else 'rises'} from {before} to {after}"
    if before == after:
        change = f"remains {after}"
    return f"{text}; the corrected winds' disagreement {change} kt."
