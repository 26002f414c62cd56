"""Starting point of a diagnosis: the perfect instrument, known effects, or another simulation.

Assumptions: known effects are removed from the reports (`airswing.gap.simulation.forward`),
so that the diagnosis concerns the remaining gap. Reports of another simulation that follows the
paths of the archive are matched by aircraft and time, and their wind replaces the wind of the
reference (`airswing.gap.simulation.report_table`). A
simulation on other paths is diagnosed like an archive, against model winds at its positions, and
its effects are known effects of the archive: those of the whole fleet, and those of aircraft that
are in both.

Validity: a simulation on other paths must be long enough for a diagnosis. Unit: kt.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airswing.errors import InputError
from airswing.units import KNOT
from airswing.workflow.job import Job

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Reports
    from airswing.gap.archive.frame import Frame
    from airswing.gap.effects import ActiveEffect
    from airswing.gap.result.schema import KnownEntry, SimulationEntry

__all__ = ["Asked", "Start", "job_of_simulation", "read_start", "starting_point"]

# Where the collocation of a simulation on other paths is kept while it is diagnosed.
_SIMULATION_FOLDER = ".simulation"


@dataclass(frozen=True)
class Start:
    """Reports for a diagnosis, and the effects that were removed from them."""

    frame: Frame
    known: list[ActiveEffect] = field(default_factory=list)  # removed from the reports
    known_entries: list[KnownEntry] = field(default_factory=list)  # for ``gap.json``
    # entry of ``gap.json``; None for the perfect instrument
    simulation: SimulationEntry | None = None


def disagreement_kt(frame: Frame) -> float:
    """Return the mean vector disagreement of reports and simulation, kt."""
    return float(np.hypot(*frame.residual.T).mean() / KNOT)


@dataclass(frozen=True)
class Asked:
    """Requested starting point, read and checked before the archive is read."""

    known: list[ActiveEffect] | None = None
    known_file: Path | None = None
    simulated: str | None = None
    reports: xr.Dataset | None = None  # of the simulation
    section: Reports | None = None  # how they are read


def read_start(job: Job, *, known: Path | None = None, simulated: str | None = None) -> Asked:
    """Read the requested starting point.

    Parameters
    ----------
    known : Path, optional
        ``effects.yaml`` or ``fits.nc``: effects that the simulation contains.
    simulated : str, optional
        Simulated reports: a file, a glob, or the configuration of a separate archive.

    Raises
    ------
    InputError
        If a file is missing or has other content.
    """
    effects, reports, section = None, None, None
    if known is not None:
        from airswing.gap.simulation.effects_file import read_known

        effects = read_known(known, reference=job.config.gap_reference())
    if simulated is not None:
        reports, section = _read(job, simulated)
    return Asked(effects, known, simulated, reports, section)


def starting_point(
    job: Job, frame: Frame, asked: Asked, *, effects_of: Callable[[Job], list[ActiveEffect]]
) -> Start:
    """Return the starting point of a diagnosis.

    Parameters
    ----------
    frame : Frame
        Reports of the archive against the reference.
    asked : Asked
        From `read_start`.
    effects_of : callable
        Diagnoses the archive of a job; used for a simulation on other paths.

    Raises
    ------
    InputError
        If an effect needs an aircraft or a variable that the archive does not have.
    """
    start = Start(frame)
    start = _against(job, start, asked, effects_of)
    if asked.known is not None and asked.known_file is not None:
        strict = asked.known_file.suffix != ".nc"
        start = _without(start, asked.known, str(asked.known_file), strict=strict)
    return start


def _without(start: Start, effects: Sequence[ActiveEffect], source: str, *, strict: bool) -> Start:
    """Remove effects; those of aircraft that are not in the archive are refused or left out."""
    from airswing.gap.result.schema import KnownEntry
    from airswing.gap.simulation.effects_file import plain_effects
    from airswing.gap.simulation.forward import remove_effects

    removed = list(effects) if strict else _of_archive(effects, start.frame.tails)
    try:
        left = remove_effects(start.frame, removed)
    except InputError as err:
        raise InputError(
            err.what, file=source, field=err.field, found=err.found, remedy=err.remedy
        ) from err
    entry = KnownEntry(
        source=source,
        effects=plain_effects(removed),
        left_out=len(effects) - len(removed),
        disagreement_without_kt=disagreement_kt(start.frame),
        disagreement_with_kt=disagreement_kt(left),
    )
    return replace(
        start,
        frame=left,
        known=[*start.known, *removed],
        known_entries=[*start.known_entries, entry],
    )


def _of_archive(effects: Sequence[ActiveEffect], tails: Sequence[str]) -> list[ActiveEffect]:
    """Return the effects on aircraft of the archive; those on all stay."""
    out = []
    for one in effects:
        both = None if one.tails is None else tuple(t for t in one.tails if t in tails)
        if both is None or (both and (one.name != "tail_swap" or len(both) == 2)):
            out.append(replace(one, tails=both))
    return out


def _against(
    job: Job, start: Start, asked: Asked, effects_of: Callable[[Job], list[ActiveEffect]]
) -> Start:
    """Replace the perfect instrument by another simulation, if there is one."""
    from airswing.gap.result.schema import SimulationEntry
    from airswing.gap.simulation.report_table import (
        match_reports,
        with_simulated_wind,
    )

    simulated, reports, section = asked.simulated, asked.reports, asked.section
    if simulated is None or reports is None or section is None:
        return start
    with job.progress.stage("match") as stage:
        matched = match_reports(start.frame, reports)
        number = int(matched.found.sum())
        stage.note = f"{number:,} of {start.frame.size:,} reports are in the simulation"
    entry = SimulationEntry(
        source=simulated,
        reports=matched.simulated,
        matched=number,
        of=start.frame.size,
        matched_by="aircraft and time",
    )
    if matched.same_paths:
        return Start(with_simulated_wind(start.frame, matched), simulation=entry)
    other = job_of_simulation(job, simulated, section)
    effects = effects_of(other)
    shutil.rmtree(other.output, ignore_errors=True)
    shared = set(start.frame.tails) & {str(name) for name in reports["aircraft"].values}
    entry = replace(entry, matched_by="distribution", aircraft_in_both=sorted(shared))
    return _without(Start(start.frame, simulation=entry), effects, simulated, strict=False)


def _read(job: Job, simulated: str) -> tuple[xr.Dataset, Reports]:
    """Read simulated reports, with the column mapping of the archive where it is needed."""
    from airswing.config_file import load_config
    from airswing.reports import read_reports

    if Path(simulated).suffix in {".yaml", ".yml"}:
        section = load_config(Path(simulated)).reports
        found = read_reports(section.files, format=section.format, columns=section.columns)
        return found, section
    archive = job.config.reports
    section = archive.model_copy(update={"files": [simulated], "format": "auto", "columns": {}})
    if not glob(simulated, recursive=True):
        raise InputError("no reports of a simulation", file=simulated, field="--simulated")
    try:
        return read_reports(section.files), section
    except InputError:
        if not archive.columns:
            raise
    section = section.model_copy(update={"columns": archive.columns})
    return read_reports(section.files, columns=section.columns), section


def job_of_simulation(job: Job, simulated: str, reports: Reports) -> Job:
    """Return the job that diagnoses a simulation on other paths.

    Parameters
    ----------
    job : Job
        Of the archive; its references are used unless the simulation has others.
    simulated : str
        Reports, or the configuration of an archive.
    reports : Reports
        How they are read.

    Returns
    -------
    Job
        Its products go to a folder inside the archive's output.
    """
    from airswing.config_file import load_config

    output = job.output / _SIMULATION_FOLDER
    config = job.config.model_copy(update={"reports": reports, "output": output})
    if Path(simulated).suffix in {".yaml", ".yml"}:
        config = load_config(Path(simulated), output=output)
    return replace(job, config=config, fresh=True)
