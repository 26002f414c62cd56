"""Computing resources: threads or processes of this machine, or a dask scheduler at an address.

Every stage builds dask graphs and leaves the choice of scheduler to this module, so that the same
code runs in all three places with the same results. Workers at an address must see the files under
the same paths and have the same airswing.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

import dask

from airswing.config import Compute
from airswing.errors import InputError
from airswing.products.whole_files import code_digest
from airswing.workflow.progress import Progress

if TYPE_CHECKING:
    from distributed import Client

CONNECT_TIMEOUT = "15s"
_AGAIN = "then run the same command again: finished months are kept"


@contextlib.contextmanager
def scheduler(compute: Compute, progress: Progress) -> Iterator[None]:
    """Run every dask computation inside the block on the configured resources."""
    if compute.scheduler is not None:
        with _at_address(compute.scheduler, progress):
            yield
        return
    workers = 1 if compute.workers == "auto" else compute.workers
    cores = os.cpu_count() or 1
    threads = max(1, cores // workers) if compute.threads == "auto" else compute.threads
    progress.threads = workers * threads
    kind = "threads" if workers == 1 else "processes"
    try:
        with dask.config.set(scheduler=kind, num_workers=progress.threads):
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
            progress.threads = sum(client.nthreads().values()) or 1
            progress.say(f"dask dashboard: {client.dashboard_link}")
            if not client.nthreads():
                progress.say("the dask scheduler has no workers yet: waiting for them")
            yield
    except KilledWorker as err:
        raise InputError(
            "the same task ended several workers, most likely out of memory",
            field="compute",
            found=str(err.task),
            remedy=f"Give each worker more memory or fewer threads, {_AGAIN}",
        ) from err
    except (CommClosedError, CancelledError) as err:
        raise InputError(
            "the dask scheduler was lost",
            field="scheduler",
            found=address,
            remedy=f"Start it again, {_AGAIN}",
        ) from err


def require_same_code(client: Client) -> None:
    """Raise InputError for workers with another version of airswing."""
    answers = client.run(code_digest, on_error="return")
    # ignore a worker that was lost meanwhile (OSError)
    other = sorted(
        worker
        for worker, digest in answers.items()
        if digest != code_digest() and not isinstance(digest, OSError)
    )
    if other:
        raise InputError(
            "workers have no airswing of this version",
            field="scheduler",
            found=", ".join(other[:3]),
            remedy="Install the same airswing where the workers run",
        )
