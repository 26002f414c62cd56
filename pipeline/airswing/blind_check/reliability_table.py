"""Whether a stated probability means what it says: of claims stated with p, a share p is right.

Assumptions: a claim is a name among ``effects`` or a raised unknown, each with its stated
probability; a name is right when the effect is at work in the archive, an unknown when something
is at work that the diagnosis has no name for. Claims fall into bins of the stated probability; a
bin is judged where `LEAST` claims and more stand in it.

Reference: A. Murphy (1973), A new vector partition of the probability score (reliability).
Units: fractions of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from airswing.blind_check.scores import StatedClaim
from airswing.blind_check.unknown_scores import of_background
from airswing.gap.result.schema import GapReport
from airswing.synthetic.sealed.labels import Label

__all__ = ["EDGES", "LEAST", "reliability_rows", "stated_claims", "worst_gap"]

# Finer above: most claims are stated at 0.9 and more.
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
# Claims of a bin: of fewer its share right is chance.
LEAST = 20


class Bin(TypedDict):
    """Claims whose stated probability lies from ``low`` to ``high``."""

    low: float
    high: float
    claims: int
    stated: float  # mean
    right: float  # share


def stated_claims(label: Label, gap: GapReport, truth: Sequence[str]) -> list[StatedClaim]:
    """Return every claim of a diagnosis with its probability and whether it is right.

    Parameters
    ----------
    truth : sequence of str
        Names at work that the diagnosis knows.

    Returns
    -------
    list of StatedClaim
        What is there beside the case's own effect
        (gross errors of a hard world, the heading errors of a real record) is not judged, nor
        unknowns where a little of everything is.
    """
    out = [
        StatedClaim("name", claim.probability, claim.name in truth)
        for claim in gap.effects
        if claim.name in truth or claim.name not in label["background"]
    ]
    if label["world"] != "hard" and label["kind"] != "removed":
        out += [
            StatedClaim("unknown", place.probability, label["kind"] == "outside")
            for place in gap.unknown.where
            if place.probability is not None and not of_background(label, place)
        ]
    return out


def reliability_rows(claims: Sequence[StatedClaim]) -> list[Bin]:
    """Return the calibration table of claims.

    Parameters
    ----------
    claims : sequence of StatedClaim
        From `stated_claims`, of all cases.

    Returns
    -------
    list of dict
        Bins without claims are left out.
    """
    stated = np.array([claim.probability for claim in claims], float)
    right = np.array([claim.right for claim in claims], bool)
    place = np.clip(np.searchsorted(EDGES, stated, side="right") - 1, 0, len(EDGES) - 2)
    return [
        {
            "low": EDGES[k],
            "high": EDGES[k + 1],
            "claims": int((place == k).sum()),
            "stated": float(stated[place == k].mean()),
            "right": float(right[place == k].mean()),
        }
        for k in np.unique(place)
    ]


def worst_gap(claims: Sequence[StatedClaim]) -> tuple[float | None, int]:
    """Return the largest distance of stated and right where `LEAST` claims stand, and their number.

    Parameters
    ----------
    claims : sequence of StatedClaim
        From `stated_claims`.

    Returns
    -------
    gap : float or None
        None where no bin holds enough.
    number : int
        Claims in the bins judged.
    """
    rows = [row for row in reliability_rows(claims) if row["claims"] >= LEAST]
    if not rows:
        return None, 0
    gap = max(abs(row["stated"] - row["right"]) for row in rows)
    return gap, sum(row["claims"] for row in rows)
