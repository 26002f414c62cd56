"""Names that only stand in for something unknown.

Assumptions: what nobody knows, a heading error that follows the hour of the day say, or one that
acts in a quadrant only, has a mean, one cycle and two over the reports, and each has a name in the
catalogue. Names and curves of one component on the same aircraft are therefore judged together:
where the names' share of what all of them explain on held-out days stays under
:data:`CATALOGUE_SHARE` by two standard errors, one effect that nobody named is likelier than as
many named ones beside it on just these aircraft; the unknown is the verdict, and the names are told
with it as parts of its shape.

Validity: lasting effects of heading and airspeed, with curves across and along the heading; the
aircraft of names and curves are the same but for a few (:data:`ALIKE`). What the columns of a true
effect cannot carry (a bank that is inferred) leaves less than the share allows.

Source: docs/gap.md section 6 (unknown).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term

Floats = NDArray[np.float64]

#: Effects of the catalogue whose error is along the heading.
ALONG = ("tas_scale", "tas_offset")
#: Share of the energy under which the catalogue does not explain a gap.
CATALOGUE_SHARE = 0.9
#: Aircraft in common over aircraft in either, from which names and curves are on the same ones.
ALIKE = 0.5


def folded(terms: Sequence[Term], energy: Floats, error: Floats) -> dict[int, int]:
    """Terms of the catalogue that only stand in for unknown ones.

    Parameters
    ----------
    energy, error : (t,) float
        Held-out energy of each and its standard error.

    Returns
    -------
    dict
        Position of a known term -> position of the strongest unknown one it belongs to.
    """
    out: dict[int, int] = {}
    for component in ("cross", "along"):
        curves = [
            k
            for k, term in enumerate(terms)
            if not term.candidate.known and term.candidate.component == component
        ]
        struck = {a for k in curves for a in terms[k].tails}
        names = [
            k
            for k, term in enumerate(terms)
            if _component(term) == component and _alike(set(term.tails), struck)
        ]
        if not names or not curves:
            continue
        share, doubt = _share(*((energy[own], error[own]) for own in (names, curves)))
        if share + 2 * doubt < CATALOGUE_SHARE:
            strongest = max(curves, key=lambda k: energy[k])
            out |= dict.fromkeys(names, strongest)
    return out


def _component(term: Term) -> str:
    """Component that a lasting effect of a unit makes its error in; empty for others."""
    if not term.candidate.known or term.period is not None:
        return ""
    if term.candidate.name in ALONG:
        return "along"
    return "cross" if term.candidate.heading and term.candidate.scope == "aircraft" else ""


def _alike(one: set[int], other: set[int]) -> bool:
    return len(one & other) >= ALIKE * len(one | other)


def _share(named: tuple[Floats, Floats], nameless: tuple[Floats, Floats]) -> tuple[float, float]:
    """First's share of two sums of energies and its standard error."""
    # held out an energy may come out negative: then there is none
    known, unknown = (max(float(own[0].sum()), 1e-9) for own in (named, nameless))
    errors = [float(np.hypot.reduce(own[1])) for own in (named, nameless)]
    doubt = np.hypot(unknown * errors[0], known * errors[1]) / (known + unknown) ** 2
    return known / (known + unknown), float(doubt)


def stand_ins(before: Sequence[Term], after: Sequence[Term]) -> set[str]:
    """Names that came up only where a table took another's share.

    A table over heading or track holds a constant and a cycle as well. Taken off, it may leave of a
    name that stood before what another name copies, on the same aircraft; of a curve too: what no
    name explained better while the curve stood is what the table's cells miss of it.

    Parameters
    ----------
    before, after : sequence of Term
        Found before tables were taken off, and after.
    """

    def aircraft(terms: Sequence[Term]) -> dict[str, set[int]]:
        out: dict[str, set[int]] = {}
        for term in terms:
            if term.candidate.known and term.candidate.scope == "aircraft":
                out.setdefault(term.candidate.name, set()).update(term.tails)
        return out

    first, last = aircraft(before), aircraft(after)
    robbed = set().union(*(own - last.get(name, set()) for name, own in first.items()))
    curved: dict[str, set[int]] = {"": set()}
    for term in before:
        if not term.candidate.known:
            curved.setdefault(term.candidate.component, set()).update(term.tails)
    like = {term.candidate.name: curved.get(_component(term), set()) for term in after}
    return {
        name
        for name, own in last.items()
        if own - first.get(name, set()) and own <= robbed | like[name]
    }
