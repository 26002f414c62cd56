"""The main job: every stage in order, every product, the page, and the summary of a run.

By month reports -> collocate -> headings -> screen; then fit -> table -> correct -> evaluate ->
page. Disagreement is the mean magnitude of the wind vector difference over screened reports (kt)
against the main reference or pool, the same reports before and after; it is computed from the data
of the fit (the field test uses held-out data).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from airswing.compass.plausibility import heading_kind_warnings, plausibility_warnings
from airswing.config import Config
from airswing.evaluation import Evaluation
from airswing.evaluation.monitoring.changes import change_warnings
from airswing.flags import STATUS
from airswing.products.whole_files import workspace
from airswing.units import NORMAL_95
from airswing.workflow.job import Job
from airswing.workflow.months import make_headings
from airswing.workflow.stages import make_corrected, make_evaluation, make_fits

if TYPE_CHECKING:
    from airswing.report.run.selection import BeforeAfter

Summary = dict[str, Any]
"""Main results of a run, as printed by ``airswing run --json``."""


@dataclass(frozen=True, repr=False)
class Results:
    """Products of a run.

    Attributes
    ----------
    output : Path
        Folder of the products.
    headings, corrected : Dataset
        Reports of all months, lazy.
    fits : Dataset
        Deviations and tables of every aircraft.
    evaluation : Evaluation
        Evaluation of the corrections.
    summary : dict
        Output of ``airswing run --json``.
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
        return dict(self.summary["months"])

    @property
    def page(self) -> Path:
        """The page that shows the results."""
        return self.output / "report" / "index.html"

    def __repr__(self) -> str:
        reports, status = self.summary["reports"], self.summary["status"]
        months = ", ".join(f"{len(names)} {state}" for state, names in self.months.items())
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
    """Run every stage and write every product and the page.

    Parameters
    ----------
    config : Config, str or path
        A configuration, or the path of its file.
    output : str or path, optional
        Folder of the products, in place of the configuration's.
    fresh : bool, default False
        Remake every month; by default months whose inputs are unchanged are kept.
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
        The configuration or the data cannot be used; the message states the remedy.

    Examples
    --------
    >>> results = airswing.run("configs/quickstart.yaml", output=folder)
    >>> results.fits["status"].dims
    ('reference', 'aircraft')
    """
    job = Job.of(config, output=output, fresh=fresh, quiet=quiet, scheduler=scheduler)
    with job.running():
        return run_job(job)


def run_job(job: Job) -> Results:
    """The main job on the scheduler that is in use; see :func:`run`."""
    from airswing.report.run.page import write_page
    from airswing.report.run.selection import disagreement

    with workspace(job.output):
        headings = make_headings(job)
        fits = make_fits(job, headings)
        corrected = make_corrected(job, fits)
        differences = disagreement(headings, corrected, job.reference)
        summary = summarise(job, headings, fits, differences)
        evaluation = make_evaluation(job, headings, fits, corrected)
        if evaluation.monitoring is not None:
            summary["events"] = len(evaluation.monitoring.events)
            summary["watched"] = evaluation.monitoring.text
        with job.progress.stage("page") as stage:
            page = write_page(
                job.output / "report",
                headings=headings,
                fits=fits,
                corrected=corrected,
                summary=summary,
                evaluation=evaluation,
                disagreement=differences,
            )
            stage.note = str(page)
    return Results(job.output, headings, fits, corrected, evaluation, summary)


def summarise(job: Job, headings: xr.Dataset, fits: xr.Dataset, wind: BeforeAfter) -> Summary:
    """Collect the main results of a run.

    ``reference``, ``reports``, ``aircraft``, ``months``, counts by ``status``, ``disagreement_kt``
    before and after, ``warnings``, and under ``fits`` an entry for each aircraft (degrees, kt).
    """
    from airswing.report.run.reading_warnings import reading_warnings, reference_warnings, tally
    from airswing.report.run.selection import kept_reports, screening_warnings, status_counts

    names = ["offset", "amplitude", "phase"]
    names += [f"{name}_standard_error" for name in names]
    status = {code: name for name, code in STATUS.items()}
    selected = fits.sel(reference=job.reference)
    table = selected[["status", *names, "report_count"]].to_dataframe().reset_index()
    table = table[["aircraft", "status", *names, "report_count"]]
    table = table.rename(columns={"report_count": "reports"}).assign(
        status=table["status"].map(status), before_kt=wind.before, after_kt=wind.after
    )
    reading = tally(headings, "reading_audit")
    return {
        "reference": job.reference,
        "reports": {
            "read": reading.get("reports_read", headings.sizes["report"]),
            "usable": headings.sizes["report"],
            "kept": kept_reports(headings),
        },
        "aircraft": headings.sizes["aircraft"],
        "months": json.loads(headings.attrs.get("months", "{}")),
        "status": status_counts(fits, job.reference),
        "disagreement_kt": {"before": wind.total.before, "after": wind.total.after},
        "warnings": [
            *plausibility_warnings(fits),
            *screening_warnings(headings),
            *reading_warnings(reading),
            *reference_warnings(tally(headings, "reference_audit")),
            *heading_kind_warnings(fits, job.reference),
            *change_warnings(fits),
        ],
        "fits": table.to_dict("records"),
    }


def summary_text(summary: Summary, output: Path) -> str:
    """Lay the summary out for a terminal; `output` is the folder of the products."""
    from airswing.report.run.selection import fitted_text

    reports = summary["reports"]
    before, after = (summary["disagreement_kt"][when] for when in ("before", "after"))
    lines = [
        f"{reports['read']:,} reports read, {reports['kept']:,} kept for the fit against "
        f"{summary['reference']}",
        fitted_text(summary["status"]),
        "",
        "aircraft    amplitude*       phase   offset*          reports   wind disagreement (kt)  "
        "status",
    ]
    for fit in summary["fits"]:
        wide = [NORMAL_95 * fit[f"{name}_standard_error"] for name in ("amplitude", "offset")]
        winds = (fit[f"{when}_kt"] for when in ("before", "after"))
        lines.append(
            f"{fit['aircraft']:<10} {_digits('{:6.2f} +- {:4.2f}', fit['amplitude'], wide[0])} "
            f"{_digits('{:8.1f}', fit['phase'])} "
            f"{_digits('{:8.2f} +- {:4.2f}', fit['offset'], wide[1])} {fit['reports']:9,}   "
            f"{_digits('{:7.2f} -> {:5.2f}', *winds)}         {fit['status']}"
        )
    lines.append("* degrees, with 95 % intervals")
    months = "; ".join(
        f"months {state}: "
        + (", ".join(names) if len(names) < 5 else f"{len(names)}, {names[0]} to {names[-1]}")
        for state, names in summary.get("months", {}).items()
        if names
    )
    for paragraph in (summary.get("warnings"), summary.get("watched"), months):
        if paragraph:
            lines += ["", *([paragraph] if isinstance(paragraph, str) else paragraph)]
    lines += [
        "",
        f"mean wind vector disagreement of the corrected reports: {before:.2f} kt before, "
        f"{after:.2f} kt after (same data as the fit)"
        if np.isfinite(before)
        else "no report could be corrected",
        f"products: {output}",
        f"page:     {output / 'report' / 'index.html'}",
    ]
    return "\n".join(lines)


def _digits(form: str, *values: float) -> str:
    text = form.format(*values)
    return text if np.isfinite(values).all() else "-".rjust(len(form.format(*[0.0] * len(values))))
