"""What every stage of the workflow shares: the job, its products, what they depend on.

A product carries the fingerprint of all it depends on; with ``resume`` a product whose fingerprint
still holds is read instead of made again.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from airswing.config import Config, as_json
from airswing.fingerprint import fingerprint
from airswing.products import read_product, require_writable, write_product
from airswing.progress import Progress

HEADINGS, FITS, CORRECTED = "headings.nc", "fits.nc", "corrected.nc"
PROFILES, FIELD_TEST, SENSITIVITY = "error_profiles.nc", "field_test.json", "sensitivity.json"

COLLOCATING = (
    "airswing.reports.read",
    "airswing.reference.catalogue",
    "airswing.reference.collocate",
    "airswing.compass.headings",
)
FITTING = (
    "airswing.compass.deviation",
    "airswing.compass.table",
    "airswing.evaluation.stability",
)
"""Modules whose source, with all they use, a product depends on."""


@dataclass(frozen=True)
class Job:
    """One run: what is asked, who is told, and whether earlier work counts.

    Parameters
    ----------
    config : Config
    progress : Progress
    resume : bool, default False
        Use finished products and model times that still hold.
    """

    config: Config
    progress: Progress
    resume: bool = False

    @property
    def output(self) -> Path:
        """Folder of the products."""
        return self.config.output

    @property
    def store(self) -> Path:
        """Folder of finished model times, there while a run is under way, or kept on request."""
        return self.output / ".collocated"

    def clear_store(self) -> None:
        """Remove the finished model times, unless the configuration keeps them."""
        if not self.config.compute.keep_samples:
            shutil.rmtree(self.store, ignore_errors=True)


def main_reference(config: Config) -> str:
    """Fits used for the correction and the cards: the first pool, else the first reference.

    Parameters
    ----------
    config : Config

    Returns
    -------
    str
    """
    return next(iter([*config.pool, *config.references]))


def ready(job: Job, given: xr.Dataset | None, name: str) -> xr.Dataset:
    """Take a product as given, or read it from the output folder.

    Parameters
    ----------
    job : Job
    given : Dataset or None
    name : str
        File name of the product.

    Returns
    -------
    Dataset
    """
    return read_product(job.output / name) if given is None else given


def product(
    job: Job,
    name: str,
    make: Callable[[], xr.Dataset],
    *,
    title: str,
    depends: tuple[Any, ...],
    sources: tuple[xr.Dataset, ...] = (),
) -> xr.Dataset:
    """Read a product that still holds, or make it and write it.

    Parameters
    ----------
    job : Job
    name : str
        File name.
    make : callable
        Makes the Dataset.
    title : str
    depends : tuple
        All it depends on beside its name; see :func:`airswing.fingerprint.fingerprint`.
    sources : tuple of Dataset
        Products it is made from.

    Returns
    -------
    Dataset
        As read back from the file.
    """
    path, mark = job.output / name, fingerprint(name, *depends)
    if job.resume and path.exists():
        found = read_product(path)
        if found.attrs.get("fingerprint") == mark:
            job.progress.say(f"{name}: nothing changed, kept")
            return found
    require_writable(job.output)
    made = make()
    made.attrs["fingerprint"] = mark
    write_product(
        made,
        path,
        title=title,
        config_json=as_json(job.config),
        sources=[*job.config.reports.files, *job.config.references],
        source_uuids=[source.attrs["uuid"] for source in sources],
    )
    del made  # a year's product is not held twice
    return read_product(path)
