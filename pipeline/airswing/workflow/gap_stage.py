"""The stages of the gap, in order: simulate the reports, diagnose where and why the real ones part.

Assumes the configuration of the main job, and works on its headings; months of them that are not
there, or whose inputs changed, are made as the main job makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from airswing.errors import InputError
from airswing.products.netcdf import write_product
from airswing.products.whole_files import write_json
from airswing.workflow.job import Job
from airswing.workflow.months import make_headings

if TYPE_CHECKING:
    from airswing.gap.archive.frame import Frame
    from airswing.gap.diagnose import Diagnosis
    from airswing.gap.effects import ActiveEffect, Effect
    from airswing.gap.result.schema import ClaimsEntry, GapReport

GAP_JSON, GAP_PRODUCT, GAP_EFFECTS = "gap.json", "gap.nc", "effects.yaml"


def simulation(job: Job, effects: Path | None, output: Path, *, seed: int = 0) -> Path:
    """Simulate the archive's reports forward through the reference and write them.

    Parameters
    ----------
    effects : Path, optional
        Effects file; none is the perfect instrument.
    output : Path
        ``.csv`` or ``.parquet``.
    """
    from airswing.gap.simulation.effects_file import read_effects
    from airswing.gap.simulation.report_table import report_path, simulate_reports, write_reports

    output = report_path(output)  # before an archive is read for nothing
    active = read_effects(effects) if effects is not None else []
    headings = make_headings(job)
    members = job.config.pools()[job.config.gap_reference()]
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

    Parameters
    ----------
    without : sequence of str, optional
        Effects to withhold from the catalogue.
    known : Path, optional
        ``effects.yaml`` or ``fits.nc``: effects that the simulation already contains. The diagnosis
        concerns the remaining gap, and ``effects.yaml`` then holds both.
    simulated : str, optional
        Reports of another simulation, in place of those of a perfect instrument.

    Returns
    -------
    GapReport
        The content of ``gap.json``.

    Raises
    ------
    InputError
        If an effect to do without is unknown, or what the diagnosis starts from cannot be read.
    """
    from airswing.gap.archive.sample import sampled
    from airswing.gap.diagnose import diagnose
    from airswing.gap.result.effect_entries import active_effects, not_known, unknown_not_known
    from airswing.gap.simulation.effects_file import write_effects
    from airswing.report.gap.gap_page import write_gap_page
    from airswing.workflow.gap_start import read_start, starting_point

    config = job.config
    # before anything is read: a mistyped file must not cost the hour that headings may take
    asked = read_start(job, known=known, simulated=simulated)
    archive = make_headings(job)
    with job.progress.stage("read") as stage:
        headings = sampled(archive)
        frame = _frame(job, headings)
        stage.note = f"{archive.sizes['report']:,} reports, {frame.size:,} diagnosed"
    start = starting_point(job, frame, asked, effects_of=_effects_of_archive)
    with job.progress.stage("diagnose") as stage:
        found = diagnose(start.frame, catalogue=_catalogue(without), progress=stage.enter)
        # Effects of scatter cannot be removed from the reports, so known ones are found again.
        effects = not_known(found.report.effects, start.known)
        unknown = unknown_not_known(found.report.unknown, start.known)
        findings = [effect.name for effect in effects]
        if number := len(unknown.where):
            findings.append(f"{number} unexplained error{'s' if number > 1 else ''}")
        stage.note = ", ".join(findings) or "no missing effect found"
    report = replace(
        found.report,
        effects=effects,
        unknown=unknown,
        reference=config.gap_reference(),
        headings_uuid=archive.attrs["uuid"],
        known=start.known_entries or None,
        simulation=start.simulation,
        claims=_claims(job, headings, found),
        counts=replace(found.report.counts, reports=archive.sizes["report"]),
    )
    write_json(job.output / GAP_JSON, report.content())
    write_effects([*start.known, *active_effects(report)], job.output / GAP_EFFECTS)
    write_product(
        found.dataset,
        job.output / GAP_PRODUCT,
        title="Gap between reported and simulated winds: maps, evidence and statistics",
        config_json=config.model_dump_json(),
        sources=[*config.reports.files, *config.references],
        source_uuids=[archive.attrs["uuid"]],
    )
    with job.progress.stage("page") as stage:
        stage.note = str(
            write_gap_page(job.output / "gap", gap=report, maps=found.dataset, units=config.units)
        )
    return report


def _effects_of_archive(job: Job) -> list[ActiveEffect]:
    """Diagnose the archive of a simulation and return its effects."""
    from airswing.gap.archive.sample import sampled
    from airswing.gap.diagnose import diagnose
    from airswing.gap.result.effect_entries import active_effects

    frame = _frame(job, sampled(make_headings(job)))
    with job.progress.stage("diagnose the simulation") as stage:
        found = active_effects(diagnose(frame, progress=stage.enter).report)
        stage.note = f"{len(found)} effects"
    return found


def _frame(job: Job, headings: xr.Dataset) -> Frame:
    """Reports of headings against the gap's reference or pool."""
    from airswing.gap.archive.frame import Frame

    config = job.config
    reference = config.pools()[config.gap_reference()]
    return Frame.from_headings(headings, reference=reference, phases=config.gap.phases)


def _claims(job: Job, headings: xr.Dataset, found: Diagnosis) -> ClaimsEntry:
    """Repeat the deviations and the field test without the effects other than deviation."""
    from airswing.gap.checks.refit_claims import review_claims

    config = job.config
    test = config.field_test
    with job.progress.stage("claims") as stage:
        reviewed = review_claims(
            headings,
            found.adjustment,
            pools=config.pools(),
            reference=config.gap_reference(),
            fit=config.fit.model_dump(),
            field_test=None if test is None else test.model_dump(),
        )
        if found.adjustment.names:
            stage.note = f"{reviewed.stay} of {reviewed.of} fits stay within their interval"
        elif found.report.unknown.where:
            stage.note = "unexplained errors are not removed from the reports"
        else:
            stage.note = "no effect other than the deviation to remove"
    return reviewed


def _catalogue(without: Sequence[str]) -> dict[str, Effect]:
    """Return the catalogue without the named effects."""
    from airswing.gap.effects import CATALOGUE

    for name in without:
        if name not in CATALOGUE:
            raise InputError(
                "unknown effect",
                field="--without",
                found=name,
                remedy=f"the catalogue holds {', '.join(CATALOGUE)}",
            )
    return {name: effect for name, effect in CATALOGUE.items() if name not in without}
