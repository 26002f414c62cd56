"""The watch over the fleet: what happened since the last time, told once: ``events.json``.

Takes the products of ``airswing run`` or, by months, of ``airswing update``; nothing is decoded.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from airswing.products.monthly import joined_months
from airswing.products.netcdf import read_product
from airswing.products.ragged import aircraft_of_report
from airswing.workflow.job import CORRECTED, FITS, HEADINGS, Job, main_reference

if TYPE_CHECKING:
    from airswing.evaluation.monitoring import Monitoring, UnitTable

EVENTS, PAGE = "events.json", "monitoring.html"


def make_monitoring(job: Job, fits: xr.Dataset | None = None) -> Monitoring:
    """States of the aircraft and events: ``events.json``, and the page that shows them.

    Parameters
    ----------
    job : Job
        Headings, and corrected winds where there are any, stand in its folder.
    fits : Dataset, optional
        Read from the output folder when not given.
    """
    from airswing.evaluation.monitoring import (
        changed_since,
        find_events,
        read_events,
        read_tables,
        with_tables,
        write_events,
    )
    from airswing.report.run.monitoring_section import write_monitoring_page

    path, reference = job.output / EVENTS, main_reference(job.config)
    with job.progress.stage("monitoring") as stage:
        fits = read_product(job.output / FITS) if fits is None else fits
        board = job.config.monitoring.tables_in_use
        previous = read_events(path) if path.exists() else None
        tables = None if board is None else read_tables(board, reference=reference)
        headings = _of_all_months(job, HEADINGS)
        found = find_events(
            read_product(job.output / HEADINGS) if headings is None else headings,
            fits,
            corrected=_of_all_months(job, CORRECTED),
            previous=previous,
            reference=reference,
            members=job.config.pools()[reference],
            tables_in_use=tables,
        )
        found = with_tables(found, _tables_since(job, changed_since(found)))
        found = replace(found, unsaid=len(found.new_events))
        write_events(found, path)
        write_monitoring_page(job.output / "report" / PAGE, found)
        number = len(found.new_events)
        stage.note = f"{number:,} new event{'s' * (number != 1)}"
    return found


def events_said(job: Job, number: int) -> None:
    """Note that the lines of the events have been said.

    Parameters
    ----------
    number : int
        Of all events, as of :func:`make_monitoring`; a later look may have found more.
    """
    from airswing.evaluation.monitoring import read_events, write_events

    path = job.output / EVENTS
    found = read_events(path)
    if found.unsaid:
        left = min(max(len(found.events) - number, 0), found.unsaid)
        write_events(replace(found, unsaid=left), path)


def _tables_since(job: Job, since: dict[str, str]) -> dict[str, UnitTable | None]:
    """Tables of aircraft whose compass changed, of the reports since; none where they are few.

    These aircraft are fitted by themselves: what the others tell of the reference's error is left
    out, which widens the tables' errors.
    """
    from airswing.compass.fit.deviation import fit_sums, sum_aircraft
    from airswing.compass.table import add_tables, heading_histogram
    from airswing.evaluation.monitoring import tables_of
    from airswing.workflow.update.month_sums import chosen_blocks

    if not since:
        return {}
    config, whole = job.config, job.output / HEADINGS
    months = sorted(whole.with_suffix("").glob("*.nc"))
    late = [month for month in months if month.stem >= min(since.values())[:7]]
    headings = joined_months([read_product(path, lazy=True) for path in late or [whole]])
    parts, histograms = [], []
    for block in chosen_blocks(headings, set(since)):
        own = _since(block, since)
        parts.append(sum_aircraft(own, pools=config.pools(), **config.fit.model_dump()))
        histograms.append(heading_histogram(own, abscissa=config.fit.abscissa))
    found: dict[str, UnitTable | None] = dict.fromkeys(since)
    if parts:
        fits = add_tables(
            fit_sums(parts),
            np.concatenate(histograms),
            resolution=math.degrees(config.table.resolution),
        )
        now = tables_of(fits.sel(reference=main_reference(config)))
        found |= {name: now[name] for name in since if name in now}
    return found


def _since(headings: xr.Dataset, since: dict[str, str]) -> xr.Dataset:
    """Headings in memory with the reports before each aircraft's day marked as not to be used."""
    from airswing.flags import SCREENING

    first = [since.get(name, "0001-01-01") for name in headings["aircraft"].to_numpy().astype(str)]
    begin = np.array(first, dtype="datetime64[D]")[aircraft_of_report(headings)]
    # the Dataset is the caller's, and its screening stays as it is
    screening = headings["screening"].to_numpy().copy()
    screening[headings["time"].to_numpy() < begin] |= SCREENING["no_reference"]
    return headings.assign(screening=("report", screening))


def _of_all_months(job: Job, name: str) -> xr.Dataset | None:
    """A product of every report: the single file, or all months joined, lazily."""
    whole = job.output / name
    months = sorted(whole.with_suffix("").glob("*.nc"))
    if months:
        return joined_months([read_product(path, lazy=True) for path in months])
    return read_product(whole, lazy=True) if whole.exists() else None
