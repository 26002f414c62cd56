"""What happened to the reports on the way in: counts per reason, and files left out.

Assumes that every report read is either kept or dropped for exactly one reason, so
``reports_read = reports_kept + sum(dropped)`` holds at any time; a kept report may have been
repaired for several reasons.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np


class AuditContent(TypedDict, total=False):
    """A tally as it stands beside the reports; the counts of :class:`Audit` by name."""

    reports_read: int
    reports_kept: int
    dropped: dict[str, int]
    repaired: dict[str, int]
    missing: dict[str, int]
    flags: dict[str, dict[str, int]]
    formats: dict[str, int]
    files: int  # of all formats
    files_skipped: list[dict[str, str]]
    examples: dict[str, str]
    similar_tails: list[list[str]]


@dataclass
class Audit:
    """Running tally of one reading."""

    read: int = 0  # reports met, whole or broken
    # Reports left out; values set right or set missing in reports that stay; both per reason.
    dropped: Counter[str] = field(default_factory=Counter)
    repaired: Counter[str] = field(default_factory=Counter)
    # Reports that stay without a value, per variable.
    missing: Counter[str] = field(default_factory=Counter)
    # Codes met, per flag field of the source.
    flags: dict[str, Counter[str]] = field(default_factory=dict)
    formats: Counter[str] = field(default_factory=Counter)  # files read, per format
    files_skipped: list[dict[str, str]] = field(default_factory=list)  # each file and reason
    # The first value met that could not be read, per reason.
    examples: dict[str, str] = field(default_factory=dict)
    # Aircraft whose identifiers differ only in case or blanks; kept apart.
    similar_tails: list[list[str]] = field(default_factory=list)

    @property
    def kept(self) -> int:
        """Reports read less reports dropped."""
        return self.read - sum(self.dropped.values())

    def drop(self, reason: str, number: int) -> None:
        """Count reports left out."""
        if number:
            self.dropped[reason] += int(number)

    def repair(self, reason: str, number: int) -> None:
        """Count values set right or set missing."""
        if number:
            self.repaired[reason] += int(number)

    def example(self, reason: str, value: object) -> None:
        """Keep the first value met that could not be read."""
        plain = value.item() if isinstance(value, np.generic) else value
        self.examples.setdefault(reason, repr(plain)[:60])

    def codes(self, name: str, tally: Mapping[str, int]) -> None:
        """Add the number of reports per code met in one flag field of the source."""
        self.flags.setdefault(name, Counter()).update(tally)

    def as_dict(self) -> AuditContent:
        """Plain form of the tally."""
        return {
            "reports_read": self.read,
            "reports_kept": self.kept,
            "dropped": dict(sorted(self.dropped.items())),
            "repaired": dict(sorted(self.repaired.items())),
            "missing": dict(sorted(self.missing.items())),
            "flags": {name: dict(sorted(tally.items())) for name, tally in self.flags.items()},
            "formats": dict(sorted(self.formats.items())),
            "files": sum(self.formats.values()),
            "files_skipped": self.files_skipped,
            "examples": self.examples,
            "similar_tails": self.similar_tails,
        }

    def as_json(self) -> str:
        """Return :meth:`as_dict` as JSON: NetCDF attributes cannot hold dicts."""
        return json.dumps(self.as_dict())

    @classmethod
    def from_dict(cls, content: AuditContent) -> Audit:
        """Undo :meth:`as_dict`."""
        return cls(
            read=content["reports_read"],
            dropped=Counter(content["dropped"]),
            repaired=Counter(content["repaired"]),
            missing=Counter(content["missing"]),
            flags={name: Counter(tally) for name, tally in content["flags"].items()},
            formats=Counter(content["formats"]),
            files_skipped=list(content["files_skipped"]),
            examples=dict(content["examples"]),
            similar_tails=[list(group) for group in content.get("similar_tails", [])],
        )

    def add(self, other: Audit) -> None:
        """Add another tally, such as one file's."""
        self.read += other.read
        self.dropped += other.dropped
        self.repaired += other.repaired
        self.missing += other.missing
        self.formats += other.formats
        for name, tally in other.flags.items():
            self.codes(name, tally)
        self.files_skipped += other.files_skipped
        self.examples = other.examples | self.examples
        self.similar_tails += other.similar_tails


def similar(tails: Iterable[str]) -> list[list[str]]:
    """Identifiers that differ only in case or blanks: groups of two and more, in order of name."""
    groups: dict[str, list[str]] = {}
    for tail in sorted(tails):
        groups.setdefault("".join(tail.split()).casefold(), []).append(tail)
    return [group for group in groups.values() if len(group) > 1]
