"""The shipped recipe for a batch system, run by a stand-in for Slurm on this machine.

`sbatch` and `scancel` of the stand-in start and end a job's script as Slurm does; the recipe, what
dask-jobqueue makes of it, the worker processes and the run are the real ones.
"""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from airswing.products.netcdf import read_product
from airswing.workflow import Job, make_headings
from tests.command import configured

pytest.importorskip("dask_jobqueue")

SBATCH = """#!/bin/bash
cp "$1" {folder}/job.sh  # Slurm keeps a copy, since the caller deletes the script soon
setsid bash {folder}/job.sh > {folder}/job.log 2>&1 &
echo $! >> {folder}/submitted
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/bash
echo "$1" >> {folder}/cancelled
kill -- "-$1"
"""


@pytest.fixture
def slurm(tmp_path):
    """A folder with the stand-in's commands, first in the path; two small workers a job."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (folder / name).write_text(text.format(folder=folder))
        (folder / name).chmod(0o755)
    yield folder
    for number in (folder / "submitted").read_text().split():
        subprocess.run(["kill", "--", f"-{number}"], check=False, stderr=subprocess.DEVNULL)


@pytest.mark.slow
def test_the_recipe_runs_the_main_job_on_workers_of_the_batch_system(slurm, tmp_path, root):
    table = tmp_path / "N401.csv"
    rows = (root / "data_samples/reports/N401.csv").read_text().splitlines(keepends=True)
    table.write_text("".join(rows[:1500]))  # eight days
    config = configured(tmp_path, table, {"ruc": root / "data_samples/ruc/*.grb"}, output="batch")
    environment = os.environ | {
        "PATH": f"{slurm}:{os.environ['PATH']}",
        "DASK_JOBQUEUE__SLURM__CORES": "2",
        "DASK_JOBQUEUE__SLURM__PROCESSES": "2",
        "DASK_JOBQUEUE__SLURM__MEMORY": "4GiB",
    }
    recipe = [sys.executable, str(root / "configs/batch/slurm.py"), str(config), "1"]
    options = {"env": environment, "cwd": tmp_path, "timeout": 240}
    done = subprocess.run(recipe, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "dask dashboard" in done.stderr + done.stdout
    assert (slurm / "cancelled").read_text() == (slurm / "submitted").read_text()
    script = (slurm / "job.sh").read_text()
    assert re.search(r"#SBATCH --cpus-per-task=2\b", script)
    assert "--lifetime 110m" in script and "--nthreads 1" in script
    log = (slurm / "job.log").read_text()
    assert log.count("Start worker at") == 2 and "Traceback" not in log

    expected = make_headings(Job.of(config, output=tmp_path / "here", quiet=True))
    batch = read_product(tmp_path / "batch/headings")
    for name in batch.variables:
        np.testing.assert_array_equal(batch[name].to_numpy(), expected[name].to_numpy(), str(name))
