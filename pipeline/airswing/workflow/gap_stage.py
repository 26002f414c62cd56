"""The stages of the gap: simulate the reports; diagnose where and why the real ones differ.

Assumes the configuration of the main job, and works on its headings; months that are missing, or
whose inputs changed, are made as by the main job. A diagnosis starts from the perfect instrument,
from known effects, which are removed from the reports, or from the reports of another simulation:
on the paths of the archive their wind replaces the wind of the reference; on other paths the
simulation is diagnosed like an archive, against model winds at its positions, and its effects on
the whole fleet and on aircraft in both are known effects of the archive.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from airswing.config import Config
from airswing.config_file import load_config, naming_configuration
from airswing.errors import InputError
from airswing.gap.archive.frame import Frame, sampled
from airswing.gap.checks import review_claims
from airswing.gap.diagnose import attributed, diagnose
from airswing.gap.effects import CATALOGUE, ActiveEffect
from airswing.gap.result.schema import GapReport, KnownEntry, SimulationEntry
from airswing.gap.simulation.effects_file import (
    active_effects,
    not_known,
    plain_effects,
    read_effects,
    read_known,
    unknown_not_known,
    write_effects,
)
from airswing.gap.simulation.forward import remove_effects
from airswing.gap.simulation.report_table import (
    match_reports,
    report_path,
    simulate_reports,
    with_simulated_wind,
    write_reports,
)
from airswing.products.whole_files import write_json
from airswing.reference.collocate import collocate
from airswing.report.gap.gap_page import write_gap_page
from airswing.reports import expand, read_reports
from airswing.units import KNOT
from airswing.workflow.job import Job
from airswing.workflow.months import catalogues, make_headings


def simulation(job: Job, effects: Path | None, output: Path, *, seed: int = 0) -> Path:
    """Simulate the archive's reports, with the effects of a file, and write a CSV or Parquet."""
    output = report_path(output)  # refuse a wrong name before the archive is read
    active = read_effects(effects) if effects is not None else []
    headings = make_headings(job)
    members = job.pools[job.config.gap_reference()]
    with job.progress.stage("simulate") as stage:
        table = simulate_reports(headings, reference=members, effects=active, seed=seed)
        stage.note = f"{len(table):,} reports, {len(active)} effects"
    return write_reports(table, output)


def diagnosis(
    job: Job,
    *,
    without: Sequence[str] = (),
    known: Path | None = None,
    simulated: str | None = None,
) -> GapReport:
    """Diagnose the gap: ``gap.json``, ``gap.nc``, ``effects.yaml`` and ``gap/index.html``.

    Effects `without` are withheld from the catalogue. ``effects.yaml`` or ``fits.nc`` of `known`
    names effects that the simulation already contains: the diagnosis concerns the remaining gap,
    and ``effects.yaml`` then holds all effects. Reports `simulated` (a file, a glob, or the
    configuration of a separate archive) replace those of a perfect instrument.
    """
    # checked before anything is read, because headings may take an hour
    for name in without:
        if name not in CATALOGUE:
            remedy = f"The catalogue holds {', '.join(CATALOGUE)}"
            raise InputError("unknown effect", field="--without", found=name, remedy=remedy)
    begin = starting_point(job, known=known, simulated=simulated)
    archive = make_headings(job)
    with job.progress.stage("read") as stage:
        headings = with_near_winds(job, sampled(archive))
        frame = frame_of(job, headings)
        stage.note = f"{archive.sizes['report']:,} reports, {frame.size:,} diagnosed"
    start = begin(frame)
    with job.progress.stage("diagnose") as stage:
        catalogue = {name: effect for name, effect in CATALOGUE.items() if name not in without}
        result = diagnose(start.frame, catalogue=catalogue, progress=stage.enter)
        # Effects of scatter cannot be removed from the reports: known ones are diagnosed again.
        effects = not_known(result.report.effects, start.removed)
        unknown = unknown_not_known(result.report.unknown, start.removed)
        findings = [effect.name for effect in effects]
        if number := len(unknown.where):
            findings.append(f"{number} unexplained error{'s' if number > 1 else ''}")
        stage.note = ", ".join(findings) or "no missing effect found"
    with job.progress.stage("claims") as stage:
        # refit without the effects other than deviation
        config, test = job.config, job.config.field_test
        claims = review_claims(
            headings,
            result.adjustment,
            pools=job.pools,
            reference=config.gap_reference(),
            fit=config.fit.model_dump(),
            field_test=None if test is None else test.model_dump(),
        )
        stage.note = "no effect other than the deviation to remove"
        if result.adjustment.names:
            stage.note = f"{claims.stay} of {claims.of} fits stay within their interval"
        elif result.report.unknown.where:
            stage.note = "unexplained errors are not removed from the reports"
    report = replace(
        result.report,
        effects=effects,
        unknown=unknown,
        reference=config.gap_reference(),
        headings_uuid=archive.attrs["uuid"],
        known=start.known_entries or None,
        simulation=start.simulation,
        claims=claims,
        counts=replace(result.report.counts, reports=archive.sizes["report"]),
    )
    report = attributed(
        report,
        job.pools[job.config.gap_reference()],
        lambda reference, offset: remove_effects(
            frame_of(
                job, with_near_winds(job, headings, offset) if offset else headings, reference
            ),
            start.removed,
        ),
    )
    write_json(job.output / "gap.json", report.content())
    write_effects([*start.removed, *active_effects(report)], job.output / "effects.yaml")
    title = "Gap between reported and simulated winds: maps, evidence and statistics"
    job.write(result.dataset, "gap.nc", title=title, sources=(archive,))
    with job.progress.stage("page") as stage:
        stage.note = str(write_gap_page(job.output / "gap", gap=report, maps=result.dataset))
    return report


def with_near_winds(job: Job, headings: xr.Dataset, offset: float = 0.0) -> xr.Dataset:
    """Headings with the winds of the gap's references an hour before and after each report.

    They are the winds that a reference with wrong valid times would give. The tendency between two
    fields shows half of it where waves are small. With an ``offset`` (correct minus stated valid
    time of the fields, h) the winds at the reports are also those of the correct time.
    """
    config = job.config
    members = job.pools[config.gap_reference()]
    models = {name: catalogue for name, catalogue in catalogues(job).items() if name in members}
    if not models:
        return headings
    places = headings[["time", "latitude", "longitude", "pressure"]]
    hours = {"_hour_before": -1.0, "_hour_after": 1.0} | ({"": 0.0} if offset else {})
    shifts = [np.timedelta64(round(3600 * (hour - offset)), "s") for hour in hours.values()]
    # together, so that a model file is read once
    shifted = xr.concat([places.assign(time=places["time"] + shift) for shift in shifts], "report")
    winds = collocate(shifted, models, max_time_gap=config.collocation.max_time_gap).compute()
    near: dict[str, Any] = {}
    for name in ("reference_eastward_wind", "reference_northward_wind"):
        wind = winds[name].reindex(reference=headings["reference"])
        parts = np.split(wind.to_numpy(), len(shifts), axis=-1)
        near |= {name + when: (wind.dims, part) for when, part in zip(hours, parts, strict=True)}
    return headings.assign(near)


def frame_of(job: Job, headings: xr.Dataset, reference: str | None = None) -> Frame:
    """Reports of headings against a reference; against that of the gap, or its pool, by default."""
    config = job.config
    members = job.pools[config.gap_reference()] if reference is None else reference
    return Frame.from_headings(headings, reference=members, phases=config.gap.phases)


# --- starting point ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Start:
    """Reports for a diagnosis, and the effects that were removed from them."""

    frame: Frame
    removed: list[ActiveEffect] = field(default_factory=list)
    known_entries: list[KnownEntry] = field(default_factory=list)  # for ``gap.json``
    # entry of ``gap.json``; None for the perfect instrument
    simulation: SimulationEntry | None = None


def starting_point(
    job: Job, *, known: Path | None = None, simulated: str | None = None
) -> Callable[[Frame], Start]:
    """Read the starting point of a diagnosis; return a function that makes it from the archive."""
    effects = None if known is None else read_known(known, reference=job.config.gap_reference())
    reports = None if simulated is None else _read_simulation(job, simulated)

    def begin(frame: Frame) -> Start:
        start = Start(frame)
        if simulated is not None and reports is not None:
            start = _from_simulation(job, frame, simulated, *reports)
        if known is not None and effects is not None:
            start = _remove(start, effects, str(known), strict=known.suffix != ".nc")
        return start

    return begin


def _remove(start: Start, effects: Sequence[ActiveEffect], source: str, *, strict: bool) -> Start:
    """Remove effects; those of aircraft that are not in the archive are refused or omitted."""
    removed = list(effects)
    if not strict:
        removed, tails = [], start.frame.tails
        for effect in effects:
            there = None if effect.tails is None else tuple(t for t in effect.tails if t in tails)
            # effects on all aircraft remain; a swap needs both of its aircraft
            if there is None or (there and (effect.name != "tail_swap" or len(there) == 2)):
                removed.append(replace(effect, tails=there))
    try:
        frame = remove_effects(start.frame, removed)
    except InputError as err:
        raise err.located(file=source) from err
    # mean vector disagreement of reports and simulation
    before, after = (float(np.hypot(*f.residual.T).mean() / KNOT) for f in (start.frame, frame))
    entry = KnownEntry(
        source=source,
        effects=plain_effects(removed),
        left_out=len(effects) - len(removed),
        disagreement_without_kt=before,
        disagreement_with_kt=after,
    )
    removed, entries = [*start.removed, *removed], [*start.known_entries, entry]
    return replace(start, frame=frame, removed=removed, known_entries=entries)


def _from_simulation(
    job: Job, frame: Frame, simulated: str, reports: xr.Dataset, simulation: Config
) -> Start:
    with job.progress.stage("match") as stage:
        matched = match_reports(frame, reports)
        number = int(matched.found.sum())
        stage.note = f"{number:,} of {frame.size:,} reports are in the simulation"
    entry = SimulationEntry(
        source=simulated,
        reports=matched.simulated,
        matched=number,
        of=frame.size,
        matched_by="aircraft and time",
    )
    if matched.same_paths:
        return Start(with_simulated_wind(frame, matched), simulation=entry)
    output = job.output / ".simulation"  # its collocation, during the diagnosis
    config = simulation.model_copy(update={"output": output})
    try:
        with naming_configuration(simulated):
            effects = effects_of_archive(replace(job, config=config, fresh=True))
    finally:
        shutil.rmtree(output, ignore_errors=True)
    shared = set(frame.tails) & {str(name) for name in reports["aircraft"].values}
    entry = replace(entry, matched_by="distribution", aircraft_in_both=sorted(shared))
    return _remove(Start(frame, simulation=entry), effects, simulated, strict=False)


def effects_of_archive(job: Job) -> list[ActiveEffect]:
    """Diagnose the archive of a simulation and return its effects."""
    frame = frame_of(job, with_near_winds(job, sampled(make_headings(job))))
    with job.progress.stage("diagnose the simulation") as stage:
        effects = active_effects(diagnose(frame, progress=stage.enter).report)
        stage.note = f"{len(effects)} effects"
    return effects


def _read_simulation(job: Job, simulated: str) -> tuple[xr.Dataset, Config]:
    """Read simulated reports; return also the configuration of their archive.

    Without a configuration of the simulation it is that of the job with other report files, whose
    columns are named as in its archive if they are not the canonical ones.
    """
    if Path(simulated).suffix in {".yaml", ".yml"}:
        config = load_config(Path(simulated))
        section = config.reports
        with naming_configuration(simulated):
            reports = read_reports(section.files, format=section.format, columns=section.columns)
        return reports, config
    expand(simulated, "--simulated")  # its error names the option
    files, columns = [simulated], job.config.reports.columns
    try:
        reports, columns = read_reports(files), {}
    except InputError:
        if not columns:
            raise
        reports = read_reports(files, columns=columns)
    section = job.config.reports.model_copy(
        update={"files": files, "format": "auto", "columns": columns}
    )
    return reports, job.config.model_copy(update={"reports": section})
