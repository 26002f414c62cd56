"""The reject list of aircraft that GSI reads: its lines, its criteria, and a line taken off it.

Layout as GSI reads it (src/gsi/aircraftobsqc.f90): 16 lines are skipped, then of every line columns
1-8 are an identifier, column 11 ``T``, 13 ``W`` and 15 ``R`` say what is rejected (temperature,
wind, humidity), 22-29 a second identifier (MDCRS). Blank columns 22-29 match every report with a
blank station identifier: ``--------`` stands for none. What follows (number of reports, biases and
standard deviations, type, reasons in brackets) is for people; the criteria are told in the header,
as in ``bias_DIR > 7``. Speeds are in m/s, directions in degrees.

Every line is kept as the octets it came as, unless it is one that has to change.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from airswing.errors import InputError

# GSI skips as many, whatever they hold.
HEADER_LINES = 16
NONE = b"--------"
WIND_CRITERIA = ("bias_S", "std_S", "bias_DIR", "std_DIR", "std_W", "rms_W")
_CRITERION = re.compile(r"\b((?:bias|std|rms)_\w+)\s*>\s*(\d+(?:\.\d*)?|\.\d+)")
_ENTRY = re.compile(rb"(?P<identifier>\S{1,8}) *$")
_FLAGS = ((10, b"T"), (12, b"W"), (14, b"R"))
_SECOND = slice(21, 29)


@dataclass(frozen=True)
class Entry:
    """A line of the list; one without identifier is no entry."""

    line: bytes  # with its end of line
    identifier: str = ""
    second: str = ""  # MDCRS identifier; empty where there is none
    flags: str = ""  # those of T, W, R that are set
    reasons: tuple[str, ...] = ()  # what stands in brackets

    def without_wind(self) -> Entry | None:
        """The entry with its wind no longer rejected; None where nothing is left to reject."""
        flags = self.flags.replace("W", "")
        # the wind's column; all else stays to the octet
        line = self.line[:12] + b"-" + self.line[13:]
        return replace(self, line=line, flags=flags) if flags else None


@dataclass(frozen=True)
class RejectList:
    """A list as it was read."""

    header: bytes  # the lines that are skipped
    entries: list[Entry]  # every line after it, entry or not
    criteria: dict[str, float]  # by name, what is rejected beyond
    filled: int  # lines whose blank second identifier would have matched every report without one


def read_reject_list(path: Path) -> RejectList:
    """Read a list.

    Raises
    ------
    InputError
        If it cannot be read, has no entry, or names no criterion of wind.
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
    told = _CRITERION.findall(header.decode("latin-1"))
    criteria = {name: float(limit) for name, limit in told}
    if not set(WIND_CRITERIA) & set(criteria):
        raise InputError(
            "the header of the list names no criterion of wind to hold aircraft against",
            file=path,
            found=", ".join(criteria) or "none",
            remedy=f"Write them into its first 16 lines, such as `bias_DIR > 7`; known are "
            f"{', '.join(WIND_CRITERIA)}",
        )
    filled = [_filled(entry) for entry in entries]
    changed = sum(one.line != other.line for one, other in zip(filled, entries, strict=True))
    return RejectList(header, filled, criteria, changed)


def _entry(line: bytes) -> Entry:
    """What a line says; an entry without identifier where it is none GSI would heed."""
    body = line.rstrip(b"\r\n")
    identifier = _ENTRY.match(body[:8].ljust(8))
    flags = [letter for place, letter in _FLAGS if body[place : place + 1] == letter]
    known = all(body[place : place + 1] in (letter, b"-", b" ", b"") for place, letter in _FLAGS)
    if identifier is None or not flags or not known or body.startswith(b";"):
        return Entry(line)
    second = body[_SECOND].strip()
    reasons = re.search(rb"\(([^()]*)\)?\s*$", body[29:])
    return Entry(
        line,
        identifier["identifier"].decode("latin-1"),
        "" if set(second) <= set(b"-") else second.decode("latin-1"),
        b"".join(flags).decode("ascii"),
        tuple(reasons[1].decode("latin-1").split()) if reasons else (),
    )


def _filled(entry: Entry) -> Entry:
    """An entry whose second identifier is blank, with one that matches nothing."""
    body = entry.line.rstrip(b"\r\n")
    if not entry.identifier or body[_SECOND].strip():
        return entry
    end = entry.line[len(body) :]
    return replace(entry, line=body[:21].ljust(21) + NONE + body[29:] + end)
