"""Selection of terms: screen, exact contest, and replacement until nothing changes.

1. Every candidate is scored in closed form (:mod:`airswing.gap.model.evidence`) with one noise
factor
   kappa for all, and passes a gate if its evidence by its *own* noise factor plus its log prior
   exceeds `GATE`. Mixing the two factors in one ranking would make a change and a table of the date
   replace each other for ever.
2. The best of each name and the best tables are fitted jointly with all terms in the model and
   ranked by exact marginal likelihood. The screening score of a fleet-wide candidate is limited by
   T and hardly says which shape fits.
3. A name represents a table where it holds, alone or with further names, at least `REPRESENTS` of
   the table's log evidence: its columns are first-order and made of inferred context. (One table of
   the heading has more evidence than hard iron alone where soft iron acts as well.)
4. After every addition each term is removed and contested again, until nothing changes.

References
----------
Wang, G., Sarkar, A., Carbonetto, P. and Stephens, M. (2020). A simple new approach to variable
selection in regression, with application to genetic fine mapping. J. R. Stat. Soc. B 82, 1273-1300
(credible sets).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.model.candidates import Group
from airswing.gap.model.evidence import dated_evidence, static_evidence
from airswing.gap.model.refinement import refined
from airswing.gap.model.terms import GATE, Model, Statistics, Term, describe, set_prior

Floats = NDArray[np.float64]

#: Share of a table's log evidence that a name must hold: a deviation of 5 degrees turns the heading
#: its columns are evaluated at, an error of first order of (5 degrees)^2 / 2 = 0.4 % of the energy;
#: ten times that for context that is inferred.
REPRESENTS = 0.96
#: Standard error of a coefficient, m/s, up to which it says what is usual; fewest of them; median
#: of chi squared with one degree of freedom.
KNOWN_TO, FEW, CHI_SQUARED_MEDIAN = 0.15, 20, 0.455
#: Days below which what all aircraft share cannot be separated from the weather of those days.
DAYS = 3
#: Names and tables in a contest, the best of each by the screening score.
NAMES, TABLES = 12, 6
#: Most terms, and rounds of replacement after an addition.
MOST, ROUNDS = 8, 2


def screen(model: Model) -> list[Term]:
    """All candidates given the terms in the model, best first; ``score`` holds the log prior."""
    groups = [g for g in model.sums.candidates.groups if g.kind not in ("nuisance", "probe")]
    statistics = [(g, model.statistics(g)) for g in groups]
    # of tables and names that act always: the factor of a usual candidate
    usual = [float(np.median(s.factor)) for g, s in statistics if g.kind != "dated"]
    model.kappa = max(1.0, float(np.median(usual))) if usual else 1.0
    statistics = [(g, model.with_usual(g, s)) for g, s in statistics]
    out: list[Term] = []
    for group, found in statistics:
        factor = max(model.kappa, float(np.mean(found.factor)))
        if group.kind == "dated":
            ranked, gated = dated_evidence(model, group, model.kappa, GATE - group.prior)
            if gated.tails:
                out.append(
                    Term(
                        group,
                        "a",
                        gated.tails,
                        gated.scale,
                        gated.start,
                        ranked.evidence + group.prior,
                        gated.evidence + group.prior,
                        gated.inclusion,
                        shape=gated.shape,
                    )
                )
            continue
        out += _static(group, found, model.kappa, factor, model.sums.span)
    return sorted(out, key=lambda term: -term.score)


def usual_sizes(
    statistics: Sequence[tuple[Group, Statistics]], kappa: float
) -> dict[str, tuple[float, float]]:
    """Variances of what no aircraft and no fleet is free of, by part, from the bulk of tables.

    With coefficients theta of variance v by their noise, the variance m^2 for which the median of
    theta^2 / (v + m^2) is that of chi squared; over all tables, aircraft and directions, of which
    an effect concerns few. Directions that are hardly known say nothing of it.

    Returns
    -------
    dict
        Part -> (variance of single aircraft, variance of the fleet), m2 s-2.
    """
    out = {}
    for part in ("heading", "airspeed", "wind"):
        own = [found for group, found in statistics if group.kind == "table" and group.part == part]
        aircraft = [_directions(s.information, s.score, kappa) for s in own]
        fleet = [
            _directions(
                s.fleet_information[None],
                s.score.sum(axis=0)[None],
                max(1.0, s.fleet_factor),
            )
            for s in own
        ]
        out[part] = _median_variance(aircraft), _median_variance(fleet)
    return out


def _directions(information: Floats, score: Floats, factor: float) -> tuple[Floats, Floats]:
    """Squared coefficients along the axes of the information, and their variances."""
    values, vectors = np.linalg.eigh(information)
    turned = np.einsum("aji,aj->ai", vectors, score)
    known = values > factor / KNOWN_TO**2
    return (turned[known] / values[known]) ** 2, factor / values[known]


def _median_variance(parts: Sequence[tuple[Floats, Floats]]) -> float:
    squares = np.concatenate([square for square, _ in parts]) if parts else np.zeros(0)
    noise = np.concatenate([variance for _, variance in parts]) if parts else np.zeros(0)
    if squares.size < FEW:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if np.median(squares / (noise + middle)) > CHI_SQUARED_MEDIAN:
            low = middle
        else:
            high = middle
    return float(low)


def _static(group: Group, found: Statistics, kappa: float, factor: float, days: int) -> list[Term]:
    scopes = group.scopes
    if days < DAYS:
        if not group.named:
            return []
        scopes = scopes.replace("f", "")
    if not scopes:
        return []
    ranked = static_evidence(found, kappa, scopes)
    gated = ranked
    if factor > kappa and any(r.evidence + group.prior > GATE for r in ranked.values()):
        gated = static_evidence(found, factor, scopes)
    return [
        Term(
            group,
            scope,
            one.tails,
            one.scale,
            {},
            one.evidence + group.prior,
            gated[scope].evidence + group.prior,
            one.inclusion,
            one.spread,
        )
        for scope, one in ranked.items()
        if one.tails
    ]


def contest(
    model: Model, terms: Sequence[Term], ranked: Sequence[Term], gate: float = GATE
) -> list[Term]:
    """Best candidates by exact marginal likelihood together with the terms, best first."""
    able = [term for term in ranked if term.gate > gate]
    if not able:
        return []
    short: list[Term] = []
    seen: set[tuple[str, str, str]] = set()
    for term in able:
        kind = (term.group.name, term.scope, term.group.kind)
        if kind not in seen:
            seen.add(kind)
            short.append(term)
    names = [t for t in short if t.group.named][:NAMES]
    tables = [t for t in short if not t.group.named][:TABLES]
    short = names + tables
    before = model.evidence(terms, model.kappa)

    def exactly(term: Term) -> Term:
        gain = model.evidence([*terms, term], model.kappa) - before
        return term.with_score(gain + term.group.prior + set_prior(model, term))

    scored = [exactly(term) for term in short]
    # the screening score of fleet-wide candidates hardly says which form fits
    named = max((t for t in scored if t.group.named), key=lambda t: t.score, default=None)
    if named is not None and named.scope == "f":
        forms = [
            exactly(term)
            for term in able
            if (term.group.name, term.scope, term.group.kind)
            == (named.group.name, named.scope, named.group.kind)
        ]
        scored[scored.index(named)] = max(forms, key=lambda t: t.score)
    scored = [term for term in scored if term.score > gate]
    if not scored:
        return []
    scored.sort(key=lambda term: -term.score)
    best = scored[0]
    if not best.group.named:
        named_terms = [t for t in scored if t.group.named]
        represented = [t for t in named_terms if t.score > REPRESENTS * best.score]
        if represented:
            best = represented[0]
        elif _names_together(model, terms, named_terms, before) > REPRESENTS * best.score:
            best = named_terms[0]
    best = _without_idle(model, terms, best, before)
    rivals = tuple(
        (best.score - t.score, t.group.name, t.scope) for t in scored if t.label != best.label
    )
    return [replace(best, rivals=rivals), *(t for t in scored if t.label != best.label)]


def _names_together(
    model: Model, terms: Sequence[Term], named: Sequence[Term], before: float
) -> float:
    """Exact evidence, with log priors, of the names that raise it when added one after another."""
    chosen: list[Term] = []
    left = list(named)
    prior = best = 0.0
    while left:
        priors = [prior + term.group.prior + set_prior(model, term) for term in left]
        gains = [model.evidence([*terms, *chosen, term], model.kappa) - before for term in left]
        scores = np.add(gains, priors)
        place = int(np.argmax(scores))
        if scores[place] <= best:
            break
        best, prior = float(scores[place]), priors[place]
        chosen.append(left.pop(place))
    return best


def _without_idle(model: Model, terms: Sequence[Term], term: Term, before: float) -> Term:
    """A term without the aircraft that raise its exact evidence by their absence.

    The screening score gives the fleet's part back approximately: with an effect of several m/s on
    one aircraft it includes others.
    """
    if term.scope != "a":
        return term
    for _ in term.tails:
        if len(term.tails) < 2:
            return term
        options = []
        for a in term.tails:
            left = tuple(b for b in term.tails if b != a)
            start = {b: day for b, day in term.start.items() if b != a}
            other = replace(term, tails=left, start=start)
            exact = model.evidence([*terms, other], model.kappa) - before
            options.append(other.with_score(exact + other.group.prior + set_prior(model, other)))
        best = max(options, key=lambda one: one.score)
        if best.score <= term.score:
            return term
        term = best
    return term


def search(
    model: Model,
    *,
    start: Sequence[Term] = (),
    say: Callable[[str], None] = lambda text: None,
) -> list[Term]:
    """Add terms, and replace or remove them, until nothing changes."""
    terms = list(start)
    model.condition(terms)
    if terms:
        learn_usual(model)
        terms = revisit(model, terms, 1, say)
    seen: set[frozenset[tuple[object, ...]]] = set()
    for _ in range(MOST):
        found = contest(model, terms, screen(model))
        if not found:
            break
        say(f"+ {describe(found[0])}")
        terms = [*terms, found[0]]
        model.condition(terms)
        terms = refined(model, terms, found[0], say)
        learn_usual(model)
        terms = revisit(model, terms, ROUNDS, say)
        state = frozenset(term.label for term in terms)
        if state in seen:
            break
        seen.add(state)
    return terms


def learn_usual(model: Model) -> None:
    """Estimate the usual sizes with all terms in the model: an effect must not pass for usual."""
    groups = [g for g in model.sums.candidates.groups if g.kind == "table"]
    model.usual = usual_sizes([(g, model.statistics(g)) for g in groups], model.kappa)


def revisit(model: Model, terms: list[Term], rounds: int, say: Callable[[str], None]) -> list[Term]:
    """Remove each term and contest its place, until nothing changes."""
    for _ in range(rounds):
        changed = False
        for term in list(terms):
            rest = [other for other in terms if other is not term]
            model.condition(rest)
            ranked = screen(model)
            if term.group.refined:
                ranked.append(_as_it_is(model, terms, rest, term))
            found = contest(model, rest, ranked)
            if not found:
                say(f"- {describe(term)}")
                terms, changed = rest, True
                continue
            new = found[0]
            if new.label != term.label:
                say(f"~ {describe(term)} -> {describe(new)}")
            changed |= new.key != term.key
            terms = [new if other is term else other for other in terms]
            if new.label != term.label:
                model.condition(terms)
                terms = refined(model, terms, new, say)
        model.condition(terms)
        if not changed:
            break
    return terms


def _as_it_is(model: Model, terms: Sequence[Term], rest: Sequence[Term], term: Term) -> Term:
    """A table of two variables as a candidate for its own place."""
    gain = model.evidence(terms, model.kappa) - model.evidence(rest, model.kappa)
    score = gain + term.group.prior + set_prior(model, term)
    return replace(term, score=score, gate=score / model.kappa)
