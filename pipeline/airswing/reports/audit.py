"""Counts of reports kept, dropped and repaired during reading.

Each report read is kept or dropped for one reason: ``reports_read = reports_kept + sum(dropped)``.
A kept report may have been repaired for several reasons.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, SupportsInt

import numpy as np

AuditContent = dict[str, Any]  # plain form of an :class:`Audit`, as stored in ``reading_audit``
_COUNTERS = ("dropped", "repaired", "missing", "formats")
_OTHERS = ("files_skipped", "examples", "mistakes", "similar_tails", "remarks")
_LARGE_SHARE = 0.5  # share of the reports above which a note states the missing values


@dataclass
class Audit:
    """Counts of one reading."""

    read: int = 0  # reports in the files, damaged ones included
    dropped: Counter[str] = field(default_factory=Counter)  # reports left out, by reason
    # values of kept reports corrected or set missing, by reason
    repaired: Counter[str] = field(default_factory=Counter)
    missing: Counter[str] = field(default_factory=Counter)  # kept reports without a variable
    # codes that occurred, by flag field of the source
    flags: dict[str, Counter[str]] = field(default_factory=dict)
    formats: Counter[str] = field(default_factory=Counter)  # files read, by format
    files_skipped: list[dict[str, str]] = field(default_factory=list)  # ``file`` and ``reason``
    examples: dict[str, str] = field(default_factory=dict)  # first unreadable value, by column
    # likely mistake of the unit of a quantity of which most values are impossible
    mistakes: dict[str, str] = field(default_factory=dict)
    # aircraft identifiers that differ only in case or blanks; they are kept apart
    similar_tails: list[list[str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)  # sentences of the readers for the user

    @property
    def usable(self) -> int:
        """Number of reports read minus number dropped."""
        return self.read - sum(self.dropped.values())

    def drop(self, reason: str, number: SupportsInt, *, unread: bool = False) -> None:
        """Count reports left out; ``unread`` ones are not yet counted in ``read``."""
        self.read += int(number) if unread else 0
        if int(number):
            self.dropped[reason] += int(number)

    def repair(self, reason: str, number: SupportsInt) -> None:
        """Count values corrected or set missing."""
        if int(number):
            self.repaired[reason] += int(number)

    def example(self, column: str, value: object) -> None:
        """Keep the first value of a column that could not be read."""
        scalar = value.item() if isinstance(value, np.generic) else value
        self.examples.setdefault(column, repr(scalar)[:60])

    def remark(self, *sentences: str) -> None:
        """Add sentences that a user should see, each once."""
        self.remarks = list(dict.fromkeys([*self.remarks, *sentences]))

    def codes(self, name: str, counts: Mapping[str, int]) -> None:
        """Add the number of reports of each code of one flag field."""
        self.flags.setdefault(name, Counter()).update(counts)

    def likely(self, name: str) -> str:
        """Return the likely mistake of a quantity in brackets, or nothing."""
        return f" ({self.mistakes[name]})" if name in self.mistakes else ""

    def notes(self) -> list[str]:
        """Sentences that a user should see beyond the counts of dropped reports."""
        notes, total = list(self.remarks), self.usable
        absent = self.missing["eastward_wind"]
        if absent >= total > 0:
            notes.append(f"none of the {total:,} reports has a wind")
        elif absent > _LARGE_SHARE * total:
            notes.append(f"only {total - absent:,} of the {total:,} reports have a wind")
        for reason, number in sorted(self.repaired.items()):
            name, out_of_range, _ = reason.partition("_out_of_range")
            if out_of_range and number > _LARGE_SHARE * total:
                cause = "a column it is derived from" if name == "derived_wind" else "its column"
                notes.append(
                    f"{number:,} of the {total:,} values of {name} are impossible and are not "
                    f"used: the unit of {cause} is likely another{self.likely(name)}"
                )
        if flights := self.repaired["same_identifier_at_two_places"]:
            notes.append(
                f"two aircraft seem to share one identifier in {flights:,} reports: they are "
                "separated by callsign and position, and numbered from west to east "
                "(TAIL-1, TAIL-2)"
            )
        return notes

    def as_dict(self) -> AuditContent:
        """Plain form of the counts."""
        return {
            "reports_read": self.read,
            "reports_kept": self.usable,
            **{name: dict(sorted(getattr(self, name).items())) for name in _COUNTERS},
            "flags": {name: dict(sorted(counts.items())) for name, counts in self.flags.items()},
            "files": sum(self.formats.values()),
            **{name: getattr(self, name) for name in _OTHERS},
            "notes": self.notes(),
        }

    def as_json(self) -> str:
        """Return :meth:`as_dict` as JSON, because NetCDF attributes cannot hold a dict."""
        return json.dumps(self.as_dict())

    @classmethod
    def from_dict(cls, content: AuditContent) -> Audit:
        """Make an audit of its plain form."""
        audit = cls(content["reports_read"])
        audit.flags = {name: Counter(counts) for name, counts in content["flags"].items()}
        for name in (*_COUNTERS, *_OTHERS):
            setattr(audit, name, type(getattr(audit, name))(content.get(name, ())))
        return audit

    def add(self, audit: Audit) -> None:
        """Add the counts of another audit, such as that of one file."""
        self.read += audit.read
        for name in _COUNTERS:
            getattr(self, name).update(getattr(audit, name))
        for name, counts in audit.flags.items():
            self.codes(name, counts)
        self.files_skipped += audit.files_skipped
        self.examples = audit.examples | self.examples
        self.mistakes = audit.mistakes | self.mistakes
        self.similar_tails += audit.similar_tails
        self.remark(*audit.remarks)


def similar(tails: Iterable[str]) -> list[list[str]]:
    """Groups of identifiers that differ only in case or blanks, in alphabetical order."""
    groups: dict[str, list[str]] = {}
    for tail in sorted(tails):
        groups.setdefault("".join(tail.split()).casefold(), []).append(tail)
    return [group for group in groups.values() if len(group) > 1]
