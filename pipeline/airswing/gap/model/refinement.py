"""Tables of one variable refined by a second one.

The second variable is sought by products of the fitted curve with functions of every other
variable; of the best one the full table of two variables is built and contested with the table of
one. It is kept where its exact evidence, with its own prior, is larger by the gate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from airswing.gap.model.candidates import Group
from airswing.gap.model.evidence import static_evidence
from airswing.gap.model.terms import GATE, Model, Term, describe, set_prior

#: Log evidence of a table from which a second variable is sought.
LEAST = 30.0


def refined(model: Model, terms: list[Term], term: Term, say: Callable[[str], None]) -> list[Term]:
    """Terms with a table of one variable replaced by one of two where that is more likely.

    Parameters
    ----------
    model : Model
        Conditioned on the terms.
    term : Term
        One of the terms.
    """
    if term.group.kind != "table" or len(term.group.variables) != 1 or term.score < LEAST:
        return terms
    second = _second_variable(model, term)
    better = None if second is None else _paired(model, terms, term, second)
    if better is not None:
        say(f"~ {describe(term)} -> {describe(better)}")
        terms = [better if other is term else other for other in terms]
    model.condition(terms)
    return terms


def _second_variable(model: Model, term: Term) -> str | None:
    """Variable with whose functions the fitted curve has the largest evidence as a product."""
    candidates = model.sums.candidates
    k = next(i for i, other in enumerate(model.terms) if other is term)
    theta = model.theta[model.offsets[k + 1] : model.offsets[k + 2]]
    # the curve that all aircraft of the term have in common
    curve = term.group.transform @ theta.reshape(-1, term.group.size).mean(axis=0)
    probes: list[tuple[str, Group]] = []
    for name in candidates.variables:
        if name == term.group.variables[0]:
            continue
        group = candidates.add_product(term.group, curve, name)
        if group is not None:
            probes.append((name, group))
    model.sums.extend()
    model.condition(model.terms)
    best, found = GATE, None
    number = np.log(2 * max(len(probes), 1))
    for name, group in probes:
        statistics = model.statistics(group)
        factor = max(model.kappa, float(np.mean(statistics.factor)))
        evidence = static_evidence(statistics, factor, term.scope)[term.scope].evidence - number
        if evidence > best:
            best, found = evidence, name
    candidates.forget([group for _, group in probes])
    return found


def _paired(model: Model, terms: list[Term], term: Term, second: str) -> Term | None:
    candidates = model.sums.candidates
    weight = term.group.prior - float(np.log(len(candidates.variables)))
    group = candidates.add_table(candidates.paired(term.group, second), weight)
    model.sums.extend()
    if group is None:
        return None
    rest = [other for other in terms if other is not term]
    before = model.evidence(rest, model.kappa)
    options = []
    for scale in (0.5 * term.scale, term.scale, 2.0 * term.scale):
        other = replace(term, group=group, scale=scale)
        exact = model.evidence([*rest, other], model.kappa) - before
        options.append(other.with_score(exact + group.prior + set_prior(model, other)))
    best = max(options, key=lambda one: one.score)
    now = model.evidence(terms, model.kappa) - before + term.group.prior + set_prior(model, term)
    if best.score < now + GATE * model.kappa:
        candidates.forget([group])
        return None
    return replace(best, gate=term.gate + (best.score - now) / model.kappa)
