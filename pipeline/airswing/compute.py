"""Where the work runs: threads of this process, local worker processes, or a dask scheduler.

Assumes every stage builds dask graphs and leaves the choice of scheduler to this module, so that
the same code runs in all three places with the same results.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import dask

from airswing.config import Compute
from airswing.errors import InputError
from airswing.progress import Progress


@contextlib.contextmanager
def scheduler(compute: Compute, progress: Progress) -> Iterator[None]:
    """Make every dask computation inside the block run where the configuration says.

    Parameters
    ----------
    compute : Compute
        ``scheduler`` an address, or None; ``workers`` a number of processes, or "auto" for
        threads of this process; ``threads`` for each worker, or "auto".
    progress : Progress
        Told where the dashboard is, when there is one.

    Raises
    ------
    InputError
        If the scheduler cannot be reached.
    """
    cores = os.cpu_count() or 1
    if compute.scheduler is None and compute.workers in ("auto", 1):
        threads = cores if compute.threads == "auto" else compute.threads
        with dask.config.set(scheduler="threads", num_workers=threads):
            yield
        return
    with _client(compute, cores) as link:
        progress.say(f"dask dashboard: {link}")
        yield


@contextlib.contextmanager
def _client(compute: Compute, cores: int) -> Iterator[str]:
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        if compute.scheduler is None:
            workers = int(compute.workers)
            threads = max(1, cores // workers) if compute.threads == "auto" else compute.threads
            address = stack.enter_context(
                LocalCluster(n_workers=workers, threads_per_worker=threads, dashboard_address=":0")
            )
        else:
            address = compute.scheduler
        try:
            client = stack.enter_context(Client(address, timeout="15s"))
        except (OSError, TimeoutError, ValueError) as err:
            raise InputError(
                "cannot reach the dask scheduler",
                field="scheduler",
                found=compute.scheduler,
                remedy="Start it with `dask scheduler`, or leave --scheduler away",
            ) from err
        yield str(client.dashboard_link)
