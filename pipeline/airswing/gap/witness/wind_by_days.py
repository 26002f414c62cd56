"""Names of the reference's wind told by days, where nothing else was found.

Assumptions: a wind left along the grid, a bias of its speed, a wrong height or time is the same on
every day, and what the reference's weather gets wrong is not: what the search's day fields take of
it is left where the errors of a day are noise of known covariance
(:mod:`airswing.gap.held_out.by_days`).

Validity: ten blocks of days and more; where no other effect of the whole fleet stands, of which a
part would pass for one of the wind.

Source: that of :mod:`airswing.gap.held_out.by_days`.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.attenuation import EXOGENOUS, TIMED
from airswing.gap.held_out.by_days import BLOCK, LEAST_BLOCKS, ByDays, Column
from airswing.gap.search.belief import FEATURES, LIKELIER_ANOTHER, STATED, chance
from airswing.gap.search.cross_validated import Doubtful
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem
from airswing.gap.witness.bench import Setting

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class WindName:
    """An effect of the reference's wind by days."""

    name: str
    form: int  # which of its columns
    evidence: float  # nats
    deviations: float  # from nothing, of the days' errors and of what lasts

    @property
    def weighed(self) -> Floats:
        """What its probability is made of, as :func:`airswing.gap.search.belief.features`."""
        nothing_else = np.zeros(len(FEATURES) - 2)
        # the fit of probabilities has logarithms of evidence; below a tenth of a nat it is none
        return np.asarray(np.r_[np.log(max(self.evidence, 0.1)), self.deviations, nothing_else])

    @property
    def probability(self) -> float:
        """Probability that it is at work, as of any name."""
        return float(chance(self.weighed))


def wind_names(setting: Setting, effects: Mapping[str, Effect], rest: Floats) -> list[WindName]:
    """Weigh the names of the reference's wind, likeliest first.

    Parameters
    ----------
    effects : mapping
        Name -> effect; those of the wind are asked.
    rest : (n, 2) float
        Residual with what was found taken off.
    """
    if int(setting.day.max()) // BLOCK + 1 < LEAST_BLOCKS:
        return []
    frames = setting.frame, setting.quiet
    asked = [
        (name, form, Column.of(*frames, effect, form))
        for name, effect in effects.items()
        if name in (*EXOGENOUS, TIMED)
        for form in range(len(effect.column_names))
    ]
    days = ByDays.of(frames, setting.noise, setting.day, rest, [column for *_, column in asked])
    out = []
    for k, (name, form, _) in enumerate(asked):
        told = days.weigh(k)
        if told is not None:
            one = WindName(name, form, told.deviations**2 / 2, told.deviations)
            out.append((told.deviations > 0, told.formal, one))
    # what is allowed for beyond the covariance weighs on a bias below a level more than on its
    # opposite above: it says how sure a name is, not which
    return [one for *_, one in sorted(out, key=lambda o: (-o[0], -o[1]))]


def name_by_days(
    problem: Problem,
    found: Found,
    setting: Setting,
    rest: Floats,
    others: Sequence[Sequence[int]],
) -> Doubtful | None:
    """Find a name of the wind by days, where nothing else of the fleet stands.

    One that is likelier than not and not beyond doubt has its reason.

    Parameters
    ----------
    found : Found
        What stands.
    rest : (n, 2) float
        Residual with it taken off.
    others : sequence of sequence of int
        Aircraft of what was told beside it.
    """
    tails = tuple(range(len(problem.archive.tails)))
    if any(len(own) == len(tails) for own in (*others, *(term.tails for term in found.terms))):
        return None
    best = next(iter(wind_names(setting, problem.effects, rest)), None)
    if best is None or best.probability < LIKELIER_ANOTHER:
        return None
    reason = "" if best.probability >= STATED else "its days do not tell it beyond doubt"
    key = best.name, "fleet", (best.form,)
    for score in found.left:
        if score.candidate.key == key:
            term = Term(score.candidate, tails, None, replace(score, tempered=best.evidence))
            return Doubtful(term, best.probability, best.weighed, reason)
    return None
