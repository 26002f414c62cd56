"""The field test: what the corrected aircraft gained beyond what the model did to everyone.

Assumes the corrected aircraft reported corrected winds from ``start`` on and the controls never
did, so that the controls' change is the model's. The measure is the mean magnitude of the wind
vector disagreement (Jacobs et al. 2010, Table 1). Its change is taken linearly, as the seed
does, and in quadrature, because independent errors add in quadrature. Days are the units of the
bootstrap: every flight of a day shares the model's error. Aircraft are usually chosen for bad
winds, so the permutation test regresses the level during the test on the level before it:
conditional on what the choice was made from, group labels are exchangeable without an effect.
Where the groups hardly overlap before the test that conditioning costs most of the power; the
plain permutation of labels, right only for a choice that ignored the level, stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import NotRequired, TypedDict, TypeVar, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.day_sums import (
    GROUPS,
    WINDOWS,
    DayPart,
    DaySums,
    Floats,
    bootstrap,
    interval_95,
)
from airswing.evaluation.disagreement import (
    disagreement_sums,
    measures_of,
    reference_mean,
    vector_difference,
)
from airswing.evaluation.results import Content
from airswing.evaluation.robustness import scrutinise
from airswing.flags import ROLL, SCREENING, TEMPERATURE_QC
from airswing.products.findings import findings
from airswing.products.ragged import aircraft_of_report, blocks, time_span
from airswing.units import KNOT

_COLUMNS = (
    "time",
    "screening",
    "roll_flag",
    "temperature_qc",
    "heading",
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
)
_NEVER = ("no_ground_vector", "no_reference", "missing_wind", "wind_qc", "gross_error")


_Numbers = TypeVar("_Numbers", float, Floats)


def adjusted_reductions(
    corrected_before: _Numbers,
    corrected_during: _Numbers,
    controls_before: _Numbers,
    controls_during: _Numbers,
) -> tuple[_Numbers, _Numbers]:
    """Reduction of the corrected group beyond the controls', linearly and in quadrature.

    Parameters
    ----------
    corrected_before, corrected_during, controls_before, controls_during : float or array
        Mean wind vector disagreement, any one unit.

    Returns
    -------
    linear, quadrature : float or array
        The seed's difference of differences, and the distance below
        ``sqrt(corrected_before**2 + controls_during**2 - controls_before**2)``, the level the
        corrected group would have reached untreated when errors add in quadrature.
    """
    linear = (corrected_before - corrected_during) - (controls_before - controls_during)
    untreated = np.sqrt(
        np.maximum(corrected_before**2 + controls_during**2 - controls_before**2, 0.0)
    )
    return linear, untreated - corrected_during


class FieldTest(TypedDict):
    """What a field test is."""

    # start, before_start, end: the test runs from ``start`` to ``end`` (default: the archive's
    # end), the window before it from ``before_start`` to ``start``
    start: date
    before_start: date
    # corrected, controls: aircraft of each group
    corrected: list[str]
    controls: list[str]
    end: NotRequired[date | None]
    # roll, temperature_qc: ``require_good`` / ``require_pass`` (the seed's rule, the default; a
    # flag that no report of the archive carries cannot be required and is named in ``notes``), or
    # ``ignore``
    roll: NotRequired[str]
    temperature_qc: NotRequired[str]


def field_test(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    draws: int = 2000,
    seed: int = 0,
    **test: Unpack[FieldTest],
) -> Content:
    """Compute the field test of two groups of aircraft.

    Parameters
    ----------
    headings : Dataset
        Screened headings; the winds are as reported.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Key of ``pools`` the headline is measured against.
    draws : int, default 2000
        Bootstrap and permutation draws.
    seed : int, default 0
    **test
        Dates, groups and rules, as in :class:`FieldTest`.

    Returns
    -------
    FieldTestFound
        A dict with the content of ``field_test.json``, but for what was expected of the test;
        disagreements in knots.

    Raises
    ------
    InputError
        If a group names an unknown aircraft or a window holds no report of a group.
    """
    corrected, controls, end = test["corrected"], test["controls"], test.get("end")
    _require_known(headings, corrected, controls)
    required, notes = _rules(
        headings,
        roll=test.get("roll", "require_good"),
        temperature_qc=test.get("temperature_qc", "require_pass"),
    )
    window = _Window.of(headings, start=test["start"], before_start=test["before_start"], end=end)
    names = headings["aircraft"].to_numpy().astype(str)
    member = np.isin(names, [*corrected, *controls])
    days: dict[str, list[DayPart]] = {key: [] for key in pools}
    measured: dict[tuple[str, str], list[Floats]] = {}
    for block in blocks(headings, _COLUMNS):
        number = window.number(block)
        chosen = _eligible(block, required) & (number >= 0)
        for key, members in pools.items():
            difference = _difference(block, members)
            days[key].append(
                DayPart.of(block, difference, chosen & np.isfinite(difference), number)
            )
        groups = {"controls": controls, "corrected": corrected}
        for cell, part in _measures(block, pools[reference], chosen, number, groups).items():
            measured.setdefault(cell, []).append(part)
    treated = np.isin(names[member], corrected)
    sums = {key: DaySums.of(days[key], member, treated) for key in pools}
    by_reference = {key: _headline(own, draws=draws, seed=seed) for key, own in sums.items()}
    result: Content = {
        "reference": reference,
        "start": str(test["start"]),
        "before_start": str(test["before_start"]),
        "end": str(end) if end else None,
        "notes": notes,
        **by_reference[reference],
        **scrutinise(sums[reference], names[member], draws=draws, seed=seed),
        "components": _components(measured),
        "by_reference": by_reference,
    }
    return findings(result)


def _headline(sums: DaySums, *, draws: int, seed: int) -> Content:
    """Groups, reductions and their intervals."""
    means = sums.means()
    empty = [key for key, value in means.items() if not np.isfinite(value)]
    if empty:
        raise InputError(
            "the field test has no usable report",
            field="field_test",
            found=f"group {empty[0][0]}, window {empty[0][1]}",
            remedy="Check the dates and the groups, or relax field_test.roll and temperature_qc",
        )
    linear, quadrature = adjusted_reductions(*_four(means))
    drawn = bootstrap(sums, draws=draws, seed=seed)
    groups: dict[str, Content] = {}
    for index, group in enumerate(GROUPS):
        chosen = sums.corrected if group == "corrected" else ~sums.corrected
        groups[group] = {
            "aircraft": int(chosen.sum()),
            "before_kt": means[group, "before"],
            "during_kt": means[group, "during"],
            "reduction_kt": means[group, "before"] - means[group, "during"],
            "reduction_ci_kt": interval_95(drawn[:, index, 0] - drawn[:, index, 1]),
            "before_ci_kt": interval_95(drawn[:, index, 0]),
            "during_ci_kt": interval_95(drawn[:, index, 1]),
            "reports_before": int(sums.count[chosen][:, ~sums.during].sum()),
            "reports_during": int(sums.count[chosen][:, sums.during].sum()),
        }
    spread = adjusted_reductions(drawn[:, 1, 0], drawn[:, 1, 1], drawn[:, 0, 0], drawn[:, 0, 1])
    return {
        "groups": groups,
        "adjusted_reduction_kt": linear,
        "adjusted_reduction_ci_kt": interval_95(spread[0]),
        "adjusted_reduction_quadrature_kt": quadrature,
        "adjusted_reduction_quadrature_ci_kt": interval_95(spread[1]),
        "days_before": int((~sums.during).sum()),
        "days_during": int(sums.during.sum()),
    }


def _four(means: Mapping[tuple[str, str], float]) -> tuple[float, float, float, float]:
    return (
        means["corrected", "before"],
        means["corrected", "during"],
        means["controls", "before"],
        means["controls", "during"],
    )


def _measures(
    headings: xr.Dataset,
    members: list[str],
    chosen: NDArray[np.bool_],
    window: NDArray[np.int64],
    groups: Mapping[str, list[str]],
) -> dict[tuple[str, str], Floats]:
    """Sums behind every measure, of each aircraft of a block, by group and window."""
    winds = reference_mean(headings, members)
    names = headings["aircraft"].to_numpy().astype(str)
    row = aircraft_of_report(headings)
    found = {}
    for group, aircraft in groups.items():
        own = np.isin(names, aircraft)
        for index, name in enumerate(WINDOWS):
            take = chosen & (window == index) & own[row]
            found[group, name] = disagreement_sums(
                headings["eastward_wind"].to_numpy()[take],
                headings["northward_wind"].to_numpy()[take],
                winds["reference_eastward_wind"].to_numpy()[take],
                winds["reference_northward_wind"].to_numpy()[take],
                np.radians(headings["heading"].to_numpy()[take]),
                row[take],
                names.size,
            )
    return found


def _components(
    measured: Mapping[tuple[str, str], list[Floats]],
) -> dict[str, dict[str, dict[str, float]]]:
    """Every measure of disagreement by group and window, m/s."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for (group, name), sums in measured.items():
        total = np.concatenate(sums, axis=1).sum(axis=1)
        found.setdefault(group, {})[name] = measures_of(total)
    return found


def _require_known(headings: xr.Dataset, corrected: list[str], controls: list[str]) -> None:
    known = set(headings["aircraft"].to_numpy().astype(str))
    unknown = [name for name in [*corrected, *controls] if name not in known]
    if unknown:
        raise InputError(
            "a group names an aircraft the archive does not hold",
            field="field_test",
            found=", ".join(unknown[:5]),
            remedy=f"Known aircraft: {', '.join(sorted(known)[:20])}",
        )
    both = sorted(set(corrected) & set(controls))
    if both or not corrected or not controls:
        raise InputError(
            "aircraft in both groups" if both else "a group names no aircraft",
            field="field_test",
            found=", ".join(both) or ("corrected" if not corrected else "controls"),
            remedy="Every aircraft is either corrected or a control",
        )


def _rules(
    headings: xr.Dataset, *, roll: str, temperature_qc: str
) -> tuple[list[tuple[str, int, bool]], list[str]]:
    """Flags to ask for (name, code, whether it must or must not be), and what cannot be asked."""
    rules, notes = [], []
    for name, policy, codes, good in (
        ("roll_flag", roll, ROLL, "good"),
        ("temperature_qc", temperature_qc, TEMPERATURE_QC, "pass"),
    ):
        if policy.startswith("require"):
            some = any((part[name] != codes["missing"]).any() for part in blocks(headings, [name]))
            if not some:
                notes.append(f"no report carries {name}: it could not be required")
                continue
            rules.append((name, codes[good], True))
        elif policy.startswith("reject"):
            rules.append((name, codes["bad" if name == "roll_flag" else "fail"], False))
    return rules, notes


def _eligible(headings: xr.Dataset, rules: list[tuple[str, int, bool]]) -> NDArray[np.bool_]:
    """Reports that count."""
    bits = sum(SCREENING[name] for name in _NEVER)
    chosen = (headings["screening"].to_numpy() & bits) == 0
    for name, code, must in rules:
        chosen &= (headings[name].to_numpy() == code) == must
    return np.asarray(chosen)


@dataclass(frozen=True)
class _Window:
    """The window before, from ``before`` to ``start``, and that of the test, to ``last``."""

    before: np.datetime64
    start: np.datetime64
    last: np.datetime64

    @classmethod
    def of(
        cls, headings: xr.Dataset, *, start: date, before_start: date, end: date | None
    ) -> _Window:
        if end is None:
            last = time_span(headings)[1] + np.timedelta64(1, "s")
        else:
            last = np.datetime64(end)
        return cls(np.datetime64(before_start), np.datetime64(start), last)

    def number(self, headings: xr.Dataset) -> NDArray[np.int64]:
        """0 before, 1 during, -1 outside, for every report."""
        time = headings["time"].to_numpy()
        window = np.full(time.size, -1, dtype=np.int64)
        window[(time >= self.before) & (time < self.start)] = 0
        window[(time >= self.start) & (time < self.last)] = 1
        return window


def _difference(headings: xr.Dataset, members: list[str]) -> NDArray[np.float64]:
    winds = reference_mean(headings, members)
    found = vector_difference(
        headings["eastward_wind"].to_numpy(),
        headings["northward_wind"].to_numpy(),
        winds["reference_eastward_wind"].to_numpy(),
        winds["reference_northward_wind"].to_numpy(),
    )
    return np.asarray(found / KNOT, dtype=np.float64)
