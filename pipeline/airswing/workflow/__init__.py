"""The stages that the commands run, in order, each a function of the job.

``months`` makes the headings month by month, ``stages`` fits, corrects and evaluates, ``main`` runs
all of them; ``gap_stage`` diagnoses the gap.
"""

from airswing.workflow.job import CORRECTED, FITS, HEADINGS, PROFILES, Job
from airswing.workflow.main import Results, run, run_job
from airswing.workflow.months import make_headings
from airswing.workflow.stages import (
    events_said,
    make_corrected,
    make_field_test,
    make_fits,
    make_monitoring,
    make_sensitivity,
)

__all__ = [
    "CORRECTED",
    "FITS",
    "HEADINGS",
    "PROFILES",
    "Job",
    "Results",
    "events_said",
    "make_corrected",
    "make_field_test",
    "make_fits",
    "make_headings",
    "make_monitoring",
    "make_sensitivity",
    "run",
    "run_job",
]
