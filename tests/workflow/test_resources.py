"""Three places to run, the same results; and a clear end when a place fails."""

import contextlib
import os
import signal
from concurrent.futures import CancelledError

import dask
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from benchmarks import fault_drill
from tests.command import configured

import airswing
from airswing.config import Compute
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.workflow import job
from airswing.workflow.progress import Progress

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address():
    """A scheduler that runs already, with two workers in this process."""
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    with distributed.LocalCluster(**options, dashboard_address=None, protocol="tcp://") as cluster:
        yield cluster.scheduler_address


def results(root, folder, place, aircraft, first, last):
    """Products of a run at a place, without its page, of the reports of a period."""
    folder.mkdir()
    (folder.parent / "reports").mkdir(exist_ok=True)
    for path in (root / "data_samples/reports").glob(f"{aircraft}.csv"):
        table = pd.read_csv(path, dtype=str)
        selected = table[table["time"].between(first, last)]
        selected.to_csv(folder.parent / "reports" / path.name, index=False)
    models = {name: root / f"data_samples/{name}/*.gr*" for name in ("ruc", "rtfdaa")}
    config = load_config(configured(folder, folder.parent / "reports/*.csv", models))
    return airswing.run(config.model_copy(update={"compute": place}))


@pytest.mark.parametrize(
    ("reports", "places"),
    [
        (("N402", "2009-10-01", "2009-10-08"), ["cluster"]),
        pytest.param(("*", "2009", "2010"), ["processes", "cluster"], marks=pytest.mark.slow),
    ],
)
@pytest.mark.usefixtures("blank_cards")
def test_all_places_give_the_same_bytes(address, tmp_path, root, reports, places, monkeypatch):
    monkeypatch.setattr("airswing.report.run.page.write_page", lambda *_, **__: "")
    threads = results(root, tmp_path / "threads", Compute(threads=2), *reports)
    assert len([*threads.output.rglob("*")]) > 12
    for name in places:
        place = Compute(workers=2, threads=1) if name == "processes" else Compute(scheduler=address)
        output = results(root, tmp_path / name, place, *reports).output
        differences = fault_drill.differences(threads.output, output)
        assert not [line for line in differences if not line.endswith("airswing_config")]


@pytest.mark.parametrize(
    ("place", "scheduler", "number"),
    [
        (Compute(), "threads", None),
        (Compute(threads=3), "threads", 3),
        (Compute(workers=1, threads=3), "threads", 3),
        (Compute(workers=2), "processes", 2),  # whatever the number of cores
    ],
)
def test_as_many_threads_or_processes_as_configured(place, scheduler, number):
    with job.resources(place, Progress(quiet=True)):
        assert dask.config.get("scheduler") == scheduler
        assert dask.config.get("num_workers") == number


def test_a_lazy_product_is_written_with_processes(tmp_path):
    sizes = {"row_size": ("aircraft", np.array([4], dtype=np.int32))}
    ds = xr.Dataset({"turn": ("report", np.arange(4.0))} | sizes).chunk(report=2)
    with job.resources(Compute(workers=2, threads=1), Progress(quiet=True)):
        path = airswing.write_product(ds.assign(turn=ds["turn"] + 1.0), tmp_path / "p.nc", title="")
    assert airswing.read_product(path)["turn"].values.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(job, "CONNECT_TIMEOUT", "1s")
    with (
        pytest.raises(InputError, match=r"cannot reach.*tcp://127\.0\.0\.1:9.*dask scheduler"),
        job.resources(Compute(scheduler="tcp://127.0.0.1:9"), Progress(quiet=True)),
    ):
        pass


def test_a_worker_process_that_ends_is_one_message():
    def die():
        os.kill(os.getpid(), signal.SIGKILL)

    with (
        pytest.raises(InputError, match=r"out of memory.*fewer workers.*same command again"),
        job.resources(Compute(workers=2, threads=1), Progress(quiet=True)),
    ):
        dask.delayed(die)().compute()


LOST = (distributed.comm.core.CommClosedError("gone"), CancelledError("gone"))


@pytest.mark.parametrize("lost", [*LOST, distributed.KilledWorker("task", None, 3)], ids=repr)
def test_a_lost_connection_to_the_scheduler_is_one_message(address, lost):
    with (
        pytest.raises(InputError, match=r"same command again"),
        job.resources(Compute(scheduler=address), Progress(quiet=True)),
    ):
        raise lost


def test_the_dashboard_and_missing_workers_are_reported(address, capsys):
    with job.resources(Compute(scheduler=address), Progress()):
        pass
    assert "dask dashboard: http" in capsys.readouterr().err
    options = {"n_workers": 0, "processes": False, "protocol": "tcp://"}
    with (
        distributed.LocalCluster(**options, dashboard_address=None) as cluster,
        job.resources(Compute(scheduler=cluster.scheduler_address), Progress()),
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
        job.require_same_code(Asked())
