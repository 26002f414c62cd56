"""Three places to run, the same results; and a clear end when a place fails."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from types import SimpleNamespace

import dask
import numpy as np
import pytest

from airswing.config import Compute
from airswing.errors import InputError
from airswing.workflow import compute
from airswing.workflow.progress import Progress, Tasks, count_tasks, follow_tasks

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address():
    """A scheduler that runs already, with two workers in this process."""
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    with distributed.LocalCluster(**options, dashboard_address=None, protocol="tcp://") as cluster:
        yield cluster.scheduler_address


def some_work() -> np.ndarray:
    import dask.array as da

    values = da.from_array(np.random.default_rng(1).normal(size=1000), chunks=100)
    return np.asarray(da.sin(values).cumsum(axis=0).compute())


def test_an_address_gives_the_same_bits_as_threads(address):
    progress = Progress(quiet=True)
    with compute.scheduler(Compute(), progress):
        here = some_work()
    with compute.scheduler(Compute(scheduler=address), progress):
        there = some_work()
    np.testing.assert_array_equal(here, there)
    assert progress.threads == 2


def test_the_whole_collocation_gives_the_same_bits_at_an_address(address, tmp_path, root):
    from airswing import workflow
    from airswing.config_file import load_config

    path = tmp_path / "config.yaml"
    path.write_text(
        f"reports: {{files: '{root}/data_samples/reports/N40[46].csv'}}\n"
        f"references: {{ruc: {{files: {root}/data_samples/ruc/*.grb}}}}\n"
        f"output: {tmp_path}/results\n"
    )
    results = []
    for place in (Compute(threads=2), Compute(scheduler=address)):
        job = workflow.Job(load_config(path), Progress(quiet=True))
        with compute.scheduler(place, job.progress):
            results.append(workflow.make_headings(job))
    for name in results[0].variables:
        one, other = (result[name].to_numpy() for result in results)
        np.testing.assert_array_equal(one, other, str(name))


def test_workers_keep_their_threads_to_themselves_and_may_keep_memory():
    """The C library learns which sizes come back only where no threshold is set for it."""
    names = ("MALLOC_TRIM_THRESHOLD_", "OMP_NUM_THREADS")
    before = dask.config.get("distributed.nanny.pre-spawn-environ")
    with (
        compute.local_cluster(1, 1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        (found,) = client.run(lambda: [os.environ.get(name) for name in names]).values()
    assert found == [os.environ.get(names[0]), os.environ.get(names[1], "1")]
    assert dask.config.get("distributed.nanny.pre-spawn-environ") == before


def test_workers_start_keep_no_tasks_sent_to_them_and_raise_what_fails_in_them(capfd):
    """Each message to a worker holds the places of the reports of its tasks."""

    def fail() -> None:
        raise InputError("nothing works", remedy="Try again")

    before = dask.config.get("distributed.admin.low-level-log-length")
    with (
        pytest.raises(InputError, match="nothing works"),
        compute.scheduler(Compute(workers=2, threads=1), Progress(quiet=True)),
    ):
        sent = distributed.default_client().cluster.scheduler.stream_comms.values()
        assert len(sent) == 2
        assert {one.recent_message_log.maxlen for one in sent} == {compute.LOGGED}
        dask.delayed(fail)().compute()
    assert dask.config.get("distributed.admin.low-level-log-length") == before
    assert "nothing works" not in "".join(capfd.readouterr())


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(compute, "CONNECT_TIMEOUT", "1s")
    with (
        pytest.raises(InputError, match=r"cannot reach.*tcp://127\.0\.0\.1:9.*dask scheduler"),
        compute.scheduler(Compute(scheduler="tcp://127.0.0.1:9"), Progress(quiet=True)),
    ):
        pass


def test_a_worker_killed_over_and_over_is_one_message():
    def die() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        pytest.raises(InputError, match=r"out of memory.*more memory.*--resume"),
        compute.scheduler(Compute(workers=2, threads=1), Progress(quiet=True)),
    ):
        dask.delayed(die)().compute()


def test_a_worker_that_ends_while_it_starts_is_one_message():
    with (
        dask.config.set({"distributed.worker.preload": ["import os; os._exit(1)"]}),
        pytest.raises(InputError, match=r"compute\.workers.*ended while it was started.*--resume"),
        compute.scheduler(Compute(workers=2, threads=1), Progress(quiet=True)),
    ):
        pass


def test_workers_that_all_wait_for_memory_are_one_message(monkeypatch):
    """In this process, which is above their limit: they are paused as soon as they look."""
    monkeypatch.setattr(compute, "PATIENCE", 1.0)
    options = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "protocol": "tcp://"}
    with (
        distributed.LocalCluster(**options, memory_limit="20MB", dashboard_address=None) as cluster,
        pytest.raises(InputError, match=r"waiting for memory.*more memory.*--resume"),
        compute.scheduler(Compute(scheduler=cluster.scheduler_address), Progress(quiet=True)),
    ):
        worker = cluster.workers[0]
        while worker.status.name != "paused":
            time.sleep(0.05)
        some_work()


def test_a_scheduler_without_workers_is_said(capsys):
    options = {"n_workers": 0, "processes": False, "protocol": "tcp://"}
    with (
        distributed.LocalCluster(**options, dashboard_address=None) as cluster,
        compute.scheduler(Compute(scheduler=cluster.scheduler_address), Progress()),
    ):
        pass
    assert "no workers yet" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["CommClosedError", "CancelledError"])
def test_a_scheduler_lost_on_the_way_is_one_message(kind):
    from concurrent.futures import CancelledError

    from distributed.comm.core import CommClosedError

    lost = {"CommClosedError": CommClosedError, "CancelledError": CancelledError}[kind]
    place = Compute(scheduler="tcp://host:8786")
    with (
        pytest.raises(InputError, match=r"tcp://host:8786.*--resume"),
        compute._losses(place, threading.Event()),
    ):
        raise lost("gone")


def test_the_dashboard_is_named(address, capsys):
    with compute.scheduler(Compute(scheduler=address), Progress()):
        pass
    assert "dask dashboard: http" in capsys.readouterr().err


def test_workers_with_another_airswing_are_refused(address, monkeypatch):
    monkeypatch.setattr(compute, "code_digest", lambda *names: "another")
    monkeypatch.setattr(compute, "WORKERS_CODE", "airswing.products.ragged")

    class Pretend:
        def run(self, *words: object, on_error: str) -> dict[str, str]:
            return {"tcp://worker:1": "own"}

    with pytest.raises(InputError, match=r"another version.*worker:1"):
        compute._require_same_code(Pretend())


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (ModuleNotFoundError("No module named 'airswing'"), "no airswing of this version"),
        (AttributeError("no code_digest"), "no airswing of this version"),
        ("another", "another version"),
        (OSError("in <TCP>: stream is closed"), None),
    ],
)
def test_only_workers_that_answer_are_held_against_this_version(answer, says):
    class Asked:
        def run(self, function, *words, on_error):
            assert on_error == "return"
            return {"tcp://a": function(*words), "tcp://b": answer}

    with pytest.raises(InputError, match=says) if says else contextlib.nullcontext():
        compute._require_same_code(Asked())


def test_tasks_are_counted_at_a_scheduler(address):
    with distributed.Client(address) as client:
        held = client.compute([dask.delayed(pow)(2, n, pure=False) for n in range(5)])
        distributed.wait(held)
        assert client.run_on_scheduler(count_tasks) == (5, 5)


def test_tasks_of_local_threads_are_counted():
    with follow_tasks() as tasks, dask.config.set(scheduler="threads"):
        some_work()
    assert tasks.done == tasks.total > 10


def test_the_remaining_time_is_that_of_this_stage_and_the_later_ones():
    from airswing.workflow.progress import StageRecord

    progress = Progress(quiet=True, expected={"read": 10.0, "collocate": 50.0, "fit": 20.0})
    assert progress.remaining("plan", 1.0, Tasks()) is None
    assert progress.remaining("collocate", 30.0, Tasks()) == pytest.approx(20.0 + 10.0 + 20.0)
    progress.records.append(StageRecord("read", 20.0))
    # Reading took twice what was expected, and so will the fit; the tasks tell the rest.
    left = progress.remaining("collocate", 30.0, Tasks(done=60, total=100))
    assert left == pytest.approx(20.0 + 40.0)


def test_the_libraries_start_is_not_taken_for_the_pace_of_the_work():
    """Seven thousand reports read in a second, most of it imports: a run of 15 s in all."""
    from airswing.workflow.cost import stage_seconds

    from airswing.workflow.progress import StageRecord

    progress = Progress(quiet=True, expected=stage_seconds(7000, 4, {}))
    progress.records.append(StageRecord("reports", 1.0))
    left = progress.remaining("collocate", 0.3, Tasks(done=73, total=101))
    assert left is not None and left < 60.0


def test_the_page_is_foretold_by_the_figures_it_draws():
    from airswing.report.run import page
    from airswing.workflow import cost

    assert cost.PANELS == page.SMALL_PANELS
    few, more, most = (cost.stage_seconds(0, count, {})["page"] for count in (6, 96, 6000))
    assert few < 0.7 * more and most - more < more


def test_a_fleet_of_many_aircraft_is_foretold_to_cost_more():
    """Measured: 600 aircraft of 288,000 reports, fleet 5 s, peak 0.3 GB; of 600,000, cards 42 s."""
    from airswing.workflow.cost import estimate, stage_seconds

    seconds = stage_seconds(592_800, 600, {})
    assert 7.0 < seconds["fit"] < 30.0 and 20.0 < seconds["swing cards"] < 80.0
    more = stage_seconds(592_800, 6000, {})["fit"]
    assert 6.0 * seconds["fit"] < more < 11.0 * seconds["fit"]
    memory = [
        estimate(592_800, aircraft, {}, block=200_000)["memory_bytes"]
        for aircraft in (60, 600, 6000)
    ]
    assert memory[0] < 0.8e9
    assert memory[1] - memory[0] < 0.3e9
    assert memory[2] - memory[1] == pytest.approx(10.0 * (memory[1] - memory[0]))


def test_each_stage_of_6000_aircraft_is_foretold_near_what_it_took():
    """Measured (docs/benchmarks.md): 240 reports each, two references; the fit of 20 million."""
    from airswing.workflow.cost import as_text, estimate

    nothing = SimpleNamespace(messages=0, sparse_messages=0, bytes=0)
    plans = {"ruc": nothing, "rap": nothing}
    told = estimate(1_440_000, 6000, plans, block=200_000)
    measured = {"ranking": 40.5, "compare": 199.3, "stability": 88.0, "observation errors": 2.1}
    measured |= {"profiles": 0.9, "swing cards": 640.0}
    for stage, seconds in measured.items():
        assert 0.5 * seconds < told["stages"][stage] < 2.0 * seconds, stage
    assert 70.0 < estimate(20_000_000, 6000, plans, block=200_000)["stages"]["fit"] < 130.0
    assert told["seconds"] == pytest.approx(sum(told["stages"].values()), rel=0.01)
    text = as_text({"reports": 1_440_000, "aircraft": 6000, "references": {}, **told})
    assert "compare 198" in text and "ranking 42" in text


def test_the_accounts_tell_the_share_of_decoding():
    from airswing.workflow.progress import StageRecord

    progress = Progress(quiet=True, threads=2)
    progress.records += [
        StageRecord("reports", 1.0, octets=3_000_000, reports=1234),
        StageRecord("collocate", 3.0, octets=5_000_000, messages=42, reports=1200, decoding=4.0),
    ]
    found = progress.accounts()
    assert found["decoding_share"] == pytest.approx(0.5)
    text = progress.accounts_text()
    assert "42" in text and "1,234" in text and "50.0%" in text


def test_a_stage_tells_its_phases_and_what_each_took():
    progress = Progress(quiet=True)
    with progress.stage("diagnose") as stage:
        stage.tell("statistics", 0.0)
        sum(range(3_000_000))
        stage.tell("statistics", 0.5)
        assert stage.phase == "statistics 50%"
        stage.tell("search", 0.0)
    (told,) = progress.accounts()["stages"]
    assert list(told["phases"]) == ["statistics", "search"]
    assert told["phases"]["statistics"] > told["phases"]["search"] >= 0.0
    assert "phase" not in told
