"""Names and unknowns in turn: search, name, take what has none off, until nothing is left.

Assumptions: what a table takes off is no name's any more, so names are searched for again without
it; a doubtful name that explains what a table does is stated in its place. Two aircraft that are
said to have exchanged their identifiers are given each other's reports before any table is taken
off: where an unknown of theirs turns up, all is told again without the exchange, and it stands
where it is found beside the unknown as well.

Validity: as :mod:`airswing.gap.passes`; archives of three days and more for anything unnamed.

Source: docs/gap.md section 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.heading_uncertainty import rounding_of_headings
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.days_left_out import folds_of_days, term_coefficients
from airswing.gap.held_out.linearised import FoundFirst
from airswing.gap.held_out.name_or_table import explains
from airswing.gap.passes import Pass, Search, of_view, search_twice, swap_in
from airswing.gap.search.absorbed_by_unknown import stand_ins
from airswing.gap.search.belief import STATED, beside_table
from airswing.gap.search.cross_validated import ANOTHER, OTHERWISE, Doubtful
from airswing.gap.search.tail_swaps import Swap
from airswing.gap.sums.whole_archive import Archive
from airswing.gap.taken_off.remainders import is_remainder, remainder_names
from airswing.gap.taken_off.unknown_taken import Taken, next_unknown
from airswing.gap.witness.bench import Setting
from airswing.gap.witness.learned import LearnedWitness
from airswing.gap.witness.wind_by_days import name_by_days

Floats = NDArray[np.float64]

#: Unknowns that are taken off at most.
MOST_UNKNOWNS = 4


@dataclass(frozen=True)
class NamesAndUnknowns:
    """What has a name and what has none, nothing left beside them."""

    final: Pass  # of the archive without the unknowns
    again: bool  # whether it is linearised about what an earlier one found
    swap: Swap | None
    taken: list[Taken]  # unknowns, in the order in which they were taken off
    doubtful: Doubtful | None  # a name of the wind by days that was not stated
    search: Search  # with the names that tables confirmed


def names_and_unknowns(archive: Archive, search: Search, *, swaps: bool) -> NamesAndUnknowns:
    """Tell names and unknowns of an archive.

    Parameters
    ----------
    swaps : bool
        Whether two aircraft may have exchanged identifiers.
    """
    told = _told(archive, search, swaps=swaps)
    if told.swap is None or not _of_the_pair(told):
        return told
    without = _told(archive, search, swaps=False)
    return told if swap_in(without.final, search) is not None else without


def _of_the_pair(told: NamesAndUnknowns) -> bool:
    """Whether an unknown of some aircraft is one of those that were exchanged."""
    fleet = len(told.final.problem.archive.tails)
    some = [set(one.unknown.tails) for one in told.taken if len(one.unknown.tails) < fleet]
    return told.swap is not None and any(set(told.swap.pair) & tails for tails in some)


def _told(archive: Archive, search: Search, *, swaps: bool) -> NamesAndUnknowns:
    """Search, and again without what was found unnamed."""
    final, again, swap = search_twice(archive, search, swaps=swaps)
    first, effects = final.standing.found.terms, search.effects
    taken: list[Taken] = []
    witness = LearnedWitness()
    # what no other day can confirm is not raised, as no name is
    seeks = search.dictionary and not archive.clock.short
    doubtful: Doubtful | None = None  # of the last pass
    while seeks and len(taken) < MOST_UNKNOWNS:
        search.tell("witness", len(taken) / MOST_UNKNOWNS)
        beside = _beside_names(final)
        unknown = _next_unknown(final, beside, witness, taken)
        others = [one.unknown.tails for one in taken] + [one.term.tails for one in search.named]
        weak = unknown is None or unknown[0].unknown.run > 0.0
        doubtful = _by_means(final, beside, others) if weak else None
        name = doubtful if doubtful is not None and not doubtful.reason else None
        name = _name_of(final, *unknown) if name is None and unknown is not None else name
        if name is not None:
            search = replace(search, named=(*search.named, name))
        elif unknown is not None:
            taken.append(unknown[0])
            archive = of_view(archive, unknown[1])
        else:
            break
        final, again, more = search_twice(archive, search, swaps=swaps and swap is None)
        swap = swap or more
    left = effects
    while small := _not_told(first, final.standing.found.terms, taken):
        left = {name: effect for name, effect in left.items() if name not in small}
        final, again, _ = search_twice(archive, replace(search, effects=left), swaps=False)
    return NamesAndUnknowns(final, again, swap, taken, doubtful, search)


def _not_told(first: Sequence[Term], terms: Sequence[Term], taken: Sequence[Taken]) -> set[str]:
    """Names that are what unknowns left, or stood in for them."""
    return remainder_names(terms, [one.unknown for one in taken]) | stand_ins(first, terms)


@dataclass(frozen=True)
class _BesideNames:
    """What the names of a pass leave, and what it is weighed with."""

    setting: Setting
    rest: Floats  # (n, 2): m/s
    linear: Floats | None  # (n, 2): of what was taken off, the part to first order; None: nothing


def _beside_names(final: Pass) -> _BesideNames:
    """Take the names of a pass off."""
    problem, found = final.problem, final.standing.found
    values = term_coefficients(found.given, found.terms)
    named = [k for k, term in enumerate(found.terms) if term.candidate.known]
    about = FoundFirst.of(problem, [found.terms[k] for k in named], [values[k] for k in named])
    rest, linear = problem.archive.residual, None
    if named:
        rest, linear = about(problem.archive, problem.context)
    return _BesideNames(Setting.of(problem), rest, linear)


def _by_means(
    final: Pass, beside: _BesideNames, others: Sequence[Sequence[int]]
) -> Doubtful | None:
    """Find a name of the wind by days; ``others``: aircraft of what was told."""
    found = final.standing.found
    return name_by_days(final.problem, found, beside.setting, beside.rest, others)


def _next_unknown(
    final: Pass, beside: _BesideNames, witness: LearnedWitness, taken: Sequence[Taken]
) -> tuple[Taken, Frame] | None:
    """Find what the names of a pass do not explain, and the archive without it.

    Not what earlier ones, or the steps of coarse headings, leave.
    """
    problem = final.problem
    fold = folds_of_days(problem.base.stats)
    unknown = next_unknown(
        beside.setting, problem.effects, beside.rest, fold, witness, linear=beside.linear
    )
    frame = problem.archive
    rounding = float(np.mean(frame.airspeed)) * rounding_of_headings(frame)
    told = [one.unknown for one in taken]
    if unknown is not None and is_remainder(unknown[0].unknown, told, rounding):
        return None
    return unknown


def _name_of(final: Pass, taken: Taken, left: Frame) -> Doubtful | None:
    """Find the doubtful name that explains what a table does, with the probability it then has."""
    problem, standing = final.problem, final.standing
    stand = [term for term in standing.found.terms if term.candidate.known]
    table = problem.archive.residual - left.residual, taken.unknown.tails
    # that something is there makes a name that is likelier another effect no surer
    asked = [one for one in standing.doubtful if one.reason not in (ANOTHER, OTHERWISE)]
    for one in sorted(asked, key=lambda one: -one.probability):
        chance = beside_table(one.probability)
        if chance >= STATED and explains(problem, stand, one.term, table):
            return replace(one, probability=chance)
    return None
