"""Warnings on input: files and messages that were left out, identifiers that are easily confused.

Takes the audits that reading leaves as attributes of the headings: ``reading_audit`` of the reports
and ``reference_audit`` with ``skipped`` and ``unread`` of each reference.
"""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

if TYPE_CHECKING:
    from airswing.reference.files import SkippedPart
    from airswing.reports.audit import AuditContent

_GROUPS_SHOWN = 5
# Limits the size of the attribute if many messages are damaged.
_ENTRIES_KEPT = 200
_REPEATED = "_column_repeated"
# Reports left out or averaged because the configuration asks for it.
_AS_ASKED = ("not_wanted", "averaged", "merged_message")


def tally(ds: xr.Dataset, name: str) -> Any:
    """Return an audit from an attribute (JSON or mapping), empty if there is none."""
    stored = ds.attrs.get(name, {})
    try:
        return dict(json.loads(stored) if isinstance(stored, str) else stored)
    except (TypeError, ValueError):
        return {}


def reading_warnings(audit: AuditContent) -> list[str]:
    """Return warnings on the reports that were read, from ``reading_audit``; a line each."""
    lines = []
    if skipped := audit.get("files_skipped", []):
        lines.append(
            f"{len(skipped)} of {len(skipped) + audit.get('files', 0)} report files left out; "
            f"the first: {skipped[0]['reason']}"
        )
    dropped = [
        (-n, why) for why, n in audit.get("dropped", {}).items() if n and why not in _AS_ASKED
    ]
    if dropped:
        counts = ", ".join(f"{why.replace('_', ' ')} {-n:,}" for n, why in sorted(dropped))
        total = -sum(n for n, _ in dropped)
        lines.append(f"{total:,} of {audit['reports_read']:,} reports left out: {counts}")
    if examples := audit.get("examples", {}):
        values = ", ".join(f"{name} such as {value}" for name, value in examples.items())
        lines.append(f"values that cannot be read: {values}")
    for name in sorted(audit.get("repaired", {})):
        if name.endswith(_REPEATED):
            column = name.removesuffix(_REPEATED)
            lines.append(f"a report file has two columns named {column}: the first is used")
    lines += audit.get("notes", [])
    if groups := audit.get("similar_tails", []):
        shown = "; ".join(", ".join(map(repr, group)) for group in groups[:_GROUPS_SHOWN])
        more = len(groups) - _GROUPS_SHOWN
        rest = f"; and {more} more group{'s' * (more > 1)}" if more > 0 else ""
        lines.append(
            "identifiers that differ only in case or blanks count as different aircraft: "
            f"{shown}{rest}"
        )
    return lines


def model_warnings(skipped: Sequence[SkippedPart]) -> list[str]:
    """Return the skipped content of model files, without messages that are not winds on levels."""
    # most files contain messages of other kinds ("wind"), so they cause no warning
    return model_reasons([entry for entry in skipped if entry["what"] != "wind"])


def unread(problems: Iterable[tuple[object, str, str]]) -> list[SkippedPart]:
    """Count (valid time, file, reason) of messages not decoded, the most frequent first.

    A reason begins with the position of its message, which is removed. At most 200 entries.
    """
    counts = Counter(
        (file, re.sub(r"^message at \d+: ", "", reason)) for _, file, reason in problems
    )
    often = sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:_ENTRIES_KEPT]
    return [
        {"file": file, "what": "message", "reason": reason, "count": count}
        for (file, reason), count in often
    ]


def reference_warnings(audits: Mapping[str, Any]) -> list[str]:
    """Return warnings on the model files of every reference, from ``reference_audit``."""
    return [
        f"{name}: {line}"
        for name, audit in audits.items()
        for line in model_warnings([*audit.get("skipped", []), *audit.get("unread", [])])
    ]


def model_reasons(skipped: Sequence[SkippedPart]) -> list[str]:
    """Return the skipped content of model files, one line for each reason, most files first."""
    groups: dict[tuple[str, str], list[SkippedPart]] = defaultdict(list)
    for entry in skipped:
        groups[entry["what"], entry["reason"]].append(entry)
    lines = []
    for (kind, reason), entries in sorted(groups.items(), key=lambda item: -len(item[1])):
        names = [Path(entry["file"]).name for entry in entries]
        more = len(names) - 1
        where = names[0] + (f" and {more} more file{'s' * (more > 1)}" if more else "")
        total = sum(int(entry["count"]) for entry in entries)
        number = "" if kind == "file" else f"{total:,} times "
        lines.append(f"left out: {reason}, {number}in {where}")
    return lines
