"""The nightly job as a person would tell it: what is new is taken up, the rest stands.

reports and model files that are new -> months they touch -> fit -> table -> correct -> page.

Assumes one configuration whose patterns also match the files that are yet to come. Products of
every report stand by month; all else is as ``airswing run`` writes it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import xarray as xr

from airswing.errors import InputError
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.netcdf import read_product
from airswing.products.workspace import workspace
from airswing.report.run.reading_warnings import reading_warnings, tally
from airswing.workflow.collocating import filled
from airswing.workflow.fits import make_fits
from airswing.workflow.job import CORRECTED, HEADINGS, Job
from airswing.workflow.main import make_page
from airswing.workflow.update.corrected_months import MOVED, correct_month
from airswing.workflow.update.judged import judged, recent_months
from airswing.workflow.update.model_spans import model_spans
from airswing.workflow.update.monitoring_stage import make_monitoring
from airswing.workflow.update.month_fits import MonthlyFits
from airswing.workflow.update.months import Month, keep_note, kept_note, months_of

if TYPE_CHECKING:
    from airswing.reports.staging_store import Spool
    from airswing.workflow.closing_summary import Summary


def _of_all(headings: xr.Dataset, summary: Summary, since: str) -> Summary:
    """The summary with counts of all months, and a word on what is of the last ones alone."""
    counts = {
        "read": tally(headings, "reading_audit")["reports_read"],
        "usable": headings.sizes["report"],
        "kept": int(headings.attrs["kept_reports"]),
    }
    words = (
        f"Fits and tables are of all {counts['kept']:,} reports kept; wind disagreement, ranking, "
        f"profiles and the figures of reports are of the flights since {since}."
    )
    return {**summary, "reports": counts, "warnings": [words, *summary["warnings"]]}


@dataclass(frozen=True)
class Taken:
    """Products as of now."""

    # headings, fits, corrected: the first and the last of all months, read lazily
    headings: xr.Dataset
    fits: xr.Dataset
    corrected: xr.Dataset
    # ``all`` of them, those ``made`` this time and those ``corrected``
    months: dict[str, list[str]]


def update(job: Job) -> Summary:
    """Take up what is new since the last time; end with every product as of now.

    Returns
    -------
    Summary
        As of :func:`airswing.workflow.main.run`; ``months`` of :class:`Taken`; ``watched``, a line
        for what happened to the fleet and one for each new event; ``events``, how many there are in
        all (to be noted once the lines are said, :func:`.monitoring_stage.events_said`).
    """
    from airswing.workflow.closing_summary import summarise

    job = replace(job, resume=True)
    with workspace(job.output):
        taken = take_up(job)
        months, headings, fits = taken.months["all"], taken.headings, taken.fits
        recent = recent_months(job, months, fits)
        summary = summarise(job.config, recent.headings, fits, recent.corrected)
        if recent.since:
            summary = _of_all(headings, summary, recent.since)
        watched = make_monitoring(job, fits)
        drawn, mark = job.output / ".update/page.json", _of_page(job, taken)
        if kept_note(drawn).get("mark") == mark and (job.output / "report/index.html").exists():
            job.progress.say("nothing new: evaluation and page stand")
        else:
            evaluation = judged(job, months, headings, fits, recent)
            evaluation = replace(evaluation, monitoring=watched)
            make_page(job, recent.headings, fits, recent.corrected, summary, evaluation)
            keep_note(drawn, {"mark": mark})
    job.progress.say(job.progress.accounts_text())
    summary["accounts"] = job.progress.accounts()
    summary["months"], summary["watched"] = taken.months, watched.text
    summary["events"] = len(watched.events)
    return summary


def _of_page(job: Job, taken: Taken) -> str:
    """Hash of what evaluation and page are made of."""
    uuids = [one.attrs["uuid"] for one in (taken.headings, taken.fits, taken.corrected)]
    config = job.config.model_dump(exclude={"compute", "output"})
    return fingerprint(uuids, config, code_digest(__name__))


def take_up(job: Job) -> Taken:
    """Bring headings, fits, tables and corrected winds to where the files are now.

    Parameters
    ----------
    job : Job
        With ``resume``; its folder is held by the caller.
    """
    _require_no_single_files(job)
    spool, months, made = _headings(job)
    headings = _whole(job, HEADINGS)
    headings.attrs["reading_audit"] = _audit(headings, spool)
    fits = make_fits(job, headings, MonthlyFits(months), near=MOVED)
    # after all fits: a new month may change the table of an aircraft in every other month
    anew = [month for month in months if correct_month(replace(job, month=month), fits)]
    job.progress.say(f"corrected anew: {', '.join(anew) or 'no month'}")
    told = {"all": months, "made": made, "corrected": anew}
    return Taken(headings, fits, _whole(job, CORRECTED), told)


def _require_no_single_files(job: Job) -> None:
    for name in (HEADINGS, CORRECTED):
        if (job.output / name).exists():
            raise InputError(
                "the folder holds products of `airswing run`, which an update would leave behind",
                file=job.output / name,
                remedy="Choose another folder with --output, or move headings.nc and corrected.nc",
            )


def _headings(job: Job) -> tuple[Spool, list[str], list[str]]:
    """Headings of every month: all reports, the months there are, and those made this time."""
    note = job.output / ".update" / "models.json"
    with job.progress.stage("reports") as stage:
        spool = filled(job, job.store)
        stage.octets = spool.octets_read
        stage.note = f"{sum(spool.counts().values()):,} reports, {spool.octets_read:,} bytes new"
    spans, told = model_spans(job, kept_note(note))
    keep_note(note, told)
    months, made = [], []
    all_of_them = [
        Month(replace(job, month=name), spool, spans) for name in months_of(spool.hours())
    ]
    _say_what_changed(job, all_of_them)
    for month in all_of_them:
        before = month.job.place(HEADINGS)
        # nothing else tells what was made: a month that stands is not written
        stamp = before.stat().st_mtime_ns if before.exists() else 0
        if not month.make():
            month.remove()
            continue
        months.append(month.job.month)
        if before.stat().st_mtime_ns != stamp:
            made.append(month.job.month)
    for path in (job.output / "headings").glob("*.nc"):
        if path.stem not in months:
            Month(replace(job, month=path.stem), spool, spans).remove()
    if not months:
        raise InputError(
            "no month has both reports and model winds",
            field="references",
            found=f"reports in {', '.join(months_of(spool.hours()))}",
            remedy="Check the patterns of the model files",
        )
    job.progress.say(f"months: {len(months)}, made anew: {', '.join(made) or 'none'}")
    for warning in reading_warnings(spool.audit.as_dict()):
        job.progress.say(f"  {warning}")
    return spool, months, made


def _say_what_changed(job: Job, months: list[Month]) -> None:
    """Say which settings, or whether the code, are other than the last time."""
    changed = sorted({name for month in months for name in month.changed})
    if changed:
        many = sum(bool(month.changed) for month in months)
        job.progress.say(
            f"changed since the last time: {', '.join(changed)}; {many} months are made anew"
        )


def _audit(headings: xr.Dataset, spool: Spool) -> str:
    """Tally of the reading: of whole files, and of what ordering the months left out."""
    from airswing.reports.canonical.audit import Audit

    whole, ordered = Audit(), Audit.from_dict(tally(headings, "reading_audit"))
    whole.add(spool.audit)
    # they were read once, and are in the tally of whole files
    ordered.read = 0
    whole.add(ordered)
    return whole.as_json()


def _whole(job: Job, name: str) -> xr.Dataset:
    """All months of a product as one."""
    return read_product((job.output / name).with_suffix(""), lazy=True)
