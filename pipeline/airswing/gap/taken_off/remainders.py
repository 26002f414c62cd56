"""What names and earlier unknowns leave of themselves, and is no finding.

Assumptions: cells are coarse and names linear, so that what they leave within them bends into the
shape of others, on the same aircraft and small beside what left it.

Validity: sizes as found, m/s rms over the reports of the aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term
from airswing.gap.search.belief import LIKELIER_ANOTHER
from airswing.gap.witness.fitted_tables import Unknown

Floats = NDArray[np.float64]

#: Size beside that of the names' on the same aircraft under which an unknown is their remainder.
REMAINDER = 0.2
#: The same beside an earlier unknown's: cells are coarse.
OWN_REMAINDER = 0.35
#: The same beside what coarse headings make: of steps of 10 and 15 degrees 0.43 to 0.46 were left.
COARSE_REMAINDER = 0.7


def small_beside(errors: Floats, size: float, *, share: float = REMAINDER) -> bool:
    """Whether a size, m/s rms, is small beside what names explain of the same reports, (m, 2)."""
    return size < share * float(np.sqrt((errors**2).sum(axis=1).mean()))


def is_remainder(new: Unknown, earlier: Sequence[Unknown], rounding: Floats) -> bool:
    """Whether an unknown is what the cells of an earlier one left on the same aircraft.

    Or what their coarse headings leave: the same along a course, it goes with all that courses do.

    Parameters
    ----------
    rounding : (aircraft,) float
        What the steps of each aircraft's headings make, m/s; 0 of fine ones.
    """
    if new.run and earlier:  # runs are of what is small, beside nothing that is not
        return True
    own = set(new.tails)
    coarse = rounding[list(own)]
    if np.mean(coarse > 0) > 0.5 and new.size < COARSE_REMAINDER * float(coarse.max()):
        return True
    return any(
        len(own & set(old.tails)) > 0.5 * len(own) and new.size < OWN_REMAINDER * old.size
        for old in earlier
    )


def remainder_names(terms: Sequence[Term], unknowns: Sequence[Unknown]) -> set[str]:
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
            own <= set(one.tails) and (doubted or size < OWN_REMAINDER * one.size)
            for one in unknowns
        )
        small[term.candidate.name] = small.get(term.candidate.name, True) and less
    return {name for name, less in small.items() if less}
