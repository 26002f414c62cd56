"""The stages that the commands run, in order, each a function of the job.

``months`` makes the headings month by month, ``fitting`` fits and corrects, ``evaluation_stage``
and ``monitoring_stage`` evaluate, ``main`` runs all of them; ``gap_stage`` diagnoses the gap.
"""

from airswing.workflow.evaluation_stage import (
    make_evaluation,
    make_field_test,
    make_observation_errors,
    make_ranking,
    make_sensitivity,
    make_stability,
    make_virtual,
)
from airswing.workflow.fitting import make_corrected, make_fits
from airswing.workflow.job import (
    CORRECTED,
    FIELD_TEST,
    FITS,
    HEADINGS,
    PROFILES,
    SENSITIVITY,
    Job,
    main_reference,
)
from airswing.workflow.main import Results, make_page, run, run_job
from airswing.workflow.monitoring_stage import events_said, make_monitoring
from airswing.workflow.months import make_headings

__all__ = [
    "CORRECTED",
    "FIELD_TEST",
    "FITS",
    "HEADINGS",
    "PROFILES",
    "SENSITIVITY",
    "Job",
    "Results",
    "events_said",
    "main_reference",
    "make_corrected",
    "make_evaluation",
    "make_field_test",
    "make_fits",
    "make_headings",
    "make_monitoring",
    "make_observation_errors",
    "make_page",
    "make_ranking",
    "make_sensitivity",
    "make_stability",
    "make_virtual",
    "run",
    "run_job",
]
