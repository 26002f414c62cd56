"""What judges the corrections of a run, in one object.

Assumes the products of docs/formats.md; None is what the configuration does not allow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation.

    Attributes
    ----------
    profiles, observation_errors : Dataset
        ``error_profiles.nc``, ``observation_errors.nc``.
    stability, virtual, field_test, sensitivity : mapping
        Contents of ``stability.json``, ``virtual_field_test.json`` and so on.
    monitoring : mapping
        Content of ``events.json``.
    ranking : sequence of mapping
        Of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`.
    """

    profiles: xr.Dataset | None = None
    observation_errors: xr.Dataset | None = None
    stability: Mapping[str, Any] | None = None
    ranking: Sequence[Mapping[str, Any]] | None = None
    virtual: Mapping[str, Any] | None = None
    field_test: Mapping[str, Any] | None = None
    sensitivity: Mapping[str, Any] | None = None
    monitoring: Mapping[str, Any] | None = None
