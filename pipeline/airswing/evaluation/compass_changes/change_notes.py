"""What is noted of a changed compass beside its fit.

Assumes changes as :func:`airswing.evaluation.compass_changes.change_dates.find_changes` finds them.
A fit over a period that holds a change describes neither compass. Dates are days, UTC; angles in
degrees.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.vocabulary import describe

if TYPE_CHECKING:
    from airswing.evaluation.contents import AircraftChanges, Change

_NO_CHANGE = np.datetime64("NaT", "ns")


def add_changes(fits: xr.Dataset, changes: list[AircraftChanges]) -> xr.Dataset:
    """Write beside every fit whether its period straddles a change of the compass.

    Parameters
    ----------
    fits : Dataset
        With ``aircraft``.
    changes : list of dict
        Of :func:`find_changes`, one an aircraft.

    Returns
    -------
    Dataset
        With ``change_count``, ``change_p_value`` (NaN with too few days to tell), and of the
        largest change ``change_rms``, ``change_date``, ``change_date_low``,
        ``change_date_high`` (NaT where there is none); all of them in the attribute
        ``compass_changes`` (see :func:`noted_changes`).
    """
    known = {entry["aircraft"]: entry for entry in changes}
    rows = [known.get(str(name)) for name in fits["aircraft"].to_numpy()]
    changes_of = [[] if row is None else row["changes"] for row in rows]
    largest = [max(own, key=lambda one: one["curve_rms_deg"], default=None) for own in changes_of]

    def dates(pick: Callable[[Change], str]) -> NDArray[np.datetime64]:
        return np.array(
            [_NO_CHANGE if one is None else np.datetime64(pick(one), "ns") for one in largest],
            dtype="datetime64[ns]",
        )

    p_value = [np.nan if row is None or row["p_value"] is None else row["p_value"] for row in rows]
    columns: dict[str, object] = {
        "change_count": np.array([len(own) for own in changes_of], dtype=np.int8),
        "change_p_value": np.array(p_value),
        "change_rms": np.array([0.0 if one is None else one["curve_rms_deg"] for one in largest]),
        "change_date": dates(lambda one: one["date"]),
        "change_date_low": dates(lambda one: one["date_ci"][0]),
        "change_date_high": dates(lambda one: one["date_ci"][1]),
    }
    found = fits.assign({name: ("aircraft", v) for name, v in columns.items()})
    return describe(found.assign_attrs(compass_changes=json.dumps(changes)))


def noted_changes(fits: xr.Dataset) -> list[AircraftChanges]:
    """All changes that :func:`add_changes` wrote beside the fits.

    Returns
    -------
    list of dict
        As of :func:`find_changes`.

    Raises
    ------
    InputError
        If nothing was written there.
    """
    if "compass_changes" not in fits.attrs:
        raise InputError(
            "the fits do not say which compasses changed",
            field="compass_changes",
            remedy="Make them again: `airswing fit`",
        )
    found: list[AircraftChanges] = json.loads(fits.attrs["compass_changes"])
    return found


def change_warnings(fits: xr.Dataset) -> list[str]:
    """Say which fits straddle a change of the compass, and when it was.

    Parameters
    ----------
    fits : Dataset
        Of :func:`add_changes`; without its variables there is nothing to say.

    Returns
    -------
    list of str
        One sentence an aircraft.
    """
    if "change_count" not in fits:
        return []
    lines = []
    for name, number, size, *days in zip(
        *(fits[key].to_numpy() for key in ("aircraft", "change_count", "change_rms")),
        *(fits[f"change_date{end}"].to_numpy() for end in ("", "_low", "_high")),
        strict=True,
    ):
        if number:
            when, low, high = (str(day)[:10] for day in days)
            others = f" (the largest of {number} changes)" if number > 1 else ""
            lines.append(
                f"{name}: the compass changed by {size:.1f} degrees rms on {when} ({low} to "
                f"{high}){others}; its fit straddles the change"
            )
    return lines
