"""From files to screened headings: read, catalogue, plan, collocate, derive, screen.

Takes the configuration, calls the package's own functions with plain arguments and writes
``headings.nc``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.fingerprint import code_digest, file_identities, fingerprint
from airswing.products import as_stored, read_product
from airswing.workflow.job import COLLOCATING, HEADINGS, Job, product

if TYPE_CHECKING:
    from airswing.reference.catalogue import Catalogue
    from airswing.reference.planning import Plan


def plan_run(job: Job) -> dict[str, Any]:
    """Say what a run would read and cost; nothing is decoded and nothing written.

    Parameters
    ----------
    job : Job

    Returns
    -------
    dict
        Per reference what :func:`airswing.reference.planning.plan` counts; ``reports``, and
        estimates ``seconds`` and ``memory_bytes`` from this package's own benchmarks.
    """
    from airswing.cost import estimate

    reports = read(job)
    models = catalogues(job, list(job.config.references))
    asked = job.config.collocation
    options = {"max_time_gap": asked.max_time_gap, "sparse": asked.sparse, "derivatives": False}
    plans = plans_of(job, reports, models, options)
    return {
        "reports": reports.sizes["report"],
        "aircraft": reports.sizes["aircraft"],
        **estimate(reports.sizes["report"], plans),
        "references": {name: one.as_dict() for name, one in plans.items()},
    }


def read(job: Job) -> xr.Dataset:
    """Read the aircraft reports the configuration names.

    Parameters
    ----------
    job : Job

    Returns
    -------
    Dataset
        Canonical reports.
    """
    from airswing.reports.read import read_reports

    asked = job.config.reports
    with job.progress.stage("reports") as stage:
        reports = read_reports(
            asked.files, format=asked.format, columns=asked.columns, on_bad_file=asked.on_bad_file
        )
        stage.note = f"{reports.sizes['report']:,} reports of {reports.sizes['aircraft']} aircraft"
        stage.reports = reports.sizes["report"]
        stage.octets = sum(size for _, size, _ in file_identities(asked.files))
    return reports


def catalogues(job: Job, names: list[str]) -> dict[str, Catalogue]:
    """Catalogue the GRIB folders of some references.

    Parameters
    ----------
    job : Job
    names : list of str

    Returns
    -------
    dict of str to Catalogue
    """
    from airswing.reference.catalogue import build_catalogue

    found = {}
    with job.progress.stage("catalogue") as stage:
        for name in names:
            asked = job.config.references[name]
            found[name] = build_catalogue(
                asked.files, name=name, lead=asked.lead, on_bad_file=asked.on_bad_file
            )
        stage.note = ", ".join(
            f"{name} {len(model):,} model times" for name, model in found.items()
        )
    for name, model in found.items():
        for note in model.notes:
            job.progress.say(f"  {name}: {note}")
    return found


def plans_of(
    job: Job, reports: xr.Dataset, models: dict[str, Catalogue], options: dict[str, Any]
) -> dict[str, Plan]:
    """What the collocation will read, and which reports have no model.

    Parameters
    ----------
    job : Job
    reports : Dataset
    models : dict of str to Catalogue
    options : dict
        ``max_time_gap``, ``sparse`` and ``derivatives`` of the collocation.

    Returns
    -------
    dict of str to Plan
    """
    from airswing.cost import stage_seconds
    from airswing.reference.planning import plan

    with job.progress.stage("plan") as stage:
        plans = plan(reports, models, **options)
        messages = sum(one.messages for one in plans.values())
        stage.note = f"{messages:,} messages to read"
    job.progress.expected = stage_seconds(
        reports.sizes["report"], plans, threads=job.progress.threads
    )
    return plans


def collocated_headings(job: Job, *, names: list[str], derivatives: bool = False) -> xr.Dataset:
    """Reports with model winds and headings, not yet screened or written.

    Parameters
    ----------
    job : Job
    names : list of str
        References to sample.
    derivatives : bool, default False
        Also sample the reference wind's derivatives, which the gap diagnosis needs.

    Returns
    -------
    Dataset
        In memory; ``reading_audit`` and ``reference_audit`` in the attributes.
    """
    from airswing.compass.headings import derive_headings
    from airswing.reference.collocate import ACCOUNT, collocate
    from airswing.reference.planning import require_overlap

    reports = read(job)
    models = catalogues(job, names)
    asked = job.config.collocation
    options: dict[str, Any] = {
        "max_time_gap": asked.max_time_gap,
        "sparse": asked.sparse,
        "derivatives": derivatives,
    }
    plans = plans_of(job, reports, models, options)
    require_overlap(plans)
    with job.progress.stage("collocate") as stage:
        winds = collocate(reports, models, store=job.store, account=True, **options).compute()
        matched = ", ".join(f"{name} {one.matched:,}" for name, one in plans.items())
        stage.note = f"reports within the model: {matched}"
        stage.reports = max(one.matched for one in plans.values())
        stage.messages = int(winds["decoded_messages"].sum())
        stage.octets = int(winds["decoded_bytes"].sum())
        stage.decoding = float(winds["decoding_seconds"].sum())
    unread = winds["unread_messages"].to_series().to_dict()
    with job.progress.stage("headings") as stage:
        headings = derive_headings(reports, winds.drop_vars(list(ACCOUNT))).compute()
        stage.reports = headings.sizes["report"]
    headings.attrs["reference_audit"] = {
        name: plans[name].as_dict()
        | {"notes": model.notes, "skipped": model.skipped, "unread_messages": unread[name]}
        for name, model in models.items()
    }
    return headings


def make_headings(job: Job) -> xr.Dataset:
    """Reports, model winds, headings and screening: ``headings.nc``.

    Parameters
    ----------
    job : Job

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If no report is left after screening.
    """
    from airswing.compass.screening import mark_corrected_units, screen

    config = job.config
    names = list(config.references)
    unscreened = fingerprint(
        config.model_dump(include={"reports", "references", "collocation"}),
        file_identities(config.reports.files),
        [file_identities(model.files) for model in config.references.values()],
        code_digest(*COLLOCATING),
    )

    def make() -> xr.Dataset:
        headings = _unscreened(job, unscreened)
        if headings is None:
            if not job.resume:
                job.clear_store()
            headings = as_stored(collocated_headings(job, names=names))
        headings.attrs["unscreened_fingerprint"] = unscreened
        with job.progress.stage("screen") as stage:
            headings = screen(headings, **config.screening.model_dump())
            if config.field_test is not None:
                test = config.field_test
                headings = mark_corrected_units(
                    headings,
                    aircraft=test.corrected,
                    start=np.datetime64(test.start),
                    end=None if test.end is None else np.datetime64(test.end),
                )
            kept = int((headings["screening"] == 0).sum())
            stage.note = f"{kept:,} of {headings.sizes['report']:,} reports kept"
            stage.reports = kept
        require_kept(headings)
        return headings

    headings = product(
        job,
        HEADINGS,
        make,
        title="Heading errors of aircraft reports against model winds",
        depends=(
            unscreened,
            config.model_dump(include={"screening", "field_test"}),
            code_digest("airswing.compass.screening"),
        ),
    )
    job.clear_store()
    return headings


def require_kept(headings: xr.Dataset) -> None:
    """Refuse to go on when screening left nothing, and say which rules did it.

    Parameters
    ----------
    headings : Dataset
        Screened.

    Raises
    ------
    InputError
    """
    from airswing.compass.screening import audit

    if bool((headings["screening"] == 0).any()):
        return
    total = audit(headings)["together"].sum("aircraft").to_series()
    found = ", ".join(f"{rule} {count:,}" for rule, count in total[total > 0].items())
    raise InputError(
        "screening left no report",
        field="screening",
        found=f"of {headings.sizes['report']:,} reports, left out by {found}",
        remedy="Loosen the rule that removed most, or check the reports",
    )


def _unscreened(job: Job, mark: str) -> xr.Dataset | None:
    """Reports with model winds of an earlier run that still hold, to be screened anew."""
    path = job.output / HEADINGS
    if not (job.resume and path.exists()):
        return None
    found = read_product(path)
    if found.attrs.get("unscreened_fingerprint") != mark:
        return None
    job.progress.say(f"{HEADINGS}: model winds kept, screened anew")
    return found.drop_vars("screening")
