"""The field test: reduction of the corrected group's disagreement beyond that of the controls.

Assumes that the corrected aircraft reported corrected winds from ``start`` on and the controls
never did, so that the controls' change is the model's. The measure is the mean magnitude of the
wind vector disagreement (Jacobs et al. 2010, Table 1). Its change is computed linearly, as there,
and in quadrature, as independent errors add. Days are the units of the bootstrap.

Aircraft are usually chosen for bad winds, so that some of the reduction is regression to the mean.
The permutation test therefore regresses the level during the test on the level before it (where the
groups hardly overlap before the test this costs most of the power), and the same choice is also
made within the window before the test, where nothing was corrected. Knots, unless a name says
otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.screening import rejected
from airswing.errors import InputError
from airswing.evaluation import Content
from airswing.evaluation.innovations import chunks, require_reference
from airswing.evaluation.resampling import Floats, day_weights, interval, permutation_test, ratio
from airswing.flags import QC, ROLL, SCREENING
from airswing.products.ragged import blocks, time_span
from airswing.products.whole_files import Findings
from airswing.units import KNOT

GROUPS, WINDOWS = ("controls", "corrected"), ("before", "during")
_NEVER = ("no_ground_vector", "no_reference", "missing_wind", "wind_qc", "gross_error")
_Numbers = TypeVar("_Numbers", float, Floats)


def adjusted_reductions(
    corrected_before: _Numbers,
    corrected_during: _Numbers,
    controls_before: _Numbers,
    controls_during: _Numbers,
) -> tuple[_Numbers, _Numbers]:
    """Reduction of the corrected group beyond that of the controls, linearly and in quadrature.

    The difference of differences, and the distance below ``sqrt(corrected_before**2 +
    controls_during**2 - controls_before**2)``, the level the corrected group would have had
    untreated when errors add in quadrature.
    """
    linear = (corrected_before - corrected_during) - (controls_before - controls_during)
    square = corrected_before**2 + controls_during**2 - controls_before**2
    return linear, np.sqrt(np.maximum(square, 0.0)) - corrected_during


@dataclass(frozen=True)
class DaySums:
    """Reports and summed disagreement by aircraft and day."""

    count: Floats  # (aircraft, day)
    total: Floats  # (aircraft, day): kt
    corrected: NDArray[np.bool_]  # (aircraft,)
    during: NDArray[np.bool_]  # (day,): whether the day is in the test

    def means(self, weights: Floats) -> Floats:
        """Mean disagreement (draw, group, window) with days weighted (draw, day).

        NaN without a report; groups and windows are in the order of `GROUPS` and `WINDOWS`.
        """
        groups = np.stack([~self.corrected, self.corrected])
        count, total = groups @ self.count, groups @ self.total
        windows = [
            ratio(weights[:, days] @ total[:, days].T, weights[:, days] @ count[:, days].T)
            for days in (~self.during, self.during)
        ]
        return np.stack(windows, axis=-1)

    def levels(self, *periods: NDArray[np.bool_]) -> list[Floats]:
        """Mean disagreement of each aircraft over chosen days; NaN without a report."""
        return [ratio(self.total[:, days].sum(1), self.count[:, days].sum(1)) for days in periods]

    def bootstrap(self, *, draws: int, seed: int) -> Floats:
        """Bootstrap the means over days within each window: (draw, group, window)."""
        weights = np.ones((draws, self.during.size))
        for k, days in enumerate((~self.during, self.during)):
            options: Any = {"draws": draws, "seed": seed + 7919 * k, "length": 1}
            weights[:, days] = day_weights(int(days.sum()), **options)  # days are independent units
        return self.means(weights)


def field_test(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    start: date,
    before_start: date,
    corrected: list[str],
    controls: list[str],
    end: date | None = None,
    roll: str = "require_good",
    temperature_qc: str = "require_pass",
    draws: int = 2000,
    seed: int = 0,
) -> Content:
    """Compute the field test of two groups of aircraft.

    Parameters
    ----------
    headings : Dataset
        Screened headings; the winds are as reported.
    pools, reference : mapping of str to list of str, str
        Members of each reference and pool; name of the reference or pool to use.
    start, before_start : date
        First day of the test, and of the window before it.
    corrected, controls : list of str
        Aircraft of each group.
    end : date, optional
        Day after the test; the end of the archive by default.
    roll, temperature_qc : str
        ``require_good`` / ``require_pass`` (the rule of Jacobs et al. 2010; a flag that no report
        of the archive has cannot be required and is named in ``notes``), ``reject_...`` or
        ``ignore``.
    draws : int, default 2000
        Bootstrap and permutation draws.
    seed : int, default 0

    Returns
    -------
    dict
        Content of ``field_test.json`` except the expected reduction: ``groups`` (each with
        ``aircraft``, ``before_kt``, ``during_kt``, ``reduction_kt``, their ``*_ci_kt`` and
        ``reports_before``, ``reports_during``), ``adjusted_reduction_kt`` and
        ``adjusted_reduction_quadrature_kt`` with ``*_ci_kt``, ``days_before``, ``days_during``; the
        same ``by_reference``; ``permutation``, ``regression_to_the_mean``, ``matched_controls``,
        ``by_aircraft``; the dates, and ``notes``.

    Raises
    ------
    InputError
        If a group names an unknown aircraft, the reference is unknown, or a window has no report
        of a group.
    ConfigError
        On an unknown policy.

    Examples
    --------
    >>> from datetime import date
    >>> test = airswing.field_test(
    ...     headings,
    ...     pools={"ruc": ["ruc"]},
    ...     reference="ruc",
    ...     before_start=date(2009, 9, 16),
    ...     start=date(2009, 10, 1),
    ...     corrected=["N401", "N402"],
    ...     controls=["N403", "N404", "N405"],
    ...     roll="ignore",
    ...     temperature_qc="ignore",
    ...     draws=200,
    ... )
    >>> sorted(test["groups"])
    ['controls', 'corrected']
    """
    names = headings["aircraft"].to_numpy().astype(str)
    require_aircraft(names, corrected, "field_test.corrected")
    require_aircraft(names, controls, "field_test.controls")
    if shared := ", ".join(sorted(set(corrected) & set(controls))):
        remedy = "Every aircraft is either corrected or a control"
        raise InputError("aircraft in both groups", field="field_test", found=shared, remedy=remedy)
    require_reference(pools, reference)
    flags, notes = _flag_policies(headings, roll=roll, temperature_qc=temperature_qc)
    low, high = (time.astype("datetime64[D]").astype(np.int64) for time in time_span(headings))
    begin, switch = (int(np.datetime64(day).astype(np.int64)) for day in (before_start, start))
    stop = int(high) + 1 if end is None else int(np.datetime64(end).astype(np.int64))
    days = np.arange(max(int(low), begin), min(int(high), stop) + 1)
    member = np.where(np.isin(names, corrected), 1, np.where(np.isin(names, controls), 0, -1))
    sums = {key: np.zeros((2, names.size, days.size)) for key in pools}
    for chunk in chunks(headings, pools, ["screening", *flags]):
        used = (member[chunk.aircraft] >= 0) & (chunk.day >= begin) & (chunk.day < stop)
        used &= (chunk.block["screening"].to_numpy() & sum(SCREENING[name] for name in _NEVER)) == 0
        for name, (codes, policy) in flags.items():
            used &= ~rejected(chunk.block, name, codes, policy, "field_test").to_numpy()
        aircraft, day, wind = chunk.aircraft[used], chunk.day[used], chunk.wind[:, used]
        place = aircraft * days.size + day - max(int(low), begin)
        for key, model in chunk.model.items():
            difference = np.hypot(*(wind - model[:, used])) / KNOT
            good = np.isfinite(difference)
            for table, values in zip(sums[key], (good * 1.0, difference), strict=True):
                table.ravel()[:] += np.bincount(place[good], values[good], table.size)
    by_reference = {}
    for key, (count, total) in sums.items():
        rows, seen = member >= 0, count[member >= 0].any(axis=0)
        day_sums = DaySums(
            count[rows][:, seen], total[rows][:, seen], member[rows] == 1, days[seen] >= switch
        )
        by_reference[key] = _reductions(day_sums, draws=draws, seed=seed)
        if key == reference:
            checks = _checks(day_sums, names[rows], draws=draws, seed=seed)
    return Findings(
        {
            "reference": reference,
            "start": str(start),
            "before_start": str(before_start),
            "end": str(end) if end else None,
            "notes": notes,
            **by_reference[reference],
            **checks,
            "by_reference": by_reference,
        }
    )


def _reductions(sums: DaySums, *, draws: int, seed: int) -> Content:
    means = sums.means(np.ones((1, sums.during.size)))[0]
    if not np.isfinite(means).all():
        group, window = np.argwhere(~np.isfinite(means))[0]
        raise InputError(
            "the field test has no usable report",
            field="field_test",
            found=f"group {GROUPS[group]}, window {WINDOWS[window]}",
            remedy="Check the dates and the groups, or relax field_test.roll and temperature_qc",
        )
    drawn = sums.bootstrap(draws=draws, seed=seed)
    groups = {}
    for i, members in enumerate((~sums.corrected, sums.corrected)):
        entry: Content = {"aircraft": int(members.sum())}
        for j, window in enumerate(WINDOWS):
            entry[f"{window}_kt"] = float(means[i, j])
            entry[f"{window}_ci_kt"] = interval(drawn[:, i, j]).tolist()
            in_window = sums.during == bool(j)
            entry[f"reports_{window}"] = int(sums.count[members][:, in_window].sum())
        entry["reduction_kt"] = float(means[i, 0] - means[i, 1])
        entry["reduction_ci_kt"] = interval(drawn[:, i, 0] - drawn[:, i, 1]).tolist()
        groups[GROUPS[i]] = entry
    linear, quadrature = adjusted_reductions(*means[::-1].ravel().tolist())
    spread = adjusted_reductions(*drawn[:, ::-1].reshape(draws, 4).T)
    return {
        "groups": groups,
        "adjusted_reduction_kt": float(linear),
        "adjusted_reduction_ci_kt": interval(spread[0]).tolist(),
        "adjusted_reduction_quadrature_kt": float(quadrature),
        "adjusted_reduction_quadrature_ci_kt": interval(spread[1]).tolist(),
        "days_before": int((~sums.during).sum()),
        "days_during": int(sums.during.sum()),
    }


def _checks(sums: DaySums, names: NDArray[np.str_], *, draws: int, seed: int) -> Content:
    before, during = sums.levels(~sums.during, sums.during)
    good = np.isfinite(before) & np.isfinite(during)
    first, second, group = before[good], during[good], sums.corrected[good]
    effect, p_value = permutation_test(-second, group, covariate=first, draws=draws, seed=seed)
    matched: Content = {"adjusted_reduction_kt": None}
    change = first - second
    if group.any() and not group.all():
        # pair each corrected aircraft with the control of the nearest disagreement before the test
        distance = np.abs(first[group][:, np.newaxis] - first[~group])
        less = change[group] - change[~group][distance.argmin(axis=1)]
        matched["adjusted_reduction_kt"] = float(less.mean())
        matched["mean_distance_kt"] = float(distance.min(axis=1).mean())
    rows = zip(names, np.array(GROUPS)[sums.corrected.astype(int)], before, during, strict=True)
    columns = ("aircraft", "group", "before_kt", "during_kt")
    return {
        "permutation": {
            "effect_kt": effect,
            "p_value": p_value,
            "p_value_unconditional": permutation_test(change, group, draws=draws, seed=seed)[1],
            "draws": draws,
        },
        "regression_to_the_mean": regression_to_the_mean(sums),
        "matched_controls": matched,
        "by_aircraft": [
            dict(zip(columns, (value.item() for value in row), strict=True)) for row in rows
        ],
    }


def regression_to_the_mean(sums: DaySums) -> Content:
    """Spurious reduction of the aircraft that are worst in the first half of the window before.

    None and ``why`` where there are too few.
    """
    days = np.flatnonzero(~sums.during)
    half = np.zeros((2, sums.during.size), dtype=bool)
    half[0, days[: days.size // 2]] = half[1, days[days.size // 2 :]] = True
    early, late = sums.levels(*half)
    good = np.isfinite(early) & np.isfinite(late)
    number = int(sums.corrected.sum())
    if good.sum() <= number:
        return {"spurious_reduction_kt": None, "why": "too few days or aircraft before the test"}
    worst = np.zeros(good.size, dtype=bool)
    worst[np.flatnonzero(good)[np.argsort(-early[good])[:number]]] = True
    change = early - late
    return {
        "spurious_reduction_kt": float(change[worst].mean() - change[good & ~worst].mean()),
        "rule": f"the {number} aircraft with the largest disagreement in the first half of the "
        "window before, followed through its second half, minus the others' change",
    }


def require_aircraft(names: NDArray[np.str_], group: list[str], field: str) -> None:
    """Raise InputError for a group without aircraft, or with one that the archive does not hold."""
    unknown = [name for name in group if name not in set(names)]
    if unknown or not group:
        problem = "a group names an aircraft the archive does not hold"
        found, remedy = ", ".join(unknown[:5]), f"Known aircraft: {', '.join(sorted(names)[:20])}"
        if not group:
            problem, found = "the group names no aircraft", "an empty list"
        raise InputError(problem, field=field, found=found, remedy=remedy)


def _flag_policies(
    headings: xr.Dataset, *, roll: str, temperature_qc: str
) -> tuple[dict[str, tuple[dict[str, int], str]], list[str]]:
    """Codes and policy of each flag, and notes on flags that cannot be required."""
    flags = {"roll_flag": (ROLL, roll), "temperature_qc": (QC, temperature_qc)}
    notes = []
    for name, (codes, policy) in flags.items():
        columns = (block[name].to_numpy() for block in blocks(headings, [name]) if name in block)
        if policy.startswith("require") and not any(
            np.any(column != codes["missing"]) for column in columns
        ):
            flags[name] = codes, "ignore"
            notes.append(f"no report carries {name}: it could not be required")
    return flags, notes
