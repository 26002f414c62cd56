"""Evaluation of corrections and references, changes of compasses, errors of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import xarray as xr

if TYPE_CHECKING:
    from airswing.evaluation.monitoring.events import Monitoring

Content = dict[str, Any]
"""Content of a JSON file, or of a part of it, by the keys of docs/formats.md.

The function that makes it documents the keys.
"""


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation; None where the configuration does not allow one."""

    observation_errors: xr.Dataset | None = None  # ``observation_errors.nc``
    innovations: xr.Dataset | None = None  # ``innovation_statistics.nc``
    stability: Content | None = None  # ``stability.json``
    ranking: Sequence[Content] | None = None  # ``ranking.csv``
    virtual: Content | None = None  # ``virtual_field_test.json``
    field_test: Content | None = None  # ``field_test.json``
    sensitivity: Content | None = None  # ``sensitivity.json``
    monitoring: Monitoring | None = None  # ``events.json``
