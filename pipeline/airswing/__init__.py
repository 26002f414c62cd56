"""Swing an aircraft's compass from its archive of wind reports and model winds.

Assumes reports of wind, position and time from aircraft that compute wind as ground velocity
minus air velocity along a magnetic heading, and model winds in GRIB. The stages, in order, are
functions from Datasets to a Dataset: :func:`read_reports`, :func:`build_catalogue`,
:func:`collocate`, :func:`derive_headings`, :func:`screen`, :func:`fit_deviation`,
:func:`add_tables`, :func:`correct`; then :func:`field_test`, :func:`compare` and
:func:`diagnose`. See the README for the two-command start and ``airswing --help`` for the
commands.
"""

from importlib import import_module
from typing import TYPE_CHECKING

# pyproj must come first: some eccodes builds bundle a libproj that crashes the interpreter
# when it is loaded before pyproj's. tests/test_import_order.py holds both orders.
import pyproj  # noqa: F401

from airswing.version import __version__ as __version__

if TYPE_CHECKING:  # for editors and mypy; at run time each is imported on first use
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
    from airswing.workflow.main import run as run
    from airswing.workflow.track import append_winds as append_winds

# Modules and their public names, which are imported on first use.
_PUBLIC = {
    "airswing.reports.read": "read_reports",
    "airswing.reference.catalogue": "build_catalogue",
    "airswing.reference.collocate": "collocate",
    "airswing.reference.fleet_wind": "fleet_wind",
    "airswing.compass.headings": "derive_headings",
    "airswing.compass.screening": "screen audit",
    "airswing.compass.fit.deviation": "fit_deviation",
    "airswing.compass.correction": "add_tables correct",
    "airswing.evaluation.innovations": "error_profiles innovation_statistics",
    "airswing.evaluation.field_test": "field_test",
    "airswing.evaluation.gains": "rank_aircraft virtual_field_test cross_validate",
    "airswing.evaluation.monitoring.changes": "watch_compasses",
    "airswing.evaluation.monitoring.events": "find_events",
    "airswing.evaluation.comparison": "compare",
    "airswing.gap.simulation.report_table": "simulate_reports",
    "airswing.gap.archive.frame": "Frame",
    "airswing.report.gap.gap_page": "diagnose",
    "airswing.handover.export": "export",
    "airswing.evaluation.observation_errors": "observation_errors",
    "airswing.handover.forecasts.correcting": "correct_forecasts",
    "airswing.workflow.main": "run",
    "airswing.workflow.track": "append_winds",
    "airswing.products.netcdf": "open_product open_results read_product write_product",
    "airswing.config_file": "load_config",
    "airswing.products.ragged": "aircraft_reports",
    "airswing.synthetic.archive": "write_archive",
    "airswing.synthetic.mode_s": "write_mode_s",
}
_STAGES = {name: module for module, names in _PUBLIC.items() for name in names.split()}

__all__ = sorted(_STAGES)


def __getattr__(name: str) -> object:
    if name not in _STAGES:
        raise AttributeError(f"module 'airswing' has no attribute {name!r}")
    found: object = getattr(import_module(_STAGES[name]), name)
    return found


def __dir__() -> list[str]:
    return [*globals(), *_STAGES]
