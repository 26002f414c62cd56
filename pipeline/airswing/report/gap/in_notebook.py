"""``airswing.diagnose``: a gap diagnosis that a notebook displays as text, table and figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from typing import ParamSpec

from markupsafe import Markup
from matplotlib.figure import Figure

from airswing.gap.diagnose import Diagnosis
from airswing.gap.diagnose import diagnose as _diagnose
from airswing.report.gap.gap_page import gap_figures
from airswing.report.gap.words import closure_text, headline, plain_name, who_text
from airswing.report.html.document import Column, Row, table

P = ParamSpec("P")


class ShownDiagnosis(Diagnosis):
    """Result of :func:`airswing.diagnose`, with the figures of the gap's page."""

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of the gap's page by name, newly drawn."""
        drawn = gap_figures(self.report, self.dataset)
        return {name: draw() for name, draw in drawn.items()}

    def _repr_html_(self) -> str:
        gap = self.report.content()
        fleet = self.report.counts.aircraft
        rows = [
            Row(
                [
                    plain_name(effect["name"]),
                    who_text(effect, fleet),
                    f"{effect['probability']:.2f}",
                    closure_text(effect.get("closure")),
                ]
            )
            for effect in gap["effects"]  # type: ignore[attr-defined]
        ]
        for place in gap["unknown"]["where"]:  # type: ignore[index]
            name = f"unexplained, by {' and '.join(place['variables']).replace('_', ' ')}"
            chance = place["probability"]
            cells = [name, who_text(place, fleet), "-" if chance is None else f"{chance:.2f}"]
            rows.append(Row([*cells, closure_text(place["closure"])]))
        columns = [Column(name) for name in ("effect", "aircraft", "probability", "closes")]
        text = Markup("<p>{}</p>").format(headline(gap))
        return str(text + table(columns, rows) if rows else text)


def _shown(find: Callable[P, Diagnosis]) -> Callable[P, ShownDiagnosis]:
    @wraps(find)
    def diagnose(*args: P.args, **kwargs: P.kwargs) -> ShownDiagnosis:
        found = find(*args, **kwargs)
        return ShownDiagnosis(*(getattr(found, one.name) for one in fields(found)))

    return diagnose


diagnose = _shown(_diagnose)
