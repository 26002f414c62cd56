"""From ``gap.json`` and ``gap.nc`` to the figures of the gap page.

Assumes these names in ``gap.nc``, each optional (residual: reported minus simulated, m/s):

==================================  ============================================
variable                            dimensions
==================================  ============================================
residual_across_heading             aircraft, heading_bin (degree, bin middles)
residual_along_heading              aircraft, heading_bin
heading_count                       aircraft, heading_bin
level_residual_along, _across       flight_phase, layer
level_count                         flight_phase, layer
map_eastward_residual, _northward_  map_latitude, map_longitude
map_count                           map_latitude, map_longitude
timeline_disagreement (kt)          series, day; with _half_width, and timeline_count
log_evidence                        effect
aircraft_probability                effect, aircraft
noise_correlation, _half_width      lag (km)
noise_correlation_model             lag
pit_count, pit_count_before         pit_bin
==================================  ============================================
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from airswing.report import gap_evidence_figures as evidence
from airswing.report import gap_figures as places
from airswing.report.gap_words import plain_name


def _has(maps: xr.Dataset | None, *names: str) -> bool:
    return maps is not None and all(name in maps.variables for name in names)


def _words(values: Any) -> list[str]:
    return [str(value) for value in np.asarray(values)]


def where_figures(
    maps: xr.Dataset | None, gap: Mapping[str, Any], named: Sequence[str]
) -> Iterator[Figure]:
    """Yield the figures of where the gap lies, as far as ``gap.nc`` holds them."""
    if maps is None:
        return
    for component in ("across", "along"):
        name = f"residual_{component}_heading"
        if _has(maps, name, "heading_count"):
            yield places.aircraft_heading_figure(
                _words(maps["aircraft"]),
                maps["heading_bin"].to_numpy(),
                maps[name].transpose("aircraft", "heading_bin").to_numpy(),
                maps["heading_count"].transpose("aircraft", "heading_bin").to_numpy(),
                component=f"{component} the heading",
                outstanding=named,
            )
    if _has(maps, "level_residual_along", "level_residual_across", "level_count"):
        order = ("flight_phase", "layer")
        yield places.phase_level_figure(
            _words(maps["flight_phase"]),
            _words(maps["layer"]),
            {
                f"{way} the heading": maps[f"level_residual_{way}"].transpose(*order).to_numpy()
                for way in ("along", "across")
            },
            maps["level_count"].transpose(*order).to_numpy(),
        )
    if _has(maps, "map_eastward_residual", "map_northward_residual", "map_count"):
        order = ("map_latitude", "map_longitude")
        yield places.gap_map_figure(
            maps["map_longitude"].to_numpy(),
            maps["map_latitude"].to_numpy(),
            *(
                maps[name].transpose(*order).to_numpy()
                for name in ("map_eastward_residual", "map_northward_residual", "map_count")
            ),
        )
    if _has(maps, "timeline_disagreement", "timeline_disagreement_half_width"):
        yield _timeline(maps, gap)


def _timeline(maps: xr.Dataset, gap: Mapping[str, Any]) -> Figure:
    value = maps["timeline_disagreement"].transpose("series", "day").to_numpy()
    half = maps["timeline_disagreement_half_width"].transpose("series", "day").to_numpy()
    names = _words(maps["series"])
    number = int(maps["timeline_count"].sum()) if "timeline_count" in maps else 0
    series = {name: (value[i], half[i]) for i, name in enumerate(names[:7])}
    return places.timeline_figure(
        maps["day"].to_numpy(), series, changes=change_dates(gap), number=number
    )


def change_dates(gap: Mapping[str, Any]) -> dict[str, Any]:
    """Return the date of each effect that begins at one, by its plain name and aircraft."""
    found: dict[str, Any] = {}
    for effect in gap.get("effects") or []:
        period = effect.get("period")
        if isinstance(period, Mapping):
            period = list(period.values())
        first = period[0] if isinstance(period, list | tuple) and period else period
        if first:
            tails = effect.get("tails") or []
            whom = f", {tails[0]}" + (" ..." if len(tails) > 1 else "") if tails else ""
            name = str(effect["name"]).replace("_", " ")
            found[f"{name}{whom}"] = np.datetime64(str(first)[:10])
    return found


def which_figures(maps: xr.Dataset | None, gap: Mapping[str, Any]) -> Iterator[Figure]:
    """Yield the evidence of each effect and the aircraft that carry the effects."""
    effects = gap.get("effects") or []
    chosen = [str(effect["name"]) for effect in effects]
    ambiguous = [str(name) for effect in effects for name in effect.get("ambiguous_with") or []]
    table = _evidence_rows(maps, gap)
    if table:
        yield evidence.evidence_figure(
            [name for name, _ in table],
            [value for _, value in table],
            chosen=chosen,
            ambiguous=ambiguous,
            threshold=gap.get("evidence_needed"),
            number=int(gap.get("reports", 0) or 0),
        )
    if maps is not None and "aircraft_probability" in maps:
        value = maps["aircraft_probability"].transpose("effect", "aircraft")
        rows = [i for i, name in enumerate(_words(value["effect"])) if name in chosen]
        if rows:
            yield evidence.posterior_figure(
                _words(value["aircraft"]),
                [_words(value["effect"])[i] for i in rows],
                value.to_numpy()[rows],
            )


def _evidence_rows(maps: xr.Dataset | None, gap: Mapping[str, Any]) -> list[tuple[str, float]]:
    listed = gap.get("evidence") or []
    if listed:
        return [
            (str(entry["name"]), float(entry["log_evidence"]))
            for entry in listed
            if isinstance(entry.get("log_evidence"), int | float)
        ]
    if maps is not None and "log_evidence" in maps:
        return list(
            zip(_words(maps["effect"]), map(float, maps["log_evidence"].to_numpy()), strict=True)
        )
    return []


def closure_figures(gap: Mapping[str, Any]) -> Iterator[Figure]:
    """Yield the waterfall, where there is something to close."""
    closure, numbers = gap.get("closure") or {}, gap.get("gap") or {}
    before, after = closure.get("before"), closure.get("after")
    if before is None or after is None or not gap.get("effects"):
        return
    floor = numbers.get("noise_floor_kt")
    steps = [
        (str(step["name"]), float(step.get("after", step.get("after_kt"))), step.get("ci"))
        for step in closure.get("steps") or []
    ]
    if not steps:
        names = " + ".join(plain_name(str(effect["name"])) for effect in gap["effects"][:2])
        more = " + ..." if len(gap["effects"]) > 2 else ""
        steps = [(names + more, float(after), closure.get("ci"))]
    yield evidence.waterfall_figure(
        steps,
        before=float(before),
        floor=float("nan") if floor is None else float(floor),
        number=int(closure.get("reports", 0) or 0),
        after_all=(float(after), closure.get("ci")),
    )


def method_figures(maps: xr.Dataset | None, gap: Mapping[str, Any]) -> Iterator[Figure]:
    """Yield the checks of the noise model and of the improved simulation's calibration."""
    if maps is None:
        return
    if _has(maps, "noise_correlation", "noise_correlation_model"):
        value = maps["noise_correlation"].to_numpy()
        half = (
            maps["noise_correlation_half_width"].to_numpy()
            if "noise_correlation_half_width" in maps
            else np.full(value.shape, np.nan)
        )
        number = int(maps["noise_pairs"].sum()) if "noise_pairs" in maps else 0
        yield evidence.autocorrelation_figure(
            maps["lag"].to_numpy(),
            value,
            half,
            maps["noise_correlation_model"].to_numpy(),
            number=number,
        )
    if _has(maps, "pit_count"):
        early = maps["pit_count_before"].to_numpy() if "pit_count_before" in maps else None
        yield evidence.pit_figure(maps["pit_count"].to_numpy(), before=early)
