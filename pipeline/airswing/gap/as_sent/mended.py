"""Winds sent wrongly so plainly that they are set right before anything is fitted.

Assumptions: what is found here needs no noise model, no search and no other effect's absence: winds
that are not the aircraft's own at all would only spoil these. Each kind looks at the archive the
one before it leaves.

Validity: each kind's own.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Mended:
    """An error of the winds sent, and the archive without it."""

    component: str  # what is sent wrongly
    variables: tuple[str, ...]  # by what
    title: str  # what is told of it on the waterfall
    tails: tuple[int, ...]  # aircraft that have it
    evidence: float  # nats
    size: float  # m/s rms where it acts
    lifted: Frame  # winds as they would have been
    saved: Floats  # (n,): disagreement with it less without, m/s
    drawn: Floats  # (draws,): its mean over all reports, as what is open about it leaves it
    labels: tuple[str, ...]  # of its values
    values: tuple[float, ...]
    unit: str
    edges: tuple[float, ...] | None = None  # of the first variable, where it is a table
    # the effect of the catalogue that it is, where it has a name
    name: str | None = None
    parameters: Mapping[str, float | None] = field(default_factory=dict)
    standard_errors: Mapping[str, float] = field(default_factory=dict)


def shortened(frame: Frame, winds: Floats) -> Floats:
    """Disagreement of an archive less that of other winds on its paths, (..., n), m/s.

    Parameters
    ----------
    winds : (..., n, 2) float
        m/s.
    """
    left = winds - np.stack([frame.u_ref, frame.v_ref], -1)
    return np.asarray(np.hypot(*frame.residual.T) - np.hypot(left[..., 0], left[..., 1]))


def days_of(frame: Frame, rows: NDArray[np.bool_]) -> int:
    """Days on which some reports were made."""
    return int(np.unique(frame.day[rows]).size)


def in_aircraft(frame: Frame, tails: Sequence[int]) -> NDArray[np.bool_]:
    """Reports of some aircraft, (n,)."""
    return np.asarray(np.isin(frame.aircraft, tails))
