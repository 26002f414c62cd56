"""The virtual field test: corrections learned from some flights, judged on others.

Assumes nothing of the aircraft but that their compasses stay as they are (see
:mod:`airswing.evaluation.stability`). The correction is learned up to a date and applied to the
reports after it; or, in cross-validation, learned from all but a fold of whole flights and applied
to that fold. What was predicted from the fit alone stands beside what came out. Reports are the
screened ones; the realised gain is paired (the same report before and after its correction), so
the model's own error hardly enters; its interval is a bootstrap over days.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import correct
from airswing.compass.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.evaluation.disagreement import KNOT, reference_mean, vector_difference
from airswing.evaluation.folds import Choice, Folds, flight_folds, only
from airswing.evaluation.ranking import rank_aircraft
from airswing.ragged import aircraft_of_report, blocks, row_bounds, time_span
from airswing.vocabulary import CORRECTION

Floats = NDArray[np.float64]
_JUDGED = (
    "time", "flight", "eastward_wind", "northward_wind", "airspeed", "heading", "magnetic_heading",
    "screening", "reference_eastward_wind", "reference_northward_wind",
)  # fmt: skip
"""Columns a correction is made from and judged by."""


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

    def learn(reports: xr.Dataset) -> NDArray[np.bool_]:
        time = reports["time"].to_numpy()
        chosen = time < np.datetime64(learned_until)
        if learned_from is not None:
            chosen &= time >= np.datetime64(learned_from)
        return np.asarray(chosen)

    def judge(reports: xr.Dataset) -> NDArray[np.bool_]:
        time = reports["time"].to_numpy()
        chosen = time >= np.datetime64(learned_until)
        if end is not None:
            chosen &= time < np.datetime64(end)
        return np.asarray(chosen)

    _require_reports(headings, learn, judge, learned_until)
    part = only(headings, learn)
    fits = _fitted(part, pools, reference, fit_options)
    ranking = rank_aircraft(part, fits, pools=pools, reference=reference, seed=seed)
    windows, gains = [], []
    for block, aircraft in _blocks(headings):
        apart = Apart.of(block, fits, pools[reference], reference, method)
        corrected_here = treated[aircraft][aircraft_of_report(block)]
        after = np.where(corrected_here, apart.after, apart.before)
        kept = (block["screening"].to_numpy() == 0) & np.isfinite(apart.before + apart.after)
        late = kept & judge(block)
        windows.append(_windows(block, apart.before, after, kept & learn(block), late))
        judged = late & apart.done & corrected_here
        gains += gains_of(block, apart.before - after, judged)
    result: dict[str, Any] = {
        "reference": reference,
        "learned_until": str(learned_until),
        "method": method,
        "groups": _groups(np.concatenate(windows, axis=1), treated),
    }
    return result | _compared(headings, gains, ranking, draws=draws, seed=seed)


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
    dealt = flight_folds(headings, folds=folds, seed=seed)

    def without(fold: int) -> xr.Dataset:
        return only(headings, lambda reports: dealt.of(reports) != fold)

    fits = [_fitted(without(fold), pools, reference, fit_options) for fold in range(folds)]
    whole = _fitted(headings, pools, reference, fit_options)
    ranking = rank_aircraft(headings, whole, pools=pools, reference=reference, seed=seed)
    gains, own_gains = [], []
    for block, _ in _blocks(headings):
        before, after, done = _held_out(block, dealt, fits, pools[reference], reference, method)
        own = Apart.of(block, whole, pools[reference], reference, method)
        judged = (block["screening"].to_numpy() == 0) & np.isfinite(before + after) & done
        gains += gains_of(block, before - after, judged)
        own_gains += gains_of(block, own.before - own.after, judged)
    reports = sum(gain.reports for gain in gains)
    if not reports:
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
        "in_sample_gain_kt": sum(float(gain.total.sum()) for gain in own_gains) / reports,
    }
    return result | _compared(headings, gains, ranking, draws=draws, seed=seed)


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
    before = only(headings, lambda reports: reports["time"].to_numpy() < np.datetime64(start))
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


def _blocks(headings: xr.Dataset) -> Iterator[tuple[xr.Dataset, slice]]:
    """Blocks of aircraft with the columns a correction is judged by, and which aircraft."""
    start = 0
    for block in blocks(headings, _JUDGED):
        stop = start + block.sizes["aircraft"]
        yield block, slice(start, stop)
        start = stop


class Apart(NamedTuple):
    """Disagreement of reports with the reference, as reported and as corrected.

    Attributes
    ----------
    before, after : array, shape (report,)
        Knots.
    done : array of bool, shape (report,)
        Whether the report could be corrected.
    """

    before: Floats
    after: Floats
    done: NDArray[np.bool_]

    @classmethod
    def of(
        cls, reports: xr.Dataset, fits: xr.Dataset, members: list[str], reference: str, method: str
    ) -> Apart:
        """Correct some reports by some fits and measure them."""
        mended = correct(reports, fits, reference=reference, method=_method(method))
        winds = reference_mean(reports, members)
        model = (
            winds["reference_eastward_wind"].to_numpy(),
            winds["reference_northward_wind"].to_numpy(),
        )
        pairs = (
            (reports["eastward_wind"], reports["northward_wind"]),
            (mended["corrected_eastward_wind"], mended["corrected_northward_wind"]),
        )
        before, after = (
            np.asarray(vector_difference(u.to_numpy(), v.to_numpy(), *model) / KNOT, dtype=float)
            for u, v in pairs
        )
        done = mended["correction_applied"].to_numpy() == CORRECTION["corrected"]
        return cls(before, after, done)


def _held_out(
    block: xr.Dataset,
    dealt: Folds,
    fits: list[xr.Dataset],
    members: list[str],
    reference: str,
    method: str,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Each report corrected by the fit that never saw its flight."""
    number = dealt.of(block)
    before = after = np.full(number.size, np.nan)
    done = np.zeros(number.size, dtype=bool)
    for fold, fit in enumerate(fits):
        own = Apart.of(block, fit, members, reference, method)
        held = number == fold
        before = own.before
        after = np.where(held, own.after, after)
        done = np.where(held, own.done, done)
    return before, after, done


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
        [summed(learn), summed(learn, before), summed(judge), summed(judge, after),
         summed(judge, before)]
    )  # fmt: skip


def _groups(windows: Floats, treated: NDArray[np.bool_]) -> dict[str, Any]:
    """The seed's table: the corrected as corrected after the date, the controls as reported."""
    found = {}
    for group, member in (("controls", ~treated), ("corrected", treated)):
        learned, before, judged, after, uncorrected = windows[:, member].sum(axis=1)
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


class Gain(NamedTuple):
    """What one aircraft's judged reports gained, by day.

    Attributes
    ----------
    day : array of int, shape (day,)
        Increasing.
    total : array, shape (day,)
        Summed gain, knots.
    counts : array, shape (day,)
        Reports.
    """

    day: NDArray[np.int64]
    total: Floats
    counts: Floats

    @property
    def reports(self) -> int:
        """All of them."""
        return int(self.counts.sum())


def gains_of(block: xr.Dataset, gain: Floats, judged: NDArray[np.bool_]) -> list[Gain]:
    """Sum the gains of each aircraft of a block by day.

    Parameters
    ----------
    block : Dataset
    gain : array, shape (report,)
        Knots.
    judged : array of bool, shape (report,)
        Reports that count.

    Returns
    -------
    list of Gain
        One an aircraft.
    """
    day = block["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    found = []
    for start, stop in zip(*row_bounds(block["row_size"].to_numpy()), strict=True):
        chosen = np.flatnonzero(judged[start:stop]) + start
        days, index = np.unique(day[chosen], return_inverse=True)
        total = np.bincount(index, weights=gain[chosen], minlength=days.size)
        number = np.bincount(index, minlength=days.size)
        found.append(Gain(days, total.astype(np.float64), number.astype(np.float64)))
    return found


def _together(gains: list[Gain]) -> Gain:
    """Gains of a fleet by day."""
    days, index = np.unique(np.concatenate([gain.day for gain in gains]), return_inverse=True)

    def summed(parts: list[Floats]) -> Floats:
        return np.bincount(index, weights=np.concatenate(parts)).astype(np.float64)

    return Gain(
        days, summed([gain.total for gain in gains]), summed([gain.counts for gain in gains])
    )


def _compared(
    headings: xr.Dataset,
    gains: list[Gain],
    ranking: list[dict[str, Any]],
    *,
    draws: int,
    seed: int,
) -> dict[str, Any]:
    """Predicted and realised gain, each aircraft and together."""
    predicted = {entry["aircraft"]: entry for entry in ranking}
    entries, judged = [], []
    for name, gain in zip(headings["aircraft"].to_numpy().astype(str), gains, strict=True):
        known = predicted[name]
        if not gain.reports or known["expected_gain_kt"] is None:
            continue
        mean, drawn = _bootstrapped(gain, draws=draws, seed=seed)
        entries.append(
            {
                "aircraft": name,
                "reports": gain.reports,
                **_side_by_side(
                    known["expected_gain_kt"],
                    known["expected_gain_standard_error_kt"],
                    mean,
                    drawn,
                ),
            }
        )
        judged.append(gain)
    if not entries:
        return {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}
    weights = np.array([gain.reports for gain in judged], dtype=float)
    share = weights / weights.sum()
    together = float(share @ [entry["predicted_gain_kt"] for entry in entries])
    spread = share @ np.diag([entry["predicted_standard_error_kt"] ** 2 for entry in entries])
    mean, drawn = _bootstrapped(_together(judged), draws=draws, seed=seed)
    return _side_by_side(together, float(np.sqrt(spread @ share)), mean, drawn) | {
        "reports": int(weights.sum()),
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


def _bootstrapped(gain: Gain, *, draws: int, seed: int) -> tuple[float, Floats]:
    """Mean gain and its draws, days drawn again with replacement."""
    days = gain.day.size
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(days, np.full(days, 1.0 / days), size=draws).astype(float)
    # Stretched by sqrt(n / (n - 1)): drawing n of n days again varies too little.
    weights = 1.0 + (weights - 1.0) * np.sqrt(days / max(days - 1.0, 1.0))
    drawn = (weights @ gain.total) / np.maximum(weights @ gain.counts, 1.0)
    return float(gain.total.sum() / gain.counts.sum()), np.asarray(drawn)
