"""The job, which every stage of the workflow takes, and the names of its products."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr

from airswing.config import Config
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.products.netcdf import open_product, product_path, write_product
from airswing.products.ragged import COVERAGE
from airswing.report.run.reading_warnings import tally
from airswing.workflow.progress import Progress

# Folders of one file a month, and files of the whole archive.
HEADINGS, CORRECTED = "headings", "corrected"
FITS, PROFILES = "fits.nc", "error_profiles.nc"


@dataclass(frozen=True)
class Job:
    """One run: its configuration, its display of progress, and whether earlier work is kept."""

    config: Config
    progress: Progress
    fresh: bool = False  # remake every month
    # results of one stage that a later one of the same run needs
    shared: dict[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        config: Config | str | Path,
        *,
        output: str | Path | None = None,
        fresh: bool = False,
        quiet: bool = False,
        scheduler: str | None = None,
    ) -> Job:
        """Make a job of a configuration, or of its file; options as of :func:`airswing.run`."""
        folder = None if output is None else Path(output)
        if not isinstance(config, Config):
            config = load_config(config, output=folder)
        changes: dict[str, Any] = {} if folder is None else {"output": folder}
        if scheduler is not None:
            changes["compute"] = config.compute.model_copy(update={"scheduler": scheduler})
        return cls(config.model_copy(update=changes), Progress(quiet=quiet), fresh)

    @property
    def output(self) -> Path:
        """Folder of the products."""
        return self.config.output

    @property
    def notes(self) -> Path:
        """Folder of records of the files used, for the next run."""
        return self.output / ".airswing"

    @property
    def pools(self) -> dict[str, list[str]]:
        """Members of each reference and pool."""
        return self.config.pools()

    @property
    def reference(self) -> str:
        """Reference or pool whose fits correct the winds."""
        return self.config.main_reference()

    @property
    def against(self) -> dict[str, Any]:
        """Options ``pools`` and ``reference`` of the evaluations."""
        return {"pools": self.pools, "reference": self.reference}

    def write(
        self, ds: xr.Dataset, name: str, *, title: str, sources: tuple[xr.Dataset, ...] = ()
    ) -> None:
        """Write a product, made from the products `sources`, under a name in the output folder."""
        covered = sources[0].attrs if sources else {}
        write_product(
            ds.assign_attrs({key: covered[key] for key in COVERAGE if key in covered}),
            self.output / name,
            title=title,
            config_json=self.config.model_dump_json(),
            sources=[*self.config.reports.files, *self.config.references],
            source_uuids=[source.attrs["uuid"] for source in sources],
        )

    def ready(self, given: xr.Dataset | None, name: str) -> xr.Dataset:
        """Take a product as given, or open that of the output folder."""
        if given is not None:
            return given
        return open_product(product_path(self.output, name.removesuffix(".nc")))


def require_kept(headings: xr.Dataset) -> None:
    """Raise InputError, with the rules that removed them, if screening left no report."""
    if headings.attrs.get("kept_reports", 1):
        return
    counts = tally(headings, "screened_out")
    found = ", ".join(f"{rule} {int(count):,}" for rule, count in counts.items() if count)
    raise InputError(
        "screening left no report",
        field="screening",
        found=f"of {headings.sizes['report']:,} reports, left out by {found}",
        remedy="Loosen the rule that removed most, or check the reports; "
        f"the folder {HEADINGS} holds the model winds at them",
    )
