"""What the evaluation's JSON files hold, key by key, for who writes them and who shows them.

Assumes the files of docs/formats.md. Disagreements and gains in knots of mean wind vector
disagreement, winds in m/s, angles in degrees; ``*_ci*`` are the two ends of a 95 % interval.
"""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict, final

import numpy as np
from numpy.typing import NDArray

Component = Literal["eastward", "northward"]


class Change(TypedDict):
    """A change of a compass; degrees."""

    date: str  # first day of the new compass
    date_ci: list[str]
    # change_deg, standard_error_deg: of A, B, C
    change_deg: dict[str, float]
    standard_error_deg: dict[str, float]
    curve_rms_deg: float
    p_value: float


class AircraftChanges(TypedDict):
    """All changes of one aircraft."""

    aircraft: str
    days: int
    # p_value, statistic: of the largest; None with too few days
    p_value: float | None
    statistic: float | None
    changes: list[Change]


class Ranked(TypedDict):
    """One aircraft of the ranking; without a fit to be trusted there is ``why`` and no gain."""

    rank: int | None
    aircraft: str
    status: str
    reports: int
    disagreement_kt: NotRequired[float]
    expected_gain_kt: float | None
    expected_gain_ci_kt: NotRequired[list[float]]
    expected_gain_standard_error_kt: NotRequired[float]
    amplitude_deg: NotRequired[float]
    rank_ci: NotRequired[list[int]]
    why: NotRequired[str]


class Group(TypedDict):
    """One group of a field test, before it and during it."""

    aircraft: int
    before_kt: float
    during_kt: float
    reduction_kt: float
    reduction_ci_kt: list[float]
    before_ci_kt: list[float]
    during_ci_kt: list[float]
    reports_before: int
    reports_during: int


class Headline(TypedDict):
    """Groups and reductions of a field test against one reference."""

    groups: dict[str, Group]
    adjusted_reduction_kt: float
    adjusted_reduction_ci_kt: list[float]
    adjusted_reduction_quadrature_kt: float
    adjusted_reduction_quadrature_ci_kt: list[float]
    days_before: int
    days_during: int


class Permutation(TypedDict):
    """The effect among groups drawn by lot."""

    # effect_kt, p_value: not a number where the groups tell nothing apart
    effect_kt: float
    p_value: float
    p_value_unconditional: float
    draws: int
    null_effects_kt: NDArray[np.float64] | list[float]


class Spurious(TypedDict):
    """What the same choice of aircraft gains where nothing was corrected."""

    spurious_reduction_kt: float | None
    rule: NotRequired[str]
    why: NotRequired[str]


class Matched(TypedDict):
    """Each corrected aircraft against the control nearest to it before the test."""

    adjusted_reduction_kt: float | None
    mean_distance_kt: NotRequired[float]


class Levels(TypedDict):
    """One aircraft's disagreement before and during the test; not a number without a report."""

    aircraft: str
    group: Literal["corrected", "controls"]
    before_kt: float
    during_kt: float


class Scrutiny(TypedDict):
    """Whether a reduction is the correction's, or the choice of aircraft and luck."""

    permutation: Permutation
    regression_to_the_mean: Spurious
    matched_controls: Matched
    by_aircraft: list[Levels]


class Expected(TypedDict):
    """What the fits before a field test expected of it."""

    ranking: list[Ranked]
    predicted_reduction_kt: float | None
    predicted_reduction_ci_kt: list[float] | None
    predicted_aircraft: int


class FieldTestFound(Headline, Scrutiny):
    """A field test: the headline against the main reference, and all that judges it."""

    reference: str
    start: str
    before_start: str
    end: str | None
    notes: list[str]
    # group -> window -> measure of disagreement, m/s
    components: dict[str, dict[str, dict[str, float]]]
    by_reference: dict[str, Headline]


class FieldTestContent(FieldTestFound, Expected):
    """``field_test.json``: what was found, and what was expected."""


class SideBySide(TypedDict):
    """Gain predicted from the fit alone and gain realised; ``agree`` None if none can tell."""

    predicted_gain_kt: float
    predicted_standard_error_kt: float
    predicted_gain_ci_kt: list[float]
    realised_gain_kt: float
    realised_gain_ci_kt: list[float]
    difference_kt: float
    difference_ci_kt: list[float]
    agree: bool | None


class AircraftGain(SideBySide):
    """The same of one aircraft."""

    aircraft: str
    reports: int


class Compared(TypedDict):
    """The same of all aircraft together; the two gains None where nothing could be judged."""

    predicted_gain_kt: float | None
    predicted_standard_error_kt: NotRequired[float]
    predicted_gain_ci_kt: NotRequired[list[float]]
    realised_gain_kt: float | None
    realised_gain_ci_kt: NotRequired[list[float]]
    difference_kt: NotRequired[float]
    difference_ci_kt: NotRequired[list[float]]
    agree: NotRequired[bool | None]
    reports: NotRequired[int]
    by_aircraft: list[AircraftGain]


class VirtualGroup(TypedDict):
    """One group of a virtual field test, before and after the date learned up to."""

    aircraft: int
    before_kt: float
    during_kt: float
    during_uncorrected_kt: float
    reduction_kt: float
    reports_before: int
    reports_during: int


@final
class VirtualTest(Compared):
    """Corrections learned up to a date and judged on the reports after it."""

    reference: str
    learned_until: str
    method: str
    groups: dict[str, VirtualGroup]


@final
class CrossValidation(Compared):
    """Every flight judged by corrections that never saw it."""

    reference: str
    folds: int
    method: str
    in_sample_gain_kt: float


@final
class NotTried(TypedDict):
    """What the archive could not carry."""

    why: str


class VirtualContent(TypedDict):
    """``virtual_field_test.json``."""

    later: VirtualTest | NotTried
    held_out: CrossValidation | NotTried


class Difference(TypedDict):
    """Difference of one quantity, first reference minus second, degrees."""

    difference: float
    standard_error: float
    ci: list[float]


class AircraftDifference(TypedDict):
    """One aircraft between two references; coefficients A to E in degrees."""

    p_value: float
    difference: dict[str, float]
    standard_error: dict[str, float]
    ci: dict[str, list[float]]
    aircraft: NotRequired[str]
    offset: NotRequired[Difference]
    amplitude: NotRequired[Difference]
    phase: NotRequired[Difference]


class FleetDifference(TypedDict):
    """What the fleet has in common between two references; not a number without a report."""

    aircraft: int
    difference: NotRequired[dict[str, float]]
    standard_error: NotRequired[dict[str, float]]
    curve_rms_deg: float
    p_value: float


class Region(TypedDict):
    """Mean difference of a wind component in a region, and against the other regions, m/s."""

    region: int
    component: Component
    days: int
    difference: float
    difference_standard_error: float
    difference_p_value: float
    difference_adjusted_p_value: NotRequired[float]
    # None with one region, or too few days that others share
    contrast: float | None
    contrast_p_value: float | None
    contrast_standard_error: NotRequired[float]
    contrast_adjusted_p_value: NotRequired[float]


class Verdict(TypedDict):
    """Whether two references may be pooled; None where it cannot be told."""

    poolable: bool | None
    why: str


class Pair(Verdict):
    """Two references on the same reports; a slice of them has its name and no single aircraft."""

    slice: NotRequired[str]
    references: list[str]
    reports: int
    mean_vector_difference_m_s: float
    fleet: FleetDifference
    aircraft: NotRequired[list[AircraftDifference]]
    regions: list[Region]
    own_test: bool


class Corner(TypedDict):
    """A reference's own error of a wind component, m/s; None where the variance is negative."""

    reference: str
    variance: float
    variance_standard_error: float
    component_rms: float | None


class Hat(TypedDict):
    """The three-cornered hat of three references."""

    references: list[str]
    reports: int
    errors: list[Corner]


class IntervalCost(TypedDict):
    """What model winds every so many hours cost against hourly ones, m/s."""

    interval_h: int
    reports: int
    rms_vector_difference_m_s: float | None
    reports_at_middle: int
    rms_vector_difference_at_middle_m_s: float | None


class Strata(TypedDict):
    """Pairs of references judged within slices of the reports."""

    by_lead_time: list[Pair]
    by_phase: list[Pair]
    by_level: list[Pair]
    by_season: list[Pair]


class SensitivityContent(TypedDict, total=False):
    """``sensitivity.json``; of one reference alone there is but ``time_interval``."""

    reports: int
    references: list[str]
    pairs: list[Pair]
    # of :class:`Strata`
    by_lead_time: list[Pair]
    by_phase: list[Pair]
    by_level: list[Pair]
    by_season: list[Pair]
    three_way: list[Hat]
    time_interval: dict[str, list[IntervalCost]]


class WindowFit(TypedDict):
    """The fit of one aircraft in one window of the calendar, degrees; the numbers if published."""

    aircraft: str
    window: str
    reports: int
    status: str
    offset: NotRequired[float]
    offset_standard_error: NotRequired[float]
    amplitude: NotRequired[float]
    amplitude_standard_error: NotRequired[float]
    phase: NotRequired[float]
    phase_standard_error: NotRequired[float]
    A: NotRequired[float]
    A_standard_error: NotRequired[float]
    B: NotRequired[float]
    B_standard_error: NotRequired[float]
    C: NotRequired[float]
    C_standard_error: NotRequired[float]
    D: NotRequired[float]
    D_standard_error: NotRequired[float]
    E: NotRequired[float]
    E_standard_error: NotRequired[float]


class StabilityContent(TypedDict):
    """``stability.json``."""

    reference: str
    window: str
    changes: list[AircraftChanges]
    windows: list[WindowFit]
