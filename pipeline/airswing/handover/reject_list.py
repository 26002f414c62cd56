"""A GSI reject list without the aircraft whose corrected winds meet its criteria.

Layout read by GSI (src/gsi/aircraftobsqc.f90): 16 lines are skipped; in every further line columns
1-8 are an identifier, columns 11, 13 and 15 hold ``T``, ``W`` and ``R`` where temperature, wind and
humidity are rejected, columns 22-29 are a second (MDCRS) identifier. The rest of a line and the
criteria in the header, such as ``bias_DIR > 7`` (m/s, degrees), are for people.

An aircraft's ``W`` is removed when every reason of its entry is a criterion of wind with a limit in
the header and its corrected winds meet all such criteria on `FEWEST` reports or more; without ``T``
and ``R`` its line is removed. All other lines are unchanged byte for byte. Statistics are of report
minus reference: speed (``S``), direction (``DIR``, where the reference blows at 5 m/s or more) and
length of the vector difference (``W``). Identifiers are compared without leading zeros.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.evaluation.innovations import chunks, innovations, members_of, profile_cells
from airswing.flags import FREE_OF_DEVIATION
from airswing.handover.selection import Request, product_of_run, refuse_existing
from airswing.products.ragged import time_span
from airswing.products.whole_files import atomic

FILE_NAME = "current_bad_aircraft"
HEADER_LINES = 16  # skipped by GSI
FEWEST = 200
"""Fewest reports for a decision on an aircraft; the smallest number in real lists."""
LARGEST_LIST = 500
"""Identifiers that GSI's lists hold; the number is not tested for winds."""
WIND_CRITERIA = ("bias_S", "std_S", "bias_DIR", "std_DIR", "std_W", "rms_W")
_SHOWN = 12  # aircraft named in the notes
_CRITERION = re.compile(r"\b((?:bias|std|rms)_\w+)\s*>\s*(\d+(?:\.\d*)?|\.\d+)")
_FLAGS = ((10, b"T"), (12, b"W"), (14, b"R"))
_SECOND = slice(21, 29)


@dataclass(frozen=True)
class Entry:
    """A line of the list; one without identifier is no entry."""

    line: bytes  # with its end of line
    identifier: str = ""
    second: str = ""  # MDCRS identifier
    flags: str = ""  # those of T, W, R that are set
    reasons: tuple[str, ...] = ()  # in brackets at the end of the line


def write_reject_list(request: Request) -> dict[str, Any]:
    """Write the changed list.

    Returns ``files``, ``criteria``, ``taken_off`` and ``stay`` (entries with a rejected wind, with
    ``why`` and statistics), ``winds_a_day_gained``, ``blank_identifiers_filled`` and ``notes``.
    """
    if request.settings.base is None:
        raise InputError(
            "the current list is needed",
            field="--base",
            remedy="Give the file GSI reads (current_bad_aircraft)",
        )
    header, entries, criteria, filled = read_reject_list(request.settings.base)
    target = request.path / FILE_NAME if request.folder else request.path
    refuse_existing(request, target)
    by_name = {_unpadded(aircraft["name"]): aircraft for aircraft in _judged(request, criteria)}
    lines = [header]
    removed: list[dict[str, Any]] = []
    stay: list[dict[str, Any]] = []
    for entry in entries:
        line = entry.line
        if "W" in entry.flags:
            names = map(_unpadded, (entry.identifier, entry.second))
            aircraft = next((by_name[name] for name in names if name in by_name), None)
            passes, why = _verdict(entry, aircraft, criteria)
            outcome = {"aircraft": entry.identifier, "why": why, **(aircraft or {})}
            if passes:
                flags = entry.flags.replace("W", "")
                removed.append({**outcome, "still_rejected": flags})
                line = line[:12] + b"-" + line[13:] if flags else b""
            else:
                stay.append(outcome)
        lines.append(line)
    with atomic(target) as temporary:
        temporary.write_bytes(b"".join(lines))
    present = [entry for entry in stay if "name" in entry]
    gained = sum(entry["winds_a_day"] for entry in removed)
    notes = [f"removed: {entry['aircraft']} ({entry['why']})" for entry in removed[:_SHOWN]]
    notes += [f"remains: {entry['aircraft']} ({entry['why']})" for entry in present[:_SHOWN]]
    notes.append(
        f"{len(removed)} aircraft removed, {len(stay)} remain ({len(stay) - len(present)} of them "
        f"not in the archive): {gained:,.0f} winds a day gained"
    )
    if len(stay) > LARGEST_LIST:
        notes.append(
            f"{len(stay)} aircraft are listed for wind; GSI holds {LARGEST_LIST} and does not test"
        )
    if filled:
        notes.append(
            f"{filled} blank second identifiers, which match every report without one, "
            "filled with dashes"
        )
    return {
        "files": [{"path": str(target), "entries": sum(bool(entry.flags) for entry in entries)}],
        "criteria": criteria,
        "taken_off": removed,
        "stay": stay,
        "winds_a_day_gained": round(gained, 1),
        "blank_identifiers_filled": filled,
        "notes": notes,
    }


def _verdict(
    entry: Entry, judged: dict[str, Any] | None, criteria: dict[str, float]
) -> tuple[bool, str]:
    """Whether the wind of an entry is accepted again, and why; None: not in the archive."""
    if judged is None:
        return False, "not in the archive"
    if judged["reports"] == 0:
        return False, "its winds could not be corrected"
    # Reasons of temperature or humidity are covered by the flags T and R, which remain.
    flagged = "T" in entry.flags or "R" in entry.flags
    unanswered = [
        name
        for name in entry.reasons
        if not (name in WIND_CRITERIA and name in criteria) and (_of_wind(name) or not flagged)
    ]
    if unanswered:
        return False, f"listed for another reason: {' '.join(unanswered)}"
    if not any(_of_wind(name) for name in entry.reasons):
        return False, "the list gives no reason for rejecting its wind"
    if judged["reports"] < FEWEST:
        return False, f"{judged['reports']} corrected reports, {FEWEST} are needed"
    before, fails = (
        ", ".join(f"{name} {judged[state][name]:.1f}" for name in judged[f"{state}_fails"])
        for state in ("reported", "corrected")
    )
    if fails:
        return False, f"corrected winds fail too: {fails}"
    return True, f"corrected winds meet every criterion (as reported: {before or 'no criterion'})"


def _of_wind(reason: str) -> bool:
    return not reason.endswith(("_T", "_RH")) or "_W_" in reason


def _unpadded(identifier: str) -> str:
    return identifier.strip().lstrip("0") or identifier.strip()


def read_reject_list(path: Path) -> tuple[bytes, list[Entry], dict[str, float], int]:
    """Read a list: its header, every further line, and the limits of the criteria.

    Blank second identifiers are replaced by dashes and counted. InputError if it cannot be read,
    has no entry, or names no criterion of wind.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as err:
        raise InputError("cannot be read", file=path, found=err.strerror) from err
    lines = content.splitlines(keepends=True)
    header = b"".join(lines[:HEADER_LINES])
    entries = [_entry(line) for line in lines[HEADER_LINES:]]
    if not any(entry.identifier for entry in entries):
        raise InputError(
            "not a reject list as GSI reads it: no line after the 16 of its header has an "
            "identifier and T, W or R in columns 11, 13 and 15",
            file=path,
            found=f"{len(lines)} lines",
        )
    criteria = {name: float(limit) for name, limit in _CRITERION.findall(header.decode("latin-1"))}
    if not set(WIND_CRITERIA) & set(criteria):
        raise InputError(
            "the header of the list names no criterion of wind to judge aircraft by",
            file=path,
            found=", ".join(criteria) or "none",
            remedy=f"Write them into its first 16 lines, such as `bias_DIR > 7`; known are "
            f"{', '.join(WIND_CRITERIA)}",
        )
    filled = sum(a.line != b for a, b in zip(entries, lines[HEADER_LINES:], strict=True))
    return header, entries, criteria, filled


def _entry(line: bytes) -> Entry:
    body = line.rstrip(b"\r\n")
    identifier = re.match(rb"(\S{1,8}) *$", body[:8].ljust(8))
    flags = [letter for place, letter in _FLAGS if body[place : place + 1] == letter]
    valid = all(body[place : place + 1] in (letter, b"-", b" ", b"") for place, letter in _FLAGS)
    if identifier is None or not flags or not valid or body.startswith(b";"):
        return Entry(line)
    second = body[_SECOND].strip()
    reasons = re.search(rb"\(([^()]*)\)?\s*$", body[29:])
    if not second:
        line = body[:21].ljust(21) + b"--------" + body[29:] + line[len(body) :]
    return Entry(
        line,
        identifier[1].decode("latin-1"),
        "" if set(second) <= set(b"-") else second.decode("latin-1"),
        b"".join(flags).decode("ascii"),
        tuple(reasons[1].decode("latin-1").split()) if reasons else (),
    )


def _judged(request: Request, criteria: dict[str, float]) -> list[dict[str, Any]]:
    """Every aircraft of the archive by the criteria of wind, as reported and as corrected.

    Both states are judged on the reports that passed the screening and were corrected, which are
    compared with the mean of the references the correction was fitted against. Columns are
    ``name``, corrected ``reports``, ``winds_a_day`` that could be used if accepted, and for both
    states the statistics by criterion and the limits exceeded (``*_fails``).
    """
    tables = []
    why = "it holds the model winds the criteria are applied to"
    with product_of_run(request, "headings", why=why) as headings:
        reference = str(request.corrected.attrs.get("correction_reference", ""))
        pools, needed = {"": members_of(headings, reference)}, ["pressure", "phase", "screening"]
        first, last = time_span(headings)
        for chunk in chunks(headings, pools, needed, request.corrected):
            usable = np.isfinite(chunk.wind[0] + chunk.model[""][0])
            usable &= profile_cells(chunk.block) >= 0
            good = np.isin(chunk.applied, FREE_OF_DEVIATION) & np.isfinite(chunk.corrected[0])
            good &= usable
            columns: dict[Any, Any] = {"aircraft": chunk.aircraft, "usable": usable, "good": good}
            for state, wind in (("reported", chunk.wind), ("corrected", chunk.corrected)):
                omb = innovations(*wind, *chunk.model[""])  # observation minus background
                columns[state, "S"], columns[state, "DIR"] = omb["speed"], omb["direction"]
                columns[state, "W"] = np.hypot(omb["eastward"], omb["northward"])
            tables.append(pd.DataFrame(columns))
    days = max((last - first) / np.timedelta64(1, "D"), 1.0)
    table = pd.concat(tables)
    everyone = range(len(request.aircraft))
    counts = table.groupby("aircraft")[["usable", "good"]].sum().reindex(everyone, fill_value=0)
    grouped = table[table.pop("good")].drop(columns="usable").groupby("aircraft")
    mean, spread = (moments.reindex(everyone) for moments in (grouped.mean(), grouped.std(ddof=0)))
    statistics = {"bias": mean, "std": spread, "rms": (mean**2 + spread**2) ** 0.5}
    judged = []
    for place, name in enumerate(request.aircraft):
        usable, good = counts.iloc[place]
        aircraft: dict[str, Any] = {"name": name, "reports": int(good)}
        aircraft["winds_a_day"] = round(float(usable / days), 1)
        for state in ("reported", "corrected"):
            values = {
                criterion: float(statistics[kind][state, quantity].iloc[place])
                for criterion in WIND_CRITERIA
                if criterion in criteria
                for kind, quantity in [criterion.split("_")]
            }
            aircraft[state] = {criterion: round(value, 2) for criterion, value in values.items()}
            aircraft[f"{state}_fails"] = [
                criterion for criterion, value in values.items() if abs(value) > criteria[criterion]
            ]
        judged.append(aircraft)
    return judged
