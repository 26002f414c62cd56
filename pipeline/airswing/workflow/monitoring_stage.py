"""Monitoring of the fleet: events since the last run: ``events.json`` and its page."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from airswing.products.netcdf import product_path
from airswing.products.ragged import aircraft_of_report, blocks, some_reports
from airswing.workflow.job import CORRECTED, EVENTS, FITS, HEADINGS, Job, main_reference, ready

if TYPE_CHECKING:
    from airswing.evaluation.monitoring.events import Monitoring, UnitTable

PAGE = "monitoring.html"


def make_monitoring(
    job: Job,
    headings: xr.Dataset | None = None,
    fits: xr.Dataset | None = None,
    corrected: xr.Dataset | None = None,
) -> Monitoring:
    """States of the aircraft and events: ``events.json``, and the page that shows them.

    An event that ``events.json`` of an earlier run has is not reported again.

    Parameters
    ----------
    job : Job
    headings, fits, corrected : Dataset, optional
        Opened from the output folder when not given; corrected winds only where they are there.
    """
    from airswing.evaluation.monitoring.events import (
        changed_since,
        find_events,
        read_events,
        read_tables,
        with_tables,
        write_events,
    )
    from airswing.report.run.changes import write_monitoring_page

    path, reference = job.output / EVENTS, main_reference(job.config)
    in_use = job.config.monitoring.tables_in_use
    with job.progress.stage("monitoring") as stage:
        tables = None if in_use is None else read_tables(in_use, reference=reference)
        screened, fitted = ready(job, headings, HEADINGS), ready(job, fits, FITS)
        if corrected is None and product_path(job.output, CORRECTED).exists():
            corrected = ready(job, None, CORRECTED)
        found = find_events(
            screened,
            fitted,
            corrected=corrected,
            previous=read_events(path) if path.exists() else None,
            reference=reference,
            members=job.config.pools()[reference],
            tables_in_use=tables,
            compass=job.shared.get("compass_watch"),
        )
        found = with_tables(found, _tables_since(job, screened, changed_since(found)))
        found = replace(found, unsaid=len(found.new_events))
        write_events(found, path)
        write_monitoring_page(job.output / "report" / PAGE, found, units=job.config.units)
        number = len(found.new_events)
        stage.note = f"{number:,} new event{'s' * (number != 1)}"
    return found


def events_said(job: Job, number: int) -> None:
    """Note that the events have been printed.

    Parameters
    ----------
    job : Job
    number : int
        Of all events, as of :func:`make_monitoring`; a later run may have found more.
    """
    from airswing.evaluation.monitoring.events import read_events, write_events

    path = job.output / EVENTS
    found = read_events(path)
    if found.unsaid:
        left = min(max(len(found.events) - number, 0), found.unsaid)
        write_events(replace(found, unsaid=left), path)


def _tables_since(
    job: Job, headings: xr.Dataset, since: dict[str, str]
) -> dict[str, UnitTable | None]:
    """Tables of aircraft whose compass changed, from the reports since; None where they are few.

    These aircraft are fitted alone: the others' evidence on the reference's error is left out,
    which widens the tables' errors.
    """
    from airswing.compass.fit.deviation import fit_deviation
    from airswing.compass.table import add_tables
    from airswing.evaluation.monitoring.events import tables_of
    from airswing.products.ragged import joined

    if not since:
        return {}
    config = job.config
    names = headings["aircraft"].to_numpy().astype(str)
    begin = np.array([since.get(name, "NaT") for name in names], dtype="datetime64[ns]")
    parts, first = [], 0
    for block in blocks(headings):
        since_day = begin[first : first + block.sizes["aircraft"]]
        first += since_day.size
        if not np.isnat(since_day).all():  # no time is later than a missing one
            late = block["time"].to_numpy() >= since_day[aircraft_of_report(block)]
            parts.append(some_reports(block, late))
    recent = joined(parts)
    recent = recent.isel(aircraft=np.isin(recent["aircraft"].to_numpy().astype(str), list(since)))
    fits = add_tables(
        fit_deviation(recent, pools=config.pools(), **config.fit.model_dump()),
        recent,
        resolution=math.degrees(config.table.resolution),
    ).compute()
    now = tables_of(fits.sel(reference=main_reference(config)))
    return dict.fromkeys(since) | {name: now[name] for name in since if name in now}
