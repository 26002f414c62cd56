"""The virtual field test: corrections learned up to a date, judged on the reports after it.

Assumes nothing of the aircraft but that their compasses stay as they are (see
:mod:`airswing.evaluation.monitoring.changes`). What was predicted from the fit alone
stands beside what came out. Reports are the screened ones. The same without a date is
:mod:`airswing.evaluation.backtest.crossvalidation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.backtest.folds import Choice, only
from airswing.evaluation.backtest.gains import Apart, Floats, compared, gains_of
from airswing.evaluation.backtest.learning import (
    TableOptions,
    fitted,
    judged_blocks,
    require_reference,
)
from airswing.evaluation.backtest.ranking import rank_aircraft
from airswing.evaluation.results import Content
from airswing.products.ragged import aircraft_of_report, blocks, time_span
from airswing.units import NORMAL_95


def virtual_field_test(
    headings: xr.Dataset,
    *,
    learned_until: date,
    pools: Mapping[str, list[str]],
    reference: str,
    corrected: list[str] | None = None,
    fits: xr.Dataset | None = None,
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Unpack[TableOptions],
) -> Content:
    """Learn the corrections up to a date, apply them after it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings; of a part of them, as
        :func:`airswing.evaluation.backtest.folds.only` marks it.
    learned_until : date
        Reports before it are learned from, reports from it on are judged.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools``: the fit and what it is judged by.
    corrected : list of str, optional
        Aircraft that get the correction, the others being controls; all by default.
    fits : Dataset, optional
        Of the reports before the date, with tables, where ``headings`` has but the last of them;
        made when not given.
    **fit_options
        As for :func:`airswing.evaluation.backtest.learning.fitted`.

    Returns
    -------
    VirtualTest
        ``groups`` as in ``field_test.json``; ``predicted_gain_kt`` and ``realised_gain_kt`` with
        intervals, over all reports of the corrected aircraft that have a fit and in
        ``by_aircraft``; ``agree``: whether their difference is within its interval.

    Raises
    ------
    InputError
        If an aircraft or the reference is unknown, or a window holds no screened report.
    """
    treated = _treated(headings, corrected)
    require_reference(pools, reference)

    def learn(reports: xr.Dataset) -> NDArray[np.bool_]:
        return np.asarray(reports["time"].to_numpy() < np.datetime64(learned_until))

    def judge(reports: xr.Dataset) -> NDArray[np.bool_]:
        return np.asarray(reports["time"].to_numpy() >= np.datetime64(learned_until))

    _require_reports(headings, learn, judge, learned_until)
    part = only(headings, learn)
    if fits is None:
        fits = fitted(part, pools, reference, **fit_options)
    ranking = rank_aircraft(part, fits, pools=pools, reference=reference, seed=seed)
    windows, gains = [], []
    for block, aircraft in judged_blocks(headings):
        apart = Apart.of(block, fits, pools[reference], reference)
        corrected_here = treated[aircraft][aircraft_of_report(block)]
        # controls stay as reported, though they have a fit too
        after = np.where(corrected_here, apart.after, apart.before)
        # the same reports before and after: one without a corrected wind has no part in either
        kept = (block["screening"].to_numpy() == 0) & np.isfinite(apart.before + apart.after)
        late = kept & judge(block)
        windows.append(_windows(block, apart.before, after, kept & learn(block), late))
        judged = late & apart.done & corrected_here
        gains += gains_of(block, apart.before - after, judged)
    return {
        "reference": reference,
        "learned_until": str(learned_until),
        "method": "table",
        "groups": _groups(np.concatenate(windows, axis=1), treated),
        **compared(headings, gains, ranking, draws=draws, seed=seed),
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
    """What the fits before a field test expected of it, aircraft weighted alike.

    Parameters
    ----------
    start : date
        First day of the test: nothing from it on is looked at.
    corrected : list of str
        Aircraft corrected in the test.
    reference : str
        Key of ``pools``.
    **fit_options
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.

    Returns
    -------
    Expected
        ``ranking`` of all aircraft before the test, and ``predicted_reduction_kt`` with
        ``predicted_reduction_ci_kt`` of the corrected that had a fit (None without any):
        what to hold the adjusted reduction against.
    """
    require_reference(pools, reference)
    before = only(headings, lambda reports: reports["time"].to_numpy() < np.datetime64(start))
    fits = fitted(before, pools, reference, **fit_options)
    ranking = rank_aircraft(before, fits, pools=pools, reference=reference, seed=seed)
    known = [
        (gain, entry["expected_gain_standard_error_kt"])
        for entry in ranking
        if entry["aircraft"] in corrected and (gain := entry["expected_gain_kt"]) is not None
    ]
    result: Content = {
        "ranking": ranking,
        "predicted_reduction_kt": None,
        "predicted_reduction_ci_kt": None,
        "predicted_aircraft": len(known),
    }
    if known:
        gains, errors = zip(*known, strict=True)
        mean = float(np.mean(gains))
        # aircraft's fits err independently: the mean of n of them by the root of their summed
        # squares over n
        wide = float(np.sqrt(np.sum(np.square(errors))) / len(known))
        result["predicted_reduction_kt"] = mean
        result["predicted_reduction_ci_kt"] = [mean - NORMAL_95 * wide, mean + NORMAL_95 * wide]
    return result


def _treated(headings: xr.Dataset, corrected: list[str] | None) -> NDArray[np.bool_]:
    names = headings["aircraft"].to_numpy().astype(str)
    if corrected is None:
        return np.ones(names.size, dtype=bool)
    unknown = [name for name in corrected if name not in set(names)]
    if unknown or not corrected:
        raise InputError(
            "a group names an aircraft the archive does not hold",
            field="corrected",
            found=", ".join(unknown[:5]) or "no aircraft",
            remedy=f"Known aircraft: {', '.join(sorted(names)[:20])}",
        )
    return np.isin(names, corrected)


def _require_reports(headings: xr.Dataset, learn: Choice, judge: Choice, until: date) -> None:
    found = [False, False]
    for block in blocks(headings, ["time", "screening"]):
        kept = block["screening"].to_numpy() == 0
        found = [
            one or bool((kept & choice(block)).any())
            for one, choice in zip(found, (learn, judge), strict=True)
        ]
    for words, some in zip(("before", "from"), found, strict=True):
        if not some:
            first, last = time_span(headings)
            raise InputError(
                f"the virtual field test has no screened report {words} {until}",
                field="learned_until",
                found=f"reports from {str(first)[:10]} to {str(last)[:10]}",
                remedy="Choose a date inside the archive",
            )


def _windows(
    block: xr.Dataset,
    before: Floats,
    after: Floats,
    learn: NDArray[np.bool_],
    judge: NDArray[np.bool_],
) -> Floats:
    """Reports and summed disagreements of each aircraft before and after the date."""
    row, size = aircraft_of_report(block), block.sizes["aircraft"]

    def summed(chosen: NDArray[np.bool_], values: Floats | None = None) -> Floats:
        weights = None if values is None else values[chosen]
        return np.bincount(row[chosen], weights=weights, minlength=size).astype(np.float64)

    return np.array(
        [
            summed(learn),
            summed(learn, before),
            summed(judge),
            summed(judge, after),
            summed(judge, before),
        ]
    )


def _groups(windows: Floats, treated: NDArray[np.bool_]) -> dict[str, Content]:
    """The seed's table: the corrected as corrected after the date, the controls as reported."""
    found: dict[str, Content] = {}
    for group, member in (("controls", ~treated), ("corrected", treated)):
        learned, before, judged, after, uncorrected = windows[:, member].sum(axis=1)
        # a group on one side of the date only has no difference
        if not learned or not judged:
            continue
        found[group] = {
            "aircraft": int(member.sum()),
            "before_kt": float(before / learned),
            "during_kt": float(after / judged),
            "during_uncorrected_kt": float(uncorrected / judged),
            "reduction_kt": float(before / learned - after / judged),
            "reports_before": int(learned),
            "reports_during": int(judged),
        }
    return found
