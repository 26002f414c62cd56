"""What a run is expected to cost, before anything is decoded.

Assumes the rates below, measured by ``make benchmarks`` on two cores of a small virtual machine;
another machine differs by a factor of two or so. Good for "minutes or a night?", no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from airswing.reference.planning import Plan

_SECONDS_PER_SPARSE_MESSAGE = 0.2e-3
_SECONDS_PER_DECODED_BYTE = 1.0e-8
_SECONDS_PER_REPORT = {
    "reports": 6.0e-6,
    "collocate": 1.6e-6,
    "headings": 3.6e-6,
    "fit": 1.3e-6,
    "swing cards": 0.0,
    "correct": 0.5e-6,
    "profiles": 0.4e-6,
    "stability": 2.5e-6,
    "ranking": 0.5e-6,
    "virtual field test": 8.0e-6,
    "page": 2.2e-6,
}
# In place of these, where an earlier run read the report and derived its heading.
_SECONDS_PER_KEPT_REPORT = {"reports": 0.6e-6, "headings": 1.6e-6}
# Libraries to start, and figures of the fleet.
_SECONDS_ANYWAY = {"reports": 0.8, "collocate": 0.4, "headings": 0.2, "page": 4.0}
# However few reports it has; of 6,000 aircraft (docs/benchmarks.md), the held-out part of the
# virtual field test of 600.
_SECONDS_PER_AIRCRAFT = {
    "fit": 0.012,
    "swing cards": 0.08,
    "observation errors": 0.4e-3,
    "stability": 0.014,
    "ranking": 0.0068,
    "virtual field test": 0.06,
    "page": 0.5e-3,
}
_SECONDS_TO_COMPARE = 0.033
"""For each aircraft, where there is more than one reference; of two."""
SECONDS_PER_PANEL, PANELS = 0.04, 96  # Of the page, for as many aircraft at most
# The fleet's equations, which the fit keeps in parts (2,400 aircraft: 20 s and 0.4 GB).
_BYTES_PER_AIRCRAFT = 200_000
# Peak memory for each report of the largest block of aircraft, with up to two references.
_BYTES_IN_BLOCK = 1500
# For each report of the archive: the sums over stretches of flight that the fleet's part of the
# fit solves together.
_BYTES_PER_REPORT = 37
# For each report while its winds are found: as read, by aircraft, by time, and ``headings.nc``.
BYTES_ON_DISK, BYTES_ON_DISK_PER_REFERENCE = 180, 62
# For each report at the end: ``headings.nc`` and ``corrected.nc``.
BYTES_OF_PRODUCTS, BYTES_OF_PRODUCTS_PER_REFERENCE = 60, 22
# For each report, of what a later run goes on with: cleaned reports and finished model times.
BYTES_KEPT, BYTES_KEPT_PER_REFERENCE = 73, 32
# The interpreter with the libraries loaded.
_BASE_BYTES = 400_000_000


class Estimate(TypedDict):
    """What a run is expected to take."""

    seconds: float
    stages: dict[str, float]  # seconds of each
    memory_bytes: int  # at most
    disk_bytes: int  # while it runs
    kept_disk_bytes: int  # after it, products included


class ReferencePlan(TypedDict):
    """A :class:`airswing.reference.planning.Plan`, and what of it an earlier run has done."""

    reference: str
    model_times: int
    messages: int
    bytes: int
    sparse_messages: int
    reports: int
    matched: int
    without_time: int
    outside_grid: int
    outside_levels: int
    report_times: tuple[str, str]
    model_span: tuple[str, str]
    report_box: tuple[float, float, float, float]
    model_box: tuple[float, float, float, float]
    model_levels: tuple[float, ...]
    kept_messages: int


class RunPlan(Estimate):
    """What a run would read, and what it is expected to take."""

    reports: int
    aircraft: int
    references: dict[str, ReferencePlan]


def stage_seconds(
    reports: int, aircraft: int, plans: Mapping[str, Plan], *, threads: int = 1, kept: float = 0.0
) -> dict[str, float]:
    """Estimate the time of every stage that grows with the archive.

    Parameters
    ----------
    threads : int, default 1
        Threads that decode at a time.
    kept : float, default 0
        Share of the reports that an earlier run dealt with.
    """
    found = {stage: reports * seconds for stage, seconds in _SECONDS_PER_REPORT.items()}
    for stage, seconds in _SECONDS_PER_KEPT_REPORT.items():
        found[stage] += reports * kept * (seconds - _SECONDS_PER_REPORT[stage])
    for stage, seconds in _SECONDS_ANYWAY.items():
        found[stage] += seconds
    for stage, seconds in _SECONDS_PER_AIRCRAFT.items():
        found[stage] = found.get(stage, 0.0) + seconds * aircraft
    if len(plans) > 1:
        found["compare"] = _SECONDS_TO_COMPARE * aircraft
    found["page"] += SECONDS_PER_PANEL * min(aircraft, PANELS)
    for one in plans.values():
        decoded = 1.0 - one.sparse_messages / max(one.messages, 1)
        reading = one.sparse_messages * _SECONDS_PER_SPARSE_MESSAGE
        reading += decoded * one.bytes * _SECONDS_PER_DECODED_BYTE
        found["collocate"] += reading / threads
    return found


def estimate(
    reports: int,
    aircraft: int,
    plans: Mapping[str, Plan],
    *,
    block: int,
    left: Mapping[str, Plan] | None = None,
    keep: bool = True,
) -> Estimate:
    """Estimate time, peak memory and disk space of a run.

    Parameters
    ----------
    block : int
        Reports of the largest block of aircraft.
    left : mapping of str to Plan, optional
        What an earlier run left to be read; all of the plans by default.
    keep : bool, default True
        Finished work is kept for later runs.
    """
    left = plans if left is None else left
    whole, rest = (sum(one.messages for one in some.values()) for some in (plans, left))
    kept = 1.0 - rest / whole if whole else 0.0
    stages = stage_seconds(reports, aircraft, left, kept=kept)
    memory = _BASE_BYTES + block * _BYTES_IN_BLOCK * max(1.0, len(plans) / 2.0)
    memory += reports * _BYTES_PER_REPORT + aircraft * _BYTES_PER_AIRCRAFT
    count = len(plans)
    stays = BYTES_OF_PRODUCTS + count * BYTES_OF_PRODUCTS_PER_REFERENCE
    stays += keep * (BYTES_KEPT + count * BYTES_KEPT_PER_REFERENCE)
    most = BYTES_ON_DISK + count * BYTES_ON_DISK_PER_REFERENCE
    return {
        "seconds": round(sum(stages.values()), 1),
        "stages": {name: round(seconds, 1) for name, seconds in stages.items()},
        "memory_bytes": round(memory),
        "disk_bytes": reports * max(most, stays),
        "kept_disk_bytes": reports * stays,
    }


def as_text(found: RunPlan) -> str:
    """Lay a plan out for a terminal."""
    lines = [f"{found['reports']:,} reports of {found['aircraft']} aircraft"]
    for name, one in found["references"].items():
        lines += [
            f"{name}: {one['messages']:,} messages ({one['bytes'] / 1e6:,.0f} MB) of "
            f"{one['model_times']:,} model times, {one['sparse_messages']:,} read in place"
            + (f"; {one['kept_messages']:,} were read before" if one["kept_messages"] else ""),
            f"  {one['matched']:,} reports have a wind; without: {one['without_time']:,} outside "
            f"its times, {one['outside_grid']:,} outside its grid, {one['outside_levels']:,} "
            "outside its levels",
            f"  model {' to '.join(one['model_span'])}, reports {' to '.join(one['report_times'])}",
        ]
    lines.append(
        f"expected: about {max(found['seconds'], 1):,.0f} s, {found['memory_bytes'] / 1e9:.1f} GB "
        f"of memory, {found['disk_bytes'] / 1e9:.2g} GB of disk "
        f"({found['kept_disk_bytes'] / 1e9:.2g} GB after it); nothing was decoded"
    )
    told = (f"{name} {seconds:,.0f}" for name, seconds in found["stages"].items() if seconds >= 0.5)
    lines.append(f"  by stage, s: {', '.join(told) or 'each less than one'}")
    return "\n".join(lines)
