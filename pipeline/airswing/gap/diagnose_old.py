"""The diagnosis of an archive in one call: noise, sums, search, where, which, how far.

Assumptions: those of the modules it calls, in the order of docs/gap.md. The search runs twice where
effects are large: the second time on residuals linearised about the effects found first, with the
noise fitted after taking them off.

Validity: at least two aircraft-weeks and some thousand reports for anything but "nothing found".
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import xarray as xr

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.as_sent.in_turn import all_mended
from airswing.gap.as_sent.mended import Mended
from airswing.gap.checks.aliases import hidden_shares
from airswing.gap.checks.assumptions import Checks, run_checks, with_aliases
from airswing.gap.checks.refit_claims import Adjustment, make_adjustment
from airswing.gap.closure.interval import with_interval
from airswing.gap.closure.of_scatter import (
    Reduction,
    reduction_of,
    with_scatter,
)
from airswing.gap.design.candidates import candidates
from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.gaussian import plain_probability
from airswing.gap.evidence.localisation import slices
from airswing.gap.evidence.terms import given_terms
from airswing.gap.held_out.attenuation import readout_factors
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.held_out.reduction import close, whole_coefficients
from airswing.gap.in_no_mean import in_no_mean
from airswing.gap.library_threads import one_library_thread
from airswing.gap.names_and_unknowns import names_and_unknowns
from airswing.gap.noise.residual_statistics import gross_errors
from airswing.gap.passes import Pass, Progress, Search, of_view
from airswing.gap.result.assembled import Findings, assemble
from airswing.gap.result.diagnosis_dataset import diagnosis_dataset
from airswing.gap.result.schema import EffectEntry, GapReport
from airswing.gap.result.unknown_entries import with_unknowns
from airswing.gap.scatter.second_moments import second_moments
from airswing.gap.search.absorbed_by_unknown import folded
from airswing.gap.search.cross_validated import Doubtful
from airswing.gap.search.stepwise import Rules
from airswing.gap.search.testability import absorbed, too_short
from airswing.gap.sums.problem import Problem
from airswing.gap.sums.whole_archive import Archive, held_archive
from airswing.gap.taken_off.unknown_taken import Taken


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found."""

    report: GapReport  # the content of gap.json
    dataset: xr.Dataset  # the content of gap.nc
    adjustment: Adjustment  # what takes the effects beside the deviation off the winds

    def __repr__(self) -> str:
        """Say in a few lines what is at work and how far it closes."""
        closure = self.report.closure
        unnamed = [" x ".join(place.variables) for place in self.report.unknown.where]
        return "\n".join(
            [
                f"Diagnosis: {closure.before:.2f} kt before, {closure.after:.2f} kt after",
                *(f"  {_line(effect)}" for effect in self.report.effects),
                *(f"  without a name: {place}" for place in unnamed),
            ]
        )


def _line(effect: EffectEntry) -> str:
    tails = effect.tails
    whom = "the fleet" if not tails else ", ".join(tails[:4]) + (" ..." if len(tails) > 4 else "")
    return f"{effect.name} ({whom}), probability {effect.probability:.2f}"


def _asked(headings: xr.Dataset, reference: str | Sequence[str] | None) -> str | Sequence[str]:
    """The reference asked for, or the first that the headings hold."""
    if reference is not None:
        return reference
    if "reference" not in headings.coords or not headings.sizes["reference"]:
        raise InputError("the headings hold no reference", field="reference")
    return str(headings["reference"].to_numpy()[0])


def usable_effects(
    frame: Frame, catalogue: Mapping[str, Effect]
) -> tuple[dict[str, Effect], dict[str, str]]:
    """Effects whose columns can be tested in an archive, and why the others cannot.

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
    reports: xr.Dataset | Frame | Archive,
    *,
    reference: str | Sequence[str] | None = None,
    catalogue: Mapping[str, Effect] | None = None,
    dictionary: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose where an archive parts from its simulation, why, and how far that closes.

    Parameters
    ----------
    reports : Dataset, Frame or Archive
        Screened headings with the columns the gap needs; or reports against one reference, in
        memory or to be read an aircraft at a time
        (:func:`airswing.gap.sums.whole_archive.read_archive`).
    reference : str or sequence of str, optional
        Of a Dataset: which reference, or the members of a pool; the first when not given.
    catalogue : mapping, optional
        Name -> effect; the whole catalogue by default.
    dictionary : bool
        Also look outside the catalogue.
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
    if isinstance(reports, xr.Dataset):
        reports = Frame.from_headings(reports, reference=_asked(reports, reference))
    archive = held_archive(reports) if isinstance(reports, Frame) else reports
    _check(archive)
    tell = progress or (lambda stage, done: None)
    with one_library_thread():
        return _diagnosed(
            archive, CATALOGUE if catalogue is None else catalogue, dictionary, seed, tell
        )


def _diagnosed(
    archive: Archive,
    catalogue: Mapping[str, Effect],
    dictionary: bool,
    seed: int,
    tell: Progress,
) -> Diagnosis:
    """Search, name, take unknowns off and search again, until nothing is left; then say so."""
    effects, untestable = usable_effects(archive.view, catalogue)
    search = Search(effects, Rules(), dictionary, seed, tell)
    known_names = set(catalogue)
    swaps = "tail_swap" in known_names and not archive.clock.short
    mended = all_mended(archive.view, known_names) if dictionary else []
    if mended:  # nothing is fitted to winds that are not the aircraft's own
        archive = of_view(archive, mended[-1].lifted)
    told = names_and_unknowns(archive, search, swaps=swaps)
    final, again, swap = told.final, told.again, told.swap
    problem, found = final.problem, final.standing.found
    findings = _findings(final, told.search, again=again, names=known_names)
    findings = _without_remnant(findings, told.taken, mended=mended)
    findings = _with_doubtful(findings, told.doubtful)
    findings = replace(findings, swap=swap, untestable=untestable | dict(findings.untestable))
    report = assemble(problem, findings)
    report = with_unknowns(
        report, told.taken, problem=problem, found=found, whole=findings.whole, mended=mended
    )
    tell("checks", 0.0)
    checks = run_checks(problem, found, findings.closure)
    report = _with_rivals(checks.told(report), checks, problem, findings)
    dataset = diagnosis_dataset(problem, found).assign(checks.histograms())
    return Diagnosis(report, dataset, _adjustment(final, findings.factors))


def _adjustment(final: Pass, factors: Mapping[str, float]) -> Adjustment:
    """What takes the effects beside the deviation off the winds, by the fit to all days."""
    found = final.standing.found
    fitted = term_coefficients(found.given, found.terms)
    return make_adjustment(
        final.problem, found.terms, whole_coefficients(fitted, found.terms, factors)
    )


def _with_rivals(
    report: GapReport, checks: Checks, problem: Problem, findings: Findings
) -> GapReport:
    """Say of every name which others look like it."""
    unseen = [name for name, reason in findings.hidden.items() if not reason.startswith("in part")]
    hidden = hidden_shares(problem.base.stats, findings.found.terms, unseen)
    told = with_aliases(report.effects, checks.shares, hidden)
    return replace(report, effects=told, ambiguity={entry.name: entry.ambiguity for entry in told})


def _without_remnant(
    findings: Findings, taken: Sequence[Taken], *, mended: Sequence[Mended]
) -> Findings:
    """Leave out winds sent for others where that is what a table's cells left of its variable."""
    told = {name for one in taken for name in one.unknown.grid.variables}
    told |= {"wind_speed"} if mended else set()
    if findings.sent is not None and told & set(findings.sent.telling):
        return replace(findings, sent=None)
    return findings


def _with_doubtful(findings: Findings, name: Doubtful | None) -> Findings:
    """Add a name that days tell but not beyond doubt, where it does not stand."""
    stand = {term.candidate.name for term in findings.found.terms}
    if name is None or not name.reason or name.term.candidate.name in stand:
        return findings
    return replace(findings, doubtful=(*findings.doubtful, name))


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
    # what an effect switches on and off stands out from its neighbours, and is no gross error
    calm = replace(problem.noise, gross=gross_errors(whole.residual, problem.noise.order))
    moments = [
        m
        for m in second_moments(frame, calm)
        if m.name in names and plain_probability(m.evidence) >= search.rules.probability
    ]
    scatter = {m.name: reduction_of(frame, whole.residual, m, calm.gross) for m in moments}
    closure, whole = with_scatter(closure, scatter), with_scatter(whole, scatter)
    jittery = sent = None
    unnamed: dict[str, Reduction] = {}
    if search.dictionary:
        jittery, sent, unnamed = in_no_mean(problem, whole.residual, moments, calm.gross, search)
    scatter |= unnamed
    whole = with_scatter(whole, unnamed)
    return Findings(
        found=found,
        closure=closure,
        whole=whole,
        where=slices(base, bare, problem.plan) if search.dictionary else [],
        untestable=untestable,
        hidden=hidden,
        energy=(standing.energy, standing.error),
        weighed=standing.weighed,
        means=means,
        factors=factors,
        doubts=doubts,
        swap=None,
        moments=moments,
        scatter=scatter,
        jittery=jittery,
        sent=sent,
        doubtful=standing.doubtful,
    )


def _check(archive: Archive) -> None:
    # less holds neither the noise along flights nor what flights differ by
    if archive.reports < 200 or archive.flights < 4:
        raise InputError(
            "too few reports for a diagnosis",
            found=f"{archive.reports} reports of {archive.flights} flights",
            remedy="at least 200 reports of four flights with model winds are needed",
        )
