"""The stages in order, each a function of the job and what the stage before made.

``main`` tells the whole job; ``collocating``, ``headings_stage``, ``fits``, ``evaluation_stage``
and ``ranking_stage`` hold its stages, ``gap_stage`` those of the gap; ``job`` what they share.
"""

from airswing.workflow.evaluation_stage import (
    make_evaluation,
    make_field_test,
    make_profiles,
    make_sensitivity,
)
from airswing.workflow.fits import make_corrected, make_fits
from airswing.workflow.headings_stage import make_headings, plan_run
from airswing.workflow.job import (
    COLLOCATING,
    CORRECTED,
    FIELD_TEST,
    FITS,
    FITTING,
    HEADINGS,
    PROFILES,
    SENSITIVITY,
    Job,
    main_reference,
    where_it_stands,
)
from airswing.workflow.main import make_page, run
from airswing.workflow.ranking_stage import make_ranking, make_stability, make_virtual

__all__ = [
    "COLLOCATING",
    "CORRECTED",
    "FIELD_TEST",
    "FITS",
    "FITTING",
    "HEADINGS",
    "PROFILES",
    "SENSITIVITY",
    "Job",
    "main_reference",
    "make_corrected",
    "make_evaluation",
    "make_field_test",
    "make_fits",
    "make_headings",
    "make_page",
    "make_profiles",
    "make_ranking",
    "make_sensitivity",
    "make_stability",
    "make_virtual",
    "plan_run",
    "run",
    "where_it_stands",
]
