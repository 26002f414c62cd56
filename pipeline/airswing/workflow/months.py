"""Headings by month: the month is the unit of work of a run.

A month (UTC) contains the complete flights whose first report lies in it: it is made from the
reports of the month and `MARGIN` around it, and written as ``headings/2008-07.nc``. Its inputs are
recorded: the reports (a hash of their rows by day, independent of their files), the model files
(path, size, time of change and a hash of parts of the content), the settings and the code. A month
with unchanged inputs is kept.

Assumes that a file that keeps its path, size and time of change keeps its content, and that no
flight lasts longer than `MARGIN`. Whether reported headings and airspeeds are used is judged month
by month. New model files cause a month to be remade, removed ones do not.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from airswing.compass.headings import derive_headings
from airswing.compass.screening import audit as screening_counts
from airswing.compass.screening import mark_corrected_units, screen
from airswing.errors import InputError
from airswing.evaluation.field_test import require_aircraft
from airswing.products.netcdf import as_stored, open_product, read_product
from airswing.products.ragged import BLOCK_REPORTS, FLIGHTS
from airswing.products.whole_files import code_digest, fingerprint, read_note, write_json
from airswing.reference.catalogue import Catalogue, build_catalogue
from airswing.reference.collocate import ACCOUNT, PROBLEMS, collocate, overlap, require_overlap
from airswing.reference.files import is_lost_file
from airswing.reference.fleet_wind import fleet_wind
from airswing.report.run.reading_warnings import model_warnings, reading_warnings, tally, unread
from airswing.reports import Audit, assemble, read_file
from airswing.reports.audit import similar
from airswing.reports.read import read_each
from airswing.workflow.job import CORRECTED, HEADINGS, Job

MARGIN = np.timedelta64(2, "D")
"""Time around a month in which its flights may have reports."""
_CHECKED_FIRST = 100_000
"""Reports whose times and places are compared with the models before anything is decoded."""


def make_headings(job: Job) -> xr.Dataset:
    """Reports, model winds, headings and screening of every month: ``headings/2008-07.nc``.

    Months whose inputs are unchanged are kept, unless the job is fresh. The Dataset of all months
    is lazy; its attribute ``months`` (JSON) has those ``made`` and ``kept``. Months without a
    screened report are included, with the model's winds.
    """
    with job.progress.stage("reports") as stage:
        archive = ReportArchive(job)
        number = len(archive.files)
        stage.note = f"{archive.count:,} reports in {number:,} file{'s' * (number != 1)}"
    for warning in reading_warnings(archive.audit.as_dict()):
        job.progress.say(f"  {warning}")
    models, config = catalogues(job), job.config
    without_files: Any = {"reports": {"files"}, "references": {"__all__": {"files"}}}
    asked = config.model_dump(
        include={"reports", "references", "collocation"}, exclude=without_files
    )
    settings = {
        "collocation": fingerprint(asked, code_digest()),
        "screening": fingerprint(config.model_dump(include={"screening", "field_test"})),
    }
    months = [_Month(job, name, archive, models, settings) for name in archive.months]
    if models and not any(month.previous.get("product") for month in months):
        # refuse reports and models without overlap before hours of reading
        for most in (_CHECKED_FIRST, archive.count):
            gap = config.collocation.max_time_gap
            overlaps = overlap(archive.places(most), models, max_time_gap=gap)
            if all(counts["matched"] for counts in overlaps.values()):
                break
        else:
            require_overlap(overlaps)
    for month in months:
        if not month.unchanged:
            month.make()
            archive.release(month.name)
    there = {month.name for month in months if month.previous["product"]}
    for name in (HEADINGS, CORRECTED):
        for path in (job.output / name).glob("*.nc"):
            if path.stem not in there:  # all its reports were withdrawn
                path.unlink()
    if lost := sum(month.lost for month in months):
        job.progress.say(
            f"  model files that vanished or changed before they were read: {lost:,}; their "
            "reports have no wind, the next run reads them again"
        )
    headings = open_product(job.output / HEADINGS)
    headings.attrs["reading_audit"] = archive.audit_of(headings).as_json()
    remade = [month.name for month in months if not month.unchanged and month.name in there]
    unchanged = [month.name for month in months if month.unchanged]
    headings.attrs["months"] = json.dumps({"made": remade, "kept": unchanged})
    return headings


class ReportArchive:
    """The report files of a configuration, cleaned, and the days that each has reports of.

    Files recorded by an earlier run are read only if their reports are needed. ``days`` has, by
    ``file`` and ``day`` since 1970, the number of reports (``count``) and the sum of the hashes of
    their rows (``mark``, modulo 2^64), which is independent of their order.
    """

    def __init__(self, job: Job) -> None:
        self._asked = job.config.reports
        self._read: dict[str, tuple[pd.DataFrame, Audit]] = {}
        key = fingerprint(self._asked.model_dump(exclude={"files"}), code_digest())
        note = read_note(job.notes / "reports.json")
        noted = note["files"] if note.get("key") == key else {}

        def record(path: Path) -> tuple[tuple[str, dict[str, Any]], Audit]:
            status, name = path.stat() if path.exists() else path.lstat(), str(path)
            identity = [status.st_size, status.st_mtime_ns]
            entry = noted.get(name, {})
            if entry.get("identity") != identity:
                frame, audit = self._content(name)
                entry = {"identity": identity, "audit": audit.as_dict(), "days": _days_of(frame)}
                entry["tails"] = frame["tail"].unique().tolist()
            return (name, entry), Audit.from_dict(entry["audit"])

        asked = self._asked
        records, self.audit = read_each(
            asked.files, asked.format, asked.mapping, asked.on_bad_file, record
        )
        self.files: dict[str, dict[str, Any]] = dict(records)  # also for the next run
        if (test := job.config.field_test) is not None:
            # an unknown aircraft is refused before model files are read
            tails = {tail for entry in self.files.values() for tail in entry["tails"]}
            named = [*test.corrected, *test.controls]
            # aircraft that share an identifier are numbered later: N401-1, N401-2
            tails |= {name for name in named if re.sub(r"-\d+$", "", name) in tails}
            require_aircraft(np.array(sorted(tails)), named, "field_test")
        write_json(job.notes / "reports.json", {"key": key, "files": self.files})
        rows = [(name, *row) for name, record in self.files.items() for row in record["days"]]
        self.days = pd.DataFrame(rows, columns=["file", "day", "count", "mark"])
        self.count = int(self.days["count"].sum())  # duplicates included

    def _content(self, name: str) -> tuple[pd.DataFrame, Audit]:
        if name not in self._read:
            asked = self._asked
            self._read[name] = read_file(name, format=asked.format, columns=asked.mapping)
        return self._read[name]

    @property
    def months(self) -> list[str]:
        """Months with reports, as ``2008-07``, in order of time."""
        days = self.days["day"].to_numpy().astype("M8[D]")
        return [str(month) for month in np.unique(days.astype("M8[M]"))]

    def _near(self, month: str) -> pd.DataFrame:
        start, stop = (bound.astype("M8[D]") for bound in _month_bounds(month))
        first, last = (start - MARGIN).astype(int), (stop + MARGIN).astype(int) - 1
        return self.days[self.days["day"].between(first, last)]

    def mark(self, month: str) -> list[list[int]]:
        """Day, reports and hash of their rows for the days around a month."""
        by_day = self._near(month).groupby("day")[["count", "mark"]].sum()
        return list(by_day.reset_index().to_numpy().tolist())

    def around(self, month: str) -> list[pd.DataFrame]:
        """Cleaned reports of the days around a month, one table a file."""
        start, stop = _month_bounds(month)
        tables = []
        for name in self._near(month)["file"].unique():
            frame, _ = self._content(name)
            inside = frame["time"].between(start - MARGIN, stop + MARGIN, inclusive="left")
            tables.append(frame if inside.all() else frame[inside])
        return tables

    def release(self, month: str) -> None:
        """Drop the reports of files that no later month needs."""
        _, stop = _month_bounds(month)
        later = self.days["day"] >= (stop - MARGIN).astype("M8[D]").astype(int)
        for name in set(self._read).difference(self.days["file"][later]):
            del self._read[name]

    def places(self, most: int) -> xr.Dataset:
        """Times and places of at most ``most`` reports, evenly selected from all files."""
        step = max(1, self.count // most)
        columns = ["time", "latitude", "longitude", "pressure"]
        every = pd.concat([self._content(name)[0][columns][::step] for name in self.files])
        return xr.Dataset({name: ("report", every[name].to_numpy()) for name in columns})

    def audit_of(self, headings: xr.Dataset) -> Audit:
        """Counts of the reading of all files, and of the assembly of the months."""
        total, assembled = Audit(), Audit.from_dict(tally(headings, "reading_audit"))
        total.add(self.audit)
        assembled.read = 0  # reports read are counted with their files
        total.add(assembled)
        total.similar_tails = similar(map(str, headings["aircraft"].to_numpy()))
        return total


def _days_of(frame: pd.DataFrame) -> list[list[int]]:
    """Day, number of reports and hash of their rows, for each day of a table."""
    day = frame["time"].to_numpy().astype("M8[D]").astype(np.int64)
    marks = pd.util.hash_pandas_object(frame, index=False).astype(np.int64)
    return list(marks.groupby(day).agg(["size", "sum"]).reset_index().to_numpy().tolist())


def _month_bounds(month: str) -> tuple[np.datetime64, np.datetime64]:
    """Begin of a month such as ``2008-07`` and of the next one, datetime64[ns]."""
    begin = np.datetime64(month, "M")
    return begin.astype("M8[ns]"), (begin + 1).astype("M8[ns]")


def catalogues(job: Job) -> dict[str, Catalogue]:
    """Catalogue the files of every reference with files, once for a job."""
    # a simulation on other paths shares the results of its job, but may have other references
    key = f"catalogues of {job.config.references!r}"
    if key in job.shared:
        shared: dict[str, Catalogue] = job.shared[key]
        return shared
    models = {}
    with job.progress.stage("catalogue") as stage:
        for name, asked in job.config.references.items():
            if asked.engine == "fleet":
                continue
            models[name] = build_catalogue(
                asked.files,
                name=name,
                lead=asked.lead,
                member=asked.member,
                on_bad_file=asked.on_bad_file,
                engine=str(asked.engine),
                naming=asked.naming(),
            )
        stage.note = ", ".join(
            f"{name} {len(model):,} model times" for name, model in models.items()
        )
    for name, model in models.items():
        for note in [*model_warnings(model.skipped), *model.notes]:
            job.progress.say(f"  {name}: {note}")
    job.shared[key] = models
    return models


def _files_between(model: Catalogue, start: np.datetime64, stop: np.datetime64) -> list[str]:
    first, last = (int(when.astype("M8[ns]").astype(np.int64)) for when in (start, stop))
    time = np.repeat(model.valid, np.diff(model.bounds))
    numbers = np.unique(model.rows["file"][:2, (time >= first) & (time <= last)]).tolist()
    return sorted("|".join(map(str, model.files[number])) for number in numbers)


class _Month:
    """One month of a run: its inputs, and the results of an earlier run."""

    def __init__(
        self,
        job: Job,
        name: str,
        archive: ReportArchive,
        models: Mapping[str, Catalogue],
        settings: dict[str, str],
    ) -> None:
        self.job, self.name, self.archive, self.models = job, name, archive, models
        self.path = job.output / HEADINGS / f"{name}.nc"
        self._note_path = job.notes / f"{name}.json"
        self.lost = 0  # model files that vanished while they were to be read
        gap = np.timedelta64(round(job.config.collocation.max_time_gap), "s")
        self.bounds = start, stop = _month_bounds(name)
        self.note: dict[str, Any] = {
            "reports": archive.mark(name),
            "models": {
                model: _files_between(catalogue, start - gap, stop + MARGIN + gap)
                for model, catalogue in models.items()
            },
            "settings": settings,
        }
        # record of an earlier run if only the screening differs; else empty
        before = {} if job.fresh else read_note(self._note_path)
        self.previous = before if self._holds(before) else {}
        self.unchanged = bool(self.previous) and self.previous["settings"] == settings

    def _holds(self, before: dict[str, Any]) -> bool:
        """Whether the headings of an earlier run have the same reports and model winds."""
        now, settings = self.note, before.get("settings", {})
        # differs also for a note of another version
        if settings.get("collocation") != now["settings"]["collocation"]:
            return False
        new_files = (set(f) - set(before["models"].get(n, ())) for n, f in now["models"].items())
        if before["reports"] != now["reports"] or any(new_files):
            return False
        if not before["product"] or not self.path.exists():
            return not before["product"]
        try:
            with open_product(self.path) as product:
                return bool(product.attrs["uuid"] == before["product"])
        except InputError:
            self.job.progress.say(f"{self.path.name}: not a product that can be read, made again")
            return False

    def make(self) -> None:
        """Make and record the month's headings, unless no flight begins in it."""
        if self.previous.get("product"):
            self.job.progress.say(f"{self.name}: model winds kept, screening repeated")
            self.note["models"] = self.previous["models"]
            headings: xr.Dataset | None = read_product(self.path).drop_vars("screening")
        else:
            headings = self._collocated()
        uuid = "" if headings is None else self._write(headings)
        self.previous = {**self.note, "product": uuid}
        # a month whose model files were lost during the run must be remade by the next
        if not self.lost:
            write_json(self._note_path, self.previous)

    def _write(self, headings: xr.Dataset) -> str:
        """Screen and write the month; the identifier of the product."""
        config, attrs = self.job.config, headings.attrs
        with self.job.progress.stage(f"headings {self.name}") as stage:
            # threads only: reports and winds are in memory, which other processes do not share
            screened = screen(headings, **config.screening.model_dump())
            headings = screened.compute(scheduler="threads")
            if (test := config.field_test) is not None:
                end = None if test.end is None else np.datetime64(test.end)
                headings = mark_corrected_units(
                    headings, aircraft=test.corrected, start=np.datetime64(test.start), end=end
                )
            counts = screening_counts(headings)["together"].sum("aircraft").to_series()
            passed = int((headings["screening"] == 0).sum())
            headings.attrs = {
                **attrs,
                "kept_reports": passed,
                "screened_out": json.dumps(counts.to_dict()),
            }
            stage.note = f"{passed:,} of {headings.sizes['report']:,} reports kept"
            self._note_path.unlink(missing_ok=True)
            title = "Heading errors of aircraft reports against model winds"
            self.job.write(headings, f"{HEADINGS}/{self.name}.nc", title=title)
            with open_product(self.path) as written:
                return str(written.attrs["uuid"])

    def _collocated(self) -> xr.Dataset | None:
        """Reports of the month with model winds and headings; None without any."""
        parts, audit = self.archive.around(self.name), Audit()
        interval = self.job.config.reports.interval
        reports = assemble(parts, interval=interval, begins=self.bounds, audit=audit)
        if not reports.sizes["report"]:
            return None
        audit.read = reports.sizes["report"] + sum(audit.dropped.values())
        flights = int(reports["flight"].max()) + 1
        winds, audits = self._winds(reports)
        if reports.sizes["report"] > BLOCK_REPORTS:
            # in chunks of whole aircraft, so that the intermediate arrays of few are in memory
            reports = reports.chunk(report=BLOCK_REPORTS).assign(row_size=reports["row_size"])
        headings = as_stored(derive_headings(reports, winds))
        headings.attrs = {
            "featureType": "trajectory",
            "reading_audit": audit.as_json(),
            "reference_audit": json.dumps(audits),
            FLIGHTS: flights,
        }
        return headings

    def _winds(self, reports: xr.Dataset) -> tuple[xr.Dataset, dict[str, Any]]:
        """Model winds at reports, and by reference what could not be read."""
        asked = self.job.config.collocation
        models = {
            name: self.models[name]
            if name in self.models
            else build_catalogue(fleet_wind(reports), name=name)
            for name in self.job.config.references
        }
        with self.job.progress.stage(f"collocate {self.name}") as stage:
            winds = collocate(
                reports,
                models,
                account=True,
                max_time_gap=asked.max_time_gap,
                sparse=asked.sparse,
                derivatives=True,
            ).compute()
            numbers = winds["reference_eastward_wind"].count("report").to_series()
            matched = ", ".join(f"{name} {number:,}" for name, number in numbers.items())
            stage.note = f"reports with winds: {matched}"
        problems = dict(zip(models, winds[PROBLEMS].to_numpy(), strict=True))
        met = (problem for failures in problems.values() for problem in failures)
        self.lost = len({file for _, file, why in met if is_lost_file(why)})
        audits = {
            name: {
                "notes": model.notes,
                "skipped": model.skipped,
                "unread_messages": len(problems[name]),
                "unread": unread(problems[name]),
            }
            for name, model in models.items()
        }
        return winds.drop_vars([*ACCOUNT, PROBLEMS]), audits
