"""Runs functions in worker processes that may be ended by the data they read.

ecCodes calls ``abort()`` where one of its assertions fails, and damaged lengths may make it read
outside its buffers or never return. Such work is done by a worker process; if the worker ends, the
caller gets a `WorkerEndedError` and the next call starts a new worker.

Functions are module-level functions of this package; arguments and results can be pickled. A worker
serves one call at a time and is used again. If a worker that has served earlier calls ends, the
call is repeated once in a new worker, because the earlier calls may be the cause. Workers end with
the process that started them, also if that process is killed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

SECONDS = 60  # limit of one call; the slowest packing decodes 200,000 points a second
MEMORY = 4 << 30  # bytes of address space of a worker; a damaged length may request far more
_START_LOCK = threading.Lock()


class WorkerEndedError(Exception):
    """The worker process ended while it served a call."""


class _Process(SpawnProcess):
    """A spawned process that does not import the main script and may be started anywhere.

    Without this a script without ``if __name__ == "__main__"`` would run again in each worker,
    and daemonic processes (workers of dask.distributed) could start none.
    """

    def start(self) -> None:
        config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
        with _START_LOCK:
            main, daemon = sys.modules["__main__"], config.get("daemon")
            sys.modules["__main__"], config["daemon"] = ModuleType("__main__"), False
            # a process that was itself started by another waits at its end for all but daemons
            self.daemon = True
            try:
                super().start()
            finally:
                sys.modules["__main__"], config["daemon"] = main, daemon


class _Context(SpawnContext):
    Process = _Process


_idle: list[ProcessPoolExecutor] = []
if hasattr(os, "register_at_fork"):  # workers serve the process that started them
    os.register_at_fork(after_in_child=_idle.clear)


def guarded(
    function: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
) -> Result:
    """Call a function in a worker process; its result or exception is passed on.

    WorkerEndedError if the worker ended, or the call took longer than `SECONDS`.
    """
    while True:
        try:
            executor, used = _idle.pop(), True
        except IndexError:
            executor, used = ProcessPoolExecutor(1, _Context(), _prepare), False
        try:
            future = executor.submit(_limited, function, args, kwargs)
            error = future.exception()
        except BrokenProcessPool as broken:
            error = broken
        except BaseException:  # interrupted while the worker is busy
            executor.shutdown(wait=False, cancel_futures=True)
            raise
        if not isinstance(error, BrokenProcessPool):
            _idle.append(executor)
            return future.result()
        executor.shutdown(wait=False)
        if not used:
            raise WorkerEndedError("decoding it ends the process or does not end") from error


def _prepare() -> None:
    """Limits of a worker; its messages about assertions are not shown."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    # glibc keeps freed memory after a large block was freed: arrays of fields are then not
    # returned to the system and requested again for each message (a third of the time)
    bytes(31 << 20)
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        limit = MEMORY if most == resource.RLIM_INFINITY else min(MEMORY, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(0)


def _limited(
    function: Callable[..., Result], args: tuple[object, ...], kwargs: dict[str, object]
) -> Result:
    """Call a function within `SECONDS`; the alarm ends the process."""
    if hasattr(signal, "alarm"):
        signal.alarm(SECONDS)
    try:
        return function(*args, **kwargs)
    finally:
        if hasattr(signal, "alarm"):
            signal.alarm(0)
