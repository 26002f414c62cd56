"""The main job: every stage in order, every product, the page.

By month reports -> collocate -> headings -> screen; then fit -> table -> correct -> evaluate ->
page.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from airswing.config import Config
from airswing.evaluation.results import Evaluation
from airswing.products.whole_files import workspace
from airswing.workflow.evaluation_stage import make_evaluation
from airswing.workflow.fitting import make_corrected, make_fits
from airswing.workflow.job import Job, main_reference
from airswing.workflow.months import make_headings
from airswing.workflow.progress import Progress

if TYPE_CHECKING:
    from airswing.report.run.selection import BeforeAfter
    from airswing.workflow.closing_summary import Summary


@dataclass(frozen=True, repr=False)
class Results:
    """Products of a run.

    Attributes
    ----------
    output : Path
        Folder of the products.
    headings, corrected : Dataset
        Of every report, all months, lazy.
    fits : Dataset
        Deviations and tables of every aircraft.
    evaluation : Evaluation
        What judges the corrections.
    summary : dict
        What ``airswing run --json`` prints.
    months : dict of str to list of str
        Months ``made`` by this run and those ``kept`` of an earlier one.
    """

    output: Path
    headings: xr.Dataset
    fits: xr.Dataset
    corrected: xr.Dataset
    evaluation: Evaluation
    summary: Summary

    @property
    def months(self) -> dict[str, list[str]]:
        """Months made and kept."""
        return self.summary["months"]

    @property
    def page(self) -> Path:
        """The page that shows the results."""
        return self.output / "report" / "index.html"

    def __repr__(self) -> str:
        reports, status = self.summary["reports"], self.summary["status"]
        months = ", ".join(f"{len(names)} {what}" for what, names in self.months.items())
        return "\n".join(
            [
                f"<Results in {self.output}>",
                f"  reports: {reports['usable']:,} of {self.summary['aircraft']} aircraft, "
                f"{reports['kept']:,} kept for the fit",
                f"  months: {months}",
                f"  fits against {self.summary['reference']}: {status['ok']} ok",
                f"  page: {self.page}",
            ]
        )


def run(
    config: Config | str | Path,
    *,
    output: str | Path | None = None,
    fresh: bool = False,
    quiet: bool = True,
    scheduler: str | None = None,
) -> Results:
    """Do the main job: every stage, every product, the page.

    Parameters
    ----------
    config : Config, str or path
        A configuration, or the path of its file.
    output : str or path, optional
        Folder of the products, in place of the configuration's.
    fresh : bool, default False
        Make every month anew; else months whose inputs are unchanged are kept.
    quiet : bool, default True
        Show no progress on standard error.
    scheduler : str, optional
        Address of a dask scheduler.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        The configuration or the data cannot be used; the message says what to change.

    Examples
    --------
    >>> results = airswing.run("configs/quickstart.yaml", output=folder)
    >>> results.fits["status"].dims
    ('reference', 'aircraft')
    """
    from airswing.config_file import load_config
    from airswing.workflow.compute import scheduler as on_scheduler

    if not isinstance(config, Config):
        config = load_config(config)
    if output is not None:
        config = config.model_copy(update={"output": Path(output)})
    if scheduler is not None:
        compute = config.compute.model_copy(update={"scheduler": scheduler})
        config = config.model_copy(update={"compute": compute})
    job = Job(config, Progress(quiet=quiet), fresh)
    with on_scheduler(config.compute, job.progress):
        return run_job(job)


def run_job(job: Job) -> Results:
    """The main job on the scheduler that is in use; see :func:`run`."""
    from airswing.report.run.selection import disagreement
    from airswing.workflow.closing_summary import summarise

    with workspace(job.output):
        headings = make_headings(job)
        fits = make_fits(job, headings)
        corrected = make_corrected(job, headings, fits)
        apart = disagreement(headings, corrected, main_reference(job.config))
        summary = summarise(job.config, headings, fits, apart)
        evaluation = make_evaluation(job, headings, fits, corrected)
        if evaluation.monitoring is not None:
            summary["events"] = len(evaluation.monitoring.events)
            summary["watched"] = evaluation.monitoring.text
        make_page(job, headings, fits, corrected, summary, evaluation, apart)
    job.progress.say(job.progress.accounts_text())
    summary["accounts"] = job.progress.accounts()
    return Results(job.output, headings, fits, corrected, evaluation, summary)


def make_page(
    job: Job,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset,
    summary: Summary,
    evaluation: Evaluation,
    apart: BeforeAfter,
) -> Path:
    """The page of the results: ``report/index.html``.

    Parameters
    ----------
    job : Job
    headings, fits, corrected : Dataset
        Products of the run.
    summary : Summary
        Of :func:`airswing.workflow.closing_summary.summarise`.
    evaluation : Evaluation
        Of :func:`~airswing.workflow.evaluation_stage.make_evaluation`.
    apart : BeforeAfter
        Disagreement with the main reference.
    """
    from airswing.report.run.page import write_page

    with job.progress.stage("page") as stage:
        page = write_page(
            job.output / "report",
            headings=headings,
            fits=fits,
            corrected=corrected,
            summary=summary,
            evaluation=evaluation,
            apart=apart,
            units=job.config.units,
        )
        stage.note = str(page)
    return page
