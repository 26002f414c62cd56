"""Figures and pages: what a run, a field test and a gap diagnosis look like.

Assumes Datasets and dictionaries of docs/formats.md.  Every figure function returns a matplotlib
Figure that carries its ``caption`` and shows itself in a notebook; every page is one HTML file
with nothing outside it.  matplotlib is imported only when a name of this package is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for editors and mypy; at run time each is imported on first use
    from airswing.report.gap.closing_figures import autocorrelation_figure as autocorrelation_figure
    from airswing.report.gap.closing_figures import pit_figure as pit_figure
    from airswing.report.gap.closing_figures import waterfall_figure as waterfall_figure
    from airswing.report.gap.gap_page import write_gap_page as write_gap_page
    from airswing.report.gap.slices import slices_figure as slices_figure
    from airswing.report.gap.where_figures import aircraft_heading_figure as aircraft_heading_figure
    from airswing.report.gap.where_figures import aircraft_time_figure as aircraft_time_figure
    from airswing.report.gap.where_figures import gap_map_figure as gap_map_figure
    from airswing.report.gap.where_figures import phase_level_figure as phase_level_figure
    from airswing.report.gap.which_figures import evidence_figure as evidence_figure
    from airswing.report.gap.which_figures import posterior_figure as posterior_figure
    from airswing.report.gap.which_figures import unknown_curve_figure as unknown_curve_figure
    from airswing.report.html.maps import level_maps_figure as level_maps_figure
    from airswing.report.html.maps import phase_maps_figure as phase_maps_figure
    from airswing.report.html.maps import reports_figure as reports_figure
    from airswing.report.run.compass_figures import coverage_figure as coverage_figure
    from airswing.report.run.compass_figures import heading_error_figure as heading_error_figure
    from airswing.report.run.evaluation_figures import field_test_figure as field_test_figure
    from airswing.report.run.evaluation_figures import scrutiny_figure as scrutiny_figure
    from airswing.report.run.overview import audit_figure as audit_figure
    from airswing.report.run.overview import disagreement_figure as disagreement_figure
    from airswing.report.run.overview import fleet_figure as fleet_figure
    from airswing.report.run.page import write_page as write_page
    from airswing.report.run.sensitivity_figures import (
        aircraft_differences_figure as aircraft_differences_figure,
    )
    from airswing.report.run.sensitivity_figures import (
        pair_differences_figure as pair_differences_figure,
    )
    from airswing.report.run.stability_figures import prediction_figure as prediction_figure
    from airswing.report.run.stability_figures import ranking_figure as ranking_figure
    from airswing.report.run.stability_figures import stability_figure as stability_figure

_WHERE = {
    "reports_figure": "html.maps",
    "phase_maps_figure": "html.maps",
    "level_maps_figure": "html.maps",
    "heading_error_figure": "run.compass_figures",
    "coverage_figure": "run.compass_figures",
    "fleet_figure": "run.overview",
    "disagreement_figure": "run.overview",
    "audit_figure": "run.overview",
    "field_test_figure": "run.evaluation_figures",
    "scrutiny_figure": "run.evaluation_figures",
    "stability_figure": "run.stability_figures",
    "ranking_figure": "run.stability_figures",
    "prediction_figure": "run.stability_figures",
    "pair_differences_figure": "run.sensitivity_figures",
    "aircraft_differences_figure": "run.sensitivity_figures",
    "aircraft_heading_figure": "gap.where_figures",
    "aircraft_time_figure": "gap.where_figures",
    "phase_level_figure": "gap.where_figures",
    "gap_map_figure": "gap.where_figures",
    "slices_figure": "gap.slices",
    "evidence_figure": "gap.which_figures",
    "posterior_figure": "gap.which_figures",
    "unknown_curve_figure": "gap.which_figures",
    "waterfall_figure": "gap.closing_figures",
    "autocorrelation_figure": "gap.closing_figures",
    "pit_figure": "gap.closing_figures",
    "write_page": "run.page",
    "write_gap_page": "gap.gap_page",
}

__all__ = sorted(_WHERE)


def __getattr__(name: str) -> object:
    """Import a figure or page function on first use."""
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"airswing.report.{_WHERE[name]}"), name)
    return found


def __dir__() -> list[str]:
    """List the figure and page functions, for completion."""
    return sorted([*globals(), *_WHERE])
