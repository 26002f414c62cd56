"""Where the work runs: threads of this process, local worker processes, or a dask scheduler.

Assumes every stage builds dask graphs and leaves the choice of scheduler to this module, so that
the same code runs in all three places with the same results. Workers of a cluster must see the
files under the same paths and have the same airswing.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import dask

from airswing.config import Compute
from airswing.errors import InputError
from airswing.products.fingerprint import code_digest
from airswing.workflow.progress import Progress

if TYPE_CHECKING:
    from distributed import Client

# What workers run; its source must be the same everywhere.
WORKERS_CODE = "airswing.reference.collocate"
CONNECT_TIMEOUT = "15s"
PATIENCE = 60.0  # How long every worker may wait for memory, s
# Size of a task graph that is not worth a warning.
_GRAPH = "200MB"
LOGGED = 10  # Messages and transitions dask keeps for whoever looks for a fault in dask


@contextlib.contextmanager
def scheduler(compute: Compute, progress: Progress) -> Iterator[None]:
    """Make every dask computation inside the block run where the configuration says.

    Parameters
    ----------
    compute : Compute
        ``scheduler`` an address, or None; ``workers`` a number of processes, or "auto" for
        threads of this process; ``threads`` for each worker, or "auto".
    progress : Progress
        Told where the dashboard is, when there is one, and how many threads work.

    Raises
    ------
    InputError
        If the scheduler cannot be reached or is lost, if workers have another airswing, if a piece
        of work killed several workers, or if all of them wait for memory.
    """
    cores = os.cpu_count() or 1
    if compute.scheduler is None and compute.workers in ("auto", 1):
        progress.threads = cores if compute.threads == "auto" else compute.threads
        with dask.config.set(scheduler="threads", num_workers=progress.threads):
            yield
        return
    with _client(compute, cores) as client, _watched(client) as stuck, _losses(compute, stuck):
        _require_same_code(client)
        progress.threads = sum(client.nthreads().values()) or 1
        progress.say(f"dask dashboard: {client.dashboard_link}")
        if not client.nthreads():
            progress.say("the dask scheduler has no workers yet: waiting for them")
        yield


@contextlib.contextmanager
def local_cluster(workers: int, threads: int, **options: object) -> Iterator[object]:
    """Worker processes on this machine.

    Parameters
    ----------
    threads : int
        Of each.
    **options
        Further ones of ``distributed.LocalCluster``.

    Yields
    ------
    distributed.LocalCluster

    Raises
    ------
    InputError
        If a worker ends while it starts.
    """
    from distributed import LocalCluster

    # Dask starts workers with a fixed threshold of the C library (glibc) for giving memory back,
    # and a fixed threshold also keeps that library from learning which sizes come back: every
    # decoded field (1 MB) is then mapped, faulted in page by page and unmapped, which takes more
    # time than decoding it.
    with dask.config.set({"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None}):
        try:
            cluster = LocalCluster(n_workers=workers, threads_per_worker=threads, **options)
        except (RuntimeError, OSError) as err:
            raise InputError(
                "a worker process ended while it was started",
                field="compute.workers",
                found=err.__cause__ or err,
                remedy="Take fewer workers where memory is short, then go on with --resume",
            ) from err
    with cluster:
        yield cluster


@contextlib.contextmanager
def _client(compute: Compute, cores: int) -> Iterator[Client]:
    from distributed import Client

    # A lost scheduler is told in one message by this module, not by the client's tracebacks.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    with contextlib.ExitStack() as stack:
        # The places of a stretch's reports go with its tasks, some 20 MB: no reason for a warning.
        # The scheduler, in this process with local workers, keeps the last thousand messages to
        # each worker by default, and with them the places of as many tasks: 100 MB in a year.
        admin = {"large-graph-warning-threshold": _GRAPH, "low-level-log-length": LOGGED}
        stack.enter_context(
            dask.config.set({f"distributed.admin.{name}": value for name, value in admin.items()})
        )
        if compute.scheduler is None:
            workers = int(compute.workers)
            threads = max(1, cores // workers) if compute.threads == "auto" else compute.threads
            address = stack.enter_context(local_cluster(workers, threads, dashboard_address=":0"))
        else:
            address = compute.scheduler
        try:
            client = stack.enter_context(Client(address, timeout=CONNECT_TIMEOUT))
        except (OSError, TimeoutError, ValueError) as err:
            raise InputError(
                "cannot reach the dask scheduler",
                field="scheduler",
                found=compute.scheduler,
                remedy="Start it with `dask scheduler`, or leave --scheduler away",
            ) from err
        if compute.scheduler is None:
            with contextlib.suppress(OSError):  # a worker lost just now: its successor is told
                client.register_worker_callbacks(setup=_tell_no_failures)
        yield client


def _tell_no_failures() -> None:
    """Keep a worker from printing what failed in it: it is raised where the work was asked for."""
    logging.getLogger("distributed.worker").addFilter(
        lambda record: not str(record.msg).startswith("Compute Failed")
    )


@contextlib.contextmanager
def _watched(client: Client) -> Iterator[threading.Event]:
    """Give work up, and set the event, where every worker has long been paused for want of memory.

    Dask pauses workers near their limit and waits for them to free some; what the libraries alone
    take is never freed, and the wait would have no end.
    """
    stuck, ended = threading.Event(), threading.Event()

    def watch() -> None:
        since: float | None = None
        while not ended.wait(PATIENCE / 10.0):
            with contextlib.suppress(Exception):  # a lost scheduler is told elsewhere
                workers = client.scheduler_info(n_workers=-1)["workers"].values()
                if not workers or any(worker["status"] != "paused" for worker in workers):
                    since = None
                    continue
                since = since or time.monotonic()
                if time.monotonic() - since > PATIENCE:
                    stuck.set()
                    _cancel_all(client)
                    return

    # daemon: it must not keep an interrupted job alive
    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield stuck
    finally:
        ended.set()
        thread.join(timeout=5.0)


def _cancel_all(client: Client) -> None:
    from distributed import Future

    client.cancel([Future(key, client) for key in list(client.futures)], force=True)


@contextlib.contextmanager
def _losses(compute: Compute, stuck: threading.Event) -> Iterator[None]:
    """Tell the loss of workers or of the scheduler in one message."""
    from concurrent.futures import CancelledError

    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        yield
    except KilledWorker as err:
        raise InputError(
            "the same piece of work ended several workers, most likely out of memory",
            field="compute",
            found=str(err.task),
            remedy="Give each worker more memory or fewer threads, then go on with --resume",
        ) from err
    except (CommClosedError, CancelledError) as err:
        if stuck.is_set():
            raise InputError(
                "every worker has been waiting for memory and does nothing",
                field="compute",
                remedy="Give each worker more memory or fewer threads, then go on with --resume",
            ) from err
        raise InputError(
            "the dask scheduler was lost",
            field="scheduler",
            found=compute.scheduler or "the local cluster",
            remedy="Start it again, then go on with --resume",
        ) from err


def _require_same_code(client: Client) -> None:
    """Refuse workers whose airswing would give other values; workers to come are not asked."""
    own = code_digest(WORKERS_CODE)
    theirs = client.run(code_digest, WORKERS_CODE, on_error="return")
    for err in theirs.values():
        if isinstance(err, (ImportError, AttributeError)):
            raise InputError(
                "the workers have no airswing of this version",
                field="scheduler",
                found=err,
                remedy="Install the same airswing where the workers run",
            ) from err
    other = [
        worker
        for worker, digest in theirs.items()
        if digest != own and not isinstance(digest, OSError)  # lost just now: it does no work
    ]
    if other:
        raise InputError(
            "workers run another version of airswing",
            field="scheduler",
            found=", ".join(sorted(other)[:3]),
            remedy="Install the same airswing where the workers run",
        )
