"""What every stage of the workflow shares: the job, its products, what they depend on.

A product carries the fingerprint of all it depends on; with ``resume`` a product whose fingerprint
still holds is read instead of made again.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

import xarray as xr

from airswing.config import Config
from airswing.errors import InputError
from airswing.products.fingerprint import fingerprint
from airswing.products.netcdf import provenance, read_product, write_product
from airswing.products.ragged_product import ragged_writer
from airswing.products.whole_files import require_writable
from airswing.report.run.reading_warnings import tally
from airswing.workflow.progress import Progress, StageRecord

HEADINGS, FITS, CORRECTED = "headings.nc", "fits.nc", "corrected.nc"
GAP_INPUTS = "gap_inputs.nc"
PROFILES, FIELD_TEST, SENSITIVITY = "error_profiles.nc", "field_test.json", "sensitivity.json"
OBSERVATION_ERRORS = "observation_errors.nc"

COLLOCATING = (
    "airswing.reports.report_blocks",
    "airswing.reference.places",
    "airswing.reference.grib.catalogue",
    "airswing.reference.collocate",
    "airswing.compass.headings",
)
# Modules whose source, with all they use, a product depends on.
FITTING = (
    "airswing.compass.fit.deviation",
    "airswing.compass.table",
    "airswing.evaluation.monitoring.changes",
)


@dataclass(frozen=True)
class Job:
    """One run: what is asked, who is told, and whether earlier work counts."""

    config: Config
    progress: Progress
    resume: bool = False  # use finished products and model times that still hold
    # as ``2025-07``: the job is of the flights that begin in it, and what it writes of every report
    # stands in a folder by months
    month: str = ""

    @property
    def output(self) -> Path:
        """Folder of the products."""
        return self.config.output

    @property
    def store(self) -> Path:
        """Folder of cleaned reports and finished model times, by which a later run goes on."""
        return self.output / ".collocated" / self.month

    def place(self, name: str) -> Path:
        """Where a product of every report stands.

        Parameters
        ----------
        name : str
            Its file name, as ``headings.nc``; by months ``headings/2025-07.nc``.
        """
        whole = self.output / name
        return whole.with_suffix("") / f"{self.month}.nc" if self.month else whole

    @property
    def record(self) -> Path:
        """Which of the headings' rows a later run can take up, and for what."""
        return self.store / "headings.json"

    def begin_store(self) -> None:
        """Remove what an earlier run kept, unless this one goes on with it."""
        if not self.resume:
            shutil.rmtree(self.store, ignore_errors=True)

    def end_store(self) -> None:
        """Remove what serves this run alone, or all of it where nothing is to be kept."""
        kept = self.config.compute.keep_samples
        shutil.rmtree(self.store / "blocks" if kept else self.store, ignore_errors=True)


@dataclass
class Blocks:
    """A ragged Dataset in the making, some whole aircraft at a time."""

    # reports, aircraft: of all blocks together
    reports: int
    aircraft: int
    # gives the blocks, once; takes the record of the stage
    each: Callable[[StageRecord], Iterator[xr.Dataset]]
    stage: str  # what a person reads while they are made
    # attributes of the whole; complete when the last block was given
    attrs: dict[str, object] = field(default_factory=dict)
    # called with the product's ``uuid`` when all is written, before it takes its name: whatever it
    # notes stands wherever the product does
    written: Callable[[str], None] = lambda uuid: None
    # columns carried on from an earlier product as they are stored there, see
    # :func:`airswing.products.ragged_product.ragged_writer`
    carried: xr.Dataset | None = None
    # false where a file it is made from vanished or changed meanwhile: the product is written, and
    # a run with ``resume`` makes it again though its inputs look the same as before
    whole: bool = True


def main_reference(config: Config) -> str:
    """Fits used for the correction and the cards: the first pool, else the first reference."""
    return next(iter([*config.pool, *config.references]))


def ready(job: Job, given: xr.Dataset | None, name: str) -> xr.Dataset:
    """Take a product as given, or read it from the output folder.

    Parameters
    ----------
    name : str
        File name of the product, or of a folder of its months.
    """
    return read_product(where_it_stands(job, name), lazy=True) if given is None else given


def where_it_stands(job: Job, name: str) -> Path:
    """The single file of a product, or the folder of its months where only that is there."""
    whole = job.output / name
    months = whole.with_suffix("")
    return months if months.is_dir() and not whole.exists() else whole


def require_kept(headings: xr.Dataset) -> None:
    """Refuse to go on from headings of which screening left none.

    Raises
    ------
    InputError
        Says which rules left no report.
    """
    if headings.attrs.get("kept_reports", 1):
        return
    counts = tally(headings, "screened_out")
    found = ", ".join(f"{rule} {int(count):,}" for rule, count in counts.items() if count)
    raise InputError(
        "screening left no report",
        field="screening",
        found=f"of {headings.sizes['report']:,} reports, left out by {found}",
        remedy="Loosen the rule that removed most, or check the reports; "
        f"{HEADINGS} holds the model winds at them",
    )


def product(
    job: Job,
    name: str,
    make: Callable[[], xr.Dataset],
    *,
    title: str,
    depends: tuple[object, ...],
    sources: tuple[xr.Dataset, ...] = (),
) -> xr.Dataset:
    """Read a product that still holds, or make it and write it.

    Parameters
    ----------
    depends : tuple
        All it depends on beside its name; see :func:`airswing.products.fingerprint.fingerprint`.
    sources : tuple of Dataset
        Products it is made from.

    Returns
    -------
    Dataset
        As read back from the file.
    """
    path, mark = job.output / name, fingerprint(name, *depends)
    found = _kept(job, path, mark)
    if found is not None:
        return found.load()
    require_writable(job.output)
    made = make()
    made.attrs["fingerprint"] = mark
    write_product(made, path, **_told(job, title, sources))
    return read_product(path)


def ragged_product(
    job: Job,
    name: str,
    make: Callable[[], Blocks],
    *,
    title: str,
    depends: tuple[object, ...],
    sources: tuple[xr.Dataset, ...] = (),
    whole: bool = True,
) -> xr.Dataset:
    """Read a product that still holds, or make it and write it, some aircraft at a time.

    Parameters
    ----------
    job, name, title, depends, sources
        As for :func:`product`.
    make : callable
        Gives its blocks.
    whole : bool, default True
        False where what is written beside it is not there: it is made again.

    Returns
    -------
    Dataset
        Read lazily from the file.
    """
    path, mark = job.place(name), fingerprint(name, *depends)
    found = _kept(job, path, mark) if whole else None
    if found is not None:
        return found
    require_writable(job.output)
    made = make()
    with (
        job.progress.stage(made.stage) as stage,
        ragged_writer(
            path, reports=made.reports, aircraft=made.aircraft, carried=made.carried
        ) as writer,
    ):
        for block in made.each(stage):
            writer.append(block)
        told = provenance(**_told(job, title, sources))
        writer.finish({**made.attrs, "fingerprint": mark if made.whole else "", **told})
        made.written(told["uuid"])
    return read_product(path, lazy=True)


def earlier(job: Job, path: Path) -> xr.Dataset | None:
    """A product of an earlier run that this one goes on with, whatever it was made from.

    Returns
    -------
    Dataset or None
        Read lazily; None without ``resume``, where there is none, and where it cannot be read, as
        a loss of power may leave it: that is said, and it is made again.
    """
    if not (job.resume and path.exists()):
        return None
    try:
        return read_product(path, lazy=True)
    except InputError:
        job.progress.say(f"{path.name}: not a product that can be read, made again")
        return None


def _kept(job: Job, path: Path, mark: str) -> xr.Dataset | None:
    """A product that still holds, read lazily."""
    found = earlier(job, path)
    if found is not None:
        if found.attrs.get("fingerprint") == mark:
            job.progress.say(f"{path.name}: nothing changed, kept")
            return found
        found.close()
    return None


class _Told(TypedDict):
    """Keywords of :func:`airswing.products.netcdf.provenance`."""

    title: str
    config_json: str
    sources: list[str]
    source_uuids: list[str]


def _told(job: Job, title: str, sources: tuple[xr.Dataset, ...]) -> _Told:
    """Where a product comes from."""
    return {
        "title": title,
        "config_json": job.config.model_dump_json(),
        "sources": [*job.config.reports.files, *job.config.references],
        "source_uuids": [source.attrs["uuid"] for source in sources],
    }
