"""The stages that the commands run, in order, each a function of the job.

``months`` makes the headings month by month, ``stages`` fits, corrects and evaluates, ``main`` runs
all of them; ``gap_stage`` diagnoses the gap.
"""

from airswing.workflow.job import CORRECTED as CORRECTED
from airswing.workflow.job import FITS as FITS
from airswing.workflow.job import HEADINGS as HEADINGS
from airswing.workflow.job import PROFILES as PROFILES
from airswing.workflow.job import Job as Job
from airswing.workflow.main import run_job as run_job
from airswing.workflow.months import make_headings as make_headings
from airswing.workflow.stages import make_corrected as make_corrected
from airswing.workflow.stages import make_field_test as make_field_test
from airswing.workflow.stages import make_fits as make_fits
from airswing.workflow.stages import make_monitoring as make_monitoring
from airswing.workflow.stages import make_sensitivity as make_sensitivity
from airswing.workflow.stages import record_printed as record_printed
