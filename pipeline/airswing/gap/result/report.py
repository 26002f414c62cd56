"""Content of gap.json, and of gap.nc: maps of the residual (m/s, degrees), evidence, noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats, Integers
from airswing.gap.design import unit_vectors
from airswing.gap.effects.base import Effect
from airswing.gap.model.closure import Closure, is_held_out
from airswing.gap.model.evidence import Exchange
from airswing.gap.model.passes import Fitted
from airswing.gap.result.schema import (
    ClosesEntry,
    ClosureEntry,
    CountsEntry,
    DisagreementEntry,
    EffectClosureEntry,
    EffectEntry,
    EvidenceEntry,
    GapReport,
    NoiseEntry,
    PlaceEntry,
    SliceEntry,
    StepEntry,
    UnknownClosureEntry,
    UnknownEntry,
)
from airswing.gap.result.statement import Claim, effect_entry, place_entry, probability
from airswing.units import DAY, KNOT


def could_hide(disagreement: float, reports: int) -> float:
    """Reduction (kt) by an error outside the catalogue that would not be stated.

    An error of rms s on a share f of n reports has log evidence E = n f s^2 / (2 sigma^2) and
    closes m f s^2 / (4 sigma^2) = m E / (2 n) of a mean disagreement m, with m = sigma sqrt(pi / 2)
    for two normal components. It may stay unstated below a log evidence of independent reports of
    2000, and below 0.2 m/s, which every fleet has.
    """
    if disagreement <= 0.0 or reports <= 0:
        return 0.0
    unseen = 0.5 * disagreement * 2000.0 / reports
    small = np.pi / 8.0 * (0.2 / KNOT) ** 2 / disagreement
    return float(min(unseen + small, disagreement))


def assemble(
    fitted: Fitted,
    effects: Mapping[str, Effect],
    claims: Sequence[Claim],
    closure: Closure,
    unseen: Sequence[EffectEntry | PlaceEntry],
    where: Sequence[SliceEntry],
) -> GapReport:
    """Content of gap.json without the checks; ``unseen`` are effects that change no mean."""
    frame, sums = fitted.frame, fitted.model.sums
    entries: list[EffectEntry | PlaceEntry] = [
        effect_entry(fitted, claim, effects, step)
        if claim.named
        else place_entry(fitted, claim, step)
        for claim, step in zip(claims, closure.steps, strict=True)
    ]
    if fitted.exchange is not None:
        entries.append(_exchange_entry(fitted, fitted.exchange))
    entries += unseen
    places = [entry for entry in entries if isinstance(entry, PlaceEntry)]
    steps = []
    for entry in entries:
        if isinstance(entry, PlaceEntry):
            name = f"unknown: {' x '.join(entry.variables)}"
        else:
            name = entry.name
        closes = entry.closure or ClosesEntry(0.0, [0.0, 0.0])
        steps.append(EffectClosureEntry(name, closes.reduction, closes.reduction_ci))
    value, low, high = _total(steps, closure)
    before, hidden = closure.before, could_hide(closure.before, frame.size)
    total = value if value > 1e-6 else np.inf
    named = [
        replace(entry, share_of_gap=float(np.clip(entry.closure.reduction / total, 0, 1)))
        if entry.closure
        else entry
        for entry in entries
        if isinstance(entry, EffectEntry)
    ]
    named.sort(key=lambda entry: -entry.share_of_gap)
    unnamed = [step for step in steps if step.name.startswith("unknown: ")]
    if not entries:
        # where nothing is stated the interval holds an error that could hide
        low, high = low - 0.25 * hidden, high + hidden
    best = max([0.0, *(claim.gate for claim in claims), *(x.evidence_nats for x in unseen)])
    unknown = None
    if unnamed:
        closed = sum(step.reduction for step in unnamed)
        below, above = (
            float(np.sqrt(sum((s.reduction_ci[end] - s.reduction) ** 2 for s in unnamed)))
            for end in (0, 1)
        )
        remaining, interval = before - (value - closed), [closed - below, closed + above]
        unknown = UnknownClosureEntry(remaining, remaining - closed, closed, interval)
    waterfall = [StepEntry("reports as they are", before, None)]
    for step in steps:
        waterfall.append(StepEntry(step.name, waterfall[-1].kt - step.reduction, step.reduction_ci))
    waterfall.append(StepEntry("noise floor", waterfall[-1].kt, None))
    return GapReport(
        gap=DisagreementEntry(before, before - value, float(np.exp(-best))),
        where=[row for row in where if row.q_value < 0.05][:20],
        effects=named,
        unknown=UnknownEntry(bool(places), places, unknown),
        closure=ClosureEntry(
            before=before,
            after=before - value,
            ci=[before - high, before - low],
            fraction_of_excess=1.0 if value > 1e-6 else None,
            held_out=is_held_out(sums.D),
            reduction=value,
            reduction_ci=[low, high],
            could_hide_kt=hidden,
            by_effect=steps,
        ),
        counts=CountsEntry(
            reports=frame.size,
            flights=int(np.unique(frame.flight).size),
            days=int(sums.D),
            gross=float(fitted.noise.gross.sum()),
            aircraft=len(frame.tails),
        ),
        noise=_noise_entry(fitted),
        waterfall=waterfall,
        evidence=_evidence_entries(fitted),
        slices=list(where),
        ambiguity={entry.name: entry.ambiguity for entry in named},
    )


def _total(steps: Sequence[EffectClosureEntry], closure: Closure) -> tuple[float, float, float]:
    """All steps and their interval: that of the means, the others independent of it."""
    value = closure.total.reduction
    low, high = closure.total.reduction_ci
    below, above = value - low, high - value
    for step in steps[len(closure.steps) :]:
        below = float(np.hypot(below, step.reduction - step.reduction_ci[0]))
        above = float(np.hypot(above, step.reduction_ci[1] - step.reduction))
        value += step.reduction
    return value, value - below, value + above


def _exchange_entry(fitted: Fitted, exchange: Exchange) -> EffectEntry:
    pair = [fitted.frame.tails[a] for a in exchange.pair]
    start = np.datetime64(int(fitted.model.sums.days[exchange.day]), "D")
    return EffectEntry(
        name="tail_swap",
        probability=probability(exchange.evidence),
        tails=pair,
        parameters={"pair": pair},
        standard_errors={},
        period=[str(start), None],
        scope="pair",
        evidence_nats=exchange.evidence,
    )


def _evidence_entries(fitted: Fitted) -> list[EvidenceEntry]:
    out = []
    for term in fitted.terms:
        for margin, name, scope in [(0.0, term.group.name, term.scope), *term.rivals]:
            same = name == term.group.name
            out.append(
                EvidenceEntry(
                    instead_of=term.group.name,
                    name=name,
                    scope={"a": "aircraft", "f": "fleet"}[scope],
                    known="|" not in name,
                    subset=list(term.group.form) if same else [],
                    evidence_nats=float(term.score - margin),
                    posterior=[] if not same or term.inclusion is None else term.inclusion.tolist(),
                )
            )
    return out


def _noise_entry(fitted: Fitted) -> NoiseEntry:
    noise, model = fitted.noise, fitted.noise.model
    theta = fitted.exact.theta[: fitted.model.base.group.size]
    return NoiseEntry(
        correlated_sd_m_s=float(model.correlated_sd),
        white_sd_m_s=float(model.white_sd),
        length_km=float(model.length) / 1e3,
        height_ln_p=float(model.height),
        level_hPa=(np.exp(model.level_nodes) / 100).tolist(),
        level_factor=model.level_factors.tolist(),
        day_field_sd_m_s=np.sqrt(fitted.model.sums.field_variance).tolist(),
        climatology_sd_m_s=np.abs(theta).tolist(),
        distance_km=noise.distance_km.tolist(),
        autocovariance=noise.autocovariance.tolist(),
        autocovariance_model=noise.autocovariance_model.tolist(),
        along_heading=float(model.along),
        across_heading=float(model.across),
    )


# ------------------------------------------------------------------------------------------ gap.nc
def diagnosis_dataset(fitted: Fitted) -> xr.Dataset:
    """Maps, evidence and noise as one Dataset."""
    frame, noise, sums = fitted.frame, fitted.noise, fitted.model.sums
    out = residual_maps(frame)
    begins = ((sums.days * DAY + sums.ends) * 1e9).astype(np.int64).astype("datetime64[ns]")
    out["day"] = ("day", begins)
    out["report_count"] = (("aircraft", "day"), np.diff(sums.cuts).reshape(sums.A, sums.D) // 2)
    gross = np.bincount(frame.aircraft, noise.gross, minlength=len(frame.tails))
    out["gross_error_count"] = (("aircraft",), gross)
    evidence: dict[str, tuple[float, Floats]] = {}
    for entry in _evidence_entries(fitted):
        score, included = evidence.get(entry.name, (-np.inf, np.zeros(sums.A)))
        if entry.posterior:
            included = np.maximum(entry.posterior, included)
        if entry.known:
            evidence[entry.name] = max(score, float(entry.evidence_nats)), included
    best = sorted(evidence, key=lambda name: -evidence[name][0])
    out["effect"] = ("effect", np.array(best, dtype=object))
    out["log_evidence"] = ("effect", np.array([evidence[name][0] for name in best], float))
    out["aircraft_probability"] = (
        ("effect", "aircraft"),
        np.reshape([evidence[name][1] for name in best], (len(best), sums.A)),
    )
    out["noise_distance"] = (("distance",), noise.distance_km)
    out["noise_autocovariance"] = (("distance",), noise.autocovariance)
    out["noise_autocovariance_model"] = (("distance",), noise.autocovariance_model)
    out["noise_level_factor"] = (("noise_level",), noise.model.level_factors)
    out["noise_level"] = (("noise_level",), np.exp(noise.model.level_nodes) / 100)
    return out


def binned(values: Floats, key: Integers, flight: Integers, size: int) -> tuple[Floats, Floats]:
    """Mean by bin and its standard error clustered by flight, (size,).

    A negative key leaves a value out; NaN for fewer than two flights.
    """
    ok = key >= 0
    values, key, flight = values[ok], key[ok], flight[ok]
    count = np.bincount(key, minlength=size).astype(float)
    pairs, where = np.unique(np.stack([key, flight]), axis=1, return_inverse=True)
    clusters = np.bincount(pairs[0], minlength=size).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(key, values, minlength=size) / count
        sums = np.bincount(where.ravel(), values - mean[key], minlength=pairs.shape[1])
        square = np.bincount(pairs[0], sums**2, minlength=size)
        error = np.sqrt(square * clusters / (clusters - 1)) / count
    few = clusters < 2
    return np.where(few, np.nan, mean), np.where(few, np.nan, error)


def residual_maps(frame: Frame) -> xr.Dataset:
    """Pictures of the gap, each with ``*_standard_error``.

    ``heading_map(aircraft, octant)`` and ``time_line(aircraft, week)`` in degrees;
    ``level_map_cross``, ``level_map_along(phase, level)``, ``region_map_u``,
    ``region_map_v(latitude, longitude)`` and ``time_line_along(aircraft, week)`` in m s-1.
    """
    cross, along = unit_vectors(frame.heading)
    across = (frame.residual * cross).sum(-1)
    parallel = (frame.residual * along).sum(-1)
    # a heading error turns the air vector: across the heading it is V times the angle, and opposite
    degrees = -np.degrees(across / np.maximum(frame.airspeed, 1.0))
    octant = np.mod(np.round(np.degrees(frame.magnetic_heading) / 45.0).astype(np.int64), 8)
    week = np.floor((frame.time - frame.epoch) / (7 * DAY)).astype(np.int64)
    weeks = int(week.max()) + 1
    # hPa: layers a turboprop climbs through; few reports are from above 400
    edges = np.array([0, 400, 500, 600, 700, 850, 1100.0]) * 100
    level = np.searchsorted(edges, frame.pressure) - 1
    # slightly beyond, so that the outermost reports are in the last cell
    lat = np.linspace(frame.latitude.min(), frame.latitude.max() + 1e-6, 9)
    lon = np.linspace(frame.longitude.min(), frame.longitude.max() + 1e-6, 11)
    box = (np.searchsorted(lat, frame.latitude, "right") - 1) * 10
    box = box + np.searchsorted(lon, frame.longitude, "right") - 1
    coords = {
        "aircraft": np.array(list(frame.tails), dtype=object),
        "octant": np.arange(8) * 45.0,
        "phase": np.array(["unknown", "ascent", "cruise", "descent"], dtype=object),
        "level": 0.5 * (edges[1:] + edges[:-1]) / 100,
        "latitude": 0.5 * (lat[1:] + lat[:-1]),
        "longitude": 0.5 * (lon[1:] + lon[:-1]),
        "week": np.arange(weeks),
    }
    out: dict[str, tuple[tuple[str, str], Floats]] = {}

    def put(name: str, dims: tuple[str, str], value: Floats, key: Integers) -> None:
        shape = len(coords[dims[0]]), len(coords[dims[1]])
        mean, error = binned(value, key, frame.flight, shape[0] * shape[1])
        out[name] = (dims, mean.reshape(shape))
        out[f"{name}_standard_error"] = (dims, error.reshape(shape))

    weekly = frame.aircraft * weeks + week
    put("heading_map", ("aircraft", "octant"), degrees, frame.aircraft * 8 + octant)
    put("level_map_cross", ("phase", "level"), across, frame.phase * 6 + level)
    put("level_map_along", ("phase", "level"), parallel, frame.phase * 6 + level)
    put("region_map_u", ("latitude", "longitude"), frame.residual[:, 0], box)
    put("region_map_v", ("latitude", "longitude"), frame.residual[:, 1], box)
    put("time_line", ("aircraft", "week"), degrees, weekly)
    put("time_line_along", ("aircraft", "week"), parallel, weekly)
    return xr.Dataset(out, coords=coords)
