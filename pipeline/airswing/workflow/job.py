"""The job, which every stage of the workflow takes, and its computing resources.

Every stage builds dask graphs and leaves the choice of scheduler to this module (threads or
processes of this machine, or a dask scheduler at an address), so that the same code runs in all
three places with the same results. Workers at an address must see the files under the same paths
and have the same airswing.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dask
import xarray as xr

from airswing.config import Compute, Config
from airswing.config_file import load_config, naming_configuration
from airswing.errors import InputError
from airswing.products.netcdf import open_product, product_path, write_product
from airswing.products.ragged import COVERAGE
from airswing.products.whole_files import code_digest
from airswing.report.run.reading_warnings import tally
from airswing.workflow.progress import Progress

if TYPE_CHECKING:
    from distributed import Client

CONNECT_TIMEOUT = "15s"
_AGAIN = "then run the same command again: finished months are kept"
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
    file: Path | None = None  # of the configuration

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
        file = None if isinstance(config, Config) else Path(config)
        if not isinstance(config, Config):
            config = load_config(config, output=folder)
        changes: dict[str, Any] = {} if folder is None else {"output": folder}
        if scheduler is not None:
            changes["compute"] = config.compute.model_copy(update={"scheduler": scheduler})
        config = config.model_copy(update=changes)
        return cls(config, Progress(quiet=quiet), fresh, file=file)

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Run on the configured resources; errors about a key name the configuration's file."""
        with naming_configuration(self.file), resources(self.config.compute, self.progress):
            yield

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
    def pooling(self) -> dict[str, Any]:
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

    def opened(self, product: xr.Dataset | None, name: str) -> xr.Dataset:
        """Return the product if it is passed, else open that of the output folder."""
        if product is not None:
            return product
        return open_product(product_path(self.output, name.removesuffix(".nc")))


def require_kept(headings: xr.Dataset) -> None:
    """Raise InputError, with the rules that removed them, if screening left no report."""
    if headings.attrs.get("kept_reports", 1):
        return
    counts = tally(headings, "screened_out")
    removed = ", ".join(f"{rule} {int(count):,}" for rule, count in counts.items() if count)
    raise InputError(
        "screening left no report",
        field="screening",
        found=f"of {headings.sizes['report']:,} reports, left out by {removed}",
        remedy="Loosen the rule that removed most, or check the reports; "
        f"the folder {HEADINGS} holds the model winds at them",
    )


# --- computing resources -------------------------------------------------------------------------


@contextlib.contextmanager
def resources(compute: Compute, progress: Progress) -> Iterator[None]:
    """Run every dask computation inside the block on the configured resources."""
    if compute.scheduler is not None:
        with _at_address(compute.scheduler, progress):
            yield
        return
    kind, number = "processes", compute.workers
    if number in ("auto", 1):
        kind, number = "threads", compute.threads
    try:
        with dask.config.set(scheduler=kind, num_workers=None if number == "auto" else number):
            yield
    except BrokenProcessPool as err:
        raise InputError(
            "a worker process ended, most likely out of memory",
            field="compute.workers",
            found=compute.workers,
            remedy=f"Use fewer workers, {_AGAIN}",
        ) from err


@contextlib.contextmanager
def _at_address(address: str, progress: Progress) -> Iterator[None]:
    """A dask scheduler at an address; its faults become one message each."""
    try:
        from concurrent.futures import CancelledError

        from distributed import Client, KilledWorker
        from distributed.comm.core import CommClosedError
    except ImportError as err:
        raise InputError(
            "dask's distributed scheduler is not installed",
            field="scheduler",
            remedy="pip install airswing[batch]",
        ) from err
    # a lost scheduler is reported here, not by the client's tracebacks
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, TimeoutError, ValueError) as err:
        raise InputError(
            "cannot reach the dask scheduler",
            field="scheduler",
            found=address,
            remedy="Start it with `dask scheduler`, or omit --scheduler",
        ) from err
    try:
        with client:
            require_same_code(client)
            progress.say(f"dask dashboard: {client.dashboard_link}")
            if not client.nthreads():
                progress.say("the dask scheduler has no workers yet: waiting for them")
            yield
    except (KilledWorker, CommClosedError, CancelledError) as err:
        raise InputError(
            "the dask scheduler or its workers were lost, most likely out of memory",
            field="scheduler",
            found=f"{address}: {type(err).__name__}",
            remedy=f"Give each worker more memory or fewer threads, start them again, {_AGAIN}",
        ) from err


def require_same_code(client: Client) -> None:
    """Raise InputError for workers with another version of airswing."""
    # ignore a worker that was lost meanwhile (OSError)
    outdated = sorted(
        worker
        for worker, digest in client.run(code_digest, on_error="return").items()
        if digest != code_digest() and not isinstance(digest, OSError)
    )
    if outdated:
        raise InputError(
            "workers have no airswing of this version",
            field="scheduler",
            found=", ".join(outdated[:3]),
            remedy="Install the same airswing where the workers run",
        )
