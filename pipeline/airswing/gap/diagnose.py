"""The diagnosis of an archive in one call: noise, sums, search, where, which, how far.

Assumptions: those of the modules it calls, in the order of GAP.md. The search runs twice where
effects are large: the second time on residuals linearised about the effects found first, with the
noise fitted after taking them off.

Validity: at least two aircraft-weeks and some thousand reports for anything but "nothing found".
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.checks.aliases import hidden_shares
from airswing.gap.checks.assumptions import run_checks, with_aliases
from airswing.gap.checks.refit_claims import Adjustment, make_adjustment
from airswing.gap.closure.interval import with_interval
from airswing.gap.design.basis import DictionaryPlan, plan_dictionary
from airswing.gap.design.candidates import candidates
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.design.layout import make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.localisation import residual_maps, slices
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.attenuation import readout_factors
from airswing.gap.held_out.reduction import (
    close,
    is_sensor,
    take_off,
    term_coefficients,
    term_error,
    term_fields,
    whole_coefficients,
)
from airswing.gap.noise.model import fit_noise, flown
from airswing.gap.result.assembled import Findings, aircraft_probability, assemble, best_scores
from airswing.gap.search.absorbed_by_unknown import folded
from airswing.gap.search.coding_and_outliers import second_moments
from airswing.gap.search.cross_validated import Standing, settle
from airswing.gap.search.excess_scatter import scattering
from airswing.gap.search.stepwise import Found, Rules, with_background
from airswing.gap.search.tail_swaps import Swap, exchange, find_swap
from airswing.gap.search.testability import absorbed, too_short
from airswing.gap.sums.accumulate import accumulate
from airswing.gap.sums.elimination import eliminate_days
from airswing.gap.sums.problem import Problem
from airswing.gap.sums.variance_components import shared_prior, shared_variances
from airswing.units import DAY

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Size at single reports, m/s, from which an effect is in danger of being clipped as gross errors.
PEAK = 2.5


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes
    ----------
    report : dict
        The content of gap.json.
    dataset : xarray.Dataset
        The content of gap.nc.
    details : dict
        Everything else a page shows: waterfall, evidence, noise, ambiguity, untestable effects,
        calibration, decoy, aliases, assumptions.
    adjustment : Adjustment
        What takes the effects beside the deviation off the winds.
    """

    report: dict[str, Any]
    dataset: xr.Dataset
    details: dict[str, Any]
    adjustment: Adjustment


@dataclass(frozen=True)
class Pass:
    """One pass over the reports and the search on its sums."""

    problem: Problem
    standing: Standing


@dataclass(frozen=True)
class Search:
    """What is looked for, and how."""

    effects: Mapping[str, Any]
    rules: Rules
    dictionary: bool
    seed: int
    tell: Progress


def usable_effects(
    frame: Frame, catalogue: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Effects whose columns can be tested in an archive, and why the others cannot.

    Parameters
    ----------
    frame : Frame
    catalogue : mapping

    Returns
    -------
    effects : dict
        Name -> effect with design columns.
    untestable : dict
        Name -> reason.
    """
    effects, untestable = {}, {}
    for name, effect in catalogue.items():
        reason = effect.testable(frame)
        if reason is not None:
            untestable[name] = reason
        elif effect.kind not in ("second_moment", "swap"):
            effects[name] = effect
    return effects, untestable


def diagnose(
    frame: Frame,
    *,
    catalogue: Mapping[str, Any] | None = None,
    rules: Rules | None = None,
    dictionary: bool = True,
    maps: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose where an archive parts from its simulation, why, and how far that closes.

    Parameters
    ----------
    frame : Frame
        Reports against one reference.
    catalogue : mapping, optional
        Name -> effect; the whole catalogue by default.
    rules : Rules, optional
        Thresholds of the search.
    dictionary : bool
        Also look outside the catalogue.
    maps : bool
        Also make the maps.
    seed : int
        Of the draws (noise fit, bootstrap).
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        Fewer than 200 reports or fewer than four flights.
    """
    _check(frame)
    effects, untestable = usable_effects(frame, CATALOGUE if catalogue is None else catalogue)
    tell = progress or (lambda stage, done: None)
    search = Search(effects, rules or Rules(), dictionary, seed, tell)
    known_names = set(CATALOGUE if catalogue is None else catalogue)
    first, swap = _first_pass(frame, search, swaps="tail_swap" in known_names)
    final = _second_pass(first, search)
    problem, found = final.problem, final.standing.found
    findings = _findings(final, search, again=final is not first, names=known_names)
    findings = replace(findings, swap=swap, untestable=untestable | dict(findings.untestable))
    report, details = assemble(problem, findings)
    tell("checks", 0.0)
    checks = run_checks(problem, found, findings.closure)
    unseen = [name for name, reason in findings.hidden.items() if not reason.startswith("in part")]
    hidden = hidden_shares(problem.base.stats, found.terms, unseen)
    with_aliases(report["effects"], checks.shares, hidden)
    dataset = _dataset(problem, found, maps).assign(checks.histograms())
    fitted = term_coefficients(found.given, found.terms)
    whole = whole_coefficients(fitted, found.terms, findings.factors)
    adjustment = make_adjustment(problem, found.terms, whole)
    return Diagnosis(report, dataset, details | checks.details(), adjustment)


def _first_pass(frame: Frame, search: Search, *, swaps: bool) -> tuple[Pass, Swap | None]:
    """Pass over the reports as they are; again where two aircraft exchanged identifiers."""
    first = _run(frame, exogenous(frame), frame.residual, search)
    base = first.problem.base
    swap = find_swap(base, given_terms(base, []), search.effects) if swaps else None
    if swap is not None:
        start = float(base.stats.days[swap.day]) * DAY + base.stats.day_shift * 3600
        frame = exchange(frame, swap, start)
        first = _run(frame, exogenous(frame), frame.residual, search)
    return first, swap


def _second_pass(first: Pass, search: Search) -> Pass:
    """Linearise about what was found first, where that is large; else the first pass."""
    frame, context = first.problem.archive, first.problem.context
    terms = first.standing.found.terms
    parts = _parts(first)
    if parts.peak <= PEAK and not any(_large(t) for t in terms):
        return first
    quiet = take_off(frame, parts.sensor, parts.other)
    return _run(frame, context, quiet + parts.linear, search, quiet=quiet, start=terms)


def _findings(final: Pass, search: Search, *, again: bool, names: Collection[str]) -> Findings:
    """Work out closure, where the gap lies, what shows in no mean, what cannot be tested."""
    problem, standing = final.problem, final.standing
    found, base, frame = standing.found, problem.base, problem.archive
    search.tell("closure", 0.0)
    means = folded(found.terms, standing.energy, standing.error)
    stated = [k for k, t in enumerate(found.terms) if t.candidate.known and k not in means]
    fitted = term_coefficients(found.given, found.terms)
    factors, doubts = readout_factors(problem, found.terms, fitted, again=again)
    closure = close(problem, [found.terms[k] for k in stated], factors=factors)
    whole = closure
    if len(stated) < len(found.terms):
        whole = close(problem, found.terms, factors=factors)
    closure = with_interval(closure, problem, found, known=stated, factors=factors, doubts=doubts)
    bare = given_terms(base, [])
    pool = candidates(base.stats.layout, search.effects, dictionary=False)
    hidden = absorbed(base, bare, pool, search.effects)
    named = {term.candidate.name for term in found.terms}
    untestable = {name: reason for name, reason in hidden.items() if name not in named}
    untestable |= too_short(base, search.effects)
    search.tell("where", 0.0)
    moments = [m for m in second_moments(frame, problem.noise) if m.name in names]
    jittery = None
    if search.dictionary:
        explained = {tail for moment in moments for tail in moment.tails}
        jittery = scattering(frame, whole.residual, problem.noise, explained=explained)
    return Findings(
        found=found,
        closure=closure,
        whole=whole,
        where=slices(base, bare, problem.plan) if search.dictionary else [],
        untestable=untestable,
        hidden=hidden,
        energy=(standing.energy, standing.error),
        means=means,
        factors=factors,
        doubts=doubts,
        swap=None,
        moments=moments,
        jittery=jittery,
    )


def _check(frame: Frame) -> None:
    flights = np.unique(frame.flight).size
    if frame.size < 200 or flights < 4:
        raise InputError(
            "too few reports for a diagnosis", found=f"{frame.size} reports of {flights} flights",
            remedy="at least 200 reports of four flights with model winds are needed",
        )  # fmt: skip


def _large(term: Term) -> bool:
    """Whether a term is large enough to be linearised again and to disturb the noise fit."""
    return bool(np.max(term.score.size[list(term.tails)]) > 1.5)


def _run(
    frame: Frame,
    context: Frame,
    residual: Floats,
    search: Search,
    *,
    quiet: Floats | None = None,
    start: Sequence[Term] = (),
) -> Pass:
    """Fit the noise, accumulate and search; the noise on ``quiet`` residuals where given.

    Beside that noise all that is at work stands out, most of all what is not conditioned on yet: a
    second search begins with the terms of the first.
    """
    effects, tell = search.effects, search.tell
    tell("noise", 0.0)
    calm = residual if quiet is None else quiet
    noise = fit_noise(calm, flown(context, heading_doubt(frame, context)), seed=search.seed)
    plan = plan_dictionary(context, effects)
    if not search.dictionary:
        plan = DictionaryPlan(plan.knots, (), plan.centre, plan.means, plan.flags)
    layout = make_layout(effects, plan, context)
    stats = accumulate(
        context,
        residual,
        noise=noise,
        layout=layout,
        effects=effects,
        plan=plan,
        known=None if quiet is None else residual - quiet,
        progress=lambda done: tell("statistics", done),
    )
    tell("search", 0.0)
    base = eliminate_days(stats, shared_variances(stats, shared_prior(layout, effects)))
    pool = candidates(layout, effects, dictionary=search.dictionary)
    base = with_background(base, pool)
    problem = Problem(frame, context, effects, plan, noise, base, search.seed)
    return Pass(problem, settle(base, pool, search.rules, start))


def _quantile(size: Floats) -> float:
    return float(np.quantile(size, 0.999)) if size.size else 0.0


@dataclass(frozen=True)
class _Parts:
    """Wind errors (n, 2) of the terms found so far, m/s.

    ``sensor`` and ``other`` on the frame as reported, ``linear`` by the design columns; ``peak``
    is the size that one report in a thousand of those a term acts on exceeds, of the worst term.
    """

    sensor: Floats
    other: Floats
    linear: Floats
    peak: float


def _parts(first: Pass) -> _Parts:
    """Evaluate the terms of a pass on every report."""
    problem, terms = first.problem, first.standing.found.terms
    frame, columns_frame, effects = problem.archive, problem.context, problem.effects
    day, shape = problem.day, problem.shape
    values = term_coefficients(first.standing.found.given, terms)
    sensor, other, linear = (np.zeros((frame.size, 2)) for _ in range(3))
    nothing = np.zeros(frame.size, np.int64)
    peak = 0.0
    for term, value in zip(terms, values, strict=True):
        for source in (frame, columns_frame):
            fields = term_fields(source, term, effects=effects, plan=problem.plan)
            part = term_error(fields, term, [value], aircraft=frame.aircraft, day=day,
                              fold=nothing, shape=shape)  # fmt: skip
            if source is columns_frame:
                linear += part
                size = np.hypot(*part.T)
                peak = max(peak, _quantile(size[size > 0]))
            elif is_sensor(term, effects):
                sensor += part
            else:
                other += part
    return _Parts(sensor, other, linear, peak)


def _dataset(problem: Problem, found: Found, maps: bool) -> xr.Dataset:
    """Maps, evidence table and statistics as one Dataset."""
    frame, stats, noise = problem.archive, problem.base.stats, problem.noise
    out = residual_maps(frame) if maps else xr.Dataset(coords={"aircraft": list(frame.tails)})
    core = stats.layout.core
    names = np.array([f"{n}[{i}]" for n, b in stats.layout.blocks.items() if b.stop <= core
                      for i in range(b.stop - b.start)], dtype=object)  # fmt: skip
    out["core_column"] = ("core_column", names)
    out["core_column_2"] = ("core_column_2", names)
    out["day"] = ("day", (stats.days * 86400).astype("datetime64[s]").astype("datetime64[ns]"))
    out["score"] = (("aircraft", "day", "core_column"), stats.day_score[:, :, :core])
    out["information"] = (
        ("aircraft", "core_column", "core_column_2"), stats.day_gram.sum(axis=1, dtype=float),
    )  # fmt: skip
    out["report_count"] = (("aircraft", "day"), stats.day_count)
    out["clipped_count"] = (("aircraft",), stats.clipped)
    out["gross_error_count"] = (("aircraft",), stats.gross)
    best = best_scores(found)
    out["effect"] = ("effect", np.array([s.candidate.name for s in best], dtype=object))
    out["log_evidence"] = ("effect", np.array([s.tempered for s in best], float))
    shares = [aircraft_probability(s) for s in best]
    out["aircraft_probability"] = (
        ("effect", "aircraft"), np.reshape(shares, (len(best), len(frame.tails)))
    )  # fmt: skip
    out["noise_distance"] = (("distance",), noise.distance_km)
    out["noise_autocovariance"] = (("distance",), noise.autocovariance)
    out["noise_autocovariance_model"] = (("distance",), noise.autocovariance_model)
    out["noise_level_factor"] = (("noise_level",), noise.model.level_factors)
    out["noise_level"] = (("noise_level",), np.exp(noise.model.level_nodes) / 100)
    return out
