"""Figures and pages: what a run, a field test and a gap diagnosis look like.

Assumes Datasets and dictionaries of FORMATS.md.  Every figure function returns a matplotlib
Figure that carries its ``caption`` and shows itself in a notebook; every page is one HTML file
with nothing outside it.  matplotlib is imported only when a name of this package is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_WHERE = {
    "reports_figure": "maps",
    "phase_maps_figure": "maps",
    "level_maps_figure": "maps",
    "heading_error_figure": "compass",
    "small_multiples_figure": "compass",
    "coverage_figure": "compass",
    "fleet_figure": "overview",
    "disagreement_figure": "overview",
    "audit_figure": "overview",
    "field_test_figure": "evaluation_figures",
    "scrutiny_figure": "evaluation_figures",
    "profiles_figure": "evaluation_figures",
    "stability_figure": "stability_figures",
    "ranking_figure": "stability_figures",
    "prediction_figure": "stability_figures",
    "pair_differences_figure": "sensitivity_figures",
    "aircraft_differences_figure": "sensitivity_figures",
    "aircraft_heading_figure": "gap_figures",
    "aircraft_time_figure": "gap_figures",
    "phase_level_figure": "gap_figures",
    "gap_map_figure": "gap_figures",
    "timeline_figure": "gap_slices",
    "slices_figure": "gap_slices",
    "evidence_figure": "gap_evidence_figures",
    "posterior_figure": "gap_evidence_figures",
    "unknown_curve_figure": "gap_evidence_figures",
    "waterfall_figure": "gap_evidence_figures",
    "autocorrelation_figure": "gap_evidence_figures",
    "pit_figure": "gap_evidence_figures",
    "write_page": "page",
    "write_gap_page": "gap_page",
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
