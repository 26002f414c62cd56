"""Worker processes for data that may end the process that reads it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from airswing import guarded as module
from airswing.guarded import WorkerEndedError, guarded


def test_a_result_and_an_exception_come_back_from_the_same_worker():
    assert guarded(divmod, 7, 2) == (3, 1)
    assert guarded(os.getpid) == guarded(os.getpid) != os.getpid()
    with pytest.raises(ZeroDivisionError):
        guarded(divmod, 7, 0)


def test_a_worker_that_ends_is_an_error_and_is_replaced():
    for _ in range(2):
        with pytest.raises(WorkerEndedError):
            guarded(os.abort)
        assert guarded(abs, -1) == 1
    # one that someone else ended, without an error
    os.kill(guarded(os.getpid), signal.SIGKILL)
    assert guarded(abs, -2) == 2


def test_a_call_that_does_not_return_ends():
    with pytest.raises(WorkerEndedError):
        guarded(_forever)


def _forever():
    module.signal.alarm(1)
    time.sleep(60)


def test_one_threads_fault_does_not_disturb_another():
    def work(number):
        if number % 4 == 0:
            with pytest.raises(WorkerEndedError):
                guarded(os.abort)
        return guarded(abs, -number)

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(work, range(8))) == list(range(8))


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from airswing.guarded import guarded\nprint('once', guarded(abs, -3), flush=True)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert done.stdout.split("\n")[:-1] == ["once 3"], done.stderr


def test_workers_end_with_a_process_that_is_killed(tmp_path):
    code = (
        "import os, time; from airswing.guarded import guarded\n"
        "print(guarded(os.getpid), flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    for _ in range(50):
        if not _is_running(worker):
            return
        time.sleep(0.1)
    raise AssertionError("the worker outlived its parent")


def _is_running(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().split(")")[-1].split()[0] != "Z"
    except FileNotFoundError:
        return False
