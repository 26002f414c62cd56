"""Columns of what the weather and the model do by themselves: never an aircraft's fault.

Assumptions: what the aircraft of one day share is a field of that day, curved in place and height;
what lasts over the archive is the reference's climatology by height, region and hour, and the slope
of reports on model winds, which model error alone makes flatter than 1. All are fitted
together with the effects.

Validity: the archive's own region; places are in units of its spread and clipped at three of them.

Source: docs/gap.md section 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.units import DAY

Floats = NDArray[np.float64]


def day_field_columns(frame: Frame) -> Floats:
    """Columns of the day fields: u and v times {1, x, y, z} and the products of two of these.

    The weather a model misses reaches some hundred km and a part of the troposphere: fields linear
    in place leave much of what aircraft share (a jet's error is curved in height), and scores of
    the fleet's effects then scatter from day to day by four to ten times what independent errors
    would give, two to four with the products.

    Returns
    -------
    (n, 2, 20) float
    """
    x, y, z = _places(frame)
    squares = [x * x - 1, x * y, y * y - 1, x * z, y * z, z * z - 1]
    return _by_component(np.stack([np.ones_like(x), x, y, z, *squares], -1))


def climatology_columns(frame: Frame) -> Floats:
    """Columns of the reference's own climatology: u and v by height, region and hour.

    What a reference lacks over a region changes with height: without the products of three places,
    errors that last pass for winds turned or stretched.

    Returns
    -------
    (n, 2, m) float
    """
    x, y, z = _places(frame)
    angle = 2 * np.pi * frame.time / DAY
    flat = [x, y, x * y, x * x - 1, y * y - 1]
    terms = [np.ones(frame.size), z, z * z - 1, *flat, *(term * z for term in flat)]
    terms += [x * (z * z - 1), y * (z * z - 1), np.sin(angle), np.cos(angle)]
    return _by_component(np.stack(terms, -1))


def _places(frame: Frame) -> list[Floats]:
    """Longitude, latitude and ln p from the archive's middle, in units of its spread."""
    out = []
    for values in (frame.longitude, frame.latitude, np.log(frame.pressure)):
        spread = float(np.std(values))
        out.append(np.clip((values - np.mean(values)) / (spread if spread > 0 else 1.0), -3, 3))
    return out


def _by_component(terms: Floats) -> Floats:
    """(n, k) factors to (n, 2, 2 k) columns: u first, then v."""
    n, k = terms.shape
    out = np.zeros((n, 2, 2 * k))
    out[:, 0, :k] = terms
    out[:, 1, k:] = terms
    return out


def unit_vectors(heading: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the right of the heading and along it, each (n, 2) of (u, v)."""
    sine, cosine = np.sin(heading), np.cos(heading)
    return np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)
