"""The dates at which compasses changed.

Assumes a change is a step of the offset or of the one-cycle part (a flux valve recalibrated or
exchanged); see :mod:`airswing.evaluation.compass_changes.change_kernels` for the errors' model. A
third and a fourth harmonic are fitted beside A to E: what these leave of a curve would pass for a
change wherever an aircraft turns to other routes.

Dates are days, UTC; angles in degrees.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from airswing.evaluation.compass_changes.change_kernels import (
    CHANGING,
    DaySums,
    block_orders,
    date_of_change,
    day_sums,
    largest_statistic,
    orders_of,
    scores,
    without_changes,
)
from airswing.evaluation.contents import AircraftChanges, Change
from airswing.evaluation.disagreement import member_mean
from airswing.products.ragged import blocks, row_bounds

# Neighbouring days kept together when days are permuted: weather, and the model's error, last so.
_BLOCK = 4
# Probability of any false change in the fleet.
_FALSE_ALARMS = 0.02
FEWEST_DAYS = 5  # Days with reports on either side of a change
# Share of the information on either side of a change: nearer the ends a date is not to be told.
_TRIM = 0.05
# Statistic beyond which a change is taken out of the days that are permuted; chance seldom
# reaches it.
_OBVIOUS = 28.0
# Depth of the search, each part being cut in two at its own date.
_MOST_CHANGES = 4
# What the daily sums are made from, beside the deviation's argument.
SUMMED_FROM = (
    "heading_error",
    "airspeed_error",
    "airspeed",
    "heading",
    "time",
    "screening",
)


def find_changes(
    headings: xr.Dataset,
    *,
    members: list[str],
    abscissa: Literal["magnetic", "true"] = "magnetic",
    draws: int = 999,
) -> list[AircraftChanges]:
    """Find the dates at which each aircraft's compass changed.

    Parameters
    ----------
    members : list of str
        References whose mean error is used.
    abscissa : {"magnetic", "true"}
    draws : int, default 999
        Permutations of the days.

    Returns
    -------
    list of AircraftChanges
        One an aircraft; ``p_value`` is corrected for the fleet.
    """
    sums = fleet_day_sums(headings, members, abscissa, fewest=2 * FEWEST_DAYS)
    names = headings["aircraft"].to_numpy().astype(str).tolist()
    return changes_of(names, sums, draws=draws)


def fleet_day_sums(
    headings: xr.Dataset, members: list[str], abscissa: str, *, fewest: int
) -> list[DaySums | None]:
    """Daily sums of every aircraft, see :func:`block_day_sums`."""
    argument = "magnetic_heading" if abscissa == "magnetic" else "heading"
    sums: list[DaySums | None] = []
    for loaded in blocks(headings, [*SUMMED_FROM, argument]):
        sums += block_day_sums(loaded, members, argument, fewest=fewest)
    return sums


def changes_of(
    names: list[str], sums: list[DaySums | None], *, draws: int = 999
) -> list[AircraftChanges]:
    """As :func:`find_changes`, from daily sums.

    Parameters
    ----------
    sums : list of DaySums or None
        One an aircraft; None where there are too few days.
    """
    segments = [(k, one) for k, one in enumerate(sums) if one is not None]
    entries: list[AircraftChanges] = [
        {
            "aircraft": str(name),
            "days": 0 if one is None else int(one.day.size),
            "p_value": None,
            "statistic": None,
            "changes": [],
        }
        for name, one in zip(names, sums, strict=True)
    ]
    for depth in range(_MOST_CHANGES):
        found = _judged(segments, draws=draws, seed=depth)
        following = []
        for (k, part), (statistic, p_value) in zip(segments, found, strict=True):
            if depth == 0:
                entries[k]["p_value"], entries[k]["statistic"] = p_value, statistic
            if p_value is None or p_value > _FALSE_ALARMS:
                continue
            change = _change(part, p_value)
            entries[k]["changes"].append(change)
            first = np.datetime64(change["date"]).astype("datetime64[D]").astype(np.int64)
            following += [(k, part.take(part.day < first)), (k, part.take(part.day >= first))]
        segments = following
        if not segments:
            break
    for entry in entries:
        entry["changes"].sort(key=lambda one: one["date"])
    return entries


def block_day_sums(
    headings: xr.Dataset,
    members: list[str],
    argument: str,
    *,
    fewest: int,
    by_flight: bool = False,
) -> list[DaySums | None]:
    """Daily sums of every aircraft of one block.

    Parameters
    ----------
    headings : Dataset
        Whole aircraft in memory, with :data:`SUMMED_FROM` and the argument (``flight`` too if
        by flight).
    members : list of str
        References whose mean error is used.
    argument : str
        Variable that is the deviation's argument.
    fewest : int
        Days with reports below which an aircraft is left out.
    by_flight : bool, default False
        Give :func:`airswing.evaluation.compass_changes.change_kernels.day_sums` the flights.

    Returns
    -------
    list of DaySums or None
        None where there are too few days.
    """
    part = headings.sel(reference=members)
    error, speed_error = (
        member_mean(part[name]).to_numpy().astype(np.float64)
        for name in ("heading_error", "airspeed_error")
    )
    airspeed = headings["airspeed"].to_numpy().astype(np.float64)
    heading = np.radians(headings["heading"].to_numpy().astype(np.float64))
    magnetic = np.radians(headings[argument].to_numpy().astype(np.float64))
    day = headings["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    flight = headings["flight"].to_numpy().astype(np.int64) if by_flight else None
    good = (headings["screening"].to_numpy() == 0) & np.isfinite(
        error + speed_error + airspeed + heading + magnetic
    )
    found: list[DaySums | None] = []
    for start, stop in zip(*row_bounds(headings["row_size"].to_numpy()), strict=True):
        rows = np.flatnonzero(good[start:stop]) + start
        if np.unique(day[rows]).size < fewest:
            found.append(None)
            continue
        cross = airspeed[rows] * np.radians(error[rows])
        found.append(
            day_sums(
                magnetic[rows],
                heading[rows],
                airspeed[rows],
                cross,
                speed_error[rows],
                day[rows],
                flight=None if flight is None else flight[rows],
            )
        )
    return found


def _judged(
    segments: list[tuple[int, DaySums]], *, draws: int, seed: int
) -> list[tuple[float | None, float | None]]:
    """Largest statistic of each segment and its p value within all of them."""
    usable = [part.day.size >= max(2 * FEWEST_DAYS, 3 * _BLOCK) for _, part in segments]
    if not any(usable):
        return [(None, None)] * len(segments)
    parts = [part for (_, part), good in zip(segments, usable, strict=True) if good]
    first = min(int(part.day[0]) for part in parts)
    last = max(int(part.day[-1]) for part in parts)
    rng = np.random.default_rng(seed)
    keys = block_orders(last - first + 1, block=_BLOCK, draws=draws, rng=rng)
    every = np.argsort(np.vstack([np.arange(last - first + 1.0), keys]), axis=1)
    table = np.empty((len(parts), draws + 1))
    for k, part in enumerate(parts):
        order = orders_of(part.day - first, every)
        score, share = scores(part)
        table[k, :1] = largest_statistic(score, share, order[:1], trim=_TRIM, fewest=FEWEST_DAYS)
        if table[k, 0] >= _OBVIOUS:
            score = without_changes(score, share, most=2, trim=_TRIM, fewest=FEWEST_DAYS)
        table[k, 1:] = largest_statistic(score, share, order[1:], trim=_TRIM, fewest=FEWEST_DAYS)
    # Aircraft with few days have heavier tails: each is held against its own permutations first.
    scale = np.median(table[:, 1:], axis=1, keepdims=True)
    table = table / np.where(scale > 0, scale, 1.0)
    worst = table[:, 1:].max(axis=0)
    answers = iter(
        (float(row[0] * middle), float((1.0 + (worst >= row[0]).sum()) / (draws + 1.0)))
        for row, middle in zip(table, scale[:, 0], strict=True)
    )
    return [next(answers) if good else (None, None) for good in usable]


def _change(part: DaySums, p_value: float) -> Change:
    day, (low, high), change, covariance, _ = date_of_change(part, fewest=FEWEST_DAYS)
    degrees, error = np.degrees(change), np.degrees(np.sqrt(np.diag(covariance)))
    names = "ABC"[:CHANGING]
    return {
        "date": _date(day),
        "date_ci": [_date(low), _date(high)],
        "change_deg": dict(zip(names, map(float, degrees), strict=True)),
        "standard_error_deg": dict(zip(names, map(float, error), strict=True)),
        # rms over the compass of A + B sin m + C cos m.
        "curve_rms_deg": float(np.sqrt(degrees[0] ** 2 + (degrees[1:] ** 2).sum() / 2.0)),
        "p_value": p_value,
    }


def _date(day: int) -> str:
    return str(np.datetime64(day, "D"))
