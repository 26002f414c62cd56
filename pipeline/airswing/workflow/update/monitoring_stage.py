"""The watch over the fleet: what happened since the last time, told once: ``events.json``.

Takes the products of ``airswing run`` or, by months, of ``airswing update``; nothing is decoded.
What the days of a month tell is kept beside it, so that a month that stands is not read again.
"""

from __future__ import annotations

import math
import zipfile
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from airswing.products.atomic import replacing
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.monthly import joined_months
from airswing.products.netcdf import read_product
from airswing.products.ragged import aircraft_of_report
from airswing.workflow.job import CORRECTED, FITS, HEADINGS, Job, main_reference

if TYPE_CHECKING:
    from airswing.evaluation.events_file import Monitoring, UnitTable
    from airswing.evaluation.monitoring.daily_evidence import Names, Rows
    from airswing.evaluation.monitoring.fleet_watch import KeptWatch

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
    from airswing.evaluation.monitoring import events_of, read_events, read_tables, write_events
    from airswing.evaluation.monitoring.watch import changed_since, with_tables
    from airswing.report.run.monitoring_section import write_monitoring_page

    path, reference = job.output / EVENTS, main_reference(job.config)
    with job.progress.stage("monitoring") as stage:
        fits = read_product(job.output / FITS) if fits is None else fits
        board = job.config.monitoring.tables_in_use
        previous = read_events(path) if path.exists() else None
        tables = None if board is None else read_tables(board, reference=reference)
        names, rows = _rows(job, job.config.pools()[reference], str(fits.attrs["abscissa"]))
        found = events_of(
            names,
            rows,
            fits.sel(reference=reference),
            previous=previous,
            tables_in_use=tables,
            kept=_kept_watches(job, names),
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
    from airswing.evaluation.monitoring.table_difference import tables_of
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


def _kept_watches(job: Job, names: Names) -> dict[str, KeptWatch]:
    """Where an update keeps how the watch stood when the last month began."""
    from airswing.evaluation.monitoring.fleet_watch import KeptWatch
    from airswing.workflow.update.month_sums import keep_arrays, kept_arrays

    folder = job.output / ".update"
    if not folder.is_dir():
        return {}
    mark = fingerprint(names.tolist(), code_digest("airswing.evaluation.monitoring.fleet_watch"))
    paths = {name: folder / f"{name}.watch.npz" for name in ("compass", "wind")}
    return {
        name: KeptWatch(partial(kept_arrays, path, mark), partial(keep_arrays, path, mark))
        for name, path in paths.items()
    }


def _rows(job: Job, members: list[str], abscissa: str) -> tuple[Names, Rows]:
    """What every day tells, of the single file or of all months."""
    from airswing.evaluation.monitoring.daily_evidence import joined_rows

    whole, winds = (job.output / name for name in (HEADINGS, CORRECTED))
    folder = whole.with_suffix("")
    if not folder.is_dir():
        return _of_file(whole, winds, members, abscissa, kept=None)
    parts = []
    for month in sorted(folder.glob("*.nc")):
        kept = job.output / ".update" / f"{month.stem}.watch.npz"
        corrected = winds.with_suffix("") / month.name
        parts.append(_of_file(month, corrected, members, abscissa, kept=kept))
    return joined_rows(parts)


def _of_file(
    path: Path, winds: Path, members: list[str], abscissa: str, *, kept: Path | None
) -> tuple[Names, Rows]:
    """Rows of a file of headings and its corrected winds, as kept where nothing changed."""
    from airswing.evaluation.monitoring.daily_evidence import daily_rows

    with read_product(path, lazy=True) as headings:
        corrected = read_product(winds, lazy=True) if winds.exists() else None
        uuids = [one.attrs["uuid"] for one in (headings, corrected) if one is not None]
        code = code_digest("airswing.evaluation.monitoring.daily_evidence")
        mark = fingerprint(*uuids, members, abscissa, code)
        names = headings["aircraft"].to_numpy().astype(str)
        rows = None if kept is None else _kept(kept, mark)
        if rows is None:
            rows = daily_rows(headings, members, abscissa=abscissa, corrected=corrected)
            if kept is not None:
                _keep(kept, mark, rows)
        if corrected is not None:
            corrected.close()
    return names, rows


def _keep(path: Path, mark: str, rows: Rows) -> None:
    with replacing(path, lasting=False) as temporary, temporary.open("wb") as stream:
        columns = {one.name: getattr(rows, one.name) for one in fields(rows)}
        np.savez_compressed(stream, mark=np.array(mark), **columns)


def _kept(path: Path, mark: str) -> Rows | None:
    """Rows as kept; None where they are of something else, or damaged."""
    from airswing.evaluation.monitoring.daily_evidence import Rows

    try:
        with np.load(path) as found:
            if str(found["mark"]) != mark:
                return None
            return Rows(**{one.name: found[one.name] for one in fields(Rows)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        # torn, or of another version: what is kept saves time, and is made again
        return None
