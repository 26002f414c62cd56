"""Deviation while a heater is on, by the icing flag or between two temperatures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects.base import (
    Estimate,
    OffsetAndCycle,
    Parameter,
    Parameters,
    missing_context,
    number,
)
from airswing.synthetic.sealed.draws import Draw, offset_and_cycle
from airswing.units import ZERO_CELSIUS

EDGES = (5, 0, -5, -10, -15, -20)
"""Temperatures at which a heater may switch, degC: on below one, or between two."""


def _subsets() -> tuple[tuple[int, ...], ...]:
    # by the flag; by temperature below an edge or between two
    flag = ((0,), (1, 2), (0, 1, 2))
    edges = [tuple(range(3 * k + 3, 3 * k + 6)) for k in range(len(EDGES))]
    single = [(columns[0],) for columns in edges]
    bands = list(combinations(edges, 2))
    offsets = [(warm[0], cold[0]) for warm, cold in bands]
    return (*flag, *single, *edges, *offsets, *(warm + cold for warm, cold in bands))


def _band(rng: np.random.Generator) -> dict[str, object]:
    # temperatures at which icing protection is used
    low = float(rng.choice([-20.0, -15.0, -10.0]))
    return {"between_degC": [low, low + float(rng.choice([10.0, 15.0]))]}


def _heated(frame: pd.DataFrame, values: Mapping[str, object]) -> Booleans:
    if values.get("between_degC") is None:
        return np.asarray(frame["icing"] == 1)
    low, high = _edges(values)
    return np.asarray((frame["temperature"] - ZERO_CELSIUS).between(low, high, inclusive="left"))


class HeaterCurrent(OffsetAndCycle):
    """Offset and one cycle of heading error where icing = 1, or between two temperatures.

    For temperatures there are columns for each edge, nonzero where it is colder; a band is the
    difference of two edges with equal coefficients. Without flag and temperature the effect is not
    testable.
    """

    name = "heater_current"
    title = "heading error while icing protection is on"
    draw = Draw(offset_and_cycle, ("offset_deg", "amplitude_deg"), form=_band, acts=_heated)
    distinguished_by = {"compass_offset": "the icing flag, on and off on each heading"}
    physics = (
        "The direct current of electric de-icing makes a magnetic field fixed in the aircraft; the "
        "compass deviates while it flows. Its one cycle grows as 1/H like any hard iron, which "
        "cannot be seen within one region; the amplitude is that of the region. A heater that a "
        "thermostat switches is on between two temperatures, regardless of the icing flag."
    )
    source = "FAA AC 43.13-1B, 12-37 (compass swing with electrical loads on and off)."
    needs = ("magnetic_heading",)
    parameters = (
        *OffsetAndCycle.parameters,
        Parameter("between_degC", "", 0.0, "[low, high]: on by temperature; null: by flag", None),
    )
    column_scales = np.tile(OffsetAndCycle.column_scales, 1 + len(EDGES))
    alternatives = _subsets()
    # temperatures in whole degrees blur the edges of a band by half a degree: 0.9 for a band of ten
    # degrees in simulated archives
    reliability = 0.93
    confused_with = (
        "hard_iron, compass_offset: where icing protection is on most of the time",
        "errors of airspeed in icing: along the heading, separable where headings vary",
    )

    def tied(self, subset: tuple[int, ...]) -> Floats:
        # the two edges of a band have opposite coefficients
        free = np.eye(len(subset))
        edges = {column // 3 for column in subset if column > 2}
        half = len(subset) // 2
        return free if len(edges) < 2 else free[:, :half] - free[:, half:]

    def basis(self, frame: Frame) -> Floats:
        # offset and cycle by the flag, then below each temperature, (3 + 3 m, n)
        cycle = super().basis(frame)
        on = [np.where(frame.icing == 1, 1.0, 0.0), *(_colder(frame, edge) for edge in EDGES)]
        return np.concatenate([cycle * switched for switched in on])

    def testable(self, frame: Frame) -> str | None:
        reason = super().testable(frame)
        if reason is not None:
            return reason
        by_flag = missing_context(frame, "icing") is None
        if by_flag or any(np.ptp(_colder(frame, edge)) > 0 for edge in EDGES):
            return None
        return "no icing flag that changes and no temperature on both sides of freezing"

    def error(self, frame: Frame, values: Parameters) -> Floats:
        if values["between_degC"] is None:
            if (absent := missing_context(frame, "icing", may_be_constant=True)) is not None:
                raise InputError(
                    f"effect {self.name} by the icing flag cannot be simulated",
                    field="icing",
                    found=absent,
                    remedy="Give between_degC, or reports with the flag",
                )
            on = np.where(frame.icing == 1, 1.0, 0.0)
        else:
            low, high = _edges(values)
            on = _colder(frame, high) - _colder(frame, low)
        coefficients = self.from_parameters(values, frame)
        return np.asarray(on * (coefficients @ np.nan_to_num(super().basis(frame))))

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # of the columns of the flag or of the warmest edge in use
        used = np.flatnonzero(np.reshape(coefficients, (-1, 3)).any(axis=1))
        first = int(used[0]) if used.size else 0
        block = slice(3 * first, 3 * first + 3)
        values, errors = super().to_parameters(coefficients[block], covariance[block, block], frame)
        band = None
        if first > 0:
            low = float(EDGES[int(used[1]) - 1]) if used.size > 1 else -100.0  # open
            band = [low, float(EDGES[first - 1])]
        return values | {"between_degC": band}, errors


def _colder(frame: Frame, edge: float) -> Floats:
    """Return 1 where colder than an edge (degC), 0 where warmer or unknown; linear over 1 K."""
    # temperatures are coded in steps of 1 K: a report at an edge is half on either side
    below = edge + ZERO_CELSIUS - frame.temperature + 0.5
    return np.asarray(np.nan_to_num(np.clip(below, 0.0, 1.0)))


def _edges(values: Mapping[str, object]) -> tuple[float, float]:
    # the two temperatures between which a heater is on, degC
    band = values["between_degC"]
    try:
        low, high = (number(edge) for edge in (band if isinstance(band, Iterable) else ()))
    except (TypeError, ValueError):
        low = high = np.nan
    if not low < high:
        raise InputError(
            "a band of temperatures needs two increasing numbers",
            field="between_degC",
            found=str(band),
            remedy="give [low, high] in degC",
        )
    return low, high


EFFECT = HeaterCurrent()
