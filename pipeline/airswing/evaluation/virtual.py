"""The virtual field test: corrections learned from some flights, judged on others.

Assumes nothing of the aircraft but that their compasses stay as they are (see
:mod:`airswing.evaluation.stability`). The correction is learned up to a date and applied to the
reports after it; or, in cross-validation, learned from all but a fold of whole flights and applied
to that fold. What was predicted from the fit alone stands beside what came out. Reports are the
screened ones; the realised gain is paired (the same report before and after its correction), so
the model's own error hardly enters; its interval is a bootstrap over days.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import correct
from airswing.compass.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.evaluation.disagreement import KNOT, reference_mean, vector_difference
from airswing.evaluation.folds import flight_folds, only
from airswing.evaluation.ranking import rank_aircraft
from airswing.ragged import aircraft_of_report
from airswing.vocabulary import CORRECTION

Floats = NDArray[np.float64]


def virtual_field_test(
    headings: xr.Dataset,
    *,
    learned_until: date,
    pools: Mapping[str, list[str]],
    reference: str,
    corrected: list[str] | None = None,
    learned_from: date | None = None,
    end: date | None = None,
    method: str = "table",
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Any,
) -> dict[str, Any]:
    """Learn the corrections up to a date, apply them after it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    learned_until : date
        Reports before it are learned from, reports from it on are judged.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools``: the fit and what it is judged by.
    corrected : list of str, optional
        Aircraft that get the correction, the others being controls; all by default.
    learned_from, end : date, optional
        Start of the learning and end of the judging; the archive's by default.
    method : {"table", "curve"}
        What is applied: the unit's table or the curve itself.
    draws : int, default 1000
    seed : int, default 0
    **fit_options
        As for :func:`airswing.compass.deviation.fit_deviation`.

    Returns
    -------
    dict
        ``groups`` as in ``field_test.json``; ``predicted_gain_kt`` and ``realised_gain_kt`` with
        intervals, over all reports of the corrected aircraft that have a fit and in
        ``by_aircraft``; ``agree``: whether their difference is within its interval.

    Raises
    ------
    InputError
        If an aircraft or the reference is unknown, or a window holds no screened report.
    """
    treated = _treated(headings, corrected)
    _require_reference(pools, reference)
    time = headings["time"].to_numpy()
    learn = time < np.datetime64(learned_until)
    judge = ~learn
    if learned_from is not None:
        learn &= time >= np.datetime64(learned_from)
    if end is not None:
        judge &= time < np.datetime64(end)
    _require_reports(headings, learn, judge, learned_until)
    part = only(headings, learn)
    fits = _fitted(part, pools, reference, fit_options)
    ranking = rank_aircraft(part, fits, pools=pools, reference=reference, seed=seed)
    mended = correct(headings, fits, reference=reference, method=_method(method))
    before, after = _distances(headings, mended, pools[reference])
    kept = (headings["screening"].to_numpy() == 0) & np.isfinite(before + after)
    done = mended["correction_applied"].to_numpy() == CORRECTION["corrected"]
    after = np.where(treated[aircraft_of_report(headings)], after, before)
    result: dict[str, Any] = {
        "reference": reference,
        "learned_until": str(learned_until),
        "method": method,
        "groups": _groups(headings, before, after, kept, learn, judge, treated),
    }
    judged = kept & judge & done & treated[aircraft_of_report(headings)]
    return result | _compared(headings, before, after, judged, ranking, draws=draws, seed=seed)


def cross_validate(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    folds: int = 5,
    method: str = "table",
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Any,
) -> dict[str, Any]:
    """Correct every flight with a fit that never saw it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    pools : mapping of str to list of str
    reference : str
        Key of ``pools``.
    folds : int, default 5
        Parts the flights are dealt into, day by day and aircraft by aircraft.
    method : {"table", "curve"}
    draws : int, default 1000
    seed : int, default 0
    **fit_options
        As for :func:`airswing.compass.deviation.fit_deviation`.

    Returns
    -------
    dict
        As :func:`virtual_field_test` gives, without groups, and ``in_sample_gain_kt``: what the
        fit of all flights gains on its own reports.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds.
    """
    _require_reference(pools, reference)
    number = flight_folds(headings, folds=folds, seed=seed)
    after = np.full(headings.sizes["report"], np.nan)
    done = np.zeros(after.size, dtype=bool)
    for fold in range(folds):
        held = number == fold
        fits = _fitted(only(headings, ~held), pools, reference, fit_options)
        mended = correct(headings, fits, reference=reference, method=_method(method))
        before, one = _distances(headings, mended, pools[reference])
        after[held] = one[held]
        done[held] = (mended["correction_applied"].to_numpy() == CORRECTION["corrected"])[held]
    whole = _fitted(headings, pools, reference, fit_options)
    ranking = rank_aircraft(headings, whole, pools=pools, reference=reference, seed=seed)
    mended = correct(headings, whole, reference=reference, method=_method(method))
    before, own = _distances(headings, mended, pools[reference])
    judged = (headings["screening"].to_numpy() == 0) & np.isfinite(before + after) & done
    if not judged.any():
        raise InputError(
            "no held-out report could be corrected",
            field="folds",
            found=str(folds),
            remedy="Use fewer folds, or lower fit.min_reports",
        )
    result = {
        "reference": reference,
        "folds": folds,
        "method": method,
        "in_sample_gain_kt": float((before - own)[judged].mean()),
    }
    return result | _compared(headings, before, after, judged, ranking, draws=draws, seed=seed)


def predicted_reduction(
    headings: xr.Dataset,
    *,
    start: date,
    corrected: list[str],
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int = 0,
    **fit_options: Any,
) -> dict[str, Any]:
    """What the fits before a field test expected of it, aircraft weighted alike.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    start : date
        First day of the test: nothing from it on is looked at.
    corrected : list of str
        Aircraft corrected in the test.
    pools : mapping of str to list of str
    reference : str
        Key of ``pools``.
    seed : int, default 0
    **fit_options
        As for :func:`airswing.compass.deviation.fit_deviation`.

    Returns
    -------
    dict
        ``ranking`` of all aircraft before the test, and ``predicted_reduction_kt`` with
        ``predicted_reduction_ci_kt`` of the corrected that had a fit (None without any):
        what to hold the adjusted reduction against.
    """
    _require_reference(pools, reference)
    before = only(headings, headings["time"].to_numpy() < np.datetime64(start))
    fits = _fitted(before, pools, reference, fit_options)
    ranking = rank_aircraft(before, fits, pools=pools, reference=reference, seed=seed)
    known = [
        entry
        for entry in ranking
        if entry["aircraft"] in corrected and entry["expected_gain_kt"] is not None
    ]
    result: dict[str, Any] = {
        "ranking": ranking,
        "predicted_reduction_kt": None,
        "predicted_reduction_ci_kt": None,
        "predicted_aircraft": len(known),
    }
    if known:
        mean = float(np.mean([entry["expected_gain_kt"] for entry in known]))
        errors = [entry["expected_gain_standard_error_kt"] for entry in known]
        wide = float(np.sqrt(np.sum(np.square(errors))) / len(known))
        result["predicted_reduction_kt"] = mean
        result["predicted_reduction_ci_kt"] = [mean - 1.96 * wide, mean + 1.96 * wide]
    return result


def _fitted(
    headings: xr.Dataset, pools: Mapping[str, list[str]], reference: str, options: dict[str, Any]
) -> xr.Dataset:
    """Fit and tables against one reference or pool."""
    members = list(pools[reference])
    part = headings.sel(reference=members)
    fits = fit_deviation(part, pools={reference: members}, alone=False, **options)
    attributes = fits.attrs
    fits = fits.sel(reference=[reference])
    fits.attrs = {**attributes, "reference_count": 1}
    return add_tables(fits, part)


def _method(name: str) -> Any:
    if name not in ("table", "curve"):
        raise InputError(
            "no such way to correct", field="method", found=name, remedy="table or curve"
        )
    return name


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


def _require_reference(pools: Mapping[str, list[str]], reference: str) -> None:
    if reference not in pools:
        raise InputError(
            "no such reference or pool",
            field="reference",
            found=reference,
            remedy=f"Known: {', '.join(pools)}",
        )


def _require_reports(
    headings: xr.Dataset, learn: NDArray[np.bool_], judge: NDArray[np.bool_], until: date
) -> None:
    kept = headings["screening"].to_numpy() == 0
    for words, part in (("before", learn), ("from", judge)):
        if not (kept & part).any():
            span = headings["time"].to_numpy()
            raise InputError(
                f"the virtual field test has no screened report {words} {until}",
                field="learned_until",
                found=f"reports from {str(span.min())[:10]} to {str(span.max())[:10]}",
                remedy="Choose a date inside the archive",
            )


def _distances(
    headings: xr.Dataset, mended: xr.Dataset, members: list[str]
) -> tuple[Floats, Floats]:
    """Disagreement of every report as reported and as corrected, kt."""
    winds = reference_mean(headings, members)
    reference = (
        winds["reference_eastward_wind"].to_numpy(),
        winds["reference_northward_wind"].to_numpy(),
    )
    pairs = (
        (headings["eastward_wind"], headings["northward_wind"]),
        (mended["corrected_eastward_wind"], mended["corrected_northward_wind"]),
    )
    before, after = (
        vector_difference(u.to_numpy(), v.to_numpy(), *reference) / KNOT for u, v in pairs
    )
    return np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)


def _groups(
    headings: xr.Dataset,
    before: Floats,
    after: Floats,
    kept: NDArray[np.bool_],
    learn: NDArray[np.bool_],
    judge: NDArray[np.bool_],
    treated: NDArray[np.bool_],
) -> dict[str, Any]:
    """The seed's table: the corrected as corrected after the date, the controls as reported."""
    row = treated[aircraft_of_report(headings)]
    found = {}
    for group, member in (("controls", ~row), ("corrected", row)):
        early, late = kept & learn & member, kept & judge & member
        if not early.any() or not late.any():
            continue
        found[group] = {
            "aircraft": int((treated if group == "corrected" else ~treated).sum()),
            "before_kt": float(before[early].mean()),
            "during_kt": float(after[late].mean()),
            "during_uncorrected_kt": float(before[late].mean()),
            "reduction_kt": float(before[early].mean() - after[late].mean()),
            "reports_before": int(early.sum()),
            "reports_during": int(late.sum()),
        }
    return found


def _compared(
    headings: xr.Dataset,
    before: Floats,
    after: Floats,
    judged: NDArray[np.bool_],
    ranking: list[dict[str, Any]],
    *,
    draws: int,
    seed: int,
) -> dict[str, Any]:
    """Predicted and realised gain, each aircraft and together."""
    row = aircraft_of_report(headings)
    day = headings["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    gain = before - after
    predicted = {entry["aircraft"]: entry for entry in ranking}
    entries, weights = [], []
    for k, name in enumerate(headings["aircraft"].to_numpy().astype(str)):
        here = judged & (row == k)
        known = predicted[name]
        if not here.any() or known["expected_gain_kt"] is None:
            continue
        mean, drawn = _bootstrapped(gain[here], day[here], draws=draws, seed=seed)
        entries.append(
            {
                "aircraft": name,
                "reports": int(here.sum()),
                **_side_by_side(
                    known["expected_gain_kt"],
                    known["expected_gain_standard_error_kt"],
                    mean,
                    drawn,
                ),
            }
        )
        weights.append(here.sum())
    if not entries:
        return {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}
    share = np.array(weights, dtype=float) / np.sum(weights)
    together = float(share @ [entry["predicted_gain_kt"] for entry in entries])
    spread = share @ np.diag([entry["predicted_standard_error_kt"] ** 2 for entry in entries])
    chosen = judged & np.isin(
        headings["aircraft"].to_numpy().astype(str)[row], [entry["aircraft"] for entry in entries]
    )
    mean, drawn = _bootstrapped(gain[chosen], day[chosen], draws=draws, seed=seed)
    return _side_by_side(together, float(np.sqrt(spread @ share)), mean, drawn) | {
        "reports": int(chosen.sum()),
        "by_aircraft": entries,
    }


def _side_by_side(predicted: float, error: float, realised: float, drawn: Floats) -> dict[str, Any]:
    own = float(drawn.std())
    difference, wide = realised - predicted, float(np.hypot(error, own))
    return {
        "predicted_gain_kt": predicted,
        "predicted_standard_error_kt": error,
        "predicted_gain_ci_kt": [predicted - 1.96 * error, predicted + 1.96 * error],
        "realised_gain_kt": realised,
        "realised_gain_ci_kt": [float(value) for value in np.percentile(drawn, [2.5, 97.5])],
        "difference_kt": difference,
        "difference_ci_kt": [difference - 1.96 * wide, difference + 1.96 * wide],
        "agree": bool(abs(difference) <= 1.96 * wide),
    }


def _bootstrapped(
    gain: Floats, day: NDArray[np.int64], *, draws: int, seed: int
) -> tuple[float, Floats]:
    """Mean gain and its draws, days drawn again with replacement."""
    _, index = np.unique(day, return_inverse=True)
    days = int(index.max()) + 1
    total, count = np.bincount(index, weights=gain), np.bincount(index)
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(days, np.full(days, 1.0 / days), size=draws).astype(float)
    # Stretched by sqrt(n / (n - 1)): drawing n of n days again varies too little.
    weights = 1.0 + (weights - 1.0) * np.sqrt(days / max(days - 1.0, 1.0))
    return float(gain.mean()), np.asarray((weights @ total) / np.maximum(weights @ count, 1.0))
