"""Selection of terms: screen, exact contest, and replacement until nothing changes.

The steps are those of docs/gap.md, section 5. All candidates are ranked with one noise factor kappa
and gated with their own: mixing the two in one ranking would make a change and a table of the date
replace each other for ever.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from airswing.gap.archive.reported_variables import KINDS, KNOTS
from airswing.gap.arrays import Floats
from airswing.gap.model.candidates import Group, Table
from airswing.gap.model.evidence import SMALL, dated_evidence, static_evidence
from airswing.gap.model.pairs import FINE, add_pairs
from airswing.gap.model.sums import GATE
from airswing.gap.model.terms import Model, Statistics, Term, log_evidence, set_prior

LOG = logging.getLogger(__name__)
#: Share of a table's log evidence that a name must hold: a deviation of 5 degrees turns the heading
#: its columns are evaluated at, an error of first order of (5 degrees)^2 / 2 = 0.4 % of the energy;
#: ten times that for context that is inferred.
REPRESENTS = 0.96
#: Largest standard error of a coefficient of `usual_sizes`, m/s; fewest of them; median
#: of chi squared with one degree of freedom.
MAX_ERROR, MIN_NUMBER, CHI_SQUARED_MEDIAN = 0.15, 20, 0.455
#: Days below which fleet-wide effects cannot be separated from the weather of those days.
DAYS = 3
#: Names in a contest, and tables of each scope, the best by the screening score.
NAMES, TABLES = 12, 6
#: Most terms, rounds of replacement after an addition, and names that represent a table together.
MAX_TERMS, ROUNDS, MAX_NAMES = 8, 2, 3
#: Other lever of each component, and multiples of the usual number of knots.
LEVERS = {
    "heading_angle": "across_heading",
    "along_heading": "airspeed_factor",
    "wind_angle": "across_wind",
    "along_wind": "wind_factor",
}
FINER = (2, 4)
#: Most refinements of a table (two make 16 times the usual number of knots), and most coefficients
#: of one that is refined again: a fit to a thousand takes a second.
REFINEMENTS, MAX_COEFFICIENTS = 2, 1000
#: Log evidence from which a table is refined.
REFINED_FROM = 30.0


def screen(model: Model, groups: Sequence[Group] | None = None) -> list[Term]:
    """Candidates given the terms in the model, best first; ``score`` holds the log prior.

    All groups by default; the noise factor and the usual sizes are those of the model.
    """
    out: list[Term] = []
    for group in model.sums.candidates.groups if groups is None else groups:
        if group.kind == "nuisance":
            continue
        if group.dated:
            ranked, gated = dated_evidence(model, group, model.kappa, GATE - group.prior)
            scores = ranked.evidence + group.prior, gated.evidence + group.prior
            days = [*model.sums.first_day.tolist(), model.sums.D]
            period = {a: (days[start], days[stop]) for a, (start, stop) in gated.period.items()}
            fields = gated.scale, period, *scores, gated.inclusion
            if gated.tails:
                out.append(Term(group, "a", gated.tails, *fields, shape=gated.shape))
            continue
        out += _static_terms(model, group)
    return sorted(out, key=lambda term: -term.score)


def usual_sizes(
    statistics: Sequence[tuple[Group, Statistics]], kappa: float
) -> dict[str, tuple[float, float]]:
    """Variances of the errors that all aircraft, and all fleets, have, by quantity in error.

    With coefficients theta of variance v by their noise, the variance m^2 (m2 s-2) for which the
    median of theta^2 / (v + m^2) is that of chi squared; over all tables, aircraft and directions,
    of which an effect concerns few. Directions that are hardly known are left out.
    """
    out = {}
    for quantity in ("heading", "airspeed", "wind"):
        tables = [s for g, s in statistics if g.kind == "table" and g.quantity == quantity]
        aircraft = [_directions(s.information, s.score, kappa) for s in tables]
        fleet = [
            _directions(s.fleet_information[None], s.score.sum(0)[None], max(1.0, s.fleet_factor))
            for s in tables
        ]
        out[quantity] = _median_variance(aircraft), _median_variance(fleet)
    return out


def _directions(information: Floats, score: Floats, factor: float) -> tuple[Floats, Floats]:
    """Squared coefficients along the axes of the information, and their variances."""
    values, vectors = np.linalg.eigh(information)
    turned = np.einsum("aji,aj->ai", vectors, score)
    precise = values > factor / MAX_ERROR**2
    return (turned[precise] / values[precise]) ** 2, factor / values[precise]


def _median_variance(directions: Sequence[tuple[Floats, Floats]]) -> float:
    squares, noise = np.hstack([np.zeros((2, 0)), *directions])
    if squares.size < MIN_NUMBER:
        return 0.0
    variance = 0.0
    for step in (0.5**k for k in range(1, 31)):  # bisection of 0 to 1
        if np.median(squares / (noise + (variance + step))) > CHI_SQUARED_MEDIAN:
            variance += step
    return variance


def _static_terms(model: Model, group: Group) -> list[Term]:
    scopes = group.scopes
    if model.sums.span < DAYS:
        if not group.named:
            return []
        scopes = scopes.replace("f", "")
    # two terms of one name, or of one variable and component, on one aircraft would cancel
    same = [t for t in model.terms if _function(t.group) == _function(group) and not t.period]
    having = [a for term in same for a in term.tails if term.scope == "a"]
    if len(having) == model.sums.A:
        scopes = scopes.replace("a", "")
    if not group.named and any(term.scope == "f" for term in same):
        scopes = scopes.replace("f", "")
    if not scopes:
        return []
    stats = model.statistics(group)
    factor = max(model.kappa, stats.mean_factor)
    ranked = static_evidence(stats, model.kappa, scopes, having=having)
    gated = ranked
    if factor > model.kappa and any(r.evidence + group.prior > GATE for r in ranked.values()):
        gated = static_evidence(stats, factor, scopes, having=having)
    out = []
    for scope, r in ranked.items():
        score = r.evidence
        if scope == "f":  # lasting errors of the reference limit the evidence, but not the rank
            given = stats.fleet_information / model.kappa, stats.score.sum(axis=0) / model.kappa
            score = log_evidence(*given, np.eye(group.size) / r.scale**2, 1.0)
        if r.tails:
            scores = score + group.prior, gated[scope].evidence + group.prior
            out.append(Term(group, scope, r.tails, r.scale, {}, *scores, r.inclusion, r.spread))
    return out


def _function(group: Group) -> str:
    """Name of a group; of a table with another lever that with the usual one."""
    name, _, component = group.name.partition("|")
    usual = {lever: component for component, lever in LEVERS.items()}
    return group.name if group.named else f"{name}|{usual.get(component, component)}"


def contest(model: Model, terms: Sequence[Term], ranked: Sequence[Term]) -> list[Term]:
    """Best candidates by exact marginal likelihood together with the terms, best first."""
    by_kind: dict[tuple[object, ...], list[Term]] = {}
    for term in (term for term in ranked if term.gate > GATE):
        group = term.group
        kind = (group.name, term.scope, group.dated, group.form if group.simple else ())
        by_kind.setdefault(kind, []).append(term)
    first = [forms[0] for forms in by_kind.values()]
    names = [t for t in first if t.group.named][:NAMES]
    every = [t for t in first if not t.group.named and not t.group.simple]
    tables = [t for scope in "af" for t in [x for x in every if x.scope == scope][:TABLES]]
    simple = [t for t in first if t.group.simple]
    scored = [_rescored(model, terms, term) for term in (*names, *tables, *simple)]
    # the screening score hardly says which form fits
    named = [t for t in scored if t.group.named]
    least = REPRESENTS * max((t.score for t in named), default=0.0)
    for name in [t for t in named if t.score >= least]:
        forms = by_kind[name.group.name, name.scope, name.group.dated, ()]
        rescored = [_rescored(model, terms, form) for form in forms]
        scored[scored.index(name)] = max(rescored, key=lambda t: t.score)
    scored = [term for term in scored if term.score > GATE]
    scored.sort(key=lambda term: -term.score)
    while scored and not scored[0].group.named and _is_usual(model, terms, scored[0]):
        scored.pop(0)
    if not scored:
        return []
    best = scored[0]
    if not best.group.named:
        # no tolerance is due where a table has no more coefficients than the name
        tables = [t for t in scored if not t.group.named]
        names = [
            t
            for t in scored
            if t.group.named and not any(t.score < s.score and _is_as_simple(s, t) for s in tables)
        ]
        represented = [t for t in names if t.score > REPRESENTS * best.score]
        if represented:
            best = represented[0]
        elif names:
            best = _several_names(model, terms, tables, names) or best
    best = _refine_dates(model, terms, _prune_aircraft(model, terms, best))
    rest = [t for t in scored if t.label != best.label]
    rivals = tuple((best.score - t.score, t.group.name, t.scope) for t in rest)
    return [replace(best, rivals=rivals, weight=_posterior_weight(best, rest)), *rest]


def _contest_of_all(model: Model, terms: Sequence[Term], place: Term | None = None) -> list[Term]:
    added = add_pairs(model) if place is None or len(place.group.variables) == 2 else []
    ranking = contest(model, terms, screen(model))
    if place is not None and place.group.refined and ranking and not ranking[0].group.named:
        # other tables are refined only after they have won
        now = replace(_rescored(model, terms, place), rivals=place.rivals)
        ranking = sorted([*ranking, now], key=lambda t: -t.score)
    winner = ranking[0].group if ranking else None
    model.sums.candidates.forget([group for group in added if group is not winner])
    return ranking


def _is_usual(model: Model, terms: Sequence[Term], table: Term) -> bool:
    """Whether names in the size that no aircraft is free of leave a table nothing to explain."""
    every = tuple(range(model.sums.A))
    names: dict[str, Term] = {}
    for group in model.sums.candidates.groups:
        if group.named and not group.dated and "a" in group.scopes:
            usual = float(np.hypot(SMALL, np.sqrt(model.usual.get(group.quantity, (0.0,))[0])))
            names.setdefault(group.name, Term(group, "a", every, usual))
    return _rescored(model, [*terms, *names.values()], table).score <= GATE


def _several_names(
    model: Model, terms: Sequence[Term], tables: Sequence[Term], named: Sequence[Term]
) -> Term | None:
    """First of several names that leave the best table nothing to explain; None for none.

    A table of fewer coefficients must not be better than the names.
    """
    table, selected = tables[0], list[Term]()
    names = [group for group in model.sums.candidates.groups if group.named]
    freedom, total, first = 0, 0.0, None
    for _ in range(MAX_NAMES):
        fitted = [*terms, *selected]
        if selected:
            model.condition(fitted)
            named = [t for t in screen(model, names) if t.gate > GATE][:TABLES]
        options = [_rescored(model, fitted, term) for term in named]
        best = max(options, key=lambda t: t.score, default=None)
        if best is None or best.score <= GATE:
            break
        best = _prune_aircraft(model, fitted, best)
        LOG.debug("  several names: %s, score %.1f", best.key, best.score)
        selected.append(best)
        freedom, total = freedom + best.freedom, total + best.score
        if freedom > table.freedom:
            break
        if any(total < t.score and t.freedom < freedom for t in tables):
            continue
        remaining = _rescored(model, [*terms, *selected], table).score
        if total > REPRESENTS * table.score and remaining < (1 - REPRESENTS) * table.score:
            first = selected[0]
            break
    model.condition(terms)
    return first


def _is_as_simple(term: Term, rival: Term) -> bool:
    """Whether a term has no more coefficients than another, in all or for each aircraft."""
    by_aircraft = term.scope == rival.scope and term.group.size <= rival.group.size
    return by_aircraft or term.freedom <= rival.freedom


def _rescored(model: Model, terms: Sequence[Term], term: Term) -> Term:
    """A term with its exact evidence given others and its log prior as score."""
    score = model.gain(terms, term) + term.group.prior + set_prior(model, term)
    return replace(term, score=score)


def _posterior_weight(best: Term, rivals: Sequence[Term]) -> float:
    """Posterior probability of a term among those of the contest that are no part of it.

    A name competes with the other names and with simpler tables, a table with the names.
    """
    margins = [
        best.score - t.score
        for t in rivals
        if t.group.name != best.group.name
        and (t.group.named or (best.group.named and _is_as_simple(t, best)))
    ]
    return float(1 / (1 + np.exp(-np.array(margins)).sum()))


def _prune_aircraft(model: Model, terms: Sequence[Term], term: Term) -> Term:
    """A term without the aircraft that raise its exact evidence by their absence.

    The screening score gives the fleet's part back approximately: with an effect of several m/s on
    one aircraft it includes further ones.
    """
    if term.scope != "a":
        return term
    gram, score = model.given(terms, term)
    columns = np.arange(score.size).reshape(len(term.tails), -1)

    def with_tails(tails: Sequence[int]) -> Term:
        period = {a: term.period[a] for a in tails if a in term.period}
        subset = replace(term, tails=tuple(tails), period=period)
        index = columns[np.isin(term.tails, tails)].ravel()
        part = gram[np.ix_(index, index)], score[index], subset.precision
        evidence = log_evidence(*part, 1.0) + term.group.prior + set_prior(model, subset)
        return replace(subset, score=evidence)

    best = term
    while len(best.tails) > 1:
        options = [with_tails([b for b in best.tails if b != a]) for a in best.tails]
        candidate = max(options, key=lambda t: t.score)
        if candidate.score <= best.score:
            break
        best = candidate
    return best


def _refine_dates(model: Model, terms: Sequence[Term], term: Term) -> Term:
    """A term that begins and ends with stretches of days, with the days of largest evidence."""
    days, length = model.sums.D, int(np.diff(model.sums.first_day).max(initial=1))
    for screened in sorted(set(term.period.values())):
        tails = [a for a, period in term.period.items() if period == screened]
        start, stop = screened
        # each length that is screened is twice the one before
        within = length - 1 if stop == days else max(length - 1, (stop - start) // 2)
        for side in (0, 1) if stop < days else (0,):
            step = (within + 1) // 2
            while step:
                options = [term]
                for shift in (-step, step):
                    new = list(term.period[tails[0]])
                    new[side] += shift
                    if 0 < new[0] < new[1] <= days:
                        period = {**term.period, **dict.fromkeys(tails, (new[0], new[1]))}
                        options.append(_rescored(model, terms, replace(term, period=period)))
                best = max(options, key=lambda t: t.score)
                step = step // 2 if best is term else step
                term = best
                model.release([*model.terms, *terms, term])
    return term


def search(
    model: Model,
    second_order: Callable[[Sequence[Term]], float],
    *,
    start: Sequence[Term] = (),
    settled: bool = False,
) -> tuple[list[Term], bool]:
    """Add terms, and replace or remove them, until nothing changes; steps are logged (debug).

    ``second_order`` gives the log evidence of the second order of the terms' effects. A
    candidate with less may be a part of that, and the search ends before it. The terms of the
    ``start`` are contested first where the search that found them was complete (``settled``).
    Returns the terms, and whether the search is complete.
    """
    terms = list(start)
    model.condition(terms)
    estimate_scales(model)
    if terms and settled:
        terms = revisit(model, terms, 1)
    seen: set[frozenset[tuple[object, ...]]] = set()
    for _ in range(MAX_TERMS):
        ranking = _contest_of_all(model, terms)
        if not ranking:
            break
        LOG.debug("+ %s, score %.1f", ranking[0].key, ranking[0].score)
        if ranking[0].score < second_order(terms):
            return terms, False
        terms = [*terms, ranking[0]]
        model.condition(terms)
        terms = refined(model, terms, ranking[0])
        estimate_scales(model)
        terms = revisit(model, terms, ROUNDS)
        estimate_scales(model)
        state = frozenset(term.label for term in terms)
        if state in seen:
            break
        seen.add(state)
    return terms, True


def estimate_scales(model: Model) -> None:
    """Estimate the noise factor and the usual sizes given all terms in the model.

    An effect that is not in the model would raise the scatter of the days, and pass for usual.
    """
    groups = [g for g in model.sums.candidates.groups if g.named or g.form == (0,)]
    statistics = [(g, model.statistics(g)) for g in groups if not g.dated]
    factors = [float(np.nanmedian(s.factor)) for _, s in statistics]
    model.kappa = max(1.0, float(np.median(factors))) if factors else 1.0
    if model.terms:
        model.usual = usual_sizes(statistics, model.kappa)


def revisit(model: Model, terms: list[Term], rounds: int) -> list[Term]:
    """Remove each term and contest its place by the noise of the whole model."""
    for _ in range(rounds):
        changed = False
        for term in list(terms):
            rest = [t for t in terms if t is not term]
            model.condition(rest)
            ranking = _contest_of_all(model, rest, term)
            if not ranking:
                LOG.debug("- %s", term.key)
                terms, changed = rest, True
                continue
            new = ranking[0]
            changed |= new.key != term.key
            terms = [new if t is term else t for t in terms]
            if new.label != term.label:
                LOG.debug("~ %s -> %s, score %.1f", term.key, new.key, new.score)
                model.condition(terms)
                terms = refined(model, terms, new)
        model.condition(terms)
        if not changed:
            break
    return terms


# ------------------------------------------------------------------------------------- refinement
def refined(model: Model, terms: list[Term], term: Term) -> list[Term]:
    """Terms, on which the model is conditioned, with one of their tables refined."""
    component = term.group.component
    unrefined = component in LEVERS and not (term.group.named or term.group.dated)
    if not unrefined or term.score < REFINED_FROM:
        return terms
    candidates = model.sums.candidates
    curves = candidates.table_of(term.group).curves
    finer = [curves]
    if len(curves) == 2:
        finer.append(tuple(candidates.pair_curve(c.variable, FINE) for c in curves))
    # two correlated variables may imitate fine functions of one
    names = [c.variable for c in curves if KINDS[c.variable][0] != "category"]
    finer += [
        (candidates.curve(name, times * KNOTS[name]),) for name in names for times in (1, *FINER)
    ]
    options = [Table(c, lever) for c in finer for lever in (component, LEVERS[component])][1:]
    for _ in range(REFINEMENTS):
        best = _best_table(model, terms, term, options, float(np.log(1 + len(options))))
        if best is term:
            break
        LOG.debug("~ %s -> %s, score %.1f", term.key, best.key, best.score)
        terms = [best if t is term else t for t in terms]
        model.condition(terms)
        term, table = best, candidates.table_of(best.group)
        curve, *second = table.curves
        name, size = curve.variable, curve.knots.size
        if second or name not in names or size <= FINER[0] * KNOTS[name]:
            break
        # the finest of all is the best, and no other table could represent what it leaves
        number = size if term.scope == "f" else size * len(term.tails)
        options = [
            replace(table, curves=(candidates.curve(name, times * size),))
            for times in FINER
            if times * number <= MAX_COEFFICIENTS
        ]
    return terms


def _best_table(
    model: Model, terms: list[Term], term: Term, tables: Sequence[Table], weight: float
) -> Term:
    """Best of a term and the same with other tables, the log prior of each less by ``weight``.

    A table of one variable represents one of two like a name a table.
    """

    def value(option: Term) -> float:
        return option.score / (REPRESENTS if len(option.group.variables) == 1 else 1.0)

    candidates = model.sums.candidates
    rest = [t for t in terms if t is not term]
    now = _rescored(model, rest, term)
    best, least = term, value(now) + GATE * model.kappa
    for table in tables:
        group = candidates.add_table(table, candidates.log_prior(table) - weight, refined=True)
        model.sums.extend()
        if group is None:
            continue
        options = [
            _rescored(model, rest, replace(term, group=group, scale=scale))
            for scale in term.scale * np.array([0.25, 0.5, 1.0, 2.0])
        ]
        candidate = max(options, key=lambda t: t.score)
        worse = group
        if value(candidate) > least:
            worse, best, least = best.group, candidate, value(candidate)
        if worse is not term.group:
            candidates.forget([worse])
    if best is term:
        return term
    return replace(best, gate=term.gate + (best.score - now.score) / model.kappa)
