"""A reject list as it could be, were its aircraft's winds corrected: rescue instead of reject.

Assumes a list as GSI reads it (:mod:`airswing.handover.records.gsi_list`), and applies the criteria
of its own header to the reported and to the corrected winds of the archive's aircraft. Of an
aircraft whose wind is rejected for criteria of wind alone, and whose corrected winds meet all of
them on `FEWEST` reports or more, the ``W`` is taken off; with no ``T`` or ``R`` left its line goes.
An aircraft listed for another reason as well (a type of aircraft, research), not in the archive, or
without a correction stays, and so does every line that is none. Nobody is added: aircraft that fail
and are not listed are told.

Identifiers are compared without leading zeros, with the second (MDCRS) identifier too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from airswing.errors import InputError
from airswing.handover.records.gsi_list import WIND_CRITERIA, Entry, RejectList, read_reject_list
from airswing.handover.records.registry import (
    Account,
    ArchiveWinds,
    ExportFormat,
    Listed,
    Request,
    TakenOff,
    register,
)
from airswing.handover.records.run_products import (
    correction_members,
    product_beside,
    refuse_existing,
)

if TYPE_CHECKING:
    from pathlib import Path

FILE_NAME = "current_bad_aircraft"
FEWEST = 200
"""Reports below which an aircraft is not judged; the least that real lists name."""
ROOM = 500
"""Identifiers GSI's lists hold (src/gsi/aircraftobsqc.f90)."""
# Aircraft named in notes; the list and the result have all.
_SHOWN = 12


@dataclass(frozen=True)
class Judged:
    """One aircraft of the archive against a list's criteria."""

    name: str
    reports: int  # those that could be corrected
    winds_a_day: float  # winds that could be used, were they right
    reported: dict[str, float]  # statistics by criterion
    corrected: dict[str, float]
    reported_fails: tuple[str, ...]  # criteria exceeded
    corrected_fails: tuple[str, ...]


def write(request: Request) -> Account:
    """Write the list as it could be."""
    from airswing.products.whole_files import atomic

    if request.settings.base is None:
        raise InputError(
            "the current list is needed",
            field="--base",
            remedy="Give the file GSI reads (current_bad_aircraft)",
        )
    current = read_reject_list(request.settings.base)
    target = request.path / FILE_NAME if request.folder else request.path
    refuse_existing(request, target)
    fleet = {judged.name: judged for judged in judge(request, current.criteria)}
    lines, taken_off, stay = _rescued(current, fleet)
    with atomic(target) as temporary:
        temporary.write_bytes(current.header + b"".join(lines))
    return _account(target, current, fleet, taken_off, stay)


def judge(request: Request, criteria: dict[str, float]) -> list[Judged]:
    """Hold every aircraft of the archive against a list's criteria of wind."""
    from airswing.handover.records.list_statistics import list_statistics
    from airswing.products.ragged import time_span

    names = [str(name) for name in request.corrected["aircraft"].to_numpy()]
    with product_beside(
        request, "headings.nc", why="it holds the model winds the criteria are applied to"
    ) as headings:
        members = correction_members(request.corrected)
        known = [str(name) for name in headings["reference"].to_numpy()]
        members = [name for name in members if name in known] or known[:1]
        found = list_statistics(headings, request.corrected, members)
        first, last = time_span(headings)
    days = max((last - first) / np.timedelta64(1, "D"), 1.0)
    wanted = [name for name in WIND_CRITERIA if name in criteria]
    judged = []
    for place, name in enumerate(names):
        values = [{one: float(found[one][state, place]) for one in wanted} for state in (0, 1)]
        fails = [tuple(one for one in wanted if abs(own[one]) > criteria[one]) for own in values]
        number, usable = int(found["number"][place]), float(found["usable"][place] / days)
        judged.append(Judged(name, number, usable, values[0], values[1], fails[0], fails[1]))
    return judged


def _rescued(
    current: RejectList, fleet: dict[str, Judged]
) -> tuple[list[bytes], list[TakenOff], list[Listed]]:
    """The lines of the list as it could be, who comes off and who stays.

    Told is every aircraft whose wind is rejected.
    """
    known = {_plain(name): judged for name, judged in fleet.items()}
    lines: list[bytes] = []
    taken_off: list[TakenOff] = []
    stay: list[Listed] = []
    for entry in current.entries:
        if "W" not in entry.flags:
            lines.append(entry.line)
            continue
        judged = known.get(_plain(entry.identifier)) or known.get(_plain(entry.second))
        comes_off, why = verdict(entry, judged)
        told: Listed = {"aircraft": entry.identifier, "why": why, **_told(judged)}
        if not comes_off:
            stay.append(told)
            lines.append(entry.line)
            continue
        left = entry.without_wind()
        taken_off.append({**told, "still_rejected": left.flags if left else ""})
        lines += [left.line] if left else []
    return lines, taken_off, stay


def verdict(entry: Entry, judged: Judged | None) -> tuple[bool, str]:
    """Whether an aircraft's wind comes off the list, and why or why not.

    ``judged`` is None where the archive does not have it.
    """
    others = [name for name in entry.reasons if _of_wind(name) and name not in WIND_CRITERIA]
    if judged is None:
        return False, "not in the archive"
    if judged.reports == 0:
        return False, "its winds could not be corrected"
    if others:
        return False, f"listed for another reason: {' '.join(others)}"
    if judged.reports < FEWEST:
        return False, f"{judged.reports} corrected reports, {FEWEST} are needed"
    if not entry.reasons and not judged.reported_fails:
        return False, "the list gives no reason, and its winds as reported meet every criterion"
    if judged.corrected_fails:
        fails = ", ".join(f"{name} {judged.corrected[name]:.1f}" for name in judged.corrected_fails)
        return False, f"corrected winds fail too: {fails}"
    before = ", ".join(f"{name} {judged.reported[name]:.1f}" for name in judged.reported_fails)
    return True, f"corrected winds meet every criterion (as reported: {before or 'no criterion'})"


def _of_wind(reason: str) -> bool:
    """Whether a reason may be one for the wind: those of temperature and humidity alone are not."""
    return not reason.endswith(("_T", "_RH")) or reason.endswith("_W") or "_W_" in reason


def _plain(identifier: str) -> str:
    return identifier.strip().lstrip("0") or identifier.strip()


def _told(judged: Judged | None) -> ArchiveWinds:
    if judged is None:
        return {}
    return {
        "name": judged.name,
        "reports": judged.reports,
        "winds_a_day": round(judged.winds_a_day, 1),
        "reported": {name: round(value, 2) for name, value in judged.reported.items()},
        "corrected": {name: round(value, 2) for name, value in judged.corrected.items()},
        "reported_fails": list(judged.reported_fails),
        "corrected_fails": list(judged.corrected_fails),
    }


def _account(
    target: Path,
    current: RejectList,
    fleet: dict[str, Judged],
    taken_off: list[TakenOff],
    stay: list[Listed],
) -> Account:
    """What there is to tell."""
    listed = {one.get("name") for one in [*taken_off, *stay]}
    failing = [
        _told(judged)
        for judged in fleet.values()
        if judged.reported_fails and judged.reports >= FEWEST and judged.name not in listed
    ]
    gained = sum(one["winds_a_day"] for one in taken_off)
    notes = [f"off the list: {one['aircraft']} ({one['why']})" for one in taken_off[:_SHOWN]]
    inside = [one for one in stay if "name" in one]
    notes += [f"stays: {one['aircraft']} ({one['why']})" for one in inside[:_SHOWN]]
    absent = len(stay) - len(inside)
    notes.append(
        f"{len(taken_off)} aircraft come off, {len(stay)} stay ({absent} of them not in the "
        f"archive): {gained:,.0f} winds a day gained"
    )
    if failing:
        names = ", ".join(one["name"] for one in failing[:_SHOWN])
        notes.append(f"not listed, but failing as reported: {names}")
    listed_winds = sum("W" in one.flags for one in current.entries) - len(taken_off)
    if listed_winds > ROOM:
        notes.append(
            f"{listed_winds} aircraft are listed for wind; GSI has room for {ROOM}, untested"
        )
    if current.filled:
        notes.append(
            f"{current.filled} blank second identifiers, which match every report without one, "
            "filled with dashes"
        )
    return {
        "files": [{"path": str(target), "entries": sum(bool(e.flags) for e in current.entries)}],
        "criteria": current.criteria,
        "taken_off": taken_off,
        "stay": stay,
        "not_listed": failing,
        "winds_a_day_gained": round(gained, 1),
        "blank_identifiers_filled": current.filled,
        "notes": notes,
    }


register(ExportFormat("reject_list", "a GSI reject list without the aircraft _rescued", write))
