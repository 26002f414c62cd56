"""States of the aircraft and what happened to them, and their file ``events.json``.

One schema: what :func:`write_events` writes, :func:`read_events` reads. Days are UTC dates, angles
degrees, winds knots.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

from airswing.errors import InputError
from airswing.products.whole_files import write_json

VERSION = 1
NAMED = 20
"""Aircraft of a list that are named; the file names all."""
Kind = Literal[
    "compass_changed",
    "disagreement_rose",
    "aircraft_new",
    "aircraft_silent",
    "reference_changed",
]
WORDS: dict[str, str] = {
    "compass_changed": "compass changed",
    "disagreement_rose": "disagreement rose",
    "aircraft_new": "new aircraft",
    "aircraft_silent": "silent",
    "reference_changed": "reference changed for all at once",
}


class Evidence(TypedDict, total=False):
    """The numbers behind an event, as far as its kind has them."""

    date_ci: list[str]  # 95 % interval of the date
    statistic: float
    threshold: float  # of the statistic
    aircraft_that_night: int
    # change_deg, standard_error_deg: of A to E, of a compass that changed
    change_deg: dict[str, float]
    standard_error_deg: dict[str, float]
    curve_rms_deg: float
    # factor, standard_error: of a disagreement that rose
    factor: float
    standard_error: float
    # days, usual_days: of a silence
    days: int
    usual_days: int


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    kind: Kind  # of :data:`WORDS`
    date: str  # day since which it is so
    noticed: str  # night (the day whose reports were in) that told it
    aircraft: str | None  # none: all of them at once, and no aircraft's fault
    evidence: Evidence

    @property
    def line(self) -> str:
        """The event in one line."""
        who = self.aircraft or "fleet"
        return f"{self.date}  {who}: {WORDS[self.kind]}{_evidence_words(self)}"


@dataclass(frozen=True)
class UnitTable:
    """A table of corrections: at the eight nodes, with its standard errors."""

    # correction_deg, standard_error_deg: to add to the indicated heading
    correction_deg: list[float]
    standard_error_deg: list[float]


@dataclass(frozen=True)
class State:
    """How an aircraft stands."""

    aircraft: str
    # first_day, last_day: with reports
    first_day: str
    last_day: str
    silent: bool = False
    # table_in_use, table_now: what is on board (or applied), and what would be sent now
    table_in_use: UnitTable | None = None
    table_now: UnitTable | None = None
    # beyond the error of both; None where there are not two to compare
    tables_differ: bool | None = None
    table_difference_deg: float | None = None  # rms over the nodes
    # mean wind vector disagreement of the last days with reports
    disagreement_kt: float | None = None
    past_disagreement_kt: float | None = None  # and of the days before


@dataclass(frozen=True)
class Monitoring:
    """What a night's look at the fleet tells."""

    until: str  # last day looked at
    reference: str
    states: list[State]
    events: list[Event]  # all that were ever told, in the order they were noticed
    told_before: int = 0  # how many of them an earlier look told: the rest are new
    # how many of them, the last ones, nobody is known to have been told: they are new to the next
    # look too. A command that was killed before it said its lines leaves them so.
    unsaid: int = 0

    @property
    def new_events(self) -> list[Event]:
        """Events that no earlier look told."""
        return self.events[self.told_before :]

    @property
    def text(self) -> str:
        """What a person reads in the morning: a line for every new event, and whom to send what."""
        news, silent = self.new_events, [one.aircraft for one in self.states if one.silent]
        lines = [
            f"{len(self.states):,} aircraft watched to {self.until} against {self.reference}: "
            + (f"{len(news):,} new event{'s' * (len(news) != 1)}" if news else "nothing new"),
            *(event.line for event in news),
        ]
        for words, names in (("another table for", self.differing), ("silent", silent)):
            if names:
                more = f" and {len(names) - NAMED:,} more" if len(names) > NAMED else ""
                lines.append(f"{words}: {', '.join(names[:NAMED])}{more}")
        return "\n".join(lines)

    @property
    def differing(self) -> list[str]:
        """Aircraft to which another table should go."""
        return [state.aircraft for state in self.states if state.tables_differ]


def write_events(found: Monitoring, path: Path) -> Path:
    """Write ``events.json`` under a temporary name, and rename it."""
    return write_json(path, {"version": VERSION, **asdict(found)})


def read_events(path: Path) -> Monitoring:
    """Read ``events.json``.

    Raises
    ------
    InputError
        If it is not such a file.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        if content.pop("version") != VERSION:
            raise ValueError("version")
        content["states"] = [_state(entry) for entry in content["states"]]
        content["events"] = [Event(**entry) for entry in content["events"]]
        return Monitoring(**content)
    except (ValueError, TypeError, KeyError, AttributeError) as err:
        raise InputError(
            "not the events of an earlier look that this version can read",
            file=path,
            found=err,
            remedy="Remove it: the watch begins anew, and may tell events again",
        ) from err


def _state(entry: dict[str, Any]) -> State:
    """A state as JSON brings it, right or not."""
    tables = {
        name: UnitTable(**entry[name]) if entry[name] else None
        for name in ("table_in_use", "table_now")
    }
    return State(**(entry | tables))


def _evidence_words(event: Event) -> str:
    """The numbers of an event that a person wants first."""
    told = event.evidence
    if event.kind == "aircraft_new":
        return ""
    if event.kind == "aircraft_silent":
        return f" (no report for {told['days']} days, {told['usual_days']} is usual)"
    if "factor" in told:
        size = f"wind disagreement {told['factor']:.2f} times the past's"
    else:
        size = f"by {told['curve_rms_deg']:.1f} degrees rms, offset {told['change_deg']['A']:+.1f}"
    low, high = told["date_ci"]
    between = f", between {low} and {high}" if low != high else ""
    return f" ({size}{between}; noticed {event.noticed})"
