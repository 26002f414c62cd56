"""gap.json: one object, written and read.

Assumes the names of docs/formats.md. A file of another version is read as far as it holds what this
one needs: keys not known here are passed over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from airswing.errors import InputError
from airswing.gap.result.schema.check_entries import (
    AliasEntry,
    AssumptionEntry,
    CalibrationPair,
    ClaimsEntry,
    KnownEntry,
    PlaceboEntry,
    SimulationEntry,
)
from airswing.gap.result.schema.entries import (
    LEFT_OUT,
    ClosureEntry,
    CountsEntry,
    DisagreementEntry,
    EffectEntry,
    EvidenceEntry,
    NoiseEntry,
    RivalEntry,
    SliceEntry,
    StepEntry,
    UnconfirmedEntry,
    UnknownEntry,
)


@dataclass(frozen=True)
class GapReport:
    """Content of gap.json.

    ``where`` holds the slices beyond chance, ``slices`` all of them; ``effects`` stand by what they
    explain on held-out reports. ``reference``, ``headings_uuid`` and ``claims`` are of a diagnosis
    of products, None of one in a notebook.
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
    unconfirmed: Sequence[UnconfirmedEntry] = ()
    waterfall: Sequence[StepEntry] = ()
    alone_kt: Sequence[float] = ()
    evidence: Sequence[EvidenceEntry] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)
    slices: Sequence[SliceEntry] = ()
    reliability: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    ambiguity: Mapping[str, Sequence[RivalEntry]] = field(default_factory=dict)
    calibration: CalibrationPair | None = None
    decoy: PlaceboEntry | None = None
    aliases: Sequence[AliasEntry] = ()
    assumptions: Sequence[AssumptionEntry] = ()
    claims: ClaimsEntry | None = None
    known: Sequence[KnownEntry] | None = field(default=None, metadata=LEFT_OUT)
    simulation: SimulationEntry | None = field(default=None, metadata=LEFT_OUT)

    def content(self) -> dict[str, object]:
        """Mappings, lists and values, as :func:`airswing.products.whole_files.write_json` takes."""
        return {str(key): value for key, value in _entries(self).items()}

    @classmethod
    def of(cls, content: Mapping[str, object]) -> GapReport:
        """Make a report of what a file holds.

        Raises
        ------
        pydantic.ValidationError
            Something is missing, or of another kind.
        """
        return TypeAdapter(cls).validate_python(content)

    @classmethod
    def read(cls, path: Path) -> GapReport:
        """Read gap.json.

        Raises
        ------
        InputError
            It is not there, is no JSON or does not hold what it should.
        """
        try:
            return TypeAdapter(cls).validate_json(path.read_bytes())
        except OSError as err:
            raise InputError("gap.json cannot be read", file=path, found=str(err)) from err
        except ValidationError as err:
            first = err.errors()[0]
            raise InputError(
                "not the result of a diagnosis",
                file=path,
                field=".".join(str(part) for part in first["loc"]),
                found=str(first["msg"]),
                remedy="run airswing gap again",
            ) from err


def _entries(entry: object) -> dict[str, object]:
    out = {}
    for one in fields(entry):  # type: ignore[arg-type]
        value = getattr(entry, one.name)
        if value is not None or not one.metadata.get("left_out"):
            out[one.name] = _plain(value)
    return out


def _plain(value: object) -> object:
    if is_dataclass(value):
        return _entries(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
