"""gap.json as dataclasses: the diagnosis writes them, the page and the blind check read them.

Names and units are those of docs/formats.md: kt for disagreement and closure, m s-1 for sizes and
curves, degrees, parameters as in the catalogue. A number that is not known is NaN here and null in
the file; a field marked `LEFT_OUT` is not in the file where it is None. Keys of a file that are not
known here are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from airswing.errors import InputError

#: A number that may be unknown.
Number = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]
#: Value of an effect's parameter; a range is its two ends, a pair its two aircraft.
Parameter = bool | int | float | str | list[str] | list[float] | None
#: First and last date, ISO 8601; null at the archive's ends.
Period = list[str | None]

#: Metadata of a field that is left out of the file where it is None.
LEFT_OUT = {"left_out": True}


@dataclass(frozen=True)
class DisagreementEntry:
    """Mean vector disagreement, noise floor, and probability of the effects by chance."""

    mean_vector_disagreement_kt: float
    noise_floor_kt: float
    significance: float


@dataclass(frozen=True)
class CurveEntry:
    """Coefficients of a nonparametric fit, m s-1; of a table also its edges and values.

    ``edges`` holds the bounds of the cells of each variable, ``values`` the cells in C order in
    ``unit``; ``per_tail`` the values of each aircraft where they differ.
    """

    labels: Sequence[str]
    m_s: Sequence[Number]
    unit: str | None = field(default=None, metadata=LEFT_OUT)
    variables: Sequence[str] | None = field(default=None, metadata=LEFT_OUT)
    variable_units: Sequence[str] | None = field(default=None, metadata=LEFT_OUT)
    edges: Sequence[Sequence[float]] | None = field(default=None, metadata=LEFT_OUT)
    values: Sequence[Number] | None = field(default=None, metadata=LEFT_OUT)
    per_tail: Mapping[str, Sequence[Number]] | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class SliceEntry:
    """A slice of the archive and the share of the gap's energy it holds, 0 to 1."""

    variable: str
    component: str
    values: Sequence[str]
    share_of_gap: float
    q_value: Number
    p_value: Number
    energy: Number
    group: str
    curve: CurveEntry


@dataclass(frozen=True)
class ClosesEntry:
    """Closure of an effect on held-out reports, kt, with its 95 % interval."""

    reduction: float
    reduction_ci: Sequence[float]


@dataclass(frozen=True)
class RivalEntry:
    """An effect that cannot be distinguished from a stated one, and data that would separate them.

    ``difference_nats`` is the log Bayes factor against it; None where the columns are equal.
    """

    name: str
    difference_nats: float | None
    separated_by: str


@dataclass(frozen=True)
class TailEntry:
    """Parameters of an effect on one aircraft."""

    parameters: Mapping[str, Parameter]
    standard_errors: Mapping[str, Number] | None = field(default=None, metadata=LEFT_OUT)
    period: Sequence[str | None] | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class EffectEntry:
    """A diagnosed effect of the catalogue.

    ``parameters`` are medians over aircraft where ``per_tail`` has several. ``closure`` is in
    addition to that of the effects before it. ``by_reference`` holds the parameters of an effect
    of the reference against the pool and against each of its members that has it; where one alone
    has it, ``reference`` names it and ``parameters`` are those against it.
    """

    name: str
    probability: float
    tails: Sequence[str]
    parameters: Mapping[str, Parameter]
    standard_errors: Mapping[str, Number]
    period: Period | None
    scope: str
    evidence_nats: float
    cluster_factor: float = 1.0
    size_m_s: float = 0.0
    per_tail: Mapping[str, TailEntry] | None = field(default=None, metadata=LEFT_OUT)
    reference: str | None = field(default=None, metadata=LEFT_OUT)
    by_reference: Mapping[str, TailEntry] | None = field(default=None, metadata=LEFT_OUT)
    ambiguous_with: Sequence[str] = ()
    ambiguity: Sequence[RivalEntry] = ()
    share_of_gap: float = 0.0
    closure: ClosesEntry | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class StepsEntry:
    """Steps in which the directions of winds up to a speed are sent, by a share of the reports."""

    step_deg: float
    up_to_kt: float
    share: float


@dataclass(frozen=True)
class PlaceEntry:
    """An effect outside the catalogue; of the whole fleet where ``tails`` is empty."""

    component: str
    variable: str
    variables: Sequence[str]
    group: str
    tails: Sequence[str]
    scope: str
    evidence_nats: float
    size_m_s: float
    curve: CurveEntry
    closure: ClosesEntry | None = None
    probability: float | None = None
    nearest_effect: str | None = None
    nearest_effect_share: float | None = None
    settled_by: str | None = None
    steps: StepsEntry | None = field(default=None, metadata=LEFT_OUT)
    title: str | None = field(default=None, metadata=LEFT_OUT)  # shape of the error, in words
    period: Period | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class UnknownClosureEntry:
    """Closure of all unknowns in addition to the named effects, kt."""

    before: float
    after: float
    reduction: float
    reduction_ci: Sequence[float]


@dataclass(frozen=True)
class UnknownEntry:
    """Effects outside the catalogue."""

    present: bool
    where: Sequence[PlaceEntry]
    closure: UnknownClosureEntry | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class EffectClosureEntry:
    """Closure of one claim in addition to the claims before it, kt, with its 95 % interval."""

    name: str
    reduction: float
    reduction_ci: Sequence[float]


@dataclass(frozen=True)
class ClosureEntry:
    """Disagreement on held-out reports without and with the effects, kt; intervals of 95 %.

    ``could_hide_kt``: largest closure by an error outside the catalogue that is not stated.
    """

    before: float
    after: float
    ci: Sequence[float] | None
    fraction_of_excess: float | None
    held_out: bool
    reduction: float
    reduction_ci: Sequence[float] | None
    could_hide_kt: float | None = field(default=None, metadata=LEFT_OUT)
    by_effect: Sequence[EffectClosureEntry] | None = field(default=None, metadata=LEFT_OUT)


@dataclass(frozen=True)
class StepEntry:
    """Disagreement after a step of the waterfall, kt, and the interval of its closure."""

    label: str
    kt: float
    step_ci: Sequence[float] | None


@dataclass(frozen=True)
class EvidenceEntry:
    """Evidence of one candidate in place of a term, or (None) in addition to all terms."""

    instead_of: str | None
    name: str
    scope: str
    known: bool
    subset: Sequence[int]
    evidence_nats: Number
    posterior: Sequence[Number]


@dataclass(frozen=True)
class NoiseEntry:
    """The fitted noise model, and the measured autocovariance, m2 s-2."""

    correlated_sd_m_s: float
    white_sd_m_s: float
    length_km: float
    height_ln_p: float
    level_hPa: Sequence[float]  # noqa: N815  (the unit as in the file)
    level_factor: Sequence[float]
    day_field_sd_m_s: Sequence[Number]
    climatology_sd_m_s: Sequence[Number]
    distance_km: Sequence[Number]
    autocovariance: Sequence[Number]
    autocovariance_model: Sequence[Number]
    # factors of errors along and across the heading, their mean square 1
    along_heading: float = 1.0
    across_heading: float = 1.0


@dataclass(frozen=True)
class CountsEntry:
    """Numbers of reports, flights, days and aircraft of a diagnosis."""

    reports: int
    flights: int
    days: int
    gross: float
    aircraft: int = 0


@dataclass(frozen=True)
class CalibrationEntry:
    """Agreement of held-out reports with their prediction; NaN where it is not known."""

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
    """Closure by an effect that cannot exist, kt."""

    reduction_kt: Number
    reduction_ci_kt: Sequence[Number]
    reduction_where_fitted_kt: Number
    draws: int
    closes_nothing: bool


@dataclass(frozen=True)
class AliasEntry:
    """Two effects whose columns share energy, and data that would separate them."""

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
    """A fitted deviation before and after the other effects are removed, degrees.

    ``stays``: both within 1.96 standard errors of before; None where a fit is not accepted.
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
    """Fits and field test before and after the other effects are removed."""

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


@dataclass(frozen=True)
class GapReport:
    """Content of gap.json.

    ``where`` holds the significant slices, ``slices`` all of them; ``effects`` are in the order of
    their share of the gap. ``reference``, ``headings_uuid`` and ``claims`` are None of a diagnosis
    in a notebook.
    """

    gap: DisagreementEntry
    where: Sequence[SliceEntry]
    effects: Sequence[EffectEntry]
    unknown: UnknownEntry
    closure: ClosureEntry
    counts: CountsEntry
    noise: NoiseEntry
    reference: str | None = None
    headings_uuid: str | None = None
    waterfall: Sequence[StepEntry] = ()
    evidence: Sequence[EvidenceEntry] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)
    slices: Sequence[SliceEntry] = ()
    seed: int = 0
    ambiguity: Mapping[str, Sequence[RivalEntry]] = field(default_factory=dict)
    calibration: CalibrationPair | None = None
    placebo: PlaceboEntry | None = None
    aliases: Sequence[AliasEntry] = ()
    assumptions: Sequence[AssumptionEntry] = ()
    claims: ClaimsEntry | None = None
    known: Sequence[KnownEntry] | None = field(default=None, metadata=LEFT_OUT)
    simulation: SimulationEntry | None = field(default=None, metadata=LEFT_OUT)

    def content(self) -> dict[str, object]:
        """Mappings, lists and values, as :func:`airswing.products.whole_files.write_json` takes."""
        return dict(_as_json(self))

    @classmethod
    def read(cls, path: Path) -> GapReport:
        """Read gap.json; InputError where it is not valid."""
        try:
            return TypeAdapter(cls).validate_json(path.read_bytes())
        except OSError as err:
            raise InputError("gap.json cannot be read", file=path, found=str(err)) from err
        except ValidationError as err:
            first = err.errors()[0]
            raise InputError(
                "not the result of a diagnosis",
                file=path,
                field=".".join(str(key) for key in first["loc"]),
                found=str(first["msg"]),
                remedy="run airswing gap again",
            ) from err


def _as_json(value: object) -> Any:
    if is_dataclass(value):
        entries = [(f, getattr(value, f.name)) for f in fields(value)]
        return {
            f.name: _as_json(item)
            for f, item in entries
            if item is not None or not f.metadata.get("left_out")
        }
    if isinstance(value, Mapping):
        return {key: _as_json(item) for key, item in value.items()}
    return [_as_json(item) for item in value] if isinstance(value, list | tuple) else value
