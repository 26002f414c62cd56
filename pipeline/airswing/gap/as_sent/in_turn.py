"""What is sent so wrongly that it is set right first: stuck values, maps, north, lags, bounds.

Assumptions and validity: those of each kind.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from airswing.gap.archive.frame import Frame
from airswing.gap.as_sent.ceiling import ceiling_of
from airswing.gap.as_sent.late_heading import late_heading_of
from airswing.gap.as_sent.magnetic_north import against_magnetic_north_of
from airswing.gap.as_sent.mended import Mended
from airswing.gap.as_sent.repeated import repeated_of
from airswing.gap.as_sent.wind_maps import mapped_of


def all_mended(frame: Frame, names: Collection[str]) -> list[Mended]:
    """Errors of the winds sent, each found in the archive that the one before it leaves.

    Parameters
    ----------
    names : collection of str
        Effects that may be named; what is one of another name is told without.
    """
    out: list[Mended] = []
    for find in (repeated_of, mapped_of, against_magnetic_north_of, late_heading_of, ceiling_of):
        found = find(out[-1].lifted if out else frame)
        if found is not None:
            out.append(found if found.name in names else replace(found, name=None))
    return out
