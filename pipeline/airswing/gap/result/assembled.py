"""Puts the pieces of a diagnosis into gap.json.

Assumptions: shares of the gap are in mean vector disagreement on held-out reports where a term
moves it, and in held-out whitened energy beside it (an unrotated wind or a lag hardly moves the
mean). The noise floor is the disagreement with everything found, known and unknown, taken off.

Validity: as the modules that made the pieces. Speeds in kt in the ``gap`` and ``closure`` entries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.closure.of_scatter import Reduction
from airswing.gap.evidence.gaussian import Score, luck
from airswing.gap.evidence.localisation import Slice
from airswing.gap.evidence.term_covariance import term_offsets
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.held_out.reduction import Closure
from airswing.gap.result.describe import (
    Readout,
    ambiguity,
    describe_term,
    period_of,
    probability,
    unknown_place,
)
from airswing.gap.result.schema import (
    ClosureEntry,
    CountsEntry,
    DisagreementEntry,
    EffectEntry,
    EvidenceEntry,
    GapReport,
    MeanEntry,
    PlaceEntry,
    StepEntry,
    UnconfirmedEntry,
    UnknownEntry,
)
from airswing.gap.result.single_entries import (
    bounds,
    evidence_entry,
    moment_entry,
    noise_entry,
    scatter_place,
    sent_place,
    slice_entry,
    swap_entry,
)
from airswing.gap.result.term_tables import table_of_term
from airswing.gap.scatter.excess_scatter import Scattering
from airswing.gap.scatter.moment_verdict import MomentVerdict
from airswing.gap.search.cross_validated import Doubtful
from airswing.gap.search.stepwise import Found
from airswing.gap.search.tail_swaps import Swap
from airswing.gap.sums.problem import Problem
from airswing.gap.witness.sent_winds import SentWinds

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Findings:
    """What the steps of a diagnosis found."""

    found: Found  # terms, with their rivals
    # closure, whole: of what has a name, and with unknown terms as well
    closure: Closure
    whole: Closure
    where: Sequence[Slice]
    untestable: Mapping[str, str]  # name -> why the archive cannot show it
    # the same of effects that what is always fitted takes up, named or not
    hidden: Mapping[str, str]
    energy: tuple[Floats, Floats]  # (t,), (t,): held-out energy of the terms and its standard error
    weighed: Floats  # (t, f): what the probabilities of the terms were made of
    means: Mapping[int, int]  # positions of terms that are the mean of an unknown one -> that one's
    # factors, doubts: reliabilities of the gradient effects, and their relative standard errors
    factors: Mapping[str, float]
    doubts: Mapping[str, float]
    swap: Swap | None
    moments: Sequence[MomentVerdict]
    scatter: Mapping[str, Reduction]  # name of each effect of scatter -> what it closes
    jittery: Scattering | None
    sent: SentWinds | None  # winds sent otherwise than simulated ones
    doubtful: Sequence[Doubtful]  # names that days left out did not confirm


def assemble(problem: Problem, findings: Findings) -> GapReport:
    """Make the content of gap.json, but for the checks."""
    closure, whole = findings.closure, findings.whole
    effects, unknown = _found_entries(problem, findings)
    everything = closure.before - whole.after
    explained = closure.before - closure.after
    # kt: of a gap that is none no part can be closed
    fraction = float(np.clip(explained / everything, 0, 1)) if everything > 1e-6 else None
    best = max((t.score.tempered for t in findings.found.terms), default=0.0)
    nats = [*(e.evidence_nats for e in effects), *(place.evidence_nats for place in unknown)]
    best = max([best, *nats])
    slices = [slice_entry(s) for s in findings.where]
    stats = problem.base.stats
    return GapReport(
        gap=DisagreementEntry(
            mean_vector_disagreement_kt=closure.before,
            noise_floor_kt=whole.after,
            significance=luck(best),
        ),
        # one in twenty of those below 0.05 is chance; all of them stand in `slices`
        where=[entry for entry in slices if entry.q_value < 0.05][:20],
        effects=effects,
        unknown=UnknownEntry(bool(unknown), unknown),
        closure=ClosureEntry(
            before=closure.before,
            after=closure.after,
            ci=bounds(closure.after_ci),
            fraction_of_excess=fraction,
            held_out=True,
            reduction=explained,
            reduction_ci=bounds(closure.reduction_ci),
        ),
        counts=CountsEntry(
            reports=problem.reports,
            flights=problem.flights,
            reports_in_view=problem.archive.size,
            days=int(np.unique(stats.calendar_day).size),
            clipped=float(stats.clipped.sum()),
            gross=float(stats.gross.sum()),
            aircraft=len(problem.archive.tails),
        ),
        noise=noise_entry(problem),
        unconfirmed=[doubtful_entry(d, problem) for d in findings.doubtful],
        waterfall=_waterfall(closure, whole),
        alone_kt=list(closure.alone),
        evidence=evidence_table(findings.found),
        untestable=dict(findings.untestable),
        slices=slices,
        reliability=dict(findings.factors),
        seed=problem.seed,
        ambiguity={entry.name: entry.ambiguity for entry in effects},
    )


def _found_entries(
    problem: Problem, findings: Findings
) -> tuple[list[EffectEntry], list[PlaceEntry]]:
    """Entries of ``effects`` and of ``unknown.where``."""
    named, means = _named(problem, findings)
    unknown = _places(problem, findings, means)
    # of nothing every share is nothing
    total = sum(max(e.held_out_energy, 0) for e in named) or 1.0
    effects = [replace(e, share_of_energy=max(e.held_out_energy, 0) / total) for e in named]
    whole = findings.closure.before - findings.closure.after
    for moment in findings.moments:
        # effects of scatter stand behind the named ones: they are no step of the waterfall
        reduction = findings.scatter[moment.name]
        share = float(np.clip(reduction.kt / whole, 0, 1)) if whole > 1e-6 else 0.0
        effects.append(replace(moment_entry(moment, reduction), share_of_gap=share))
    if findings.jittery is not None:
        fleet = problem.archive.tails
        unknown.append(scatter_place(findings.jittery, fleet, findings.scatter["scatter"]))
    if findings.sent is not None:
        unknown.append(sent_place(findings.sent, problem.archive.tails, findings.scatter))
    if findings.swap is not None:
        effects.append(swap_entry(findings.swap, problem.base))
    # last, for scatter and swaps are named apart from the search
    effects.sort(key=lambda e: -e.held_out_energy)
    return effects, unknown


def _named(
    problem: Problem, findings: Findings
) -> tuple[list[EffectEntry], dict[int, EffectEntry]]:
    """Terms with a name; apart, by the unknown term's position, those that are its mean."""
    found, (energy, error) = findings.found, findings.energy
    offsets = term_offsets(found.given, found.terms)
    shares = _shares(found.terms, findings.closure)
    entries: list[EffectEntry] = []
    means: dict[int, EffectEntry] = {}
    for k, term in enumerate(found.terms):
        if not term.candidate.known:
            continue
        readout = Readout(problem.effects, problem.archive, findings.factors, findings.doubts)
        entry = describe_term(term, offsets[k], found, problem.base, readout=readout)
        if k in findings.means:
            means[findings.means[k]] = entry
            continue
        rivals = ambiguity(term, found.rivals[k], found.left)
        entries.append(
            replace(
                entry,
                ambiguous_with=[rival.name for rival in rivals],
                ambiguity=rivals,
                share_of_gap=shares[len(entries)],
                held_out_energy=float(energy[k]),
                held_out_energy_standard_error=float(error[k]),
                weighed=_rounded(findings.weighed[k]),
            )
        )
    return entries, means


def _rounded(weighed: Floats) -> list[float]:
    return [round(float(x), 3) for x in weighed]


def _places(
    problem: Problem, findings: Findings, means: Mapping[int, EffectEntry]
) -> list[PlaceEntry]:
    """Places of the terms of the nonparametric basis."""
    found, (energy, error) = findings.found, findings.energy
    offsets = term_offsets(found.given, found.terms)
    fitted = term_coefficients(found.given, found.terms)
    out = []
    for k, term in enumerate(found.terms):
        if term.candidate.known:
            continue
        group = next(g for g in problem.plan.groups if g.name == term.candidate.name)
        stats = problem.base.stats
        place = unknown_place(term, found.given, offsets[k], stats, group.labels, found.rivals[k])
        table = table_of_term(problem, term, fitted[k])
        if table is not None:
            place = replace(place, curve=table)
        mean = means.get(k)
        if mean is not None:
            told = MeanEntry(mean.name, mean.tails, mean.parameters, mean.standard_errors)
            place = replace(place, mean=told)
        out.append(
            replace(
                place,
                held_out_energy=float(energy[k]),
                held_out_energy_standard_error=float(error[k]),
            )
        )
    return out


def doubtful_entry(doubtful: Doubtful, problem: Problem) -> UnconfirmedEntry:
    """Entry of ``unconfirmed``: a name the search came to that is not counted as found."""
    term, stats = doubtful.term, problem.base.stats
    return UnconfirmedEntry(
        name=term.candidate.name,
        tails=[stats.tails[a] for a in term.tails],
        period=period_of(term, stats),
        probability=doubtful.probability,
        evidence_nats=round(term.score.tempered, 2),
        weighed=_rounded(doubtful.weighed),
        reason=doubtful.reason,
    )


def _shares(terms: Sequence[Term], closure: Closure) -> list[float]:
    """Each known term's share of the disagreement's reduction, from its step in the sequence."""
    before = closure.before
    out = []
    total = closure.before - closure.after
    # each by what it adds to those before it: shares then sum to what all close together
    for _, after, _, _ in closure.sequence:
        out.append(float(np.clip((before - after) / total, 0, 1)) if total > 1e-6 else 0.0)
        before = after
    return out or [0.0] * len(terms)


def _waterfall(closure: Closure, whole: Closure) -> list[StepEntry]:
    """Disagreement of the real gap, after each effect, and the noise floor, kt."""
    steps = [StepEntry(name, after, [low, high]) for name, after, low, high in closure.sequence]
    first = StepEntry("reports as they are", closure.before, None)
    return [first, *steps, StepEntry("noise floor", whole.after, None)]


def evidence_table(found: Found) -> list[EvidenceEntry]:
    """All candidates with each term taken out, ranked; and those left over in the end."""
    out = [
        evidence_entry(score, term.candidate.name)
        for term, ranked in zip(found.terms, found.rivals, strict=True)
        # ranked: what lies further behind is no rival, and there are hundreds
        for score in ranked[:40]
    ]
    return out + [evidence_entry(score, None) for score in found.left]


def best_scores(found: Found) -> list[Score]:
    """Best score of every effect of the catalogue: with each term taken out, and with all in.

    Its forms and scopes are ranked as in the search, by raw evidence.

    Returns
    -------
    list of Score
        Best first.
    """
    best: dict[str, Score] = {}
    for ranked in (*found.rivals, found.left):
        for score in ranked:
            name = score.candidate.name
            if score.candidate.known and (name not in best or score.raw > best[name].raw):
                best[name] = score
    return sorted(best.values(), key=lambda score: -score.tempered)


def aircraft_probability(score: Score) -> Floats:
    """Probability that an effect acts on each aircraft, (A,); the fleet's acts on all or none."""
    if score.candidate.scope == "fleet":
        return np.full(score.posterior.size, probability(score))
    return score.posterior
