"""Tables refined: another lever, finer knots, a second variable.

Errors of the wind act as an angle or a factor (in proportion to its speed), or as a speed; those of
heading and airspeed in proportion to the airspeed or not. Tables of the search have one lever a
component and few knots. Of a table that won, the other lever and twice the knots are contested with
it; then a second variable is sought by products of the fitted curve with functions of every other
variable, and the full table of two variables contested. A table is kept where its exact evidence,
with its prior, is larger by the gate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from airswing.gap.archive.reported_variables import KINDS
from airswing.gap.model.candidates import KNOTS, Group, Table
from airswing.gap.model.evidence import static_evidence
from airswing.gap.model.terms import GATE, Model, Term, describe, set_prior

#: Other lever of each component, and times the usual number of knots.
LEVERS = {
    "heading_angle": "across_heading",
    "along_heading": "airspeed_factor",
    "wind_angle": "across_wind",
    "along_wind": "wind_factor",
}
FINER = 2
#: Cells of each variable in a table of two.
PAIRED = 7
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
    if term.group.kind != "table" or term.group.refined or term.score < LEAST:
        return terms
    candidates = model.sums.candidates
    (name,) = term.group.variables
    known = term.group.component
    usual = candidates.table_of(term.group).curves[0]
    options = [Table((usual,), LEVERS[known])]
    if KINDS[name][0] != "category":
        fine = candidates.curve(name, FINER * KNOTS[name])
        options += [Table((fine,), known), Table((fine,), LEVERS[known])]
    best = _contested(model, terms, term, options, float(np.log(1 + len(options))))
    if best is not term:
        say(f"~ {describe(term)} -> {describe(best)}")
        terms = [best if other is term else other for other in terms]
        model.condition(terms)
    second = _second_variable(model, best)
    if second is not None:
        curves = tuple(
            candidates.curve(v, PAIRED + (KINDS[v][0] == "circular")) for v in (name, second)
        )
        weight = float(np.log(len(candidates.variables)))
        table = Table(curves, best.group.component)
        pair = _contested(model, terms, best, [table], weight)
        if pair is not best:
            say(f"~ {describe(best)} -> {describe(pair)}")
            terms = [pair if other is best else other for other in terms]
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


def _contested(
    model: Model, terms: list[Term], term: Term, tables: Sequence[Table], weight: float
) -> Term:
    """Best of a term and the same with other tables, whose log prior is less by ``weight``."""
    candidates = model.sums.candidates
    rest = [other for other in terms if other is not term]
    before = model.evidence(rest, model.kappa)
    now = model.evidence(terms, model.kappa) - before + term.group.prior + set_prior(model, term)
    best, score = term, now + GATE * model.kappa
    for table in tables:
        group = candidates.add_table(table, term.group.prior - weight, refined=True)
        model.sums.extend()
        if group is None:
            continue
        options = []
        for scale in (0.5 * term.scale, term.scale, 2.0 * term.scale):
            other = replace(term, group=group, scale=scale)
            exact = model.evidence([*rest, other], model.kappa) - before
            options.append(other.with_score(exact + group.prior + set_prior(model, other)))
        other = max(options, key=lambda one: one.score)
        if other.score > score:
            best, score = other, other.score
        else:
            candidates.forget([group])
    if best is term:
        return term
    return replace(best, gate=term.gate + (best.score - now) / model.kappa)
