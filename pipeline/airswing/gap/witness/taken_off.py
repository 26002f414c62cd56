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
from airswing.gap.archive.reported_variables import OF_THE_REPORT
from airswing.gap.archive.value_tables import change_of
from airswing.gap.design.layout import effect_columns
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.reduction import take_off
from airswing.gap.search.belief import LIKELIER_ANOTHER
from airswing.gap.witness.bench import BLOCK, Bench, Setting
from airswing.gap.witness.fitted_tables import (
    BOUND,
    LEAST_EVIDENCE,
    Candidate,
    Unknown,
    clearly_more,
    confined,
    explained,
    field_of,
    fitted,
    halved,
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

#: What a table must explain more than all names, as a factor, to lead; the same of one that is
#: mostly these names over again (the square of their correlation from which it is): where every
#: aircraft has a little of all effects a table takes that up as well, 1.1 to 1.3 at 0.68 to 0.91.
#: Names that only stand in for what has none are unlike it (0.31 to 0.37, and it explains 4 times
#: as much). One that holds the names at a quarter more than their size says they are too small.
LEADS, LIKENESS, SAME_SIZE, LEADS_ITS_LIKE = 1.05, 0.6, 1.25, 1.5
#: The last two of a table that is nothing but the names: what changes along flights lets an effect
#: come out too small behind another of the same aircraft (an airspeed's offset behind a time lag
#: at 0.77 of its size), and its name is none the less its name.
NOTHING_BUT, NEAR_SIZE = 0.95, 1.6
#: The square of its correlation with names that leave nothing from which a table is these: 0.18 of
#: a step that stood in for an error by date and drift, 0.64 of a right hard iron of the fleet.
STANDS_IN = 0.5
#: What names may miss of their size in the residual as it is, error and all, to be left in peace.
OF_ANOTHER_SIZE = 0.25
#: Share of a table's largest value that is nothing, at an end of its variable: what an error that
#: grows from nothing has in its first cell of eight.
NOTHING = 0.15
#: Evidence beside the strongest's from which a table of another component is tried as well.
RIVAL = 0.3
#: Size beside that of the names' on the same aircraft under which an unknown is their remainder.
REMAINDER = 0.2
#: The same beside an earlier unknown's: cells are coarse.
OWN_REMAINDER = 0.35
#: Reports on which an unknown is compared with effects, at most.
MOST_COMPARED = 2000
#: What a table misses of its effect on average, as a share of what it closes, beside what its cells
#: do not resolve: measured against twins (docs/gap_check.md), 0 to 0.3 in nine archives.
MISSED = 0.1
#: The same where a variable is known roughly: 0.55 and 0.8 of acceleration, 0.85 of ground speed,
#: of bank and drift as little is known; reports that an effect moved into a cell of the reported
#: wind stand there among others that it left alone (0.4 and 1.3). Airspeed is that of a wind
#: without its small scales: of a saw by it a table closed 0.32 of 0.69 kt, of a sector half.
ROUGH = ("acceleration", "bank", "turn", "ground_speed", "drift")
KNOWN_ROUGHLY = dict.fromkeys(ROUGH, 0.7) | dict.fromkeys(OF_THE_REPORT, 0.8) | {"airspeed": 1.0}
#: Relative standard error of what a table closes from the reference's error that follows its cells
#: in every week: of simulated fleets, tables are up to 4 % above the truth (docs/gap_check.md).
LASTS = 0.04
#: Draws of what an unknown closes.
DRAWS = 200


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


def without(frame: Frame, wind: Floats) -> Frame:
    """Frame whose reported winds are others, with the heading and airspeed they imply."""
    u, v = frame.u_ref + wind[:, 0], frame.v_ref + wind[:, 1]
    air_u, air_v = frame.ground_u - u, frame.ground_v - v
    heading = np.mod(np.arctan2(air_u, air_v), 2 * np.pi)
    declination = frame.heading - frame.magnetic_heading
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=heading,
        airspeed=np.hypot(air_u, air_v),
        magnetic_heading=np.mod(heading - declination, 2 * np.pi),
    )


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
        if first is not None and _leads(plain, first, ways, fold, left=left):
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


def borne_out(setting: Setting, errors: Floats) -> bool:
    """Whether the residual holds what names make of it, (n, 2), about as large as they say.

    Names are fitted to what changes along flights. One that only stands in for an unknown may leave
    nothing of it to be told there, but is then of another size in the residual as it is.
    """
    residual, day = setting.frame.residual, setting.day
    near = np.abs(residual).max(axis=1) < BOUND
    held = np.bincount(day // BLOCK, np.where(near, (residual * errors).sum(axis=1), 0.0))
    whole = np.bincount(day // BLOCK, np.where(near, (errors**2).sum(axis=1), 0.0))
    share = float(held.sum() / whole.sum())
    error = float(np.sqrt(((held - share * whole) ** 2).sum()) / whole.sum())
    return abs(share - 1.0) + error < OF_ANOTHER_SIZE


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
    drawn = _drawn(bench, unknown, sensor, missed(bench, unknown, fold))
    return Taken(unknown, saved, drawn, near, share), without(frame, left)


def missed(bench: Bench, unknown: Unknown, fold: Integers) -> float:
    """Share of what a table closes that it misses: by its cells, and by its variables.

    Where the effect has an edge in a cell, halves of cells miss half as much as cells do; where it
    has a slope, a quarter: so cells miss at most twice what their halves explain more.
    """
    own = explained(bench, field_of(bench, unknown, fold))
    finer = [explained(bench, field_of(bench, one, fold)) for one in halved(bench, unknown, fold)]
    more = sum(max(one - own, 0.0) for one in finer)
    cells = float(np.clip(2 * more / own, 0.0, 1.0)) if own > 0 else 1.0
    return cells + max(KNOWN_ROUGHLY.get(name, MISSED) for name in unknown.grid.variables)


def _drawn(bench: Bench, unknown: Unknown, sensor: bool, missed_share: float) -> Floats:
    """What an unknown closes, drawn from what is open about its table, (draws,), m/s.

    As for what has a name (:mod:`airswing.gap.closure.interval`): the fit's own error, error of the
    reference that lasts, and the part of the effect that cells do not hold.
    """
    frame, rng = bench.setting.frame, np.random.default_rng(0)
    error = field_of(bench, unknown)
    zero = np.zeros_like(error)
    left = take_off(frame, error if sensor else zero, zero if sensor else error)
    cells = bench.cells(unknown.grid)
    rows = np.flatnonzero(np.isin(frame.aircraft, unknown.tails) & (cells >= 0))
    owner, cell, near = frame.aircraft[rows], cells[rows], left[rows]
    direction = bench.direction_for(unknown.grid, unknown.component)[rows]
    gained = float(np.hypot(*frame.residual[rows].T).sum() - np.hypot(*near.T).sum())
    # as in the scan: the prior's root needs every direction
    lasting = np.linalg.cholesky(unknown.grid.prior() + 1e-9 * np.eye(unknown.grid.size))
    lasting *= bench.persistent(unknown.grid, unknown.tails) / bench.scale(unknown.component)
    start, out = np.hypot(*near.T).sum(), np.empty(DRAWS)
    steps = np.zeros_like(unknown.values)
    for d in range(DRAWS):
        shared = lasting @ rng.standard_normal(unknown.grid.size)
        for root, group in zip(unknown.roots, unknown.groups, strict=True):
            steps[group] = root @ rng.standard_normal(unknown.grid.size) + shared
        now = near - steps[owner, cell][:, None] * direction
        out[d] = gained + start - np.hypot(*now.T).sum()
    out += gained * missed_share * rng.uniform(0.0, 2.0, DRAWS)
    out += gained * LASTS * rng.standard_normal(DRAWS)
    if "wind" in unknown.component and len(unknown.tails) == len(frame.tails):
        # the table does not tell which of the two winds errs
        out += (_of_reference(bench, unknown) - gained) * rng.integers(0, 2, DRAWS)
    return out / frame.size


def _of_reference(bench: Bench, unknown: Unknown) -> float:
    """What a table of the wind closes where the reference is what errs, summed over reports, m/s.

    Its small scales are then too weak or turned as well; they are in part wrong, so that setting
    the reference right closes less than the same table on the large-scale wind.
    """
    frame, cells = bench.setting.frame, bench.cells(unknown.grid)
    size = np.where(cells >= 0, unknown.values[frame.aircraft, np.maximum(cells, 0)], 0.0)
    winds = {"u": frame.u_ref, "v": frame.v_ref}
    direction = change_of(
        unknown.component, heading=frame.heading, airspeed=frame.airspeed, **winds
    )
    left = frame.residual - size[:, None] * direction
    return float(np.hypot(*frame.residual.T).sum() - np.hypot(*left.T).sum())


def _leads(
    bench: Bench, unknown: Unknown, ways: Sequence[Floats], fold: Integers, *, left: bool = True
) -> bool:
    """Whether a table alone explains more than all names together, either way these are taken.

    Half as much again where these leave nothing that is to be told, and it must be another thing:
    a table of the whole fleet holds a right name and what weather does by its variables.

    A factor of the wind is exact on the reference's own, whose small scales are in part wrong and
    cost it energy that a table, on the large-scale wind, does not pay.
    """
    table = field_of(bench, unknown, fold)
    names = max(ways, key=lambda errors: explained(bench, errors))
    both, square = float((table * names).sum()), float((names**2).sum())
    likeness = both**2 / max(float((table**2).sum()) * square, 1e-12)
    most = NEAR_SIZE if likeness >= NOTHING_BUT else SAME_SIZE
    like = likeness >= LIKENESS and both <= most * square
    if not left and likeness >= STANDS_IN:
        return False
    least = LEADS_ITS_LIKE if not left or (like and not from_nothing(unknown)) else LEADS
    return explained(bench, table) > least * explained(bench, names)


def from_nothing(unknown: Unknown) -> bool:
    """Whether a table of one variable begins, or ends, at nothing and grows away from it.

    Then it is the whole effect, and a steady name beside it only its mean: an offset with something
    small beside it, told by one table, is nowhere near nothing.
    """
    if len(unknown.grid.axes) > 1 or unknown.grid.axes[0].kind != "linear":
        return False
    values = np.abs(unknown.values[list(unknown.tails)]).mean(axis=0)
    return bool(min(values[0], values[-1]) < NOTHING * values.max())


def small_beside(errors: Floats, size: float, *, share: float = REMAINDER) -> bool:
    """Whether a size, m/s rms, is small beside what names explain of the same reports, (m, 2)."""
    return size < share * float(np.sqrt((errors**2).sum(axis=1).mean()))


def is_remainder(new: Taken, earlier: Sequence[Taken], rounding: Floats) -> bool:
    """Whether an unknown is what the cells of an earlier one left on the same aircraft.

    Or what their coarse headings leave: the same along a course, it goes with all that courses do.

    Parameters
    ----------
    rounding : (aircraft,) float
        What the steps of each aircraft's headings make, m/s; 0 of fine ones.
    """
    if new.unknown.run and earlier:  # runs are of what is small, beside nothing that is not
        return True
    own = set(new.unknown.tails)
    coarse = rounding[list(own)]
    if np.mean(coarse > 0) > 0.5 and new.unknown.size < OWN_REMAINDER * float(coarse.max()):
        return True
    return any(
        len(own & set(old.unknown.tails)) > 0.5 * len(own)
        and new.unknown.size < OWN_REMAINDER * old.unknown.size
        for old in earlier
    )


def remainder_names(terms: Sequence[Term], taken: Sequence[Taken]) -> set[str]:
    """Names whose every term is small beside an unknown taken off the same aircraft.

    Cells are coarse: what a table leaves within them bends into the shape of names. So does one of
    all aircraft that is no likelier than not what its name says.
    """
    small: dict[str, bool] = {}
    for term in terms:
        if not term.candidate.known:
            continue
        own = set(term.tails)
        size = float(np.median(term.score.size[list(term.tails)]))
        likely = term.score.probability
        doubted = likely is not None and likely < LIKELIER_ANOTHER
        less = any(
            own <= set(one.unknown.tails) and (doubted or size < OWN_REMAINDER * one.unknown.size)
            for one in taken
        )
        small[term.candidate.name] = small.get(term.candidate.name, True) and less
    return {name for name, less in small.items() if less}


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
