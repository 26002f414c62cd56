"""Public names and the modules they come from; `__init__.py` imports them by this list."""

from airswing.compass.correction import add_tables as add_tables
from airswing.compass.correction import correct as correct
from airswing.compass.fit.deviation import fit_deviation as fit_deviation
from airswing.compass.headings import derive_headings as derive_headings
from airswing.compass.screening import audit as audit
from airswing.compass.screening import screen as screen
from airswing.config_file import load_config as load_config
from airswing.evaluation.comparison import compare as compare
from airswing.evaluation.field_test import field_test as field_test
from airswing.evaluation.gains import cross_validate as cross_validate
from airswing.evaluation.gains import rank_aircraft as rank_aircraft
from airswing.evaluation.gains import virtual_field_test as virtual_field_test
from airswing.evaluation.innovations import error_profiles as error_profiles
from airswing.evaluation.innovations import innovation_statistics as innovation_statistics
from airswing.evaluation.monitoring.changes import watch_compasses as watch_compasses
from airswing.evaluation.monitoring.events import find_events as find_events
from airswing.evaluation.observation_errors import (
    observation_errors as observation_errors,
)
from airswing.gap.archive.frame import Frame as Frame
from airswing.gap.simulation.report_table import simulate_reports as simulate_reports
from airswing.handover.export import export as export
from airswing.handover.forecasts.correcting import correct_forecasts as correct_forecasts
from airswing.products.netcdf import open_product as open_product
from airswing.products.netcdf import open_results as open_results
from airswing.products.netcdf import read_product as read_product
from airswing.products.netcdf import write_product as write_product
from airswing.products.ragged import aircraft_reports as aircraft_reports
from airswing.reference.catalogue import build_catalogue as build_catalogue
from airswing.reference.collocate import collocate as collocate
from airswing.reference.fleet_wind import fleet_wind as fleet_wind
from airswing.report.gap.gap_page import diagnose as diagnose
from airswing.reports.read import read_reports as read_reports
from airswing.synthetic.archive import write_archive as write_archive
from airswing.synthetic.mode_s import write_mode_s as write_mode_s
from airswing.version import __version__ as __version__
from airswing.workflow.main import run as run
from airswing.workflow.track import append_winds as append_winds
