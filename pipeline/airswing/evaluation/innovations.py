"""Statistics of the innovations: observation minus reference, by aircraft, phase and level.

The innovation of a report is its wind less the reference's wind at the same place and time. The
usual statistics (bias, standard deviation, root mean square; for example Drüe et al. 2008, Q. J. R.
Meteorol. Soc. 134, 229-239, for AMDAR winds) are given of the wind speed, the wind direction and
both components, as reported and as corrected.

Assumes that every report counts alike; the innovations of one flight share the reference's error,
so that a standard error from the count alone would be too small. Direction innovations are taken
the shorter way round, where the reference wind is 5 m/s or more. A pool is the mean of its members.
m/s, degrees.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import innovations, reference_mean
from airswing.evaluation.error_profiles import (
    CELLS,
    LEVEL_EDGES_HPA,
    STATES,
    profile_cells,
)
from airswing.flags import PHASE
from airswing.products.ragged import aircraft_of_report, blocks, time_span

Floats = NDArray[np.float64]

QUANTITIES = ("speed", "direction", "eastward", "northward")
HISTOGRAM_EDGES = np.arange(-20.0, 21.0)
"""Edges of the classes of a component's innovation, m/s; what lies beyond is in the last class."""
_WINDS = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
)
_CORRECTED = ("corrected_eastward_wind", "corrected_northward_wind")


def innovation_statistics(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> xr.Dataset:
    """Statistics of the innovations: the content of ``innovation_statistics.nc``.

    Parameters
    ----------
    headings : Dataset
        Screened headings, in memory or lazy.
    corrected : Dataset
        Corrected winds of the same reports.
    pools : mapping of str to list of str
        Members of each reference and pool.

    Returns
    -------
    Dataset
        For each quantity of :data:`QUANTITIES`:

        ``innovation_{quantity}_bias``, ``_standard_deviation``, ``_rms``, ``_count``
            (reference, state, aircraft, flight_phase, layer): m/s, of the direction degrees.
            :func:`combined` gives them over whole phases, layers, aircraft or the fleet.
        ``daily_innovation_{quantity}``, ``daily_innovation_count``
            (reference, state, aircraft, day): mean of the day (UTC); NaN without a report.
        ``innovation_histogram``
            (reference, state, eastward_class, northward_class): number of reports by the
            innovation of both components, in classes of 1 m/s named by their lower edge.
    """
    first, last = (day.astype("datetime64[D]") for day in time_span(headings))
    days = np.arange(first, last + 1)
    shape = (len(pools), len(STATES), headings.sizes["aircraft"])
    cells = {name: np.zeros((3, *shape, CELLS)) for name in QUANTITIES}
    daily = {name: np.zeros((2, *shape, days.size)) for name in QUANTITIES}
    classes = HISTOGRAM_EDGES.size - 1
    histogram = np.zeros((*shape[:2], classes * classes), np.int64)
    begin = 0
    names = (*_WINDS, "pressure", "phase", "screening", "time")
    pairs = zip(blocks(headings, names), blocks(corrected, _CORRECTED), strict=True)
    for block, better in pairs:
        aircraft = slice(begin, begin + block.sizes["aircraft"])
        begin = aircraft.stop
        cell, _ = profile_cells(block)
        row = aircraft_of_report(block)
        day = (block["time"].to_numpy().astype("datetime64[D]") - first).astype(np.int64)
        for i, members in enumerate(pools.values()):
            model = [reference_mean(block, members)[name].to_numpy() for name in _WINDS[2:]]
            for j, (source, pair) in enumerate(((block, _WINDS[:2]), (better, _CORRECTED))):
                found = innovations(*(source[name].to_numpy() for name in pair), *model)
                for name, values in found.items():
                    good = np.isfinite(values) & (cell >= 0)
                    moments = [values[good] ** power for power in (0, 1, 2)]
                    for table, place, size, number in (
                        (cells[name], cell, CELLS, 3),
                        (daily[name], day, days.size, 2),
                    ):
                        key = row[good] * size + place[good]
                        for power in range(number):
                            table[power, i, j, aircraft] = np.bincount(
                                key, moments[power], block.sizes["aircraft"] * size
                            ).reshape(-1, size)
                good = np.isfinite(found["eastward"]) & (cell >= 0)
                east, north = (
                    np.clip(np.digitize(found[name][good], HISTOGRAM_EDGES) - 1, 0, classes - 1)
                    for name in ("eastward", "northward")
                )
                histogram[i, j] += np.bincount(east * classes + north, minlength=classes**2)
    dims = ("reference", "state", "aircraft", "flight_phase", "layer")
    ds = xr.Dataset(
        coords={
            "reference": list(pools),
            "state": list(STATES),
            "aircraft": headings["aircraft"].to_numpy().astype(str),
            "flight_phase": list(PHASE),
            "day": days.astype("datetime64[ns]"),
            "eastward_class": HISTOGRAM_EDGES[:-1],
            "northward_class": HISTOGRAM_EDGES[:-1],
        }
    )
    for name in QUANTITIES:
        moments = list(cells[name].reshape(3, *shape, len(PHASE), -1))
        for kind, statistic in _statistics(*moments).items():
            ds[f"innovation_{name}_{kind}"] = dims, statistic
        ds[f"daily_innovation_{name}"] = (*dims[:3], "day"), _ratio(daily[name][1], daily[name][0])
    ds["daily_innovation_count"] = (*dims[:3], "day"), daily["eastward"][0].astype(np.int32)
    ds["innovation_histogram"] = (
        (*dims[:2], "eastward_class", "northward_class"),
        histogram.reshape(*shape[:2], classes, classes),
    )
    edges = np.array(LEVEL_EDGES_HPA) * 100.0
    return ds.assign(
        layer_bottom_pressure=("layer", edges[:-1]), layer_top_pressure=("layer", edges[1:])
    )


def combined(statistics: xr.Dataset, over: Iterable[str]) -> xr.Dataset:
    """Statistics of the innovations over whole dimensions, such as all layers of a phase.

    Parameters
    ----------
    statistics : Dataset
        Of :func:`innovation_statistics`, or a part of it.
    over : iterable of str
        Dimensions whose cells are put together: ``aircraft``, ``flight_phase``, ``layer``.

    Returns
    -------
    Dataset
        ``innovation_{quantity}_bias``, ``_standard_deviation``, ``_rms`` and ``_count`` of the
        union of the cells; exact, as the moments add up.
    """
    dims = list(over)
    found = xr.Dataset()
    for name in QUANTITIES:
        count = statistics[f"innovation_{name}_count"].astype(np.float64)
        moments = [
            count.sum(dims),
            *(
                (count * statistics[f"innovation_{name}_{kind}"] ** power).sum(dims)
                for kind, power in (("bias", 1), ("rms", 2))
            ),
        ]
        for kind, values in _statistics(*(one.to_numpy() for one in moments)).items():
            found[f"innovation_{name}_{kind}"] = moments[0].dims, values
    return found.assign_coords(
        {name: one for name, one in statistics.coords.items() if set(one.dims) <= set(found.dims)}
    )


def _statistics(count: Floats, total: Floats, squares: Floats) -> dict[str, NDArray[np.generic]]:
    """Bias, standard deviation (n - 1), root mean square and count from moments."""
    bias, square = _ratio(total, count), _ratio(squares, count)
    variance = _ratio(np.maximum(square - bias**2, 0.0) * count, count - 1.0)
    return {
        "bias": bias,
        "standard_deviation": np.sqrt(variance),
        "rms": np.sqrt(square),
        "count": count.astype(np.int64),
    }


def _ratio(total: Floats, number: Floats) -> Floats:
    found = np.full(np.shape(total), np.nan)
    np.divide(total, number, out=found, where=number > 0)
    return found
