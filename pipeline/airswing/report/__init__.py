"""Figures and pages: what a run, a field test and a gap diagnosis look like.

Assumes Datasets and dictionaries of docs/formats.md.  Every figure function returns a matplotlib
Figure that carries its ``caption`` and shows itself in a notebook; every page is one HTML file
with nothing outside it.  matplotlib is imported only when a name of this package is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

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


def __getattr__(name: str) -> Any:
    """Import a figure or page function on first use."""
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"airswing.report.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    """List the figure and page functions, for completion."""
    return sorted([*globals(), *_WHERE])
