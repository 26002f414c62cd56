"""Runs functions in worker processes that may be ended by the data they read.

ecCodes calls ``abort()`` where one of its assertions fails, and damaged lengths may make it read
outside its buffers or never return. Such work is done by a worker process; if the worker ends, the
caller gets a `WorkerEndedError` and the next call starts a new worker.

Functions are module-level functions of this package; arguments and results can be pickled. A worker
serves one call at a time and is used again. If a worker that has served earlier calls ends, the
call is repeated once in a new worker, because the earlier calls may be the cause. A worker is a new
interpreter, so that a script without ``if __name__ == "__main__"`` does not run again in it and any
process may start one; it ends when its input ends, also if the process that started it is killed.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

SECONDS = 60  # limit of one call; the slowest packing decodes 200,000 points a second
MEMORY = 4 << 30  # bytes of address space of a worker; a damaged length may request far more


class WorkerEndedError(Exception):
    """The worker process ended while it served a call."""


_idle: list[subprocess.Popen[bytes]] = []
if hasattr(os, "register_at_fork"):  # workers serve the process that started them
    os.register_at_fork(after_in_child=_idle.clear)


def guarded(
    function: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
) -> Result:
    """Call a function in a worker process; its result or exception is passed on.

    WorkerEndedError if the worker ended, or the call took longer than `SECONDS`.
    """
    call = pickle.dumps((function, args, kwargs))
    while True:
        try:
            worker, used = _idle.pop(), True
        except IndexError:
            worker, used = _new_worker(), False
        assert worker.stdin is not None and worker.stdout is not None
        try:
            worker.stdin.write(call)
            worker.stdin.flush()
            result: Result
            result, error = pickle.load(worker.stdout)
        except BaseException as ended:  # the worker ended, or this process was interrupted
            worker.kill()
            worker.communicate()
            if not isinstance(ended, OSError | EOFError | pickle.UnpicklingError):
                raise
            if not used:
                raise WorkerEndedError("decoding it ends the process or does not end") from ended
        else:
            _idle.append(worker)
            if error is not None:
                raise error
            return result


def _new_worker() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", "from airswing.guarded import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )


def serve() -> None:
    """Answer the calls on standard input, each on standard output, until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is no answer
    # glibc keeps freed memory after a large block was freed: arrays of fields are then not
    # returned to the system and requested again for each message (a third of the time)
    bytes(31 << 20)
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        limit = MEMORY if most == resource.RLIM_INFINITY else min(MEMORY, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    alarm: Callable[[int], object] = getattr(signal, "alarm", lambda seconds: None)
    with contextlib.suppress(EOFError):
        while True:
            function, args, kwargs = pickle.load(sys.stdin.buffer)
            alarm(SECONDS)  # ends the process
            try:
                answer = pickle.dumps((function(*args, **kwargs), None))
            except Exception as error:
                answer = pickle.dumps((None, error))
            alarm(0)
            answers.write(answer)
            answers.flush()
