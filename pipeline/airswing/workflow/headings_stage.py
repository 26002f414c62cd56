"""Screened headings: ``headings.nc``, and the plan of a run.

Takes what :mod:`airswing.workflow.collocating` makes, some aircraft at a time, screens it and
writes it as it comes.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import xarray as xr

from airswing.products.fingerprint import code_digest, file_identities, fingerprint
from airswing.products.netcdf import as_stored
from airswing.products.ragged import blocks
from airswing.workflow.collocating import (
    Sources,
    catalogues,
    collocated_blocks,
    needs_of,
    read,
    set_places_down,
    written_to,
)
from airswing.workflow.gap_inputs import MARK, inputs_hold, set_apart
from airswing.workflow.job import (
    COLLOCATING,
    HEADINGS,
    Blocks,
    Job,
    earlier,
    ragged_product,
)

if TYPE_CHECKING:
    from airswing.config import Config
    from airswing.workflow.cost import ReferencePlan, RunPlan
    from airswing.workflow.progress import StageRecord


def plan_run(job: Job) -> RunPlan:
    """Say what a run would read and cost; nothing is decoded and nothing kept.

    Returns
    -------
    dict
        Per reference what :func:`airswing.reference.planning.plan` counts; ``reports``, and
        estimates ``seconds``, ``memory_bytes``, ``disk_bytes`` and ``kept_disk_bytes`` from this
        package's own benchmarks. With ``resume`` the cost is of what an earlier run left to do, and
        ``kept_messages`` of each reference are not read again.
    """
    from airswing.reference.store import SampleStore
    from airswing.workflow.cost import estimate

    # without --resume a run reads everything again
    kept = SampleStore(job.store) if job.resume else None
    with tempfile.TemporaryDirectory() as name:
        archive = read(job, Path(name))
        models = catalogues(job, list(job.config.references), archive, Path(name))
        places = set_places_down(archive, Path(name) / "blocks")
        with job.progress.stage("plan"):
            needs = needs_of(job, places, models, kept=kept)
    sparse = job.config.collocation.sparse
    plans = {name: need.plan(name, models[name], sparse=sparse) for name, need in needs.items()}
    left = {
        name: need.plan(name, models[name], sparse=sparse, left=True)
        for name, need in needs.items()
    }
    return {
        "reports": archive.reports,
        "aircraft": archive.aircraft,
        **estimate(
            archive.reports,
            archive.aircraft,
            plans,
            left=left,
            block=archive.largest,
            keep=job.config.compute.keep_samples,
        ),
        "references": {
            name: cast(
                "ReferencePlan",
                one.as_dict() | {"kept_messages": one.messages - left[name].messages},
            )
            for name, one in plans.items()
        },
    }


def make_headings(job: Job, given: Sources | None = None) -> xr.Dataset:
    """Reports, model winds, headings and screening: ``headings.nc``, and ``gap_inputs.nc``.

    Parameters
    ----------
    given : Sources, optional
        Reports and models; by default what the configuration names, read and catalogued.

    Returns
    -------
    Dataset
        Read lazily. Where screening left no report it is written all the same: the model's winds at
        the reports are in it.
    """
    names = list(job.config.references)
    # two hashes: with other screening alone the model winds still hold, and hours of reading
    unscreened, *screened = depends_on(job.config, given)
    beside = inputs_hold(job, unscreened)

    def make() -> Blocks:
        made = _unscreened(job, unscreened) if beside else None
        if made is None:
            job.begin_store()
            made = _collocated(job, names, given)
            # before the screening: the derivatives are of all reports, whatever is screened out of
            # them later
            made = set_apart(job, made, unscreened if made.whole else "")
        # a run whose model files were lost on the way must be found stale by the next
        made.attrs[MARK] = unscreened if made.whole else ""
        return _screened(job, made)

    headings = ragged_product(
        job,
        HEADINGS,
        make,
        title="Heading errors of aircraft reports against model winds",
        depends=(unscreened, *screened),
        whole=beside,
    )
    # only now: until the product stands, finished model times are what a killed run goes on with
    job.end_store()
    return headings


def depends_on(config: Config, given: Sources | None = None) -> tuple[str, *tuple[object, ...]]:
    """All that ``headings.nc`` depends on.

    Parameters
    ----------
    given : Sources, optional
        As for :func:`make_headings`.

    Returns
    -------
    tuple
        First the hash of the reports, the references and how they are collocated, which
        ``gap_inputs.nc`` depends on alone.
    """
    files = (
        file_identities(config.reports.files),
        [file_identities(model.files) for model in config.references.values()],
    )
    unscreened = fingerprint(
        config.model_dump(include={"reports", "references", "collocation"}),
        *(files if given is None else (given.mark,)),
        code_digest(*COLLOCATING),
    )
    return (
        unscreened,
        config.model_dump(include={"screening", "field_test"}),
        code_digest("airswing.compass.screening"),
    )


def _collocated(job: Job, names: list[str], given: Sources | None) -> Blocks:
    """Headings against some references; those of an earlier run that still hold are taken up."""
    from airswing.compass.kept_headings import KeptHeadings, Record

    found = earlier(job, job.place(HEADINGS))
    kept = KeptHeadings(found, Record.read(job.record))
    made = collocated_blocks(job, names=names, kept=kept, given=given)

    def each(stage: StageRecord) -> Iterator[xr.Dataset]:
        with contextlib.closing(found) if found is not None else contextlib.nullcontext():
            yield from made.each(stage)
        if kept.taken_up:
            job.progress.say(
                f"  headings of {kept.taken_up:,} reports are those of the earlier run"
            )

    def written(uuid: str) -> None:
        if job.config.compute.keep_samples:
            with written_to(job.store):
                kept.record(uuid).write(job.record)

    return replace(made, each=each, written=written)


def _screened(job: Job, made: Blocks) -> Blocks:
    """Mark what the fit should not use, as the blocks come by."""
    from airswing.compass.screening import audit, mark_corrected_units, screen

    config = job.config

    def each(stage: StageRecord) -> Iterator[xr.Dataset]:
        kept, removed = 0, xr.DataArray(0)
        for block in made.each(stage):
            # as stored: screening at full precision could differ from screening what is read again
            headings = screen(as_stored(block), **config.screening.model_dump())
            if config.field_test is not None:
                test = config.field_test
                headings = mark_corrected_units(
                    headings,
                    aircraft=test.corrected,
                    start=np.datetime64(test.start),
                    end=None if test.end is None else np.datetime64(test.end),
                )
            kept += int((headings["screening"] == 0).sum())
            removed = removed + audit(headings)["together_total"]
            yield headings
        # known when the last block has come by: attributes are written after the variables
        made.attrs["kept_reports"] = kept
        made.attrs["screened_out"] = removed.to_series().to_dict() if made.reports else {}
        stage.note = f"{kept:,} of {made.reports:,} reports kept"
        stage.reports = made.reports

    return replace(made, each=each)


def _unscreened(job: Job, mark: str) -> Blocks | None:
    """Reports with model winds of an earlier run that still hold, to be screened anew."""
    from airswing.compass.kept_headings import Record

    found = earlier(job, job.place(HEADINGS))
    if found is None:
        return None
    if found.attrs.get(MARK) != mark:
        found.close()
        return None
    job.progress.say(f"{HEADINGS}: model winds kept, screened anew")
    kept, record = found.drop_vars("screening"), Record.read(job.record)

    def written(uuid: str) -> None:
        # the record tells which rows an earlier run derived, and is of that product alone
        if record is not None and record.product == found.attrs["uuid"]:
            with written_to(job.store):
                record._replace(product=uuid).write(job.record)

    return Blocks(
        found.sizes["report"],
        found.sizes["aircraft"],
        lambda _: blocks(kept),
        "screen",
        dict(found.attrs),
        written,
    )
