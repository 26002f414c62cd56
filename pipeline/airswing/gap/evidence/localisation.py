"""Where the real reports part from the simulated ones, without any physics.

Assumptions: the share of a slice (an aircraft, or a dictionary group) in the gap is its
cross-fitted energy: coefficients fitted on one half of the weeks predict the other half,
theta_A' G theta_B; on a null its expectation is zero. Significance is a chi-squared test of the
group's score with the cluster factor, false discoveries are controlled over all slices
(Benjamini & Hochberg 1995). The maps are
plain means of the residual in bins, with standard errors clustered by flight.

Validity: two weeks and more for the halves. Angles in degrees, speeds in m/s.

Source: docs/gap.md section 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan, unit_vectors
from airswing.gap.sums.beyond import beyond
from airswing.gap.sums.cluster_inflation import aircraft_factor, fleet_factor
from airswing.gap.sums.day_scores import day_scores, fleet_day_scores
from airswing.gap.sums.elimination import Base, Conditional
from airswing.units import DAY

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Static columns by which an aircraft as a whole is judged.
STATIC = ("compass_offset", "hard_iron", "soft_iron", "tas_scale", "tas_offset")


@dataclass(frozen=True)
class Slice:
    """One slice of the gap."""

    variable: str  # ``aircraft``, or the variable of a dictionary group
    component: str  # ``cross``, ``along``, ``wind`` or ``both``
    values: tuple[str, ...]  # the aircraft, or the hats, that stand out
    energy: float  # cross-fitted whitened energy
    share: float  # of the energy of all slices of its kind
    p_value: float
    q_value: float
    effect: tuple[float, ...]  # fitted coefficient per label, m s-1 (the curve)
    labels: tuple[str, ...]
    group: str  # name of the dictionary group; empty for aircraft


def cross_fitted(gram: Floats, score_by_day: Floats, half: NDArray[np.bool_]) -> float:
    """Energy theta_A' G theta_B of two halves.

    Parameters
    ----------
    gram : (k, k) float
        X'X of the whole, shared half and half.
    score_by_day : (D, k) float
    half : (D,) bool

    Returns
    -------
    float
        Expectation zero where nothing is there.
    """
    # each half holds half of the information; the ridge keeps a direction few days tell from
    # answering in the one half to noise of the other
    inner = 0.5 * gram + 1e-3 * np.trace(gram) / gram.shape[0] * np.eye(gram.shape[0])
    first = np.linalg.solve(inner, score_by_day[half].sum(axis=0))
    second = np.linalg.solve(inner, score_by_day[~half].sum(axis=0))
    return float(first @ gram @ second)


def score_test(gram: Floats, score: Floats, factor: float) -> tuple[float, Floats, Floats]:
    """Chi-squared p-value of a score, estimates and their standard errors.

    Parameters
    ----------
    gram : (k, k) float
    score : (k,) float
    factor : float
        Cluster factor.

    Returns
    -------
    p_value : float
    estimate, standard_error : (k,) float
    """
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-30))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    # each direction counts as a freedom: those told a thousandth as well would add noise alone
    kept = values > 1e-3 * values[-1]
    half = vectors[:, kept] / scale[:, None] / np.sqrt(values[kept])
    projected = half.T @ score
    statistic = float(projected @ projected) / factor
    spread = half @ half.T
    error = np.sqrt(np.maximum(factor * np.diagonal(spread), 0))
    return float(chi2.sf(statistic, int(kept.sum()))), half @ projected, error


def false_discovery(p_values: Sequence[float]) -> Floats:
    """q-values of Benjamini and Hochberg; shape (n,)."""
    p = np.asarray(p_values, float)
    order = np.argsort(p)
    ranked = p[order] * p.size / np.arange(1, p.size + 1)
    out = np.empty_like(p)
    out[order] = np.minimum(1.0, np.minimum.accumulate(ranked[::-1])[::-1])
    return out


def slices(base: Base, given: Conditional, plan: DictionaryPlan) -> list[Slice]:
    """All slices, largest share of the gap first.

    Parameters
    ----------
    given : Conditional
        Given the climatology alone.
    """
    stats = base.stats
    half = stats.week_of_day % 2 == 0
    if half.all():
        half = np.arange(stats.days.size) % 2 == 0
    rows = _aircraft_slices(base, given, half)
    rows += _group_slices(base, given, plan, half)
    quality = false_discovery([r[0].p_value for r in rows]) if rows else np.zeros(0)
    total_aircraft = sum(max(r[0].energy, 0) for r in rows if r[0].variable == "aircraft")
    total = max(total_aircraft, max((r[0].energy for r in rows), default=0.0), 1e-9)
    out = [
        Slice(**{**vars(r[0]), "q_value": float(q), "share": max(r[0].energy, 0.0) / total})
        for r, q in zip(rows, quality, strict=True)
    ]
    return sorted(out, key=lambda s: -s.share)


def _aircraft_slices(base: Base, given: Conditional, half: NDArray[np.bool_]) -> list[tuple[Slice]]:
    layout = base.stats.layout
    names = [n for n in STATIC if n in layout.blocks]
    if not names:
        return []
    columns = np.concatenate([layout.columns(n) for n in names])
    labels = tuple(f"{n}[{i}]" for n in names for i in range(layout.columns(n).size))
    by_day = day_scores(given, columns)
    factor = aircraft_factor(base.stats, given, columns, score=by_day)
    out = []
    for a, tail in enumerate(base.stats.tails):
        gram = given.gram[a][np.ix_(columns, columns)]
        if np.trace(gram) <= 0:
            continue
        score = by_day[a]
        p, estimate, _ = score_test(gram, score.sum(axis=0), factor)
        energy = cross_fitted(gram, score, half)
        out.append(
            (
                Slice(
                    "aircraft",
                    "both",
                    (tail,),
                    energy,
                    0.0,
                    p,
                    1.0,
                    tuple(float(x) for x in estimate),
                    labels,
                    "",
                ),
            )
        )
    return out


def _group_slices(
    base: Base, given: Conditional, plan: DictionaryPlan, half: NDArray[np.bool_]
) -> list[tuple[Slice]]:
    layout = base.stats.layout
    names = [n for n in STATIC if n in layout.blocks]
    novel = beyond(given, np.concatenate([layout.columns(n) for n in names])) if names else given
    out = []
    for group in plan.groups:
        columns = layout.columns(group.name)
        gram = novel.fleet_gram[np.ix_(columns, columns)]
        # nothing is left of it beside what is given
        if np.trace(gram) <= 1e-9:
            continue
        score = fleet_day_scores(novel, columns)
        factor = fleet_factor(base.stats, novel, columns)
        p, estimate, error = score_test(gram, score.sum(axis=0), factor)
        energy = cross_fitted(gram, score, half)
        # at two standard errors: these are named to a reader, the test is the whole group's
        strong = np.abs(estimate) > 2 * np.maximum(error, 1e-12)
        values = tuple(x for x, s in zip(group.labels, strong, strict=True) if s)
        out.append(
            (
                Slice(
                    group.variable,
                    group.component,
                    values or group.labels,
                    energy,
                    0.0,
                    p,
                    1.0,
                    tuple(float(x) for x in estimate),
                    group.labels,
                    group.name,
                ),
            )
        )
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
