"""From reports to a fitted model: noise, sums, search, exchange of identifiers, further passes.

Where two aircraft look as if they had exchanged identifiers, the archive with corrected identifiers
is searched as well, and the labelling with the larger evidence is kept. Further passes are those of
docs/gap.md, section 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.design import day_field_columns, exogenous, heading_doubt
from airswing.gap.effects.base import Effect
from airswing.gap.model.candidates import PARTS, Candidates, Group
from airswing.gap.model.evidence import Exchange, exchange_evidence
from airswing.gap.model.refit import Refit, of_reports, refit, without_errors
from airswing.gap.model.selection import search
from airswing.gap.model.sums import GATE, Sums
from airswing.gap.model.terms import Model, Term, set_prior
from airswing.gap.noise import NoiseFit, fit_noise

#: Most passes after the first: each reduces the error of first order by that of the one before.
PASSES = 4


@dataclass
class Fitted:
    """A model and its input; exchanged identifiers are corrected in the frame."""

    frame: Frame
    context: Frame
    noise: NoiseFit
    model: Model
    terms: list[Term]
    exchange: Exchange | None = None
    errors: Floats | None = None
    """Errors of heading and airspeed that the columns are linear about, as winds (n, 2), m/s."""
    complete: bool = True
    """Whether the search did not end early."""
    exact: Refit = field(init=False)

    def refit(self, effects: Mapping[str, Effect]) -> None:
        """Fit the terms exactly."""
        sensor = [is_sensor(term, effects) for term in self.terms]
        self.exact = refit(self.frame, self.model, sensor)

    def search(
        self, effects: Mapping[str, Effect], start: Sequence[Term] = (), *, settled: bool = False
    ) -> None:
        """Search until nothing is found, or less than the second order of the effects found."""
        model = self.model

        def second_order(terms: Sequence[Term]) -> float:
            errors = np.zeros((self.frame.size, 2))
            for k, term in enumerate(terms):
                if is_sensor(term, effects):
                    columns = model.sums.candidates.raw(term.group.columns)
                    errors += np.einsum("nck,nk->nc", columns, of_reports(model, k, model.theta))
            change = errors if self.errors is None else errors - self.errors
            corrected, _, _ = without_errors(self.frame, change)
            second = self.frame.residual - corrected.residual - change
            white = model.sums.whitened(second[:, :, None])[:, 0]
            return 0.5 * float(white @ model.sums.invert(white)) / model.kappa

        self.terms, self.complete = search(model, second_order, start=start, settled=settled)


def prepared(
    frame: Frame,
    effects: Mapping[str, Effect],
    *,
    tables: bool,
    seed: int,
    noise: NoiseFit | None = None,
    less: Floats | float = 0.0,
    indicated: Floats | None = None,
) -> Fitted:
    """Build candidates and sums of an archive; nothing is searched yet.

    ``noise`` is used instead of fitting it; ``less`` (n, 2) is subtracted from the residual before.
    Errors of the heading are functions of the ``indicated`` magnetic heading (n,), where that of
    the frame is a corrected one.
    """
    context = exogenous(frame)
    if indicated is not None:
        context = replace(context, magnetic_heading=indicated)
    if noise is None:
        quiet = frame.residual - less
        noise = fit_noise(quiet, context, heading_doubt(frame, context), seed=seed)
    candidates = Candidates(frame, context, effects, tables=tables)
    sums = Sums(frame, noise, candidates, day_field_columns(context), frame.residual)
    return Fitted(frame, context, noise, Model(sums), [])


def fit_model(
    frame: Frame,
    effects: Mapping[str, Effect],
    *,
    tables: bool = True,
    exchanges: bool = True,
    seed: int = 0,
) -> Fitted:
    """Search an archive for effects, of the catalogue and outside it.

    ``tables`` also looks outside the catalogue, ``exchanges`` for exchanged identifiers. The noise
    is fitted to flights drawn with the ``seed``.
    """
    fitted = prepared(frame, effects, tables=tables, seed=seed)
    exchange = _likeliest_exchange(fitted, effects) if exchanges else None
    fitted.search(effects)
    if exchange is not None:
        fitted = _fit_with_exchange(fitted, exchange, effects, tables, seed)
    fitted.refit(effects)
    for _ in range(PASSES):
        again = _linearised(fitted, effects, tables, seed)
        if again is fitted:
            break
        fitted = again
    return fitted


def _likeliest_exchange(fitted: Fitted, effects: Mapping[str, Effect]) -> Exchange | None:
    """The likeliest exchange where it beats none, and changes of the two aircraft."""
    groups = fitted.model.sums.candidates.groups
    steps = [g for g in groups if g.named and g.dated and g.size == 3]
    if not steps:
        return None
    factor = fitted.model.statistics(steps[0]).mean_factor
    exchange = exchange_evidence(fitted.model, steps[0], max(1.0, factor))
    if exchange is None or exchange.evidence - np.log(2 * len(effects)) < GATE:
        return None
    return exchange if exchange.evidence > exchange.as_changes else None


def _fit_with_exchange(
    fitted: Fitted, exchange: Exchange, effects: Mapping[str, Effect], tables: bool, seed: int
) -> Fitted:
    """Fit with the identifiers of the later reports of a pair exchanged, if that is better."""
    sums, (first, second) = fitted.model.sums, exchange.pair
    late = sums.day >= exchange.day
    aircraft = fitted.frame.aircraft.copy()
    aircraft[late & (fitted.frame.aircraft == first)] = second
    aircraft[late & (fitted.frame.aircraft == second)] = first
    frame = replace(fitted.frame, aircraft=aircraft)
    corrected = prepared(frame, effects, tables=tables, seed=seed, noise=fitted.noise)
    corrected.search(effects)
    kappa = max(fitted.model.kappa, corrected.model.kappa)
    gain = total_evidence(corrected, kappa) - total_evidence(fitted, kappa)
    evidence = gain - float(np.log(sums.A * (sums.A - 1) / 2 * sums.D))  # pairs and days
    if evidence - np.log(2 * len(effects)) < GATE:
        return fitted
    corrected.exchange = replace(exchange, evidence=evidence)
    return corrected


def total_evidence(fitted: Fitted, kappa: float) -> float:
    """Log evidence of all terms against none with their log prior."""
    model = fitted.model
    prior = sum(t.group.prior + set_prior(model, t) for t in fitted.terms)
    return model.evidence(fitted.terms, kappa) - model.evidence([], kappa) + prior


def is_sensor(term: Term, effects: Mapping[str, Effect]) -> bool:
    """Whether a term acts on the indicated heading or airspeed."""
    if term.group.named:
        return effects[term.group.name].stage == "sensor"
    return term.group.component in PARTS


def _linearised(fitted: Fitted, effects: Mapping[str, Effect], tables: bool, seed: int) -> Fitted:
    exact, terms = fitted.exact, fitted.terms
    linear = [exact.response.linear(k, exact.theta) for k in range(len(terms))]
    sensor = [k for k in range(len(terms)) if exact.response.sensor[k]]
    errors = sum((linear[k] for k in sensor), np.zeros((fitted.frame.size, 2)))
    size = np.hypot(*errors.T)
    acting = size[size > 1e-3 * size.max(initial=0.0)]
    # 1 m/s rms is half a degree at 120 m/s, where first order errs by 0.4 % of the effect; from
    # 2.5 m/s at single reports on it may be taken for gross errors
    small = not acting.size or (np.sqrt((acting**2).mean()) < 1.0 and acting.max() < 2.5)
    if fitted.complete and (small or fitted.errors is not None):
        return fitted
    corrected, _, _ = without_errors(fitted.frame, errors)
    fitted.model.sums.release()
    less = sum((linear[k] for k in range(len(terms)) if k not in sensor), np.zeros_like(errors))
    indicated = fitted.context.magnetic_heading
    again = prepared(corrected, effects, tables=tables, seed=seed, less=less, indicated=indicated)
    candidates = again.model.sums.candidates
    groups = {(g.name, g.form, g.dated): g for g in candidates.groups}
    # refined tables of one variable differ in their knots, not in their names
    refined: dict[int, Group | None] = {}
    for old in {id(term.group): term.group for term in terms if term.group.refined}.values():
        table = fitted.model.sums.candidates.table_of(old)
        refined[id(old)] = candidates.add_table(table, old.prior, refined=True)
    again.model.sums.extend()
    start: list[Term] = []
    again.errors = np.zeros_like(errors)
    for k, term in enumerate(terms):
        found = groups.get((term.group.name, term.group.form, term.group.dated))
        group = refined[id(term.group)] if term.group.refined else found
        if group is None:
            continue
        start.append(replace(term, group=group))
        if k in sensor:
            columns = candidates.raw(group.columns)
            again.errors += exact.response.linear(k, exact.theta, columns)
    again.model.renew(corrected.residual + again.errors)
    again.search(effects, start, settled=fitted.complete)
    again.frame, again.exchange = fitted.frame, fitted.exchange
    again.refit(effects)
    return again
