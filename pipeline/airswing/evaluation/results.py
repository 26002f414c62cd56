"""Results of the evaluation in one object; None is what the configuration does not allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import xarray as xr

from airswing.evaluation import Content

if TYPE_CHECKING:
    from airswing.evaluation.monitoring.events import Monitoring


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation."""

    profiles: xr.Dataset | None = None  # ``error_profiles.nc``
    observation_errors: xr.Dataset | None = None  # ``observation_errors.nc``
    innovations: xr.Dataset | None = None  # ``innovation_statistics.nc``
    stability: Content | None = None  # ``stability.json``
    ranking: Sequence[Content] | None = None  # ``ranking.csv``
    virtual: Content | None = None  # ``virtual_field_test.json``
    field_test: Content | None = None  # ``field_test.json``
    sensitivity: Content | None = None  # ``sensitivity.json``
    monitoring: Monitoring | None = None  # ``events.json``
