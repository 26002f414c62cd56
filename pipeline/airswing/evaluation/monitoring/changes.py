"""Changes of compasses within an archive, and fits by calendar window.

The test is the nightly one (:mod:`airswing.evaluation.monitoring.fleet_watch`; docs/method.md,
"Changes of a compass") with all days before and after a date. An archive is divided at the most
likely date, and each part again. Each report gives two equations, across and along the indicated
heading, in the unknowns :data:`UNKNOWNS`. The third and fourth harmonics absorb the residual of A
to E, which looks like a change when an aircraft flies other headings. Each flight has a bias, a
random effect that is eliminated. Dates are days, UTC; angles in degrees in the results.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import FITTED_FROM, fit_sums, sum_aircraft
from airswing.errors import InputError
from airswing.evaluation import Content
from airswing.evaluation.innovations import (
    Floats,
    Ints,
    member_mean,
    paired_design,
    require_reference,
)
from airswing.evaluation.monitoring.fleet_watch import COMPASS, Tested, month_of, watch_fleet
from airswing.evaluation.monitoring.step_test import Step, step_of_series
from airswing.flags import STATUS, published
from airswing.products.ragged import blocks, row_bounds, some_reports
from airswing.vocabulary import describe

FALSE_CHANGES = 0.02
"""Largest expected number of false changes in a fleet without any for which a change is stated."""
RATE = 1.0
"""Bound of the false steps of an aircraft-year whose log likelihood ratio exceeds c, over exp(-c).

``python -m benchmarks.monitoring --part changes`` measures less than this in every world.
"""
MOST_CHANGES = 4  # depth of the search: each part of an archive is divided at its most likely date
ANGLES = 5  # A, B, C, D, E
UNKNOWNS = 12  # A to E, sin 3m, cos 3m, sin 4m, cos 4m (radians), airspeed scale, b_u, b_v (m/s)
FLIGHT_BIAS_PRECISION = 1.0
"""Error variance of a report over that of a flight's bias: correlation of 0.5 within a flight."""
GROSS = 8.0  # robust standard deviations from a first fit beyond which a report is omitted


_CHANGE = {"count": "i1", "p_value": "f8", "rms": "f8"}
_CHANGE |= dict.fromkeys(("date", "date_low", "date_high"), "M8[ns]")


@dataclass(frozen=True)
class CompassDays:
    """Normal equations, one row for each aircraft and day, sorted by aircraft and day."""

    aircraft: Ints  # (row,)
    day: Ints  # (row,): days since 1970
    normal: NDArray[np.float32]  # (row, 12, 12)
    right: NDArray[np.float32]  # (row, 12)


@dataclass(frozen=True)
class CompassWatch:
    """The test of all compasses of an archive."""

    aircraft: NDArray[np.str_]
    days: CompassDays  # daily sums; their ``aircraft`` number the names
    tested: Tested  # alarms of the nightly test

    def __repr__(self) -> str:
        changed = [entry["aircraft"] for entry in self.changes if entry["changes"]]
        return (
            f"CompassWatch: {self.aircraft.size} aircraft, {self.days.day.size} days with reports; "
            f"changed: {', '.join(changed) or 'none'}"
        )

    @cached_property
    def changes(self) -> list[Content]:
        """Changes of every aircraft, in the form of ``stability.json``.

        One entry for each aircraft: ``aircraft``, ``days`` with reports, ``p_value`` and
        ``statistic`` of the largest step (None with too few days for a test), and ``changes``, each
        with ``date`` (first day of the new compass), ``date_ci``, ``change_deg`` and
        ``standard_error_deg`` of A to E, ``curve_rms_deg`` (rms over the compass) and ``p_value``:
        the expected number of changes as clear as this in a fleet without any.
        """
        slices = rows_by_aircraft(self.days.aircraft, self.aircraft.size)
        return [self._entry(number, rows) for number, rows in enumerate(slices)]

    def _entry(self, number: int, rows: slice) -> Content:
        scale, day = float(self.tested.scale[number]), self.days.day[rows]
        months = month_of(day)
        weight, right, common = (
            values[rows].astype(np.float64)
            for values in (self.days.normal, self.days.right, self.tested.common)
        )
        for month in np.unique(months):
            in_month, noise = months == month, self.tested.noise[int(month)]
            weight[in_month], right[in_month] = noise.weights(weight[in_month], right[in_month])
        right -= np.einsum("nij,nj->ni", weight, common)  # without the fleet's common part

        def step(low: int, high: int) -> Step | None:
            if low >= high:
                return None
            noise = self.tested.noise[int(months[high - 1])]
            span = slice(low, high)
            return step_of_series(COMPASS.law, noise, scale, day[span], weight[span], right[span])

        def stated(steps: list[Step | None]) -> list[Step]:
            present = [item for item in steps if item is not None]
            return [item for item in present if self.false_changes(item.statistic) <= FALSE_CHANGES]

        first = step(0, day.size)
        new, edges = stated([first]), [0, day.size]
        for _ in range(MOST_CHANGES):
            if not new:
                break
            edges = sorted({*edges, *np.searchsorted(day, [item.day for item in new]).tolist()})
            new = stated([step(*ends) for ends in pairwise(edges)])
        # test each date again between its neighbours, so that its error is that of both parts
        changes = stated([step(*ends) for ends in zip(edges[:-2], edges[2:], strict=True)])
        return {
            "aircraft": str(self.aircraft[number]),
            "days": day.size,
            "p_value": None if first is None else self.false_changes(first.statistic),
            "statistic": None if first is None else first.statistic,
            "changes": [
                {"date": date_of(change.day)}
                | step_numbers(change)
                | {"p_value": self.false_changes(change.statistic)}
                for change in changes
            ],
        }

    def false_changes(self, statistic: float) -> float:
        """Expected number of steps beyond a statistic in a fleet without any, at most 1."""
        years = self.days.day.size / 365.25
        return float(min(RATE * years * np.exp(-statistic), 1.0))


def compass_days(headings: xr.Dataset, members: list[str], *, abscissa: str) -> CompassDays:
    """Sum the reports of a fleet, against the mean of some references, for changes of compasses.

    ``abscissa`` is the argument of the deviation: ``magnetic`` or ``true``.
    """
    argument = "magnetic_heading" if abscissa == "magnetic" else "heading"
    names = [argument, "heading", "airspeed", "heading_error", "airspeed_error"]
    empty = np.zeros(0, np.int64)
    parts: list[tuple[NDArray[np.generic], ...]] = [
        (empty, empty, np.zeros((0, UNKNOWNS, UNKNOWNS), "f4"), np.zeros((0, UNKNOWNS), "f4"))
    ]
    first = 0
    for block in blocks(headings, [*names, "time", "flight", "screening"]):
        mean = member_mean(block.sel(reference=members)[names[3:]])
        values = [
            (mean if name in mean else block)[name].to_numpy().astype(float) for name in names
        ]
        good = np.isfinite(sum(values)) & (block["screening"].to_numpy() == 0)
        magnetic, heading, airspeed, error, along = values
        columns = (
            *(np.radians(magnetic), np.radians(heading), airspeed, np.radians(error), along),
            block["time"].to_numpy().astype("datetime64[D]").astype(np.int64),
            block["flight"].to_numpy().astype(np.int64),
        )
        bounds = zip(*row_bounds(block["row_size"].to_numpy()), strict=True)
        for number, (start, stop) in enumerate(bounds, first):
            rows = np.flatnonzero(good[start:stop]) + start
            if rows.size:
                days, normal, right = _normal_equations(*(column[rows] for column in columns))
                # in single precision: a large fleet has millions of these matrices
                sums = normal.astype(np.float32), right.astype(np.float32)
                parts.append((np.full(days.size, number), days, *sums))
        first += block.sizes["aircraft"]
    return CompassDays(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _normal_equations(
    magnetic: Floats,
    heading: Floats,
    airspeed: Floats,
    error: Floats,
    along: Floats,
    day: Ints,
    flight: Ints,
) -> tuple[Ints, Floats, Floats]:
    """Normal equations of one aircraft by day, each flight's bias eliminated.

    Angles (n,) in radians, speeds in m/s. Returns the days (d,), normal matrices (d, 12, 12) and
    right sides (d, 12).
    """
    across, ahead = compass_design(magnetic, heading, airspeed)
    cross = airspeed * error
    used = np.flatnonzero(_not_gross(across, ahead, cross, along))
    order = used[np.lexsort((flight[used], day[used]))]
    # a flight past midnight is one flight of each day
    new = (np.diff(day[order]) != 0) | (np.diff(flight[order]) != 0)
    start = np.flatnonzero(np.append(order.size > 0, new))
    across, ahead, cross, along = across[:, order], ahead[:, order], cross[order], along[order]
    normal, right = np.empty((start.size, UNKNOWNS, UNKNOWNS)), np.empty((start.size, UNKNOWNS))
    # by pairs of columns: no loop over flights, and no matrix for each report
    for i in range(UNKNOWNS):
        right[:, i] = np.add.reduceat(across[i] * cross + ahead[i] * along, start)
        for j in range(i, UNKNOWNS):
            products = across[i] * across[j]
            if ahead[i].any():  # zero for angles
                products += ahead[i] * ahead[j]
            normal[:, i, j] = normal[:, j, i] = np.add.reduceat(products, start)
    normal, right = without_flight_bias(normal, right)
    days, first = np.unique(day[order], return_index=True)
    place = np.searchsorted(start, first)
    return days, np.add.reduceat(normal, place), np.add.reduceat(right, place)


def compass_design(magnetic: Floats, heading: Floats, airspeed: Floats) -> tuple[Floats, Floats]:
    """The two equations of each report in the unknowns :data:`UNKNOWNS`, each (12, n).

    Headings in radians, airspeed in m/s.
    """
    cross, along = paired_design(magnetic, heading, airspeed)
    waves = [wave(k * magnetic) for k in (3, 4) for wave in (np.sin, np.cos)]
    place = [ANGLES] * len(waves)
    return np.insert(cross, place, airspeed * waves, axis=0), np.insert(along, place, 0.0, axis=0)


def without_flight_bias(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Eliminate a bias of the reference's wind of each flight, a random effect.

    ``normal`` (..., p, p) and ``right`` (..., p) are of one flight each; the columns of b_u, b_v
    come last.
    """
    side = normal[..., -2:]
    inside = side[..., -2:, :] + FLIGHT_BIAS_PRECISION * np.eye(2)
    gain = np.swapaxes(np.linalg.solve(inside, np.swapaxes(side, -1, -2)), -1, -2)
    return (
        normal - gain @ np.swapaxes(side, -1, -2),
        right - np.einsum("...ij,...j->...i", gain, right[..., -2:]),
    )


def _not_gross(across: Floats, ahead: Floats, cross: Floats, along: Floats) -> NDArray[np.bool_]:
    """Reports within :data:`GROSS` robust standard deviations of a first fit."""
    keep = np.isfinite(cross + along)
    for _ in range(2):
        a, b = (rows if keep.all() else rows[:, keep] for rows in (across, ahead))
        theta = np.linalg.pinv(a @ a.T + b @ b.T, hermitian=True) @ (
            a @ cross[keep] + b @ along[keep]
        )
        distance = np.hypot(cross - theta @ across, along - theta @ ahead)
        # the median of a Rayleigh variable is 1.177 times its parameter
        keep = distance < GROSS * np.nanmedian(distance[keep]) / 1.177
    return np.asarray(keep)


def rows_by_aircraft(aircraft: Ints, number: int) -> list[slice]:
    """Rows of each aircraft, in sorted sums."""
    bounds = row_bounds(np.bincount(aircraft, minlength=number))
    return [slice(*ends) for ends in np.transpose(bounds).tolist()]


def step_numbers(step: Step) -> Content:
    """Date interval, size and error of a compass's step for JSON; degrees."""
    degrees, error = np.degrees(step.change[:5]), np.degrees(step.error[:5])
    return {
        "date_ci": [date_of(step.earliest), date_of(step.latest)],
        "change_deg": dict(zip("ABCDE", degrees.tolist(), strict=True)),
        "standard_error_deg": dict(zip("ABCDE", error.tolist(), strict=True)),
        # rms of A + B sin m + C cos m + D sin 2m + E cos 2m over all m
        "curve_rms_deg": float(np.sqrt(degrees[0] ** 2 + (degrees[1:] ** 2).sum() / 2.0)),
    }


def date_of(day: int) -> str:
    """ISO date of a day since 1970."""
    return str(np.datetime64(int(day), "D"))


def watch_compasses(
    headings: xr.Dataset, *, members: list[str], abscissa: Literal["magnetic", "true"] = "magnetic"
) -> CompassWatch:
    """Test the compasses of a fleet for changes.

    Parameters
    ----------
    headings : Dataset
        Screened headings of the whole archive, in memory or lazy.
    members : list of str
        References whose mean is used.
    abscissa : {"magnetic", "true"}
        Argument of the deviation.

    Returns
    -------
    CompassWatch
        Argument of :func:`add_changes` (its ``changes``) and
        :func:`airswing.evaluation.monitoring.events.find_events`.

    Examples
    --------
    >>> watch = airswing.watch_compasses(headings, members=["ruc"])
    >>> [entry["aircraft"] for entry in watch.changes][:2]
    ['N401', 'N402']
    """
    days = compass_days(headings, members, abscissa=abscissa)
    return compass_watch(headings["aircraft"].to_numpy().astype(str), days)


def compass_watch(aircraft: NDArray[np.str_], days: CompassDays) -> CompassWatch:
    """Same as :func:`watch_compasses`, from daily sums."""
    tested = watch_fleet(days.aircraft, days.day, days.normal, days.right, COMPASS, aircraft.size)
    return CompassWatch(aircraft, days, tested)


def add_changes(fits: xr.Dataset, changes: list[Content]) -> xr.Dataset:
    """Add to the fits whether their period contains a change of the compass.

    ``changes`` are those of a :class:`CompassWatch`. Adds ``change_count``, ``change_p_value`` (NaN
    with too few days for a test), and of the largest change ``change_rms``, ``change_date``,
    ``change_date_low``, ``change_date_high`` (NaT where there is none); all changes in the
    attribute ``compass_changes``, which :func:`noted_changes` reads.
    """
    by_aircraft = {entry["aircraft"]: entry for entry in changes}
    unchanged: Content = {"curve_rms_deg": 0.0, "date": "NaT", "date_ci": ["NaT", "NaT"]}
    columns = [(f"change_{key}", kind) for key, kind in _CHANGE.items()]
    rows = []
    for name in fits["aircraft"].to_numpy():
        entry = by_aircraft.get(str(name), {"p_value": None, "changes": []})
        p_value = np.nan if entry["p_value"] is None else entry["p_value"]
        largest = max(entry["changes"], key=lambda item: item["curve_rms_deg"], default=unchanged)
        size = len(entry["changes"]), p_value, largest["curve_rms_deg"]
        rows.append((*size, largest["date"], *largest["date_ci"]))
    table = np.array(rows, columns)
    ds = fits.assign({name: ("aircraft", table[name]) for name, _ in columns})
    return describe(ds.assign_attrs(compass_changes=json.dumps(changes)))


def noted_changes(fits: xr.Dataset) -> list[Content]:
    """All changes that :func:`add_changes` added to the fits; InputError without any test."""
    if "compass_changes" not in fits.attrs:
        raise InputError(
            "the fits contain no test of the compasses for changes",
            field="compass_changes",
            remedy="Make them again: `airswing fit`",
        )
    changes: list[Content] = json.loads(fits.attrs["compass_changes"])
    return changes


def change_warnings(fits: xr.Dataset) -> list[str]:
    """One sentence for every fit whose period contains a change of the compass."""
    lines = []
    for entry in noted_changes(fits) if "compass_changes" in fits.attrs else []:
        if changes := entry["changes"]:
            largest = max(changes, key=lambda change: change["curve_rms_deg"])
            among = f" (the largest of {len(changes)} changes)" if len(changes) > 1 else ""
            low, high = largest["date_ci"]
            lines.append(
                f"{entry['aircraft']}: the compass changed by {largest['curve_rms_deg']:.1f} "
                f"degrees rms on {largest['date']} ({low} to {high}){among}; "
                "its fit covers both states"
            )
    return lines


def fit_by_window(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    window: Literal["month", "quarter"] = "month",
    since: np.datetime64 | None = None,
    **fit_options: Unpack[FitOptions],
) -> list[Content]:
    """Fit every aircraft in each calendar window from the reports of that window alone.

    Against the reference or pool ``reference``, from the window that begins on the day ``since``
    on; options as for :func:`airswing.compass.fit.deviation.fit_deviation`. One entry for each
    aircraft and window with reports, sorted: ``aircraft``, ``window`` (its first day), ``reports``,
    ``status`` and, where the fit is published, ``offset``, ``amplitude``, ``phase`` and ``A`` to
    ``E``, each with ``*_standard_error``; degrees.
    """
    require_reference(pools, reference)
    pool = {reference: list(pools[reference])}
    step = 1 if window == "month" else 3

    def number(reports: xr.Dataset) -> NDArray[np.int64]:
        month = reports["time"].to_numpy().astype("datetime64[M]").astype(np.int64)
        return np.asarray(month // step)

    if since is not None:
        headings = some_reports(headings, headings["time"].to_numpy() >= since)
    windows: set[int] = set()
    for block in blocks(headings, ["time", "screening"]):
        windows.update(number(block)[block["screening"].to_numpy() == 0].tolist())
    sums: dict[int, list[xr.DataArray]] = {key: [] for key in windows}
    for block in blocks(headings.sel(reference=pool[reference]), FITTED_FROM):
        place = number(block)
        for key, parts in sums.items():
            reports = some_reports(block, place == key)
            parts.append(sum_aircraft(reports, pools=pool, alone=False, **fit_options))
    entries, words = [], {code: name for name, code in STATUS.items()}
    for key in windows:
        fits = fit_sums(xr.concat(sums.pop(key), "aircraft")).sel(reference=reference)
        first = str(np.datetime64(key * step, "M").astype("datetime64[D]"))
        for k in range(fits.sizes["aircraft"]):
            fit = fits.isel(aircraft=k)
            entry: Content = {
                "aircraft": str(fit["aircraft"].item()),
                "window": first,
                "reports": int(fit["report_count"]),
                "status": words[int(fit["status"])],
            }
            if published(fit["status"]):
                errors = np.sqrt(np.diag(fit["deviation_covariance"].to_numpy()))
                for name in ("offset", "amplitude", "phase"):
                    entry |= {key: float(fit[key]) for key in (name, f"{name}_standard_error")}
                for name, value, error in zip("ABCDE", fit["deviation"], errors, strict=True):
                    entry |= {name: float(value), f"{name}_standard_error": float(error)}
            entries.append(entry)
    return sorted(entries, key=lambda entry: (entry["aircraft"], entry["window"]))
