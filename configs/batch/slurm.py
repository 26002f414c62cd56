"""The main job with its workers on Slurm: python configs/batch/slurm.py CONFIG [JOBS].

Takes what a worker job gets from jobqueue.yaml beside it, holds the scheduler, asks for up to JOBS
worker jobs (8 by default), and goes on with what an earlier run finished. See docs/operation.md.
"""

import subprocess
import sys
from pathlib import Path

import dask

dask.config.refresh(paths=[str(Path(__file__).parent), *dask.config.paths])

from dask_jobqueue import SLURMCluster  # noqa: E402  (reads the configuration when imported)

config, jobs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 8
with SLURMCluster() as cluster:
    cluster.adapt(minimum_jobs=1, maximum_jobs=jobs)
    command = [sys.executable, "-m", "airswing", "run", config, "--resume"]
    raise SystemExit(
        subprocess.run([*command, "--scheduler", cluster.scheduler_address]).returncode
    )
