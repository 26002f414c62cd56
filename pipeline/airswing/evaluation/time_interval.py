"""Error of model winds interpolated over three or six hours, from an hourly reference.

Assumes that winds are linear in time within an hour. Long archives are thinned to evenly spread
whole days: the error depends on the weather and the model, not on the reports. It is largest in the
middle of an interval; the mean over all reports is the error of a run.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation import Content
from airswing.reference.catalogue import Catalogue
from airswing.reference.collocate import collocate

_INTERVALS_H = (3, 6)  # at which archives of models hold winds
DAYS = 10  # spread evenly over the archive
REPORTS = 20_000  # most reports of those days
_HOUR = 3_600_000_000_000  # ns


def interval_cost(reports: xr.Dataset, catalogue: Catalogue) -> list[Content]:
    """Compare winds interpolated over three and six hours with those of an hourly reference.

    ``reports`` hold time, latitude, longitude (degrees) and pressure (Pa). For each interval
    ``interval_h``, ``reports``, ``rms_vector_difference_m_s`` over all of them,
    ``reports_at_middle`` and ``rms_vector_difference_at_middle_m_s``; empty where the reference is
    not hourly.
    """
    steps = np.diff(catalogue.valid)
    if steps.size <= 3 or np.median(steps) > _HOUR:
        return []
    time = reports["time"].values.astype("M8[ns]")
    stamp, day = time.astype(np.int64), time.astype("M8[D]").astype(np.int64)
    # some whole days within the reference's time, evenly spread over it
    inside = (stamp >= catalogue.valid[0]) & (stamp <= catalogue.valid[-1]) & ~np.isnat(time)
    rows = np.flatnonzero(inside & np.isin(day, _spread(np.unique(day[inside]), DAYS)))
    if not rows.size:
        return []
    rows, names = _spread(rows, REPORTS), ("time", "latitude", "longitude", "pressure")
    chosen = xr.Dataset({name: ("report", reports[name].values[rows]) for name in names})
    # the times at whole multiples of an interval since midnight UTC
    thinned = {
        f"{hours}": catalogue.at_times(np.flatnonzero(catalogue.valid % (hours * _HOUR) == 0))
        for hours in _INTERVALS_H
    }
    kept = {name: one for name, one in thinned.items() if len(one) > 1}
    gap = max(_INTERVALS_H) * 3600.0
    winds = collocate(chosen, {"whole": catalogue, **kept}, max_time_gap=gap).compute()
    u, v = (winds[f"reference_{way}ward_wind"].values for way in ("east", "north"))
    found: list[Content] = []
    for number, name in enumerate(kept, start=1):
        length = np.hypot(u[number] - u[0], v[number] - v[0])
        step = int(name) * _HOUR
        middle = np.abs(np.mod(stamp[rows], step) - step // 2) <= _HOUR // 2
        known = np.isfinite(length)
        found.append(
            {
                "interval_h": int(name),
                "reports": int(known.sum()),
                "rms_vector_difference_m_s": _rms(length[known]),
                "reports_at_middle": int((known & middle).sum()),
                "rms_vector_difference_at_middle_m_s": _rms(length[known & middle]),
            }
        )
    return [row for row in found if row["reports"]]


def _rms(values: NDArray[np.float64]) -> float | None:
    return round(float(np.sqrt(np.mean(values**2))), 4) if values.size else None


def _spread(values: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    if values.size <= most:
        return values
    return np.asarray(values[np.linspace(0, values.size - 1, most).astype(int)])
