"""A diagnosis as a notebook shows it: the verdict, a small table, and the page's figures.

Assumes what :func:`airswing.gap.diagnose.diagnose` assumes; this stands above it because figures
are drawn from what it found, not by it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.gap.diagnose import Diagnosis
from airswing.gap.diagnose import diagnose as found_by
from airswing.report.gap.closing_figures import (
    autocorrelation_figure,
    pit_figure,
    waterfall_figure,
)
from airswing.report.gap.slices import slices_figure
from airswing.report.gap.verdict import verdict
from airswing.report.gap.where_figures import (
    aircraft_heading_figure,
    aircraft_time_figure,
    gap_map_figure,
    phase_level_figure,
)
from airswing.report.gap.which_figures import (
    evidence_figure,
    posterior_figure,
    posteriors,
    unknown_curve_figure,
)
from airswing.report.gap.words import plain_name, slice_words, who_text
from airswing.report.html.document import Column, Row, table

P = ParamSpec("P")


class ShownDiagnosis(Diagnosis):
    """What :func:`airswing.diagnose` found: `report`, `dataset`, `adjustment` and its figures."""

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of the gap's page by name, drawn anew."""
        gap, maps = self.report, self.dataset
        drawn = {
            "slices": slices_figure(gap.where),
            "aircraft_heading": aircraft_heading_figure(maps, gap),
            "phase_level": phase_level_figure(maps, gap),
            "map": gap_map_figure(maps, gap),
            "aircraft_time": aircraft_time_figure(maps, gap),
            "evidence": evidence_figure(gap),
            "autocorrelation": autocorrelation_figure(gap),
            "pit": pit_figure(maps),
        }
        single = posteriors(gap.evidence)
        if single:
            tails = [str(tail) for tail in maps["aircraft"].to_numpy()]
            drawn["posterior"] = posterior_figure(tails, single)
        if gap.effects:
            drawn["waterfall"] = waterfall_figure(gap)
        for number, place in enumerate(gap.unknown.where, 1):
            drawn[f"unknown_{number}"] = unknown_curve_figure(place)
        return drawn

    def _repr_html_(self) -> str:
        """The verdict, and what is at work with aircraft, probability and what it closes."""
        gap = self.report
        rows = [
            Row(
                [
                    plain_name(effect.name),
                    who_text(effect, gap.counts.aircraft),
                    f"{effect.probability:.2f}",
                    f"{100 * effect.share_of_gap:.0f} % of the gap",
                ]
            )
            for effect in gap.effects
        ]
        for place in gap.unknown.where:
            closes = f"{place.closure.reduction:.2f} kt" if place.closure else "-"
            sure = "-" if place.probability is None else f"{place.probability:.2f}"
            rows.append(Row(["without a name", slice_words(place), sure, closes]))
        names = Column("effect"), Column("who"), Column("probability"), Column("closes")
        told = [Markup("<p>{}</p>").format(verdict(gap))]
        return str(Markup("").join([*told, table(names, rows)] if rows else told))


def _shown(find: Callable[P, Diagnosis]) -> Callable[P, ShownDiagnosis]:
    @wraps(find)
    def diagnose(*args: P.args, **kwargs: P.kwargs) -> ShownDiagnosis:
        found = find(*args, **kwargs)
        return ShownDiagnosis(found.report, found.dataset, found.adjustment)

    return diagnose


diagnose = _shown(found_by)
