"""Three places to run, the same results; and a clear end when a place fails."""

from __future__ import annotations

import contextlib
import os
import signal

import dask
import numpy as np
import pytest

from airswing import workflow
from airswing.config import Compute
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.workflow import compute
from airswing.workflow.progress import Progress, StageRecord, Tasks

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address():
    """A scheduler that runs already, with two workers in this process."""
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    with distributed.LocalCluster(**options, dashboard_address=None, protocol="tcp://") as cluster:
        yield cluster.scheduler_address


def test_threads_processes_and_an_address_give_the_same_bits(address, tmp_path, root):
    results = {}
    for name, place in {
        "threads": Compute(threads=2),
        "processes": Compute(workers=2, threads=1),
        "address": Compute(scheduler=address),
    }.items():
        path = tmp_path / f"{name}.yaml"
        path.write_text(
            f"reports: {{files: '{root}/data_samples/reports/N40[46].csv'}}\n"
            f"references: {{ruc: {{files: {root}/data_samples/ruc/*.grb}}}}\n"
            f"output: {tmp_path}/{name}\n"
        )
        job = workflow.Job(load_config(path), Progress(quiet=True))
        with compute.scheduler(place, job.progress):
            results[name] = workflow.make_headings(job).load()
        assert job.progress.threads == 2
    for name in results["threads"].variables:
        one, *others = (result[name].to_numpy() for result in results.values())
        for other in others:
            np.testing.assert_array_equal(one, other, str(name))


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(compute, "CONNECT_TIMEOUT", "1s")
    with (
        pytest.raises(InputError, match=r"cannot reach.*tcp://127\.0\.0\.1:9.*dask scheduler"),
        compute.scheduler(Compute(scheduler="tcp://127.0.0.1:9"), Progress(quiet=True)),
    ):
        pass


def test_a_worker_process_that_ends_is_one_message():
    def die() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with (
        pytest.raises(InputError, match=r"out of memory.*fewer workers.*same command again"),
        compute.scheduler(Compute(workers=2, threads=1), Progress(quiet=True)),
    ):
        dask.delayed(die)().compute()


@pytest.mark.parametrize("kind", ["CommClosedError", "CancelledError", "KilledWorker"])
def test_what_is_lost_at_an_address_is_one_message(address, kind):
    from concurrent.futures import CancelledError

    from distributed.comm.core import CommClosedError

    lost = {
        "CommClosedError": CommClosedError("gone"),
        "CancelledError": CancelledError("gone"),
        "KilledWorker": distributed.KilledWorker("task", None, 3),
    }
    with (
        pytest.raises(InputError, match=r"same command again"),
        compute.scheduler(Compute(scheduler=address), Progress(quiet=True)),
    ):
        raise lost[kind]


def test_the_dashboard_and_missing_workers_are_said(address, capsys):
    with compute.scheduler(Compute(scheduler=address), Progress()):
        pass
    assert "dask dashboard: http" in capsys.readouterr().err
    options = {"n_workers": 0, "processes": False, "protocol": "tcp://"}
    with (
        distributed.LocalCluster(**options, dashboard_address=None) as cluster,
        compute.scheduler(Compute(scheduler=cluster.scheduler_address), Progress()),
    ):
        pass
    assert "no workers yet" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("answer", "refused"),
    [
        (ModuleNotFoundError("No module named 'airswing'"), True),
        ("another", True),
        (OSError("in <TCP>: stream is closed"), False),
    ],
)
def test_workers_with_another_airswing_are_refused(answer, refused):
    class Asked:
        def run(self, function, *words, on_error):
            assert on_error == "return"
            return {"tcp://a": function(*words), "tcp://b": answer}

    says = pytest.raises(InputError, match="tcp://b") if refused else contextlib.nullcontext()
    with says:
        compute.require_same_code(Asked())


def test_tasks_of_local_threads_are_counted():
    with Tasks() as tasks, dask.config.set(scheduler="threads"):
        dask.compute([dask.delayed(pow)(2, n, pure=False) for n in range(12)])
    assert tasks.done == tasks.total > 10


def test_the_accounts_give_the_share_of_decoding():
    progress = Progress(quiet=True, threads=2)
    progress.records += [
        StageRecord("reports", 1.0, bytes_read=3_000_000, reports=1234),
        StageRecord("collocate", 3.0, messages=42, reports=1200, decoding=4.0),
    ]
    assert progress.accounts()["decoding_share"] == pytest.approx(0.5)
    text = progress.accounts_text()
    assert "42" in text and "1,234" in text and "50.0%" in text


def test_a_stage_gives_its_phases_and_what_each_took():
    progress = Progress(quiet=True)
    with progress.stage("diagnose") as stage:
        stage.enter("statistics", 0.0)
        sum(range(3_000_000))
        stage.enter("statistics", 0.5)
        assert stage.phase == "statistics 50%"
        stage.enter("search", 0.0)
    (found,) = progress.accounts()["stages"]
    assert list(found["phases"]) == ["statistics", "search"]
    assert found["phases"]["statistics"] > found["phases"]["search"] >= 0.0
