"""Run the main job with workers on Slurm: python configs/batch/slurm.py CONFIG [JOBS].

Starts a scheduler in this process and up to JOBS worker jobs (8 by default) with the resources of
jobqueue.yaml in the same folder. Finished months of an earlier run are kept. See docs/operation.md.
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
    command = [sys.executable, "-m", "airswing", "run", config]
    raise SystemExit(
        subprocess.run([*command, "--scheduler", cluster.scheduler_address]).returncode
    )
