"""The main job as a person would tell it: every stage in order, every product, the page.

reports -> collocate -> headings -> screen -> fit -> table -> correct -> evaluate -> page.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from airswing.evaluation.results import Evaluation
from airswing.products.workspace import workspace
from airswing.workflow.evaluation_stage import make_evaluation
from airswing.workflow.fits import make_corrected, make_fits
from airswing.workflow.headings_stage import make_headings
from airswing.workflow.job import Job

if TYPE_CHECKING:
    from airswing.workflow.closing_summary import Summary


def run(job: Job) -> Summary:
    """Do the main job: every stage, every product, the page.

    Returns
    -------
    Summary
        The closing summary (see :func:`airswing.workflow.closing_summary.summarise`), and as
        ``accounts`` what each stage cost (see
        :meth:`airswing.workflow.progress.Progress.accounts`).
    """
    from airswing.workflow.closing_summary import summarise

    with workspace(job.output):
        headings = make_headings(job)
        fits = make_fits(job, headings)
        corrected = make_corrected(job, headings, fits)
        summary = summarise(job.config, headings, fits, corrected)
        evaluation = make_evaluation(job, headings, fits, corrected)
        make_page(job, headings, fits, corrected, summary, evaluation)
    job.progress.say(job.progress.accounts_text())
    summary["accounts"] = job.progress.accounts()
    return summary


def make_page(
    job: Job,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset,
    summary: Summary,
    evaluation: Evaluation,
) -> Path:
    """The page a person opens first: ``report/index.html``.

    Parameters
    ----------
    summary : Summary
        Of :func:`airswing.workflow.closing_summary.summarise`.
    evaluation : Evaluation
        Of :func:`make_evaluation`.
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
        )
        stage.note = str(page)
    return page
