"""All effects of an archive that show in no mean and have a name.

Assumptions and validity: those of :mod:`airswing.gap.scatter.coded_values` and
:mod:`airswing.gap.scatter.gross_rates`.
"""

from __future__ import annotations

from airswing.gap.archive.frame import Frame
from airswing.gap.noise.model import NoiseFit
from airswing.gap.scatter.coded_values import (
    heading_coding,
    position_coding,
    whole_minutes,
    wind_coding,
)
from airswing.gap.scatter.gross_rates import outliers
from airswing.gap.scatter.moment_verdict import MomentVerdict


def second_moments(frame: Frame, noise: NoiseFit) -> list[MomentVerdict]:
    """All second-moment effects of an archive."""
    found = [
        wind_coding(frame),
        position_coding(frame),
        heading_coding(frame),
        whole_minutes(frame),
    ]
    return [f for f in (*found, outliers(frame, noise)) if f is not None]
