"""What judges the corrections of a run, in one object.

Assumes the products of docs/formats.md; None is what the configuration does not allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import xarray as xr

if TYPE_CHECKING:
    from airswing.evaluation.contents import (
        FieldTestContent,
        Ranked,
        SensitivityContent,
        StabilityContent,
        VirtualContent,
    )
    from airswing.evaluation.events_file import Monitoring


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation."""

    # profiles, observation_errors: ``error_profiles.nc``, ``observation_errors.nc``
    profiles: xr.Dataset | None = None
    observation_errors: xr.Dataset | None = None
    # of :func:`airswing.evaluation.innovations.innovation_statistics`: ``innovation_statistics.nc``
    innovations: xr.Dataset | None = None
    # stability, virtual, field_test, sensitivity: contents of ``stability.json``,
    # ``virtual_field_test.json`` and so on
    stability: StabilityContent | None = None
    # of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`
    ranking: Sequence[Ranked] | None = None
    virtual: VirtualContent | None = None
    field_test: FieldTestContent | None = None
    sensitivity: SensitivityContent | None = None
    monitoring: Monitoring | None = None
