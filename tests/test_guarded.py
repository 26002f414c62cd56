"""Worker processes for data that may end the process that reads it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from airswing import guarded as module
from airswing.guarded import WorkerEndedError, guarded


def test_a_result_and_an_exception_come_back_from_the_same_worker():
    assert guarded(divmod, 7, 2) == (3, 1)
    assert guarded(os.getpid) == guarded(os.getpid) != os.getpid()
    with pytest.raises(ZeroDivisionError):
        guarded(divmod, 7, 0)


def _forever():
    module.signal.alarm(1)
    time.sleep(60)


@pytest.mark.parametrize("call", [os.abort, _forever])
def test_a_worker_that_ends_or_does_not_return_is_an_error_and_is_replaced(call):
    with pytest.raises(WorkerEndedError):
        guarded(call)
    assert guarded(abs, -1) == 1
    # one that someone else ended, without an error
    os.kill(guarded(os.getpid), signal.SIGKILL)
    assert guarded(abs, -2) == 2


def test_one_threads_fault_does_not_disturb_another():
    def work(number):
        if number % 4 == 0:
            with pytest.raises(WorkerEndedError):
                guarded(os.abort)
        return guarded(abs, -number)

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(work, range(8))) == list(range(8))


def test_a_script_without_a_main_guard_runs_once_and_workers_end_with_a_killed_process(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import os, time; from airswing.guarded import guarded\n"
        "print(guarded(os.getpid), flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    parent.kill()
    assert parent.communicate()[0] == ""
    for _ in range(50):
        try:
            state = Path(f"/proc/{worker}/stat").read_text().split(")")[-1].split()[0]
        except FileNotFoundError:
            return
        if state == "Z":
            return
        time.sleep(0.1)
    raise AssertionError("the worker outlived its parent")
