"""Results of the evaluation in one object, and the form of those that are JSON files.

Assumes the products of docs/formats.md; None is what the configuration does not allow. A result
that is a JSON file is a mapping with the keys of the file, written by
:func:`airswing.products.whole_files.write_json`; the function that makes it documents the keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import xarray as xr

if TYPE_CHECKING:
    from airswing.evaluation.monitoring.events import Monitoring

Content = dict[str, Any]
"""Content of a JSON file, or of a part of it, by the keys of docs/formats.md."""


@dataclass(frozen=True)
class Evaluation:
    """Products of the evaluation."""

    profiles: xr.Dataset | None = None  # ``error_profiles.nc``
    observation_errors: xr.Dataset | None = None  # ``observation_errors.nc``
    # of :func:`airswing.evaluation.innovations.innovation_statistics`: ``innovation_statistics.nc``
    innovations: xr.Dataset | None = None
    stability: Content | None = None  # ``stability.json``
    ranking: Sequence[Content] | None = None  # ``ranking.csv``
    virtual: Content | None = None  # ``virtual_field_test.json``
    field_test: Content | None = None  # ``field_test.json``
    sensitivity: Content | None = None  # ``sensitivity.json``
    monitoring: Monitoring | None = None  # ``events.json``
