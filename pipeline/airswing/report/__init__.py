"""Figures and pages of a run, a field test and a gap diagnosis.

Every figure function returns a matplotlib Figure that carries its ``caption`` and is displayed in a
notebook. Every page is one self-contained HTML file. matplotlib is imported when a name of this
package is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from airswing.report.gap.gap_page import write_gap_page as write_gap_page
    from airswing.report.run.evaluation import field_test_figure as field_test_figure
    from airswing.report.run.evaluation import pair_differences_figure as pair_differences_figure
    from airswing.report.run.heading_error import heading_error_figure as heading_error_figure
    from airswing.report.run.heading_error import write_swing_cards as write_swing_cards
    from airswing.report.run.page import write_page as write_page

_MODULES = {
    "heading_error_figure": "run.heading_error",
    "field_test_figure": "run.evaluation",
    "pair_differences_figure": "run.evaluation",
    "write_swing_cards": "run.heading_error",
    "write_page": "run.page",
    "write_gap_page": "gap.gap_page",
}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> object:
    """Import a figure or page function when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"airswing.report.{_MODULES[name]}"), name)
