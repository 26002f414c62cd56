"""Whether a stated probability means what it says: of claims stated with p, a share p is right.

Assumptions: a claim is a name among ``effects`` or a raised unknown, each with its stated
probability; a name is right when the effect is at work in the archive, an unknown when something
is at work that the diagnosis has no name for. Claims fall into bins of the stated probability; a
bin is judged where `LEAST` claims and more stand in it.

Reference: A. Murphy (1973), A new vector partition of the probability score (reliability).
Units: fractions of 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from airswing.blind_check.unknown_scores import of_background

__all__ = ["EDGES", "LEAST", "reliability_rows", "stated_claims", "worst_gap"]

# Finer above: most claims are stated at 0.9 and more.
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
# Claims of a bin: of fewer its share right is chance.
LEAST = 20


def stated_claims(
    label: Mapping[str, Any], gap: Mapping[str, Any], truth: Sequence[str]
) -> list[list[object]]:
    """Return every claim of a diagnosis with its probability and whether it is right.

    Parameters
    ----------
    gap : mapping
        Content of gap.json.
    truth : sequence of str
        Names at work that the diagnosis knows.

    Returns
    -------
    list of [str, float, bool]
        ``name`` or ``unknown``, probability, right. What is there beside the case's own effect
        (gross errors of a hard world, the heading errors of a real record) is not judged, nor
        unknowns where a little of everything is.
    """
    out: list[list[object]] = []
    for claim in gap["effects"]:
        name = str(claim["name"])
        if name in truth or name not in label["background"]:
            out.append(["name", float(claim["probability"]), name in truth])
    if label["world"] != "hard" and label["kind"] != "removed":
        out += [
            ["unknown", float(place["probability"]), label["kind"] == "outside"]
            for place in gap["unknown"]["where"]
            if place.get("probability") is not None and not of_background(label, place)
        ]
    return out


def reliability_rows(claims: Sequence[Sequence[object]]) -> list[dict[str, Any]]:
    """Return the calibration table of claims.

    Parameters
    ----------
    claims : sequence of (str, float, bool)
        From `stated_claims`, of all cases.

    Returns
    -------
    list of dict
        ``low, high`` (bin of stated probability), ``claims, stated`` (mean), ``right`` (share).
        Bins without claims are left out.
    """
    stated = np.array([claim[1] for claim in claims], float)
    right = np.array([claim[2] for claim in claims], bool)
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


def worst_gap(claims: Sequence[Sequence[object]]) -> tuple[float | None, int]:
    """Return the largest distance of stated and right where `LEAST` claims stand, and their number.

    Parameters
    ----------
    claims : sequence of (str, float, bool)
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
