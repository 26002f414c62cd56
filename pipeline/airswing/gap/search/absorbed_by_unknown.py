"""Names that are only the mean of something unknown.

Assumptions: what nobody knows, a heading error that follows the hour of the day say, has a mean
over the reports, and the mean has a name in the catalogue. Where the catalogue's share of what both
explain on held-out days stays under 0.8 by two standard errors, the name is no cause: the unknown
is the verdict, and the named part is told with it.

Validity: means of curves on the cross-track and the along-track component and their one cycle;
the unknown holds all aircraft of the name.

Source: docs/gap.md section 6 (unknown).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term

Floats = NDArray[np.float64]

#: Component of a dictionary group, and whether it is times the heading -> effects that are a mean
#: of such a curve.
MEANS = {
    ("cross", False): ("compass_offset",),
    ("cross", True): ("hard_iron",),
    ("along", False): ("tas_scale", "tas_offset"),
}
#: Share of the energy under which the catalogue does not explain a gap.
CATALOGUE_SHARE = 0.8


def folded(terms: Sequence[Term], energy: Floats, error: Floats) -> dict[int, int]:
    """Terms of the catalogue that are means of unknown ones.

    Parameters
    ----------
    terms : sequence of Term
    energy, error : (t,) float
        Held-out energy of each and its standard error.

    Returns
    -------
    dict
        Position of a known term -> position of the unknown one it belongs to.
    """
    out: dict[int, int] = {}
    for u, unknown in enumerate(terms):
        if unknown.candidate.known:
            continue
        kind = unknown.candidate.component, unknown.candidate.name.endswith("*heading")
        for k, known in enumerate(terms):
            mean = known.candidate.known and known.candidate.name in MEANS.get(kind, ())
            if mean and known.period is None and set(known.tails) <= set(unknown.tails):
                share, doubt = _share(energy[[k, u]], error[[k, u]])
                if share + 2 * doubt < CATALOGUE_SHARE:
                    out[k] = u
    return out


def _share(energy: Floats, error: Floats) -> tuple[float, float]:
    """First's share of two energies and its standard error."""
    known, unknown = (max(float(e), 1e-9) for e in energy)
    doubt = np.hypot(unknown * error[0], known * error[1]) / (known + unknown) ** 2
    return known / (known + unknown), float(doubt)
