"""Figures and pages of a run, a field test and a gap diagnosis.

Every figure function returns a matplotlib Figure that carries its ``caption`` and is displayed in a
notebook. Every page is one HTML file with nothing outside it. matplotlib is imported when a name
of this package is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from airswing.report.gap.gap_page import write_gap_page as write_gap_page
    from airswing.report.html.maps import level_maps_figure as level_maps_figure
    from airswing.report.html.maps import phase_maps_figure as phase_maps_figure
    from airswing.report.html.maps import reports_figure as reports_figure
    from airswing.report.run.changes import stability_figure as stability_figure
    from airswing.report.run.changes import timeline_figure as timeline_figure
    from airswing.report.run.evaluation import (
        aircraft_differences_figure as aircraft_differences_figure,
    )
    from airswing.report.run.evaluation import field_test_figure as field_test_figure
    from airswing.report.run.evaluation import pair_differences_figure as pair_differences_figure
    from airswing.report.run.evaluation import prediction_figure as prediction_figure
    from airswing.report.run.evaluation import ranking_figure as ranking_figure
    from airswing.report.run.evaluation import report_errors_figure as report_errors_figure
    from airswing.report.run.evaluation import scrutiny_figure as scrutiny_figure
    from airswing.report.run.fleet import audit_figure as audit_figure
    from airswing.report.run.fleet import disagreement_figure as disagreement_figure
    from airswing.report.run.fleet import fleet_figure as fleet_figure
    from airswing.report.run.heading_error import coverage_figure as coverage_figure
    from airswing.report.run.heading_error import heading_error_figure as heading_error_figure
    from airswing.report.run.heading_error import heading_errors_figure as heading_errors_figure
    from airswing.report.run.innovations import innovation_figure as innovation_figure
    from airswing.report.run.innovations import (
        innovation_histogram_figure as innovation_histogram_figure,
    )
    from airswing.report.run.innovations import innovation_series_figure as innovation_series_figure
    from airswing.report.run.innovations import sounding_figure as sounding_figure
    from airswing.report.run.page import write_page as write_page
    from airswing.report.run.swing_cards import swing_card_figure as swing_card_figure
    from airswing.report.run.swing_cards import write_swing_cards as write_swing_cards

_MODULES = {
    "html.maps": "reports_figure phase_maps_figure level_maps_figure",
    "run.heading_error": "heading_error_figure heading_errors_figure coverage_figure",
    "run.swing_cards": "swing_card_figure write_swing_cards",
    "run.fleet": "fleet_figure disagreement_figure audit_figure",
    "run.evaluation": "field_test_figure scrutiny_figure ranking_figure prediction_figure "
    "pair_differences_figure aircraft_differences_figure report_errors_figure",
    "run.changes": "stability_figure timeline_figure",
    "run.innovations": "innovation_figure innovation_histogram_figure "
    "innovation_series_figure sounding_figure",
    "run.page": "write_page",
    "gap.gap_page": "write_gap_page",
}
_WHERE = {name: module for module, names in _MODULES.items() for name in names.split()}

__all__ = sorted(_WHERE)


def __getattr__(name: str) -> object:
    """Import a figure or page function when it is first used."""
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"airswing.report.{_WHERE[name]}"), name)
    return found


def __dir__() -> list[str]:
    """Return the names of the figure and page functions, for completion."""
    return sorted([*globals(), *_WHERE])
