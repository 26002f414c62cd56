"""Content of gap.nc: maps of the residual, evidence of the effects, and noise.

Maps are means of the residual in bins with standard errors clustered by flight. Winds in m/s,
angles in degrees, distances in km, levels in hPa.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.weather import unit_vectors
from airswing.gap.model.passes import Fitted
from airswing.units import DAY

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def diagnosis_dataset(fitted: Fitted) -> xr.Dataset:
    """Maps, evidence and noise as one Dataset."""
    frame, noise, sums = fitted.frame, fitted.noise, fitted.model.sums
    out = residual_maps(frame)
    begins = ((sums.days * DAY + sums.ends) * 1e9).astype(np.int64).astype("datetime64[ns]")
    out["day"] = ("day", begins)
    counts = np.diff(sums.cuts).reshape(sums.A, sums.D) // 2
    out["report_count"] = (("aircraft", "day"), counts)
    gross = np.bincount(frame.aircraft, noise.gross, minlength=len(frame.tails))
    out["gross_error_count"] = (("aircraft",), gross)
    found: dict[str, tuple[float, Floats]] = {}
    for term in fitted.terms:
        if term.group.named:
            own = np.zeros(sums.A) if term.inclusion is None else term.inclusion
            score, others = found.get(term.group.name, (-np.inf, np.zeros(sums.A)))
            found[term.group.name] = max(score, term.score), np.maximum(own, others)
        for apart, name, _ in term.rivals:
            if "|" not in name and term.score - apart > found.get(name, (-np.inf,))[0]:
                others = found.get(name, (0.0, np.zeros(sums.A)))[1]
                found[name] = term.score - apart, others
    best = sorted(found, key=lambda name: -found[name][0])
    out["effect"] = ("effect", np.array(best, dtype=object))
    out["log_evidence"] = ("effect", np.array([found[name][0] for name in best], float))
    out["aircraft_probability"] = (
        ("effect", "aircraft"),
        np.reshape([found[name][1] for name in best], (len(best), sums.A)),
    )
    out["noise_distance"] = (("distance",), noise.distance_km)
    out["noise_autocovariance"] = (("distance",), noise.autocovariance)
    out["noise_autocovariance_model"] = (("distance",), noise.autocovariance_model)
    out["noise_level_factor"] = (("noise_level",), noise.model.level_factors)
    out["noise_level"] = (("noise_level",), np.exp(noise.model.level_nodes) / 100)
    return out


def binned(values: Floats, key: Integers, flight: Integers, size: int) -> tuple[Floats, Floats]:
    """Mean by bin and its standard error clustered by flight.

    Parameters
    ----------
    values : (n,) float
    key : (n,) int
        Bin, negative to leave out.
    flight : (n,) int
    size : int
        Number of bins.

    Returns
    -------
    mean, standard_error : (size,) float
        NaN for fewer than two flights.
    """
    ok = key >= 0
    values, key, flight = values[ok], key[ok], flight[ok]
    count = np.bincount(key, minlength=size).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(key, values, minlength=size) / count
    pairs, where = np.unique(np.stack([key, flight]), axis=1, return_inverse=True)
    sums = np.bincount(where.ravel(), values - mean[key], minlength=pairs.shape[1])
    clusters = np.bincount(pairs[0], minlength=size).astype(float)
    square = np.bincount(pairs[0], sums**2, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt(square * clusters / (clusters - 1)) / count
    error[clusters < 2] = np.nan
    mean[clusters < 2] = np.nan
    return mean, error


def residual_maps(frame: Frame) -> xr.Dataset:
    """Pictures of the gap: aircraft by heading, phase by level, region, and time line.

    Returns
    -------
    xarray.Dataset
        ``heading_map(aircraft, octant)`` and ``time_line(aircraft, week)`` degrees,
        ``level_map_cross`` and ``level_map_along(phase, level)``, ``region_map_u`` and
        ``region_map_v(latitude, longitude)`` and ``time_line_along(aircraft, week)`` m s-1, each
        with ``*_standard_error``.
    """
    cross, along = unit_vectors(frame.heading)
    across = (frame.residual * cross).sum(-1)
    parallel = (frame.residual * along).sum(-1)
    # a heading error turns the air vector: across the heading it is V times the angle, and opposite
    degrees = -np.degrees(across / np.maximum(frame.airspeed, 1.0))
    octant = np.mod(np.round(np.degrees(frame.magnetic_heading) / 45.0).astype(np.int64), 8)
    count = len(frame.tails)
    week = np.floor((frame.time - frame.epoch) / (7 * DAY)).astype(np.int64)
    weeks = int(week.max()) + 1
    # hPa: layers a turboprop climbs through; few reports are from above 400
    edges = np.array([0, 400, 500, 600, 700, 850, 1100.0]) * 100
    level = np.searchsorted(edges, frame.pressure) - 1
    # a hair beyond, for the northernmost and easternmost reports to lie in the last cell
    lat = np.linspace(frame.latitude.min(), frame.latitude.max() + 1e-6, 9)
    lon = np.linspace(frame.longitude.min(), frame.longitude.max() + 1e-6, 11)
    box = (np.searchsorted(lat, frame.latitude, "right") - 1) * 10
    box = box + np.searchsorted(lon, frame.longitude, "right") - 1
    out: dict[str, tuple[tuple[str, ...], Floats]] = {}

    def put(
        name: str, dims: tuple[str, ...], shape: tuple[int, ...], value: Floats, key: Integers
    ) -> None:
        mean, error = binned(value, key, frame.flight, int(np.prod(shape)))
        out[name] = (dims, mean.reshape(shape))
        out[f"{name}_standard_error"] = (dims, error.reshape(shape))

    put("heading_map", ("aircraft", "octant"), (count, 8), degrees, frame.aircraft * 8 + octant)
    put("level_map_cross", ("phase", "level"), (4, 6), across, frame.phase * 6 + level)
    put("level_map_along", ("phase", "level"), (4, 6), parallel, frame.phase * 6 + level)
    put("region_map_u", ("latitude", "longitude"), (8, 10), frame.residual[:, 0], box)
    put("region_map_v", ("latitude", "longitude"), (8, 10), frame.residual[:, 1], box)
    put("time_line", ("aircraft", "week"), (count, weeks), degrees, frame.aircraft * weeks + week)
    put(
        "time_line_along",
        ("aircraft", "week"),
        (count, weeks),
        parallel,
        frame.aircraft * weeks + week,
    )
    coords = {
        "aircraft": np.array(list(frame.tails), dtype=object),
        "octant": np.arange(8) * 45.0,
        "phase": np.array(["unknown", "ascent", "cruise", "descent"], dtype=object),
        "level": 0.5 * (edges[1:] + edges[:-1]) / 100,
        "latitude": 0.5 * (lat[1:] + lat[:-1]),
        "longitude": 0.5 * (lon[1:] + lon[:-1]),
        "week": np.arange(weeks),
    }
    return xr.Dataset(out, coords=coords)
