"""One entry of gap.json from one piece of a diagnosis.

Assumptions and validity: as the modules that made the pieces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import UNITS
from airswing.gap.as_sent.mended import Mended
from airswing.gap.closure.of_scatter import Reduction
from airswing.gap.evidence.gaussian import Score, plain_probability
from airswing.gap.evidence.localisation import Slice
from airswing.gap.result.describe import (
    day_text,
)
from airswing.gap.result.schema import (
    ClosesEntry,
    CurveEntry,
    EffectEntry,
    EvidenceEntry,
    NoiseEntry,
    PlaceEntry,
    SliceEntry,
    StepsEntry,
    TailEntry,
)
from airswing.gap.scatter.excess_scatter import Scattering
from airswing.gap.scatter.moment_verdict import MomentVerdict
from airswing.gap.search.tail_swaps import Swap
from airswing.gap.sums.elimination import Base
from airswing.gap.sums.problem import Problem
from airswing.gap.witness.sent_winds import SentWinds
from airswing.units import KNOT

Floats = NDArray[np.float64]

#: What would settle winds that are sent otherwise than simulated.
BEFORE_CODING = "the unit's winds before they are coded, beside those it sends"


def closes(reduction: Reduction) -> ClosesEntry:
    """What an effect of scatter closes, kt."""
    return ClosesEntry(reduction.kt, list(reduction.interval))


def moment_entry(verdict: MomentVerdict, reduction: Reduction) -> EffectEntry:
    """Entry of ``effects`` for a second-moment effect: it moves no mean."""
    return EffectEntry(
        name=verdict.name,
        probability=plain_probability(verdict.evidence),
        tails=list(verdict.tails),
        parameters=dict(verdict.parameters),
        standard_errors=dict(verdict.standard_errors),
        period=verdict.period,
        scope="aircraft",
        evidence_nats=verdict.evidence,
        per_tail={tail: TailEntry(values) for tail, values in verdict.per_tail.items()},
        closure=closes(reduction),
    )


def scatter_place(found: Scattering, fleet: Sequence[str], reduction: Reduction) -> PlaceEntry:
    """Place of an unknown effect that shows in the scatter of single reports: it moves no mean."""
    variable, excess, axis = "scatter", list(found.excess), found.axis
    curve = CurveEntry(list(found.tails), excess)
    if axis is not None:
        variable = axis.variable
        curve = CurveEntry(
            list(axis.labels),
            excess,
            unit="m/s",
            variables=[variable],
            variable_units=[UNITS[variable]],
            edges=[_floats(axis.edges)],
            values=excess,
        )
    whole = len(found.tails) == len(fleet)
    return PlaceEntry(
        component="scatter",
        variable=variable,
        variables=[variable],
        group="scatter" if axis is None else f"scatter:{variable}",
        tails=[] if whole else list(found.tails),
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(found.evidence, 2),
        probability=None if axis is None else plain_probability(found.evidence),
        size_m_s=float(np.median([size for size in excess if size > 0])),
        curve=curve,
        closure=closes(reduction),
    )


def sent_place(
    found: SentWinds, tails: Sequence[str], scatter: Mapping[str, Reduction]
) -> PlaceEntry:
    """Place of winds that are sent otherwise than simulated: a map of speeds, or directions."""
    # as for a table: three quarters of the fleet are taken for all of it
    whole = len(found.aircraft) >= 0.75 * len(tails)
    curve = CurveEntry(
        [f"{10 * k}" for k in range(36)], [100.0 * x for x in found.directions], unit="percent"
    )
    size = 0.0
    if found.speeds is not None and found.sent is not None:
        size = float(np.sqrt(np.mean((found.sent - found.speeds) ** 2)))
        curve = _speed_map(_floats(found.speeds), _floats(found.sent))
    steps, grid = None, found.lattice
    if grid is not None:
        steps = StepsEntry(grid.step, grid.below / KNOT, grid.share)
    return PlaceEntry(
        component=found.component,
        variable=found.telling[0],
        variables=list(found.telling),
        group=f"{found.component}:{found.telling[0]}",
        tails=[] if whole else [tails[a] for a in found.aircraft],
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(found.evidence, 2),
        probability=plain_probability(found.evidence),
        size_m_s=size,
        curve=curve,
        closure=closes(scatter[found.component])
        if found.component in scatter
        else None,  # of directions otherwise than in steps it is not known
        settled_by=BEFORE_CODING,
        steps=steps,
    )


def mended_place(found: Mended, tails: Sequence[str], interval: tuple[float, float]) -> PlaceEntry:
    """Place of winds set right before anything was fitted."""
    whole = len(found.tails) == len(tails)
    values, names = list(found.values), list(found.variables)
    curve = CurveEntry(list(found.labels), values, unit=found.unit)
    if found.edges is not None:
        units = [UNITS[name] for name in names]
        edges = [list(found.edges)]
        curve = replace(curve, variables=names, variable_units=units, edges=edges, values=values)
    return PlaceEntry(
        component=found.component,
        variable=names[0],
        variables=names,
        group=f"{found.component}:{names[0]}",
        tails=[] if whole else [tails[a] for a in found.tails],
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(found.evidence, 2),
        probability=plain_probability(found.evidence),
        size_m_s=found.size,
        curve=curve,
        closure=ClosesEntry(float(found.saved.mean()) / KNOT, list(interval)),
        settled_by=BEFORE_CODING,
        title=found.title,
    )


def mended_effect(found: Mended, tails: Sequence[str]) -> EffectEntry:
    """Entry of ``effects`` for what was set right before anything was fitted, and has a name."""
    whole = len(found.tails) == len(tails)
    return EffectEntry(
        name=str(found.name),
        probability=plain_probability(found.evidence),
        tails=[tails[a] for a in found.tails],
        parameters=found.parameters,
        standard_errors=found.standard_errors,
        period=None,
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(found.evidence, 2),
        size_m_s=found.size,
        held_out_energy=2.0 * found.evidence,
    )


def _speed_map(speeds: list[float], sent: list[float]) -> CurveEntry:
    """Speeds, and what is sent in their place, m/s."""
    return CurveEntry(
        [f"{speed:.3g}" for speed in speeds],
        sent,
        unit="m/s",
        variables=["wind_speed"],
        variable_units=["m/s"],
        edges=[speeds],
        values=sent,
    )


def swap_entry(swap: Swap, base: Base) -> EffectEntry:
    """Entry of ``effects`` for exchanged identifiers."""
    stats = base.stats
    pair = [stats.tails[a] for a in swap.pair]
    return EffectEntry(
        name="tail_swap",
        probability=plain_probability(swap.evidence),
        tails=pair,
        parameters={"pair": pair},
        standard_errors={},
        period=[day_text(stats, swap.day), None],
        scope="pair",
        evidence_nats=swap.evidence,
        held_out_energy=2.0 * swap.gain,
    )


def bounds(interval: tuple[float, float] | None) -> list[float] | None:
    """Bounds of an interval as a list; None where there is none."""
    return None if interval is None else list(interval)


def slice_entry(piece: Slice) -> SliceEntry:
    """Entry of one slice of where the gap lies."""
    return SliceEntry(
        variable=piece.variable,
        component=piece.component,
        values=list(piece.values),
        share_of_gap=float(np.clip(piece.share, 0, 1)),
        q_value=piece.q_value,
        p_value=piece.p_value,
        energy=piece.energy,
        group=piece.group,
        curve=CurveEntry(list(piece.labels), list(piece.effect)),
    )


def noise_entry(problem: Problem) -> NoiseEntry:
    """Entry of the noise and of what weather and climatology vary by."""
    noise, variances = problem.noise, problem.base.variances
    model = noise.model
    return NoiseEntry(
        correlated_sd_m_s=float(model.correlated_sd),
        white_sd_m_s=float(model.white_sd),
        length_km=float(model.length) / 1e3,
        height_ln_p=float(model.height),
        level_hPa=_floats(np.exp(model.level_nodes) / 100),
        level_factor=_floats(model.level_factors),
        day_field_sd_m_s=_floats(np.sqrt(variances.day)),
        climatology_sd_m_s=_floats(np.sqrt(variances.climatology)),
        distance_km=_floats(noise.distance_km),
        autocovariance=_floats(noise.autocovariance),
        autocovariance_model=_floats(noise.autocovariance_model),
        along_heading=float(model.along),
        across_heading=float(model.across),
    )


def _floats(values: Floats) -> list[float]:
    return [float(value) for value in values]


def evidence_entry(score: Score, instead_of: str | None) -> EvidenceEntry:
    """Entry of one candidate's evidence."""
    return EvidenceEntry(
        instead_of=instead_of,
        name=score.candidate.name,
        scope=score.candidate.scope,
        known=score.candidate.known,
        subset=list(score.candidate.subset),
        tempered_nats=score.tempered,
        raw_nats=score.raw,
        cluster_factor=score.factor,
        posterior=_floats(score.posterior),
    )
