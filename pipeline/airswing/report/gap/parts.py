"""From ``gap.json`` and ``gap.nc`` to the figures of the gap page.

Assumes the arrays of :func:`airswing.gap.evidence.localisation.residual_maps` (each with
``*_standard_error``; residual: reported minus simulated), and beside them these, every one
optional:

=======================================  =============================================
variable                                 dimensions
=======================================  =============================================
heading_map (degree)                     aircraft, octant
level_map_cross, level_map_along (m/s)   phase, level
region_map_u, region_map_v (m/s)         latitude, longitude
time_line (degree)                       aircraft, week
pit_count, pit_count_before              pit_bin
=======================================  =============================================

A map may have its ``*_count``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from airswing.gap.result.schema import EvidenceEntry, GapReport
from airswing.report.gap import where_figures as places
from airswing.report.gap import which_figures as evidence
from airswing.report.gap.words import plain_name


def _has(maps: xr.Dataset | None, *names: str) -> bool:
    return maps is not None and all(name in maps.variables for name in names)


def _words(values: ArrayLike) -> list[str]:
    return [str(value) for value in np.asarray(values)]


def _array(maps: xr.Dataset, name: str, *dims: str) -> Any:
    """Return an array of ``gap.nc``, or None where it has none of that name."""
    return maps[name].transpose(*dims).to_numpy() if name in maps.variables else None


def where_figures(
    maps: xr.Dataset | None, gap: GapReport, named: Sequence[str]
) -> Iterator[Figure]:
    """Yield the figures of where the gap lies, as far as ``gap.nc`` holds them."""
    if maps is None:
        return
    total = gap.counts.reports
    if _has(maps, "heading_map"):
        yield places.aircraft_heading_figure(
            _words(maps["aircraft"]),
            maps["octant"].to_numpy(),
            _array(maps, "heading_map", "aircraft", "octant"),
            _array(maps, "heading_map_count", "aircraft", "octant"),
            standard_error=_array(maps, "heading_map_standard_error", "aircraft", "octant"),
            quantity="mean heading error (degree)",
            outstanding=named,
            total=total,
        )
    if _has(maps, "level_map_cross", "level_map_along"):
        yield _levels(maps, total)
    if _has(maps, "region_map_u", "region_map_v"):
        order = ("latitude", "longitude")
        yield places.gap_map_figure(
            maps["longitude"].to_numpy(),
            maps["latitude"].to_numpy(),
            _array(maps, "region_map_u", *order),
            _array(maps, "region_map_v", *order),
            _array(maps, "region_map_count", *order),
            total=total,
        )
    if _has(maps, "time_line"):
        yield places.aircraft_time_figure(
            _words(maps["aircraft"]),
            week_starts(maps),
            _array(maps, "time_line", "aircraft", "week"),
            _array(maps, "time_line_count", "aircraft", "week"),
            outstanding=named,
            total=total,
        )


def week_starts(maps: xr.Dataset) -> Any:
    """Return the first day of each week, or its number where the days are not told."""
    weeks = maps["week"].to_numpy()
    if "day" not in maps.variables:
        return weeks
    return maps["day"].to_numpy().min() + weeks.astype("timedelta64[W]")


def _levels(maps: xr.Dataset, total: int) -> Figure:
    """Draw phase by level, without phases that hold nothing, from the ground up."""
    order = ("phase", "level")
    across = _array(maps, "level_map_cross", *order)
    along = _array(maps, "level_map_along", *order)
    number = _array(maps, "level_map_count", *order)
    filled = np.flatnonzero(np.isfinite(across).any(axis=1))
    up = np.argsort(-maps["level"].to_numpy().astype(float))
    pick = np.ix_(filled, up)
    return places.phase_level_figure(
        [_words(maps["phase"])[i] for i in filled],
        [f"{level:.0f}" for level in maps["level"].to_numpy().astype(float)[up]],
        {"along the heading": along[pick], "across the heading": across[pick]},
        None if number is None else number[pick],
        total=total,
    )


def which_figures(maps: xr.Dataset | None, gap: GapReport) -> Iterator[Figure]:
    """Yield the evidence of each effect and the aircraft that carry the effects."""
    best = best_evidence(gap.evidence)
    if best:
        yield evidence.evidence_figure(
            list(best),
            list(best.values()),
            chosen=[effect.name for effect in gap.effects],
            ambiguous=[name for effect in gap.effects for name in effect.ambiguous_with],
            number=gap.counts.reports,
        )
    if maps is not None and "aircraft" in maps.variables:
        tails = _words(maps["aircraft"])
        rows = posteriors(gap.evidence, tails)
        if rows:
            yield evidence.posterior_figure(tails, list(rows), np.array(list(rows.values())))


def best_evidence(rows: Sequence[EvidenceEntry], *, most: int = 20) -> dict[str, float]:
    """Return the best tempered evidence (nats) of each effect of the catalogue, largest first."""
    best: dict[str, float] = {}
    for row in rows:
        if row.known and np.isfinite(row.tempered_nats):
            best[row.name] = max(row.tempered_nats, best.get(row.name, -np.inf))
    return dict(sorted(best.items(), key=lambda item: -item[1])[:most])


def posteriors(rows: Sequence[EvidenceEntry], tails: Sequence[str]) -> dict[str, list[float]]:
    """Return the probability of each aircraft for the effects found on single aircraft."""
    found: dict[str, list[float]] = {}
    for row in rows:
        own = row.instead_of == row.name and row.scope == "aircraft"
        if own and row.name not in found and len(row.posterior) == len(tails):
            found[row.name] = list(row.posterior)
    return found


def closure_steps(gap: GapReport) -> list[tuple[str, float, Sequence[float] | None]]:
    """Return (name, disagreement after it in kt, 95 % interval) of each step of the waterfall.

    The diagnosis gives the interval of the step's reduction; what is left after it lies the
    reduction below the level before it.
    """
    steps: list[tuple[str, float, Sequence[float] | None]] = []
    for before, entry in pairwise(gap.waterfall):
        if entry.step_ci is not None:
            interval = sorted(before.kt - bound for bound in entry.step_ci)
            steps.append((entry.label, entry.kt, interval))
    return steps


def closure_figures(gap: GapReport) -> Iterator[Figure]:
    """Yield the waterfall, where there is something to close."""
    closure = gap.closure
    if not gap.effects:
        return
    steps = closure_steps(gap)
    if not steps:
        names = " + ".join(plain_name(effect.name) for effect in gap.effects[:2])
        more = " + ..." if len(gap.effects) > 2 else ""
        steps = [(names + more, closure.after, closure.ci)]
    yield evidence.waterfall_figure(
        steps,
        before=closure.before,
        floor=gap.gap.noise_floor_kt,
        number=gap.counts.reports,
        after_all=(closure.after, closure.ci),
    )


def method_figures(maps: xr.Dataset | None, gap: GapReport) -> Iterator[Figure]:
    """Yield the checks of the noise model and of the improved simulation's calibration."""
    noise = gap.noise
    if noise.distance_km:
        value = np.asarray(noise.autocovariance, float)
        yield evidence.autocorrelation_figure(
            noise.distance_km,
            value,
            np.full(value.shape, np.nan),
            noise.autocovariance_model,
            quantity="autocovariance of residuals (m²/s²)",
            number=gap.counts.reports,
        )
    if _has(maps, "pit_count") and maps is not None:
        early = _array(maps, "pit_count_before", "pit_bin")
        yield evidence.pit_figure(maps["pit_count"].to_numpy(), before=early)
