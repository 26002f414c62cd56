"""The sections of a configuration, their keys and what each may hold.

Quantities are strings with a unit ("3 h", "0.1 deg", "80 kt"); inside they are plain floats in SI
units and radians. An unknown key is refused with the nearest known one.
"""

from __future__ import annotations

import math
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from airswing.errors import InputError, nearest
from airswing.quantities import MetresPerSecond, Radians, Seconds, lead_condition, spelt_out
from airswing.units import DAY, KNOT


def _checked_lead(text: str) -> str:
    try:
        lead_condition(text)
    except InputError as err:
        raise ValueError(f"{err.what}; write {str(err.remedy).removeprefix('Write ')}") from err
    return text


Strings = Annotated[
    list[str], BeforeValidator(lambda value: [value] if isinstance(value, str) else value)
]


def _named_folder(value: object) -> object:
    # An empty path is the current directory, which a variable left unset in a script would fill.
    if isinstance(value, str) and not value.strip():
        raise ValueError("names no folder")
    return value


Folder = Annotated[Path, BeforeValidator(_named_folder)]
Phase = Literal["ascent", "cruise", "descent", "unknown"]
Platform = Literal["TAMDAR", "AMDAR", "ACARS", "AIREP"]
# A time; UTC where no zone is given.
Moment = Annotated[
    datetime,
    BeforeValidator(spelt_out),
    AfterValidator(lambda time: time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)),
]
Day = Annotated[date, BeforeValidator(spelt_out)]
# Reports that may be exported although marked by these screening rules or corrected by an offset
# only.
Screened = Literal[
    "phase",
    "turn",
    "ground_speed",
    "no_ground_vector",
    "no_reference",
    "temperature_qc",
    "field_test",
    "offset_only",
]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Reports(_Section):
    """Files of the aircraft reports and the meaning of their columns."""

    files: Strings
    format: str = "auto"
    columns: dict[str, str | list[str] | dict[str, object]] = {}
    only: dict[str, str | list[str]] = {}
    interval: Seconds = Field(0.0, ge=0, le=600.0)
    on_bad_file: Literal["skip", "fail"] = "skip"

    @property
    def mapping(self) -> dict[str, str | list[str] | dict[str, object]]:
        """Columns and the values to keep, in the form that `airswing.read_reports` accepts."""
        return {**self.columns, **{name: {"only": values} for name, values in self.only.items()}}


class Naming(_Section):
    """Names and metadata of model winds that a Dataset's attributes do not give; all optional."""

    u: str | None = None  # variables of the wind components
    v: str | None = None
    time: str | None = None  # coordinates
    level: str | None = None
    latitude: str | None = None
    longitude: str | None = None
    x: str | None = None
    y: str | None = None
    pressure: str | None = None  # variable of the pressure on native levels
    surface_pressure: str | None = None  # of hybrid levels, or its logarithm
    winds: str | None = None  # "grid" or "earth": the direction of the components
    # PROJ or WKT string, or attributes of a CF grid mapping
    projection: str | dict[str, object] | None = None
    units: dict[str, str] = {}  # by variable, if absent or wrong

    def stated(self) -> list[str]:
        """Keys that have a value."""
        return [key for key in Naming.model_fields if getattr(self, key)]

    def named(self) -> list[tuple[str, str]]:
        """Keys that name variables or coordinates, and these names."""
        keys = [key for key in self.stated() if key not in ("winds", "projection", "units")]
        return [*((key, getattr(self, key)) for key in keys), *(("units", n) for n in self.units)]


class Reference(Naming):
    """Files, lead times and ensemble member of one model's winds.

    Engine `fleet` has no files: the wind is computed from the aircraft's reports.
    """

    files: Strings = []
    engine: Literal["auto", "grib", "cfgrib", "netcdf", "zarr", "wrf", "fleet"] = "auto"
    lead: Annotated[str, AfterValidator(_checked_lead)] = "any"
    member: int | None = Field(None, ge=0, le=1_000_000)
    on_bad_file: Literal["skip", "fail"] = "skip"
    winds: Literal["grid", "earth"] | None = None

    @model_validator(mode="after")
    def _has_files(self) -> Reference:
        if bool(self.files) == (self.engine == "fleet"):
            raise ValueError("files must name the model's files; engine fleet has none")
        return self

    def naming(self) -> dict[str, object]:
        """Names and metadata of the files' variables that the configuration states."""
        return {key: getattr(self, key) for key in self.stated()}


class Collocation(_Section):
    """How model winds are collocated with the reports."""

    max_time_gap: Seconds = Field(3 * 3600.0, gt=0, le=366 * DAY)
    sparse: bool = True


class Screening(_Section):
    """Which reports the fit may use."""

    phases: list[Phase] = Field(["cruise"], min_length=1)
    roll: Literal["reject_bad", "require_good", "ignore"] = "reject_bad"
    temperature_qc: Literal["reject_fail", "require_pass", "ignore"] = "reject_fail"
    max_turn: Radians = Field(math.radians(10.0), gt=0, le=2 * math.pi)
    min_ground_speed: MetresPerSecond = Field(80 * KNOT, ge=0, le=1000.0)


class Fit(_Section):
    """How the deviation is fitted."""

    harmonics: Literal["auto", 1, 2] = "auto"  # cycles; "auto": the second where the data show it
    # argument of the curve: indicated magnetic heading, or true heading (Jacobs et al. 2010)
    abscissa: Literal["magnetic", "true"] = "magnetic"
    # fit airspeed errors jointly, with airspeed scale and reference bias; else the heading error
    joint: bool = True
    # with ``joint``, also the error of the reference that the fleet shares, as a field
    shared_error: bool = True
    min_reports: int = Field(200, ge=10, le=1_000_000_000)
    min_compass_points: int = Field(6, ge=3, le=8)


class Table(_Section):
    """The 8-point table the unit holds."""

    resolution: Radians = Field(math.radians(0.1), ge=1e-6, le=math.pi)
    sign: Literal["subtract_error", "add_error"] = "subtract_error"


class Correction(_Section):
    """How the archive's winds are corrected."""

    # the table is that of a unit in flight; the curve has no steps and allows for the local field
    method: Literal["table", "curve"] = "table"


class FieldTest(_Section):
    """A field test: corrected aircraft, controls, and dates."""

    start: Day
    before_start: Day
    end: Day | None = None
    corrected: list[str] = Field(min_length=1)
    controls: list[str] = Field(min_length=1)
    roll: Literal["reject_bad", "require_good", "ignore"] = "require_good"
    temperature_qc: Literal["reject_fail", "require_pass", "ignore"] = "require_pass"

    @model_validator(mode="after")
    def _groups_and_windows(self) -> FieldTest:
        shared = sorted(set(self.corrected) & set(self.controls))
        if shared:
            raise ValueError(f"aircraft in both groups: {', '.join(shared)}")
        if self.before_start >= self.start:
            raise ValueError("before_start must be earlier than start")
        if self.end is not None and self.end <= self.start:
            raise ValueError("end must be later than start")
        return self


class Gap(_Section):
    """Input of the gap diagnosis."""

    reference: str | None = None
    phases: list[Phase] = Field(["ascent", "cruise", "descent"], min_length=1)


class ObservationErrors(_Section):
    """Prior knowledge of the references' errors (``observation_errors.nc``)."""

    reference_covariance: float = Field(0.0, ge=-100.0, le=100.0)
    """Covariance of the errors of two references in a wind component, m2/s2."""


class Monitoring(_Section):
    """Tables with which the fleet is monitored (`airswing monitor`)."""

    tables_in_use: Path | None = None
    """Tables on board, in the format of ``tables.csv``; by default those of the first run."""


class Handover(_Section):
    """How corrected winds are exported (`airswing export`)."""

    platform: Literal["auto", Platform] = "auto"
    aircraft: dict[Platform, list[str]] = {}
    identifiers: Literal["tail", "number"] = "tail"
    accept: list[Screened] = ["phase", "field_test"]
    domain: int = Field(1, ge=1, le=9)
    base: Path | None = None
    start: Moment | None = None
    end: Moment | None = None

    @model_validator(mode="after")
    def _period_holds(self) -> Handover:
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ValueError("end must be later than start")
        return self


class ForecastTable(_Section):
    """Tables with a forecast and its observation in each line."""

    files: Strings
    columns: dict[str, str] = {}
    variable: str | None = None
    units: str | None = None


class Forecasts(_Section):
    """GRIB files with temperature at 2 m or wind at 10 m."""

    files: Strings


class Stations(_Section):
    """Tables of station observations."""

    files: Strings
    columns: dict[str, str] = {}
    max_time_gap: Seconds = Field(1800.0, ge=0, le=366 * DAY)


class FlightLevelWinds(_Section):
    """Model winds of the main job paired with its corrected winds, by box, layer and day."""

    reference: str | None = None
    region: Radians = Field(math.radians(5.0), gt=math.radians(0.1), le=math.radians(90.0))
    fewest: int = Field(10, ge=1)


class Postprocess(_Section):
    """Forecasts to correct after the fact, and how."""

    pairs: ForecastTable | None = None
    forecasts: Forecasts | None = None
    stations: Stations | None = None
    winds: FlightLevelWinds | None = None
    ratio: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"
    training: float = Field(0.5, gt=0, lt=1)
    running_mean: int = Field(7, ge=1, le=100_000)

    @model_validator(mode="after")
    def _one_source(self) -> Postprocess:
        if (self.forecasts is None) != (self.stations is None):
            missing = "stations" if self.stations is None else "forecasts"
            raise ValueError(f"forecasts and stations go together: {missing} is missing")
        if sum(source is not None for source in (self.pairs, self.forecasts, self.winds)) != 1:
            raise ValueError("give one of pairs, forecasts with stations, and winds")
        return self


class Metadata(_Section):
    """Global attributes of every product (ACDD 1.3) that only the user can state."""

    creator_name: str | None = None
    creator_email: str | None = None
    creator_url: str | None = None
    institution: str | None = None
    project: str | None = None
    license: str | None = None


class Compute(_Section):
    """Computing resources of a run."""

    workers: Annotated[int, Field(ge=1, le=4096)] | Literal["auto"] = "auto"
    threads: Annotated[int, Field(ge=1, le=4096)] | Literal["auto"] = "auto"
    scheduler: str | None = None


class Config(_Section):
    """Everything one run needs; docs/formats.md has the meaning of each key."""

    reports: Reports
    references: dict[str, Reference] = Field(min_length=1)
    pool: dict[str, list[str]] = {}
    never_pool: list[str] = ["nam"]
    collocation: Collocation = Collocation()
    screening: Screening = Screening()
    fit: Fit = Fit()
    table: Table = Table()
    correction: Correction = Correction()
    field_test: FieldTest | None = None
    gap: Gap = Gap()
    observation_errors: ObservationErrors = ObservationErrors()
    monitoring: Monitoring = Monitoring()
    handover: Handover = Handover()
    postprocess: Postprocess | None = None
    metadata: Metadata = Metadata()
    output: Folder
    compute: Compute = Compute()

    @model_validator(mode="after")
    def _pools_hold(self) -> Config:
        for name, members in self.pool.items():
            unknown = [member for member in members if member not in self.references]
            if unknown:
                near = nearest(unknown[0], list(self.references))
                raise ValueError(f"pool.{name}: no reference {unknown[0]!r}{near}")
            if name in self.references:
                raise ValueError(f"pool.{name}: a reference has the same name")
            if len(set(members)) < max(2, len(members)):
                raise ValueError(f"pool.{name}: a pool needs at least two references, each once")
            never = {name.lower() for name in self.never_pool}
            barred = [member for member in members if member.lower() in never]
            if barred:
                raise ValueError(
                    f"pool.{name}: {barred[0]!r} is in never_pool and may be compared, not pooled"
                )
        names = [*self.references, *self.pool]
        if self.gap.reference is not None and self.gap.reference not in names:
            near = nearest(self.gap.reference, names)
            raise ValueError(f"gap.reference: no reference or pool {self.gap.reference!r}{near}")
        return self

    def pools(self) -> dict[str, list[str]]:
        """Every single reference and every pool, with its members."""
        return {name: [name] for name in self.references} | self.pool

    def main_reference(self) -> str:
        """Reference or pool of the correction and the cards: the first pool, else the first."""
        return next(iter([*self.pool, *self.references]))

    def gap_reference(self) -> str:
        """Reference or pool the gap is measured against."""
        return self.gap.reference or self.main_reference()


class PostprocessConfig(_Section):
    """A configuration that only corrects forecasts."""

    postprocess: Postprocess
    output: Folder
    compute: Compute = Compute()
