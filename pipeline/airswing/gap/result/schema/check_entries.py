"""Entries of gap.json on what a diagnosis rests on and what it started from.

Units: kt, degrees, m s-1, as the names say. A number that is not known is NaN here and null in the
file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from airswing.gap.result.schema.entries import LEFT_OUT, Number


@dataclass(frozen=True)
class CalibrationEntry:
    """How held-out reports keep to what was predicted for them; NaN where it is not known."""

    crps_m_s: Number
    crps_expected_m_s: Number
    spread: Number
    lag_one: Number
    lag_one_standard_error: Number
    auc: Number
    auc_standard_error: Number


@dataclass(frozen=True)
class CalibrationPair:
    """Calibration with the effects in the simulation, and without."""

    after: CalibrationEntry
    before: CalibrationEntry


@dataclass(frozen=True)
class PlaceboEntry:
    """What a cause that cannot be at work closes, kt."""

    reduction_kt: Number
    reduction_ci_kt: Sequence[Number]
    reduction_where_fitted_kt: Number
    draws: int
    closes_nothing: bool


@dataclass(frozen=True)
class AliasEntry:
    """Two effects whose columns share energy on these flights, 0 to 1, and what would tell them."""

    effect: str
    other: str
    alias_share: float
    separated_by: str


@dataclass(frozen=True)
class AssumptionEntry:
    """An assumption, how it is checked, the result in words, and whether it holds."""

    assumption: str
    check: str
    result: str
    ok: bool


@dataclass(frozen=True)
class FitEntry:
    """A fitted deviation before and after the other effects are taken off, degrees.

    ``stays``: both within 1.96 standard errors of before; None where a fit is not to be trusted.
    """

    aircraft: str
    offset_deg: Number
    offset_deg_after: Number
    offset_deg_standard_error: Number
    amplitude_deg: Number
    amplitude_deg_after: Number
    amplitude_deg_standard_error: Number
    stays: bool | None


@dataclass(frozen=True)
class FieldTestEntry:
    """Adjusted reduction of the field test before and after, kt."""

    reduction_kt: Number
    reduction_ci_kt: Sequence[Number]
    reduction_kt_after: Number
    stays: bool


@dataclass(frozen=True)
class ClaimsEntry:
    """What of the fits and the field test stays with the other effects taken off."""

    taken_off: Sequence[str]
    aircraft: Sequence[FitEntry] = ()
    stay: int = 0
    of: int = 0
    field_test: FieldTestEntry | None = None


@dataclass(frozen=True)
class KnownEntry:
    """Known effects that were removed from the reports; ``effects`` as in effects.yaml."""

    source: str
    effects: Sequence[Mapping[str, object]]
    left_out: int
    disagreement_without_kt: float
    disagreement_with_kt: float


@dataclass(frozen=True)
class SimulationEntry:
    """A simulation in place of the perfect instrument, and how its reports were matched."""

    source: str
    reports: int
    matched: int
    of: int
    matched_by: str
    aircraft_in_both: Sequence[str] | None = field(default=None, metadata=LEFT_OUT)
