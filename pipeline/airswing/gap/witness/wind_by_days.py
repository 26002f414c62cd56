"""Names of the reference's wind told by plain means of days, where nothing else was found.

Assumptions: a wind left along the grid, a bias of its speed, a wrong height or time is the same on
every day, and what the reference's weather gets wrong is not. Fields of single days take up most of
such an effect, and whitened along flights it is asked to follow small scales that its column, made
of the wind's large ones, does not hold. So the residual is regressed on the column beside the
climatology alone, every report counting alike, and judged by its scatter between blocks of days.

Validity: ten blocks of days and more; where no other effect of the whole fleet stands, of which a
part would pass for one of the wind. The error of the reference that lasts beyond the climatology is
allowed for.

Source: Kish (1965), Survey Sampling, ch. 5; effective degrees of freedom after Satterthwaite
(1946), Biometrics 2, 110.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from airswing.gap.design.layout import effect_columns
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.attenuation import EXOGENOUS, TIMED
from airswing.gap.search.belief import FEATURES, STATED, chance
from airswing.gap.search.cross_validated import Doubtful
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem
from airswing.gap.witness.bench import BLOCK, FLEET_PERSISTENT, Setting

Floats = NDArray[np.float64]

#: Blocks of days under which their scatter tells too little.
LEAST_BLOCKS = 10
#: Share of a column's energy that the climatology must leave.
LEAST_LEFT = 0.1


@dataclass(frozen=True)
class WindName:
    """An effect of the reference's wind by its means."""

    name: str
    form: int  # which of its columns
    evidence: float  # nats
    deviations: float  # normal ones from nothing, of the block scatter and of what lasts

    @property
    def weighed(self) -> Floats:
        """What its probability is made of, as :func:`airswing.gap.search.belief.features`."""
        nothing_else = np.zeros(len(FEATURES) - 2)
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
    block = setting.day // BLOCK
    if int(block.max()) + 1 < LEAST_BLOCKS:
        return []
    model, quiet = setting.cell_model_of(False), setting.quiet
    lasting = model.columns[..., model.root.shape[1] :]
    weighed = model.weigh(rest)
    inverse = np.linalg.inv(np.diag(model.prior) + model.lasting_gram)
    out = []
    for name, effect in effects.items():
        if name not in (*EXOGENOUS, TIMED):
            continue
        for form, column in enumerate(effect_columns(quiet, effect)):
            whole = model.weight[:, None] * column
            taken = inverse @ np.einsum("nc,ncj->j", whole, lasting)
            own = column - lasting @ taken
            square = (whole * own).sum(axis=1)
            if square.sum() <= LEAST_LEFT * (whole * column).sum():
                continue
            told = (own * weighed.values).sum(axis=1)
            score, gram = (np.asarray(np.bincount(block, v), float) for v in (told, square))
            out.append(_weighed(name, form, score, gram, _size(column)))
    return sorted(out, key=lambda one: -one.deviations)


def name_by_days(
    problem: Problem,
    found: Found,
    setting: Setting,
    rest: Floats,
    others: Sequence[Sequence[int]],
) -> Doubtful | None:
    """Find a name of the wind by its means, where nothing else of the fleet stands.

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
    if best is None or best.probability < STATED:
        return None
    key = best.name, "fleet", (best.form,)
    for score in found.left:
        if score.candidate.key == key:
            term = Term(score.candidate, tails, None, replace(score, tempered=best.evidence))
            return Doubtful(term, best.probability, best.weighed, "")
    return None


def _size(column: Floats) -> float:
    """Root mean square of a column where it acts."""
    square = (column**2).sum(axis=1)
    return float(np.sqrt(square[square > 0].mean()))


def _weighed(name: str, form: int, score: Floats, gram: Floats, size: float) -> WindName:
    """Name by the sums X'r and X'X of blocks of days."""
    whole, count = float(gram.sum()), score.size
    value = float(score.sum()) / whole
    apart = float(((score - value * gram) ** 2).sum()) / whole**2 * count / (count - 1)
    variance = apart + (FLEET_PERSISTENT / size) ** 2
    ratio = float(abs(value) / np.sqrt(variance))
    # what lasts is allowed for, not estimated: as many degrees of freedom as the sum has
    freedom = (count - 1) * (variance / max(apart, 1e-12)) ** 2
    tail = max(float(stdtr(freedom, -ratio)), 1e-300)
    return WindName(name, form, ratio**2 / 2, float(-ndtri(tail)))
