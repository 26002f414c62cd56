"""Unknowns taken off an archive one after the other, and what each closes on weeks left out.

Assumptions: an unknown competes with the names the search found. Where its table alone explains
more of the plain residual than all names together, the names only stood in for it: it is fitted to
the residual with nothing taken off, else to what the names leave. The archive without it, its winds
as they would have been, is then searched for names again.

Validity: tables are fitted without each fold of weeks and taken off that fold's reports, so that
what is left is held out.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.design.layout import effect_columns
from airswing.gap.effects.base import Effect
from airswing.gap.held_out.reduction import take_off
from airswing.gap.taken_off.closed_by_table import drawn, missed
from airswing.gap.taken_off.remainders import small_beside
from airswing.gap.taken_off.table_or_names import borne_out, leads
from airswing.gap.witness.bench import Bench, Setting
from airswing.gap.witness.fitted_tables import (
    LEAST_EVIDENCE,
    Candidate,
    Unknown,
    clearly_more,
    confined,
    explained,
    field_of,
    fitted,
    stands,
)
from airswing.gap.witness.learned import LearnedWitness
from airswing.gap.witness.unknowns import (
    SECOND,
    curves,
    edged,
    exchanged,
    of_runs,
    pairs_of,
    refined,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Evidence beside the strongest's from which a table of another component is tried as well.
RIVAL = 0.3
#: Reports on which an unknown is compared with effects, at most.
MOST_COMPARED = 2000


@dataclass(frozen=True)
class Taken:
    """An unknown taken off."""

    unknown: Unknown
    saved: Floats  # (n,): disagreement before less after, m/s
    drawn: Floats  # (draws,): its mean, drawn from what the data leave open about the table, m/s
    nearest: str | None  # effect of the catalogue that explains most of it
    share: float  # share of its mean square that the effect explains

    @property
    def evidence(self) -> float:
        """What speaks for it, nats."""
        return self.unknown.evidence

    @property
    def title(self) -> str:
        """What is told of it on the waterfall."""
        what = self.unknown.component.replace("_", " ")
        return f"{what} by {' x '.join(self.unknown.grid.variables)}"


def next_unknown(
    setting: Setting,
    effects: Mapping[str, Effect],
    named_rest: Floats,
    fold: Integers,
    witness: LearnedWitness,
    *,
    linear: Floats | None = None,
) -> tuple[Taken, Frame] | None:
    """Find the strongest unknown of an archive and take it off.

    Parameters
    ----------
    effects : mapping
        Name -> effect: what an unknown is compared with.
    named_rest : (n, 2) float
        Residual with all that has a name taken off, m/s.
    fold : (D,) int
        Fold of every day.
    witness : LearnedWitness
        Which pairs of variables to try as tables.
    linear : (n, 2) float, optional
        What has a name by its design columns, on the wind that tables stand on, m/s.

    Returns
    -------
    taken : Taken
    frame : Frame
        The archive without it.
    None
        Where nothing is left to be found.
    """
    frame = setting.frame
    bench = Bench.of(setting, named_rest)
    ranked = _ranked(bench, witness)
    errors = frame.residual - named_rest
    named = bool(errors.any())
    left = _strong(ranked)
    if named and (left or not borne_out(setting, errors)):
        plain = Bench.of(setting, frame.residual)
        alone = _ranked(plain, witness)
        first = _found(plain, alone, fold) if _strong(alone) else None
        ways = (errors,) if linear is None else (errors, linear)
        if first is not None and leads(plain, first, ways, fold, left=left):
            return _taken(setting, plain, first, alone, effects, fold)
    if not named and not left:  # beside a large name its remainder would be a run
        ranked = of_runs(bench)
    unknown = _found(bench, ranked, fold) if left or (ranked and not named) else None
    if unknown is None:
        return None
    if named and small_beside(errors[np.isin(frame.aircraft, unknown.tails)], unknown.size):
        return None
    return _taken(setting, bench, unknown, ranked, effects, fold)


def _ranked(bench: Bench, witness: LearnedWitness) -> list[Candidate]:
    """Tables of one variable and of the pairs the learned witness names, most evidence first."""
    single = sorted(edged(bench) + curves(bench), key=lambda c: -c.strength)
    pairs = pairs_of(bench, witness.hear(bench.alike))
    # of a pair and a curve that tell the same the curve is simpler: `refined` tries its pairs
    least = single[0].strength + max(SECOND[0], SECOND[1] * single[0].strength)
    return [c for c in pairs if c.nats > least] + single


def _strong(ranked: Sequence[Candidate]) -> bool:
    """Whether any table has the evidence an unknown needs."""
    return bool(ranked) and ranked[0].strength >= LEAST_EVIDENCE


def _found(bench: Bench, ranked: Sequence[Candidate], fold: Integers) -> Unknown | None:
    """The best table, by the variables that tell it best."""
    best = _best(bench, ranked, fold)
    return best if best is None else exchanged(bench, best, fold)


def _best(bench: Bench, ranked: Sequence[Candidate], fold: Integers) -> Unknown | None:
    """The table that explains most of weeks left out, of the two strongest components.

    An effect of one component shows in the changes along flights of another as well.
    """
    least = max(LEAST_EVIDENCE, RIVAL * ranked[0].strength)
    strongest = dict.fromkeys(c.component for c in ranked if c.strength >= least)
    made = [_of_component(bench, ranked, name, fold) for name in [*strongest][:2]]
    tables = [table for table in made if table is not None]
    if len(tables) < 2:
        return tables[0] if tables else None
    return max(tables, key=lambda table: explained(bench, field_of(bench, table, fold)))


def _of_component(
    bench: Bench, ranked: Sequence[Candidate], component: str, fold: Integers
) -> Unknown | None:
    """The table of a component: of its strongest, or of what clearly explains more than that.

    What a fleet's effect is everywhere on average speaks for a table by any variable alike, least
    for one by the reported wind, whose evidence leaves that mean to the reference: that it is
    another variable's shows on weeks left out.
    """
    own = [c for c in ranked if c.component == component and c.strength >= LEAST_EVIDENCE]
    table = refined(bench, own[0], fold)
    best, first = own[0], fitted(bench, own[0], fold)
    for candidate in own[1:]:
        other = fitted(bench, candidate, fold)
        if other is not None and (first is None or clearly_more(bench, first, other, fold)):
            best, first = candidate, other
    if best.grid.variables[0] in own[0].grid.variables:
        return table
    other = refined(bench, best, fold)
    if table is None or other is None:
        return table or other
    return other if clearly_more(bench, table, other, fold) else table


def _taken(
    setting: Setting,
    bench: Bench,
    unknown: Unknown,
    ranked: Sequence[Candidate],
    effects: Mapping[str, Effect],
    fold: Integers,
) -> tuple[Taken, Frame] | None:
    """Take an unknown off, where it stands."""
    unknown = confined(bench, unknown, fold)
    if not stands(unknown):
        return None
    frame = setting.frame
    # for the reader of what could be meant as well: behind the sixth none is near
    rivals = tuple((c.strength, c.component, c.grid.variables) for c in ranked[:6])
    unknown = replace(unknown, rivals=rivals)
    error = field_of(bench, unknown, fold)
    zero = np.zeros_like(error)
    sensor = unknown.component.startswith(("across_heading", "heading", "along_heading", "air"))
    left = take_off(frame, error if sensor else zero, zero if sensor else error)
    saved = np.hypot(*frame.residual.T) - np.hypot(*left.T)
    if saved.mean() <= 0.0:  # the table would have the simulation part further from the reports
        return None
    near, share = nearest(setting.quiet, effects, error, unknown.tails)
    draws = drawn(bench, unknown, sensor, missed(bench, unknown, fold))
    return Taken(unknown, saved, draws, near, share), without(frame, left)


def nearest(
    context: Frame, effects: Mapping[str, Effect], error: Floats, tails: Sequence[int]
) -> tuple[str | None, float]:
    """Effect of the catalogue most like an unknown, and the share of it that the effect explains.

    Parameters
    ----------
    context : Frame
        Reports with heading, airspeed and wind free of the residual's noise.
    effects : mapping
        Name -> effect with columns.
    error : (n, 2) float
        What the unknown makes, m/s.

    Returns
    -------
    name : str or None
    share : float
        Of its mean square, by least squares with one set of coefficients.
    """
    rows = np.flatnonzero(np.isin(context.aircraft, tails) & error.any(axis=1))
    rows = rows[:: max(1, rows.size // MOST_COMPARED)]
    part, values = context.take(rows), error[rows].ravel()
    whole = float(values @ values)
    best: tuple[str | None, float] = (None, 0.0)
    for name, effect in effects.items():
        columns = np.moveaxis(effect_columns(part, effect), 0, -1)
        design = columns.reshape(values.size, -1)
        fit = design @ np.linalg.lstsq(design, values, rcond=None)[0]
        share = float(fit @ fit) / whole if whole > 0 else 0.0
        if share > best[1]:
            best = name, share
    return best
