"""What judges the corrections of a run, in one object.

Assumes the products of docs/formats.md; None is what the configuration does not allow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import xarray as xr

if TYPE_CHECKING:
    from airswing.evaluation.events_file import Monitoring


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation."""

    # profiles, observation_errors: ``error_profiles.nc``, ``observation_errors.nc``
    profiles: xr.Dataset | None = None
    observation_errors: xr.Dataset | None = None
    # stability, virtual, field_test, sensitivity: contents of ``stability.json``,
    # ``virtual_field_test.json`` and so on
    stability: Mapping[str, object] | None = None
    # of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`
    ranking: Sequence[Mapping[str, object]] | None = None
    virtual: Mapping[str, object] | None = None
    field_test: Mapping[str, object] | None = None
    sensitivity: Mapping[str, object] | None = None
    monitoring: Monitoring | None = None
