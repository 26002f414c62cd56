"""Corrections applied to reports that their fit did not use, and compared with the prediction.

Two ways to hold reports out: by date (the virtual field test: learn up to a date, apply after it)
and by flight (cross-validation: whole flights in folds).

Assumes that compasses do not change (:mod:`airswing.evaluation.monitoring.changes`) and, for the
folds, that flights are independent but for the day they share and numbered uniquely over the
archive. The gain is paired, the same report before and after its correction, so that the model's
error hardly enters. Its interval is a bootstrap over days. Knots of wind vector disagreement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import correct
from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.field_test import require_aircraft
from airswing.evaluation.ranking import rank_aircraft, require_reference
from airswing.evaluation.resampling import Floats, day_weights, interval
from airswing.evaluation.results import Content
from airswing.flags import SCREENING, is_corrected
from airswing.products.ragged import aircraft_of_report, blocks, time_span
from airswing.units import KNOT, NORMAL_95

Mask = NDArray[np.bool_]
_COLUMNS = (
    "time",
    "eastward_wind",
    "northward_wind",
    "airspeed",
    "heading",
    "magnetic_heading",
    "screening",
    "reference_eastward_wind",
    "reference_northward_wind",
    "horizontal_field",
)


class TableOptions(FitOptions, total=False):
    """Options of the fit, and the resolution of the tables in degrees."""

    resolution: float


def only(headings: xr.Dataset, chosen: Mask) -> xr.Dataset:
    """The same headings with the other reports marked so that no fit uses them.

    Parameters
    ----------
    headings : Dataset
        In memory or lazy; ``screening`` is read.
    chosen : array of bool, shape (report,)

    Returns
    -------
    Dataset
        With the bit ``no_reference`` of ``screening`` set elsewhere.
    """
    screening = headings["screening"].to_numpy()
    marked = np.where(chosen, screening, screening | SCREENING["no_reference"])
    return headings.assign(screening=("report", marked.astype(screening.dtype)))


def flight_folds(headings: xr.Dataset, *, folds: int, seed: int = 0) -> NDArray[np.int64]:
    """Fold of every report: whole flights, dealt evenly over each aircraft's days.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds.
    """
    label, day = headings["flight"].to_numpy(), headings["time"].to_numpy().astype("datetime64[D]")
    flights, first, flight = np.unique(label, return_index=True, return_inverse=True)
    if folds < 2 or flights.size < folds:
        raise InputError(
            "the flights cannot be dealt into that many folds",
            field="folds",
            found=f"{folds} folds, {flights.size} flights",
            remedy="Two folds or more, and no more than there are flights",
        )
    rng = np.random.default_rng(seed)
    aircraft = aircraft_of_report(headings)[first]
    order = np.lexsort((rng.random(flights.size), day[first], aircraft))
    # each run of `folds` flights in the order of days gets every fold once, in a random order
    dealt = np.argsort(rng.random((-(-flights.size // folds), folds)), axis=1).ravel()
    number = np.empty(flights.size, dtype=np.int64)
    number[order] = dealt[: flights.size]
    return np.asarray(number[flight])


def fitted(
    headings: xr.Dataset,
    pools: Mapping[str, list[str]],
    reference: str,
    *,
    resolution: float = 0.1,
    **options: Unpack[FitOptions],
) -> xr.Dataset:
    """Fits and tables against one reference or pool.

    Parameters
    ----------
    headings : Dataset
        Screened; marked reports (:func:`only`) are not used.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools``.
    resolution : float, default 0.1
        Of the tables, degrees.
    **options
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.
    """
    members = list(pools[reference])
    part = headings.sel(reference=members)
    fits = fit_deviation(part, pools={reference: members}, alone=False, **options)
    attributes = fits.attrs
    fits = fits.sel(reference=[reference])
    fits.attrs = {**attributes, "reference_count": 1}
    # Computed here, because every later use of a lazy fit would repeat it.
    return add_tables(fits, part, resolution=resolution).compute()


def virtual_field_test(
    headings: xr.Dataset,
    *,
    learned_until: date,
    pools: Mapping[str, list[str]],
    reference: str,
    corrected: list[str] | None = None,
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Unpack[TableOptions],
) -> Content:
    """Learn the corrections up to a date, apply them after it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings; of a part of them, as :func:`only` marks it.
    learned_until : date
        Reports before it are learned from, reports from it on are used for the comparison.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools`` of the fit and the comparison.
    corrected : list of str, optional
        Aircraft that get the correction, the others being controls; all by default.
    draws, seed : int
        Of the bootstrap.
    **fit_options
        As for :func:`fitted`.

    Returns
    -------
    dict
        ``later`` of ``virtual_field_test.json``: ``groups`` as in ``field_test.json``;
        ``predicted_gain_kt`` and ``realised_gain_kt`` with intervals, over all reports of the
        corrected aircraft that have a fit and ``by_aircraft``; ``agree``: whether their difference
        is within its interval.

    Raises
    ------
    InputError
        If an aircraft or the reference is unknown, or a period has no screened report.
    """
    names = headings["aircraft"].to_numpy().astype(str)
    if corrected is not None:
        require_aircraft(names, corrected, "corrected")
    require_reference(pools, reference)
    treated = np.ones(names.size, bool) if corrected is None else np.isin(names, corrected)
    early = headings["time"].to_numpy() < np.datetime64(learned_until)
    used = headings["screening"].to_numpy() == 0
    for words, period in (("before", early), ("from", ~early)):
        if not (used & period).any():
            first, last = time_span(headings)
            raise InputError(
                f"the virtual field test has no screened report {words} {learned_until}",
                field="learned_until",
                found=f"reports from {str(first)[:10]} to {str(last)[:10]}",
                remedy="Choose a date inside the archive",
            )
    learned = only(headings, early)
    fits = fitted(learned, pools, reference, **fit_options)
    ranking = rank_aircraft(learned, fits, pools=pools, reference=reference, seed=seed)
    before, after, done = disagreements(headings, fits, pools[reference], reference)
    aircraft = aircraft_of_report(headings)
    # controls stay as reported, though they have a fit too
    kept = used & np.isfinite(before + after)
    after = np.where(treated[aircraft], after, before)
    groups = {}
    for group, member in (("controls", ~treated[aircraft]), ("corrected", treated[aircraft])):
        old, new = kept & member & early, kept & member & ~early
        # a group with reports on one side of the date only has no difference
        if old.any() and new.any():
            level, later = float(before[old].mean()), float(after[new].mean())
            groups[group] = {
                "aircraft": int((treated == (group == "corrected")).sum()),
                "before_kt": level,
                "during_kt": later,
                "during_uncorrected_kt": float(before[new].mean()),
                "reduction_kt": level - later,
                "reports_before": int(old.sum()),
                "reports_during": int(new.sum()),
            }
    chosen = kept & ~early & done & treated[aircraft]
    return {
        "reference": reference,
        "learned_until": str(learned_until),
        "method": "table",
        "groups": groups,
        **_compared(headings, before - after, chosen, ranking, draws=draws, seed=seed),
    }


def predicted_reduction(
    headings: xr.Dataset,
    *,
    start: date,
    corrected: list[str],
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int = 0,
    **fit_options: Unpack[TableOptions],
) -> Content:
    """Reduction that the fits before a field test predict, each aircraft with the same weight.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    start : date
        First day of the test: nothing from it on is used.
    corrected : list of str
        Aircraft corrected in the test.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools``.
    seed : int, default 0
    **fit_options
        As for :func:`fitted`.

    Returns
    -------
    dict
        Part of ``field_test.json``: ``ranking`` of all aircraft before the test, and
        ``predicted_reduction_kt`` with ``predicted_reduction_ci_kt`` of the
        ``predicted_aircraft`` corrected aircraft that have a fit (None without any), to compare
        with the adjusted reduction.
    """
    require_reference(pools, reference)
    before = only(headings, headings["time"].to_numpy() < np.datetime64(start))
    fits = fitted(before, pools, reference, **fit_options)
    ranking = rank_aircraft(before, fits, pools=pools, reference=reference, seed=seed)
    known = [
        entry
        for entry in ranking
        if entry["aircraft"] in corrected and entry["expected_gain_kt"] is not None
    ]
    result: Content = {
        "ranking": ranking,
        "predicted_reduction_kt": None,
        "predicted_reduction_ci_kt": None,
        "predicted_aircraft": len(known),
    }
    if known:
        mean = float(np.mean([entry["expected_gain_kt"] for entry in known]))
        # the errors of the fits of different aircraft are independent
        errors = [entry["expected_gain_standard_error_kt"] for entry in known]
        half = NORMAL_95 * float(np.sqrt(np.sum(np.square(errors))) / len(known))
        result["predicted_reduction_kt"] = mean
        result["predicted_reduction_ci_kt"] = [mean - half, mean + half]
    return result


def cross_validate(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    folds: int = 5,
    whole: tuple[xr.Dataset, list[Content]] | None = None,
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Unpack[TableOptions],
) -> Content:
    """Correct every flight with a fit that did not use it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools``.
    folds : int, default 5
        Parts the flights are dealt into, day by day and aircraft by aircraft.
    whole : (Dataset, list of dict), optional
        Fits of all reports with the same options, with their tables, and the ranking of
        :func:`airswing.evaluation.ranking.rank_aircraft` by them; made when not given.
    draws, seed : int
        Of the bootstrap.
    **fit_options
        As for :func:`fitted`.

    Returns
    -------
    dict
        ``held_out`` of ``virtual_field_test.json``: as :func:`virtual_field_test` without groups,
        and ``in_sample_gain_kt``: gain of the fit of all flights on the reports it was fitted to.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds, or no report could be
        corrected.
    """
    require_reference(pools, reference)
    fold = flight_folds(headings, folds=folds, seed=seed)
    after, done = np.full(fold.size, np.nan), np.zeros(fold.size, bool)
    for number in range(folds):
        part = fitted(only(headings, fold != number), pools, reference, **fit_options)
        before, corrected, could = disagreements(headings, part, pools[reference], reference)
        held = fold == number
        after[held], done[held] = corrected[held], could[held]
    if whole is None:
        fits = fitted(headings, pools, reference, **fit_options)
        whole = fits, rank_aircraft(headings, fits, pools=pools, reference=reference, seed=seed)
    chosen = (headings["screening"].to_numpy() == 0) & np.isfinite(before + after) & done
    if not chosen.any():
        raise InputError(
            "no held-out report could be corrected",
            field="folds",
            found=str(folds),
            remedy="Use fewer folds, or lower fit.min_reports",
        )
    _, in_sample, _ = disagreements(headings, whole[0], pools[reference], reference)
    return {
        "reference": reference,
        "folds": folds,
        "method": "table",
        "in_sample_gain_kt": float((before - in_sample)[chosen].mean()),
        **_compared(headings, before - after, chosen, whole[1], draws=draws, seed=seed),
    }


def disagreements(
    headings: xr.Dataset, fits: xr.Dataset, members: list[str], reference: str
) -> tuple[Floats, Floats, Mask]:
    """Wind vector disagreement of every report, as reported and as corrected by tables.

    Parameters
    ----------
    headings : Dataset
        In memory or lazy.
    fits : Dataset
        With tables of ``reference``.
    members : list of str
        References whose mean the reports are compared with.
    reference : str

    Returns
    -------
    before, after : array, shape (report,), kt
    done : array of bool, shape (report,)
        Whether the report could be corrected.
    """
    parts = []
    for block in blocks(headings, _COLUMNS):
        better = correct(block, fits, reference=reference)
        model = reference_mean(block, members)
        u, v = (model[f"reference_{way}_wind"].to_numpy() for way in ("eastward", "northward"))
        before, after = (
            np.hypot(
                source[f"{prefix}eastward_wind"].to_numpy() - u,
                source[f"{prefix}northward_wind"].to_numpy() - v,
            )
            / KNOT
            for source, prefix in ((block, ""), (better, "corrected_"))
        )
        parts.append((before, after, is_corrected(better["correction_applied"].to_numpy())))
    before, after, done = (np.concatenate(column) for column in zip(*parts, strict=True))
    return before.astype(np.float64), after.astype(np.float64), done


def _compared(
    headings: xr.Dataset,
    gain: Floats,
    chosen: Mask,
    ranking: Sequence[Content],
    *,
    draws: int,
    seed: int,
) -> Content:
    """Predicted and realised gain with intervals, of each aircraft and of all together.

    ``agree`` is None where one day leaves the intervals unknown; the gains are None where nothing
    could be compared.
    """
    predicted = {entry["aircraft"]: entry for entry in ranking}
    names = headings["aircraft"].to_numpy().astype(str)
    aircraft = aircraft_of_report(headings)[chosen]
    day = headings["time"].to_numpy()[chosen].astype("datetime64[D]").astype(np.int64)
    gain = gain[chosen]
    edges = np.searchsorted(aircraft, np.arange(names.size + 1))
    entries: list[Content] = []
    together = np.zeros(gain.size, dtype=bool)
    for name, low, high in zip(names, edges[:-1], edges[1:], strict=True):
        known = predicted[name]
        if low == high or known["expected_gain_kt"] is None:
            continue
        rows = slice(low, high)
        together[rows] = True
        entries.append(
            {
                "aircraft": str(name),
                "reports": int(high - low),
                **_side_by_side(
                    known["expected_gain_kt"],
                    known["expected_gain_standard_error_kt"],
                    *_bootstrapped(gain[rows], day[rows], draws=draws, seed=seed),
                ),
            }
        )
    if not entries:
        return {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}
    share = np.array([entry["reports"] for entry in entries]) / together.sum()
    error = np.linalg.norm(share * [entry["predicted_standard_error_kt"] for entry in entries])
    return {
        **_side_by_side(
            float(share @ [entry["predicted_gain_kt"] for entry in entries]),
            float(error),
            *_bootstrapped(gain[together], day[together], draws=draws, seed=seed),
        ),
        "reports": int(together.sum()),
        "by_aircraft": entries,
    }


def _bootstrapped(
    gain: Floats, day: NDArray[np.int64], *, draws: int, seed: int
) -> tuple[float, Floats]:
    """Mean gain and its draws over days, NaN with one day."""
    days, place = np.unique(day, return_inverse=True)
    if days.size < 2:
        return float(gain.mean()), np.full(draws, np.nan)
    total, count = np.bincount(place, weights=gain), np.bincount(place)
    # days are independent units
    weights = day_weights(days.size, draws=draws, seed=seed, length=1)
    return float(gain.mean()), np.asarray((weights @ total) / np.maximum(weights @ count, 1.0))


def _side_by_side(predicted: float, error: float, realised: float, drawn: Floats) -> Content:
    wide = float(np.hypot(error, drawn.std()))
    difference, half = realised - predicted, NORMAL_95 * wide
    return {
        "predicted_gain_kt": predicted,
        "predicted_standard_error_kt": error,
        "predicted_gain_ci_kt": [predicted - NORMAL_95 * error, predicted + NORMAL_95 * error],
        "realised_gain_kt": realised,
        "realised_gain_ci_kt": interval(drawn).tolist(),
        "difference_kt": difference,
        "difference_ci_kt": [difference - half, difference + half],
        "agree": bool(abs(difference) <= half) if np.isfinite(wide) else None,
    }
