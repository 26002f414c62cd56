"""Puts the pieces of a diagnosis into gap.json and the details a page shows.

Assumptions: shares of the gap are in mean vector disagreement on held-out reports where a term
moves it, and in held-out whitened energy beside it (an unrotated wind or a lag hardly moves the
mean). The noise floor is the disagreement with everything found, known and unknown, taken off.

Validity: as the modules that made the pieces. Speeds in kt in the ``gap`` and ``closure`` entries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.closure.of_scatter import Reduction
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.localisation import Slice
from airswing.gap.evidence.term_covariance import term_offsets
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.reduction import Closure
from airswing.gap.result.describe import (
    ambiguity,
    day_text,
    describe_term,
    period_of,
    probability,
    unknown_place,
)
from airswing.gap.search.coding_and_outliers import MomentVerdict
from airswing.gap.search.cross_validated import Doubtful
from airswing.gap.search.excess_scatter import Scattering
from airswing.gap.search.stepwise import Found
from airswing.gap.search.tail_swaps import Swap
from airswing.gap.sums.elimination import Base
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Findings:
    """What the steps of a diagnosis found.

    Attributes
    ----------
    found : Found
        Terms, with their rivals.
    closure, whole : Closure
        Of what has a name, and with unknown terms as well.
    where : sequence of Slice
    untestable : mapping
        Name -> why the archive cannot show it.
    hidden : mapping
        The same of effects that what is always fitted takes up, named or not.
    energy : (t,), (t,) float
        Held-out energy of the terms and its standard error.
    means : mapping
        Positions of terms that are the mean of an unknown one -> that one's.
    factors, doubts : mapping
        Reliabilities of the gradient effects, and their relative standard errors.
    swap : Swap or None
    moments : sequence of MomentVerdict
    scatter : mapping
        Name of each effect of scatter -> what it closes.
    jittery : Scattering or None
    doubtful : sequence of Doubtful
        Names that days left out did not confirm.
    """

    found: Found
    closure: Closure
    whole: Closure
    where: Sequence[Slice]
    untestable: Mapping[str, str]
    hidden: Mapping[str, str]
    energy: tuple[Floats, Floats]
    means: Mapping[int, int]
    factors: Mapping[str, float]
    doubts: Mapping[str, float]
    swap: Swap | None
    moments: Sequence[MomentVerdict]
    scatter: Mapping[str, Reduction]
    jittery: Scattering | None
    doubtful: Sequence[Doubtful]


def assemble(problem: Problem, findings: Findings) -> tuple[dict[str, Any], dict[str, Any]]:
    """Make the content of gap.json and the details.

    Parameters
    ----------
    problem : Problem
    findings : Findings

    Returns
    -------
    report, details : dict
    """
    closure, whole = findings.closure, findings.whole
    entries, unknown = _entries(problem, findings)
    everything = closure.before - whole.after
    explained = closure.before - closure.after
    fraction = float(np.clip(explained / everything, 0, 1)) if everything > 1e-6 else None
    best = max((t.score.tempered for t in findings.found.terms), default=0.0)
    best = max([best, *(e["evidence_nats"] for e in [*entries, *unknown])])
    report = {
        "gap": {
            "mean_vector_disagreement_kt": closure.before,
            "noise_floor_kt": whole.after,
            "significance": float(min(1.0, 50.0 * np.exp(-np.clip(best, 0, 60)))),
        },
        "where": [_slice_entry(s) for s in findings.where if s.q_value < 0.05][:20],
        "effects": entries,
        "unknown": {"present": bool(unknown), "where": unknown},
        "closure": {
            "before": closure.before,
            "after": closure.after,
            "ci": _bounds(closure.after_ci),
            "fraction_of_excess": fraction,
            "held_out": True,
            "reduction": explained,
            "reduction_ci": _bounds(closure.reduction_ci),
        },
    }
    stats = problem.base.stats
    details = {
        "unconfirmed": [doubtful_entry(d, problem) for d in findings.doubtful],
        "waterfall": _waterfall(closure, whole),
        "alone_kt": list(closure.alone),
        "evidence": evidence_table(findings.found),
        "noise": _noise_entry(problem),
        "untestable": dict(findings.untestable),
        "slices": [_slice_entry(s) for s in findings.where],
        "reliability": dict(findings.factors),
        "seed": problem.seed,
        "ambiguity": {e["name"]: e["ambiguity"] for e in entries},
        "counts": {
            "reports": problem.reports,
            "flights": problem.flights,
            "reports_in_view": problem.archive.size,
            "days": int(stats.days.size),
            "clipped": float(stats.clipped.sum()),
            "gross": float(stats.gross.sum()),
        },
    }
    return report, details


def _entries(
    problem: Problem, findings: Findings
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Entries of ``effects`` and of ``unknown.where``."""
    found, energy = findings.found, findings.energy
    entries: list[dict[str, Any]] = []
    unknown: list[dict[str, Any]] = []
    described: dict[int, dict[str, Any]] = {}
    offsets = term_offsets(found.given, found.terms)
    shares = _shares(found.terms, findings.closure)
    rank = 0
    for k, term in enumerate(found.terms):
        if not term.candidate.known:
            place = _unnamed(problem, found, k, offsets[k])
            place["held_out_energy"] = float(energy[0][k])
            place["held_out_energy_standard_error"] = float(energy[1][k])
            described[k] = place
            unknown.append(place)
            continue
        entry = describe_term(
            term,
            offsets[k],
            found,
            problem.base,
            effects=problem.effects,
            frame=problem.archive,
            reliability=findings.factors,
            doubts=findings.doubts,
        )
        if k in findings.means:
            described[k] = entry
            continue
        rivals = ambiguity(term, found.rivals[k], found.left)
        entry["ambiguous_with"] = [r["name"] for r in rivals]
        entry["ambiguity"] = rivals
        entry["share_of_gap"] = shares[rank]
        entry["held_out_energy"] = float(energy[0][k])
        entry["held_out_energy_standard_error"] = float(energy[1][k])
        entries.append(entry)
        rank += 1
    for part, whole_of in findings.means.items():
        kept = ("name", "tails", "parameters", "standard_errors")
        described[whole_of]["mean"] = {key: described[part][key] for key in kept}
    total = sum(max(e["held_out_energy"], 0) for e in entries) or 1.0
    for entry in entries:
        entry["share_of_energy"] = max(entry["held_out_energy"], 0) / total
    whole = findings.closure.before - findings.closure.after
    for moment in findings.moments:
        reduction = findings.scatter[moment.name]
        share = float(np.clip(reduction.kt / whole, 0, 1)) if whole > 1e-6 else 0.0
        entries.append(moment_entry(moment, reduction) | {"share_of_gap": share})
    if findings.jittery is not None:
        unknown.append(scatter_place(findings.jittery, findings.scatter["scatter"]))
    if findings.swap is not None:
        entries.append(swap_entry(findings.swap, problem.base))
    entries.sort(key=lambda e: -e["held_out_energy"])
    return entries, unknown


def _unnamed(problem: Problem, found: Found, k: int, offset: int) -> dict[str, Any]:
    """Place of a term of the nonparametric basis."""
    term = found.terms[k]
    group = next(g for g in problem.plan.groups if g.name == term.candidate.name)
    stats = problem.base.stats
    return unknown_place(term, found.given, offset, stats, group.labels, found.rivals[k])


def doubtful_entry(doubtful: Doubtful, problem: Problem) -> dict[str, Any]:
    """Entry of ``unconfirmed``: a name the search came to that is not counted as found."""
    term, stats = doubtful.term, problem.base.stats
    return {
        "name": term.candidate.name,
        "tails": [stats.tails[a] for a in term.tails],
        "period": period_of(term, stats),
        "probability": doubtful.probability,
        "evidence_nats": round(term.score.tempered, 2),
        "reason": doubtful.reason,
    }


def _closes(reduction: Reduction) -> dict[str, Any]:
    """What an effect of scatter closes, kt."""
    return {"reduction": reduction.kt, "reduction_ci": list(reduction.interval)}


def moment_entry(verdict: MomentVerdict, reduction: Reduction) -> dict[str, Any]:
    """Entry of ``effects`` for a second-moment effect: it moves no mean."""
    return _plain_entry(
        verdict.name,
        verdict.tails,
        verdict.parameters,
        verdict.standard_errors,
        verdict.period,
        evidence=verdict.evidence,
        energy=0.0,
        scope="aircraft",
    ) | {
        "per_tail": {t: {"parameters": p} for t, p in verdict.per_tail.items()},
        "closure": _closes(reduction),
    }


def scatter_place(found: Scattering, reduction: Reduction) -> dict[str, Any]:
    """Place of an unknown effect that shows in the scatter of single reports: it moves no mean."""
    return {
        "equally_good": [],
        "component": "scatter",
        "variable": "scatter",
        "variables": ["scatter"],
        "group": "scatter",
        "tails": list(found.tails),
        "scope": "aircraft",
        "evidence_nats": round(found.evidence, 2),
        "size_m_s": float(np.median(found.excess)),
        "curve": {"labels": list(found.tails), "m_s": list(found.excess)},
        "held_out_energy": 0.0,
        "held_out_energy_standard_error": 0.0,
        "closure": _closes(reduction),
    }


def swap_entry(swap: Swap, base: Base) -> dict[str, Any]:
    """Entry of ``effects`` for exchanged identifiers."""
    stats = base.stats
    pair = [stats.tails[a] for a in swap.pair]
    return _plain_entry(
        "tail_swap",
        pair,
        {"pair": pair},
        {},
        [day_text(stats, swap.day), None],
        evidence=swap.evidence,
        energy=2.0 * swap.gain,
        scope="pair",
    )


def _plain_entry(
    name: str,
    tails: Sequence[str],
    parameters: Mapping[str, Any],
    errors: Mapping[str, float],
    period: list[str | None] | None,
    *,
    evidence: float,
    energy: float,
    scope: str,
) -> dict[str, Any]:
    return {
        "name": name,
        "probability": float(1 / (1 + 50 * np.exp(-min(evidence, 50.0)))),
        "tails": list(tails),
        "parameters": dict(parameters),
        "standard_errors": dict(errors),
        "period": period,
        "scope": scope,
        "evidence_nats": evidence,
        "cluster_factor": 1.0,
        "size_m_s": 0.0,
        "ambiguous_with": [],
        "ambiguity": [],
        "share_of_gap": 0.0,
        "share_of_energy": 0.0,
        "held_out_energy": energy,
        "held_out_energy_standard_error": 0.0,
    }


def _shares(terms: Sequence[Term], closure: Closure) -> list[float]:
    """Each known term's share of the disagreement's reduction, from its step in the sequence."""
    before = closure.before
    out = []
    total = closure.before - closure.after
    for _, after, _, _ in closure.sequence:
        out.append(float(np.clip((before - after) / total, 0, 1)) if total > 1e-6 else 0.0)
        before = after
    return out or [0.0] * len(terms)


def _bounds(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def _slice_entry(piece: Slice) -> dict[str, Any]:
    return {
        "variable": piece.variable,
        "component": piece.component,
        "values": list(piece.values),
        "share_of_gap": float(np.clip(piece.share, 0, 1)),
        "q_value": piece.q_value,
        "p_value": piece.p_value,
        "energy": piece.energy,
        "group": piece.group,
        "curve": {"labels": list(piece.labels), "m_s": list(piece.effect)},
    }


def _waterfall(closure: Closure, whole: Closure) -> list[dict[str, Any]]:
    """Disagreement of the real gap, after each effect, and the noise floor, kt."""
    out = [{"label": "reports as they are", "kt": closure.before, "step_ci": None}]
    out += [
        {"label": name, "kt": after, "step_ci": [low, high]}
        for name, after, low, high in closure.sequence
    ]
    return [*out, {"label": "noise floor", "kt": whole.after, "step_ci": None}]


def _noise_entry(problem: Problem) -> dict[str, Any]:
    noise, base = problem.noise, problem.base
    model = noise.model
    return {
        "correlated_sd_m_s": float(model.correlated_sd),
        "white_sd_m_s": float(model.white_sd),
        "length_km": float(model.length) / 1e3,
        "height_ln_p": float(model.height),
        "level_hPa": [float(x) for x in np.exp(model.level_nodes) / 100],
        "level_factor": [float(x) for x in model.level_factors],
        "day_field_sd_m_s": [float(x) for x in np.sqrt(base.variances.day)],
        "climatology_sd_m_s": [float(x) for x in np.sqrt(base.variances.climatology)],
        "distance_km": [float(x) for x in noise.distance_km],
        "autocovariance": [float(x) for x in noise.autocovariance],
        "autocovariance_model": [float(x) for x in noise.autocovariance_model],
    }


def evidence_table(found: Found) -> list[dict[str, Any]]:
    """All candidates with each term taken out, ranked; and those left over in the end."""
    out = []
    for term, ranked in zip(found.terms, found.rivals, strict=True):
        for score in ranked[:40]:
            out.append(
                {
                    "instead_of": term.candidate.name,
                    "name": score.candidate.name,
                    "scope": score.candidate.scope,
                    "known": score.candidate.known,
                    "subset": list(score.candidate.subset),
                    "tempered_nats": score.tempered,
                    "raw_nats": score.raw,
                    "cluster_factor": score.factor,
                    "posterior": [float(x) for x in score.posterior],
                }
            )
    for score in found.left:
        out.append(
            {
                "instead_of": None,
                "name": score.candidate.name,
                "scope": score.candidate.scope,
                "known": score.candidate.known,
                "subset": list(score.candidate.subset),
                "tempered_nats": score.tempered,
                "raw_nats": score.raw,
                "cluster_factor": score.factor,
                "posterior": [float(x) for x in score.posterior],
            }
        )
    return out


def best_scores(found: Found) -> list[Score]:
    """Best score of every effect of the catalogue: with each term taken out, and with all in.

    Parameters
    ----------
    found : Found

    Returns
    -------
    list of Score
        Best first.
    """
    best: dict[str, Score] = {}
    for ranked in (*found.rivals, found.left):
        for score in ranked:
            name = score.candidate.name
            if score.candidate.known and (name not in best or score.tempered > best[name].tempered):
                best[name] = score
    return sorted(best.values(), key=lambda score: -score.tempered)


def aircraft_probability(score: Score) -> Floats:
    """Probability that an effect acts on each aircraft, (A,); the fleet's acts on all or none."""
    if score.candidate.scope == "fleet":
        return np.full(score.posterior.size, probability(score))
    return score.posterior
